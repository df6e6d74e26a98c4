"""Whether the two inputs are what they are said to be."""

from __future__ import annotations

import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.fitting import horizon
from vio_eval_ros.diagnosis.run import Run

STILL_M, STILL_RAD = 0.05, math.radians(5.0)
MOVES_M, SURELY_MOVES_M = 0.2, 1.0
# for how long a position is repeated where it is not measured any more
FROZEN_S, FROZEN_SHARE, FROZEN_LEAST_S = 5.0, 0.05, 1.0
AS_USUAL = 0.3
FEWEST_MEDIAN = 10
AT_ORIGIN = 0.02
RATE_RATIO = 3.0
HEADING_RAD = math.radians(2.0)
# an interpolated truth: how much of it is straight, and how much more it bends in between
MOSTLY, BENT_TIMES = 0.45, 10.0
FEWEST_KNOTS, REGULAR = 10, 0.8
# to which stamps are exact in most files
STAMP_S = 1e-6


def stands_still(poses: Trajectory, metres: float = STILL_M) -> bool:
    """Return whether a trajectory moves no further than this, and turns hardly."""
    turned = 0.0
    if poses.rotations is not None:
        turned = float(rotation.angle_between(poses.rotations, poses.rotations[0]).max())
    return stays(poses, metres) and turned < STILL_RAD


def stays(poses: Trajectory, metres: float = STILL_M) -> bool:
    """Return whether a trajectory moves no further than this, however it turns."""
    return _extent(poses) < metres


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


def likely_swapped(run: Run) -> float:
    """
    Return how likely it is that the truth is an estimate and the estimate a truth.

    An odometry begins at the origin of its own world and heads along its x axis, and has the rate
    of a camera; a motion capture has neither.
    """
    extents = [_extent(side) for side in (run.estimate, run.truth)]
    starts = [float(np.linalg.norm(side.positions[0])) for side in (run.estimate, run.truth)]
    intervals = [float(np.median(np.diff(side.stamps_ns))) for side in (run.estimate, run.truth)]
    begins = (
        starts[1] < AT_ORIGIN * extents[1] and starts[0] > 10 * AT_ORIGIN * extents[0]
    )  # fmt: skip
    if begins and intervals[1] > RATE_RATIO * intervals[0]:
        return 0.7
    headed = _heads_along_x(run.truth) and not _heads_along_x(run.estimate)
    return 0.6 if begins and headed and intervals[0] < RATE_RATIO * intervals[1] else 0.0


def _heads_along_x(poses: Trajectory) -> bool:
    """Return whether the first pose has the heading of the world, as far as it has one."""
    if poses.rotations is None:
        return False
    x, y, _ = rotation.rotate(poses.rotations[0], np.array([1.0, 0.0, 0.0]))
    return abs(math.atan2(y, x)) < HEADING_RAD


def _extent(poses: Trajectory) -> float:
    """Return how far the median positions of seconds are from that of all: not what noise does."""
    interval_s = float(np.median(np.diff(poses.stamps_ns))) / 1e9
    rows = int(np.clip(1 / interval_s, FEWEST_MEDIAN, len(poses) // 4))
    whole = poses.positions[: len(poses) // rows * rows].reshape(-1, rows, 3)
    seconds = np.median(whole, axis=1)
    return float(lengths(seconds - np.median(seconds, axis=0)).max())


def frozen(poses: Trajectory, other: Trajectory) -> np.ndarray:
    """
    Return which rows repeat one position for long, while the other side moves on.

    A side that is published faster than it is measured repeats itself as well, but not for long.
    """
    changes = np.flatnonzero(np.diff(poses.positions, axis=0).any(axis=1)) + 1
    edges = np.concatenate([[0], changes, [len(poses)]])
    begin_ns, end_ns = poses.stamps_ns[edges[:-1]], poses.stamps_ns[edges[1:] - 1]
    lasts_ns = end_ns - begin_ns
    longest_ns = min(FROZEN_S * 1e9, FROZEN_SHARE * float(np.ptp(poses.stamps_ns)))
    rows = np.zeros(len(poses), bool)
    for k in np.flatnonzero(lasts_ns > max(longest_ns, FROZEN_LEAST_S * 1e9)).tolist():
        if _moves_as_usual(other, int(begin_ns[k]), int(end_ns[k])):
            rows[edges[k] + 1 : edges[k + 1]] = True
    return rows


def _moves_as_usual(poses: Trajectory, begin_ns: int, end_ns: int) -> bool:
    """Return whether a side goes on from one stamp to the other, not much slower than usual."""
    begin, end = horizon(poses.stamps_ns, 1.0)
    speeds = lengths(poses.positions[end] - poses.positions[begin])
    within = (poses.stamps_ns[begin] >= begin_ns) & (poses.stamps_ns[end] <= end_ns)
    if not within.any() or within.all():
        return False
    usual = float(np.median(speeds[~within]))
    return float(np.median(speeds[within])) > max(AS_USUAL * usual, MOVES_M / 2)
