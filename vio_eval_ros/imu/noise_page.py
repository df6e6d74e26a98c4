"""The noise of an IMU as a page: its curves and parameters."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from vio_eval_ros.imu.analysis import Analysis, Axis
from vio_eval_ros.imu.fit import PARAMETERS, SI
from vio_eval_ros.imu.noise_reports import cell, fitted_range, reasons, record_line
from vio_eval_ros.rendering.figures import axis, layout
from vio_eval_ros.rendering.page import Html, page, plot, swatch, table, tag, warnings

COLOURS = {'x': '#d1382c', 'y': '#3b8f3b', 'z': '#3f7fc4'}
TITLES = {'gyro': 'Gyroscope', 'accel': 'Accelerometer'}


def html_document(analysis: Analysis) -> str:
    """Return a page of the curves, the parameters and the warnings."""
    legend = [part for name in COLOURS for part in (swatch(COLOURS[name]), name)]
    return page(
        f'{analysis.source}: IMU noise',
        tag('header', tag('div', tag('h1', analysis.source), tag('p', record_line(analysis)))),
        warnings(analysis.warnings),
        tag('h2', 'Overlapping Allan deviation'),
        tag('p', *legend, '; shaded: 95 % confidence; dashed: the fit, over its range'),
        tag(
            'div',
            *(
                plot(_curves(analysis, kind), 420, f'Allan deviation, {kind}', title)
                for kind, title in TITLES.items()
            ),
            class_='plots',
        ),
        *(part for kind in TITLES for part in _parameters(analysis, kind)),
    )


def _parameters(analysis: Analysis, kind: str) -> Iterator[Html]:
    yield tag('h2', TITLES[kind])
    heads = [f'{one.label} [{one.units[kind]}]' for one in PARAMETERS.values()]
    fits = {name[-1]: one.fit for name, one in analysis.axes.items() if name.startswith(kind)}
    rows = [
        [letter, *(cell(getattr(fit, attribute)) for attribute in PARAMETERS), fitted_range(fit)]
        for letter, fit in fits.items()
    ]
    yield table(['', *heads, 'fitted τ [s]'], rows)
    for reason, names in reasons(analysis, kind).items():
        axes = ', '.join(name[-1] for name in names)
        yield tag('p', f'{axes}: {reason}', class_='soft')


def _curves(analysis: Analysis, kind: str) -> dict[str, Any]:
    """Return the figure of one sensor: three curves with confidence and fit."""
    data: list[dict[str, Any]] = []
    for letter, colour in COLOURS.items():
        data += _curve(analysis.axes[f'{kind}_{letter}'], letter, colour, SI[kind])
    return {
        'data': data,
        'layout': layout(
            xaxis=axis('averaging time τ [s]', type='log', dtick=1),
            yaxis=axis(SI[kind].replace('s2', 's²'), type='log', dtick=1),
        ),
    }


def _curve(one: Axis, letter: str, colour: str, unit: str) -> Iterator[dict[str, Any]]:
    taus_s, (low, high) = one.curve.taus_s, one.band
    known = np.isfinite(low) & np.isfinite(high)
    yield {
        'x': [*taus_s[known].tolist(), *taus_s[known][::-1].tolist()],
        'y': [*low[known].tolist(), *high[known][::-1].tolist()],
        'fill': 'toself',
        'opacity': 0.2,
        'fillcolor': colour,
        'line': {'width': 0},
        'hoverinfo': 'skip',
        'mode': 'lines',
    }
    yield {
        'x': taus_s.tolist(),
        'y': one.curve.deviations.tolist(),
        'mode': 'lines',
        'line': {'color': colour, 'width': 1.5},
        'hovertemplate': f'{letter}: %{{y:.4~g}} {unit} at %{{x:.4~g}} s<extra></extra>',
    }
    if one.fit.range_s:
        used = (taus_s >= one.fit.range_s[0]) & (taus_s <= one.fit.range_s[1])
        yield {
            'x': taus_s[used].tolist(),
            'y': one.fit.deviations[used].tolist(),
            'mode': 'lines',
            'line': {'color': colour, 'width': 1, 'dash': 'dash'},
            'hoverinfo': 'skip',
        }
