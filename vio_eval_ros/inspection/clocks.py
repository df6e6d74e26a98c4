"""The clock of the stamps against the clock of the recorder: latency, offset, drift, jitter."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.sensor_stream import Moment, runs, SensorStream, spread
from vio_eval_ros.core.statistics import NORMAL_95
from vio_eval_ros.inspection.clock_offsets import known_offset
from vio_eval_ros.inspection.finding import are, Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.measured_stream import Clocks

#: a line is fitted to one point of each window: the most and the fewest windows ...
MAX_WINDOWS = 64
MIN_WINDOWS = 16
#: ... the fewest messages in each ...
WINDOW_MESSAGES = 8
#: ... and the shortest duration that shows a drift
MIN_DURATION_S = 10.0
#: standard deviations beyond which a drift is significant
DRIFT_DEVIATIONS = 4.0
#: no clock of a computer has a finer resolution
RESOLUTION_S = 1e-7
#: largest correlation of neighbouring residuals by which the uncertainty is enlarged
MAX_AUTOCORRELATION = 0.9
#: parts of the recording whose mean residuals show whether they wander ...
PARTS = 8
#: ... which they do where their variance is this many times what noise explains ...
WANDER_VARIANCES = 3.0
#: ... and by this many of their standard deviations over the recording the slope may then be off
WANDER_DEVIATIONS = 3.0
#: a line is straight where the slopes of its halves differ from it by less than this share of it,
#: or less than this many standard deviations
HALF_SLOPE = 0.7
HALF_DEVIATIONS = 8.0
#: it is a step where both halves have less than this share of its slope
STEP_SLOPE = 0.3
#: pace of the recorder's clock, over that of the stamps, below which it stands still
STANDSTILL_PACE = 1e-3
#: size of a step of the latency, in spreads of its noise
STEP_SPREADS = 10.0
#: delay of a late message, in spreads of the latency and in periods of the stream
LATE_SPREADS = 10.0
LATE_PERIODS = 10.0


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


class ComparedClocks(NamedTuple):
    """
    How the clocks of a stream compare, and what is wrong with them.

    :param clocks: None where there is only one.
    :param stamps_step: when the clock of the stamps was set, while messages went on.
    """

    clocks: Clocks | None
    findings: list[Finding]
    stamps_step: Moment | None = None


def clocks(stream: SensorStream, limits: InspectionLimits) -> ComparedClocks:
    """Return how the clock of the stamps compares with that of the recorder."""
    if stream.logged_ns is None or stream.stamps_ns is None:
        return ComparedClocks(None, [])
    latencies_ns = stream.logged_ns - stream.stamps_ns
    # differences of years have no nanoseconds left in floating point
    first_ns = int(latencies_ns[0])
    base_s = first_ns / 1e9
    latencies = (latencies_ns - first_ns) / 1e9
    median, p99 = (base_s + np.quantile(latencies, [0.5, 0.99])).tolist()
    order = np.argsort(stream.stamps_ns, kind='stable')
    seconds = (stream.stamps_ns[order] - stream.stamps_ns[order[0]]) / 1e9
    count = min(MAX_WINDOWS, len(order) // WINDOW_MESSAGES)
    if count < MIN_WINDOWS or seconds[-1] < MIN_DURATION_S:
        low = Clocks(median, p99, base_s + float(latencies.min()))
        found = [*_findings(stream, low, limits), *_late(stream, latencies, limits)]
        return ComparedClocks(low, found)
    x, latencies = seconds - seconds[-1] / 2, latencies[order]
    line, height, lowest = _lines(x, latencies, count)
    step = None if line.is_straight else _step(stream, order, lowest, latencies, limits)
    if step is not None:  # what it was until then
        is_before = stream.stamps_ns[order] <= step.moment.begin_ns
        height = float(latencies[is_before].min())
    residuals = latencies - line.slope * line.is_straight * x
    figures = Clocks(
        latency_median_s=median,
        latency_p99_s=p99,
        offset_s=base_s + height,
        drift_ppm=1e6 * line.slope if line.is_straight else math.nan,
        drift_uncertainty_ppm=1e6 * line.uncertainty if line.is_straight else math.nan,
        jitter_s=spread(residuals),
        is_steady=line.is_straight,
    )
    found = list(_findings(stream, figures, limits))
    if step is not None:
        found.append(_step_finding(stream, step))
    if not abs(figures.drift_ppm) > limits.replayed_ppm:
        found += _late(stream, residuals[np.argsort(order)], limits)
    return ComparedClocks(figures, found, step.moment if step and step.is_of_stamps else None)


def _lines(x: np.ndarray, latencies: np.ndarray, count: int) -> tuple[Line, float, np.ndarray]:
    """
    Return the line of the latencies, the height of their lower envelope, and its points.

    The least latency of each of ``count`` windows lies on a line whatever the load. Where delays
    scatter to both sides it varies more than the median of each does: the line that is less
    uncertain counts.
    """
    edges = np.linspace(0, len(x), count + 1).astype(int)
    windows = list(pairwise(edges.tolist()))
    lowest = np.array([a + latencies[a:b].argmin() for a, b in windows])
    envelope = robust_line(x[lowest], latencies[lowest])
    middle = robust_line(
        np.array([x[a:b].mean() for a, b in windows]),
        np.array([np.median(latencies[a:b]) for a, b in windows]),
    )
    return min(envelope, middle, key=lambda one: one.uncertainty), envelope.height, lowest


def robust_line(x: np.ndarray, y: np.ndarray) -> Line:
    """
    Return the line whose slope is the median of all slopes between points (Theil and Sen).

    Its uncertainty is that of least squares with the spread of the residuals, enlarged where
    neighbours err alike; where they wander, it is what such a wander makes of a slope.
    """
    slope = theil_sen(x, y)
    height = float(np.median(y - slope * x))
    residuals = y - slope * x - height
    noise = max(spread(residuals), RESOLUTION_S)
    alike = min(max(_autocorrelation(residuals), 0.0), MAX_AUTOCORRELATION)
    uncertainty = noise * math.sqrt((1 + alike) / (1 - alike) / len(x)) / float(np.std(x))
    stands_out = abs(slope) > uncertainty
    parts = [float(part.mean()) for part in np.array_split(residuals, PARTS)]
    wander = float(np.std(parts))
    if wander**2 > WANDER_VARIANCES * noise**2 * PARTS / len(x):
        uncertainty = max(uncertainty, WANDER_DEVIATIONS * wander / float(np.ptp(x)))
    half = len(x) // 2
    halves = [theil_sen(x[:half], y[:half]), theil_sen(x[half:], y[half:])]
    limit = max(HALF_SLOPE * abs(slope), HALF_DEVIATIONS * uncertainty)
    is_step = stands_out and all(abs(part) < STEP_SLOPE * abs(slope) for part in halves)
    is_straight = all(abs(part - slope) < limit for part in halves) and not is_step
    return Line(slope, height, uncertainty, is_straight)


def theil_sen(x: np.ndarray, y: np.ndarray) -> float:
    """Return the median of the slopes between all pairs of points of distinct x."""
    i, j = np.triu_indices(len(x), 1)
    apart = x[j] > x[i]
    return float(np.median((y[j] - y[i])[apart] / (x[j] - x[i])[apart])) if apart.any() else 0.0


def _autocorrelation(residuals: np.ndarray) -> float:
    square = float(residuals @ residuals)
    return float(residuals[1:] @ residuals[:-1]) / square if square else 0.0


def is_drift(line: Line, duration_s: float, least_ppm: float, least_s: float) -> bool:
    """Return whether two clocks drift apart for certain, by more than a rate and a time."""
    slope = abs(line.slope)
    return (
        line.is_straight
        and slope > max(least_ppm / 1e6, DRIFT_DEVIATIONS * line.uncertainty)
        and slope * duration_s > least_s
    )


class _Step(NamedTuple):
    """A step of the latency, in seconds, and whether it is rather one of the stamps."""

    size_s: float
    moment: Moment
    is_of_stamps: bool


def _step(
    stream: SensorStream,
    order: np.ndarray,
    lowest: np.ndarray,
    latencies: np.ndarray,
    limits: InspectionLimits,
) -> _Step | None:
    """Return where the latency steps from one level to another, and stays there."""
    assert stream.stamps_ns is not None
    k, size = _largest_step(latencies[lowest], limits)
    if not size:
        return None
    a, b = int(lowest[k]), int(lowest[k + 1])
    at = a + int(np.abs(np.diff(latencies[a : b + 1])).argmax())
    stamped = float(np.diff(stream.stamps_ns[order[[at, at + 1]]])[0]) / 1e9
    usual = float(np.median(np.diff(stream.stamps_ns[order]))) / 1e9
    is_of_stamps = abs(stamped - usual) > abs(size) / 2
    # a stamp that is set back is between those of others: sorting hid the step
    is_of_stamps |= bool((np.diff(stream.stamps_ns) / 1e9 - usual < -abs(size) / 2).any())
    return _Step(size, stream.moment(int(order[at]), int(order[at + 1])), is_of_stamps)


def _step_finding(stream: SensorStream, step: _Step) -> Finding:
    return FINDINGS['clock_step'].found(
        stream,
        minor=not step.is_of_stamps,
        ms=1e3 * abs(step.size_s),
        whose='that of the stamps' if step.is_of_stamps else 'that of the recorder, or transport',
        value=step.size_s,
        moments=(step.moment,),
    )


def _largest_step(y: np.ndarray, limits: InspectionLimits) -> tuple[int, float]:
    """Return the index before which (N,) heights step, and by how much; zero if they do not."""
    before, after = np.maximum.accumulate(y), np.minimum.accumulate(y[::-1])[::-1]
    up = after[1:] - before[:-1]
    before, after = np.minimum.accumulate(y), np.maximum.accumulate(y[::-1])[::-1]
    down = before[:-1] - after[1:]
    inner = slice(2, len(y) - 3)
    k = 2 + int(np.argmax(np.maximum(up, down)[inner]))
    noise = max(spread(y[: k + 1]), spread(y[k + 1 :]))
    if max(up[k], down[k]) < max(limits.clock_step_s, STEP_SPREADS * noise):
        return k, 0.0
    return k, float(np.median(y[k + 1 :]) - np.median(y[: k + 1]))


def _late(
    stream: SensorStream, latencies: np.ndarray, limits: InspectionLimits
) -> Iterator[Finding]:
    """Yield what was held up on its way: messages that are late, between others that are not."""
    assert stream.stamps_ns is not None
    late = latencies - np.median(latencies)
    period_s = float(np.median(np.diff(np.sort(stream.stamps_ns)))) / 1e9 if len(late) > 1 else 0.0
    limit = max(limits.late_arrival_s, LATE_PERIODS * period_s, LATE_SPREADS * spread(late))
    begins, ends = runs(late > limit)
    # a clock that was set does not catch up, and a stamp that is too early is not late
    is_held = (begins > 0) & (ends < len(late))
    is_held &= stream.stamps_ns[begins] >= stream.stamps_ns[begins - 1]
    begins, ends = begins[is_held], ends[is_held]
    if len(begins):
        held = np.concatenate([late[k:end] for k, end in zip(begins, ends, strict=True)])
        yield FINDINGS['late_arrival'].found(
            stream,
            messages=are(len(held), 'message'),
            count=len(held),
            value=float(held.max()),
            moments=stream.moments(begins - 1, begins),
        )


def _findings(stream: SensorStream, found: Clocks, limits: InspectionLimits) -> Iterator[Finding]:
    duration_s = float(np.ptp(stream.times_ns)) / 1e9
    drift, uncertainty = found.drift_ppm, found.drift_uncertainty_ppm
    if abs(drift) - NORMAL_95 * uncertainty > limits.replayed_ppm:
        pace = 1 + drift / 1e6
        yield FINDINGS['replayed'].found(
            stream,
            'pace' if pace > STANDSTILL_PACE else 'still',
            pace=1 / pace if pace else math.inf,
            value=drift,
        )
        return
    line = Line(drift / 1e6, 0.0, uncertainty / 1e6, found.is_steady)
    if is_drift(line, duration_s, limits.drift_ppm, limits.drift_s):
        yield FINDINGS['clock_drift'].found(
            stream,
            'recorder',
            interval=NORMAL_95 * uncertainty,
            total_ms=1e3 * (abs(drift) * duration_s / 1e6),
            value=drift,
        )
    if not limits.latency_min_s <= found.offset_s <= limits.latency_max_s:
        why = known_offset(found.offset_s)
        yield FINDINGS['clock_offset'].found(
            stream,
            'recorder',
            minor=not why,
            why=why,
            apart=abs(found.offset_s),
            side='after' if found.offset_s < 0 else 'before',
            value=found.offset_s,
        )
