"""What there is to know of a cause: an entry of ``CAUSES``."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import Any

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.diagnosis.correction import Correction, Step, Undo
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.diagnosis.measurement import Measurement

#: errors by the beginnings of their names
POSITION_ERRORS = r'ATE|RPE'
FRAME_ERRORS = r'(rotation )?RPE 1f'
OF_GROUND_TRUTH = (
    'Check what provides the ground truth at those moments (markers lost or swapped, multipath), '
    'and leave them out.'
)
Evidence = Callable[[Measurement, Mapping[str, Any]], str]


def template(text: str, **more: Callable[[float], object]) -> Evidence:
    """Return evidence that is a text with value v and uncertainty u, and more from the value."""

    def evidence(measurement: Measurement, findings: Mapping[str, Any]) -> str:
        values = {name: function(measurement.value) for name, function in more.items()}
        return text.format(v=measurement.value, u=measurement.uncertainty, **values)

    return evidence


def no_flags(correction: Correction, config: EvaluationConfig) -> tuple[str, ...]:
    """Return the flags of what only the estimator can correct."""
    return ()


@dataclass(frozen=True, eq=False)
class KnownCause:
    """
    A cause that a diagnosis may name: all there is to know of it.

    :param name: as users read it.
    :param unit: of its value, as text; empty where it has no value.
    :param meaning: of the value, for the docs.
    :param measured: how, for the docs.
    :param remedy: what undoes it, for the docs.
    :param evidence: from its measurement and the findings, the end of a sentence about the side.
    :param advice: one sentence on what to do.
    :param advice_without_imu: likewise for a system without an IMU; empty where it is the same.
    :param limits: names of the fields of the limits that decide whether it is healthy.
    :param healthy: from the limits and half the duration of the run in seconds, the largest
        healthy size.
    :param undo: takes it out of poses; None where that cannot be done afterwards.
    :param undo_order: causes of a lower number are undone first.
    :param flags: from the correction and the flags given, those of ``replay`` that correct it.
        What begins with a question mark is appended to the spec of the side.
    :param acts_on: beginnings of the names of the errors that undoing it has to reduce, a regular
        expression. What rotates the alignment a little changes the absolute rotation error with
        it, in one direction or the other.
    :param removed_by: alignments under which it is not an error.
    :param may_raise_ate: whether it shows as it is, so that other errors may hide it in the ATE.
    :param comes_first: whether nothing else can be trusted while it is there.
    :param side: from the findings, the side that it is of.
    :param detail: from the correction, what is particular to this run, for the advice.
    :param special: from the correction, advice that stands for all other; empty where none does.
    """

    name: str
    unit: str
    meaning: str
    measured: str
    remedy: str
    advice: str
    evidence: Evidence
    advice_without_imu: str = ''
    limits: tuple[str, ...] = ()
    healthy: Callable[[DiagnosisLimits, float], float] = lambda limits, half_s: 0.0
    undo: Undo | None = None
    undo_order: int = 0
    flags: Callable[[Correction, EvaluationConfig], tuple[str, ...]] = no_flags
    acts_on: str = ''
    removed_by: tuple[str, ...] = ()
    may_raise_ate: bool = False
    comes_first: bool = False
    side: Callable[[Mapping[str, Any]], str] = lambda findings: 'estimate'
    detail: Callable[[Correction], str] = lambda correction: ''
    special: Callable[[Correction], str] = lambda correction: ''

    @property
    def unit_in_names(self) -> str:
        """The unit as names of values have it, such as ``percent_per_min``."""
        return self.unit.replace('%', 'percent').replace('/', '_per_')

    def measurement(
        self, value: float, uncertainty: float, limits: DiagnosisLimits, half_s: float
    ) -> Measurement:
        """Return its measurement, whose size is the absolute value."""
        value, uncertainty = float(value), float(uncertainty)
        return Measurement(
            name=self.name,
            value=value,
            unit=self.unit,
            uncertainty=uncertainty,
            healthy=self.healthy(limits, half_s),
            needed_confidence=limits.confidence_percent / 100,
            size=abs(value),
            size_uncertainty=uncertainty,
        )

    def counted(self, value: float, limits: DiagnosisLimits) -> Measurement:
        """Return its measurement where it is counted, not estimated."""
        return self.measurement(value, math.nan, limits, math.nan)

    def undone(self, correction: Correction, value: Any) -> Correction:
        """Return the correction that undoes this cause as well, by a value."""
        if self.undo is None:
            return correction
        return correction.having(self.name, Step(self.undo_order, self.undo, value))

    def advised(self, correction: Correction, side: str, limits: DiagnosisLimits) -> str:
        """Return what to do about it in a run."""
        special = self.special(correction)
        if special:
            return special
        if side == 'ground_truth' and not self.comes_first:
            return OF_GROUND_TRUTH
        text = self.advice if limits.inertial else self.advice_without_imu or self.advice
        detail = self.detail(correction)
        return f'{text} Here {detail}.' if detail else text
