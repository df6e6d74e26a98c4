"""Stamps that are wrong for a moment: nothing is missing there, and all else is judged without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vio_eval_ros.core.sensor_stream import lower_median, SensorStream
from vio_eval_ros.inspection.findings import are, Finding
from vio_eval_ros.inspection.timing import ALIKE, HALF, longest, NEAR

# Where stamps are off more often, in so many of the messages, that is jitter
OFTEN = 0.01


def corrected(stream: SensorStream) -> tuple[SensorStream, list[Finding]]:
    """
    Return a stream with wrong stamps as they should be, and that they were wrong.

    A stamp is wrong where it goes away from those before and those behind come back by as much:
    the number of messages in between is right, so none is missing.
    """
    if stream.stamps_ns is None or len(stream) < 5:
        return stream, []
    stamps_ns = stream.stamps_ns
    steps = np.diff(stamps_ns) / 1e9
    period = lower_median(np.abs(steps))
    if np.mean(np.abs(steps - period) < ALIKE * period) < HALF:
        return stream, []
    leaps = np.flatnonzero(np.abs(steps - period) > longest(steps, period) - period)
    sizes = steps[leaps] - period
    comes_back = np.abs(sizes[:-1] + sizes[1:]) < ALIKE * period
    # a message that is lost, and one that comes twice, are just that
    is_twice = np.abs(steps[leaps]) <= NEAR * period
    comes_back &= ~is_twice[:-1] & ~is_twice[1:]
    off_ns = np.zeros(len(stream), np.int64)
    firsts, lasts = [], []
    last = 0
    for k in np.flatnonzero(comes_back).tolist():
        begin, end = int(leaps[k]) + 1, int(leaps[k + 1]) + 1
        if begin >= last and 2 * (end - begin) < len(stream):
            off_ns[begin:end] = round(1e9 * float(sizes[k] - sizes[k + 1]) / 2)
            firsts.append(begin)
            lasts.append(end - 1)
            last = end + 1
    count, most_s = int(np.count_nonzero(off_ns)), float(np.abs(off_ns).max()) / 1e9
    if not count or 2 * count > len(stream) or len(firsts) > OFTEN * len(stream):
        return stream, []
    moments = stream.moments(np.array(firsts), np.array(lasts))
    level = 'fail' if stream.is_sensor and most_s > period else 'warn'
    finding = Finding(
        'wrong_stamp', stream.topic, level,
        f'{are(count, "message")} stamped wrong, by up to {most_s:.3g} s, between others that are '
        'not; none is missing there',
        count, most_s, 's', moments,
    )  # fmt: skip
    return replace(stream, stamps_ns=stamps_ns - off_ns), [finding]
