"""Intervals between stamps: which of them count as tracking."""

import numpy as np
import pytest

from vio_eval_ros.core.intervals import Intervals, longest_tracked, nanoseconds, TrackingLimit


def test_an_interval_may_be_as_long_as_the_gap_or_as_three_of_a_slow_stream():
    assert longest_tracked(0.5, median=0.1) == 0.5
    assert longest_tracked(0.5, median=0.4) == 3 * 0.4


def test_batches_give_the_intervals_of_the_whole():
    stamps = np.array([0, 1, 3, 10, 11, 30])
    whole, parts = Intervals(2), Intervals(2)
    ended = whole.add(stamps).tolist()
    assert ended == [1, 2, 7, 1, 19]
    assert [k for part in np.split(stamps, [1, 1, 4]) for k in parts.add(part).tolist()] == ended
    for limit, total in ((2, 4), (7, 11), (19, 30)):
        assert whole.total_ns(limit) == parts.total_ns(limit) == total


def test_seconds_are_rounded_to_whole_nanoseconds():
    assert nanoseconds(0.1) == 100_000_000
    assert nanoseconds(-1.5e-9) == -2


@pytest.mark.parametrize(
    'intervals', [[], [1], [200], [200] * 5 + [1] * 5, [200] * 5 + [1] * 6, [90, 40, 200, 300, 31]]
)
def test_the_limit_of_batches_is_that_of_all_intervals(intervals):
    limit = TrackingLimit(100)
    for interval in intervals:
        limit.add(np.array([interval]))
    median = float(np.median(intervals)) if intervals else 0.0
    expected = longest_tracked(100, median)
    # with as many short as long intervals the median lies between; the longest short one bounds it
    assert limit.longest_ns() == expected
