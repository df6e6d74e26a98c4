"""What a visual-inertial odometry makes of true poses: errors that add up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Trajectory


@dataclass(frozen=True)
class Drift:
    """
    How wrong the simulated estimator is; the defaults are those of a good stereo VIO.

    :param position_walk: m/√s, random walk of the position, per axis.
    :param yaw_walk: rad/√s, random walk of the heading, which no VIO can observe.
    :param scale: estimated over true length.
    :param position_noise: m, white, per axis.
    :param orientation_noise: rad, white, per axis; roll and pitch do not drift, gravity is seen.
    :param scale_drift: by how much more of the true length the scale grows, per minute.
    """

    position_walk: float = 0.012
    yaw_walk: float = 0.005
    scale: float = 0.99
    position_noise: float = 0.003
    orientation_noise: float = 0.003
    scale_drift: float = 0.0


GOOD_STEREO = Drift()


def estimate(truth: Trajectory, drift: Drift, source: np.random.Generator) -> Trajectory:
    """Return what a VIO says of the true poses, in a world of its own, with covariances."""
    assert truth.rotations is not None
    n = len(truth)
    elapsed_s = (truth.stamps_ns - truth.stamps_ns[0]) / 1e9
    root_dt = np.sqrt(np.diff(elapsed_s))
    yaw_errors = np.append(0, np.cumsum(drift.yaw_walk * root_dt * source.standard_normal(n - 1)))
    turns = rotation.about_z(yaw_errors)

    scales = drift.scale + drift.scale_drift * elapsed_s[:-1, None] / 60
    steps = scales * rotation.rotate(turns[:-1], np.diff(truth.positions, axis=0))
    steps += drift.position_walk * root_dt[:, None] * source.standard_normal((n - 1, 3))
    positions = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    positions += drift.position_noise * source.standard_normal((n, 3))

    wobble = drift.orientation_noise * source.standard_normal((n, 3))
    rotations = rotation.multiply(turns, truth.rotations)
    rotations = rotation.multiply(rotation.from_rotation_vector(wobble), rotations)

    forward = rotation.rotate(truth.rotations[0], np.array([1.0, 0.0, 0.0]))
    to_own_world = rotation.about_z(-np.arctan2(forward[1], forward[0]))

    # what the estimator knows of its errors: not that its scale is wrong, nor where yaw leads it
    variances = np.empty((n, 2, 3))
    variances[:, 0] = drift.position_noise**2 + drift.position_walk**2 * elapsed_s[:, None]
    variances[:, 1] = drift.orientation_noise**2
    variances[:, 1, 2] += drift.yaw_walk**2 * elapsed_s
    return Trajectory(
        truth.stamps_ns,
        rotation.rotate(to_own_world, positions),
        rotation.normalize(rotation.multiply(to_own_world, rotations)),
        variances[..., None] * np.eye(3),
    )
