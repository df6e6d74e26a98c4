"""The clock of the stamps against the clock of the recorder: latency, offset, drift, jitter."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.sensor_stream import Moment, runs, SensorStream, spread
from vio_eval_ros.inspection.findings import are, Finding

WINDOWS, LEAST_WINDOWS, MESSAGES_A_WINDOW = 64, 16, 8
LEAST_S = 10.0
# A drift is told where it is more than this, certain, and matters at the end of the recording
DRIFT_PPM, DRIFT_TOTAL_S, DEVIATIONS = 10.0, 0.0009, 4.0
# What is left of a line wanders where the means of so many parts vary by this much more than
# noise does, and then hides a slope that makes this many of their standard deviations
PARTS, WANDERS, HIDDEN = 8, 3.0, 3.0
# A line is one where its halves differ from it by no more than this, or so many deviations
BENT, HALF_DEVIATIONS, STRAIGHT = 0.7, 8.0, 0.3
# No quartz drifts as much
REPLAYED_PPM = 1000.0
STANDS_STILL = 1e-3
# What a message may take from sensor to disk, and how early a clock may be without a word
LATEST_S, EARLIEST_S = 1.0, -0.001
# A clock was set where all that is behind differs from all in front by this, and many spreads
STEP_S, STEP_SPREADS = 0.005, 10.0
# Messages were held up where they are late by this, so many periods and so many spreads of all
HELD_S, HELD_PERIODS, HELD_SPREADS = 0.5, 10.0, 10.0


@dataclass(frozen=True)
class Clocks:
    """
    Log time minus stamp, of the messages of a stream; NaN where it cannot be told.

    :param latency_median_s: and ``latency_p99_s``: what it is, clocks and transport together.
    :param offset_s: of the lower envelope in the middle of the recording: the difference of the
        clocks and the least time of transport, which no recording can tell apart.
    :param drift_ppm: by how much faster than the stamps the clock of the recorder runs, and
        ``drift_uncertainty_ppm``, its standard deviation; NaN where it does not run evenly.
    :param jitter_s: standard deviation of transport, robust: what is left above the envelope.
    """

    latency_median_s: float
    latency_p99_s: float
    offset_s: float
    drift_ppm: float = math.nan
    drift_uncertainty_ppm: float = math.nan
    jitter_s: float = math.nan
    is_steady: bool = False


class Line(NamedTuple):
    """
    A line through points, robust.

    :param height: in the middle, at ``x`` = 0.
    :param uncertainty: the standard deviation of the slope.
    :param is_straight: whether both halves have the slope of the whole.
    """

    slope: float
    height: float
    uncertainty: float
    is_straight: bool


def clocks(stream: SensorStream) -> tuple[Clocks | None, list[Finding]]:
    """Return how the clocks of a stream compare; None where it has but one."""
    if stream.logged_ns is None or stream.stamps_ns is None:
        return None, []
    latencies_ns = stream.logged_ns - stream.stamps_ns
    # differences of years have no nanoseconds left in floating point
    first_ns = int(latencies_ns[0])
    base_s = first_ns / 1e9
    latencies = (latencies_ns - first_ns) / 1e9
    median, p99 = (base_s + np.quantile(latencies, [0.5, 0.99])).tolist()
    order = np.argsort(stream.stamps_ns, kind='stable')
    seconds = (stream.stamps_ns[order] - stream.stamps_ns[order[0]]) / 1e9
    count = min(WINDOWS, len(order) // MESSAGES_A_WINDOW)
    if count < LEAST_WINDOWS or seconds[-1] < LEAST_S:
        low = Clocks(median, p99, base_s + float(latencies.min()))
        return low, [*_findings(stream, low), *_late(stream, latencies)]
    edges = np.linspace(0, len(order), count + 1).astype(int)
    windows = list(pairwise(edges.tolist()))
    x, latencies = seconds - seconds[-1] / 2, latencies[order]
    lowest = np.array([a + latencies[a:b].argmin() for a, b in windows])
    envelope = fit(x[lowest], latencies[lowest])
    # the least of what is not late on one side only varies more than the middle of it
    middle = fit(
        np.array([x[a:b].mean() for a, b in windows]),
        np.array([np.median(latencies[a:b]) for a, b in windows]),
    )
    line = min(envelope, middle, key=lambda one: one.uncertainty)
    stepped = [] if line.is_straight else list(_step(stream, order, lowest, latencies))
    offset = envelope.height
    if stepped:  # what it was until then
        is_before = stream.stamps_ns[order] <= stepped[0].moments[0].begin_ns
        offset = float(latencies[is_before].min())
    rest = latencies - line.slope * line.is_straight * x
    found = Clocks(
        median,
        p99,
        base_s + offset,
        1e6 * line.slope if line.is_straight else math.nan,
        1e6 * line.uncertainty if line.is_straight else math.nan,
        spread(rest),
        line.is_straight,
    )
    findings = [*_findings(stream, found), *stepped]
    if not abs(found.drift_ppm) > REPLAYED_PPM:
        findings += _late(stream, rest[np.argsort(order)])
    return found, findings


def fit(x: np.ndarray, y: np.ndarray) -> Line:
    """
    Return the line whose slope is the median of all slopes between points (Theil and Sen).

    Its uncertainty is that of least squares with the spread of what is left, enlarged where
    neighbours err alike; where that wanders, it is what such a wander makes of a slope.
    """
    slope = theil_sen(x, y)
    height = float(np.median(y - slope * x))
    rest = y - slope * x - height
    # no better than clocks resolve
    noise = max(spread(rest), 1e-7)
    alike = min(max(_autocorrelation(rest), 0.0), 0.9)
    uncertainty = noise * math.sqrt((1 + alike) / (1 - alike) / len(x)) / float(np.std(x))
    stands_out = abs(slope) > uncertainty
    parts = [float(part.mean()) for part in np.array_split(rest, PARTS)]
    wander = float(np.std(parts))
    if wander**2 > WANDERS * noise**2 * PARTS / len(x):
        uncertainty = max(uncertainty, HIDDEN * wander / float(np.ptp(x)))
    half = len(x) // 2
    halves = [theil_sen(x[:half], y[:half]), theil_sen(x[half:], y[half:])]
    limit = max(BENT * abs(slope), HALF_DEVIATIONS * uncertainty)
    is_step = stands_out and all(abs(part) < STRAIGHT * abs(slope) for part in halves)
    is_straight = all(abs(part - slope) < limit for part in halves) and not is_step
    return Line(slope, height, uncertainty, is_straight)


def theil_sen(x: np.ndarray, y: np.ndarray) -> float:
    """Return the median of the slopes between all pairs of points of distinct x."""
    i, j = np.triu_indices(len(x), 1)
    apart = x[j] > x[i]
    return float(np.median((y[j] - y[i])[apart] / (x[j] - x[i])[apart])) if apart.any() else 0.0


def _autocorrelation(rest: np.ndarray) -> float:
    square = float(rest @ rest)
    return float(rest[1:] @ rest[:-1]) / square if square else 0.0


def is_drift(line: Line, duration_s: float, least_s: float = DRIFT_TOTAL_S) -> bool:
    """Return whether two clocks drift apart for certain, and by more than something."""
    slope = abs(line.slope)
    return (
        line.is_straight
        and slope > max(DRIFT_PPM / 1e6, DEVIATIONS * line.uncertainty)
        and slope * duration_s > least_s
    )


def _step(
    stream: SensorStream, order: np.ndarray, lowest: np.ndarray, latencies: np.ndarray
) -> Iterator[Finding]:
    """Yield where the latency steps from one level to another, and stays there."""
    assert stream.stamps_ns is not None
    assert stream.logged_ns is not None
    y = latencies[lowest]
    count = len(y)
    before, after = np.maximum.accumulate(y), np.minimum.accumulate(y[::-1])[::-1]
    up = after[1:] - before[:-1]
    before, after = np.minimum.accumulate(y), np.maximum.accumulate(y[::-1])[::-1]
    down = before[:-1] - after[1:]
    inner = slice(2, count - 3)
    k = 2 + int(np.argmax(np.maximum(up, down)[inner]))
    size = float(np.median(y[k + 1 :]) - np.median(y[: k + 1]))
    noise = max(spread(y[: k + 1]), spread(y[k + 1 :]))
    if max(up[k], down[k]) < max(STEP_S, STEP_SPREADS * noise):
        return
    a, b = int(lowest[k]), int(lowest[k + 1])
    at = a + int(np.abs(np.diff(latencies[a : b + 1])).argmax())
    stamped = float(np.diff(stream.stamps_ns[order[[at, at + 1]]])[0]) / 1e9
    usual = float(np.median(np.diff(stream.stamps_ns[order]))) / 1e9
    is_stamps = abs(stamped - usual) > abs(size) / 2
    # a stamp that is set back is between those of others: sorting hid the step
    is_stamps |= bool((np.diff(stream.stamps_ns) / 1e9 - usual < -abs(size) / 2).any())
    whose = 'that of the stamps' if is_stamps else 'that of the recorder, or transport'
    yield Finding(
        'clock_step', stream.topic, 'warn' if is_stamps else 'info',
        f'a clock steps by {1e3 * abs(size):.3g} ms, most likely {whose}',
        value=size, unit='s', moments=(_moment(stream, order, at),),
    )  # fmt: skip


def _moment(stream: SensorStream, order: np.ndarray, at: int) -> Moment:
    return stream.moment(int(order[at]), int(order[at + 1]))


def _late(stream: SensorStream, latencies: np.ndarray) -> Iterator[Finding]:
    """Yield what was held up on its way: messages that are late, between others that are not."""
    assert stream.stamps_ns is not None
    late = latencies - np.median(latencies)
    period_s = float(np.median(np.diff(np.sort(stream.stamps_ns)))) / 1e9 if len(late) > 1 else 0.0
    limit = max(HELD_S, HELD_PERIODS * period_s, HELD_SPREADS * spread(late))
    begins, ends = runs(late > limit)
    # a clock that was set does not catch up, and a stamp that is too early is not late
    is_held = (begins > 0) & (ends < len(late))
    is_held &= stream.stamps_ns[begins] >= stream.stamps_ns[begins - 1]
    begins, ends = begins[is_held], ends[is_held]
    if len(begins):
        held = np.concatenate([late[k:end] for k, end in zip(begins, ends, strict=True)])
        count, largest = len(held), float(held.max())
        yield Finding(
            'late_arrival', stream.topic, 'warn' if stream.is_sensor else 'info',
            f'{are(count, "message")} recorded late, by up to {largest:.3g} s',
            count, largest, 's', stream.moments(begins - 1, begins),
        )  # fmt: skip


def _findings(stream: SensorStream, found: Clocks) -> Iterator[Finding]:
    duration_s = float(np.ptp(stream.times_ns)) / 1e9
    drift, uncertainty = found.drift_ppm, found.drift_uncertainty_ppm
    if abs(drift) > REPLAYED_PPM:
        pace = 1 + drift / 1e6
        speed = (
            f'the stamps run at {1 / pace:.4g} times the speed of the clock of the recorder, as '
            'in a simulation or a replay'
            if pace > STANDS_STILL
            else 'the clock of the recorder does not go forward with the stamps'
        )
        yield Finding('replayed', stream.topic, 'info', speed, value=drift, unit='ppm')
        return
    if is_drift(Line(drift / 1e6, 0.0, uncertainty / 1e6, found.is_steady), duration_s):
        total_s = abs(drift) * duration_s / 1e6
        yield Finding(
            'clock_drift', stream.topic, 'warn',
            f'the clock of the recorder gains {drift:.1f} ± {1.96 * uncertainty:.1g} ppm on that '
            f'of the stamps, {1e3 * total_s:.3g} ms over the recording',
            value=drift, unit='ppm',
        )  # fmt: skip
    if not EARLIEST_S <= found.offset_s <= LATEST_S:
        early = found.offset_s < 0
        yield Finding(
            'clock_offset', stream.topic, 'info',
            f'stamped {abs(found.offset_s):.4g} s {"after" if early else "before"} it was '
            'recorded, at least: the two clocks differ',
            value=found.offset_s, unit='s',
        )  # fmt: skip
