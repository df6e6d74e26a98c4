"""Cameras that expose together: frames without a partner, and their skew."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
import math

import numpy as np

from vio_eval_ros.core.sensor_stream import Moment, runs, SensorStream, spread
from vio_eval_ros.inspection.clocks import (
    fit,
    is_drift,
    LEAST_S,
    LEAST_WINDOWS,
    Line,
    MESSAGES_A_WINDOW,
    WINDOWS,
)
from vio_eval_ros.inspection.findings import Finding
from vio_eval_ros.inspection.timing import Timing

SAME_RATE = 0.02
# Frames are partners where their stamps differ by no more than this, and so many spreads, from
# the usual difference; where those spread all over the period, by this part of it
PARTNERS_S, PARTNERS_SPREADS, PARTNERS = 0.001, 6.0, 0.1
# What blurs no more than half a pixel at 1 rad/s and a focal length of 500 pixels
SKEW_S = 0.0005
# Between cameras is no transport: less drift is certain than against the recorder
DRIFT_TOTAL_S = 0.0002
# Where fewer have a partner, the cameras run freely
TRIGGERED = 0.5


@dataclass(frozen=True)
class Pair:
    """
    Two cameras; of different rates, the slower is the first.

    :param skew_s: by how much the second is stamped later, in the median of all frames; up to
        half a period, since whole ones cannot be told.
    :param skew_jitter_s: the spread of that, robust.
    :param skew_drift_ppm: by how much faster than the first the clock of the second runs; NaN
        where there are too few frames to tell, or it does not run evenly.
    :param frames: of both, in the time that they have in common.
    :param unsynchronised: those among them that have no partner.
    """

    first: str
    second: str
    skew_s: float
    skew_jitter_s: float
    skew_drift_ppm: float
    frames: int
    unsynchronised: int


def pairs(
    streams: Sequence[SensorStream], timings: Sequence[Timing]
) -> tuple[list[Pair], list[Finding]]:
    """Return the pairs of cameras, and what is wrong with each."""
    cameras = [
        (stream, figures)
        for stream, figures in zip(streams, timings, strict=True)
        if stream.kind == 'camera'
        and stream.stamps_ns is not None
        and math.isfinite(figures.rate_hz)
    ]
    found: list[Pair] = []
    findings: list[Finding] = []
    for (a, first), (b, second) in combinations(cameras, 2):
        has_one_rate = abs(first.rate_hz / second.rate_hz - 1) < SAME_RATE
        if not has_one_rate and first.rate_hz > second.rate_hz:
            (a, first), (b, second) = (b, second), (a, first)
        pair, wrong = _pair(a, b, first.period_s if has_one_rate else second.period_s)
        if pair is None:
            continue
        found.append(pair)
        if not has_one_rate:
            wrong = [_apart(pair, first.rate_hz, second.rate_hz)]
        findings += wrong
    return found, findings


def _pair(a: SensorStream, b: SensorStream, period_s: float) -> tuple[Pair | None, list[Finding]]:
    first, second = np.unique(a.times_ns), np.unique(b.times_ns)
    begin, end = max(first[0], second[0]), min(first[-1], second[-1])
    near = round(period_s * 0.5e9)
    common = [times[(times >= begin - near) & (times <= end + near)] for times in (first, second)]
    if begin > end or min(map(len, common)) < 3:
        return None, []
    usual_ns = _usual_skew(*common, period_s)
    partners = common[1] - usual_ns
    skews = _differences(common[0], partners) / 1e9
    line = _drift((common[0] - common[0][0]) / 1e9, skews, period_s)
    duration_s = float(np.ptp(common[0])) / 1e9
    drifts = line is not None and is_drift(line, duration_s, DRIFT_TOTAL_S)
    runs_freely = drifts and abs(line.slope) * duration_s > period_s / 2
    if drifts:  # what drifts apart evenly is still together
        partners = partners - np.rint(line.slope * (partners - common[0][0])).astype(np.int64)
    off = [_differences(common[0], partners) / 1e9, _differences(partners, common[0]) / 1e9]
    usual = float(np.median(off[0]))
    reach = max(PARTNERS_S, PARTNERS_SPREADS * spread(off[0]))
    if reach > period_s / 2:
        reach = PARTNERS * period_s
    alone = [
        times[(np.abs(apart - side * usual) > reach) & (times >= begin) & (times <= end)]
        for times, apart, side in zip(common, off, (1, -1), strict=True)
    ]
    frames = sum(map(len, common))
    lost = frames if runs_freely else sum(map(len, alone))
    drift_ppm = 1e6 * line.slope if line is not None and line.is_straight else math.nan
    skew = usual_ns / 1e9 + float(np.median(skews))
    pair = Pair(a.topic, b.topic, skew, spread(skews), drift_ppm, frames, lost)
    return pair, list(_findings(a, b, pair, alone, duration_s if drifts else 0.0))


def _usual_skew(times: np.ndarray, others: np.ndarray, period_s: float) -> int:
    """
    Return by how much others are later than times, in nanoseconds, whole periods left out.

    It is the mean on a circle, where half a period early is half a period late.
    """
    angles = 2 * math.pi * _differences(times, others) / (1e9 * period_s)
    mean = math.atan2(float(np.sin(angles).mean()), float(np.cos(angles).mean()))
    return round(mean / (2 * math.pi) * period_s * 1e9)


def _drift(seconds: np.ndarray, skews: np.ndarray, period_s: float) -> Line | None:
    """Return the line along which the skew of two cameras changes; None of too few frames."""
    count = min(WINDOWS, len(seconds) // MESSAGES_A_WINDOW)
    if count < LEAST_WINDOWS or seconds[-1] < LEAST_S:
        return None
    skews = np.unwrap(skews, period=period_s)
    parts = zip(np.array_split(seconds, count), np.array_split(skews, count), strict=True)
    x, y = np.array([(part.mean(), np.median(off)) for part, off in parts]).T
    return fit(x - seconds[-1] / 2, y)


def _differences(times: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return for each time by how much the nearest of the others is later, in nanoseconds."""
    behind = np.clip(np.searchsorted(others, times), 1, len(others) - 1)
    later, earlier = others[behind] - times, others[behind - 1] - times
    return np.where(np.abs(later) < np.abs(earlier), later, earlier)


def _apart(pair: Pair, *rates_hz: float) -> Finding:
    return Finding(
        'unsynchronised', f'{pair.first}, {pair.second}', 'warn',
        f'{pair.unsynchronised} of {pair.frames} frames have no partner: the rates are '
        f'{" and ".join(f"{rate:.4g}" for rate in rates_hz)} Hz',
        pair.unsynchronised, pair.unsynchronised / pair.frames, 'ratio',
    )  # fmt: skip


def _findings(
    a: SensorStream, b: SensorStream, pair: Pair, alone: Sequence[np.ndarray], drift_s: float
) -> Iterator[Finding]:
    """Yield what is wrong; ``drift_s`` is for how long the cameras drift apart, 0 if not."""
    topic = f'{a.topic}, {b.topic}'
    if pair.unsynchronised > (1 - TRIGGERED) * pair.frames:
        drift = f' and drift by {pair.skew_drift_ppm:.3g} ppm' if drift_s else ''
        yield Finding(
            'unsynchronised', topic, 'warn',
            f'{pair.unsynchronised} of {pair.frames} frames have no partner: the cameras run '
            f'freely{drift}',
            pair.unsynchronised, pair.unsynchronised / pair.frames, 'ratio',
        )  # fmt: skip
        return
    if drift_s:
        yield Finding(
            'clock_drift', topic, 'warn',
            f'the clock of {b.topic} gains {pair.skew_drift_ppm:.1f} ppm on that of {a.topic}, '
            f'{abs(pair.skew_drift_ppm) * drift_s / 1e3:.3g} ms over the recording',
            value=pair.skew_drift_ppm, unit='ppm',
        )  # fmt: skip
    if pair.unsynchronised:
        counts = ', '.join(
            f'{len(times)} of {stream.topic}' for stream, times in zip((a, b), alone, strict=True)
        )
        moments: list[Moment] = []
        for stream, times in zip((a, b), alone, strict=True):
            begins, ends = runs(np.isin(stream.times_ns, times))
            moments += stream.moments(begins, ends - 1)
        yield Finding(
            'unsynchronised', topic, 'warn', f'frames without a partner: {counts}',
            pair.unsynchronised, pair.unsynchronised / pair.frames, 'ratio',
            tuple(sorted(moments)),
        )  # fmt: skip
    if abs(pair.skew_s) > SKEW_S and not drift_s:
        yield Finding(
            'camera_skew', topic, 'warn',
            f'{b.topic} is stamped {1e3 * abs(pair.skew_s):.3g} ms '
            f'{"later" if pair.skew_s > 0 else "earlier"} than {a.topic}, '
            f'± {1e3 * pair.skew_jitter_s:.2g} ms',
            value=pair.skew_s, unit='s',
        )  # fmt: skip
