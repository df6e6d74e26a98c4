"""A run while it is measured: what is known of it so far."""

from __future__ import annotations

import math
from typing import Any

from vio_eval_ros.core.trajectory import Pairs
from vio_eval_ros.diagnosis.causes.cause import KnownCause
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun
from vio_eval_ros.diagnosis.first_fit import FirstFit
from vio_eval_ros.diagnosis.geometry import Body
from vio_eval_ros.diagnosis.inputs import interpolated_over_s
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.diagnosis.measurement import Measurement

SIDES = ('estimate', 'ground_truth')


class Measuring:
    """
    What has been measured so far, and the correction of what is unusual in it.

    :param run: that is measured.
    :param limits: of what is healthy.
    :param fit: the peak of the correlation of angular speeds, the convention that the poses were
        written in, and the lag under it.
    """

    def __init__(
        self,
        run: DiagnosedRun,
        limits: DiagnosisLimits,
        fit: FirstFit,
    ) -> None:
        self.run, self.limits = run, limits
        self.peak, self.convention, self.lag = fit.peak, fit.convention, fit.lag
        #: what the frames tell, once they have been measured
        self.body = Body.unknown()
        self.correction = Correction(run.middle_ns)
        self.measurements: list[Measurement] = []
        self.findings: dict[str, Any] = {
            'position_only': not run.oriented,
            'stamps_far_from_all_others': run.stray,
            'orientations_that_never_change': run.constant_orientations,
            'truth_interpolated_s': interpolated_over_s(run.truth),
        }

    def pairs(self) -> Pairs:
        """Return the estimate with all that is unusual undone, and the true poses."""
        return self.run.pairs(self.correction)

    def measured(self, cause: KnownCause, value: float, uncertainty: float) -> Measurement:
        """Return the measurement of a cause in this run."""
        return cause.measurement(value, uncertainty, self.limits, self.run.half_s)

    def counted(self, cause: KnownCause, value: float) -> Measurement:
        """Return the measurement of a cause that is counted, not estimated."""
        return cause.counted(value, self.limits)

    def note(self, cause: KnownCause, measurement: Measurement, value: Any = None) -> None:
        """
        Remember a measurement; where it is unusual, the correction undoes it by the value.

        In too short a run, nothing that has an uncertainty is observable.
        """
        if 2 * self.run.half_s < self.limits.shortest_s and not math.isnan(
            measurement.uncertainty
        ):
            measurement = measurement.as_unobservable()
        self.measurements.append(measurement)
        if measurement.unusual:
            self.correction = cause.undone(self.correction, value)
