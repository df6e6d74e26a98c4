"""When the messages of a stream come: rate, jitter, gaps, duplicates, order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.sensor_stream import lower_median, Moment, SensorStream, spread
from vio_eval_ros.inspection.finding import are, Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.measured_stream import Timing

#: an interval that exceeds the period by more than this share of it misses a message ...
MISSING_PERIODS = 0.5
#: ... unless jitter explains it: one period in a million is longer by this many spreads
JITTER_SPREADS = 6.0
#: jitter makes periods shorter as often as longer: the longest exceeds the period by at most this
#: many times what the shortest lacks ...
LONGER_THAN_SHORTER = 1.2
#: ... unless that is nearly zero itself: it lacks more than this share of the period
SHORTEST_LACKS_PERIODS = 0.8
#: largest jitter of a short period, as a share of it, and largest deviation of a single interval
SHORT_PERIOD_JITTER = 0.2
SHORT_PERIOD_SINGLE = 0.4
#: stamps in whole milliseconds are common; whoever has coarser ones knows it
COARSEST_RESOLUTION_S = 0.001
#: relative difference up to which two periods are the same
SAME_PERIOD = 0.25
#: share of periods like the median from which a stream is regular ...
REGULAR_SHARE = 0.9
#: ... and from which it has a period at all
PERIODIC_SHARE = 0.5
#: messages come in bursts where, by the median period, more are missing than there are, and at
#: least this share of the intervals is too long
BURST_SHARE = 0.1
#: a message comes twice where it follows the one before within this share of the period, between
#: others that are a period apart
REPEATED_PERIODS = 0.001
#: correlation of stamps with times of recording above which they were stamped on arrival, and the
#: fewest intervals that show it
ARRIVAL_CORRELATION = 0.9
ARRIVAL_INTERVALS = 10


class StampIntervals(NamedTuple):
    """
    The intervals between the distinct times of a stream.

    :param order: (M,) indices of the messages at these times, sorted.
    :param periods_s: (M - 1,) how long they last.
    :param period_s: the usual one.
    :param is_whole: (M - 1,) whether no message is missing in them, ``is_gap`` where many are.
    :param numbers: (M - 1,) how many periods they stand for.
    """

    order: np.ndarray
    periods_s: np.ndarray
    period_s: float
    is_whole: np.ndarray
    is_gap: np.ndarray
    numbers: np.ndarray


def timing(
    stream: SensorStream, limits: InspectionLimits, step: Moment | None = None
) -> tuple[Timing, list[Finding]]:
    """
    Return the figures of a stream, and what is wrong with its stamps.

    :param step: between which stamps their clock was set while messages went on.
    """
    order, repeated = _distinct(stream)
    distinct = stream.times_ns[order]
    backward = np.flatnonzero(np.diff(stream.times_ns) < 0) + 1
    figures = Timing(
        count=len(stream),
        first_ns=int(distinct[0]),
        last_ns=int(distinct[-1]),
        duplicates=len(stream) - len(distinct),
        backward=len(backward),
    )
    # when messages are recorded depends on much that is nobody's fault
    found = [] if stream.stamps_ns is None else list(_order(stream, backward, repeated))
    if len(distinct) < 3:
        return figures, found
    between = _intervals(stream, order, limits, step)
    figures = _figures(figures, between, distinct)
    if stream.stamps_ns is not None:
        found += [
            *_dropped(stream, figures, between),
            *_gap(stream, between),
            *_jitter(stream, figures, between, limits),
        ]
    return figures, found


def _distinct(stream: SensorStream) -> tuple[np.ndarray, np.ndarray]:
    """Return the order of distinct times, and (2, D) which messages have the time of another."""
    order = np.argsort(stream.times_ns, kind='stable')
    steps_ns = np.diff(stream.times_ns[order])
    # of transforms, those of several frames come together
    is_again = np.append(False, steps_ns <= 0 if stream.kind == 'other' else _twice(steps_ns))
    repeated = np.stack([order[np.flatnonzero(is_again) - 1], order[is_again]])
    return order[~is_again], repeated


def _twice(steps: np.ndarray) -> np.ndarray:
    """Return which intervals, in nanoseconds, are not any: a message comes a second time."""
    is_zero = steps <= 0
    if is_zero.all():
        return is_zero
    period = lower_median(steps[steps > REPEATED_PERIODS * steps.mean()])
    is_alike = np.abs(steps - period) < SAME_PERIOD * period
    is_near = steps <= REPEATED_PERIODS * period
    if np.mean(is_alike[~is_near]) < PERIODIC_SHARE:
        return is_zero
    return is_zero | is_near & np.append(True, is_alike[:-1]) & np.append(is_alike[1:], True)


def _intervals(
    stream: SensorStream, order: np.ndarray, limits: InspectionLimits, step: Moment | None
) -> StampIntervals:
    """Return what lies between the distinct times of a stream."""
    distinct = stream.times_ns[order]
    periods = np.diff(distinct) / 1e9
    period, has_one = _period(periods)
    if step is not None:  # this is how long it was
        periods[np.searchsorted(distinct, step.end_ns) - 1] = period
    is_long = periods >= max(limits.gap_periods * period, limits.gap_s)
    is_whole = periods <= longest(periods, period) if has_one else ~is_long
    # what comes by keyframe, by event or when it was recorded has no messages to be missing
    is_due = stream.is_sensor or _is_regular(periods, period)
    is_whole |= not is_due or stream.stamps_ns is None
    numbers = np.where(is_whole, 1, np.maximum(2, np.rint(periods / period)))
    return StampIntervals(
        order=order,
        periods_s=periods,
        period_s=period,
        is_whole=is_whole,
        is_gap=~is_whole & is_long,
        numbers=numbers,
    )


def _period(periods: np.ndarray) -> tuple[float, bool]:
    """Return the period, and whether there is one: messages in bursts have but a mean."""
    period = lower_median(periods)
    is_alike = np.abs(periods - period) < SAME_PERIOD * period
    is_longer = periods > (1 + MISSING_PERIODS) * period
    missing = float(np.sum(periods[is_longer] / period - 1))
    in_bursts = missing > len(periods) and is_longer.mean() > BURST_SHARE
    if is_alike.mean() < PERIODIC_SHARE or in_bursts:
        return float(periods.mean()), False
    return period, True


def _is_regular(periods: np.ndarray, period: float) -> bool:
    return float(np.mean(np.abs(periods - period) < SAME_PERIOD * period)) >= REGULAR_SHARE


def longest(periods: np.ndarray, period: float) -> float:
    """Return how long an interval can be in which no message is missing."""
    slack = JITTER_SPREADS * spread(periods)
    lacks = period - float(periods.min())
    if lacks < SHORTEST_LACKS_PERIODS * period:
        slack = min(slack, LONGER_THAN_SHORTER * lacks)
    return period + max(MISSING_PERIODS * period, slack)


def _figures(known: Timing, between: StampIntervals, distinct: np.ndarray) -> Timing:
    """Return the figures of a stream with those of its intervals."""
    rate, uncertainty = _rate(between.periods_s, between.numbers)
    deviations = np.abs(between.periods_s[between.is_whole] - between.period_s)
    median, p99 = np.quantile(deviations, [0.5, 0.99])
    return replace(
        known,
        rate_hz=rate,
        rate_uncertainty_hz=uncertainty,
        period_s=between.period_s,
        jitter_median_s=float(median),
        jitter_p99_s=float(p99),
        jitter_max_s=float(deviations.max()),
        is_regular=_is_regular(between.periods_s, between.period_s),
        missing=int(np.sum(between.numbers - 1)),
        gaps=int(between.is_gap.sum()),
        longest_s=float(between.periods_s.max()),
        times_s=(distinct[1:] - distinct[0]) / 1e9,
        periods_s=between.periods_s,
    )


def _rate(periods: np.ndarray, numbers: np.ndarray) -> tuple[float, float]:
    """Return the rate [Hz] and its standard deviation: least squares of times on numbers."""
    index = np.concatenate([[0.0], np.cumsum(numbers)])
    index -= index.mean()
    seconds = np.concatenate([[0.0], np.cumsum(periods)])
    square = float(index @ index)
    period = float(index @ seconds) / square
    residuals = seconds - seconds.mean() - period * index
    variance = float(residuals @ residuals) / max(len(residuals) - 2, 1)
    return 1 / period, math.sqrt(variance / square) / period**2


def _order(stream: SensorStream, backward: np.ndarray, repeated: np.ndarray) -> Iterator[Finding]:
    """Yield what is earlier than the one before; (2, D) ``repeated`` are ones and their copies."""
    if len(backward):
        steps_s = -np.diff(stream.times_ns)[backward - 1] / 1e9
        yield FINDINGS['out_of_order'].found(
            stream,
            messages=are(len(backward), 'message'),
            ms=1e3 * steps_s.max(),
            count=len(backward),
            value=float(steps_s.max()),
            moments=stream.moments(backward - 1, backward),
        )
    count = repeated.shape[1]
    if count:
        earlier, again = np.sort(repeated[:, np.argsort(repeated.max(axis=0))], axis=0)
        apart_ns = int((stream.times_ns[again] - stream.times_ns[earlier]).max())
        yield FINDINGS['duplicate_stamps'].found(
            stream,
            severe=stream.is_sensor and 2 * count > len(stream),
            total=len(stream),
            nearly=f', or one that is off by up to {apart_ns / 1e3:.3g} µs' if apart_ns else '',
            count=count,
            value=count / len(stream),
            moments=stream.moments(earlier, again),
        )


def _dropped(stream: SensorStream, figures: Timing, between: StampIntervals) -> Iterator[Finding]:
    """Yield the intervals in which a few messages are missing."""
    which = np.flatnonzero(~between.is_whole & ~between.is_gap)
    if len(which):
        missing = int(np.sum(between.numbers[which] - 1))
        longest_s = float(between.periods_s[which].max())
        yield FINDINGS['dropped'].found(
            stream,
            minor=not _is_due(stream, figures),
            lost=are(missing, 'message'),
            row=longest_s / between.period_s - 1,
            period_ms=1e3 * between.period_s,
            count=missing,
            value=longest_s,
            moments=stream.moments(between.order[which], between.order[which + 1]),
        )


def _gap(stream: SensorStream, between: StampIntervals) -> Iterator[Finding]:
    """Yield the intervals in which many messages are missing."""
    which = np.flatnonzero(between.is_gap)
    if len(which):
        yield FINDINGS['gap'].found(
            stream,
            times='once' if len(which) == 1 else f'{len(which)} times',
            lost=are(int(np.sum(between.numbers[which] - 1)), 'message'),
            count=len(which),
            value=float(between.periods_s[which].max()),
            moments=stream.moments(between.order[which], between.order[which + 1]),
        )


def _is_due(stream: SensorStream, figures: Timing) -> bool:
    """Return whether a stream should be regular: sensors, and poses that otherwise are."""
    return stream.is_sensor or (stream.kind == 'pose' and figures.is_regular)


def _jitter(
    stream: SensorStream, figures: Timing, between: StampIntervals, limits: InspectionLimits
) -> Iterator[Finding]:
    if not (stream.is_sensor or figures.is_regular):
        return
    period_s, is_whole = between.period_s, between.is_whole
    limit_s = min(
        max(limits.jitter_percent / 100 * period_s, limits.jitter_min_s),
        limits.jitter_max_s,
        SHORT_PERIOD_JITTER * period_s,
    )
    resolution_s = int(np.gcd.reduce(np.diff(stream.times_ns[between.order]))) / 1e9
    limit_s += min(resolution_s, COARSEST_RESOLUTION_S)
    single_s = max(
        min(limits.single_jitter_s, SHORT_PERIOD_SINGLE * period_s),
        JITTER_SPREADS * spread(between.periods_s[is_whole]),
        limit_s,
    )
    often = figures.jitter_p99_s > limit_s
    if not often and figures.jitter_max_s <= single_s:
        return
    off_s = np.where(is_whole, np.abs(between.periods_s - period_s), 0.0)
    worst = int(off_s.argmax())
    at_arrival = _is_stamped_on_arrival(stream, between)
    yield FINDINGS['jitter'].found(
        stream,
        minor=not _is_due(stream, figures),
        period_ms=1e3 * period_s,
        median_ms=1e3 * figures.jitter_median_s,
        p99_ms=1e3 * figures.jitter_p99_s,
        max_ms=1e3 * figures.jitter_max_s,
        on_arrival='; they are recorded with the same jitter: stamped on arrival'
        if at_arrival
        else '',
        count=int(np.sum(off_s > (limit_s if often else single_s))),
        value=figures.jitter_p99_s,
        moments=(stream.moment(int(between.order[worst]), int(between.order[worst + 1])),),
    )


def _is_stamped_on_arrival(stream: SensorStream, between: StampIntervals) -> bool:
    """Return whether the stamps vary in just the way in which the messages are recorded."""
    if stream.logged_ns is None or between.is_whole.sum() < ARRIVAL_INTERVALS:
        return False
    stamped, logged = (
        np.diff(times_ns[between.order])[between.is_whole].astype(float)
        for times_ns in (stream.times_ns, stream.logged_ns)
    )
    if not np.ptp(stamped) or not np.ptp(logged):
        return False
    return float(np.corrcoef(stamped, logged)[0, 1]) > ARRIVAL_CORRELATION
