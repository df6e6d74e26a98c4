"""What all figures have in common; a figure is a plain dict as plotly takes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from itertools import pairwise
import math
from typing import Any

import numpy as np

from vio_eval_ros.rendering.text import printable

Figure = dict[str, Any]

BLUE, RED, GREY, AMBER = '#3f7fc4', '#d1452f', '#8a919b', '#c98a1b'
#: decimal digits of a coordinate, of the range of all
DIGITS = 5
PIXELS_PER_LETTER = 7
AXIS = {'gridcolor': 'rgba(128,128,128,0.22)', 'zeroline': False, 'exponentformat': 'e'}


def layout(**more: Any) -> Figure:
    """Return the layout that all figures share; text takes its colour from the page."""
    return {
        'font': {'family': 'system-ui, sans-serif', 'size': 12},
        'paper_bgcolor': 'rgba(0,0,0,0)',
        'plot_bgcolor': 'rgba(0,0,0,0)',
        # margins that follow the labels would take plotly several tries, and differ between plots
        'margin': {'l': 64, 'r': 10, 't': 30, 'b': 42},
        'showlegend': False,
        'hovermode': 'closest',
        **more,
    }


def axis(title: str = '', **more: Any) -> Figure:
    """Return an axis with a title."""
    return {**AXIS, 'title': {'text': title}, **more}


def line_layout(names: Sequence[str], **more: Any) -> Figure:
    """Return the layout of a figure with one line per name, the first at the top."""
    return layout(
        yaxis=axis(
            range=[len(names) - 0.4, -0.6],
            tickvals=list(range(len(names))),
            ticktext=[label(name) for name in names],
            fixedrange=True,
        ),
        margin={'l': 16 + PIXELS_PER_LETTER * max(map(len, names)), 'r': 10, 't': 30, 'b': 42},
        **more,
    )


def label(text: str) -> str:
    """Return text that plotly shows as it is: without links or markup."""
    return escape(printable(text))


def shortened(name: str, most_letters: int, keep_end: bool = False) -> str:
    """Return a name that is cut to a number of letters, at its end unless that is to stay."""
    if len(name) <= most_letters:
        return name
    return '…' + name[1 - most_letters :] if keep_end else name[: most_letters - 1] + '…'


def extremes(values: np.ndarray, most_points: int) -> np.ndarray:
    """
    Return which of (N,) values keep the outline of their curve, in rising order.

    These are the least and the greatest of each of ``most_points / 2`` stretches of equal length;
    all where there are no more than ``most_points``.
    """
    if len(values) <= most_points:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), most_points // 2 + 1).astype(int)
    stretches = list(pairwise(edges.tolist()))
    least = [begin + int(values[begin:end].argmin()) for begin, end in stretches]
    greatest = [begin + int(values[begin:end].argmax()) for begin, end in stretches]
    return np.unique(least + greatest)


def numbers(values: np.ndarray) -> list[float | None]:
    """Return (N,) numbers as JSON has them, to 1e-5 of their range; None for NaN."""
    known = values[np.isfinite(values)]
    spread = float(np.ptp(known)) if len(known) else 0.0
    decimals = DIGITS - math.floor(math.log10(spread)) if spread > 0 else 9
    return [v if math.isfinite(v) else None for v in np.round(values, decimals).tolist()]


def boxes(title: str, samples: Mapping[str, np.ndarray]) -> Figure:
    """Return a box plot of each sample; whiskers reach from the 5th to the 95th percentile."""
    quantiles = [np.quantile(values, [0.05, 0.25, 0.5, 0.75, 0.95]) for values in samples.values()]
    low, q1, median, q3, high = (column.tolist() for column in np.transpose(quantiles))
    spread = min(low) > 0 and max(high) > 20 * min(low)
    return {
        'data': [
            {
                'type': 'box',
                'x': list(range(len(samples))),
                'lowerfence': low,
                'q1': q1,
                'median': median,
                'q3': q3,
                'upperfence': high,
                'mean': [float(values.mean()) for values in samples.values()],
                'line': {'color': BLUE, 'width': 1.5},
                'fillcolor': 'rgba(63,127,196,0.25)',
                'width': 0.4,
                'yhoverformat': '.4~g',
            }
        ],
        'layout': layout(
            xaxis=axis(
                tickvals=list(range(len(samples))),
                ticktext=list(samples),
                range=[-0.6, len(samples) - 0.4],
                showgrid=False,
            ),
            yaxis=axis(
                title,
                type='log' if spread else 'linear',
                **({'dtick': 'D2'} if spread else {'rangemode': 'tozero'}),
            ),
        ),
    }
