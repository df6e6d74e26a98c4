"""What all figures look like, as plotly's in plain dicts."""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import Any

import numpy as np

Figure = dict[str, Any]


DIGITS = 5


BLUE, RED, GREY, AMBER = '#3f7fc4', '#d1452f', '#8a919b', '#c98a1b'


AXIS = {'gridcolor': 'rgba(128,128,128,0.22)', 'zeroline': False, 'exponentformat': 'e'}


def layout(**more: Any) -> Figure:
    """Return what all figures look like; colours of text follow the page."""
    return {
        'font': {'family': 'system-ui, sans-serif', 'size': 12},
        'paper_bgcolor': 'rgba(0,0,0,0)',
        'plot_bgcolor': 'rgba(0,0,0,0)',
        # margins that follow the labels would take plotly several tries, and differ between plots
        'margin': {'l': 64, 'r': 10, 't': 10, 'b': 42},
        'showlegend': False,
        'hovermode': 'closest',
        **more,
    }


def axis(title: str = '', **more: Any) -> Figure:
    """Return an axis with a title."""
    return {**AXIS, 'title': {'text': title}, **more}


def numbers(values: np.ndarray) -> list[float | None]:
    """Return (N,) numbers as JSON has them, to 1e-5 of their range; None for what is none."""
    known = values[np.isfinite(values)]
    spread = float(np.ptp(known)) if len(known) else 0.0
    decimals = DIGITS - math.floor(math.log10(spread)) if spread > 0 else 9
    return [v if math.isfinite(v) else None for v in np.round(values, decimals).tolist()]


def boxes(title: str, samples: Mapping[str, np.ndarray]) -> Figure:
    """Return a box over the quartiles for each sample, with whiskers from 5 to 95 percent."""
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
