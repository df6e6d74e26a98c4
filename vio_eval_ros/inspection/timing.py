"""When the messages of a stream come: rate, jitter, gaps, duplicates, order."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.sensor_stream import lower_median, Moment, SensorStream, spread
from vio_eval_ros.inspection.findings import are, Finding

# An interval that is longer than a period by this much of it misses a message ...
MISSING = 0.5
# ... unless the periods of the stream spread so much that one in a million is longer. Jitter alone
# makes periods shorter as often as longer, by no more than a period
SPREADS, SHORTER, SHORTEST = 6.0, 1.2, 0.8
# A gap, and no longer a few dropped messages
GAP_PERIODS, GAP_S = 10.0, 0.1
# Of the 99th percentile of the deviations from the period: a part of it, within limits, and the
# resolution of the stamps, which nobody has coarser than milliseconds without knowing
JITTER_OF_PERIOD, JITTER_S, JITTER_OF_SHORT_PERIOD = 0.03, (0.0005, 0.0015), 0.2
COARSEST_S = 0.001
# A single interval that is off by more is told in any case
OFF_BY, OFF_BY_S = 0.4, 0.002
# Streams are regular where nearly all periods are alike. They have a period where half are, and
# come in bursts where by that period most messages are missing, all over the recording
ALIKE, NEARLY_ALL, HALF, ALL_OVER = 0.25, 0.9, 0.5, 0.1
# A message comes twice where it is nearer to the one before than this part of the period, between
# others that are a period apart
NEAR = 0.001


@dataclass(frozen=True, eq=False)
class Timing:
    """
    Figures of the distinct times of a stream, sorted; NaN where there are too few.

    :param rate_hz: by the regression of the times on the number of the message, which counts
        those that are missing, and ``rate_uncertainty_hz``, its standard deviation.
    :param period_s: the median, one of the periods, where half of them are like it; of others
        the mean. ``jitter_*_s`` are of the absolute deviations from it, of intervals in which no
        message is missing.
    :param missing: messages that are missing in all of the intervals that are too long.
    :param gaps: how many of these are long.
    :param duplicates: messages with the stamp of another one, or nearly so.
    :param backward: how often a message is earlier than the one before.
    :param times_s: (M,) of what is drawn, seconds since the first, the ends of ``periods_s``.
    """

    count: int
    first_ns: int
    last_ns: int
    rate_hz: float = math.nan
    rate_uncertainty_hz: float = math.nan
    period_s: float = math.nan
    jitter_median_s: float = math.nan
    jitter_p99_s: float = math.nan
    jitter_max_s: float = math.nan
    is_regular: bool = False
    missing: int = 0
    gaps: int = 0
    longest_s: float = math.nan
    duplicates: int = 0
    backward: int = 0
    times_s: np.ndarray = field(default_factory=lambda: np.empty(0), repr=False)
    periods_s: np.ndarray = field(default_factory=lambda: np.empty(0), repr=False)

    @property
    def duration_s(self) -> float:
        """From the first to the last message."""
        return (self.last_ns - self.first_ns) / 1e9


def timing(stream: SensorStream, step: Moment | None = None) -> tuple[Timing, list[Finding]]:
    """
    Return the figures of a stream, and what is wrong with its stamps.

    :param step: between which stamps their clock was set while messages went on.
    """
    times = stream.times_ns
    order = np.argsort(times, kind='stable')
    steps_ns = np.diff(times[order])
    # of transforms, those of several frames come together
    is_again = np.append(False, steps_ns <= 0 if stream.kind == 'other' else _twice(steps_ns))
    repeated = np.stack([order[np.flatnonzero(is_again) - 1], order[is_again]])
    order = order[~is_again]
    distinct = times[order]
    backward = np.flatnonzero(np.diff(times) < 0) + 1
    known: dict[str, Any] = {
        'count': len(times),
        'first_ns': int(distinct[0]),
        'last_ns': int(distinct[-1]),
        'duplicates': len(times) - len(distinct),
        'backward': len(backward),
    }
    if len(distinct) < 3:
        figures = Timing(**known)
        return figures, list(_order(stream, figures, backward, repeated))
    periods = np.diff(distinct) / 1e9
    period, has_one = _period(periods)
    if step is not None:  # this is how long it was
        periods[np.searchsorted(distinct, step.end_ns) - 1] = period
    alike = float(np.mean(np.abs(periods - period) < ALIKE * period))
    is_regular = alike >= NEARLY_ALL
    is_long = periods >= max(GAP_PERIODS * period, GAP_S)
    whole = periods <= longest(periods, period) if has_one else ~is_long
    # what comes by keyframe, by event or when it was recorded has no messages to be missing
    whole |= not (stream.is_sensor or is_regular) or stream.stamps_ns is None
    numbers = np.where(whole, 1, np.maximum(2, np.rint(periods / period)))
    deviations = np.abs(periods[whole] - period)
    rate, uncertainty = _rate(periods, numbers)
    is_gap = ~whole & is_long
    median, p99 = np.quantile(deviations, [0.5, 0.99])
    figures = Timing(
        **known,
        rate_hz=rate,
        rate_uncertainty_hz=uncertainty,
        period_s=period,
        jitter_median_s=float(median),
        jitter_p99_s=float(p99),
        jitter_max_s=float(deviations.max()),
        is_regular=is_regular,
        missing=int(np.sum(numbers - 1)),
        gaps=int(is_gap.sum()),
        longest_s=float(periods.max()),
        times_s=(distinct[1:] - distinct[0]) / 1e9,
        periods_s=periods,
    )
    if stream.stamps_ns is None:
        return figures, []  # when messages are recorded depends on much that is nobody's fault
    found = [
        *_order(stream, figures, backward, repeated),
        *_lost(stream, figures, order, ~whole & ~is_gap, 'dropped', numbers),
        *_lost(stream, figures, order, is_gap, 'gap', numbers),
        *_jitter(stream, figures, order, whole),
    ]
    return figures, found


def _period(periods: np.ndarray) -> tuple[float, bool]:
    """Return the period, and whether there is one: messages in bursts have but a mean."""
    period = lower_median(periods)
    is_alike = np.abs(periods - period) < ALIKE * period
    is_longer = periods > (1 + MISSING) * period
    missing = float(np.sum(periods[is_longer] / period - 1))
    in_bursts = missing > len(periods) and is_longer.mean() > ALL_OVER
    if is_alike.mean() < HALF or in_bursts:
        return float(periods.mean()), False
    return period, True


def _twice(steps: np.ndarray) -> np.ndarray:
    """Return which intervals, in nanoseconds, are none: a message comes a second time."""
    is_none = steps <= 0
    if is_none.all():
        return is_none
    period = lower_median(steps[steps > NEAR * steps.mean()])
    is_alike = np.abs(steps - period) < ALIKE * period
    is_near = steps <= NEAR * period
    if np.mean(is_alike[~is_near]) < HALF:
        return is_none
    return is_none | is_near & np.append(True, is_alike[:-1]) & np.append(is_alike[1:], True)


def longest(periods: np.ndarray, period: float) -> float:
    """Return how long an interval can be in which no message is missing."""
    slack = SPREADS * spread(periods)
    shorter = period - float(periods.min())
    if shorter < SHORTEST * period:
        slack = min(slack, SHORTER * shorter)
    return period + max(MISSING * period, slack)


def _rate(periods: np.ndarray, numbers: np.ndarray) -> tuple[float, float]:
    """Return the rate [Hz] and its standard deviation, by least squares on the own clock."""
    index = np.concatenate([[0.0], np.cumsum(numbers)])
    index -= index.mean()
    seconds = np.concatenate([[0.0], np.cumsum(periods)])
    square = float(index @ index)
    period = float(index @ seconds) / square
    rest = seconds - seconds.mean() - period * index
    deviation = math.sqrt(float(rest @ rest) / max(len(rest) - 2, 1) / square)
    return 1 / period, deviation / period**2


def _order(
    stream: SensorStream, figures: Timing, backward: np.ndarray, repeated: np.ndarray
) -> Iterator[Finding]:
    """Yield what is earlier than the one before; (2, D) ``repeated`` are ones and their copies."""
    if stream.stamps_ns is None:
        return
    if figures.backward:
        steps = -np.diff(stream.times_ns)[backward - 1] / 1e9
        level = {'other': 'info', 'pose': 'warn'}.get(stream.kind, 'fail')
        yield Finding(
            'out_of_order', stream.topic, level,
            f'{are(figures.backward, "message")} stamped earlier than the one before, by up to '
            f'{1e3 * steps.max():.3g} ms',
            figures.backward, float(steps.max()), 's', stream.moments(backward - 1, backward),
        )  # fmt: skip
    if figures.duplicates:
        mostly = 2 * figures.duplicates > len(stream)
        level = 'info' if stream.kind == 'other' else 'warn'
        level = 'fail' if stream.is_sensor and mostly else level
        earlier, again = np.sort(repeated[:, np.argsort(repeated.max(axis=0))], axis=0)
        apart_ns = int((stream.times_ns[again] - stream.times_ns[earlier]).max())
        nearly = f', or one that is off by up to {apart_ns / 1e3:.3g} µs' if apart_ns else ''
        yield Finding(
            'duplicate_stamps', stream.topic, level,
            f'{figures.duplicates} of {len(stream)} messages have the stamp of an earlier one'
            f'{nearly}',
            figures.duplicates, figures.duplicates / len(stream), 'ratio',
            stream.moments(earlier, again),
        )  # fmt: skip


def _lost(
    stream: SensorStream,
    figures: Timing,
    order: np.ndarray,
    which: np.ndarray,
    name: str,
    numbers: np.ndarray,
) -> Iterator[Finding]:
    """Yield what is wrong with the intervals in which messages are missing."""
    if not which.any():
        return
    found, missing = np.flatnonzero(which), int(np.sum(numbers[which] - 1))
    longest = float(figures.periods_s[which].max())
    lost = f'{are(missing, "message")} missing'
    if name == 'gap':
        times = 'once' if len(found) == 1 else f'{len(found)} times'
        message = f'silent {times}, for up to {longest:.3g} s; {lost}'
        level = 'fail' if stream.is_sensor else 'warn'
    else:
        message = (
            f'{lost}, up to {longest / figures.period_s - 1:.0f} in a row, where one is due '
            f'every {1e3 * figures.period_s:.4g} ms'
        )
        level = _level(stream, figures)
    yield Finding(
        name, stream.topic, level, message, missing if name == 'dropped' else len(found), longest,
        's', stream.moments(order[found], order[found + 1]),
    )  # fmt: skip


def _level(stream: SensorStream, figures: Timing) -> str:
    """Return how bad it is where a stream is not as regular as it is otherwise."""
    is_due = stream.is_sensor or (stream.kind == 'pose' and figures.is_regular)
    return 'warn' if is_due else 'info'


def _jitter(
    stream: SensorStream, figures: Timing, order: np.ndarray, whole: np.ndarray
) -> Iterator[Finding]:
    period = figures.period_s
    periods_ns = np.diff(stream.times_ns[order])
    resolution = min(int(np.gcd.reduce(periods_ns)) / 1e9, COARSEST_S)
    least, most = JITTER_S
    limit = min(max(JITTER_OF_PERIOD * period, least), most, JITTER_OF_SHORT_PERIOD * period)
    limit += resolution
    off = np.where(whole, np.abs(figures.periods_s - period), 0.0)
    alone = max(min(OFF_BY_S, OFF_BY * period), SPREADS * spread(figures.periods_s[whole]), limit)
    if figures.jitter_p99_s <= limit and figures.jitter_max_s <= alone:
        return
    if not (stream.is_sensor or figures.is_regular):
        return
    worst = int(off.argmax())
    count = int(np.sum(off > (limit if figures.jitter_p99_s > limit else alone)))
    yield Finding(
        'jitter', stream.topic, _level(stream, figures),
        f'periods are off {1e3 * period:.4g} ms by {1e3 * figures.jitter_median_s:.3g} ms in the '
        f'median, {1e3 * figures.jitter_p99_s:.3g} ms in the 99th percentile and '
        f'{1e3 * figures.jitter_max_s:.3g} ms at most{_at_arrival(stream, order, whole)}',
        count, figures.jitter_p99_s, 's', _once(stream, order, worst),
    )  # fmt: skip


def _once(stream: SensorStream, order: np.ndarray, k: int) -> tuple[Moment, ...]:
    return (stream.moment(int(order[k]), int(order[k + 1])),)


def _at_arrival(stream: SensorStream, order: np.ndarray, whole: np.ndarray) -> str:
    """Return whether the stamps are off in just the way in which the messages are recorded."""
    if stream.logged_ns is None or whole.sum() < 10:
        return ''
    stamped = np.diff(stream.times_ns[order])[whole].astype(float)
    logged = np.diff(stream.logged_ns[order])[whole].astype(float)
    if not np.ptp(stamped) or not np.ptp(logged):
        return ''
    alike = float(np.corrcoef(stamped, logged)[0, 1]) > 0.9
    return '; they are recorded with the same jitter, so stamped on arrival' if alike else ''
