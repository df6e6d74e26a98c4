"""Cameras that expose together: frames without a partner, and a constant skew."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
import math

import numpy as np

from vio_eval_ros.inspection.findings import Finding
from vio_eval_ros.inspection.streams import Moment, spread, Stream
from vio_eval_ros.inspection.timing import Timing

SAME_RATE = 0.02
# Frames are partners where their stamps differ by no more than this much of a period from the
# usual difference
PARTNERS, PARTNERS_S = 0.1, 0.001
# What blurs no more than half a pixel at 1 rad/s and a focal length of 500 pixels
SKEW_S = 0.0005
# Where fewer have a partner, the cameras run freely
TRIGGERED = 0.5


@dataclass(frozen=True)
class Pair:
    """
    Two cameras of one rate.

    :param skew_s: by how much the second is stamped later, in the median of all frames.
    :param skew_jitter_s: the spread of that, robust.
    :param frames: of both, in the time that they have in common.
    :param unsynchronised: those among them that have no partner.
    """

    first: str
    second: str
    skew_s: float
    skew_jitter_s: float
    frames: int
    unsynchronised: int


def pairs(
    streams: Sequence[Stream], timings: Sequence[Timing]
) -> tuple[list[Pair], list[Finding]]:
    """Return the pairs of cameras of one rate, and what is wrong with each."""
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
        if abs(first.rate_hz / second.rate_hz - 1) < SAME_RATE:
            pair, wrong = _pair(a, b, first.period_s)
            if pair is not None:
                found.append(pair)
                findings += wrong
    return found, findings


def _pair(a: Stream, b: Stream, period_s: float) -> tuple[Pair | None, list[Finding]]:
    first, second = np.unique(a.times_ns), np.unique(b.times_ns)
    begin, end = max(first[0], second[0]), min(first[-1], second[-1])
    near = round(period_s * 0.5e9)
    common = [times[(times >= begin - near) & (times <= end + near)] for times in (first, second)]
    if begin > end or min(map(len, common)) < 3:
        return None, []
    skews = _differences(*common) / 1e9
    usual = float(np.median(skews))
    reach = max(PARTNERS * period_s, PARTNERS_S)
    alone = [
        times[np.abs(_differences(times, others) / 1e9 - side * usual) > reach]
        for times, others, side in ((*common, 1), (*common[::-1], -1))
    ]
    alone = [times[(times >= begin) & (times <= end)] for times in alone]
    frames = sum(map(len, common))
    pair = Pair(a.topic, b.topic, usual, spread(skews), frames, sum(map(len, alone)))
    return pair, list(_findings(a, b, pair, alone))


def _differences(times: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return for each time by how much the nearest of the others is later, in nanoseconds."""
    behind = np.clip(np.searchsorted(others, times), 1, len(others) - 1)
    later, earlier = others[behind] - times, others[behind - 1] - times
    return np.where(np.abs(later) < np.abs(earlier), later, earlier)


def _findings(a: Stream, b: Stream, pair: Pair, alone: Sequence[np.ndarray]) -> Iterator[Finding]:
    topic = f'{a.topic}, {b.topic}'
    if pair.unsynchronised > (1 - TRIGGERED) * pair.frames:
        yield Finding(
            'unsynchronised', topic, 'warn',
            f'{pair.unsynchronised} of {pair.frames} frames have no partner: the cameras run '
            'freely',
            pair.unsynchronised, pair.unsynchronised / pair.frames, 'ratio',
        )  # fmt: skip
        return
    if pair.unsynchronised:
        counts = ', '.join(
            f'{len(times)} of {stream.topic}' for stream, times in zip((a, b), alone, strict=True)
        )
        moments: list[Moment] = []
        for stream, times in zip((a, b), alone, strict=True):
            which = np.flatnonzero(np.isin(stream.times_ns, times))
            moments += stream.moments(which, which)
        yield Finding(
            'unsynchronised', topic, 'warn', f'frames without a partner: {counts}',
            pair.unsynchronised, pair.unsynchronised / pair.frames, 'ratio',
            tuple(sorted(moments)),
        )  # fmt: skip
    if abs(pair.skew_s) > SKEW_S:
        yield Finding(
            'camera_skew', topic, 'warn',
            f'{b.topic} is stamped {1e3 * abs(pair.skew_s):.3g} ms '
            f'{"later" if pair.skew_s > 0 else "earlier"} than {a.topic}, '
            f'± {1e3 * pair.skew_jitter_s:.2g} ms',
            value=pair.skew_s, unit='s',
        )  # fmt: skip
