"""The messages of a topic as columns: they differ only in their stamps and numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
import heapq
from operator import itemgetter
from pathlib import Path
from shutil import rmtree
import struct
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.core.trajectory import blocks, Trajectory
from vio_eval_ros.errors import ConfigError

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


def pose_topic(poses: Trajectory, topic: str, frame: str, latency_ns: int = 0) -> TopicColumns:
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


def odometry_topic(
    poses: Trajectory, topic: str, frame: str, child: str, latency_ns: int = 0
) -> TopicColumns:
    """Return Odometry with the covariances of the poses; the twist stays zero."""

    def numbers(block: slice) -> np.ndarray:
        some = poses[block]
        covariances, twists = np.zeros((len(some), 6, 6)), np.zeros((len(some), 6 + 36))
        if some.covariances is not None:
            covariances[:, :3, :3] = some.covariances[:, 0]
            covariances[:, 3:, 3:] = some.covariances[:, 1]
        return np.concatenate([_pose_columns(some), covariances.reshape(-1, 36), twists], axis=1)

    return TopicColumns(
        topic=topic,
        msgtype='nav_msgs/msg/Odometry',
        frames=(frame, child),
        stamps_ns=poses.stamps_ns,
        numbers=numbers,
        latency_ns=latency_ns,
    )


def _pose_columns(poses: Trajectory) -> np.ndarray:
    columns = [poses.positions] if poses.rotations is None else [poses.positions, poses.rotations]
    return np.concatenate(columns, axis=1)


def write_ros1(topics: Sequence[TopicColumns], path: Path) -> None:
    """Write a ROS 1 bag."""
    from rosbags.rosbag1 import Writer

    _record(topics, Writer(path), ros1=True)


def write_rosbag2(topics: Sequence[TopicColumns], path: Path) -> None:
    """Write a rosbag2 folder in MCAP format, with compressed chunks."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    _record(topics, writer, ros1=False)


def write_sqlite3(topics: Sequence[TopicColumns], path: Path) -> None:
    """Write a rosbag2 folder with SQLite."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    _record(topics, Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3), ros1=False)


def write_mcap(topics: Sequence[TopicColumns], path: Path) -> None:
    """Write an mcap file."""
    folder = path.with_suffix('')
    write_rosbag2(topics, folder)
    (folder / f'{folder.name}.mcap').replace(path)
    rmtree(folder)


def _record(topics: Sequence[TopicColumns], writer: Any, ros1: bool) -> None:
    """
    Write the messages in the order in which a recorder would have received them.

    :raises ConfigError: ROS cannot hold the stamps.
    """
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
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
