"""
The diagnosis: an estimate and its ground truth in, causes out. Start reading here.

Everything is measured from what knows least of the other faults: clocks, conventions and the
turn of the sensor from short relative rotations, then jumps and outliers from the positions, then
what is left. A parameter becomes a cause where it is beyond what healthy runs show and where
undoing it, with everything else undone, makes some error at least 5 % smaller.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.alignment import SCALED_MODES
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.statistics import root_mean_square, without_nan
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.advice import advice, evidence, flags
from vio_eval_ros.diagnosis.conventions import Finding
from vio_eval_ros.diagnosis.correction import Correction
from vio_eval_ros.diagnosis.inputs import (
    frozen,
    likely_swapped,
    MOVES_M,
    stands_still,
    stays,
    SURELY_MOVES_M,
)
from vio_eval_ros.diagnosis.measurements import FRAMES, measure, Measured, Measurement, SURE
from vio_eval_ros.diagnosis.run import FEWEST_POSES, IMPROVEMENT, improvement, Run

SCHEMA = 'vio_eval_ros.diagnosis/1'
NAMES = (
    *('truth_static', 'insufficient_motion', 'swapped_inputs'),
    *('quaternion_conjugated', 'quaternion_order', 'pose_inverted', 'axes_swapped'),
    *('time_offset', 'clock_drift', 'scale', 'scale_drift', 'sensor_rotation', 'lever_arm'),
    *('gravity_tilt', 'yaw_drift', 'jump', 'outliers', 'lost_tracking', 'diverged'),
)
#: the errors that a cure must make smaller; of other causes, any of them. What turns the
#: alignment a little turns the absolute rotation error with it, in one direction or the other.
POSITIONS = r'ATE|RPE'
ACTS_ON = {
    'scale': 'ATE',
    'scale_drift': POSITIONS,
    'lever_arm': POSITIONS,
    'jump': f'ATE|{FRAMES}',
    'outliers': POSITIONS,
    'diverged': POSITIONS,
    'gravity_tilt': 'posyaw ATE',
}
#: what is seen as it is, whether or not other errors hide it in the ATE; of an offset, positions
#: that contradict it have been asked
CERTAIN = ('time_offset', 'jump', *NAMES[3:7])
#: of the spread of the truth, that an ATE must not reach without a cause
UNLIKE = 0.5
#: of the whole run: while one of these is wrong, nothing else can be trusted
FUNDAMENTAL = NAMES[:7]


@dataclass(frozen=True)
class Cause:
    """
    One thing that is wrong.

    :param name: one of ``NAMES``.
    :param confidence: 0 to 1, that its size is beyond what healthy runs show.
    :param value: its size: what the estimate is wrong by, not what corrects it.
    :param unit: of the value.
    :param uncertainty: half the width of the 95 % interval of the value; NaN where it has none.
    :param ate_before_m: the ATE with the causes before this one undone.
    :param ate_after_m: the ATE with this one undone as well.
    :param evidence: one sentence of numbers.
    :param advice: one sentence on what to do.
    :param flags: of ``replay``, that correct it; empty where only the estimator can. What begins
        with a question mark goes behind the spec of the side.
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
    flags: tuple[str, ...]
    side: str = 'estimate'


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """
    What is wrong with an estimate.

    :param causes: the one that explains most first; empty where nothing is unusual.
    :param cannot_tell: names of causes that this motion, or these data, cannot show.
    :param findings: everything measured, by name, also where it is healthy.
    :param corrected: the estimate with all causes undone, as far as that can be done afterwards.
    :param errors_before: errors of the estimate against interpolated truth, by name.
    :param errors_after: those of the corrected one.
    """

    causes: tuple[Cause, ...]
    cannot_tell: tuple[str, ...]
    findings: dict[str, Any]
    corrected: Trajectory
    errors_before: dict[str, float]
    errors_after: dict[str, float]

    def to_dict(self) -> dict[str, Any]:
        """Return all but the trajectory as plain numbers, strings and lists."""
        return {
            'schema': SCHEMA,
            'causes': [without_nan(asdict(cause)) for cause in self.causes],
            'cannot_tell': list(self.cannot_tell),
            'findings': without_nan(self.findings),
        }


def diagnose(estimate: Trajectory, truth: Trajectory, config: EvaluationConfig) -> Diagnosis:
    """
    Return what is wrong with an estimate.

    :param config: options of the evaluation; its offset, frames and crop are applied first.
    :raises NoPairs: where there are too few poses to tell anything.
    """
    return diagnose_run(Run.received(estimate, truth, config))


def diagnose_run(run: Run) -> Diagnosis:
    """Return what is wrong with a run, to which its options have been applied."""
    if stands_still(run.truth):
        # an estimate of what stands still may drift a little
        rests = stands_still(run.estimate, MOVES_M)
        return _without_motion(run, 'insufficient_motion' if rests else 'truth_static')
    if stays(run.truth) and not stays(run.estimate, SURELY_MOVES_M):  # within its noise
        return _without_motion(run, 'truth_static')
    if stays(run.estimate) and not stays(run.truth, SURELY_MOVES_M):
        return _without_motion(run, 'insufficient_motion')
    lost = frozen(run.estimate, run.truth)
    if lost.any():  # what it repeats is no estimate
        return diagnose_run(run.of(run.estimate[~lost], run.truth))
    still = frozen(run.truth, run.estimate)
    if still.any():
        return _where_truth_moves(run, ~still)
    measured = measure(run)
    if measured.convention.of_truth:
        return _with_truth_mended(run, measured.convention)
    named = _named(run, measured)
    findings = {
        one.name: {
            'value': one.value,
            'unit': one.unit,
            'uncertainty': one.uncertainty,
            'healthy': one.healthy,
        }
        for one in measured.parameters
    } | measured.findings
    causes = _causes(run, measured, named)
    swapped = likely_swapped(run)
    if swapped:
        causes.insert(0, _swapped(run, swapped))
    correction = measured.correction.only([one.name for one in named])
    if not causes and _is_unlike(run, measured.correction.scale):
        causes = [_unlike(run)]
    return Diagnosis(
        tuple(causes),
        tuple(one.name for one in measured.parameters if not (one.told or one.unusual)),
        findings,
        correction.apply(run.estimate),
        run.errors(Correction(run.middle_ns)),
        run.errors(correction),
    )


def _where_truth_moves(run: Run, moving: np.ndarray) -> Diagnosis:
    """Return the diagnosis without what the truth repeats, with the repetition as a cause."""
    rest = run.of(run.estimate, run.truth[moving])
    diagnosis = diagnose_run(rest)
    nothing = Correction(run.middle_ns)
    share = 1 - float(np.mean(moving))
    cause = Cause(
        'truth_static',
        1.0,
        share,
        'ratio',
        math.nan,
        run.ate_m(nothing),
        rest.ate_m(nothing),
        f'it moves on, while the ground truth repeats one position, for {100 * share:.0f} % of it',
        advice('truth_static'),
        (),
    )
    return replace(diagnosis, causes=(cause, *diagnosis.causes), errors_before=run.errors(nothing))


def _is_unlike(run: Run, scale: float) -> bool:
    """Return whether an estimate of one point would be nearly as good."""
    pairs = run.pairs(Correction(run.middle_ns))
    if len(pairs) < FEWEST_POSES:
        return False
    path = pairs.ground_truth.positions
    spread_m = root_mean_square(lengths(path - path.mean(axis=0)))
    scaled = Correction(run.middle_ns, scale=scale)
    return run.errors(scaled)['ATE [m]'] > UNLIKE * spread_m


def _unlike(run: Run) -> Cause:
    ate_m = run.ate_m(Correction(run.middle_ns))
    return Cause(
        'diverged',
        SURE,
        1.0,
        'ratio',
        math.nan,
        ate_m,
        ate_m,
        'nothing that could be undone makes its path like that of the ground truth, and its error '
        'is nearly as large as that path is wide',
        advice('diverged'),
        (),
    )


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
        """How much of the error it explains; of tracking, how much was lost."""
        return 1 - self.after / self.before if self.error else self.measurement.value


def _with_truth_mended(run: Run, found: Finding) -> Diagnosis:
    """Return the diagnosis against the truth as it was meant, with its convention as a cause."""
    meant = run.of(run.estimate, found.convention.undo(run.truth))
    diagnosis = diagnose_run(meant)
    nothing = Correction(run.middle_ns)
    cause = Cause(
        found.convention.name,
        1.0,
        1 - found.misfit / found.misfit_as_is,
        'ratio',
        math.nan,
        run.ate_m(nothing),
        meant.ate_m(nothing),
        evidence(found.convention.name, 0.0, 0.0),
        advice(found.convention.name, found.convention.detail),
        flags(found.convention.name, Correction(0, found.convention), run.config),
        'ground_truth',
    )
    return replace(
        diagnosis,
        causes=(cause, *diagnosis.causes),
        errors_before=run.errors(nothing),
    )


def _named(run: Run, measured: Measured) -> list[Named]:
    """
    Return the parameters that are causes.

    From all suspects that one is cleared first without which the errors stay as they are, then
    the next: two that look alike, such as a lever arm and an offset on a straight way, do not
    clear each other.
    """
    unusual = [one for one in measured.parameters if one.unusual]
    lost = [one for one in unusual if one.name == 'lost_tracking']
    scaled = ['scale'] if run.config.alignment in SCALED_MODES else []
    suspects = [one for one in unusual if one not in lost and one.name not in scaled]
    named: list[Named] = []
    while suspects:
        correction = measured.correction.only([one.name for one in suspects])
        after = run.errors(correction)
        named = [
            Named(one, *_undone(one, run.errors(correction.without(one.name)), after))
            for one in suspects
        ]
        least = min(named, key=lambda one: one.share)
        if least.share >= IMPROVEMENT:
            break
        named.remove(least)
        suspects.remove(least.measurement)
    named += [Named(one) for one in lost]
    return sorted(named, key=lambda one: (one.name not in FUNDAMENTAL, -one.share))


def _undone(
    one: Measurement, before: dict[str, float], after: dict[str, float]
) -> tuple[str, float, float]:
    """
    Return the error that undoing a cause improves most.

    Where there is any doubt, no cure makes the ATE larger: drift can hide in a fault by chance.
    """
    ate, certain = 'ATE [m]', one.name in CERTAIN or one.beyond_doubt
    if not certain and after.get(ate, 0.0) > (1 + IMPROVEMENT) * before.get(ate, math.inf):
        return ate, before[ate], after[ate]
    return improvement(before, after, ACTS_ON.get(one.name, ''))


def _causes(run: Run, measured: Measured, named: list[Named]) -> list[Cause]:
    causes = []
    correction = measured.correction.only([one.name for one in named])
    before_m = run.ate_m(Correction(run.middle_ns))
    for k, one in enumerate(named):
        parameter = one.measurement
        after_m = run.ate_m(measured.correction.only([each.name for each in named[: k + 1]]))
        causes.append(
            Cause(
                parameter.name,
                parameter.confidence,
                parameter.value,
                parameter.unit,
                parameter.uncertainty,
                before_m,
                after_m,
                _evidence(one, measured),
                _advice(one.name, measured),
                flags(parameter.name, correction, run.config),
                _side(one.name, measured),
            )
        )
        before_m = after_m
    return causes


def _advice(name: str, measured: Measured) -> str:
    """Return what to do about a cause of this run."""
    if _side(name, measured) != 'estimate':
        return advice('ground_truth')
    return advice(name, measured.convention.convention.detail if name in FUNDAMENTAL else '')


def _side(name: str, measured: Measured) -> str:
    """Return which side a cause is of."""
    if name == 'outliers':
        return str(measured.findings['outlier_poses']['side'])
    if name == 'jump':
        return str(max(_harmful_jumps(measured), key=lambda jump: jump['size_m'])['side'])
    return 'estimate'


def _harmful_jumps(measured: Measured) -> list[dict[str, Any]]:
    return [jump for jump in measured.findings['jumps'] if jump['harmful']]


def _evidence(one: Named, measured: Measured) -> str:
    """Return the sentence of numbers that speaks for a cause."""
    found = evidence(one.name, one.measurement.value, one.measurement.uncertainty)
    if one.name == 'jump':
        turn_deg = max(jump['turn_deg'] for jump in _harmful_jumps(measured))
        turned = f'turned by up to {turn_deg:.1f} deg'
        if not one.measurement.value:
            found = f'it is {turned} between two poses and stays so'
        elif turn_deg:
            found += f', {turned}'
    if one.name == 'yaw_drift':
        found += f', {measured.findings["yaw_drift_deg_per_m"]:.2g} deg a metre'
    if one.error:
        error, _, unit = one.error.rstrip(']').partition(' [')
        change = f'from {one.before:.3g} to {one.after:.3g} {unit}'
        return f'{found}; undoing it takes the {error} {change}'
    gaps = measured.findings['gaps']
    longest = max((gap['seconds'] for gap in gaps), default=0.0)
    if not longest:
        return f'{found}, some poses at a time'
    return f'{found}, the longest interval is {longest:.1f} s'


def _swapped(run: Run, confidence: float) -> Cause:
    ate_m = run.ate_m(Correction(run.middle_ns))
    return Cause(
        'swapped_inputs',
        confidence,
        math.nan,
        '',
        math.nan,
        ate_m,
        ate_m,
        'it begins away from its origin, while the ground truth begins there and has the lower '
        'rate or the heading of its x axis, as an estimate does',
        advice('swapped_inputs'),
        (),
    )


def _without_motion(run: Run, name: str) -> Diagnosis:
    ate_m = run.ate_m(Correction(run.middle_ns))
    also = 'nor does the ground truth' if stays(run.truth) else 'though the ground truth does'
    evidence = {
        'truth_static': 'it moves, while the ground truth stays where it is',
        'insufficient_motion': f'it does not move, {also}',
    }[name]
    cause = Cause(name, 1.0, math.nan, '', math.nan, ate_m, math.nan, evidence, advice(name), ())
    others = tuple(other for other in NAMES if other not in FUNDAMENTAL[:2])
    errors = run.errors(Correction(run.middle_ns))
    return Diagnosis((cause,), others, {}, run.estimate, errors, errors)
