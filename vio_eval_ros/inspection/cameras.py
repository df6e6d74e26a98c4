"""Cameras that expose together: frames without a partner, and their skew."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.sensor_stream import Moment, runs, SensorStream, spread
from vio_eval_ros.inspection.clocks import (
    is_drift,
    Line,
    MAX_WINDOWS,
    MIN_DURATION_S,
    MIN_WINDOWS,
    robust_line,
    WINDOW_MESSAGES,
)
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.limits import InspectionLimits
from vio_eval_ros.inspection.measured_stream import MeasuredStream

#: relative difference up to which two rates are the same
SAME_RATE = 0.02
#: difference of partner frames from the usual skew, in spreads of it ...
PARTNER_SPREADS = 6.0
#: ... and in periods, where skews spread over the whole period
PARTNER_PERIODS = 0.1
#: share of frames with a partner below which the cameras run freely
TRIGGERED_SHARE = 0.5


@dataclass(frozen=True)
class Pair:
    """
    Two cameras; of different rates, the slower is the first.

    :param skew_s: by how much the second is stamped later, in the median of all frames; up to
        half a period, since whole ones cannot be determined.
    :param skew_jitter_s: the spread of that, robust.
    :param skew_drift_ppm: by how much faster than the first the clock of the second runs; NaN
        where there are too few frames, or it does not run evenly.
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
    streams: Sequence[MeasuredStream], limits: InspectionLimits
) -> tuple[list[Pair], list[Finding]]:
    """Return the pairs of cameras, and what is wrong with each."""
    cameras = [
        one
        for one in streams
        if one.stream.kind == 'camera'
        and one.stream.stamps_ns is not None
        and math.isfinite(one.timing.rate_hz)
    ]
    found: list[Pair] = []
    findings: list[Finding] = []
    for first, second in combinations(cameras, 2):
        rates_hz = [first.timing.rate_hz, second.timing.rate_hz]
        has_one_rate = abs(rates_hz[0] / rates_hz[1] - 1) < SAME_RATE
        if not has_one_rate and rates_hz[0] > rates_hz[1]:
            first, second = second, first
        period_s = (first if has_one_rate else second).timing.period_s
        compared = _compared(first.stream, second.stream, period_s, limits)
        if compared is None:
            continue
        found.append(compared.pair)
        if has_one_rate:
            findings += _findings(first.stream, second.stream, compared, limits)
        else:
            findings.append(_of_two_rates(compared.pair, sorted(rates_hz)))
    return found, findings


class _Compared(NamedTuple):
    """A pair, the stamps of frames without a partner, and how long the cameras drift apart."""

    pair: Pair
    alone: list[np.ndarray]
    drift_s: float


def _compared(
    a: SensorStream, b: SensorStream, period_s: float, limits: InspectionLimits
) -> _Compared | None:
    """Return what two cameras have in common; None where that is too little."""
    first, second = np.unique(a.times_ns), np.unique(b.times_ns)
    begin, end = max(first[0], second[0]), min(first[-1], second[-1])
    near = round(period_s * 0.5e9)
    common = [times[(times >= begin - near) & (times <= end + near)] for times in (first, second)]
    if begin > end or min(map(len, common)) < 3:
        return None
    usual_ns = _usual_skew(common[0], common[1], period_s)
    partners = common[1] - usual_ns
    skews = _differences(common[0], partners) / 1e9
    line = _drift((common[0] - common[0][0]) / 1e9, skews, period_s)
    duration_s = float(np.ptp(common[0])) / 1e9
    runs_freely = False
    drift_s = 0.0
    if line is not None and is_drift(line, duration_s, limits.drift_ppm, limits.camera_drift_s):
        drift_s = duration_s
        runs_freely = abs(line.slope) * duration_s > period_s / 2
        # what drifts apart evenly is still together
        partners = partners - np.rint(line.slope * (partners - common[0][0])).astype(np.int64)
    alone = [
        times[is_alone & (times >= begin) & (times <= end)]
        for times, is_alone in zip(
            common, _alone(common[0], partners, period_s, limits), strict=True
        )
    ]
    frames = sum(map(len, common))
    pair = Pair(
        first=a.topic,
        second=b.topic,
        skew_s=usual_ns / 1e9 + float(np.median(skews)),
        skew_jitter_s=spread(skews),
        skew_drift_ppm=1e6 * line.slope if line is not None and line.is_straight else math.nan,
        frames=frames,
        unsynchronised=frames if runs_freely else sum(map(len, alone)),
    )
    return _Compared(pair, alone, drift_s)


def _alone(
    times: np.ndarray, partners: np.ndarray, period_s: float, limits: InspectionLimits
) -> list[np.ndarray]:
    """Return which times have no partner, and which partners have none."""
    off = [_differences(times, partners) / 1e9, _differences(partners, times) / 1e9]
    usual = float(np.median(off[0]))
    reach = max(limits.partner_s, PARTNER_SPREADS * spread(off[0]))
    if reach > period_s / 2:
        reach = PARTNER_PERIODS * period_s
    return [np.abs(off[0] - usual) > reach, np.abs(off[1] + usual) > reach]


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
    count = min(MAX_WINDOWS, len(seconds) // WINDOW_MESSAGES)
    if count < MIN_WINDOWS or seconds[-1] < MIN_DURATION_S:
        return None
    skews = np.unwrap(skews, period=period_s)
    parts = zip(np.array_split(seconds, count), np.array_split(skews, count), strict=True)
    x, y = np.array([(part.mean(), np.median(off)) for part, off in parts]).T
    return robust_line(x - seconds[-1] / 2, y)


def _differences(times: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return for each time by how much the nearest of the others is later, in nanoseconds."""
    after = np.clip(np.searchsorted(others, times), 1, len(others) - 1)
    later, earlier = others[after] - times, others[after - 1] - times
    return np.where(np.abs(later) < np.abs(earlier), later, earlier)


def _of_two_rates(pair: Pair, rates_hz: Sequence[float]) -> Finding:
    return FINDINGS['unsynchronised'].found(
        f'{pair.first}, {pair.second}',
        'rates',
        frames=pair.frames,
        rates=' and '.join(f'{rate:.4g}' for rate in rates_hz),
        count=pair.unsynchronised,
        value=pair.unsynchronised / pair.frames,
    )


def _findings(
    a: SensorStream, b: SensorStream, compared: _Compared, limits: InspectionLimits
) -> Iterator[Finding]:
    """Yield what is wrong with two cameras of one rate."""
    pair, drifts = compared.pair, compared.drift_s > 0
    where = f'{a.topic}, {b.topic}'
    lost, share = pair.unsynchronised, pair.unsynchronised / pair.frames
    if lost > (1 - TRIGGERED_SHARE) * pair.frames:
        yield FINDINGS['unsynchronised'].found(
            where,
            'free',
            frames=pair.frames,
            drift=f' and drift by {pair.skew_drift_ppm:.3g} ppm' if drifts else '',
            count=lost,
            value=share,
        )
        return
    if drifts:
        yield FINDINGS['clock_drift'].found(
            where,
            'cameras',
            first=a.topic,
            second=b.topic,
            total_ms=abs(pair.skew_drift_ppm) * compared.drift_s / 1e3,
            value=pair.skew_drift_ppm,
        )
    if lost:
        of_both = list(zip((a, b), compared.alone, strict=True))
        moments: list[Moment] = []
        for stream, times in of_both:
            begins, ends = runs(np.isin(stream.times_ns, times))
            moments += stream.moments(begins, ends - 1)
        yield FINDINGS['unsynchronised'].found(
            where,
            'some',
            counts=', '.join(f'{len(times)} of {stream.topic}' for stream, times in of_both),
            count=lost,
            value=share,
            moments=tuple(sorted(moments)),
        )
    if abs(pair.skew_s) > limits.camera_skew_s and not drifts:
        yield FINDINGS['camera_skew'].found(
            where,
            first=a.topic,
            second=b.topic,
            ms=1e3 * abs(pair.skew_s),
            side='later' if pair.skew_s > 0 else 'earlier',
            spread_ms=1e3 * pair.skew_jitter_s,
            value=pair.skew_s,
        )
