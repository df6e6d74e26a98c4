"""The formats in which a run is written; each is a function and a line in ``FORMATS``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vio_eval_ros.conversion.staging import check_out, staged_path
from vio_eval_ros.conversion.texts import write_euroc, write_rows
from vio_eval_ros.conversion.topics import (
    odometry_topic,
    pose_topic,
    TopicColumns,
    write_mcap,
    write_ros1,
    write_rosbag2,
    write_sqlite3,
)
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation.simulated_run import Imu, IMU_RATE_HZ, SimulatedRun

VIO_LATENCY_NS = 38_000_000  # between an image and the publication of its pose


def recorded_topics(run: SimulatedRun) -> list[TopicColumns]:
    """Return the topics that a recorder would record of a run."""
    found = []
    if len(run.ground_truth):
        found.append(pose_topic(run.ground_truth, '/ground_truth/pose', 'world'))
    if run.imu is not None:
        found.append(_imu(run.imu))
    if len(run.estimate):
        found.append(_of_estimate(run.estimate))
    return found


def _of_estimate(poses: Trajectory) -> TopicColumns:
    if poses.rotations is None:
        return pose_topic(poses, '/vio/position', 'odom', VIO_LATENCY_NS)
    return odometry_topic(poses, '/vio/odometry', 'odom', 'body', VIO_LATENCY_NS)


def _imu(imu: Imu) -> TopicColumns:
    """Return Imu messages without orientation; covariances are those of the white noise."""
    unknown = np.zeros(4 + 9)
    unknown[3:5] = 1.0, -1.0  # as sensor_msgs/Imu says that there is no orientation
    gyro, accel = (
        (np.eye(3) * noise.density**2 * IMU_RATE_HZ).ravel()
        for noise in (imu.noise.gyro, imu.noise.accel)
    )

    def numbers(block: slice) -> np.ndarray:
        samples = imu.samples[block]
        parts = [unknown, samples[:, :3], gyro, samples[:, 3:], accel]
        rows = [np.broadcast_to(part, (len(samples), part.shape[-1])) for part in parts]
        return np.concatenate(rows, axis=1)

    return TopicColumns('/imu0', 'sensor_msgs/msg/Imu', ('imu0',), imu.stamps_ns, numbers)


def _write_tum(run: SimulatedRun, path: Path) -> None:
    path.mkdir()
    for name in ('estimate', 'ground_truth'):
        poses = getattr(run, name)
        if len(poses):
            (path / f'{name}.tum').write_text(tum(poses))
    if run.imu is not None:
        _write_imu_csv(run.imu, path / 'imu0.csv')


IMU_COLUMNS = (
    '#timestamp [ns],'
    'w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],'
    'a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n'
)
SENSOR = """sensor_type: {kind}
comment: simulated by vio_eval_ros
T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
"""
IMU_SENSOR = """rate_hz: {rate:g}
gyroscope_noise_density: {gyro.density!r}
gyroscope_random_walk: {gyro.walk!r}
accelerometer_noise_density: {accel.density!r}
accelerometer_random_walk: {accel.walk!r}
"""


def _write_euroc(run: SimulatedRun, path: Path) -> None:
    """Write a sequence folder like EuRoC's, and the estimate beside its ``mav0``."""
    if len(run.ground_truth):
        folder = path / 'mav0' / 'state_groundtruth_estimate0'
        folder.mkdir(parents=True)
        (folder / 'sensor.yaml').write_text(SENSOR.format(kind='visual-inertial'))
        if run.ground_truth.rotations is None:
            raise ConfigError('a EuRoC folder needs orientations of the ground truth')
        write_euroc(run.ground_truth, folder / 'data.csv')
    if run.imu is not None:
        folder = path / 'mav0' / 'imu0'
        folder.mkdir(parents=True)
        noise = IMU_SENSOR.format(rate=IMU_RATE_HZ, **vars(run.imu.noise))
        (folder / 'sensor.yaml').write_text(SENSOR.format(kind='imu') + noise)
        _write_imu_csv(run.imu, folder / 'data.csv')
    if len(run.estimate):
        path.mkdir(exist_ok=True)
        (path / 'estimate.tum').write_text(tum(run.estimate))


def _write_imu_csv(imu: Imu, path: Path) -> None:
    with path.open('w') as file:
        file.write(IMU_COLUMNS)
        write_rows(file, imu.stamps_ns, imu.samples)


def _recording(
    write: Callable[[Sequence[TopicColumns], Path], None],
) -> Callable[[SimulatedRun, Path], None]:
    """Return what writes the topics of a run."""
    return lambda run, path: write(recorded_topics(run), path)


class Format(NamedTuple):
    """How a run can be written: by which function, and with which suffix, if any."""

    write: Callable[[SimulatedRun, Path], None]
    suffix: str = ''


FORMATS: dict[str, Format] = {
    'ros1': Format(_recording(write_ros1), '.bag'),
    'mcap': Format(_recording(write_mcap), '.mcap'),
    'rosbag2': Format(_recording(write_rosbag2)),
    'sqlite3': Format(_recording(write_sqlite3)),
    'tum': Format(_write_tum),
    'euroc': Format(_write_euroc),
}

# a folder has none of these
FILE_SUFFIXES = ('.csv', '.db3', '.json', '.tum', '.txt', '.yaml')


def format_of(path: Path, stated: str | None = None) -> str:
    """
    Return the format to be written: as stated, otherwise by the suffix of the name.

    :raises ConfigError: where the suffix is that of another format.
    """
    named = next((name for name, one in FORMATS.items() if one.suffix == path.suffix != ''), None)
    if stated is None and path.suffix in FILE_SUFFIXES:
        known = ', '.join(one.suffix for one in FORMATS.values() if one.suffix)
        raise ConfigError(
            f'{path}: cannot write {path.suffix}; OUT ends in {known}, or in neither for a folder'
        )
    chosen = stated or named or 'rosbag2'
    if named != chosen:
        suffix = FORMATS[chosen].suffix
        if suffix:
            raise ConfigError(f'{path}: for {chosen}, OUT is a file: name it with {suffix}')
        if named:
            raise ConfigError(f'{path}: for {chosen}, OUT is a folder: drop {path.suffix}')
    return chosen


def write_recording(run: SimulatedRun, path: Path, kind: str | None = None) -> None:
    """
    Write a run; its path holds all of it or nothing.

    Recordings have ``/ground_truth/pose`` (PoseStamped), ``/vio/odometry`` (Odometry with the
    covariance of its pose; the twist stays zero) and ``/imu0``, as far as the run has them, in
    the order in which a recorder would have received them.

    :param kind: of ``FORMATS``. None goes by the suffix: ``.bag`` a ROS 1 bag, ``.mcap`` an mcap
        file, otherwise a rosbag2 folder in MCAP format with compressed chunks.
    :raises ConfigError: where the path exists already, or its suffix is that of another format.
    :raises WriteError: where it cannot be written.
    """
    chosen = format_of(path, kind)
    check_out(path)
    with staged_path(path) as staged:
        FORMATS[chosen].write(run, staged)
