"""Intervals between stamps, and how long one may be that still counts as tracking."""

from __future__ import annotations

import numpy as np

#: an interval may be as many median intervals long, where that is more than ``max_gap_s``
MEDIAN_INTERVALS = 3


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


class Intervals:
    """
    Durations between consecutive stamps, and how much of them was without a longer gap.

    Intervals up to the gap are only summed; the few longer ones are kept, since the limit may
    turn out to be larger.
    """

    def __init__(self, gap_ns: int) -> None:
        self._gap_ns = gap_ns
        self._last_ns: int | None = None
        self._short_sum_ns = 0
        self._long_ns = np.empty(0, np.int64)

    def add(self, stamps: np.ndarray) -> np.ndarray:
        """Add the next stamps of the series; return the intervals that they end."""
        if not len(stamps):
            return np.empty(0, np.int64)
        start = stamps[0] if self._last_ns is None else self._last_ns
        intervals = np.diff(stamps, prepend=start)[self._last_ns is None :]
        self._last_ns = int(stamps[-1])
        short = intervals <= self._gap_ns
        self._short_sum_ns += int(intervals[short].sum())
        self._long_ns = np.concatenate([self._long_ns, intervals[~short]])
        return intervals

    def total_ns(self, limit_ns: float) -> int:
        """Return the sum of the intervals up to a limit that is not below the gap."""
        return self._short_sum_ns + int(self._long_ns[self._long_ns <= limit_ns].sum())
