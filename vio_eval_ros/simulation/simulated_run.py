"""A simulated run: a flight, its estimate and its IMU, at EuRoC's rates."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.imu.record import GRAVITY_M_S2
from vio_eval_ros.imu.simulated_noise import NoiseModel, simulate_noise
from vio_eval_ros.simulation.drift import Drift, estimate, GOOD_STEREO
from vio_eval_ros.simulation.flight import FIRST_STAMP_NS, Flight

TRUTH_PERIOD_NS = 5_000_000
IMU_PERIOD_NS = 5_000_000
CAMERA_PERIOD_NS = 50_000_000
CAMERA_PHASE_NS = 1_300_000  # the camera runs freely: never exactly at a truth sample
IMU_RATE_HZ = 1e9 / IMU_PERIOD_NS


@dataclass(frozen=True, eq=False)
class Imu:
    """
    The samples of the IMU of the body.

    :param stamps_ns: (N,) int64 nanoseconds.
    :param samples: (N, 6) angular rates [rad/s] and specific forces [m/s²], x y z each.
    :param noise: that the samples contain.
    """

    stamps_ns: np.ndarray
    samples: np.ndarray
    noise: NoiseModel


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """
    A flight and its estimate; a missing part has no poses.

    :param ground_truth: poses of the body at 200 Hz; the world's z axis points up.
    :param estimate: poses of the same body at 20 Hz with covariances, in their own world: z up as
        well, origin and heading where the estimator started.
    :param imu: samples at 200 Hz in the axes of the body; None where there are none.
    """

    ground_truth: Trajectory = field(default_factory=Trajectory.empty)
    estimate: Trajectory = field(default_factory=Trajectory.empty)
    imu: Imu | None = None


def simulate(
    duration_s: float = 60.0,
    seed: int = 7,
    drift: Drift = GOOD_STEREO,
    imu_noise: NoiseModel | None = None,
) -> SimulatedRun:
    """
    Return a flight of a multirotor through a room of 6 x 6 x 2.5 m, and its estimate.

    :param duration_s: length of the flight in seconds.
    :param seed: of flight, drift and noise; the same seed gives the same run on every machine, up
        to the last bits of a sine. The default is that of the demo.
    :param drift: errors of the estimate.
    :param imu_noise: of the IMU; None for a run without one. The estimate does not depend on it.
    """
    path_source, drift_source, imu_source = _sources(seed)
    flight = Flight.random(path_source)
    duration_ns = _nanoseconds(duration_s)
    truth_ns = np.arange(0, duration_ns, TRUTH_PERIOD_NS)
    camera_ns = np.arange(CAMERA_PHASE_NS, duration_ns, CAMERA_PERIOD_NS)
    imu = None
    if imu_noise is not None:
        imu_ns = np.arange(0, duration_ns, IMU_PERIOD_NS)
        imu = _measured(imu_ns, flight.imu_samples(imu_ns), imu_noise, imu_source)
    return SimulatedRun(
        flight.poses(truth_ns), estimate(flight.poses(camera_ns), drift, drift_source), imu
    )


def at_rest(duration_s: float, seed: int, imu_noise: NoiseModel) -> SimulatedRun:
    """Return a run of an IMU alone, at rest and level; arguments as of ``simulate``."""
    imu_ns = np.arange(0, _nanoseconds(duration_s), IMU_PERIOD_NS)
    true = np.array([0.0, 0.0, 0.0, 0.0, 0.0, GRAVITY_M_S2])
    return SimulatedRun(imu=_measured(imu_ns, true, imu_noise, _sources(seed)[2]))


def _sources(seed: int) -> list[np.random.Generator]:
    """Return independent random numbers for path, drift and IMU."""
    seeds = np.random.SeedSequence(seed).spawn(3)
    return [np.random.Generator(np.random.PCG64(each)) for each in seeds]


def _measured(
    elapsed_ns: np.ndarray, true: np.ndarray, noise: NoiseModel, source: np.random.Generator
) -> Imu:
    samples = simulate_noise(len(elapsed_ns), IMU_RATE_HZ, noise, source)
    samples += true
    return Imu(FIRST_STAMP_NS + elapsed_ns, samples, noise)


def _nanoseconds(duration_s: float) -> int:
    duration_ns = round(duration_s * 1e9)
    if duration_ns <= 2 * CAMERA_PERIOD_NS:
        raise ConfigError(f'a run of {duration_s:g} s is too short to have poses')
    return duration_ns
