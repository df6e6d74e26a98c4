"""
Messages to poses.

The messages may come from rclpy, rosbags, JSON or protobuf: all have the same fields, and none of
these is imported here. A further message type is a line in :data:`CONVERTERS`; where
the definition of a type shows its one pose, it needs none, see
:mod:`~vio_eval_ros.recordings.definitions`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from vio_eval_ros.core.trajectory import Poses, Trajectory
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings import px4
from vio_eval_ros.recordings.geographic import Origin, Projection

PATH = 'nav_msgs/msg/Path'
NO_FIX = -1  # the status of a NavSatFix and of a GPSFix
#: how the covariance of a fix may say that it is unknown: as a number, and in JSON by its name
UNKNOWN_TYPES = (0, 'UNKNOWN')
POSITION_CELLS = 9

# The numbers of a pose: the position, then the quaternion x y z w and then the row-major 6 x 6
# covariance, where the message has them; or the position and its row-major 3 x 3 covariance.
Numbers = tuple[float, ...]
# The stamp [ns] and the numbers of a pose.
Row = tuple[int, Numbers]


class Adjustment(Protocol):
    """What makes poses in metres of the numbers of a stream, part by part."""

    def __call__(self, numbers: np.ndarray) -> np.ndarray:
        """Return the numbers of poses for further (N, M) numbers of a message type."""

    def notes(self) -> list[str]:
        """Return what has been done, in sentences."""

    @property
    def origin(self) -> Origin | None:
        """Latitude, longitude [deg] and height [m] of what the poses are relative to, if any."""


@dataclass(frozen=True)
class Converter:
    """
    How the poses in a message of one type are read.

    :param rows: of a message; the stamps are 0 where the type has none.
    :param is_stamped: whether the type has a stamp.
    :param adjustment: makes poses of the numbers, where they are not yet.
    :param is_usual: whether the type is one that odometry and ground truth usually come in.
    :param from_boot: whether stamps may count from the start of a device.
    :param notes: what was taken for granted, in sentences.
    """

    rows: Callable[[Any], list[Row]]
    is_stamped: bool = True
    adjustment: Callable[[], Adjustment] | None = None
    is_usual: bool = False
    from_boot: bool = False
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class ArrayConverter:
    """
    How one of the poses in a message of one type is read.

    :param elements: the names (or indices) of the poses in a message, and what has their numbers.
    :param numbers: of an element.
    :param stamp_ns: of a message; None where the type has no stamp.
    :param notes: what was taken for granted, in sentences.
    :param by_index: whether the elements have no names.
    """

    elements: Callable[[Any], Iterable[tuple[str, Any]]]
    numbers: Callable[[Any], Numbers]
    stamp_ns: Callable[[Any], int] | None
    notes: tuple[str, ...] = ()
    by_index: bool = False


def stamp_ns(stamp: Any) -> int:
    """Return a stamp of ROS, JSON or protobuf in nanoseconds."""
    if hasattr(stamp, 'nanosec'):
        return int(stamp.sec * 1_000_000_000 + stamp.nanosec)
    if hasattr(stamp, 'nsec'):
        return int(stamp.sec * 1_000_000_000 + stamp.nsec)
    return int(stamp.seconds * 1_000_000_000 + stamp.nanos)


def header_ns(message: Any) -> int:
    """Return the stamp in the header of a message."""
    return stamp_ns(message.header.stamp)


def xyz(vector: Any) -> Numbers:
    """Return the components of a vector."""
    return vector.x, vector.y, vector.z


def xyzw(quaternion: Any) -> Numbers:
    """Return the components of a quaternion."""
    return quaternion.x, quaternion.y, quaternion.z, quaternion.w


def pose_numbers(pose: Any) -> Numbers:
    """Return the numbers of a Pose."""
    return (*xyz(pose.position), *xyzw(pose.orientation))


def transform_numbers(transform: Any) -> Numbers:
    """Return the numbers of a Transform."""
    return (*xyz(transform.translation), *xyzw(transform.rotation))


def covariant_numbers(pose: Any) -> Numbers:
    """Return the numbers of a PoseWithCovariance."""
    return (*pose_numbers(pose.pose), *pose.covariance)


def geographic_numbers(position: Any) -> Numbers:
    """Return latitude and longitude [deg] and altitude [m]."""
    return position.latitude, position.longitude, position.altitude


def geographic_pose_numbers(pose: Any) -> Numbers:
    """Return the numbers of a GeoPose."""
    return (*geographic_numbers(pose.position), *xyzw(pose.orientation))


def fix_numbers(fix: Any) -> Numbers:
    """
    Return where a satellite fix is and the covariance [m²] of that, along east, north and up.

    The position is NaN where its status says that there is none (-1), the covariance where its
    type says that it is unknown.
    """
    status = getattr(fix, 'status', None)
    has_fix = status is None or getattr(status, 'status', None) != NO_FIX
    position = geographic_numbers(fix) if has_fix else (np.nan,) * 3
    cells = tuple(getattr(fix, 'position_covariance', ()))
    kind = getattr(fix, 'position_covariance_type', UNKNOWN_TYPES[0])
    is_known = len(cells) == POSITION_CELLS and kind not in UNKNOWN_TYPES
    return (*position, *(cells if is_known else (np.nan,) * POSITION_CELLS))


def from_transform_stamped(message: Any) -> list[Row]:
    """Return the pose of the child frame in the frame of the header."""
    return [(header_ns(message), transform_numbers(message.transform))]


def from_path(message: Any) -> list[Row]:
    """Return the poses of a Path, each with the stamp of its own header."""
    return [(header_ns(pose), pose_numbers(pose.pose)) for pose in message.poses]


def _usual(field: str, numbers: Callable[[Any], Numbers]) -> Converter:
    """Return how a message with a header and one field is read."""
    return Converter(
        lambda message: [(header_ns(message), numbers(getattr(message, field)))], is_usual=True
    )


def _unstamped(numbers: Callable[[Any], Numbers]) -> Converter:
    """Return how a message that has no header is read."""
    return Converter(lambda message: [(0, numbers(message))], is_stamped=False)


def _geographic(field: str, numbers: Callable[[Any], Numbers]) -> Converter:
    """Return how a message with a header and a field in latitude and longitude is read."""
    return Converter(
        lambda message: [(header_ns(message), numbers(getattr(message, field)))],
        adjustment=Projection,
    )


def _of_px4(
    numbers: Callable[[Any], Numbers], adjustment: Callable[[], Adjustment] = px4.Upright
) -> Converter:
    """Return how a message of PX4 is read."""
    return Converter(
        lambda message: [(px4.stamp_ns(message), numbers(message))],
        adjustment=adjustment,
        from_boot=True,
    )


_FIX = Converter(lambda fix: [(header_ns(fix), fix_numbers(fix))], adjustment=Projection)
CONVERTERS: dict[str, Converter | ArrayConverter] = {
    'nav_msgs/msg/Odometry': _usual('pose', covariant_numbers),
    'geometry_msgs/msg/PoseStamped': _usual('pose', pose_numbers),
    'geometry_msgs/msg/PoseWithCovarianceStamped': _usual('pose', covariant_numbers),
    'geometry_msgs/msg/TransformStamped': Converter(from_transform_stamped, is_usual=True),
    'geometry_msgs/msg/PointStamped': _usual('point', xyz),
    PATH: Converter(from_path, is_usual=True),
    'geometry_msgs/msg/Pose': _unstamped(pose_numbers),
    'geometry_msgs/msg/PoseWithCovariance': _unstamped(covariant_numbers),
    'geometry_msgs/msg/Transform': _unstamped(transform_numbers),
    'geometry_msgs/msg/Point': _unstamped(xyz),
    'geometry_msgs/msg/PoseArray': ArrayConverter(
        lambda message: _numbered(message.poses), pose_numbers, header_ns, by_index=True
    ),
    'sensor_msgs/msg/NavSatFix': _FIX,
    'gps_msgs/msg/GPSFix': _FIX,
    'gps_common/msg/GPSFix': _FIX,
    'geographic_msgs/msg/GeoPointStamped': _geographic('position', geographic_numbers),
    'geographic_msgs/msg/GeoPoseStamped': _geographic('pose', geographic_pose_numbers),
    **{name: _of_px4(px4.odometry_numbers) for name in px4.ODOMETRY},
    **{name: _of_px4(px4.local_position_numbers) for name in px4.LOCAL_POSITION},
    **{name: _of_px4(px4.global_position_numbers, Projection) for name in px4.GLOBAL_POSITION},
    'foxglove.PoseInFrame': Converter(
        lambda message: [(stamp_ns(message.timestamp), pose_numbers(message.pose))]
    ),
    'foxglove.PosesInFrame': ArrayConverter(
        lambda message: _numbered(message.poses),
        pose_numbers,
        lambda message: stamp_ns(message.timestamp),
        by_index=True,
    ),
    'foxglove.LocationFix': Converter(
        lambda fix: [(stamp_ns(fix.timestamp), fix_numbers(fix))], adjustment=Projection
    ),
}
# of ROS, with one stamped pose in a message: what can be scored as it arrives
STREAMED = tuple(
    name
    for name, converter in CONVERTERS.items()
    if isinstance(converter, Converter) and converter.is_stamped and '/' in name
)
USUAL = tuple(
    name
    for name, converter in CONVERTERS.items()
    if isinstance(converter, Converter) and converter.is_usual
)


def _numbered(elements: Iterable[Any]) -> Iterator[tuple[str, Any]]:
    """Yield the elements of a list with their indices."""
    return ((str(k), one) for k, one in enumerate(elements))


def adjustment_of(msgtype: str) -> Adjustment | None:
    """Return what makes poses of the numbers of a new stream; None where they are that already."""
    converter = CONVERTERS[msgtype]
    assert isinstance(converter, Converter)
    return converter.adjustment() if converter.adjustment else None


def collect(msgtype: str, messages: Iterable[Any], adjustment: Adjustment | None = None) -> Poses:
    """
    Return the poses of messages of one type, in the order in which they arrived.

    :param msgtype: of :data:`STREAMED`; the poses of several Paths are concatenated, for
        :class:`PathRevisions` to make one trajectory of.
    :param adjustment: that of earlier messages of the stream.
    """
    converter = CONVERTERS[msgtype]
    assert isinstance(converter, Converter)
    stamps, numbers = columns([row for message in messages for row in converter.rows(message)])
    adjust = adjustment or adjustment_of(msgtype)
    if adjust and len(stamps):
        numbers = adjust(numbers)
    return poses(stamps, numbers)


def columns(rows: list[Row]) -> tuple[np.ndarray, np.ndarray]:
    """Return the (N,) stamps and the (N, 3), (N, 7), (N, 12) or (N, 43) numbers of rows."""
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
    :param numbers: (N, 3), (N, 7), (N, 12) or (N, 43), as the numbers of a :data:`Row`.
    """
    width = numbers.shape[1]
    is_place = width == 3 + POSITION_CELLS
    rotations = numbers[:, 3:7].copy() if width > 3 and not is_place else None
    begin = 3 if is_place else 7
    covariances = covariance_blocks(numbers[:, begin:]) if width > begin else None
    return Poses(stamps_ns, numbers[:, :3].copy(), rotations, covariances, zero_is_unset=True)


def covariance_blocks(numbers: np.ndarray) -> np.ndarray | None:
    """
    Return the (N, 2, 3, 3) position and orientation blocks of (N, 36) row-major matrices.

    Of (N, 9) matrices, which are of a position, the orientation is NaN. None if no matrix is
    usable: most publishers leave them zero.
    """
    size = 3 if numbers.shape[1] == POSITION_CELLS else 6
    matrices = numbers.reshape(-1, size, size)
    variances = np.diagonal(matrices, axis1=1, axis2=2)
    usable = np.isfinite(numbers).all(axis=1) & numbers.any(axis=1) & (variances >= 0).all(axis=1)
    if not usable.any():
        return None
    blocks = np.full((len(matrices), 2, 3, 3), np.nan)
    blocks[:, 0] = matrices[:, :3, :3]
    if size > 3:
        blocks[:, 1] = matrices[:, 3:, 3:]
    blocks[~usable] = np.nan
    return blocks


class PathRevisions:
    """
    One trajectory from the Path messages of a topic, each of which revises all of it.

    Of the poses with the same stamp one remains: the latest published (final, what the system made
    of the run in the end), and the first (causal, what it knew at the time).

    :param source: what an error names, the topic for example.
    """

    #: what was left out: nothing
    warnings: Sequence[str] = ()

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
