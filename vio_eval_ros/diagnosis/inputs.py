"""Whether the two inputs are what they are said to be."""

from __future__ import annotations

import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.run import Run

STILL_M, STILL_RAD = 0.05, math.radians(5.0)
STATIC_SHARE = 0.5
MOVES_M = 0.2
AT_ORIGIN = 0.02
RATE_RATIO = 3.0
# an interpolated truth: how much of it is straight, and how much more it bends in between
MOSTLY, BENT_TIMES = 0.45, 10.0
FEWEST_KNOTS, REGULAR = 10, 0.8
# to which stamps are exact in most files
STAMP_S = 1e-6


def stands_still(poses: Trajectory, metres: float = STILL_M) -> bool:
    """Return whether a trajectory moves no further than this, and turns hardly."""
    extent = _extent(poses)
    turned = 0.0
    if poses.rotations is not None:
        turned = float(rotation.angle_between(poses.rotations, poses.rotations[0]).max())
    return extent < metres and turned < STILL_RAD


def truth_is_static(run: Run) -> bool:
    """Return whether most of the truth repeats the pose before, while the estimate moves on."""
    repeats = ~np.diff(run.truth.positions, axis=0).any(axis=1)
    intervals = np.diff(run.truth.stamps_ns)
    # a truth that is published faster than it is measured repeats itself, but not for long
    stands = intervals[repeats].sum() > STATIC_SHARE * intervals.sum()
    if not stands or _extent(run.estimate) < MOVES_M:
        return False
    changes = np.flatnonzero(~repeats)
    runs = np.diff(
        np.concatenate([[0], run.truth.stamps_ns[changes + 1] - run.truth.stamps_ns[0]])
    )
    longest_ns = max(
        int(runs.max(initial=0)),
        int(run.truth.stamps_ns[-1] - run.truth.stamps_ns[changes[-1] if len(changes) else 0]),
    )
    return longest_ns > STATIC_SHARE * float(intervals.sum())


def interpolated_over_s(truth: Trajectory) -> float | None:
    """
    Return the time between the poses that a truth was interpolated from, if it was.

    Between those its positions lie on straight lines, as exactly as they are written, and it
    bends only there, again and again after the same time. What flies bends all the time.
    """
    stamps_ns, points = truth.stamps_ns, truth.positions
    seconds = (stamps_ns - stamps_ns[0]) / 1e9
    chord = points[2:] - points[:-2]
    weight = (seconds[1:-1] - seconds[:-2]) / (seconds[2:] - seconds[:-2])
    bend = lengths(points[:-2] + weight[:, None] * chord - points[1:-1])
    speed = lengths(chord) / (seconds[2:] - seconds[:-2])
    rounding = 2 * _resolution(points) + 2 * STAMP_S * speed
    moving = lengths(chord) > BENT_TIMES * rounding
    bent = moving & (bend > rounding)
    straight = moving & ~bent
    if not bent.any() or straight.sum() < MOSTLY * moving.sum():
        return None
    # a pose that lies between two samples bends both
    begin = bent & ~np.concatenate([[False], bent[:-1]])
    # only where it moved from one to the next
    knots = np.flatnonzero(begin)
    still = np.concatenate([[0], np.cumsum(~moving)])
    apart = np.diff(knots)[still[knots[1:]] == still[knots[:-1]]]
    if len(apart) < FEWEST_KNOTS or np.median(bend[bent]) < BENT_TIMES * np.median(rounding[bent]):
        return None
    usual = float(np.median(apart))
    regular = np.abs(apart - usual) <= 1
    if regular.mean() < REGULAR:
        return None
    return usual * float(np.median(np.diff(seconds)))


def _resolution(points: np.ndarray) -> float:
    """Return the step in which coordinates are written."""
    steps = [np.diff(np.unique(column)) for column in points.T]
    return max((float(step.min()) for step in steps if len(step)), default=0.0)


def inputs_look_swapped(run: Run) -> bool:
    """
    Return whether the truth looks like an estimate and the estimate like a truth.

    An odometry begins at the origin of its own world, and has the rate of a camera; a motion
    capture has neither.
    """
    extents = [_extent(side) for side in (run.estimate, run.truth)]
    starts = [float(np.linalg.norm(side.positions[0])) for side in (run.estimate, run.truth)]
    intervals = [float(np.median(np.diff(side.stamps_ns))) for side in (run.estimate, run.truth)]
    return (
        starts[1] < AT_ORIGIN * extents[1]
        and starts[0] > 10 * AT_ORIGIN * extents[0]
        and intervals[1] > RATE_RATIO * intervals[0]
    )


def _extent(poses: Trajectory) -> float:
    return float(lengths(poses.positions - np.median(poses.positions, axis=0)).max())
