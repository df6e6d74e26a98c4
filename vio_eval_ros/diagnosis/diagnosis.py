"""
The diagnosis: an estimate and its ground truth in, causes out. Start reading here.

What depends least on other faults is measured first: clocks, conventions and the rotation of the
sensor from short relative rotations, then jumps and outliers from the positions, then the rest. A
parameter becomes a cause where it is beyond what healthy runs show and where undoing it, with
everything else undone, reduces some error by the share that the limits ask for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.limits import PROFILES
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.statistics import root_mean_square, without_nan
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.causes import CAUSES
from vio_eval_ros.diagnosis.causes.cause import KnownCause
from vio_eval_ros.diagnosis.causes.conventions import improvement as improvement_by_convention
from vio_eval_ros.diagnosis.causes.divergence import DIVERGED
from vio_eval_ros.diagnosis.causes.inputs import (
    INSUFFICIENT_MOTION,
    SWAPPED_INPUTS,
    TRUTH_STATIC,
)
from vio_eval_ros.diagnosis.causes.scale import SCALE
from vio_eval_ros.diagnosis.conventions import FoundConvention
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun, FEWEST_POSES, improvement
from vio_eval_ros.diagnosis.gyroscope import GyroscopeComparison
from vio_eval_ros.diagnosis.inputs import frozen, likely_swapped, stands_still, stays
from vio_eval_ros.diagnosis.limits import DEFAULT, DiagnosisLimits
from vio_eval_ros.diagnosis.measurement import Measurement
from vio_eval_ros.diagnosis.measurements import measure, Measured
from vio_eval_ros.diagnosis.warnings import warnings_of

SCHEMA = 'vio_eval_ros.diagnosis/1'
ATE = 'ATE [m]'
#: of the spread of the truth: an ATE beyond it does not go without a cause
UNEXPLAINED_ATE_RATIO = 0.5
#: that such an estimate has diverged
UNEXPLAINED_CONFIDENCE = 0.8


@dataclass(frozen=True)
class Cause:
    """
    One thing that is wrong.

    :param name: one of ``CAUSES``.
    :param confidence: 0 to 1, that its size is beyond what healthy runs show.
    :param value: its size: what the estimate is wrong by, not what corrects it.
    :param unit: of the value.
    :param uncertainty: half the width of the 95 % interval of the value; NaN where it has none.
    :param ate_before_m: the ATE with the causes before this one undone.
    :param ate_after_m: the ATE with this one undone as well.
    :param evidence: one sentence of numbers.
    :param advice: one sentence on what to do.
    :param flags: of ``replay``, that correct it; empty where only the estimator can. What begins
        with a question mark is appended to the spec of the side.
    :param side: ``estimate`` or ``ground_truth``, of which it is wrong.
    """

    name: str
    confidence: float
    value: float
    unit: str
    uncertainty: float
    ate_before_m: float
    ate_after_m: float
    evidence: str
    advice: str
    flags: tuple[str, ...] = ()
    side: str = 'estimate'


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """
    What is wrong with an estimate.

    :param causes: the one that explains most first; empty where nothing is unusual.
    :param cannot_tell: names of causes that this motion, or these data, cannot show.
    :param findings: everything measured, by name, also where it is healthy.
    :param corrected: the estimate with all causes undone, as far as that can be done afterwards.
    :param begin_ns: the first stamp of the estimate, as it was received.
    :param errors_before: errors of the estimate against interpolated truth, by name.
    :param errors_after: those of the corrected one.
    :param limits: what counted as healthy.
    :param profile: the platform that the limits are of.
    :param gyroscope: what a gyroscope says of the estimate, where one was given.
    """

    causes: tuple[Cause, ...]
    cannot_tell: tuple[str, ...]
    findings: dict[str, Any]
    corrected: Trajectory
    begin_ns: int
    errors_before: dict[str, float]
    errors_after: dict[str, float]
    limits: DiagnosisLimits = DEFAULT
    profile: str = PROFILES[0]
    gyroscope: GyroscopeComparison | None = None

    @property
    def warnings(self) -> list[str]:
        """What to know of these poses that is not a cause, as sentences."""
        return warnings_of(self.findings, self.gyroscope, self.limits)

    def errors(self) -> dict[str, dict[str, float | None]]:
        """Return each error before and after all causes are undone, by its name."""
        return {
            name: without_nan({'before': value, 'after': self.errors_after.get(name)})
            for name, value in self.errors_before.items()
        }

    def to_dict(self, errors: bool = False) -> dict[str, Any]:
        """
        Return all but the trajectory as plain numbers, strings and lists: what ``--json`` prints.

        :param errors: whether the findings have the errors before and after.
        """
        findings = without_nan(self.findings)
        if self.gyroscope is not None:
            findings['gyroscope'] = without_nan(vars(self.gyroscope))
        if errors:
            findings['errors'] = self.errors()
        return {
            'schema': SCHEMA,
            'profile': self.profile,
            'limits': self.limits.to_dict(),
            'causes': [without_nan(asdict(cause)) for cause in self.causes],
            'cannot_tell': list(self.cannot_tell),
            'warnings': self.warnings,
            'findings': findings,
        }


def diagnose(
    estimate: Trajectory,
    truth: Trajectory,
    config: EvaluationConfig,
    limits: DiagnosisLimits = DEFAULT,
) -> Diagnosis:
    """
    Return what is wrong with an estimate.

    :param config: options of the evaluation; its offset, frames and crop are applied first.
    :param limits: what counts as healthy.
    :raises NoPairs: where there are too few poses, or the two sides have no time in common.
    """
    diagnosis = diagnose_run(DiagnosedRun.received(estimate, truth, config), limits)
    return replace(diagnosis, begin_ns=int(estimate.stamps_ns[0]))


def diagnose_run(run: DiagnosedRun, limits: DiagnosisLimits = DEFAULT) -> Diagnosis:
    """Return what is wrong with a run, to which its options have been applied."""
    resting = _resting(run, limits)
    if resting is not None:
        return _without_motion(run, resting, limits)
    lost = frozen(run.estimate, run.truth, limits)
    if lost.any():  # what it repeats is not an estimate
        return diagnose_run(run.of(run.estimate[~lost], run.truth), limits)
    still = frozen(run.truth, run.estimate, limits)
    if still.any():
        return _where_truth_moves(run, ~still, limits)
    measured = measure(run, limits)
    if measured.convention.of_truth:
        return _with_corrected_truth(run, measured.convention, limits)
    return _of_measured(run, measured, limits)


def _of_measured(run: DiagnosedRun, measured: Measured, limits: DiagnosisLimits) -> Diagnosis:
    """Return the diagnosis of what was measured."""
    named = _named(run, measured, limits)
    correction = measured.correction.only(each.name for each in named)
    causes = _causes(run, measured, named, limits)
    swapped = likely_swapped(run)
    if swapped:
        causes.insert(0, _without_measurement(SWAPPED_INPUTS, run, limits, confidence=swapped))
    scale = measured.correction.value(SCALE.name, 1.0)
    if not causes and _is_unexplained(run, scale):
        causes = [_unexplained(run, limits)]
    return Diagnosis(
        causes=tuple(causes),
        cannot_tell=tuple(
            one.name for one in measured.measurements if not (one.observable or one.unusual)
        ),
        findings={
            one.name: {
                'value': one.value,
                'unit': one.unit,
                'uncertainty': one.uncertainty,
                'healthy': one.healthy,
            }
            for one in measured.measurements
        }
        | measured.findings,
        corrected=correction.apply(run.estimate),
        begin_ns=int(run.estimate.stamps_ns[0]),
        errors_before=run.errors(Correction(run.middle_ns)),
        errors_after=run.errors(correction),
        limits=limits,
    )


# -- inputs of which nothing can be measured -----------------------------------------------------


def _resting(run: DiagnosedRun, limits: DiagnosisLimits) -> KnownCause | None:
    """Return the cause that a side rests, if one does."""
    if stands_still(run.truth, limits.still_m, limits):
        # an estimate of what stands still may drift a little
        rests = stands_still(run.estimate, limits.moving_m, limits)
        return INSUFFICIENT_MOTION if rests else TRUTH_STATIC
    truth_stays, estimate_stays = (
        stays(side, limits.still_m) for side in (run.truth, run.estimate)
    )
    if truth_stays and not stays(run.estimate, limits.clearly_moving_m):  # within its noise
        return TRUTH_STATIC
    if estimate_stays and not stays(run.truth, limits.clearly_moving_m):
        return INSUFFICIENT_MOTION
    return None


def _without_motion(run: DiagnosedRun, known: KnownCause, limits: DiagnosisLimits) -> Diagnosis:
    """Return that a side rests, and that nothing else can be observed."""
    findings = {'truth_rests': stays(run.truth, limits.still_m)}
    cause = replace(
        _without_measurement(known, run, limits, findings=findings), ate_after_m=math.nan
    )
    resting = (TRUTH_STATIC.name, INSUFFICIENT_MOTION.name)
    errors = run.errors(Correction(run.middle_ns))
    return Diagnosis(
        causes=(cause,),
        cannot_tell=tuple(name for name in CAUSES if name not in resting),
        findings={},
        corrected=run.estimate,
        begin_ns=int(run.estimate.stamps_ns[0]),
        errors_before=errors,
        errors_after=errors,
        limits=limits,
    )


def _without_measurement(
    known: KnownCause,
    run: DiagnosedRun,
    limits: DiagnosisLimits,
    confidence: float = 1.0,
    findings: Mapping[str, Any] | None = None,
) -> Cause:
    """Return a cause that has no size."""
    nothing = Correction(run.middle_ns)
    ate_m = run.ate_m(nothing)
    return Cause(
        name=known.name,
        confidence=confidence,
        value=math.nan,
        unit='',
        uncertainty=math.nan,
        ate_before_m=ate_m,
        ate_after_m=ate_m,
        evidence=known.evidence(known.counted(math.nan, limits), findings or {}),
        advice=known.advised(nothing, 'estimate', limits),
    )


# -- faults of the truth: it is diagnosed again without them -------------------------------------


def _where_truth_moves(
    run: DiagnosedRun, moving: np.ndarray, limits: DiagnosisLimits
) -> Diagnosis:
    """Return the diagnosis without what the truth repeats, with the repetition as a cause."""
    share = TRUTH_STATIC.counted(1 - float(np.mean(moving)), limits)
    return _after(TRUTH_STATIC, share, run, run.of(run.estimate, run.truth[moving]), limits)


def _with_corrected_truth(
    run: DiagnosedRun, found: FoundConvention, limits: DiagnosisLimits
) -> Diagnosis:
    """Return the diagnosis against the truth as it was meant, with its convention as a cause."""
    known = CAUSES[found.convention.name]
    correction = known.undone(Correction(0), found.convention)
    meant = run.of(run.estimate, found.convention.undo(run.truth))
    return _after(
        known, known.counted(improvement_by_convention(found), limits), run, meant, limits,
        correction, side='ground_truth',
    )  # fmt: skip


def _after(
    known: KnownCause,
    measurement: Measurement,
    run: DiagnosedRun,
    rest: DiagnosedRun,
    limits: DiagnosisLimits,
    correction: Correction | None = None,
    side: str = 'estimate',
) -> Diagnosis:
    """Return the diagnosis of the rest of a run, after a cause that was taken out of it."""
    diagnosis = diagnose_run(rest, limits)
    nothing = Correction(run.middle_ns)
    correction = correction or nothing
    cause = Cause(
        name=known.name,
        confidence=1.0,
        value=measurement.value,
        unit=known.unit,
        uncertainty=math.nan,
        ate_before_m=run.ate_m(nothing),
        ate_after_m=rest.ate_m(nothing),
        evidence=known.evidence(measurement, {}),
        advice=known.advised(correction, side, limits),
        flags=known.flags(correction, run.config),
        side=side,
    )
    return replace(diagnosis, causes=(cause, *diagnosis.causes), errors_before=run.errors(nothing))


# -- measurements that are causes ----------------------------------------------------------------


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


def _named(run: DiagnosedRun, measured: Measured, limits: DiagnosisLimits) -> list[Named]:
    """
    Return the measurements that are causes.

    From all suspects the one is removed first without which the errors stay as they are, then the
    next: two that look alike, such as a lever arm and an offset on a straight path, do not clear
    each other.
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


def _causes(
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


# -- errors without a cause ----------------------------------------------------------------------


def _is_unexplained(run: DiagnosedRun, scale: float) -> bool:
    """Return whether an estimate of one point would be nearly as good."""
    nothing = Correction(run.middle_ns)
    pairs = run.pairs(nothing)
    if len(pairs) < FEWEST_POSES:
        return False
    path = pairs.ground_truth.positions
    spread_m = root_mean_square(lengths(path - path.mean(axis=0)))
    return run.errors(SCALE.undone(nothing, scale))[ATE] > UNEXPLAINED_ATE_RATIO * spread_m


def _unexplained(run: DiagnosedRun, limits: DiagnosisLimits) -> Cause:
    """Return that the estimate is of another path."""
    return replace(
        _without_measurement(DIVERGED, run, limits, confidence=UNEXPLAINED_CONFIDENCE),
        value=1.0,
        unit=DIVERGED.unit,
        evidence='nothing that could be undone makes its path like that of the ground truth, and '
        'its error is nearly as large as the extent of that path',
    )
