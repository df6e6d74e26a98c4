"""Small recordings for tests: messages with poses of trajectories, in a rosbag2."""

from __future__ import annotations

from collections.abc import Iterable
from operator import itemgetter
from pathlib import Path
from typing import Any

from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from vio_eval_ros.core.trajectory import Trajectory

STORE = get_typestore(Stores.ROS2_JAZZY)


def stamped(cls: str, stamp_ns: int, *content: Any) -> Any:
    """Return a message that begins with a header."""
    time = STORE.types['builtin_interfaces/msg/Time'](*divmod(stamp_ns, 10**9))
    return STORE.types[cls](STORE.types['std_msgs/msg/Header'](time, 'map'), *content)


def poses(trajectory: Trajectory) -> list[Any]:
    """Return a PoseStamped for each pose."""
    geometry = 'geometry_msgs/msg/'
    point, quaternion, pose = (
        STORE.types[geometry + name] for name in ('Point', 'Quaternion', 'Pose')
    )
    columns = trajectory.stamps_ns.tolist(), trajectory.positions, trajectory.rotations
    return [
        stamped(f'{geometry}PoseStamped', stamp_ns, pose(point(*p), quaternion(*q)))
        for stamp_ns, p, q in zip(*columns, strict=True)
    ]


def record(folder: Path, messages: Iterable[tuple[str, Any]]) -> Path:
    """Write messages, each received at its stamp, as a rosbag2."""
    received = sorted(
        ((m.header.stamp.sec * 10**9 + m.header.stamp.nanosec, topic, m) for topic, m in messages),
        key=itemgetter(0),
    )
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = {
            topic: writer.add_connection(topic, msgtype, typestore=STORE)
            for topic, msgtype in {topic: m.__msgtype__ for _, topic, m in received}.items()
        }
        for received_ns, topic, message in received:
            raw = STORE.serialize_cdr(message, message.__msgtype__)
            writer.write(connections[topic], received_ns, raw)
    return folder
