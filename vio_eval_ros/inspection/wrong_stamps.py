"""Stamps that are wrong for a moment: nothing is missing there, and all else is judged without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vio_eval_ros.core.sensor_stream import lower_median, SensorStream
from vio_eval_ros.inspection.finding import are, Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.timing import (
    longest,
    PERIODIC_SHARE,
    REPEATED_PERIODS,
    SAME_PERIOD,
)

# Where more than this part of the stamps leave the sequence, that is jitter
RARE_SHARE = 0.01
# Fewer messages do not show which of their stamps is wrong
MIN_MESSAGES = 5


def corrected(stream: SensorStream) -> tuple[SensorStream, list[Finding]]:
    """
    Return a stream with wrong stamps as they should be, and that they were wrong.

    Stamps are wrong where they step away from those before, and those after step back by as much:
    the number of messages in between is right, so none is missing.
    """
    if stream.stamps_ns is None or len(stream) < MIN_MESSAGES:
        return stream, []
    steps = np.diff(stream.stamps_ns) / 1e9
    period = lower_median(np.abs(steps))
    if np.mean(np.abs(steps - period) < SAME_PERIOD * period) < PERIODIC_SHARE:
        return stream, []
    off_ns, firsts, lasts = _excursions(steps, period)
    count, most_s = int(np.count_nonzero(off_ns)), float(np.abs(off_ns).max()) / 1e9
    if not count or 2 * count > len(stream) or len(firsts) > RARE_SHARE * len(stream):
        return stream, []
    finding = FINDINGS['wrong_stamp'].found(
        stream,
        severe=stream.is_sensor and most_s > period,
        messages=are(count, 'message'),
        count=count,
        value=most_s,
        moments=stream.moments(firsts, lasts),
    )
    return replace(stream, stamps_ns=stream.stamps_ns - off_ns), [finding]


def _excursions(steps: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return by how many nanoseconds stamps are off, and the first and last message of each stretch.

    :param steps: (N - 1,) seconds between N stamps, in the order of the file.
    """
    leaps = np.flatnonzero(np.abs(steps - period) > longest(steps, period) - period)
    sizes = steps[leaps] - period
    comes_back = np.abs(sizes[:-1] + sizes[1:]) < SAME_PERIOD * period
    # a message that is lost, and one that comes twice, are just that
    is_twice = np.abs(steps[leaps]) <= REPEATED_PERIODS * period
    comes_back &= ~is_twice[:-1] & ~is_twice[1:]
    off_ns = np.zeros(len(steps) + 1, np.int64)
    firsts, lasts = [], []
    last = 0
    for k in np.flatnonzero(comes_back).tolist():
        begin, end = int(leaps[k]) + 1, int(leaps[k + 1]) + 1
        if begin >= last and 2 * (end - begin) < len(off_ns):
            off_ns[begin:end] = round(1e9 * float(sizes[k] - sizes[k + 1]) / 2)
            firsts.append(begin)
            lasts.append(end - 1)
            last = end + 1
    return off_ns, np.array(firsts, int), np.array(lasts, int)
