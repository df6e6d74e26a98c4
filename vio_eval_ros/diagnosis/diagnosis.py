"""
The diagnosis: an estimate and its ground truth in, causes out. Start reading here.

What depends least on other faults is measured first: clocks, conventions and the rotation of the
sensor from short relative rotations, then jumps and outliers from the positions, then the rest. A
parameter becomes a cause where it is beyond what healthy runs show and where undoing it, with
everything else undone, reduces some error by the share that the limits ask for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.statistics import root_mean_square
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.causes import CAUSES
from vio_eval_ros.diagnosis.causes.cause import KnownCause
from vio_eval_ros.diagnosis.causes.clocks import CLOCK_DRIFT
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
from vio_eval_ros.diagnosis.diagnosed_run import ATE, DiagnosedRun, FEWEST_POSES
from vio_eval_ros.diagnosis.divergence import blown_up_from
from vio_eval_ros.diagnosis.first_fit import first_fit, FirstFit, UNRELATED_RESIDUAL
from vio_eval_ros.diagnosis.inputs import frozen, likely_swapped, stands_still, stays
from vio_eval_ros.diagnosis.limits import DEFAULT, DiagnosisLimits
from vio_eval_ros.diagnosis.measurement import Measurement
from vio_eval_ros.diagnosis.measurements import measure, Measured
from vio_eval_ros.diagnosis.naming import causes_of, named_causes
from vio_eval_ros.diagnosis.pace import likely_pace
from vio_eval_ros.diagnosis.report import Cause, Diagnosis

#: of the spread of the truth: an ATE beyond it does not go without a cause
UNEXPLAINED_ATE_RATIO = 0.5
#: that such an estimate has diverged
UNEXPLAINED_CONFIDENCE = 0.8


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
    run = DiagnosedRun.received(estimate, truth, config)
    diagnosis = diagnose_run(run, limits)
    return replace(diagnosis, begin_ns=int(estimate.stamps_ns[0]), run=run)


def diagnose_run(run: DiagnosedRun, limits: DiagnosisLimits = DEFAULT) -> Diagnosis:
    """Return what is wrong with a run, to which its options have been applied."""
    resting = _resting(run, limits)
    if resting is not None:
        return _without_motion(run, resting, limits)
    first = blown_up_from(run.estimate.positions, run.truth.positions)
    if first is not None:
        return _before_it_blew_up(run, first, limits)
    lost = frozen(run.estimate, run.truth, limits)
    if lost.any():  # what it repeats is not an estimate
        return diagnose_run(run.of(run.estimate[~lost], run.truth), limits)
    still = frozen(run.truth, run.estimate, limits)
    if still.any():
        return _where_truth_moves(run, ~still, limits)
    fit = first_fit(run)
    if fit.others_s:
        return _undecided(run, fit, limits)
    if fit.residual > UNRELATED_RESIDUAL and not run.quick:
        paced = _at_the_pace_of_truth(run, fit, limits)
        if paced is not None:
            return paced
    measured = measure(run, fit, limits)
    if measured.convention.of_truth:
        return _with_corrected_truth(run, measured.convention, limits)
    return _of_measured(run, measured, limits)


def _of_measured(run: DiagnosedRun, measured: Measured, limits: DiagnosisLimits) -> Diagnosis:
    """Return the diagnosis of what was measured."""
    named = named_causes(run, measured, limits)
    correction = measured.correction.only(each.name for each in named)
    causes = causes_of(run, measured, named, limits)
    swapped = likely_swapped(run)
    if swapped:
        causes.insert(0, _without_measurement(SWAPPED_INPUTS, run, limits, confidence=swapped))
    scale = measured.correction.value(SCALE.name, 1.0)
    if not causes and _is_unexplained(run, scale, limits):
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
    return replace(
        _as_it_is(run, limits),
        causes=(cause,),
        cannot_tell=tuple(name for name in CAUSES if name not in resting),
    )


def _undecided(run: DiagnosedRun, fit: FirstFit, limits: DiagnosisLimits) -> Diagnosis:
    """Return that the motion repeats itself, so that several lags explain it equally well."""
    lags_s = sorted([float(fit.lag.offset_s), *fit.others_s], key=abs)
    inputs = (TRUTH_STATIC.name, INSUFFICIENT_MOTION.name, SWAPPED_INPUTS.name)
    return replace(
        _as_it_is(run, limits),
        cannot_tell=tuple(name for name in CAUSES if name not in inputs),
        findings={'equally_likely_offsets_s': lags_s},
    )


def _as_it_is(run: DiagnosedRun, limits: DiagnosisLimits) -> Diagnosis:
    """Return the diagnosis of a run of which nothing could be measured."""
    errors = run.errors(Correction(run.middle_ns))
    return Diagnosis(
        causes=(),
        cannot_tell=(),
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
    value: float = math.nan,
    findings: Mapping[str, Any] | None = None,
) -> Cause:
    """Return a cause that is counted, if it has a size."""
    nothing = Correction(run.middle_ns)
    ate_m = run.ate_m(nothing)
    return Cause(
        name=known.name,
        confidence=confidence,
        value=value,
        unit='' if math.isnan(value) else known.unit,
        uncertainty=math.nan,
        ate_before_m=ate_m,
        ate_after_m=ate_m,
        evidence=known.evidence(known.counted(value, limits), findings or {}),
        advice=known.advised(nothing, 'estimate', limits),
    )


def _before_it_blew_up(run: DiagnosedRun, first: int, limits: DiagnosisLimits) -> Diagnosis:
    """Return the diagnosis of the poses before a row, with the divergence of the others."""
    share = DIVERGED.counted(1 - first / len(run.estimate), limits)
    kept = run.truth[run.truth.stamps_ns <= run.estimate.stamps_ns[first]]
    if min(first, len(kept)) < FEWEST_POSES:
        return replace(
            _as_it_is(run, limits),
            causes=(_without_measurement(DIVERGED, run, limits, value=share.value),),
        )
    rest = run.of(run.estimate[:first], kept)
    diagnosis = _after(DIVERGED, share, run=run, rest=rest, limits=limits)
    blown_up, *others = diagnosis.causes
    others = [cause for cause in others if cause.name != DIVERGED.name]
    return replace(diagnosis, causes=(blown_up, *others))


# -- faults of the truth: it is diagnosed again without them -------------------------------------


def _where_truth_moves(
    run: DiagnosedRun, moving: np.ndarray, limits: DiagnosisLimits
) -> Diagnosis:
    """Return the diagnosis without what the truth repeats, with the repetition as a cause."""
    share = TRUTH_STATIC.counted(1 - float(np.mean(moving)), limits)
    rest = run.of(run.estimate, run.truth[moving])
    return _after(TRUTH_STATIC, share, run=run, rest=rest, limits=limits)


def _with_corrected_truth(
    run: DiagnosedRun, found: FoundConvention, limits: DiagnosisLimits
) -> Diagnosis:
    """Return the diagnosis against the truth as it was meant, with its convention as a cause."""
    known = CAUSES[found.convention.name]
    correction = known.undone(Correction(0), found.convention)
    meant = run.of(run.estimate, found.convention.undo(run.truth))
    return _after(
        known,
        known.counted(improvement_by_convention(found), limits),
        run=run,
        rest=meant,
        limits=limits,
        correction=correction,
        side='ground_truth',
    )


def _after(
    known: KnownCause,
    measurement: Measurement,
    *,
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
        uncertainty=measurement.uncertainty,
        ate_before_m=run.ate_m(nothing),
        ate_after_m=rest.ate_m(nothing),
        evidence=known.evidence(measurement, {}),
        advice=known.advised(correction, side, limits),
        flags=known.flags(correction, run.config),
        side=side,
    )
    return replace(diagnosis, causes=(cause, *diagnosis.causes), errors_before=run.errors(nothing))


def _at_the_pace_of_truth(
    run: DiagnosedRun, fit: FirstFit, limits: DiagnosisLimits
) -> Diagnosis | None:
    """Return the diagnosis at the pace of the truth, where the motions agree under it alone."""
    pace = likely_pace(run)
    if pace is None:
        return None
    paced = first_fit(run.of(pace.undo(run.estimate), run.truth))
    if paced.residual > min(fit.residual / 2, UNRELATED_RESIDUAL):
        return None
    pace = pace._replace(ratio=pace.ratio / (1 - paced.lag.drift))
    drift = CLOCK_DRIFT.measurement(
        1e6 * (1 - 1 / pace.ratio), 1e6 * paced.lag.drift_uncertainty, limits, run.half_s
    )
    rest = run.of(pace.undo(run.estimate), run.truth)
    return _after(CLOCK_DRIFT, drift, run=run, rest=rest, limits=limits)


# -- errors without a cause ----------------------------------------------------------------------


def _is_unexplained(run: DiagnosedRun, scale: float, limits: DiagnosisLimits) -> bool:
    """Return whether an estimate of one point would be nearly as good."""
    nothing = Correction(run.middle_ns)
    pairs = run.pairs(nothing)
    if len(pairs) < FEWEST_POSES:
        return False
    path = pairs.ground_truth.positions
    spread_m = root_mean_square(lengths(path - path.mean(axis=0)))
    ate_m = run.errors(SCALE.undone(nothing, scale)).get(ATE, math.nan)
    # of what turns on the spot, an estimate may drift a little
    least_m = limits.moving_m if stays(run.truth, limits.still_m) else 0.0
    return ate_m > max(UNEXPLAINED_ATE_RATIO * spread_m, least_m)


def _unexplained(run: DiagnosedRun, limits: DiagnosisLimits) -> Cause:
    """Return that the estimate is of another path."""
    return replace(
        _without_measurement(DIVERGED, run, limits, UNEXPLAINED_CONFIDENCE, 1.0),
        evidence='nothing that could be undone makes its path like that of the ground truth, and '
        'its error is nearly as large as the extent of that path',
    )
