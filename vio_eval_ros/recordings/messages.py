"""
ROS messages to poses.

The messages may come from rclpy or from rosbags: both have the same fields, and neither is
imported here. A further message type is one function and one line in :data:`CONVERTERS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from vio_eval_ros.core.trajectory import Poses, Trajectory
from vio_eval_ros.errors import ReadError

PATH = 'nav_msgs/msg/Path'

# The stamp [ns] and the numbers of a pose: the position, then the quaternion x y z w and then the
# row-major 6 x 6 covariance, where the message has them.
Row = tuple[int, tuple[float, ...]]


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec * 1_000_000_000 + header.stamp.nanosec)


def _pose(pose: Any) -> tuple[float, ...]:
    p, q = pose.position, pose.orientation
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w


def from_pose_stamped(message: Any) -> list[Row]:
    """Return the pose of a PoseStamped."""
    return [(_stamp_ns(message.header), _pose(message.pose))]


def from_pose_with_covariance(message: Any) -> list[Row]:
    """Return the pose of an Odometry or a PoseWithCovarianceStamped, with its covariance."""
    pose = message.pose
    return [(_stamp_ns(message.header), (*_pose(pose.pose), *pose.covariance))]


def from_transform_stamped(message: Any) -> list[Row]:
    """Return the pose of the child frame in the frame of the header."""
    t, q = message.transform.translation, message.transform.rotation
    return [(_stamp_ns(message.header), (t.x, t.y, t.z, q.x, q.y, q.z, q.w))]


def from_point_stamped(message: Any) -> list[Row]:
    """Return the position of a PointStamped; it has no rotation."""
    p = message.point
    return [(_stamp_ns(message.header), (p.x, p.y, p.z))]


def from_path(message: Any) -> list[Row]:
    """Return the poses of a Path, each with the stamp of its own header."""
    return [row for pose in message.poses for row in from_pose_stamped(pose)]


CONVERTERS: dict[str, Callable[[Any], list[Row]]] = {
    'nav_msgs/msg/Odometry': from_pose_with_covariance,
    'geometry_msgs/msg/PoseStamped': from_pose_stamped,
    'geometry_msgs/msg/PoseWithCovarianceStamped': from_pose_with_covariance,
    'geometry_msgs/msg/TransformStamped': from_transform_stamped,
    'geometry_msgs/msg/PointStamped': from_point_stamped,
    PATH: from_path,
}


def collect(msgtype: str, messages: Iterable[Any]) -> Poses:
    """
    Return the poses of messages of one type, in the order in which they arrived.

    :param msgtype: a key of :data:`CONVERTERS`; the poses of several Paths are concatenated,
        for :class:`PathRevisions` to make one trajectory of.
    """
    convert = CONVERTERS[msgtype]
    return poses(*columns([row for message in messages for row in convert(message)]))


def columns(rows: list[Row]) -> tuple[np.ndarray, np.ndarray]:
    """Return the (N,) stamps and the (N, 3), (N, 7) or (N, 43) numbers of rows."""
    if not rows:
        return np.empty(0, np.int64), np.empty((0, 7))
    stamps, numbers = zip(*rows, strict=True)
    return np.array(stamps, np.int64), np.array(numbers, np.float64)


def poses(stamps_ns: np.ndarray, numbers: np.ndarray) -> Poses:
    """
    Return poses of columns of numbers.

    An unusable covariance is NaN: it is all zero, has a negative variance (-1 means unknown) or a
    number that is not finite.

    :param stamps_ns: (N,) int64 nanoseconds.
    :param numbers: (N, 3), (N, 7) or (N, 43), as the numbers of a :data:`Row`.
    """
    rotations = numbers[:, 3:7].copy() if numbers.shape[1] > 3 else None
    covariances = _covariances(numbers[:, 7:]) if numbers.shape[1] > 7 else None
    return Poses(stamps_ns, numbers[:, :3].copy(), rotations, covariances, zero_is_unset=True)


def _covariances(numbers: np.ndarray) -> np.ndarray | None:
    """
    Return the (N, 2, 3, 3) position and orientation blocks of (N, 36) row-major matrices.

    None if no matrix is usable: most publishers leave them zero.
    """
    matrices = numbers.reshape(-1, 6, 6)
    variances = np.diagonal(matrices, axis1=1, axis2=2)
    usable = np.isfinite(numbers).all(axis=1) & numbers.any(axis=1) & (variances >= 0).all(axis=1)
    if not usable.any():
        return None
    blocks = np.stack([matrices[:, :3, :3], matrices[:, 3:, 3:]], axis=1)
    blocks[~usable] = np.nan
    return blocks


class PathRevisions:
    """
    One trajectory from the Path messages of a topic, each of which revises all of it.

    Of the poses with the same stamp one remains: the latest published (final, what the system made
    of the run in the end), and the first (causal, what it knew at the time).

    :param source: what an error names, the topic for example.
    """

    def __init__(self, source: str = PATH) -> None:
        self._source = source
        self._known_ns = np.empty(0, np.int64)
        self._first: list[Poses] = [Trajectory.empty()]
        self._merged: Poses = Trajectory.empty()
        self._pending: list[Poses] = []
        self._pending_poses = 0
        self._longest = 0
        self._has_distinct_stamps = False

    def add(self, revision: Poses) -> Poses:
        """Take the poses of one more Path message; return those whose stamps are new, sorted."""
        new = revision[:0]
        if not len(revision):
            return new
        self._longest = max(self._longest, len(revision))
        self._has_distinct_stamps |= bool(np.ptp(revision.stamps_ns))
        self._pending.append(revision)
        self._pending_poses += len(revision)
        # Merged in portions, the work stays in proportion to the messages and the memory to the
        # trajectory, though every message repeats all of it.
        if self._pending_poses > 100_000 + 4 * len(self._merged):
            self._merge()
        # np.unique finds the first of equal stamps
        stamps_ns, first = np.unique(revision.stamps_ns, return_index=True)
        is_new = ~np.isin(stamps_ns, self._known_ns, assume_unique=True)
        if is_new.any():
            new = revision[first[is_new]]
            self._first.append(new)
            self._known_ns = np.union1d(self._known_ns, new.stamps_ns)
        return new

    def final(self) -> Poses:
        """
        Return the trajectory as last revised, sorted by stamp.

        :raises ReadError: where the poses of each message share one stamp, zero or another.
        """
        self._check_stamps()
        self._merge()
        return self._merged

    def causal(self) -> Poses:
        """Return the trajectory as first published, sorted by stamp; raises as final does."""
        self._check_stamps()
        self._first = [Poses.concatenate(self._first)]
        return self._first[0][np.argsort(self._first[0].stamps_ns)]

    def _check_stamps(self) -> None:
        unstamped = len(self._known_ns) and not self._known_ns.any()
        if unstamped or (self._longest > 1 and not self._has_distinct_stamps):
            raise ReadError(
                self._source,
                'the poses of its Path messages carry no stamps of their own; have the publisher '
                'fill poses[].header.stamp, or score a topic of single poses',
            )

    def _merge(self) -> None:
        joined = Poses.concatenate([self._merged, *self._pending])
        self._pending, self._pending_poses = [], 0
        # of the reversed the first of equal stamps, so the last
        last = len(joined) - 1 - np.unique(joined.stamps_ns[::-1], return_index=True)[1]
        self._merged = joined[last]
