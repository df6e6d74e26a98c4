"""What the HTML report of a suite draws: every run of a sequence on one scale."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
import math
from typing import NamedTuple

from vio_eval_ros.rendering.figures import AMBER, axis, BLUE, Figure, GREY, layout, RED
from vio_eval_ros.rendering.text import number, printable
from vio_eval_ros.scoring.scoring import SequenceResult

MOST_LETTERS = 20
PIXELS_A_LETTER = 7
#: how each kind of mark looks, and how far below the middle of its line it is; the last are on top
MARKERS: Mapping[str, tuple[float, Figure]] = {
    'baseline': (0.22, {'symbol': 'circle-open', 'size': 8, 'color': GREY}),
    'baseline, median': (
        0.22,
        {'symbol': 'line-ns', 'size': 11, 'line': {'color': GREY, 'width': 2}},
    ),
    'run': (0, {'size': 8, 'color': BLUE, 'opacity': 0.75}),
    'run without success': (
        0,
        {'symbol': 'x-thin', 'size': 8, 'line': {'color': RED, 'width': 2}},
    ),
    'median': (0, {'symbol': 'line-ns', 'size': 11, 'line': {'color': BLUE, 'width': 2}}),
    'warn': (0, {'symbol': 'line-ns', 'size': 22, 'line': {'color': AMBER, 'width': 2}}),
    'fail': (0, {'symbol': 'line-ns', 'size': 22, 'line': {'color': RED, 'width': 2}}),
}


class Mark(NamedTuple):
    """A value on a line: one of ``MARKERS``, and what is told of it."""

    kind: str
    value: float
    told: str


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
            kind = 'run' if run.succeeded(one.sequence) else 'run without success'
            yield Mark(kind, run.result.summary.metrics[metric], run.run.name)
    if len(one.runs) > 1 and metric in one.metrics:
        yield Mark('median', one.metrics[metric].median, 'median')
    for gate in one.sequence.gates:
        if gate.gate.metric == metric:
            yield Mark(gate.gate.severity, gate.gate.limit, f'gate ({gate.gate.severity})')


def strips(title: str, rows: Sequence[tuple[str, Sequence[Mark]]]) -> Figure:
    """Return a line with marks for each of some names, the first at the top, on one scale."""
    values = [mark.value for _, line in rows for mark in line] or [0.0]
    wide = min(values) > 0 and max(values) > 20 * min(values)
    names = [_plain(_cut(name)) for name, _ in rows]
    widest = max(len(_cut(name)) for name, _ in rows)
    return {
        'data': [_dots(kind, rows) for kind in MARKERS],
        'layout': layout(
            xaxis=axis(title, **({'type': 'log'} if wide else {'rangemode': 'tozero'})),
            yaxis=axis(
                range=[len(rows) - 0.4, -0.6],
                tickvals=list(range(len(rows))),
                ticktext=names,
                fixedrange=True,
            ),
            margin={'l': 16 + PIXELS_A_LETTER * widest, 'r': 10, 't': 10, 'b': 42},
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
        'text': [_plain(f'{mark.told}: {number(mark.value)}') for _, mark in found],
        'hovertemplate': '%{text}<extra></extra>',
        'marker': marker,
    }


def _cut(name: str) -> str:
    """Return a name that leaves room for what it is the name of."""
    return name if len(name) <= MOST_LETTERS else name[: MOST_LETTERS - 1] + '…'


def _plain(text: str) -> str:
    """Return text of which plotly makes neither links nor bold letters."""
    return escape(printable(text))
