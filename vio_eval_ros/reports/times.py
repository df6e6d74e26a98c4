"""The figures of a run over time beside its errors: place, attitude, error along each axis."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vio_eval_ros.rendering.figures import AMBER, axis, BLUE, Figure, GREY, layout, numbers
from vio_eval_ros.reports.drawn_run import Curve, DrawnRun

TIME = 'time since the first ground truth [s]'
ANGLES = ('roll [deg]', 'pitch [deg]', 'yaw [deg]')
#: of the height, between two of the three figures that share their time
SPACE = 0.05
#: of 3 sigma
BAND = 'rgba(201,138,27,0.22)'


def places_over_time(run: DrawnRun) -> Figure:
    """Return x, y and z of the aligned estimate over time, with the ground truth."""
    seconds, truth = run.truth_over_time
    estimate = run.estimate - run.origin
    rows = [
        [
            _line(Curve(seconds, truth[:, k]).thinned(run.most_points), GREY, 'm'),
            _line(run.over_time(estimate[:, k]), BLUE, 'm'),
        ]
        for k in range(3)
    ]
    return _stacked(run, rows, run.labels)


def attitudes_over_time(run: DrawnRun) -> Figure | None:
    """Return roll, pitch and yaw likewise, without turns of 360 degrees; None where unknown."""
    if run.attitudes is None:
        return None
    truth, estimate = run.attitudes
    rows = [
        [
            _line(run.over_time(truth[:, k]), GREY, 'deg'),
            _line(run.over_time(estimate[:, k]), BLUE, 'deg'),
        ]
        for k in range(3)
    ]
    return _stacked(run, rows, ANGLES)


def errors_along_axes(run: DrawnRun) -> Figure | None:
    """Return the error along each axis with 3 sigma; None where the estimate states none."""
    sigma = run.three_sigma
    if sigma is None:
        return None
    errors = run.estimate - run.truth
    rows = [
        [
            *_band(run.over_time(sigma[:, k])),
            _line(run.over_time(errors[:, k]), BLUE, 'm'),
        ]
        for k in range(3)
    ]
    return _stacked(run, rows, [f'{name} error [m]' for name in 'xyz'])


def _line(curve: Curve, colour: str, unit: str) -> Figure:
    return {
        'type': 'scatter',
        # a single point between two gaps would be invisible as a line
        'mode': 'lines+markers' if np.isnan(curve.y).any() else 'lines',
        'marker': {'size': 2.5, 'color': colour},
        'x': numbers(curve.x),
        'y': numbers(curve.y),
        'line': {'color': colour, 'width': 2.5 if colour == GREY else 1.5},
        'hovertemplate': f'%{{y:.4~g}} {unit} at %{{x}} s<extra></extra>',
    }


def _band(bound: Curve) -> list[Figure]:
    """Return the lines of plus and minus a bound, the area between them filled."""
    line = {'color': AMBER, 'width': 0.75}
    return [
        {
            'type': 'scatter', 'mode': 'lines', 'x': numbers(bound.x), 'y': numbers(of),
            'line': line, 'hoverinfo': 'skip', **fill,
        }
        for of, fill in ((-bound.y, {}), (bound.y, {'fill': 'tonexty', 'fillcolor': BAND}))
    ]  # fmt: skip


def _stacked(run: DrawnRun, rows: Sequence[Sequence[Figure]], titles: Sequence[str]) -> Figure:
    """Return three figures above each other that share their time."""
    height = (1 - 2 * SPACE) / 3
    names = ['y', 'y2', 'y3']
    axes = {
        f'yaxis{name[1:]}': axis(
            title, domain=[top - height if top > height else 0, top], nticks=5
        )
        for name, title, top in zip(
            names, titles, (1, 1 - height - SPACE, height), strict=True
        )
    }  # fmt: skip
    return {
        'data': [
            {**trace, 'yaxis': name}
            for name, traces in zip(names, rows, strict=True)
            for trace in traces
        ],
        'layout': layout(
            xaxis=axis(TIME, range=[0, run.end], anchor=names[-1]), hovermode='x', **axes
        ),
    }
