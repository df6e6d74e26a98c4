"""The figures of an inspection: the timeline of all streams, and the periods of each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.measured_stream import MeasuredStream
from vio_eval_ros.inspection.report import Report
from vio_eval_ros.inspection.timing import MISSING_PERIODS
from vio_eval_ros.rendering.figures import (
    AMBER,
    axis,
    BLUE,
    extremes,
    Figure,
    GREY,
    label,
    layout,
    line_layout,
    numbers,
    RED,
    shortened,
)
from vio_eval_ros.rendering.text import number

# More points of a period over time, and more marks of a finding, make a page slow
MAX_POINTS, MAX_MARKS = 2000, 300
# Longer periods are drawn at the top
TOP_PERIODS = 4.0
MAX_LETTERS = 26
COLOURS = {'fail': RED, 'warn': AMBER, 'info': GREY}


def timeline(report: Report) -> Figure:
    """Return a bar for each stream, the worst at the top, with its gaps and findings."""
    streams = report.streams
    origin_ns = report.inspection.begin_ns
    lines = {one.stream.topic: k for k, one in enumerate(streams)}
    data = [_bars(streams, origin_ns), *_holes(streams, origin_ns)]
    for level in ('info', 'warn', 'fail'):
        data += _marks(level, report.findings, lines, origin_ns)
    # the end of a topic says more than its beginning
    names = [shortened(one.stream.topic, MAX_LETTERS, keep_end=True) for one in streams]
    return {
        'data': data,
        'layout': line_layout(
            names,
            barmode='overlay',
            xaxis=axis(f'seconds of the recording, since {origin_ns / 1e9:.3f}'),
        ),
    }


def _bars(streams: Sequence[MeasuredStream], origin_ns: int) -> Figure:
    """Return a bar from the first to the last message of each stream."""
    arrivals = [one.stream.arrivals_ns for one in streams]
    return {
        'type': 'bar',
        'orientation': 'h',
        'base': [float(times.min() - origin_ns) / 1e9 for times in arrivals],
        # a single message is seen, too
        'x': [max(float(np.ptp(times)) / 1e9, 1e-3) for times in arrivals],
        'y': list(range(len(streams))),
        'width': 0.5,
        'marker': {'color': BLUE, 'opacity': 0.55},
        'text': [
            label(f'{one.stream.topic}: {one.timing.count:,}, {number(one.timing.rate_hz)} Hz')
            for one in streams
        ],
        'textposition': 'none',
        'hovertemplate': '%{text}<extra></extra>',
    }


def _holes(streams: Sequence[MeasuredStream], origin_ns: int) -> list[Figure]:
    """Return the intervals in which messages are missing, the longest of each stream."""
    base: list[float] = []
    length: list[float] = []
    line: list[int] = []
    for k, one in enumerate(streams):
        periods = one.timing.periods_s
        if not one.timing.missing or not len(periods):
            continue
        longest = np.argsort(-periods, kind='stable')[:MAX_MARKS]
        longest = longest[periods[longest] > (1 + MISSING_PERIODS) * one.timing.period_s]
        ends = one.timing.times_s[longest]
        begins, ends = (_recorded(one, at, origin_ns) for at in (ends - periods[longest], ends))
        base += begins.tolist()
        length += (ends - begins).tolist()
        line += [k] * len(longest)
    if not base:
        return []
    return [
        {
            'type': 'bar',
            'orientation': 'h',
            'base': base,
            'x': length,
            'y': line,
            'width': 0.5,
            'marker': {'color': GREY, 'line': {'color': GREY, 'width': 1}},
            'hovertemplate': '%{x:.3f} s without messages, from %{base:.3f} s<extra></extra>',
        }
    ]


def _recorded(one: MeasuredStream, seconds: np.ndarray, origin_ns: int) -> np.ndarray:
    """Return when stamps, seconds since the first, were recorded, in seconds of the recording."""
    order = np.argsort(one.stream.times_ns, kind='stable')
    stamps = (one.stream.times_ns[order] - one.timing.first_ns) / 1e9
    return np.interp(seconds, stamps, (one.stream.arrivals_ns[order] - origin_ns) / 1e9)


def _marks(
    level: str, findings: Sequence[Finding], lines: dict[str, int], origin_ns: int
) -> list[Figure]:
    """Return where the findings of a level begin, and a line until they end."""
    found = [
        (moment, lines[topic] - 0.34, one)
        for one in findings
        if one.level == level
        for topic in one.topics
        if topic in lines
        for moment in one.moments
    ]
    begins = [(moment.logged_begin_ns - origin_ns) / 1e9 for moment, _, _ in found]
    ends = [(moment.logged_end_ns - origin_ns) / 1e9 for moment, _, _ in found]
    heights = [y for _, y, _ in found]
    return [
        {
            'type': 'scatter',
            'mode': 'lines',
            # nothing connects one with the next
            'x': [x for pair in zip(begins, ends, strict=True) for x in (*pair, None)],
            'y': [y for height in heights for y in (height, height, None)],
            'line': {'color': COLOURS[level], 'width': 3},
            'hoverinfo': 'skip',
        },
        {
            'type': 'scatter',
            'mode': 'markers',
            'x': begins,
            'y': heights,
            'text': [label(f'{one.name}: {one.message}') for _, _, one in found],
            'hovertemplate': '%{x:.3f} s: %{text}<extra></extra>',
            'marker': {'symbol': 'triangle-down', 'size': 9, 'color': COLOURS[level]},
        },
    ]


def period_over_time(one: MeasuredStream, origin_ns: int) -> Figure:
    """
    Return the periods of a stream, thinned to their outline; those far too long at the top.

    :param origin_ns: when the first message of the recording was recorded, where time begins.
    """
    times = _recorded(one, one.timing.times_s, origin_ns)
    usual = 1e3 * one.timing.period_s
    periods = 1e3 * one.timing.periods_s
    top = TOP_PERIODS * usual
    within, beyond = periods <= top, np.flatnonzero(periods > top)[:MAX_MARKS]
    chosen = np.flatnonzero(within)[extremes(periods[within], MAX_POINTS)]
    return {
        'data': [
            _dots(times[chosen], periods[chosen], periods[chosen], BLUE, size=3.5),
            _dots(
                times[beyond], np.full(len(beyond), top), periods[beyond], RED,
                symbol='triangle-up', size=9,
            ),
        ],
        'layout': layout(
            xaxis=axis('seconds of the recording'),
            yaxis=axis('period [ms]', range=_range(periods[within], usual, top, len(beyond) > 0)),
        ),
    }  # fmt: skip


def _dots(
    times: np.ndarray, heights: np.ndarray, periods: np.ndarray, colour: str, **marker: Any
) -> Figure:
    return {
        'type': 'scatter',
        'mode': 'markers',
        'x': numbers(times),
        'y': numbers(heights),
        'customdata': numbers(periods),
        'marker': {'color': colour, **marker},
        'hovertemplate': '%{customdata:.3f} ms at %{x:.3f} s<extra></extra>',
    }


def _range(periods: np.ndarray, usual: float, top: float, is_beyond: bool) -> list[float]:
    """Return from where to where the axis goes; equal periods do not fill it with noise."""
    if is_beyond:
        return [0.0, 1.1 * top]
    low, high = float(periods.min()), float(periods.max())
    if high > 1.5 * usual:
        return [0.0, 1.1 * high]
    reach = max(1.2 * (high - usual), 1.2 * (usual - low), 0.02 * usual)
    return [usual - reach, usual + reach]
