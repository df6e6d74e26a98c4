"""
Known truth: a simulated flight and what a visual-inertial odometry makes of it.

The demo, the tests and anyone who wants to try a gate know exactly how wrong the estimate is,
because it was made wrong here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError

GRAVITY = 9.81  # m/s²

# EuRoC's rates and epoch. The camera runs freely: it never fires exactly at a truth sample.
FIRST_STAMP_NS = 1_403_715_524_907_140_096
TRUTH_PERIOD_NS = 5_000_000
CAMERA_PERIOD_NS = 50_000_000
CAMERA_PHASE_NS = 1_300_000
# A pose is published this long after the image it is the pose of.
VIO_LATENCY_NS = 38_000_000

# The path, as a sum of sines: one row per motion, one column per axis x y z. The figure of eight
# never stands still, so that the direction of travel is always defined.
CENTRE_M = np.array([0.0, 0.0, 1.3])
AMPLITUDES_M = np.array(
    [
        [2.2, 1.5, 0.0],  # figure of eight
        [0.35, 0.35, 0.7],  # wandering: no two rounds alike
        [0.03, 0.03, 0.02],  # corrections of the controller
    ]
)
FREQUENCIES_HZ = np.array([[1 / 13, 2 / 13, 0], [1 / 31, 1 / 37, 1 / 17], [0.61, 0.53, 0.71]])

TOPICS = {
    '/ground_truth/pose': 'geometry_msgs/msg/PoseStamped',
    '/vio/odometry': 'nav_msgs/msg/Odometry',
}


@dataclass(frozen=True)
class Drift:
    """
    How wrong the simulated estimator is; the defaults are those of a good stereo VIO.

    :param position_walk: m/√s, random walk of the position, per axis.
    :param yaw_walk: rad/√s, random walk of the heading, which no VIO can observe.
    :param scale: estimated over true length.
    :param position_noise: m, white, per axis.
    :param orientation_noise: rad, white, per axis; roll and pitch do not drift, gravity is seen.
    """

    position_walk: float = 0.012
    yaw_walk: float = 0.005
    scale: float = 0.99
    position_noise: float = 0.003
    orientation_noise: float = 0.003


@dataclass(frozen=True, eq=False)
class SimulatedRun:
    """
    A flight and its estimate.

    :param ground_truth: poses of the body at 200 Hz; the world's z axis points up.
    :param estimate: poses of the same body at 20 Hz with covariances, in a world of their own:
        z up as well, origin and heading where the estimator woke up.
    """

    ground_truth: Trajectory
    estimate: Trajectory


def simulate(duration_s: float = 60.0, seed: int = 7, drift: Drift = Drift()) -> SimulatedRun:
    """
    Return a flight of a multirotor through a room of 6 x 6 x 2.5 m, and its estimate.

    :param duration_s: length of the flight in seconds.
    :param seed: another seed is another flight and another drift; the same seed gives the same
        run on every machine, up to the last bits of a sine. The default is the demo's.
    :param drift: how wrong the estimate is.
    """
    seeds = np.random.SeedSequence(seed).spawn(2)
    path_source, drift_source = (np.random.Generator(np.random.PCG64(s)) for s in seeds)
    phases = path_source.uniform(0, 2 * np.pi, AMPLITUDES_M.shape)
    phases[0] = 0  # between its axes the figure of eight allows no other phase
    duration_ns = round(duration_s * 1e9)
    truth_ns = np.arange(0, duration_ns, TRUTH_PERIOD_NS)
    camera_ns = np.arange(CAMERA_PHASE_NS, duration_ns, CAMERA_PERIOD_NS)
    return SimulatedRun(
        _fly(truth_ns, phases), _estimate(_fly(camera_ns, phases), drift, drift_source)
    )


def write_recording(run: SimulatedRun, path: Path) -> None:
    """
    Write a run as a recording with the two topics an evaluation needs.

    ``/ground_truth/pose`` (PoseStamped) and ``/vio/odometry`` (Odometry with the covariance of
    its pose; the twist stays zero), in the order in which a recorder would have received them.

    :param path: a ROS 1 bag where it ends in ``.bag``, otherwise the folder of a rosbag2 in
        MCAP format with compressed chunks.
    :raises ConfigError: where something is there already.
    """
    # imported here, since a simulation that is not written needs numpy alone
    from rosbags.rosbag1 import Writer as Rosbag1Writer
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Rosbag2Writer
    from rosbags.typesys import get_typestore, Stores

    if path.exists():
        raise ConfigError(f'{path}: is there already; remove it or choose another name')
    ros1 = path.suffix == '.bag'
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    writer: Any
    if ros1:
        writer, serialize = Rosbag1Writer(path), store.serialize_ros1
    else:
        writer = Rosbag2Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        serialize = store.serialize_cdr
    with writer:
        connections = {
            topic: writer.add_connection(topic, message_type, typestore=store)
            for topic, message_type in TOPICS.items()
        }
        for received_ns, topic, message in sorted(_messages(run, store.types), key=itemgetter(0)):
            writer.write(connections[topic], received_ns, serialize(message, TOPICS[topic]))


def _messages(run: SimulatedRun, types: Mapping[str, Any]) -> Iterator[tuple[int, str, Any]]:
    """Yield the time at which each message is received, its topic and the message itself."""
    geometry = {name.split('/')[-1]: types[name] for name in types if 'geometry_msgs' in name}
    time, header = types['builtin_interfaces/msg/Time'], types['std_msgs/msg/Header']
    if 'seq' in header.__dataclass_fields__:  # ROS 1 numbers its headers
        header = partial(header, 0)

    def head(stamp_ns: int, frame: str) -> Any:
        return header(time(*divmod(stamp_ns, 10**9)), frame)

    def poses(trajectory: Trajectory) -> Iterator[tuple[int, Any]]:
        assert trajectory.rotations is not None
        columns = trajectory.stamps_ns.tolist(), trajectory.positions, trajectory.rotations
        for stamp_ns, p, q in zip(*columns, strict=True):
            point, quaternion = geometry['Point'](*p), geometry['Quaternion'](*q)
            yield stamp_ns, geometry['Pose'](point, quaternion)

    for stamp_ns, pose in poses(run.ground_truth):
        message = geometry['PoseStamped'](head(stamp_ns, 'world'), pose)
        yield stamp_ns, '/ground_truth/pose', message

    assert run.estimate.covariances is not None
    covariances = np.zeros((len(run.estimate), 6, 6))
    covariances[:, :3, :3] = run.estimate.covariances[:, 0]
    covariances[:, 3:, 3:] = run.estimate.covariances[:, 1]
    zero = geometry['Vector3'](0, 0, 0)
    still = geometry['TwistWithCovariance'](geometry['Twist'](zero, zero), np.zeros(36))
    for (stamp_ns, pose), covariance in zip(poses(run.estimate), covariances, strict=True):
        uncertain = geometry['PoseWithCovariance'](pose, covariance.ravel())
        message = types['nav_msgs/msg/Odometry'](head(stamp_ns, 'odom'), 'body', uncertain, still)
        yield stamp_ns + VIO_LATENCY_NS, '/vio/odometry', message


def _fly(elapsed_ns: np.ndarray, phases: np.ndarray) -> Trajectory:
    """Return the true poses: nose along the path, thrust along the acceleration felt."""
    rates = 2 * np.pi * FREQUENCIES_HZ
    angles = rates * (elapsed_ns[:, None, None] / 1e9) + phases
    positions = CENTRE_M + np.sum(AMPLITUDES_M * np.sin(angles), axis=1)
    velocities = np.sum(AMPLITUDES_M * rates * np.cos(angles), axis=1)
    accelerations = -np.sum(AMPLITUDES_M * rates**2 * np.sin(angles), axis=1)

    up = _unit(accelerations + np.array([0, 0, GRAVITY]))
    left = _unit(np.cross(up, velocities))
    forward = np.cross(left, up)
    rotations = rotation.from_matrix(np.stack([forward, left, up], axis=-1))
    return Trajectory(FIRST_STAMP_NS + elapsed_ns, positions, rotations)


def _estimate(truth: Trajectory, drift: Drift, source: np.random.Generator) -> Trajectory:
    """Return what a VIO says of the true poses: dead reckoning with errors that add up."""
    assert truth.rotations is not None
    n = len(truth)
    elapsed_s = (truth.stamps_ns - truth.stamps_ns[0]) / 1e9
    root_dt = np.sqrt(np.diff(elapsed_s))
    yaw_errors = np.append(0, np.cumsum(drift.yaw_walk * root_dt * source.standard_normal(n - 1)))
    turns = _about_z(yaw_errors)

    steps = drift.scale * rotation.rotate(turns[:-1], np.diff(truth.positions, axis=0))
    steps += drift.position_walk * root_dt[:, None] * source.standard_normal((n - 1, 3))
    positions = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    positions += drift.position_noise * source.standard_normal((n, 3))

    wobble = drift.orientation_noise * source.standard_normal((n, 3))
    rotations = rotation.multiply(turns, truth.rotations)
    rotations = rotation.multiply(rotation.from_rotation_vector(wobble), rotations)

    forward = rotation.rotate(truth.rotations[0], np.array([1.0, 0.0, 0.0]))
    to_own_world = _about_z(-np.arctan2(forward[1], forward[0]))

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


def _about_z(angles: np.ndarray) -> np.ndarray:
    zero = np.zeros_like(angles)
    return rotation.from_rotation_vector(np.stack([zero, zero, angles], axis=-1))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
