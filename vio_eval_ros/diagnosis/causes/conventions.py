"""Poses that were written in one convention and read in another."""

from __future__ import annotations

from dataclasses import replace
import math

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.causes.cause import KnownCause, template
from vio_eval_ros.diagnosis.causes.measuring import Measuring
from vio_eval_ros.diagnosis.conventions import candidates, Convention, FoundConvention
from vio_eval_ros.diagnosis.correction import Correction, PosesInCorrection

ORDER = 10
MEANING = 'share of the residual that the right convention removes'


def undo(poses: PosesInCorrection, convention: Convention) -> PosesInCorrection:
    """Return the poses as they were meant."""
    meant = convention.undo(Trajectory(poses.stamps_ns, poses.positions, poses.rotations))
    return replace(poses, positions=meant.positions, rotations=meant.rotations)


def _order_flags(correction: Correction, config: EvaluationConfig) -> tuple[str, ...]:
    """Return the order of the components to state, with the inversion that goes with it."""
    convention = correction.value('quaternion_order')
    order = 'wxyz' if convention.quaternion[0] == 1 else 'xyzw'
    return (f'?quaternion={order}' + '&invert=rotation' * convention.conjugate,)


CAUSES = (
    KnownCause(
        name='quaternion_conjugated',
        unit='ratio',
        meaning=MEANING,
        measured='relative rotations agree once conjugated, with the smallest rotation of the '
        'sensor and the smallest angle between the worlds of positions and orientations',
        remedy='`?invert=rotation`',
        evidence=template('relative rotations agree when conjugated, and do not as they are'),
        advice='Publish the rotation from body to world, not its inverse (JPL quaternions are '
        'conjugates of Hamilton ones).',
        undo=undo,
        undo_order=ORDER,
        flags=lambda correction, config: ('?invert=rotation',),
        may_raise_ate=True,
        comes_first=True,
    ),
    KnownCause(
        name='quaternion_order',
        unit='ratio',
        meaning=MEANING,
        measured='likewise with w in another place',
        remedy='`?quaternion=wxyz` or `xyzw`',
        evidence=template(
            'relative rotations agree with w in another place, and do not as they are'
        ),
        advice='Write and read quaternions in the same order; ROS and TUM files have x y z w, '
        'EuRoC files w x y z.',
        undo=undo,
        undo_order=ORDER,
        flags=_order_flags,
        may_raise_ate=True,
        comes_first=True,
        detail=lambda correction: correction.value('quaternion_order').detail,
    ),
    KnownCause(
        name='pose_inverted',
        unit='ratio',
        meaning=MEANING,
        measured='likewise with whole poses inverted',
        remedy='`?invert=pose`',
        evidence=template('relative motions agree when inverted, and do not as they are'),
        advice='Publish the pose of the body in the world, not of the world in the body '
        '(world-from-camera, not camera-from-world).',
        undo=undo,
        undo_order=ORDER,
        flags=lambda correction, config: ('?invert=pose',),
        may_raise_ate=True,
        comes_first=True,
    ),
    KnownCause(
        name='axes_swapped',
        unit='ratio',
        meaning=MEANING,
        measured='likewise with axes of positions, rotations or both swapped or mirrored',
        remedy='one proper rotation of whole poses',
        evidence=template(
            'positions and orientations agree with other axes, and do not as they are'
        ),
        advice='Convert whole poses between axis conventions, positions and rotations, with one '
        'proper rotation.',
        undo=undo,
        undo_order=ORDER,
        may_raise_ate=True,
        comes_first=True,
        detail=lambda correction: correction.value('axes_swapped').detail,
    ),
)
BY_NAME = {cause.name: cause for cause in CAUSES}


def improvement(found: FoundConvention) -> float:
    """Return how much worse the poses agree as they were read: 0 as well, 1 not at all."""
    return 1 - found.residual / found.residual_as_is


def measure(run: Measuring) -> None:
    """Note the convention that was found, or that none can be observed."""
    found = run.convention
    if found.convention.name:
        cause = BY_NAME[found.convention.name]
        # it was undone for all fits, even where it turns out no better than what was read
        run.correction = cause.undone(run.correction, found.convention)
        run.note(cause, run.counted(cause, improvement(found)), found.convention)
    elif not found.observable:
        for name in dict.fromkeys(one.name for one in candidates() if one.name):
            cause = BY_NAME[name]
            run.note(cause, run.counted(cause, math.nan).as_unobservable())
