"""
Poses straight from serialised messages, a whole block of messages at a time.

Only for speed: the result equals, bit for bit, what rosbags deserialises and
:mod:`~vio_eval_ros.recordings.messages` converts. Unusual messages give None, and go that way.
Whether frame ids are UTF-8 is not checked.

A pose message is a header (stamp, frame id), perhaps a child frame id, and then doubles. CDR
(OMG DDS-XTypes, encoding 1) aligns each value to its size, counted from the end of a 4-byte
preamble that gives the byte order. ROS 1 aligns nothing and begins the header with a counter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view


class Layout(NamedTuple):
    """What follows the stamp: strings, then doubles, of which the first few are the pose."""

    strings: int
    doubles: int
    pose_doubles: int


#: doubles of the pose of an Odometry, and of the twist behind it
ODOMETRY_POSE, TWIST = 43, 6
ODOMETRY = 'nav_msgs/msg/Odometry'
POSE = Layout(strings=1, doubles=7, pose_doubles=7)
LAYOUTS = {
    ODOMETRY: Layout(2, 85, ODOMETRY_POSE),
    'geometry_msgs/msg/PoseStamped': POSE,
    'geometry_msgs/msg/PoseWithCovarianceStamped': Layout(1, 43, 43),
    'geometry_msgs/msg/TransformStamped': Layout(2, 7, 7),
    'geometry_msgs/msg/PointStamped': Layout(1, 3, 3),
}


def decode(
    msgtype: str, messages: Sequence[bytes], ros1: bool
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the stamps and numbers of messages; None if their type is not here, or unusual."""
    layout = LAYOUTS.get(msgtype)
    return columns(layout, messages, ros1) if layout else None


def decode_odometry(
    messages: Sequence[bytes],
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the stamps, numbers and (N, 6) twists of Odometry in CDR; None if unusual."""
    layout = LAYOUTS[ODOMETRY]._replace(pose_doubles=ODOMETRY_POSE + TWIST)
    found = columns(layout, messages, ros1=False)
    if found is None:
        return None
    stamps, numbers = found
    pose, twist = np.split(numbers, [ODOMETRY_POSE], axis=1)
    return stamps, np.ascontiguousarray(pose), np.ascontiguousarray(twist)


def columns(
    layout: Layout, messages: Sequence[bytes], ros1: bool
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the stamps and first numbers of messages of one layout; None if unusual."""
    ends = np.cumsum([len(message) for message in messages])
    starts = np.concatenate([[0], ends[:-1]])
    try:
        block = _Block(b''.join(messages), starts, ros1)
        stamps, numbers, read = block.records(block.begin, layout)
    except (IndexError, ValueError):  # a length points outside the block
        return None
    return (stamps, numbers) if block.ends_at(ends, read) else None


def decode_path(message: bytes, ros1: bool) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the stamps and numbers of one Path whose poses name frames of equal length."""
    try:
        block = _Block(message, np.zeros(1, np.int64), ros1)
        at = block.align(block.header(block.begin, strings=1)[1], 4)
        (count,) = block.take(at, 'u4', 1)[0].tolist()
        at += 4
        if not 0 < count < len(message):
            return None
        # Each pose but the first begins aligned to 8 bytes, so those have the same size.
        second = block.records(at, POSE)[2]
        size = block.records(second, POSE)[2] - second if count > 1 else 0
        starts = np.concatenate([at, second + size * np.arange(count - 1)])
        stamps, numbers, read = block.records(starts, POSE)
    except (IndexError, ValueError):
        return None
    whole = np.array_equal(read[:-1], starts[1:]) and block.ends_at(len(message), read[-1])
    return (stamps, numbers) if whole else None


class _Block:
    """
    Serialised messages end to end, of which many are read at once.

    :param starts: (N,) offsets of the messages.
    """

    def __init__(self, data: bytes, starts: np.ndarray, ros1: bool) -> None:
        self._bytes = np.frombuffer(data, np.uint8)
        self._ros1 = ros1
        self._order = '<'
        self.begin = starts
        if not ros1:
            preambles = self._bytes[starts[:, None] + np.arange(2)]
            if preambles[0, 0] != 0 or preambles[0, 1] > 1 or (preambles != preambles[0]).any():
                raise ValueError('not plain CDR of one byte order')
            self._order = '<' if preambles[0, 1] else '>'
            self.begin = starts + 4

    def take(self, at: np.ndarray, dtype: str, count: int) -> np.ndarray:
        """Return ``count`` values from each offset, (N, count)."""
        kind = np.dtype(self._order + dtype)
        rows = sliding_window_view(self._bytes, count * kind.itemsize)[at]
        return np.ascontiguousarray(rows).view(kind)

    def align(self, at: np.ndarray, size: int) -> np.ndarray:
        """Return the next offsets at which values of a size may begin."""
        return at if self._ros1 else at + (self.begin - at) % size

    def header(self, at: np.ndarray, strings: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the stamps of the headers at these offsets and where their strings end."""
        at = at + 4 if self._ros1 else self.align(at, 4)
        seconds = self.take(at, 'i4', 1)[:, 0].astype(np.int64)
        nanoseconds = self.take(at + 4, 'u4', 1)[:, 0]
        at = at + 8
        for _ in range(strings):
            at = self.align(at, 4)
            length = self.take(at, 'u4', 1)[:, 0]
            at = at + 4 + length
            if not self._ros1 and (not length.all() or self._bytes[at - 1].any()):
                raise ValueError('a string does not end in NUL')
        return seconds * 1_000_000_000 + nanoseconds, at

    def records(self, at: np.ndarray, layout: Layout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the stamps, numbers and ends of the records at these offsets."""
        stamps, at = self.header(at, layout.strings)
        at = self.align(at, 8)
        numbers = self.take(at, 'f8', layout.pose_doubles)
        return stamps, numbers.astype(np.float64, copy=False), at + 8 * layout.doubles

    def ends_at(self, ends: np.ndarray | int, read: np.ndarray) -> bool:
        """Return whether the messages end where they were read to; CDR may be padded by 3."""
        rest = ends - read
        return bool(((rest >= 0) & (rest <= (0 if self._ros1 else 3))).all())
