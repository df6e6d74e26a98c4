"""The figures of a suite: every run of a sequence on one scale."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import math
from typing import NamedTuple

from vio_eval_ros.rendering.figures import (
    AMBER,
    axis,
    BLUE,
    Figure,
    GREY,
    label,
    line_layout,
    RED,
    shortened,
)
from vio_eval_ros.rendering.text import number
from vio_eval_ros.scoring.results import SequenceResult

MOST_LETTERS = 20
#: how far below the middle of its line a kind of mark is, and its style; later kinds are on top
MARKERS: Mapping[str, tuple[float, Figure]] = {
    'baseline': (0.22, {'symbol': 'circle-open', 'size': 8, 'color': GREY}),
    'baseline, median': (
        0.22,
        {'symbol': 'line-ns', 'size': 11, 'line': {'color': GREY, 'width': 2}},
    ),
    'run': (0, {'size': 8, 'color': BLUE, 'opacity': 0.75}),
    'failed run': (
        0,
        {'symbol': 'x-thin', 'size': 8, 'line': {'color': RED, 'width': 2}},
    ),
    'median': (0, {'symbol': 'line-ns', 'size': 11, 'line': {'color': BLUE, 'width': 2}}),
    'warn': (0, {'symbol': 'line-ns', 'size': 22, 'line': {'color': AMBER, 'width': 2}}),
    'fail': (0, {'symbol': 'line-ns', 'size': 22, 'line': {'color': RED, 'width': 2}}),
}


class Mark(NamedTuple):
    """A value on a line, drawn as one of ``MARKERS``, and its label."""

    kind: str
    value: float
    label: str


def marks(one: SequenceResult, metric: str) -> list[Mark]:
    """Return the runs of a sequence on the scale of a metric, the baseline's, and the gates."""
    return [mark for mark in _marks(one, metric) if math.isfinite(mark.value)]


def _marks(one: SequenceResult, metric: str) -> Iterator[Mark]:
    for each in one.comparisons or ():
        if each.rule.metric == metric:
            yield from (Mark('baseline', v, 'baseline') for v in each.baseline.values)
            yield Mark('baseline, median', each.baseline.median, 'median of the baseline')
    for run in one.runs:
        if run.result is not None:
            kind = 'run' if run.succeeded(one.sequence) else 'failed run'
            yield Mark(kind, run.result.summary.metrics[metric], run.run.name)
    if len(one.runs) > 1 and metric in one.metrics:
        yield Mark('median', one.metrics[metric].median, 'median')
    for gate in one.sequence.gates:
        if gate.gate.metric == metric:
            yield Mark(gate.gate.severity, gate.gate.limit, f'gate ({gate.gate.severity})')


def strips(title: str, rows: Sequence[tuple[str, Sequence[Mark]]]) -> Figure:
    """Return a line of marks for each name, the first at the top, on one scale."""
    values = [mark.value for _, line in rows for mark in line] or [0.0]
    wide = min(values) > 0 and max(values) > 20 * min(values)
    return {
        'data': [_dots(kind, rows) for kind in MARKERS],
        'layout': line_layout(
            [shortened(name, MOST_LETTERS) for name, _ in rows],
            xaxis=axis(title, **({'type': 'log'} if wide else {'rangemode': 'tozero'})),
        ),
    }


def _dots(kind: str, rows: Sequence[tuple[str, Sequence[Mark]]]) -> Figure:
    """Return the marks of a kind on all lines."""
    below, marker = MARKERS[kind]
    found = [(k, mark) for k, (_, line) in enumerate(rows) for mark in line if mark.kind == kind]
    return {
        'type': 'scatter',
        'mode': 'markers',
        'x': [mark.value for _, mark in found],
        'y': [k + below for k, _ in found],
        'text': [label(f'{mark.label}: {number(mark.value)}') for _, mark in found],
        'hovertemplate': '%{text}<extra></extra>',
        'marker': marker,
    }
