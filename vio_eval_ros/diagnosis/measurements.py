"""All that is measured of a run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from vio_eval_ros.diagnosis.causes import FAMILIES
from vio_eval_ros.diagnosis.causes.measuring import Measuring
from vio_eval_ros.diagnosis.conventions import FoundConvention
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun
from vio_eval_ros.diagnosis.first_fit import FirstFit
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.diagnosis.measurement import Measurement


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


def measure(run: DiagnosedRun, fit: FirstFit, limits: DiagnosisLimits) -> Measured:
    """
    Return all measurements of a run, each with what was found before undone.

    :param fit: the lag and the convention that were found first.
    :raises NoPairs: the two sides have no time in common.
    """
    measuring = Measuring(run, limits, fit)
    for measure_family in FAMILIES:
        measure_family(measuring)
    return Measured(
        correction=measuring.correction,
        measurements=tuple(measuring.measurements),
        findings=measuring.findings,
        convention=measuring.convention,
    )
