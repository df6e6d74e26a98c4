"""
A record of an IMU, put in order while it is read, in memory that does not grow with its length.

Samples are sorted by stamp, repeats are left out, a few lost samples are bridged and longer gaps
cut the record into segments. Where a record exceeds the capacity, first two, then four and so on
consecutive samples are averaged into one, which leaves longer averaging times as they are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.sensor_stream import LARGEST_MEASUREMENT
from vio_eval_ros.errors import ReadError
from vio_eval_ros.imu.limits import ImuNoiseLimits

AXES = ('gyro_x', 'gyro_y', 'gyro_z', 'accel_x', 'accel_y', 'accel_z')
GRAVITY_M_S2 = 9.81  # nominal
CAPACITY = 6_000_000  # samples kept: 8 h at 200 Hz, 288 MB
SORTED_SAMPLES = 1 << 16  # held back, to sort in those that come late
GAP_NEIGHBOURS = 16  # samples on either side of a long step, which show whether it is a gap
MIN_SAMPLES = 10
PERIOD_STRIDE = 64  # samples over which the period is first taken: more than a burst has
NOT_NUMBERS = 'NaN, infinite or above 1e12'
CONSTANT_STAMPS = 'its stamps do not advance; have the driver set them'


@dataclass
class Counts:
    """
    Numbers of samples, and of gaps, in a record.

    :param samples: read.
    :param unsorted: came after others with a later stamp, and were sorted.
    :param late: came too late for that, and were left out.
    :param not_finite: left out for a NaN, an infinity or a number above 1e12.
    :param repeated: left out since they had stamp and values of the previous one.
    :param equal_stamps: had the stamp of the previous one, but other values.
    :param missing: lost, few enough in a row to be bridged: those on either side are taken to
        follow each other, which leaves white noise as it is.
    :param gaps: longer losses, which cut the record.
    :param lost: in those gaps.
    :param cut: left out so that whole groups are averaged.
    """

    samples: int = 0
    unsorted: int = 0
    late: int = 0
    not_finite: int = 0
    repeated: int = 0
    equal_stamps: int = 0
    missing: int = 0
    gaps: int = 0
    lost: int = 0
    cut: int = 0


class Segment(NamedTuple):
    """
    The samples between two gaps.

    :param begin_s: after the first stamp of the record, as is ``end_s``.
    :param parts: (6, n) each, a row per axis of ``AXES``.
    """

    begin_s: float
    end_s: float
    parts: list[np.ndarray]

    @property
    def length(self) -> int:
        """Number of samples."""
        return sum(part.shape[1] for part in self.parts)


@dataclass(frozen=True, eq=False)
class Signal:
    """
    Evenly spaced samples, except for those that are missing.

    :param rate_hz: at which the sensor makes them, after averaging.
    :param averaged: how many recorded samples each is the average of.
    :param first_ns: stamp of the first.
    """

    rate_hz: float
    averaged: int
    first_ns: int
    segments: list[Segment]
    counts: Counts

    @property
    def missing(self) -> float:
        """The share of the samples that is missing."""
        there = self.averaged * sum(segment.length for segment in self.segments)
        return self.counts.missing / (self.counts.missing + there)

    @property
    def mean_rate_hz(self) -> float:
        """The rate of the samples that are present."""
        return self.rate_hz * (1 - self.missing)

    @property
    def duration_s(self) -> float:
        """The duration of all segments together."""
        return sum(segment.length for segment in self.segments) / self.mean_rate_hz

    def axis(self, index: int) -> Iterator[np.ndarray]:
        """Yield the (n,) samples of one axis, segment by segment."""
        for segment in self.segments:
            yield np.concatenate([part[index] for part in segment.parts])

    def times_s(self, size: int) -> np.ndarray:
        """Return when each group of ``size`` samples begins, counted within segments."""
        return np.concatenate(
            [
                begin_s + (end_s - begin_s) * size / count * np.arange(count // size)
                for begin_s, end_s, count in (
                    (segment.begin_s, segment.end_s, segment.length) for segment in self.segments
                )
            ]
        )


@dataclass(eq=False)
class Record:
    """
    Takes the samples of an IMU in blocks, as they come.

    :param source: what an error names.
    :param capacity: number of samples kept.
    """

    source: object
    capacity: int = CAPACITY
    limits: ImuNoiseLimits = field(default_factory=ImuNoiseLimits)
    counts: Counts = field(default_factory=Counts)

    def __post_init__(self) -> None:
        self._blocks: list[tuple[np.ndarray, np.ndarray]] = []
        self._waiting = 0
        # the last samples taken over, to compare the next with
        self._previous = np.empty(0, np.int64), np.empty((0, 6))
        self._period_ns = 0.0
        self._edges_ns: list[int] = []  # first and last stamp of each segment
        self._elapsed_ns, self._intervals = 0, 0
        self._averaged = 1
        self._segments: list[list[np.ndarray]] = [[]]
        self._kept = 0
        self._remainder = np.empty((0, 6))

    def add(self, stamps_ns: np.ndarray, samples: np.ndarray) -> None:
        """
        Take a block of samples.

        :param stamps_ns: (N,) int64.
        :param samples: (N, 6), a column per axis of ``AXES``.
        """
        self.counts.samples += len(stamps_ns)
        finite = (np.abs(samples) < LARGEST_MEASUREMENT).all(axis=1)
        if not finite.all():
            self.counts.not_finite += int((~finite).sum())
            stamps_ns, samples = stamps_ns[finite], samples[finite]
        self._blocks.append((stamps_ns, samples))
        self._waiting += len(stamps_ns)
        if self._waiting >= 2 * SORTED_SAMPLES:
            self._take_over(SORTED_SAMPLES)

    def finish(self) -> Signal:
        """
        Return all that was taken.

        :raises ReadError: too few samples, or stamps that do not advance.
        """
        self._take_over(0)
        if self._intervals < MIN_SAMPLES - 1:
            left_out = self.counts.not_finite
            raise ReadError(
                self.source,
                f'there are fewer than {MIN_SAMPLES} samples with stamps'
                + (f'; left out: {left_out:,} {NOT_NUMBERS}' if left_out else ''),
            )
        if not self._elapsed_ns:
            raise ReadError(self.source, CONSTANT_STAMPS)
        self._close()
        self._edges_ns.append(int(self._previous[0][-1]))
        edges_s = (np.array(self._edges_ns).reshape(-1, 2) - self._edges_ns[0]) / 1e9
        segments = [
            Segment(begin_s, end_s, parts)
            for (begin_s, end_s), parts in zip(edges_s.tolist(), self._segments, strict=True)
            if parts
        ]
        period_s = self._elapsed_ns / self._intervals / 1e9
        rate_hz = 1 / period_s / self._averaged
        return Signal(rate_hz, self._averaged, self._edges_ns[0], segments, self.counts)

    def _take_over(self, held: int) -> None:
        """Put the waiting samples in order, and take over all but the last ``held``."""
        stamps, samples = self._ordered()
        old = len(self._previous[0])
        end = max(len(stamps) - held, old)
        self._blocks, self._waiting = [(stamps[end:], samples[end:])], len(stamps) - end
        if end == old:
            return
        if not old:
            self._edges_ns.append(int(stamps[0]))
            self._period_ns = self._period(stamps)
            self._remainder = samples[:1]
        lost = _lost(stamps, self._period_ns)
        begin = max(old, 1)
        lost = lost[begin - 1 : end - 1]
        steps = np.diff(stamps[begin - 1 : end])
        self._elapsed_ns += int(steps[lost == 0].sum())
        self._intervals += int((lost == 0).sum())
        self.counts.equal_stamps += int((steps == 0).sum())
        self._cut(stamps[begin - 1 : end], samples[begin - 1 : end], lost)
        self._previous = (
            stamps[max(end - GAP_NEIGHBOURS, 0) : end],
            samples[max(end - GAP_NEIGHBOURS, 0) : end],
        )

    def _ordered(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the previous and the waiting samples, sorted and without repeats."""
        blocks = [self._previous, *self._blocks]
        stamps = np.concatenate([stamps for stamps, _ in blocks])
        samples = np.concatenate([samples for _, samples in blocks])
        self._blocks = []
        old = len(self._previous[0])
        if old:
            late = stamps < stamps[old - 1]
            late[:old] = False
            if late.any():
                self.counts.late += int(late.sum())
                stamps, samples = stamps[~late], samples[~late]
        if (np.diff(stamps) < 0).any():
            self.counts.unsorted += int((stamps < np.maximum.accumulate(stamps)).sum())
            order = np.argsort(stamps, kind='stable')
            stamps, samples = stamps[order], samples[order]
        same = np.flatnonzero(np.diff(stamps) == 0) + 1
        same = same[(samples[same] == samples[same - 1]).all(axis=1) & (same >= old)]
        if len(same):
            self.counts.repeated += len(same)
            stamps, samples = np.delete(stamps, same), np.delete(samples, same, axis=0)
        return stamps, samples

    def _period(self, stamps: np.ndarray) -> float:
        """Return the period of the samples, whatever their jitter, bursts and gaps."""
        stride = min(PERIOD_STRIDE, len(stamps) - 1)
        if stride < 1:
            return 1.0
        period = float(np.median(np.diff(stamps[::stride]))) / stride
        step = float(np.median(np.diff(stamps)))
        if step > period / 2:  # else samples come in bursts
            period = step
        if period <= 0:
            raise ReadError(self.source, CONSTANT_STAMPS)
        for _ in range(3):
            period = float(
                (stamps[-1] - stamps[0]) / (len(stamps) - 1 + _lost(stamps, period).sum())
            )
        return period

    def _cut(self, stamps: np.ndarray, samples: np.ndarray, lost: np.ndarray) -> None:
        """
        Store samples, the first of which is stored already.

        :param stamps: (N + 1,).
        :param samples: (N + 1, 6).
        :param lost: (N,) samples lost before each of the others.
        """
        cuts = np.flatnonzero(lost > self.limits.max_lost_samples)
        self.counts.gaps += len(cuts)
        self.counts.lost += int(lost[cuts].sum())
        self.counts.missing += int(lost.sum() - lost[cuts].sum())
        first, *others = np.split(samples[1:], cuts)
        self._store(first)
        for cut, piece in zip(cuts.tolist(), others, strict=True):
            self._close()
            self._segments.append([])
            self._edges_ns += [int(stamps[cut]), int(stamps[cut + 1])]
            self._store(piece)

    def _store(self, samples: np.ndarray) -> None:
        samples = np.concatenate([self._remainder, samples])
        # in pairs of groups, so that two can always be averaged later
        whole = len(samples) - len(samples) % (2 * self._averaged)
        self._remainder = samples[whole:].copy()
        self._keep(samples[:whole])
        while self._kept > self.capacity:
            self._average()

    def _keep(self, samples: np.ndarray) -> None:
        if len(samples):
            means = (
                samples.reshape(-1, self._averaged, 6).mean(axis=1)
                if self._averaged > 1
                else samples
            )
            self._segments[-1].append(np.ascontiguousarray(means.T))
            self._kept += len(means)

    def _close(self) -> None:
        """Close the open segment."""
        over = len(self._remainder) % self._averaged
        self.counts.cut += over
        self._keep(self._remainder[: len(self._remainder) - over])
        self._remainder = np.empty((0, 6))

    def _average(self) -> None:
        """Average every two samples into one."""
        for index, parts in enumerate(self._segments):
            joined = np.concatenate(parts, axis=1) if parts else np.empty((6, 0))
            parts.clear()
            even = joined.shape[1] // 2 * 2
            self.counts.cut += (joined.shape[1] - even) * self._averaged
            if even:
                self._segments[index] = [(joined[:, 0:even:2] + joined[:, 1:even:2]) / 2]
        self._averaged *= 2
        self._kept = sum(part.shape[1] for parts in self._segments for part in parts)


def _lost(stamps_ns: np.ndarray, period_ns: float) -> np.ndarray:
    """
    Return how many samples are lost before each but the first.

    A sample that is merely late, or a burst of them, is followed by others that are not. How late
    the samples on either side of a long step are, up to the next, distinguishes it from a loss.
    """
    lost = np.zeros(max(len(stamps_ns) - 1, 0), np.int64)
    elapsed = (stamps_ns - stamps_ns[0]) / period_ns
    steps = np.flatnonzero(np.diff(elapsed) > 1.5)
    if len(steps):
        late = elapsed - np.arange(len(elapsed))
        begins = np.concatenate([[0], steps[:-1] + 1])[:, None]
        ends = np.concatenate([steps[1:], [len(late) - 1]])[:, None]
        past = steps[:, None] - np.arange(GAP_NEIGHBOURS)
        ahead = steps[:, None] + 1 + np.arange(GAP_NEIGHBOURS)
        before = np.where(past >= begins, late[past], np.nan)
        after = np.where(ahead <= ends, late[np.minimum(ahead, ends)], np.nan)
        moved = np.nanmedian(after, axis=1) - np.nanmedian(before, axis=1)
        lost[steps] = np.rint(moved).clip(min=0)
    return lost
