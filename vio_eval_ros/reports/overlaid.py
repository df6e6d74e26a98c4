"""Several systems in the same plots, each in the colour that it has in every picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import math

import numpy as np

from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.rendering.figures import axis, Figure, GREY, label, layout, numbers
from vio_eval_ros.rendering.page import Html, joined, plot, swatch, system_swatch, tag
from vio_eval_ros.rendering.palette import look
from vio_eval_ros.reports.drawn_run import DrawnRun
from vio_eval_ros.reports.plots import relative_samples, segment_samples, usual_lengths
from vio_eval_ros.reports.times import TIME

#: drawn of each line
MOST_POINTS = 1000
#: of 1, the distance of groups, for all boxes of a group
GROUP = 0.8
Samples = Mapping[str, Mapping[str, np.ndarray]]


def overlaid(results: Mapping[str, Result], order: Sequence[str]) -> Html:
    """
    Return plots of systems on one sequence: paths, errors over time, and relative errors as boxes.

    :param results: by system; what has no alignment is left out, its row in the table says why.
    :param order: of all systems, also those without a result.
    """
    able = {
        name: result
        for name, result in results.items()
        if not math.isnan(result.summary.metrics['ate_trans_rmse_m'])
    }
    if not able:
        return tag('p', 'Nothing can be drawn: no alignment is determined.', class_='soft')
    runs = {name: DrawnRun.of(result, MOST_POINTS) for name, result in able.items()}
    places = {name: order.index(name) for name in able}
    legend = [part for name in able for part in (system_swatch(places[name]), name)]
    first = next(iter(able.values()))
    lengths = first.config.segment_lengths_m or usual_lengths(
        first.summary.metrics['path_length_m']
    )
    relative = _of_all({name: relative_samples(result) for name, result in able.items()})
    drift = _of_all({name: segment_samples(result, lengths) for name, result in able.items()})
    grouped = [
        *((f'RPE, {title}', samples) for title, samples in relative.items()),
        *drift.items(),
    ]
    return joined(
        [
            tag(
                'p',
                *legend,
                swatch(GREY),
                'ground truth. ',
                'Boxes: quartiles; whiskers: 5th to 95th percentile.',
                class_='soft',
            ),
            tag(
                'div',
                plot(_paths(runs, places), 420, 'paths of all systems from above'),
                plot(_errors(runs, places), 420, 'position errors of all systems over time'),
                *(
                    plot(_boxes(title, samples, places), 260, f'{title} of all systems')
                    for title, samples in grouped
                ),
                class_='plots',
            ),
        ]
    )


def _of_all(found: Mapping[str, list[tuple[str, dict[str, np.ndarray]]]]) -> dict[str, Samples]:
    """Return samples by their title, system and group instead of by system and title."""
    titles = dict.fromkeys(title for of in found.values() for title, _ in of)
    return {
        title: {name: dict(of)[title] for name, of in found.items() if title in dict(of)}
        for title in titles
    }


def _style(place: int) -> Figure:
    colour, dashes, _ = look(place)
    dash = ','.join(f'{1.6 * length:g}px' for length in dashes) or 'solid'
    return {
        'type': 'scatter', 'mode': 'lines', 'line': {'color': colour, 'width': 1.6, 'dash': dash},
    }  # fmt: skip


def _paths(runs: Mapping[str, DrawnRun], places: Mapping[str, int]) -> Figure:
    """Return the aligned estimates and the ground truth of the first from above."""
    first = next(iter(runs.values()))
    across, up = ('xyz'.index(name) for name in first.axes_from_above)
    truth = first.truth_over_time.y
    stride = -(-len(truth) // (2 * MOST_POINTS))
    lines = [
        {
            'type': 'scatter', 'mode': 'lines', 'hoverinfo': 'skip',
            'x': numbers(truth[::stride, across]), 'y': numbers(truth[::stride, up]),
            'line': {'color': GREY, 'width': 3},
        }
    ]  # fmt: skip
    for name, run in runs.items():
        path = run.over_time(run.estimate - first.origin, run.evenly_spaced()).y
        lines.append(
            {
                **_style(places[name]),
                'name': label(name),
                'x': numbers(path[:, across]),
                'y': numbers(path[:, up]),
                'hovertemplate': f'{label(name)}<extra></extra>',
            }
        )
    return {
        'data': lines,
        'layout': layout(
            xaxis=axis(first.labels[across]), yaxis=axis(first.labels[up], scaleanchor='x')
        ),
    }


def _errors(runs: Mapping[str, DrawnRun], places: Mapping[str, int]) -> Figure:
    """Return the position errors over time."""
    lines = []
    for name, run in runs.items():
        curve = run.over_time(run.errors)
        # a single pair between two gaps would be invisible as a line
        broken = bool(np.isnan(curve.y).any())
        lines.append(
            {
                **_style(places[name]),
                'mode': 'lines+markers' if broken else 'lines',
                'marker': {'size': 2.5},
                'name': label(name),
                'x': numbers(curve.x),
                'y': numbers(curve.y),
                'hovertemplate': f'{label(name)}: %{{y:.4~g}} m at %{{x}} s<extra></extra>',
            }
        )
    end = max(run.end for run in runs.values())
    return {
        'data': lines,
        'layout': layout(
            xaxis=axis(TIME, range=[0, end]),
            yaxis=axis('position error [m]', rangemode='tozero'),
        ),
    }


def _boxes(title: str, samples: Samples, places: Mapping[str, int]) -> Figure:
    """Return boxes of each delta or length, those of the systems beside each other."""
    groups = list(dict.fromkeys(group for of in samples.values() for group in of))
    width = GROUP / len(samples)
    quantiles = {
        name: np.array(
            [np.nanquantile(v, [0.05, 0.25, 0.5, 0.75, 0.95]) for v in of.values()]
        ).T.tolist()
        for name, of in samples.items()
    }
    data = []
    for k, (name, of) in enumerate(samples.items()):
        low, q1, median, q3, high = quantiles[name]
        shift = (k - (len(samples) - 1) / 2) * width
        colour = look(places[name]).colour
        data.append(
            {
                'type': 'box',
                'name': label(name),
                'x': [groups.index(group) + shift for group in of],
                'lowerfence': low, 'q1': q1, 'median': median, 'q3': q3, 'upperfence': high,
                'line': {'color': colour, 'width': 1.5},
                'fillcolor': f'{colour}40',
                'width': 0.75 * width,
                'yhoverformat': '.4~g',
            }
        )  # fmt: skip
    lows, highs = zip(*((min(of[0]), max(of[-1])) for of in quantiles.values()), strict=True)
    spread = min(lows) > 0 and max(highs) > 20 * min(lows)
    return {
        'data': data,
        'layout': layout(
            boxmode='overlay',
            xaxis=axis(
                tickvals=list(range(len(groups))),
                ticktext=groups,
                range=[-0.6, len(groups) - 0.4],
                showgrid=False,
            ),
            yaxis=axis(
                title,
                type='log' if spread else 'linear',
                **({'dtick': 'D2'} if spread else {'rangemode': 'tozero'}),
            ),
        ),
    }
