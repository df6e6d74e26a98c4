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


def stands_still(poses: Trajectory) -> bool:
    """Return whether a trajectory moves and turns no more than its noise may be."""
    extent = _extent(poses)
    turned = 0.0
    if poses.rotations is not None:
        turned = float(rotation.angle_between(poses.rotations, poses.rotations[0]).max())
    return extent < STILL_M and turned < STILL_RAD


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
