"""All that is measured of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from vio_eval_ros.diagnosis.causes import FAMILIES
from vio_eval_ros.diagnosis.causes.measuring import Measuring
from vio_eval_ros.diagnosis.conventions import find_convention, FoundConvention
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.correlation import Peak
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun
from vio_eval_ros.diagnosis.lag import fit_lag, Lag, speed_peak
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.diagnosis.measurement import Measurement

#: a lower peak of the correlation is not trusted
TRUSTED_PEAK = 0.6
#: starts closer than this lead to the same lag
SAME_LAG_S = 0.05


@dataclass(frozen=True, eq=False)
class Measured:
    """
    All that was measured.

    :param correction: undoes all of it that is unusual.
    :param measurements: in the order in which they were made.
    :param findings: what else there is to say, by name.
    :param convention: how the poses were written.
    """

    correction: Correction
    measurements: tuple[Measurement, ...]
    findings: dict[str, Any]
    convention: FoundConvention


def measure(run: DiagnosedRun, limits: DiagnosisLimits) -> Measured:
    """
    Return all measurements of a run, each with what was found before undone.

    :raises NoPairs: the two sides have no time in common.
    """
    measuring = Measuring(run, limits, *_first_fit(run))
    for measure_family in FAMILIES:
        measure_family(measuring)
    return Measured(
        correction=measuring.correction,
        measurements=tuple(measuring.measurements),
        findings=measuring.findings,
        convention=measuring.convention,
    )


def _first_fit(run: DiagnosedRun) -> tuple[Peak, FoundConvention, Lag]:
    """Return where the angular speeds agree, and the convention and the lag that fit together."""
    peak = speed_peak(run.estimate, run.truth, run.gap_s)
    starts = [0.0]
    if peak.height > TRUSTED_PEAK:
        starts = [peak.lag_s] if abs(peak.lag_s) < SAME_LAG_S else [peak.lag_s, 0.0]
    tried = []
    for start_s in starts:
        found = find_convention(run.estimate, run.true_poses, start_s)
        meant = found.convention.undo(run.estimate)
        lag = fit_lag(meant, run.true_poses, start_s, by_rotations=run.oriented)
        tried.append((found, lag))
    found, lag = min(tried, key=lambda one: one[1].residual)
    return peak, found, lag
