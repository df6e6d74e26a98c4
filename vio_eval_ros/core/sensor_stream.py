"""The messages of one topic as columns of numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.trajectory import Poses

#: larger values cannot be measurements of an IMU or poses; they come from misread bytes
LARGEST_MEASUREMENT = 1e12
#: at most this many occurrences are listed
MAX_MOMENTS = 200
#: simulated time begins with 0: that is a stamp if the next message follows within this many
#: periods
MAX_FIRST_PERIODS = 5.0


class Moment(NamedTuple):
    """An interval, by the stamps and by the clock of the recorder."""

    begin_ns: int
    end_ns: int
    logged_begin_ns: int
    logged_end_ns: int


@dataclass(frozen=True, eq=False)
class SensorStream:
    """
    The messages of a topic, in the order in which they were written.

    :param msgtype: as ROS 2 spells it.
    :param kind: what is in it, one of camera, imu, pose and other.
    :param logged_ns: (N,) int64 nanoseconds, when each was recorded; None where unknown.
    :param stamps_ns: (N,) int64 nanoseconds, of their headers; None where they have none.
    :param frames: how many messages name each frame.
    :param numbers: (N, 6) of an IMU, rad/s and m/s²; (N, 3) or (N, 7) of poses, x y z in metres
        and quaternions x y z w; None for other kinds.
    :param lacks: which of ``gyroscope`` and ``accelerometer`` an IMU declares that it does not
        have; those numbers are zero.
    :param transforms: of a TF topic, the poses of each child frame in its parent, by
        'PARENT.CHILD'; of a very long one, from its beginning only.
    """

    topic: str
    msgtype: str
    kind: str
    logged_ns: np.ndarray | None
    stamps_ns: np.ndarray | None
    frames: Mapping[str, int]
    numbers: np.ndarray | None = None
    lacks: tuple[str, ...] = ()
    transforms: Mapping[str, Poses] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.times_ns)

    @property
    def times_ns(self) -> np.ndarray:
        """(N,) int64 nanoseconds: the stamps, or without stamps when they were recorded."""
        times = self.logged_ns if self.stamps_ns is None else self.stamps_ns
        assert times is not None
        return times

    @property
    def arrivals_ns(self) -> np.ndarray:
        """(N,) int64 nanoseconds: when they were recorded, or the stamps where that is unknown."""
        return self.times_ns if self.logged_ns is None else self.logged_ns

    @property
    def is_sensor(self) -> bool:
        """Whether it is an input of a VIO."""
        return self.kind in ('camera', 'imu')

    @property
    def has_poses(self) -> bool:
        """Whether what it holds can be scored: poses, or transforms that are sent again."""
        is_static = 'static' in self.topic.rpartition('/')[2].lower()
        sent_again = any(len(sent) > 1 for sent in self.transforms.values())
        return self.kind == 'pose' or (sent_again and not is_static)

    @property
    def is_usable(self) -> np.ndarray:
        """(N,) whether all numbers of a message are finite and not absurdly large."""
        assert self.numbers is not None
        return (np.abs(self.numbers) < LARGEST_MEASUREMENT).all(axis=1)

    @property
    def is_stamped(self) -> np.ndarray:
        """(N,) whether a message has a stamp: 0 is not one, unless a simulation begins there."""
        assert self.stamps_ns is not None
        known = self.stamps_ns != 0
        later = self.stamps_ns[1:]
        if len(later) > 1 and not known[0] and later[0] > 0:
            known[0] = later[0] <= MAX_FIRST_PERIODS * lower_median(np.abs(np.diff(later)))
        return known

    def stamped(self) -> SensorStream:
        """Return the messages that have a stamp; if none has one, all without stamps."""
        if self.stamps_ns is None:
            return self
        known = self.is_stamped
        if known.all():
            return self
        if not known.any() and self.logged_ns is not None:
            return replace(self, stamps_ns=None)
        return replace(
            self,
            logged_ns=None if self.logged_ns is None else self.logged_ns[known],
            stamps_ns=self.stamps_ns[known],
            numbers=None if self.numbers is None else self.numbers[known],
        )

    def moment(self, first: int, last: int) -> Moment:
        """Return the interval from one message to another."""
        ends = (first, last)
        begin_ns, end_ns = sorted(int(self.times_ns[k]) for k in ends)
        logged_ns, logged_end_ns = sorted(int(self.arrivals_ns[k]) for k in ends)
        return Moment(begin_ns, end_ns, logged_ns, logged_end_ns)

    def moments(self, first: np.ndarray, last: np.ndarray) -> tuple[Moment, ...]:
        """Return the intervals between pairs of messages, at most MAX_MOMENTS of them."""
        pairs = zip(first[:MAX_MOMENTS].tolist(), last[:MAX_MOMENTS].tolist(), strict=True)
        return tuple(self.moment(*pair) for pair in pairs)


def runs(is_so: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first index of each run of true values, and one past its last."""
    edges = np.diff(np.concatenate([[0], is_so.astype(np.int8), [0]]))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)


def lower_median(values: np.ndarray) -> float:
    """Return the median; of an even number of values the lower of the middle two."""
    return float(np.quantile(values, 0.5, method='lower'))


def spread(values: np.ndarray) -> float:
    """Return a robust standard deviation, from the median absolute deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))
