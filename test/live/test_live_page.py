"""What the page of a running evaluation is told, from a run as it goes on."""

import json
import math

import pytest

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.live.health import Level, Status
from vio_eval_ros.live.page import document, drift_name, MOST_POINTS, state, View
from vio_eval_ros.live.run import LiveRun, RunSetup
from vio_eval_ros.simulation import simulate

STATUSES = [
    Status('accuracy', Level.OK, 'running', {}),
    Status('streams', Level.WARN, 'nobody publishes /<b>odom\x1b[2J', {}),
]


def shown(run: LiveRun, label: str = '') -> dict:
    """Return what the page is told of a run."""
    text = state(3, [View.of(label, run, STATUSES)])
    assert '\n' not in text
    told = json.loads(text)
    assert told['run'] == 3
    (estimate,) = told['estimates']
    return estimate


def run_of(alignment: str = 'se3') -> LiveRun:
    """Return a run that has not begun."""
    config = EvaluationConfig(alignment=alignment)
    return LiveRun(RunSetup(config, ('/vio/odometry', '/ground_truth/pose')))


@pytest.fixture(scope='module')
def flight():
    return simulate(duration_s=80.0)


def test_a_run_that_has_not_begun_has_statuses_and_says_why_nothing_is_drawn():
    told = shown(run_of())
    assert told['label'] == 'Estimate'
    assert told['topics'] == '/vio/odometry against /ground_truth/pose'
    assert told['figures'] == []
    assert told['caption'] == 'Nothing can be drawn yet: there are no pairs.'
    assert told['tiles'][0] == ['ATE position', '- m', 'RMSE so far']
    assert told['statuses'] == [
        ['accuracy', 'pass', 'OK', 'running'],
        ['streams', 'warn', 'WARN', 'nobody publishes /<b>odom?[2J'],
    ]


def test_a_run_has_its_path_errors_and_running_values(flight):
    run = run_of()
    run.add_estimate(flight.estimate)
    run.add_ground_truth(flight.ground_truth)
    for _ in run.advance():
        pass
    told = shown(run, 'vins')
    assert told['label'] == 'vins'
    names = {name: value for name, value, _ in told['tiles']}
    assert names['ATE position'] == f'{run.values["ate_trans_rmse_m"]:.4g} m'
    assert names['RPE over 1s'] == f'{run.values["rpe_1s_trans_rmse_m"]:.4g} m'
    assert told['tiles'][-1][2] == f'{run.values["pairs"]:,} pairs'
    path, errors = told['figures']
    assert max(len(trace['x']) for trace in path['data']) <= MOST_POINTS
    assert errors['layout']['xaxis']['range'] == [0, pytest.approx(80, abs=1.1)]
    assert path['layout']['uirevision'] == errors['layout']['uirevision'] == 3
    worst = max(value for value in errors['data'][0]['y'] if value is not None)
    assert worst > run.values['ate_trans_rmse_m']


@pytest.mark.parametrize('alignment', ['none', 'origin', 'se3'])
@pytest.mark.parametrize('count', [1, 2, 3])
def test_few_pairs_are_drawn_or_said_not_to_suffice(flight, alignment, count):
    run = run_of(alignment)
    run.add_estimate(flight.estimate[:count])
    run.add_ground_truth(flight.ground_truth[:40])
    for _ in run.advance():
        pass
    told = shown(run)
    assert bool(told['figures']) != told['caption'].startswith('Nothing can be drawn yet')


def test_what_is_shown_of_a_run_does_not_change_while_the_run_goes_on(flight):
    run = run_of()
    run.add_estimate(flight.estimate[:400])
    run.add_ground_truth(flight.ground_truth[:4000])
    for _ in run.advance():
        pass
    view = View.of('', run, STATUSES)
    before = state(1, [view])
    run.add_estimate(flight.estimate[400:])
    run.add_ground_truth(flight.ground_truth[4000:])
    for _ in run.advance():
        pass
    assert state(1, [view]) == before
    assert state(1, [View.of('', run, STATUSES)]) != before


@pytest.mark.parametrize(
    ('values', 'name'),
    [
        ({}, ''),
        ({'ate_trans_rmse_m': 1.0}, ''),
        ({'rpe_1f_trans_rmse_m': 1.0, 'rpe_0.5s_trans_rmse_m': 1.0}, 'rpe_0.5s_trans_rmse_m'),
        ({'rpe_1f_trans_rmse_m': 1.0, 'rpe_1s_trans_rmse_m': math.nan}, 'rpe_1f_trans_rmse_m'),
        ({'rpe_1s_trans_rmse_m': math.nan, 'rpe_1s_disp_rmse_m': 1.0}, 'rpe_1s_disp_rmse_m'),
    ],
)
def test_the_relative_error_is_one_that_is_known_and_rather_over_seconds(values, name):
    assert drift_name(values) == name


def test_the_page_loads_nothing_from_elsewhere_and_asks_its_own_server_only(parsed):
    page = parsed(document('/robot<1>/vio_evaluator'))
    assert page.of('h1')[0][1] == '/robot<1>/vio_evaluator'
    policy = next(a['content'] for a, _ in page.of('meta') if 'content' in a and 'http-equiv' in a)
    assert policy.startswith("default-src 'none'")
    assert policy.endswith("connect-src 'self'")
    assert not [a for _, a in page.elements if 'src' in a or 'href' in a]
