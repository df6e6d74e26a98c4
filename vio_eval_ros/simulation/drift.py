"""The errors of a visual-inertial odometry, which accumulate over true poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Trajectory


@dataclass(frozen=True)
class Drift:
    """
    Errors of the simulated estimator; the defaults are those of a good stereo VIO.

    :param position_walk: m/√s, random walk of the position, per axis.
    :param yaw_walk: rad/√s, random walk of the heading, which no VIO can observe.
    :param scale: estimated over true length.
    :param position_noise: m, white, per axis.
    :param orientation_noise: rad, white, per axis; roll and pitch are observable and do not drift.
    :param scale_drift: growth of the scale per minute, as a share of the true length.
    """

    position_walk: float = 0.012
    yaw_walk: float = 0.005
    scale: float = 0.99
    position_noise: float = 0.003
    orientation_noise: float = 0.003
    scale_drift: float = 0.0


GOOD_STEREO = Drift()


def estimate(truth: Trajectory, drift: Drift, source: np.random.Generator) -> Trajectory:
    """Return the estimate of a VIO of the true poses, in its own world, with covariances."""
    assert truth.rotations is not None
    n = len(truth)
    elapsed_s = (truth.stamps_ns - truth.stamps_ns[0]) / 1e9
    root_dt = np.sqrt(np.diff(elapsed_s))
    yaw_errors = np.append(0, np.cumsum(drift.yaw_walk * root_dt * source.standard_normal(n - 1)))
    headings = rotation.about_z(yaw_errors)

    scales = drift.scale + drift.scale_drift * elapsed_s[:-1, None] / 60
    steps = scales * rotation.rotate(headings[:-1], np.diff(truth.positions, axis=0))
    steps += drift.position_walk * root_dt[:, None] * source.standard_normal((n - 1, 3))
    positions = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    positions += drift.position_noise * source.standard_normal((n, 3))

    wobble = drift.orientation_noise * source.standard_normal((n, 3))
    rotations = rotation.multiply(headings, truth.rotations)
    rotations = rotation.multiply(rotation.from_rotation_vector(wobble), rotations)

    forward = rotation.rotate(truth.rotations[0], np.array([1.0, 0.0, 0.0]))
    to_own_world = rotation.about_z(-np.arctan2(forward[1], forward[0]))

    # the errors that the estimator knows of: not those of its scale, nor how yaw moves it
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
