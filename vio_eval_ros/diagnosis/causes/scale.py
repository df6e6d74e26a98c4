"""The estimate is too large or too small, everywhere or more and more."""

from __future__ import annotations

from dataclasses import replace
import math
from typing import NamedTuple

from vio_eval_ros.core.alignment import SCALED_MODES
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.statistics import root_mean_square
from vio_eval_ros.core.steps import path_of_changed_steps
from vio_eval_ros.diagnosis.causes.cause import KnownCause, POSITION_ERRORS, template
from vio_eval_ros.diagnosis.causes.measuring import Measuring
from vio_eval_ros.diagnosis.correction import Correction, PosesInCorrection
from vio_eval_ros.diagnosis.geometry import fit_scale
from vio_eval_ros.diagnosis.measurement import Measurement
from vio_eval_ros.recordings.spec import LENGTH_UNITS

PERCENT_PER_MINUTE = 100 * 60
#: of a point that may be tracked in place of the body
LONGEST_LEVER_M = 2.0
#: how near, as a share, the scale that a unit makes is
UNIT_TOLERANCE = 0.1
UNIT_NAMES = {'mm': 'millimetres', 'cm': 'centimetres'}
SIDES_IN_WORDS = {'estimate': 'the estimate', 'ground_truth': 'the ground truth'}


def _undo_scale(poses: PosesInCorrection, scale: float) -> PosesInCorrection:
    """Return the poses in metres of the truth."""
    return replace(poses, positions=poses.positions / scale)


def _undo_drift(poses: PosesInCorrection, per_s: float) -> PosesInCorrection:
    """Return the poses with one scale, given by how much more of itself it grows per second."""
    if not per_s:
        return poses
    factors = 1 / (1 + per_s * poses.elapsed_s)
    return replace(poses, positions=path_of_changed_steps(poses.positions, factors))


class UnitMistaken(NamedTuple):
    """A unit of positions that was taken for metres, and the side that is in it."""

    name: str
    side: str


def unit_mistaken(scale: float) -> UnitMistaken | None:
    """Return the unit that a scale comes from, if it does."""
    for unit, metres in LENGTH_UNITS.items():
        for side, expected in (('estimate', 1 / metres), ('ground_truth', metres)):
            # kilometres on one side are told from millimetres on the other by what is usual
            if metres < 1 and abs(math.log(scale / expected)) < UNIT_TOLERANCE:
                return UnitMistaken(unit, side)
    return None


def _unit_of(correction: Correction) -> UnitMistaken | None:
    return unit_mistaken(correction.value('scale', 1.0))


def _scale_flags(correction: Correction, config: EvaluationConfig) -> tuple[str, ...]:
    """Return the unit to state, or the alignment that removes the scale."""
    mistaken = _unit_of(correction)
    return ('--alignment', 'sim3') if mistaken is None else (f'?unit={mistaken.name}',)


def _unit_advice(correction: Correction) -> str:
    """Return which unit to state, where it is one."""
    mistaken = _unit_of(correction)
    if mistaken is None:
        return ''
    return (
        f'The positions of {SIDES_IN_WORDS[mistaken.side]} are in {UNIT_NAMES[mistaken.name]}: '
        f'state ?unit={mistaken.name} after its name.'
    )


SCALE = KnownCause(
    name='scale',
    unit='ratio',
    meaning='estimated over true length',
    measured='the slope of the estimated positions over the true ones, rotated as the best '
    'similarity does',
    remedy='`--alignment sim3`',
    evidence=template('it is {v:.4f} ± {u:.4f} times as large as the ground truth'),
    advice='Check baseline and IMU calibration, or that a monocular system was initialised with '
    'metric scale; sim3 shows what is left without it.',
    advice_without_imu='Check the stereo baseline or the scale of the depth; a monocular camera '
    'has no metric scale. sim3 shows what is left without it.',
    limits=('scale_percent',),
    healthy=lambda limits, half_s: math.log(1 + limits.scale_percent / 100),
    undo=_undo_scale,
    undo_order=50,
    flags=_scale_flags,
    special=_unit_advice,
    side=lambda findings: str(findings['scale_of_side']),
    acts_on='ATE',
    removed_by=tuple(SCALED_MODES),
)
SCALE_DRIFT = KnownCause(
    name='scale_drift',
    unit='%/min',
    meaning='per minute',
    measured='a scale that grows evenly, in the fit of the lever arm',
    remedy='the estimator',
    evidence=template('its scale changes by {v:.1f} ± {u:.1f} % per minute'),
    advice='Give the estimator something metric all the time: accelerometer excitation, stereo '
    'overlap at the depth seen; check the accelerometer bias.',
    advice_without_imu='Give the estimator something metric all the time: depth in range, stereo '
    'overlap at the depth seen, loop closures.',
    limits=('scale_drift_percent', 'positions_late_s'),
    healthy=lambda limits, half_s: 60 * limits.scale_drift_percent / half_s,
    undo=_undo_drift,
    undo_order=60,
    acts_on=POSITION_ERRORS,
)
CAUSES = (SCALE, SCALE_DRIFT)


def measure(run: Measuring) -> None:
    """Note the drift of the scale, and the scale of what is left."""
    drift = run.measured(
        SCALE_DRIFT,
        PERCENT_PER_MINUTE * run.body.scale_drift.value,
        PERCENT_PER_MINUTE * run.body.scale_drift.uncertainty,
    )
    if run.findings['positions_late_s'] is not None:
        drift = drift.as_unobservable()
    run.note(SCALE_DRIFT, drift, drift.value / PERCENT_PER_MINUTE)
    scale = _scale(run)
    run.note(SCALE, scale, scale.value)
    mistaken = unit_mistaken(scale.value)
    run.findings['scale_of_side'] = 'estimate' if mistaken is None else mistaken.side


def _scale(run: Measuring) -> Measurement:
    """Return the scale; its size is its logarithm, so that half is as far off as double."""
    scale = fit_scale(run.pairs())
    measured = run.measured(SCALE, scale.value, scale.uncertainty)
    if _may_be_a_lever_arm(run, scale.value):
        return measured.as_unobservable()
    known = scale.uncertainty < scale.value
    return replace(
        measured,
        size=abs(math.log(scale.value)),
        size_uncertainty=-math.log1p(-scale.uncertainty / scale.value) if known else math.inf,
    )


def _may_be_a_lever_arm(run: Measuring, scale: float) -> bool:
    """
    Return whether a point beside the body moves as if the scale were another.

    On a circle it does, where the body turns with its path: a larger radius is a larger scale.
    """
    unusual = abs(scale - 1) > run.limits.scale_percent / 100
    if not (unusual and run.body.lever_for_scale):
        return False
    path = run.pairs().ground_truth.positions
    radius_m = root_mean_square(lengths(path - path.mean(axis=0)))
    return abs(scale - 1) * radius_m < LONGEST_LEVER_M
