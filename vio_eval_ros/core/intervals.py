"""Intervals between stamps, and how long one may be that still counts as tracking."""

from __future__ import annotations

import math

import numpy as np

#: an interval may be as many median intervals long, where that is more than ``max_gap_s``
MEDIAN_INTERVALS = 3
#: logarithms of intervals in nanoseconds, up to the longest that 64 bits hold
BIN_WIDTH = 0.01
BINS = 4400


def nanoseconds(seconds: float) -> int:
    """Return a duration in whole nanoseconds."""
    return round(seconds * 1e9)


def longest_tracked(max_gap: float, median: float) -> float:
    """
    Return the longest interval between poses that counts as tracking.

    :param max_gap: the option ``max_gap_s``.
    :param median: of the intervals between the poses, in the same unit.
    """
    return max(max_gap, MEDIAN_INTERVALS * median)


class TrackingLimit:
    """
    The longest interval that counts as tracking, of a stream that arrives in batches.

    The limit is above the gap only where the median interval is above a third of it. Hence the
    shorter intervals are only counted; those that may be the median are kept.
    """

    def __init__(self, gap_ns: int) -> None:
        self._gap_ns = gap_ns
        self._short = 0
        self._longest_short_ns = 0
        self._long_ns = np.empty(0, np.int64)

    def add(self, intervals: np.ndarray) -> None:
        """Take in the next intervals [ns] of the stream."""
        is_long = MEDIAN_INTERVALS * intervals > self._gap_ns
        self._long_ns = np.concatenate([self._long_ns, intervals[is_long]])
        self._short += len(intervals) - int(np.count_nonzero(is_long))
        longest_ns = int(intervals[~is_long].max(initial=0))
        self._longest_short_ns = max(self._longest_short_ns, longest_ns)

    def longest_ns(self) -> float:
        """Return the limit for the intervals so far."""
        if len(self._long_ns) < max(self._short, 1):
            return self._gap_ns
        short_ns = np.full(self._short, self._longest_short_ns)
        median_ns = float(np.median(np.concatenate([short_ns, self._long_ns])))
        return longest_tracked(self._gap_ns, median_ns)


class MedianInterval:
    """
    The median interval of a stream that arrives in batches, in memory that does not grow.

    Intervals are counted in bins a percent wide: enough to tell which of two streams is denser.
    """

    def __init__(self) -> None:
        self._bins = np.zeros(BINS, np.int64)

    def add(self, intervals: np.ndarray) -> None:
        """Take in the next intervals [ns] of the stream, all positive."""
        bins = (np.log(intervals) / BIN_WIDTH).astype(np.int64)
        self._bins += np.bincount(bins, minlength=BINS)

    def ns(self) -> float:
        """Return the median of the intervals so far; NaN where there are none."""
        passed = np.cumsum(self._bins)
        if not passed[-1]:
            return math.nan
        return math.exp(BIN_WIDTH * float(np.searchsorted(passed, (passed[-1] + 1) // 2)))


class Intervals:
    """
    The time between consecutive stamps, and how much of it lies in intervals up to a limit.

    Intervals up to the gap are only summed; the few longer ones are kept, since the limit may
    become larger.
    """

    def __init__(self, gap_ns: int) -> None:
        self._gap_ns = gap_ns
        self._last_ns: int | None = None
        #: from the first stamp to the last
        self.span_ns = 0
        self._short_sum_ns = 0
        self._long_ns = np.empty(0, np.int64)

    def add(self, stamps: np.ndarray) -> np.ndarray:
        """Add the next stamps of the series; return the intervals that they end."""
        if not len(stamps):
            return np.empty(0, np.int64)
        start = stamps[0] if self._last_ns is None else self._last_ns
        intervals = np.diff(stamps, prepend=start)[self._last_ns is None :]
        self._last_ns = int(stamps[-1])
        self.span_ns += int(intervals.sum())
        short = intervals <= self._gap_ns
        self._short_sum_ns += int(intervals[short].sum())
        self._long_ns = np.concatenate([self._long_ns, intervals[~short]])
        return intervals

    def total_ns(self, limit_ns: float) -> int:
        """Return the sum of the intervals up to a limit that is not below the gap."""
        return self._short_sum_ns + int(self._long_ns[self._long_ns <= limit_ns].sum())
