"""
What can be done to a trajectory on its way from one format to another.

Each change takes poses in the order of their stamps and returns others. None drops a pose without
the caller being able to count it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.cleaning import clean, Cleaning
from vio_eval_ros.core.interpolation import interpolated, Interpolator
from vio_eval_ros.core.orientations import why_positions_only
from vio_eval_ros.core.steps import distances
from vio_eval_ros.core.trajectory import Poses, Trajectory
from vio_eval_ros.errors import ConfigError

#: what turns the axes of the world, and of the body, into x forward or east, y left or north, z up
AXES = {
    'ned': (((0, 1, 0), (1, 0, 0), (0, 0, -1)), ((1, 0, 0), (0, -1, 0), (0, 0, -1))),
    'camera': (((0, 0, 1), (-1, 0, 0), (0, -1, 0)), ((0, 0, 1), (-1, 0, 0), (0, -1, 0))),
}
#: poses that are looked at at first for one that is turned far enough; then twice as many
FIRST_LOOK = 64
PLANES = {'xy': 2, 'xz': 1, 'yz': 0}


def in_order(poses: Poses, counts: Cleaning) -> Trajectory:
    """
    Return the poses that say something, in the order of their stamps, with every digit as it was.

    As :func:`clean`, but quaternions keep the length that they have.
    """
    # the number of a row travels as its weight, which nothing here looks at
    cleaned = clean(replace(poses, weights=np.arange(float(len(poses)))), counts)
    assert cleaned.weights is not None
    rows, cleaned = cleaned.weights.astype(int), replace(cleaned, weights=None)
    if poses.rotations is None or cleaned.rotations is None or why_positions_only(poses):
        return replace(cleaned, rotations=None)
    return replace(cleaned, rotations=poses.rotations[rows])


def merged(parts: Sequence[Trajectory]) -> tuple[Trajectory, int]:
    """Return all poses in one order, and how many were dropped since their stamp was taken."""
    joined = Poses.concatenate([Poses(p.stamps_ns, p.positions, p.rotations) for p in parts])
    order = np.argsort(joined.stamps_ns, kind='stable')
    first = np.concatenate([[True], np.diff(joined.stamps_ns[order]) > 0])[: len(order)]
    kept = order[first]
    rotations = None if joined.rotations is None else joined.rotations[kept]
    whole = Trajectory(joined.stamps_ns[kept], joined.positions[kept], rotations)
    return whole, len(order) - len(kept)


def cropped(poses: Trajectory, start_s: float, end_s: float) -> Trajectory:
    """Return the poses from ``start_s`` to ``end_s`` after the first."""
    seconds = (poses.stamps_ns - poses.stamps_ns[:1]) / 1e9
    return poses[(seconds >= start_s) & (seconds <= end_s)]


def every(poses: Trajectory, count: int) -> Trajectory:
    """Return every ``count``-th pose."""
    return poses[::count]


def at_rate(poses: Trajectory, rate_hz: float) -> Trajectory:
    """Return the first pose of each interval of that rate: none is made up."""
    if not len(poses):
        return poses
    slot = np.floor((poses.stamps_ns - poses.stamps_ns[0]) * (rate_hz / 1e9) + 1e-6)
    return poses[np.concatenate([[True], np.diff(slot) > 0])]


def after_motion(poses: Trajectory, distance_m: float, angle_deg: float) -> Trajectory:
    """
    Return each pose that moved so far along the path, or is turned so far from the last one kept.

    Either is enough, as in evo's motion filter.
    """
    along = distances(poses.positions)
    unit = None
    if poses.rotations is not None and math.isfinite(angle_deg):
        unit = rotation.normalize(poses.rotations)
    kept = [0] if len(poses) else []
    while kept:  # one step for each pose that is kept
        last = kept[-1]
        following = max(int(np.searchsorted(along, along[last] + distance_m)), last + 1)
        if unit is not None:
            following = min(following, _first_turned(unit, last, following, angle_deg))
        if following >= len(poses):
            break
        kept.append(following)
    return poses[np.array(kept, int)]


def _first_turned(unit: np.ndarray, last: int, stop: int, angle_deg: float) -> int:
    """Return the first of the poses up to ``stop`` that is turned so far from the last one."""
    begin, count = last + 1, FIRST_LOOK
    while begin < min(stop, len(unit)):
        end = min(begin + count, stop, len(unit))
        angles = np.degrees(rotation.angle_between(unit[begin:end], unit[last]))
        far = np.flatnonzero(angles >= angle_deg)
        if len(far):
            return begin + int(far[0])
        begin, count = end, 2 * count
    return stop


def resampled(poses: Trajectory, stamps_ns: np.ndarray, max_gap_s: float) -> Trajectory:
    """
    Return the poses at other stamps, as far as no longer gap is bridged.

    Positions are interpolated along straight lines, orientations by slerp.
    """
    wanted = np.unique(stamps_ns)
    wanted = wanted[Interpolator(poses, max_gap_s).inside(wanted)]
    return interpolated(replace(poses, covariances=None), wanted)


def turned(poses: Trajectory, axes: str) -> Trajectory:
    """
    Return the poses with z up: of NED and FRD, or of a camera's optical axes.

    :param axes: ``ned`` makes east, north, up and a body with x forward, y left, z up of north,
        east, down and forward, right, down. ``camera`` makes x forward, y left, z up of x right,
        y down, z forward, of world and body alike.
    """
    world, body = (np.array(matrix, float) for matrix in AXES[axes])
    positions = poses.positions @ world.T
    if poses.rotations is None:
        return replace(poses, positions=positions, covariances=None)
    matrices = world @ rotation.to_matrix(rotation.normalize(poses.rotations)) @ body.T
    rotations = rotation.from_matrix(matrices)
    return replace(poses, positions=positions, rotations=rotations, covariances=None)


def on_plane(poses: Trajectory, plane: str) -> Trajectory:
    """
    Return the poses projected to a plane of the world: ``xy``, ``xz`` or ``yz``.

    Orientations keep their turn about the normal of the plane: the swing is left out of what is
    the product of a swing and a turn about that axis.
    """
    normal = PLANES[plane]
    positions = poses.positions.copy()
    positions[:, normal] = 0.0
    rotations = poses.rotations
    if rotations is not None:
        flat = np.zeros_like(rotations)
        flat[:, normal], flat[:, 3] = rotations[:, normal], rotations[:, 3]
        if (rotation.lengths(flat) < 1e-9).any():
            raise ConfigError(
                f'--plane {plane}: a pose is turned over, so that it has no heading in the plane'
            )
        rotations = rotation.normalize(flat)
    return replace(poses, positions=positions, rotations=rotations, covariances=None)
