"""The figures of a run: its path in space, its errors over time, its relative errors."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
import math

import numpy as np

from vio_eval_ros.core.config import Delta, plain
from vio_eval_ros.core.intervals import longest_tracked
from vio_eval_ros.core.relative import (
    candidates,
    progress_along,
    relative_errors,
    RPE_KINDS,
    segment_errors,
)
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.rendering.figures import AMBER, axis, BLUE, Figure, GREY, layout, numbers, RED
from vio_eval_ros.reports.drawn_run import DrawnPairs

MOST_MARKS = 100
#: from no error to the largest; calm to hot, on light and dark alike
RAMP = ('#3569b0', '#2aa3a3', '#86b63c', '#e6a426', '#d1382c')
LEVELS = 16
#: viewpoint of the 3-D view by the horizontal axes; in a camera frame, y points down
CAMERAS = {
    'xy': {'eye': {'x': 1.05, 'y': -1.5, 'z': 1.0}, 'center': {'x': 0, 'y': 0, 'z': -0.1}},
    'xz': {
        'eye': {'x': 1.05, 'y': -1.0, 'z': -1.5},
        'center': {'x': 0, 'y': 0.1, 'z': 0},
        'up': {'x': 0, 'y': -1, 'z': 0},
    },
}
QUIET = {'hoverinfo': 'skip'}
START = {'mode': 'markers', 'hovertemplate': 'start<extra></extra>'}
NOWHERE = {'mode': 'markers', 'x': [None], 'y': [None]}
GAP = 'rgba(128,128,128,0.22)'


def path_3d(run: DrawnPairs) -> Figure:
    """Return the aligned estimate in the colours of its error, with the ground truth, in 3-D."""
    chosen, kind = run.evenly_spaced(), {'type': 'scatter3d'}
    truth, estimate = (run.places(p, 'xyz', chosen) for p in (run.truth, run.estimate))
    drawn = [run.truth, run.estimate]
    drawn += [] if run.whole is None else [run.whole.positions]
    both = np.vstack(drawn) - run.origin
    low, high = both.min(axis=0), both.max(axis=0)
    # a little room, and never flat; what plotly calls the aspect of the data fits cubes only
    room = max(0.02 * float((high - low).max()), 1e-3)
    low, high = low - room, high + room
    sides = (high - low) / (high - low).max()
    axes = {
        f'{name}axis': axis(
            run.labels[k], range=[float(low[k]), float(high[k])],
            nticks=round(1 + 6 * sides[k]), gridcolor='#a9aeb5',
            showbackground=False, showspikes=False,
        )
        for k, name in enumerate('xyz')
    }  # fmt: skip
    return {
        'data': [
            *_outline(run, 'xyz', kind),
            {**kind, **truth, 'mode': 'lines', 'line': {'color': GREY, 'width': 2}, **QUIET},
            {**kind, **estimate, 'mode': 'lines', 'line': {**_colours(run, chosen), 'width': 5}}
            | _told(run, chosen),
            {**kind, **_first(estimate), **START, 'marker': {'size': 4, 'color': GREY}},
            {**kind, **NOWHERE, 'z': [None], 'marker': {'size': 7, 'color': RED}, **QUIET},
        ],
        'layout': layout(
            scene={
                **axes,
                'aspectmode': 'manual',
                'aspectratio': dict(zip('xyz', (1.3 * sides).tolist(), strict=True)),
                # a turntable has its axis along z
                'dragmode': 'turntable' if run.axes_from_above == 'xy' else 'orbit',
                'camera': CAMERAS[run.axes_from_above],
            },
            margin={'l': 0, 'r': 0, 't': 0, 'b': 0},
        ),
    }


def path_from_above(run: DrawnPairs) -> Figure:
    """Return the same from above."""
    names, chosen, kind = run.axes_from_above, run.evenly_spaced(), {'type': 'scatter'}
    truth, estimate = (run.places(p, names, chosen) for p in (run.truth, run.estimate))
    right, up = (run.labels['xyz'.index(name)] for name in names)
    return {
        'data': [
            *_outline(run, names, kind),
            {**kind, **truth, 'mode': 'lines', 'line': {'color': GREY, 'width': 1.5}, **QUIET},
            # every pair, be it alone, to be pointed at; over them lines of one colour each
            {**kind, **estimate, 'mode': 'markers',
             'marker': {**_colours(run, chosen), 'size': 3}} | _told(run, chosen),
            *_coloured(run, names, chosen),
            {**kind, **_first(estimate), **START, 'marker': {'size': 8, 'color': GREY}},
            {**kind, **NOWHERE, 'marker': {'size': 13, 'symbol': 'circle-open', 'color': RED,
                                           'line': {'width': 3}}, **QUIET},
        ],
        'layout': layout(xaxis=axis(right), yaxis=axis(up, scaleanchor='x')),
    }  # fmt: skip


def _outline(run: DrawnPairs, names: str, kind: Figure) -> list[Figure]:
    """Return the whole ground truth as a thin line, broken at its own gaps."""
    if run.whole is None or not len(run.whole):
        return []
    stamps, positions = run.whole.stamps_ns, run.whole.positions - run.origin
    stride = -(-len(stamps) // run.most_points)
    chosen = np.unique(np.append(np.arange(0, len(stamps), stride), len(stamps) - 1))
    seconds = np.diff(stamps[chosen]) / 1e9
    usual = float(np.median(seconds)) if len(seconds) else 0.0
    holes = np.flatnonzero(seconds > longest_tracked(run.longest_s, usual)) + 1
    places = {
        axis: numbers(np.insert(positions[chosen, 'xyz'.index(name)], holes, math.nan))
        for axis, name in zip('xyz', names, strict=False)
    }
    line = {'color': GREY, 'width': 1 if len(names) == 2 else 2, 'dash': 'dot'}
    return [{**kind, **places, 'mode': 'lines', 'line': line, **QUIET}]


def _colours(run: DrawnPairs, chosen: np.ndarray) -> Figure:
    """Return the colours of the chosen errors."""
    errors = run.broken(np.minimum(run.errors, run.hottest), chosen)
    return {
        'color': [0 if error is None else error for error in errors],
        'colorscale': [[k / (len(RAMP) - 1), colour] for k, colour in enumerate(RAMP)],
        'cmin': 0,
        'cmax': run.hottest,
    }


def _told(run: DrawnPairs, chosen: np.ndarray) -> Figure:
    """Return the label of each place: its time and error."""
    errors = run.broken(run.errors, chosen)
    return {
        'customdata': run.broken(run.seconds, chosen),
        'text': ['' if error is None else f'{error:.3g} m' for error in errors],
        'hovertemplate': '%{text} off at %{customdata} s<extra></extra>',
    }


def _first(places: Figure) -> Figure:
    return {axis: values[:1] for axis, values in places.items()}


def _coloured(run: DrawnPairs, names: str, chosen: np.ndarray) -> list[Figure]:
    """Return the lines of the estimate, one per level of error."""
    errors = run.errors[chosen]
    level = (errors[1:] + errors[:-1]) / 2 / run.hottest * LEVELS
    level = level.clip(max=LEVELS - 1).astype(int)
    level[run.gap_between(chosen)] = -1
    ends = [0, *(np.flatnonzero(np.diff(level)) + 1), len(level)]
    lines: list[list[int]] = [[] for _ in range(LEVELS)]
    for begin, end in pairwise(ends):
        if end > begin and level[begin] >= 0:
            lines[level[begin]] += [*range(begin, end + 1), len(chosen)]
    positions = run.estimate[chosen] - run.origin
    positions = np.vstack([positions, np.full(3, math.nan)])
    return [
        {
            'type': 'scatter',
            'mode': 'lines',
            **{
                axis: numbers(positions[line, 'xyz'.index(name)])
                for axis, name in zip('xy', names, strict=True)
            },
            'line': {'color': _ramp((k + 0.5) / LEVELS), 'width': 3},
            **QUIET,
        }
        for k, line in enumerate(lines)
        if line
    ]


def _ramp(share: float) -> str:
    """Return the colour of an error, as a share of the hottest one."""
    red, green, blue = ramp_colours(np.array([share]))[0].tolist()
    return f'rgb({red},{green},{blue})'


def ramp_colours(shares: np.ndarray) -> np.ndarray:
    """Return the (N, 3) colours, 0 to 255, of errors as (N,) shares of the hottest one."""
    stops = np.array([[int(colour[k : k + 2], 16) for k in (1, 3, 5)] for colour in RAMP])
    at = np.linspace(0, 1, len(RAMP))
    colours = np.stack([np.interp(shares, at, stops[:, k]) for k in range(3)], axis=1)
    return colours.round().astype(np.uint8)


def errors_over_time(run: DrawnPairs, rmse_m: float, rmse_deg: float) -> Figure:
    """Return the errors of position and rotation over time; gaps are shaded, jumps marked."""
    jumps = run.jumps[:MOST_MARKS]
    gaps = sorted(run.gaps, key=lambda gap: gap[0] - gap[1])[:MOST_MARKS]
    at = np.array([k for k, _ in jumps], int)
    figure: Figure = {
        'data': [
            _curve(run, run.errors, 'y', 'm'),
            {
                'type': 'scatter',
                'mode': 'markers',
                'x': numbers(run.seconds[at]),
                'y': numbers(run.errors[at]),
                'text': [f'{size:.3g} m' for _, size in jumps],
                'hovertemplate': 'jumped by %{text} at %{x} s<extra></extra>',
                'marker': {
                    'symbol': 'diamond-open',
                    'size': 10,
                    'color': RED,
                    'line': {'width': 2},
                },
            },
        ],
        'layout': layout(
            xaxis=axis('time since the first ground truth [s]', range=[0, run.end]),
            yaxis=axis('position [m]', rangemode='tozero'),
            hovermode='x',
            shapes=[_shade(*gap) for gap in gaps] + [_level(rmse_m, 'y')],
        ),
    }
    if not math.isnan(run.angles.sum()):
        figure['data'].append(_curve(run, run.angles, 'y2', 'deg'))
        figure['layout'] |= {
            'yaxis': axis('position [m]', rangemode='tozero', domain=[0.54, 1]),
            'yaxis2': axis('rotation [deg]', rangemode='tozero', domain=[0, 0.46]),
        }
        figure['layout']['xaxis']['anchor'] = 'y2'
        figure['layout']['shapes'].append(_level(rmse_deg, 'y2'))
    return figure


def _curve(run: DrawnPairs, values: np.ndarray, axis: str, unit: str) -> Figure:
    chosen = run.extremes(values)
    return {
        'type': 'scatter',
        # a single pair between two gaps would be invisible as a line
        'mode': 'lines+markers' if run.gap_between(chosen).any() else 'lines',
        'marker': {'size': 2.5, 'color': BLUE},
        'x': run.broken(run.seconds, chosen),
        'y': run.broken(values, chosen),
        'yaxis': axis,
        'line': {'color': BLUE, 'width': 1.5},
        'hovertemplate': f'%{{y:.4~g}} {unit} at %{{x}} s<extra></extra>',
    }


def _shade(begin: float, end: float) -> Figure:
    span = {'xref': 'x', 'x0': begin, 'x1': end, 'yref': 'paper', 'y0': 0, 'y1': 1}
    return {'type': 'rect', **span, 'fillcolor': GAP, 'line': {'width': 0}, 'layer': 'below'}


def _level(value: float, axis: str) -> Figure:
    line = {'color': AMBER, 'width': 1.5, 'dash': 'dash'}
    span = {'xref': 'paper', 'x0': 0, 'x1': 1, 'yref': axis, 'y0': value, 'y1': value}
    return {'type': 'line', **span, 'line': line}


def relative_samples(result: Result) -> list[tuple[str, dict[str, np.ndarray]]]:
    """Return titles of two kinds of relative error, with the errors over each delta."""
    pairs, alignment = result.summary.pairs, result.summary.alignment
    kinds = ('disp', 'dist') if pairs.rotations is None else ('trans', 'rot')
    titles = {'trans': 'position [m]', 'rot': 'rotation [deg]', 'disp': 'displacement [m]',
              'dist': 'distance [m]'}  # fmt: skip
    found: dict[str, dict[str, np.ndarray]] = {kind: {} for kind in kinds}
    for text in result.config.rpe_deltas:
        delta = Delta.parse(text)
        of = candidates(progress_along(pairs, delta.unit), delta, result.config)
        errors = relative_errors(pairs, of.begin[of.usable], of.end[of.usable], alignment)
        for kind in kinds:
            values = errors[list(RPE_KINDS).index(kind)]
            if np.isfinite(values).any():
                found[kind][text] = values
    return [(titles[kind], samples) for kind, samples in found.items() if samples]


def segment_samples(
    result: Result, lengths_m: Sequence[float]
) -> list[tuple[str, dict[str, np.ndarray]]]:
    """Return titles of the drift of position and rotation, with the drift over each length."""
    pairs, scale = result.summary.pairs, result.summary.alignment.scale
    if pairs.rotations is None:
        return []
    path = progress_along(pairs, 'm')
    drift: dict[str, np.ndarray] = {}
    turn: dict[str, np.ndarray] = {}
    for length in lengths_m:
        errors = segment_errors(pairs, scale, path, length)
        name = f'{plain(length)} m'
        for samples, values in ((drift, 100 * errors[0]), (turn, errors[1])):
            if np.isfinite(values).any():
                samples[name] = values
    found = [('drift of position [%]', drift), ('drift of rotation [deg/m]', turn)]
    return [(title, samples) for title, samples in found if samples]


def usual_lengths(path_m: float) -> tuple[float, ...]:
    """Return round lengths [m] from a twentieth to half of a path."""
    if not path_m > 0:
        return ()
    decade = 10.0 ** math.floor(math.log10(path_m) - 1)
    series = [factor * decade for factor in (1, 2, 5, 10, 20, 50)]
    return tuple(length for length in series if 0.1 * path_m / 2 <= length <= 0.5 * path_m)
