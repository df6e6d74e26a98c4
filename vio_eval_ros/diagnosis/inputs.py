"""Whether the two inputs are what they are said to be: moving, measured, not exchanged."""

from __future__ import annotations

import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.diagnosed_run import DiagnosedRun
from vio_eval_ros.diagnosis.fitting import horizon
from vio_eval_ros.diagnosis.limits import DiagnosisLimits

#: a repetition of one position is not shorter than this
SHORTEST_FREEZE_S = 1.0
#: of its usual speed, what the other side has at least while one is frozen
USUAL_SPEED_SHARE = 0.3
#: positions of which a median is taken against noise
FEWEST_OF_MEDIAN = 10
#: the extents of a path within which a side begins at its origin
ORIGIN_SHARE = 0.02
#: the rate of a ground truth over that of an estimate
RATE_RATIO = 3.0
#: confidences that the sides were exchanged, by their rates and by their headings
CONFIDENCE_BY_RATES, CONFIDENCE_BY_HEADINGS = 0.7, 0.6
HEADING_RAD = math.radians(2.0)
#: of an interpolated truth, the share that is straight, and how much sharper the rest bends
STRAIGHT_SHARE, BEND_RATIO = 0.45, 10.0
#: knots of which most are a regular distance apart
FEWEST_KNOTS, REGULAR_SHARE = 10, 0.8
#: the resolution of stamps in most files
STAMP_RESOLUTION_S = 1e-6


def stands_still(poses: Trajectory, metres: float, limits: DiagnosisLimits) -> bool:
    """Return whether a trajectory moves no further than this, and hardly rotates."""
    angle = 0.0
    if poses.rotations is not None:
        angle = float(rotation.angle_between(poses.rotations, poses.rotations[0]).max())
    return stays(poses, metres) and angle < math.radians(limits.still_deg)


def stays(poses: Trajectory, metres: float) -> bool:
    """Return whether a trajectory moves no further than this, however it rotates."""
    return _extent(poses) < metres


def interpolated_over_s(truth: Trajectory) -> float | None:
    """
    Return the time between the poses that a truth was interpolated from, if it was.

    Between those its positions lie on straight lines, as exactly as they are written; it bends
    only at them, at regular intervals. The path of a body that moves freely bends everywhere.
    """
    stamps_ns, points = truth.stamps_ns, truth.positions
    seconds = (stamps_ns - stamps_ns[0]) / 1e9
    chord = points[2:] - points[:-2]
    weight = (seconds[1:-1] - seconds[:-2]) / (seconds[2:] - seconds[:-2])
    deviation = lengths(points[:-2] + weight[:, None] * chord - points[1:-1])
    speed = lengths(chord) / (seconds[2:] - seconds[:-2])
    rounding = 2 * _resolution(points) + 2 * STAMP_RESOLUTION_S * speed
    moving = lengths(chord) > BEND_RATIO * rounding
    bent = moving & (deviation > rounding)
    straight = moving & ~bent
    if not bent.any() or straight.sum() < STRAIGHT_SHARE * moving.sum():
        return None
    # a pose that lies between two samples bends both
    begin = bent & ~np.concatenate([[False], bent[:-1]])
    # only where it moved from one to the next
    knots = np.flatnonzero(begin)
    still = np.concatenate([[0], np.cumsum(~moving)])
    apart = np.diff(knots)[still[knots[1:]] == still[knots[:-1]]]
    if len(apart) < FEWEST_KNOTS or np.median(deviation[bent]) < BEND_RATIO * np.median(
        rounding[bent]
    ):
        return None
    usual = float(np.median(apart))
    regular = np.abs(apart - usual) <= 1
    if regular.mean() < REGULAR_SHARE:
        return None
    return usual * float(np.median(np.diff(seconds)))


def _resolution(points: np.ndarray) -> float:
    """Return the step in which coordinates are written."""
    steps = [np.diff(np.unique(column)) for column in points.T]
    return max((float(step.min()) for step in steps if len(step)), default=0.0)


def likely_swapped(run: DiagnosedRun) -> float:
    """
    Return how likely it is that the truth is an estimate and the estimate a truth.

    An odometry begins at the origin of its own world and heads along its x axis, and has the rate
    of a camera; a motion capture has neither.
    """
    extents = [_extent(side) for side in (run.estimate, run.truth)]
    starts = [float(np.linalg.norm(side.positions[0])) for side in (run.estimate, run.truth)]
    intervals = [float(np.median(np.diff(side.stamps_ns))) for side in (run.estimate, run.truth)]
    begins = (
        starts[1] < ORIGIN_SHARE * extents[1] and starts[0] > 10 * ORIGIN_SHARE * extents[0]
    )  # fmt: skip
    if begins and intervals[1] > RATE_RATIO * intervals[0]:
        return CONFIDENCE_BY_RATES
    headed = _heads_along_x(run.truth) and not _heads_along_x(run.estimate)
    similar_rates = intervals[0] < RATE_RATIO * intervals[1]
    return CONFIDENCE_BY_HEADINGS if begins and headed and similar_rates else 0.0


def _heads_along_x(poses: Trajectory) -> bool:
    """Return whether the first pose has the heading of the world, as far as it has one."""
    if poses.rotations is None:
        return False
    x, y, _ = rotation.rotate(poses.rotations[0], np.array([1.0, 0.0, 0.0]))
    return abs(math.atan2(y, x)) < HEADING_RAD


def _extent(poses: Trajectory) -> float:
    """Return how far medians over a second are from that of all, which noise does not raise."""
    interval_s = float(np.median(np.diff(poses.stamps_ns))) / 1e9
    rows = int(np.clip(1 / interval_s, FEWEST_OF_MEDIAN, len(poses) // 4))
    whole = poses.positions[: len(poses) // rows * rows].reshape(-1, rows, 3)
    seconds = np.median(whole, axis=1)
    return float(lengths(seconds - np.median(seconds, axis=0)).max())


def frozen(poses: Trajectory, other: Trajectory, limits: DiagnosisLimits) -> np.ndarray:
    """
    Return which rows repeat one position for long, while the other side moves on.

    A side that is published faster than it is measured repeats itself as well, but not for long.
    """
    changes = np.flatnonzero(np.diff(poses.positions, axis=0).any(axis=1)) + 1
    edges = np.concatenate([[0], changes, [len(poses)]])
    begin_ns, end_ns = poses.stamps_ns[edges[:-1]], poses.stamps_ns[edges[1:] - 1]
    lasts_ns = end_ns - begin_ns
    longest_ns = min(
        limits.frozen_s * 1e9, limits.frozen_percent / 100 * float(np.ptp(poses.stamps_ns))
    )
    rows = np.zeros(len(poses), bool)
    for k in np.flatnonzero(lasts_ns > max(longest_ns, SHORTEST_FREEZE_S * 1e9)).tolist():
        if _moves_as_usual(other, int(begin_ns[k]), int(end_ns[k]), limits.moving_m / 2):
            rows[edges[k] + 1 : edges[k + 1]] = True
    return rows


def _moves_as_usual(poses: Trajectory, begin_ns: int, end_ns: int, least_m_s: float) -> bool:
    """Return whether a side moves between two stamps not much slower than usual."""
    begin, end = horizon(poses.stamps_ns, 1.0)
    speeds = lengths(poses.positions[end] - poses.positions[begin])
    within = (poses.stamps_ns[begin] >= begin_ns) & (poses.stamps_ns[end] <= end_ns)
    if not within.any() or within.all():
        return False
    usual = float(np.median(speeds[~within]))
    return float(np.median(speeds[within])) > max(USUAL_SPEED_SHARE * usual, least_m_s)
