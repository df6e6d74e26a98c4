"""
What the page of a running evaluation shows: values, path, errors and statuses of each estimate.

Knows nothing of the server: a :class:`View` of each estimate in, text that the page takes out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import json
import math
from typing import Any

import numpy as np

from vio_eval_ros.core.alignment import Alignment
from vio_eval_ros.core.trajectory import Pairs
from vio_eval_ros.live.health import Level, Status
from vio_eval_ros.live.run import LiveRun
from vio_eval_ros.rendering.figures import Figure
from vio_eval_ros.rendering.page import badge, Html, page, tag
from vio_eval_ros.rendering.text import number, percent, printable
from vio_eval_ros.reports.drawn_run import DrawnPairs
from vio_eval_ros.reports.plots import errors_over_time, path_from_above

#: that are looked at, evenly over the run, and drawn of each line: a picture costs the same,
#: however long the run is
MOST_PAIRS, MOST_POINTS = 20_000, 500
#: the colours of the levels, as reports name them
WORDS = {Level.OK: 'pass', Level.WARN: 'warn', Level.ERROR: 'fail', Level.STALE: 'warn'}


@dataclass(frozen=True, eq=False)
class View:
    """
    An estimate at a moment. What it refers to does not change: another thread may draw it.

    :param label: what it is called beside others; empty where there is only one.
    :param topics: of the estimate and of the ground truth.
    :param values: the running values; empty until a second is over.
    :param pairs: all that are kept.
    :param alignment: of all pairs; None where there are none.
    :param span_ns: the first and the last stamp of the ground truth.
    """

    label: str
    topics: tuple[str, str]
    values: Mapping[str, float]
    statuses: Sequence[Status]
    pairs: Pairs
    alignment: Alignment | None
    span_ns: tuple[int, int]
    max_gap_s: float

    @classmethod
    def of(cls, label: str, run: LiveRun, statuses: Sequence[Status]) -> View:
        """Return the view of a run as it is now."""
        evaluation = run.evaluation
        pairs, truth = evaluation.kept(), evaluation.associator.ground_truth
        return cls(
            label=label,
            topics=run.names,
            values=run.values,
            statuses=tuple(statuses),
            pairs=pairs,
            alignment=evaluation.alignment() if len(pairs) else None,
            span_ns=(truth.first_used_ns, truth.last_used_ns),
            max_gap_s=evaluation.config.max_gap_s,
        )


def document(name: str) -> str:
    """
    Return the page, which asks for what it shows.

    :param name: of the node.
    :raises ConfigError: where plotly is not installed.
    """
    return page(
        f'{name}: live',
        tag(
            'header',
            tag('div', tag('h1', name), tag('p', '', class_='soft', id='run')),
            badge('', 'connecting'),
        ),
        Html('<main></main>'),
        script='live.js',
        listens=True,
    )


def state(run: int, views: Sequence[View]) -> str:
    """Return what the page shows, as JSON in one line."""
    shown = {'run': run, 'estimates': [_estimate(run, view) for view in views]}
    return json.dumps(shown, allow_nan=False, separators=(',', ':'))


def _estimate(run: int, view: View) -> dict[str, Any]:
    figures, caption = _drawn(run, view)
    estimate, truth = map(printable, view.topics)
    return {
        'label': view.label or 'Estimate',
        'topics': f'{estimate} against {truth}',
        'tiles': list(_tiles(view.values)),
        'figures': figures,
        'caption': caption,
        'statuses': [
            (status.name, WORDS[status.level], status.level.name, printable(status.message))
            for status in view.statuses
        ],
    }


def _drawn(run: int, view: View) -> tuple[list[Figure], str]:
    """Return the path from above and the errors over time, and what is to be known of them."""
    if view.alignment is None or not len(view.pairs):
        return [], 'Nothing can be drawn yet: there are no pairs.'
    if not view.alignment.is_known:
        return [], 'Nothing can be drawn yet: the alignment is not determined.'
    drawn = DrawnPairs.of_pairs(
        view.pairs[:: -(-len(view.pairs) // MOST_PAIRS)],
        view.alignment,
        view.span_ns,
        view.max_gap_s,
        most_points=MOST_POINTS,
    )
    rmse = [float(np.sqrt(np.mean(errors**2))) for errors in (drawn.errors, drawn.angles)]
    figures = [path_from_above(drawn), errors_over_time(drawn, *rmse)]
    for figure in figures:
        figure['layout']['uirevision'] = run  # so that what was zoomed stays so
    return figures, (
        'The estimate, aligned, from blue (no error) to red '
        f'({number(drawn.hottest)} m or more); the ground truth in grey. Dashed: RMSE.'
    )


def _tiles(values: Mapping[str, float]) -> Iterator[tuple[str, str, str]]:
    """Yield the headline figures: name, value and what it refers to."""
    of = {name: values.get(name, math.nan) for name in ('ate_trans_rmse_m', 'ate_rot_rmse_deg')}
    yield 'ATE position', f'{number(of["ate_trans_rmse_m"])} m', 'RMSE so far'
    yield 'ATE rotation', f'{number(of["ate_rot_rmse_deg"])}°', 'RMSE so far'
    if drift := drift_name(values):
        yield f'RPE over {drift.split("_")[1]}', f'{number(values[drift])} m', 'RMSE so far'
    coverage = values.get('coverage_ratio', math.nan)
    yield 'Coverage', percent(coverage), f'{values.get("pairs", 0):,.0f} pairs'


def drift_name(values: Mapping[str, float]) -> str:
    """Return the metric of a relative error of position, over seconds if there is one; or ''."""
    names = [name for name in values if name.startswith('rpe_') and name.endswith('_rmse_m')]
    known = [name for name in names if not math.isnan(values[name])] or names
    over_seconds = [name for name in known if name.split('_')[1].endswith('s')]
    return next(iter(over_seconds + known), '')
