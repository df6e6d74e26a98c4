"""Which of the measurements are causes: those that explain an error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

from vio_eval_ros.diagnosis.causes import CAUSES
from vio_eval_ros.diagnosis.causes.cause import KnownCause
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.diagnosed_run import ATE, DiagnosedRun, improvement
from vio_eval_ros.diagnosis.limits import DiagnosisLimits
from vio_eval_ros.diagnosis.measurement import Measurement
from vio_eval_ros.diagnosis.measurements import Measured
from vio_eval_ros.diagnosis.report import Cause


@dataclass(frozen=True)
class Named:
    """A measurement that is a cause; undoing it takes an error from one value to another."""

    measurement: Measurement
    error: str = ''
    before: float = math.nan
    after: float = math.nan

    @property
    def name(self) -> str:
        """Of the cause."""
        return self.measurement.name

    @property
    def share(self) -> float:
        """How much of the error it explains; its size, where it cannot be undone."""
        return 1 - self.after / self.before if self.error else self.measurement.value


def named_causes(run: DiagnosedRun, measured: Measured, limits: DiagnosisLimits) -> list[Named]:
    """
    Return the measurements that are causes.

    Of all suspects the one is dropped first whose undoing matters least to the errors, then the
    next: two with similar effects, such as a lever arm and an offset on a straight path, are not
    both dropped.
    """
    unusual = [one for one in measured.measurements if one.unusual]
    irreversible = [one for one in unusual if CAUSES[one.name].undo is None]
    suspects = [
        one
        for one in unusual
        if one not in irreversible and run.config.alignment not in CAUSES[one.name].removed_by
    ]
    needed = limits.improvement_percent / 100
    named: list[Named] = []
    while suspects:
        correction = measured.correction.only(one.name for one in suspects)
        after = run.errors(correction)
        named = [
            _undone(one, run.errors(correction.without(one.name)), after, needed)
            for one in suspects
        ]
        least = min(named, key=lambda one: one.share)
        if least.share >= needed:
            break
        named.remove(least)
        suspects.remove(least.measurement)
    named += [Named(one) for one in irreversible]
    return sorted(named, key=lambda one: (not CAUSES[one.name].comes_first, -one.share))


def _undone(
    one: Measurement, before: dict[str, float], after: dict[str, float], needed: float
) -> Named:
    """
    Return a measurement with the error that undoing it reduces most.

    Where there is any doubt, undoing a cause must not raise the ATE: a fault can hide drift by
    chance.
    """
    known = CAUSES[one.name]
    may_raise_ate = known.may_raise_ate or one.significant
    if not may_raise_ate and after.get(ATE, 0.0) > (1 + needed) * before.get(ATE, math.inf):
        return Named(one, ATE, before[ATE], after[ATE])
    return Named(one, *improvement(before, after, known.acts_on))


def causes_of(
    run: DiagnosedRun, measured: Measured, named: list[Named], limits: DiagnosisLimits
) -> list[Cause]:
    """Return the causes, each with the ATE before and after it is undone, in their order."""
    causes = []
    correction = measured.correction.only(one.name for one in named)
    before_m = run.ate_m(Correction(run.middle_ns))
    for k, one in enumerate(named):
        known, measurement = CAUSES[one.name], one.measurement
        after_m = run.ate_m(measured.correction.only(each.name for each in named[: k + 1]))
        side = known.side(measured.findings)
        causes.append(
            Cause(
                name=known.name,
                confidence=measurement.confidence,
                value=measurement.value,
                unit=known.unit,
                uncertainty=measurement.uncertainty,
                ate_before_m=before_m,
                ate_after_m=after_m,
                evidence=_evidence(one, known, measured.findings),
                advice=known.advised(correction, side, limits),
                flags=known.flags(correction, run.config),
                side=side,
            )
        )
        before_m = after_m
    return causes


def _evidence(one: Named, known: KnownCause, findings: Mapping[str, Any]) -> str:
    """Return what was measured, and the error that undoing it reduces."""
    found = known.evidence(one.measurement, findings)
    if not one.error:
        return found
    error, _, unit = one.error.rstrip(']').partition(' [')
    change = f'from {one.before:.3g} to {one.after:.3g} {unit}'
    return f'{found}; undoing it reduces the {error} {change}'
