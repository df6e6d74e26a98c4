"""Sources as one publisher would have sent them; refused where several take turns."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.interleaving import copies, interleaving
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.orientations import finite
from vio_eval_ros.core.statistics import median
from vio_eval_ros.core.steps import step_lengths
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.sources import Source

#: of one and the same pose between others, and of steps that show what is usual
FEWEST_PLACEHOLDERS, FEWEST_STEPS = 2, 20
#: a step that is as long, and so many times the usual one, is a leap; of so many the first
LEAP_M, LEAP_STEPS, MOST_LEAPS = 0.05, 10.0, 10_000
#: of which so many places are looked at, the most frequent ones
MOST_PLACES = 20


def of_one_publisher(
    estimate: Source, truth: Source, config: EvaluationConfig
) -> tuple[Source, Source]:
    """
    Return both sides as one publisher would have sent them: without poses that came twice.

    :raises ReadError: in the time that is evaluated, the poses of two or three trajectories take
        turns.
    """
    true_ns = truth.poses.stamps_ns
    if truth.poses.zero_is_unset:
        true_ns = true_ns[true_ns != 0]
    begin_ns = int(true_ns.min()) if len(true_ns) else 0
    whole = []
    for source, offset_s in ((estimate, config.time_offset_s), (truth, 0.0)):
        poses = _within(source.poses, begin_ns - nanoseconds(offset_s), config)
        whole.append(_once(_of_one(source, poses)))
    return whole[0], whole[1]


def _of_one(source: Source, poses: Poses) -> Source:
    """Return a source whose poses do not take turns, with a sentence on those that are none."""
    found, lost = interleaving(poses), placeholder(poses)
    if found is None:
        if lost is None:
            return source
        note = f'{source.spec}: {lost}: placeholders for lost poses? They are scored as they are'
        return replace(source, warnings=(note, *source.warnings))
    if lost is not None:
        others = np.setdiff1d(np.arange(len(poses)), lost.rows)
        if interleaving(poses[others]) is None:
            raise ReadError(
                source.spec,
                f'{lost}: placeholders for lost poses? Leave these out: where there is no pose, '
                'write none',
            )
    raise ReadError(
        source.spec,
        f'{found}; name a topic that only one of them publishes, or record each on a topic of its '
        'own; --start-s and --end-s choose a time without them',
    )


@dataclass(frozen=True, eq=False)
class Placeholder:
    """
    One and the same pose, written wherever there is none.

    :param rows: (N,) of the poses that are it.
    :param first_ns: the stamp of the first.
    """

    pose: str
    rows: np.ndarray
    first_ns: int

    def __str__(self) -> str:
        """Return what it is, in words."""
        return (
            f'{len(self.rows)} poses are {self.pose}, the first at {self.first_ns / 1e9:.2f} s, '
            'and the others are elsewhere'
        )


def placeholder(poses: Poses) -> Placeholder | None:
    """Return the pose that the stream leaps to, and from which it leaps back; None without one."""
    rows = np.flatnonzero(finite(poses.positions))
    rows = rows[np.argsort(poses.stamps_ns[rows], kind='stable')]
    positions = poses.positions[rows]
    steps = step_lengths(positions)
    moving = steps[steps > 0]
    if len(moving) < FEWEST_STEPS:
        return None
    leaps = np.flatnonzero(steps > max(LEAP_M, LEAP_STEPS * median(moving)))
    if not len(leaps):  # nearly always
        return None
    # where one leap ends and another begins
    ends, begins = positions[leaps[:MOST_LEAPS] + 1], positions[leaps[:MOST_LEAPS]]
    places, counts = np.unique(np.concatenate([ends, begins]), axis=0, return_counts=True)
    for place in places[np.argsort(-counts, kind='stable')[:MOST_PLACES]]:
        there = (positions == place).all(axis=1)
        entered = there[0] or (there[1:] & ~there[:-1])[leaps].any()
        left = there[-1] or (there[:-1] & ~there[1:])[leaps].any()
        often = FEWEST_PLACEHOLDERS <= np.count_nonzero(there) <= len(there) // 2
        found = rows[there]
        turns = poses.rotations is not None and np.ptp(poses.rotations[found], axis=0).any()
        if often and entered and left and not turns:
            values = [place, *([] if poses.rotations is None else [poses.rotations[found[0]]])]
            shown = ' '.join(f'{value:g}' for value in np.concatenate(values))
            return Placeholder(shown, found, int(poses.stamps_ns[found[0]]))
    return None


def _once(source: Source) -> Source:
    """Return a source without the second of poses that were published twice."""
    again = copies(source.poses)
    if not again.any():
        return source
    warning = (
        f'{source.spec}: {np.count_nonzero(again)} of {len(again)} poses repeat the one before, '
        'at nearly the same stamp, as of two publishers; they are left out'
    )
    poses = source.poses[np.flatnonzero(~again)]
    return replace(source, poses=poses, warnings=(*source.warnings, warning))


def _within(poses: Poses, begin_ns: int, config: EvaluationConfig) -> Poses:
    """Return the poses in the time that is evaluated, relative to the first ground truth."""
    if not config.start_s and math.isinf(config.end_s):
        return poses
    elapsed_ns = poses.stamps_ns - begin_ns
    inside = elapsed_ns >= nanoseconds(config.start_s)
    if math.isfinite(config.end_s):
        inside &= elapsed_ns <= nanoseconds(config.end_s)
    return poses[np.flatnonzero(inside)]
