"""
The formats in which a run is written; each is a function and a line in ``FORMATS``.

Messages are serialised in columns: those of a topic differ only in their stamps and numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import heapq
from operator import itemgetter
from pathlib import Path
import struct
import tempfile
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.core.trajectory import blocks, Trajectory
from vio_eval_ros.errors import ConfigError, WriteError
from vio_eval_ros.rendering.tum import formatted, tum
from vio_eval_ros.simulation.simulated_run import Imu, IMU_RATE_HZ, SimulatedRun

VIO_LATENCY_NS = 38_000_000  # between an image and the publication of its pose
LAST_STAMP_NS = 2**31 * 10**9  # 2038: the seconds of a ROS stamp are int32


class TopicColumns(NamedTuple):
    """
    The messages of a topic, all of one type, as columns.

    :param frames: the frame names that follow the stamp in each message.
    :param numbers: returns all doubles after those, (n, D), of a slice of the messages.
    :param latency_ns: between stamp and receipt.
    """

    topic: str
    msgtype: str
    frames: tuple[str, ...]
    stamps_ns: np.ndarray
    numbers: Callable[[slice], np.ndarray]
    latency_ns: int = 0

    def messages(self, ros1: bool) -> Iterator[tuple[int, str, bytes]]:
        """Yield the time of receipt, the topic and the bytes of each message."""
        # CDR begins with a preamble, a ROS 1 header with a counter; both have 4 bytes
        begin = bytes(4) if ros1 else b'\0\1\0\0'
        strings = b''
        for frame in self.frames:
            text = frame.encode() + (b'' if ros1 else b'\0')
            strings += struct.pack('<I', len(text)) + text
            # CDR aligns numbers to their size, and strings to the size of their length
            strings += b'' if ros1 else bytes(-len(strings) % 4)
        strings += b'' if ros1 else bytes(-len(strings) % 8)
        for block in blocks(len(self.stamps_ns)):
            stamps_ns, numbers = self.stamps_ns[block], self.numbers(block)
            kind = [
                ('begin', f'V{len(begin)}'),
                ('stamp', '<u4', 2),
                ('strings', f'V{len(strings)}'),
                ('numbers', '<f8', numbers.shape[1]),
            ]
            rows = np.empty(len(stamps_ns), kind)
            rows['begin'], rows['strings'] = np.void(begin), np.void(strings)
            rows['stamp'] = np.stack(np.divmod(stamps_ns, 10**9), axis=-1)
            rows['numbers'] = numbers
            for stamp_ns, row in zip(stamps_ns.tolist(), rows, strict=True):
                yield stamp_ns + self.latency_ns, self.topic, row.tobytes()


def recorded_topics(run: SimulatedRun) -> list[TopicColumns]:
    """Return the topics that a recorder would record of a run."""
    found = []
    if len(run.ground_truth):
        found.append(_poses(run.ground_truth, '/ground_truth/pose', 'world'))
    if run.imu is not None:
        found.append(_imu(run.imu))
    if len(run.estimate):
        found.append(_odometry(run.estimate))
    return found


def _poses(poses: Trajectory, topic: str, frame: str, latency_ns: int = 0) -> TopicColumns:
    """Return PoseStamped messages, or PointStamped where there are only positions."""
    kind = 'geometry_msgs/msg/' + ('PointStamped' if poses.rotations is None else 'PoseStamped')

    def numbers(block: slice) -> np.ndarray:
        return _pose_columns(poses[block])

    return TopicColumns(
        topic=topic,
        msgtype=kind,
        frames=(frame,),
        stamps_ns=poses.stamps_ns,
        numbers=numbers,
        latency_ns=latency_ns,
    )


def _pose_columns(poses: Trajectory) -> np.ndarray:
    columns = [poses.positions] if poses.rotations is None else [poses.positions, poses.rotations]
    return np.concatenate(columns, axis=1)


def _odometry(poses: Trajectory) -> TopicColumns:
    """Return Odometry with the covariances of the poses; the twist stays zero."""
    if poses.rotations is None:
        return _poses(poses, '/vio/position', 'odom', VIO_LATENCY_NS)

    def numbers(block: slice) -> np.ndarray:
        some = poses[block]
        covariances, twists = np.zeros((len(some), 6, 6)), np.zeros((len(some), 6 + 36))
        if some.covariances is not None:
            covariances[:, :3, :3] = some.covariances[:, 0]
            covariances[:, 3:, 3:] = some.covariances[:, 1]
        return np.concatenate([_pose_columns(some), covariances.reshape(-1, 36), twists], axis=1)

    return TopicColumns(
        topic='/vio/odometry',
        msgtype='nav_msgs/msg/Odometry',
        frames=('odom', 'body'),
        stamps_ns=poses.stamps_ns,
        numbers=numbers,
        latency_ns=VIO_LATENCY_NS,
    )


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


def _write_ros1(run: SimulatedRun, path: Path) -> None:
    from rosbags.rosbag1 import Writer

    _record(run, Writer(path), ros1=True)


def _write_rosbag2(run: SimulatedRun, path: Path) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    _record(run, writer, ros1=False)


def _write_sqlite3(run: SimulatedRun, path: Path) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    _record(run, Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3), ros1=False)


def _write_mcap(run: SimulatedRun, path: Path) -> None:
    folder = path.with_suffix('')
    _write_rosbag2(run, folder)
    (folder / f'{folder.name}.mcap').replace(path)


def _record(run: SimulatedRun, writer: Any, ros1: bool) -> None:
    """Write the messages in the order in which a recorder would have received them."""
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    topics = recorded_topics(run)
    for one in topics:
        if one.stamps_ns[0] < 0 or one.stamps_ns[-1] >= LAST_STAMP_NS:
            raise ConfigError(f'{one.topic}: stamps of messages are limited to 1970 to 2038')
    with writer:
        connections = {
            one.topic: writer.add_connection(one.topic, one.msgtype, typestore=store)
            for one in topics
        }
        messages = (one.messages(ros1) for one in topics)
        for received_ns, topic, message in heapq.merge(*messages, key=itemgetter(0)):
            writer.write(connections[topic], received_ns, message)


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
POSE_COLUMNS = (
    '#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],'
    'q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []\n'
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
        columns = [run.ground_truth.positions, np.roll(run.ground_truth.rotations, 1, axis=1)]
        rows = np.concatenate(columns, axis=1)
        with (folder / 'data.csv').open('w') as file:
            file.write(POSE_COLUMNS)
            _write_rows(file, run.ground_truth.stamps_ns, rows)
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
        _write_rows(file, imu.stamps_ns, imu.samples)


def _write_rows(file: Any, stamps_ns: np.ndarray, numbers: np.ndarray) -> None:
    """Write a line for each stamp and its numbers, with all of their digits."""
    for block in blocks(len(stamps_ns)):
        table = np.empty((len(stamps_ns[block]), 1 + numbers.shape[1]), object)
        table[:, 0], table[:, 1:] = stamps_ns[block], numbers[block]
        file.write(formatted(table, ','.join(['%d'] + ['%.17g'] * numbers.shape[1])))


class Format(NamedTuple):
    """How a run can be written: by which function, and with which suffix, if any."""

    write: Callable[[SimulatedRun, Path], None]
    suffix: str = ''


FORMATS: dict[str, Format] = {
    'ros1': Format(_write_ros1, '.bag'),
    'mcap': Format(_write_mcap, '.mcap'),
    'rosbag2': Format(_write_rosbag2),
    'sqlite3': Format(_write_sqlite3),
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
    with _staged(path) as staged:
        FORMATS[chosen].write(run, staged)


def check_out(path: Path) -> None:
    """Raise ``ConfigError`` where nothing can be written to a path."""
    if path.exists():
        raise ConfigError(f'{path}: exists already; remove it or choose another name')
    if not path.parent.is_dir():
        raise ConfigError(f'{path}: there is no folder {path.parent}')


@contextmanager
def _staged(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to, and rename it when it is complete."""
    check_out(path)
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=f'.{path.name}.') as folder:
            staged = Path(folder, path.name)
            yield staged
            staged.rename(path)
    except OSError as error:
        raise WriteError(path, error.strerror or str(error)) from None
