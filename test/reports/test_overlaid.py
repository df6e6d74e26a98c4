"""Several systems in the same plots of a page."""

from dataclasses import replace
import math

import numpy as np
import plotly.graph_objects as go
import pytest

from vio_eval_ros import compare
from vio_eval_ros.rendering.palette import COLOURS
from vio_eval_ros.reports.compared import comparison_html
from vio_eval_ros.reports.plots import relative_samples
from vio_eval_ros.simulation import simulate


@pytest.fixture(scope='module')
def found():
    flight = simulate(duration_s=30.0)
    keep = np.ones(len(flight.estimate), bool)
    keep[200:300] = False
    estimates = {
        'still <b>': replace(flight.estimate[:1]),
        'whole': flight.estimate,
        'lost': flight.estimate[keep],
    }
    return compare(estimates, flight.ground_truth)


@pytest.fixture(scope='module')
def page(found, parsed):
    return parsed(comparison_html(found))


def test_a_system_has_one_colour_in_table_legend_and_plots(page, found):
    used = {name: COLOURS[k] for k, name in enumerate(found.runs)}
    patches = [a['style'] for a, _ in page.of('span') if a.get('class') == 'swatch']
    for name in ('whole', 'lost'):
        # table, legend and the section of the system
        assert sum(used[name] in style for style in patches) == 3
        drawn = [
            trace['line']['color']
            for figure in page.figures
            for trace in figure['data']
            if trace.get('name') == name
        ]
        assert drawn == [used[name]] * 6
    for figure in page.figures:
        go.Figure(figure)


def test_paths_and_errors_of_all_systems_are_drawn_without_bridges(page, found):
    paths, errors = page.figures[:2]
    assert paths['layout']['yaxis']['scaleanchor'] == 'x'
    assert [trace.get('name') for trace in paths['data'][1:]] == ['whole', 'lost']
    whole, lost = errors['data']
    assert (whole['y'].count(None), lost['y'].count(None)) == (0, 1)
    largest = found.results['whole'].summary.metrics['ate_trans_max_m']
    assert max(whole['y']) == pytest.approx(largest, rel=1e-4)


def test_boxes_are_of_the_relative_errors_of_each_system(page, found):
    whole, lost = page.figures[2]['data']
    (_, samples), *_ = relative_samples(found.results['lost'])
    assert lost['median'] == [float(np.median(values)) for values in samples.values()]
    assert [b > a for a, b in zip(whole['x'], lost['x'], strict=True)] == [True] * len(samples)
    assert page.figures[2]['layout']['yaxis']['title']['text'] == 'RPE, position [m]'


def test_what_cannot_be_aligned_is_said_and_not_drawn(found, page):
    metrics = found.results['still <b>'].summary.metrics
    assert math.isnan(metrics['ate_trans_rmse_m'])
    assert 'Nothing can be drawn' in page.text
    assert not page.of('b') or '<b>' in page.text
