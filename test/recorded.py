"""Small recordings for tests: messages of any definition, written by rosbags."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

START_NS = 1_700_000_000_000_000_000
STEP_NS = 50_000_000
LATENCY_NS = 2_000_000  # from the stamp to the recording
KINDS = ('ros1', 'sqlite', 'mcap')


class Stream(NamedTuple):
    """
    A topic to be recorded.

    :param messages: as nested dictionaries; what is left out is zero.
    :param definitions: of types that are not standard, by name.
    :param logged_ns: when each was recorded; None at the usual times.
    """

    topic: str
    msgtype: str
    messages: Iterable[Mapping[str, Any]]
    definitions: Mapping[str, str] = {}
    logged_ns: Iterable[int] | None = None


def write(path: Path, kind: str, *streams: Stream) -> Path:
    """Return where a recording of streams is: a ROS 1 bag, or a folder of SQLite or mcap."""
    ros1 = kind == 'ros1'
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    for stream in streams:
        for name, definition in stream.definitions.items():
            types.register(get_types_from_msg(definition, name))
    path = path.with_suffix('.bag') if ros1 else path
    plugin = StoragePlugin.MCAP if kind == 'mcap' else StoragePlugin.SQLITE3
    serialize = types.serialize_ros1 if ros1 else types.serialize_cdr
    rows = []
    for stream in streams:
        logged = stream.logged_ns or (stamp(k) + LATENCY_NS for k in range(1 << 30))
        for log_ns, message in zip(logged, stream.messages, strict=False):
            built = build(types, stream.msgtype, message)
            rows.append((log_ns, stream.topic, bytes(serialize(built, stream.msgtype))))
    with Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=plugin) as writer:
        connections = {
            stream.topic: writer.add_connection(stream.topic, stream.msgtype, typestore=types)
            for stream in streams
        }
        for log_ns, topic, raw in sorted(rows, key=lambda row: row[0]):
            writer.write(connections[topic], log_ns, raw)
    return path


def build(types: Any, msgtype: str, values: Mapping[str, Any]) -> Any:
    """Return a message of rosbags from nested dictionaries."""
    fields = types.fielddefs[msgtype][1]
    assert not values.keys() - {name for name, _ in fields}, (msgtype, values)
    return types.types[msgtype](
        **{name: _value(types, kind, values.get(name)) for name, kind in fields}
    )


def _value(types: Any, kind: Any, value: Any) -> Any:
    node, argument = kind
    if node == Nodetype.NAME:
        return build(types, argument, value or {})
    if node == Nodetype.BASE:
        name = argument[0]
        return (value or '') if name == 'string' else value or (False if name == 'bool' else 0)
    inner, count = argument
    filled = value if value is not None else [None] * (count if node == Nodetype.ARRAY else 0)
    if inner[0] == Nodetype.BASE and inner[1][0] != 'string':
        return np.array([one or 0 for one in filled], inner[1][0])
    return [_value(types, inner, one) for one in filled]


def stamp(k: int) -> int:
    """Return the stamp [ns] of message k."""
    return START_NS + k * STEP_NS


def header(k: int, frame: str = 'map') -> dict[str, Any]:
    """Return the header of message k."""
    seconds, nanoseconds = divmod(stamp(k), 1_000_000_000)
    return {'stamp': {'sec': seconds, 'nanosec': nanoseconds}, 'frame_id': frame}


def numbers(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return position and quaternion x y z w of a motion that never repeats, at message k."""
    s = k * STEP_NS / 1e9
    position = np.array([np.sin(s), np.sin(0.7 * s) * 2, 0.3 * s])
    turn = np.array([0.1 * np.sin(s), 0.2 * np.cos(s), np.sin(s / 3), 1.0])
    return position, turn / np.linalg.norm(turn)


def vector(values: Iterable[float], names: str = 'xyz') -> dict[str, float]:
    """Return a vector or quaternion by the names of its components."""
    return dict(zip(names, map(float, values), strict=True))


def pose(k: int) -> dict[str, Any]:
    """Return the pose at message k."""
    position, turn = numbers(k)
    return {'position': vector(position), 'orientation': vector(turn, 'xyzw')}


def transform(k: int) -> dict[str, Any]:
    """Return the same as a transform."""
    position, turn = numbers(k)
    return {'translation': vector(position), 'rotation': vector(turn, 'xyzw')}


def odometry(count: int = 60) -> Stream:
    """Return a stamped estimate that is exact."""
    messages = [{'header': header(k, 'odom'), 'pose': {'pose': pose(k)}} for k in range(count)]
    return Stream('/vio/odometry', 'nav_msgs/msg/Odometry', messages)


def fixes(count: int = 60, topic: str = '/fix', status: int = 0) -> Stream:
    """Return the positions as fixes of a satellite receiver."""
    from pymap3d import enu2geodetic

    positions = np.array([numbers(k)[0] for k in range(count)])
    places = np.column_stack(enu2geodetic(*positions.T, 47.4, 8.55, 500.0)).tolist()
    messages = [
        {
            'header': header(k, 'gps'),
            'status': {'status': status},
            **dict(zip(('latitude', 'longitude', 'altitude'), place, strict=True)),
        }
        for k, place in enumerate(places)
    ]
    return Stream(topic, 'sensor_msgs/msg/NavSatFix', messages)
