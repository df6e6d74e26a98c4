"""A multirotor's flight through a room, and the samples of an ideal IMU on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.imu.record import GRAVITY_M_S2

UPWARDS = np.array([0.0, 0.0, GRAVITY_M_S2])

FIRST_STAMP_NS = 1_403_715_524_907_140_096  # at the time of the EuRoC recordings

# The path, a sum of sines: a row per motion, a column per axis x y z. The figure of eight never
# stops, so that the direction of travel is always defined.
CENTRE_M = np.array([0.0, 0.0, 1.3])
AMPLITUDES_M = np.array(
    [
        [2.2, 1.5, 0.0],  # figure of eight
        [0.35, 0.35, 0.7],  # wandering: no two rounds alike
        [0.03, 0.03, 0.02],  # corrections of the controller
    ]
)
FREQUENCIES_HZ = np.array([[1 / 13, 2 / 13, 0], [1 / 31, 1 / 37, 1 / 17], [0.61, 0.53, 0.71]])
RATES = 2 * np.pi * FREQUENCIES_HZ


@dataclass(frozen=True, eq=False)
class Flight:
    """
    A flight through a room of 6 x 6 x 2.5 m: nose along the path, thrust along the specific force.

    :param phases: (3, 3) rad, of the sines at the start.
    """

    phases: np.ndarray

    @classmethod
    def random(cls, source: np.random.Generator) -> Flight:
        """Return a random flight."""
        phases = source.uniform(0, 2 * np.pi, AMPLITUDES_M.shape)
        phases[0] = 0  # the axes of a figure of eight are in phase
        return cls(phases)

    def poses(self, elapsed_ns: np.ndarray) -> Trajectory:
        """Return the poses of the body at (N,) times after the start; the world's z points up."""
        angles = self._angles(elapsed_ns)
        positions = CENTRE_M + np.sum(AMPLITUDES_M * np.sin(angles), axis=1)
        axes = _axes(*self._motion(angles)[:2])
        rotations = rotation.from_matrix(np.stack(axes, axis=-1))
        return Trajectory(FIRST_STAMP_NS + elapsed_ns, positions, rotations)

    def imu_samples(self, elapsed_ns: np.ndarray) -> np.ndarray:
        """Return (N, 6): angular rates [rad/s] and specific forces [m/s²] in the body's axes."""
        velocities, accelerations, jerks = self._motion(self._angles(elapsed_ns))
        forward, left, up = _axes(velocities, accelerations)
        thrust = accelerations + UPWARDS
        across = np.cross(up, velocities)
        d_up = _derivative_of_unit(thrust, jerks)
        d_left = _derivative_of_unit(
            across, np.cross(d_up, velocities) + np.cross(up, accelerations)
        )
        # rates of the body from derivatives of its axes: ω_x = up · d(left)/dt, ...
        rates = _dot(up, d_left), _dot(forward, d_up), -_dot(forward, d_left)
        forces = (_dot(axis, thrust) for axis in (forward, left, up))
        return np.stack([*rates, *forces], axis=-1)

    def _angles(self, elapsed_ns: np.ndarray) -> np.ndarray:
        return RATES * (elapsed_ns[:, None, None] / 1e9) + self.phases

    def _motion(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return velocities, accelerations and jerks, (N, 3) each, in the world's axes."""
        return (
            np.sum(AMPLITUDES_M * RATES * np.cos(angles), axis=1),
            -np.sum(AMPLITUDES_M * RATES**2 * np.sin(angles), axis=1),
            -np.sum(AMPLITUDES_M * RATES**3 * np.cos(angles), axis=1),
        )


def _axes(velocities: np.ndarray, accelerations: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the axes of the body in the world: forward, left and up."""
    up = _unit(accelerations + UPWARDS)
    left = _unit(np.cross(up, velocities))
    return np.cross(left, up), left, up


def _unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _derivative_of_unit(vectors: np.ndarray, derivatives: np.ndarray) -> np.ndarray:
    """Return the derivatives of the directions of vectors."""
    directions = _unit(vectors)
    across = derivatives - _dot(directions, derivatives)[:, None] * directions
    return np.asarray(across / np.linalg.norm(vectors, axis=-1, keepdims=True))


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum('nj,nj->n', a, b)
