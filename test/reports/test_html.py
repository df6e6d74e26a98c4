"""The page of a run: what it says and draws, and that no name breaks out of it."""

import base64
from dataclasses import replace
import hashlib
import json
import math
from pathlib import Path
import re
import sys

import numpy as np
import plotly.graph_objects as go
import pytest

from verbs import start, transcript
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.gates import Gate, judge
from vio_eval_ros.core.rotation import rotate
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.evaluation.result import Input, Result
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.rendering.figures import boxes
from vio_eval_ros.rendering.page import html, tag
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.reports.drawn_run import Curve, DrawnRun, JUMP_OVER_P95, MIN_JUMP_M, MOST_POINTS
from vio_eval_ros.reports.html import html_report
from vio_eval_ros.reports.plots import relative_samples, segment_samples, usual_lengths
from vio_eval_ros.simulation import simulate

HOSTILE = '</script><script>hacked=1</script><img src=x onerror="hacked=2">\'"&amp;%{x}\x1b\x00'
GATES = ('ate_trans_rmse_m<=1e-9', 'coverage_ratio>=0.5', 'rpe_1s_rot_rmse_deg<=90')


def result_of(
    estimate: Trajectory,
    truth: Trajectory,
    gates: tuple[str, ...] = (),
    source: str = 'est.tum',
    **options: object,
) -> Result:
    evaluation = Evaluation(EvaluationConfig(**options))
    evaluation.add_ground_truth(truth)
    evaluation.add_estimate(estimate)
    evaluation.flush()
    summary, streams = evaluation.summary(), evaluation.associator
    return Result(
        Input.of(source, 'tum', streams.estimate, sha256='0' * 64),
        Input.of('gt.tum', 'tum', streams.ground_truth),
        evaluation.config,
        summary,
        judge([Gate.parse(gate) for gate in gates], summary.metrics),
    )


def harmed() -> tuple[Trajectory, Trajectory]:
    """Return a flight of 40 s: not tracked until 3 s and from 10 to 14 s, off by 1 m from 25 s."""
    run = simulate(duration_s=40.0)
    estimate = run.estimate
    seconds = (estimate.stamps_ns - run.ground_truth.stamps_ns[0]) / 1e9
    positions = estimate.positions + np.outer(seconds >= 25, [1.0, 0, 0])
    tracked = (seconds >= 3) & ((seconds < 10) | (seconds >= 14))
    return replace(estimate, positions=positions)[tracked], run.ground_truth


@pytest.fixture(scope='module')
def result() -> Result:
    return result_of(*harmed(), GATES, segment_lengths_m=(10,))


@pytest.fixture(scope='module')
def report(result) -> str:
    return html_report(result)


@pytest.fixture(scope='module')
def real(shared_data) -> Result:
    """Return a real run that starts late and jumps: VINS-Mono on EuRoC's V1_02."""
    estimate = shared_data / 'est_plsl_slam/euroc/V1-02/vins-mono.csv'
    truth = shared_data / 'gt_euroc/open_vins_tum/V1_02_medium.txt'
    config = EvaluationConfig(max_difference_s=0.01)
    gates = [Gate.parse(gate) for gate in ('ate_trans_rmse_m<=0.1', 'coverage_ratio>=0.9')]
    sources = read_sources([f'{estimate}?quaternion=wxyz&stamps=ns', str(truth)])
    return score_run(*sources, config, gates)


def test_the_page_says_what_was_found(result, report, parsed):
    metrics, page = result.summary.metrics, parsed(report)
    assert page.of('h1')[0][1] == 'est.tum'
    assert ('fail', 'badge fail') == next(
        (text, attributes['class'])
        for attributes, text in page.of('span')
        if 'badge' in attributes['class']
    )
    for name in ('ate_trans_rmse_m', 'ate_rot_max_deg', 'rpe_10m_trans_rmse_m', 'sim3_scale'):
        assert f'{metrics[name]:.4g}' in page.text, name
    for verdict in result.verdicts:
        assert verdict.gate.metric in page.text
    for name in result.config.to_dict():
        assert name in page.text
    assert f'{100 * metrics["coverage_ratio"]:.1f} %' in page.text
    assert f'{len(result.summary.pairs):,} pairs' in page.text
    assert '0' * 64 in page.text
    assert '2 gaps without pairs' in page.text
    assert '1 jump of the estimate' in page.text


def test_warnings_and_what_was_dropped_are_reported(parsed):
    estimate, truth = harmed()
    positions = estimate.positions.copy()
    positions[5] = math.nan
    result = result_of(replace(estimate, positions=positions), truth)
    page = parsed(html_report(result))
    assert 'estimate: dropped 1 non-finite' in result.summary.warnings
    for warning in result.summary.warnings:
        assert warning in page.text
    assert re.search(r'dropped: non finite\s+1\s+0', page.text)
    assert 'no gates' in page.text


@pytest.mark.parametrize('place', ['estimate', 'ground_truth', 'warnings'])
def test_a_name_stays_text(place, result, report, parsed):
    if place == 'warnings':
        assert result.summary.warnings  # else there is no list of them to compare with
        hostile = replace(result, summary=replace(result.summary, warnings=[HOSTILE]))
    else:
        hostile = replace(result, **{place: replace(getattr(result, place), source=HOSTILE)})
    text = html_report(hostile)
    page = parsed(text)
    assert '<script>hacked=1' in page.text
    assert {name for name, _ in page.elements} == {name for name, _ in parsed(report).elements}
    assert len(page.of('script')) == len(parsed(report).of('script'))
    assert not any(name.startswith('on') for _, attributes in page.elements for name in attributes)
    assert '\x1b' not in text
    assert '\x00' not in text


def test_content_of_elements_is_text_unless_it_was_made_here():
    assert html('<b>') == '&lt;b&gt;'
    assert (
        tag('p', '<b>', tag('i', '"'), title='"') == '<p title="&quot;">&lt;b&gt;<i>&quot;</i></p>'
    )


def test_nothing_in_the_page_is_elsewhere(report, parsed):
    page = parsed(report)
    for name, attributes in page.elements:
        assert not attributes.keys() & {'src', 'href', 'action', 'data', 'srcset'}, name
        assert name not in ('link', 'iframe', 'object', 'embed', 'base')
    styles = ' '.join(text for _, text in page.of('style'))
    assert 'url(' not in styles
    assert '@import' not in styles


def test_only_the_scripts_of_the_page_may_run(report, parsed):
    page = parsed(report)
    (policy,) = (
        attributes['content'] for attributes, _ in page.of('meta') if 'http-equiv' in attributes
    )
    scripts = [text for attributes, text in page.of('script') if not attributes]
    assert len(scripts) == 3
    for script in scripts:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert policy.startswith("default-src 'none'; ")
    assert 'unsafe' not in policy.replace("style-src 'unsafe-inline'", '')


@pytest.mark.slow
def test_every_report_is_the_same_in_another_process(tmp_path):
    estimate, truth = tmp_path / 'est.tum', tmp_path / 'gt.tum'
    run = simulate(duration_s=10.0)
    for file, poses in ((estimate, run.estimate), (truth, run.ground_truth)):
        rows = np.column_stack([poses.stamps_ns / 1e9, poses.positions, poses.rotations])
        np.savetxt(file, rows, '%.9f')
    kinds = set(REPORTS) - {'rerun'}  # whose library is not among those of the tests
    for seed in ('1', '2'):
        files = ('--estimate', estimate, '--ground-truth', truth)
        reports = (f'--report={kind}:{tmp_path}/{seed}.{kind}' for kind in kinds)
        done = start('replay', *files, *reports, env={'PYTHONHASHSEED': seed})
        assert done.returncode == 0, transcript(done)
    for kind in kinds:
        one, other = ((tmp_path / f'{seed}.{kind}').read_bytes() for seed in ('1', '2'))
        assert one == other, kind


@pytest.mark.slow
def test_the_figures_are_such_as_plotly_knows(report, parsed):
    figures = parsed(report).figures
    kinds = [figure['data'][0]['type'] for figure in figures]
    assert kinds == ['scatter3d', *5 * ['scatter'], *4 * ['box']]
    for figure in figures:
        go.Figure(figure)  # raises where it has a property that there is not


def test_gaps_and_jumps_are_where_they_were_made(result):
    drawn = DrawnRun.of(result)
    assert np.allclose(drawn.gaps, [(0, 3), (10, 14)], atol=0.06)
    ((k, size),) = drawn.jumps
    assert drawn.seconds[k] == pytest.approx(25, abs=0.06)
    assert size == pytest.approx(1, abs=0.05)


def test_what_is_a_jump_is_reported_and_documented(result, report, parsed):
    drawn = DrawnRun.of(result)
    assert f'(from one pair to the next off by more than {drawn.least_jump:.4g} m)' in (
        parsed(report).text
    )
    document = (Path(__file__).resolve().parents[2] / 'docs/figures.md').read_text()
    assert f'{MIN_JUMP_M:g} m and {JUMP_OVER_P95:g} times' in document
    assert drawn.least_jump >= MIN_JUMP_M
    assert np.quantile(drawn.steps, 0.95) * JUMP_OVER_P95 <= drawn.least_jump


@pytest.mark.parametrize('turned', [False, True])
def test_ground_truth_is_drawn_also_where_there_is_no_pair(turned, tmp_path, parsed):
    flight = simulate(duration_s=20.0)
    for name, poses in (('est', flight.estimate[:100]), ('gt', flight.ground_truth)):
        (tmp_path / f'{name}.tum').write_text(tum(poses))
    sources = read_sources([f'{tmp_path}/est.tum', f'{tmp_path}/gt.tum'])
    lever = (0.5, 0, 0, 0, 0, 0, 1) if turned else (0, 0, 0, 0, 0, 0, 1)
    config = EvaluationConfig(start_s=1, end_s=15, ground_truth_to_body=lever)
    result = score_run(*sources, config)
    path, above = parsed(html_report(result)).figures[:2]
    seconds = (result.truth.stamps_ns - flight.ground_truth.stamps_ns[0]) / 1e9
    assert (seconds[0], seconds[-1]) == pytest.approx((1, 15), abs=0.02)
    last = np.searchsorted(flight.ground_truth.stamps_ns, result.truth.stamps_ns[-1])
    where = flight.ground_truth.positions[last] + rotate(
        flight.ground_truth.rotations[last], np.array(lever[:3])
    )
    for figure, names in ((path, 'xyz'), (above, 'xy')):
        whole, paired, *_ = figure['data']
        assert whole['line']['dash'] == 'dot'
        assert 'dash' not in paired['line']
        assert len(whole['x']) > 1000
        assert [whole[name][-1] for name in names] == pytest.approx(where[: len(names)], abs=1e-3)
        assert whole['x'][-1] != pytest.approx(paired['x'][-1], abs=0.1)
    for k, name in enumerate('xyz'):
        low, high = path['layout']['scene'][f'{name}axis']['range']
        assert low < result.truth.positions[:, k].min() < result.truth.positions[:, k].max() < high
    assert 'dotted where it has no pairs' in parsed(html_report(result)).text


def test_a_gap_of_the_ground_truth_itself_is_not_bridged(tmp_path, parsed):
    flight = simulate(duration_s=20.0)
    seconds = (flight.ground_truth.stamps_ns - flight.ground_truth.stamps_ns[0]) / 1e9
    truth = flight.ground_truth[(seconds < 8) | (seconds > 12)]
    for name, poses in (('est', flight.estimate), ('gt', truth)):
        (tmp_path / f'{name}.tum').write_text(tum(poses))
    sources = read_sources([f'{tmp_path}/est.tum', f'{tmp_path}/gt.tum'])
    (_, above, *_) = parsed(html_report(score_run(*sources, EvaluationConfig()))).figures
    assert above['data'][0]['x'].count(None) == 1


def test_a_lost_track_is_a_gap_until_the_ground_truth_ends():
    run = simulate(duration_s=20.0)
    drawn = DrawnRun.of(result_of(run.estimate[:100], run.ground_truth))
    ((begin, end),) = drawn.gaps
    assert begin == pytest.approx(5, abs=0.06)
    assert end == pytest.approx(20, abs=0.06)


def test_lines_are_thinned_out_but_keep_their_extremes_and_gaps(parsed):
    run = simulate(duration_s=400.0)
    positions = run.estimate.positions.copy()
    positions[4321] += 3
    keep = np.ones(len(positions), bool)
    keep[6000:6100] = False
    estimate = replace(run.estimate, positions=positions)[keep]
    result = result_of(estimate, run.ground_truth, rpe_deltas=('1f',))
    figures = parsed(html_report(result)).figures
    for trace in (trace for figure in figures for trace in figure['data']):
        assert len(trace.get('y', ())) <= 1.1 * MOST_POINTS
    path, _, time, *_ = figures
    assert path['data'][1]['x'].count(None) == 1
    curve = time['data'][0]
    assert curve['y'].count(None) == 1
    highest = max(y for y in curve['y'] if y is not None)
    assert highest == pytest.approx(result.summary.metrics['ate_trans_max_m'], rel=1e-4)
    assert [round(shape['x1'] - shape['x0']) for shape in time['layout']['shapes'][:1]] == [5]


def test_places_and_attitudes_over_time_are_interrupted_in_gaps_and_never_turn_around(parsed):
    run = simulate(duration_s=60.0)
    keep = np.ones(len(run.estimate), bool)
    keep[400:500] = False
    page = parsed(html_report(result_of(run.estimate[keep], run.ground_truth)))
    places, attitudes = page.figures[4:6]
    assert [places['layout'][f'yaxis{k}']['title']['text'] for k in ('', 2, 3)] == [
        'x [m]', 'y [m]', 'z [m]',
    ]  # fmt: skip
    assert attitudes['layout']['yaxis3']['title']['text'] == 'yaw [deg]'
    for figure, limit in ((places, 4.0), (attitudes, 90.0)):
        for truth, estimate in zip(figure['data'][::2], figure['data'][1::2], strict=True):
            assert estimate['y'].count(None) == 1
            assert truth['yaxis'] == estimate['yaxis']
            known = np.array([y for y in estimate['y'] if y is not None])
            assert np.abs(np.diff(known)).max() < limit


def test_errors_along_axes_are_within_the_bounds_that_the_estimate_states(parsed):
    run = simulate(duration_s=20.0)
    covariances = np.zeros((len(run.estimate), 2, 3, 3))
    covariances[:] = np.diag([0.01, 0.04, 0.09])
    stated = replace(run.estimate, covariances=covariances)
    of = result_of(stated, run.ground_truth, alignment='none')
    page = parsed(html_report(of))
    assert '3 sigma' in page.text
    figure = page.figures[3]
    for k, sigma in enumerate((0.1, 0.2, 0.3)):
        below, above, error = figure['data'][3 * k : 3 * k + 3]
        assert above['fill'] == 'tonexty'
        assert np.allclose(above['y'], 3 * sigma, rtol=1e-4)
        assert np.allclose(below['y'], -3 * sigma, rtol=1e-4)
        shift = DrawnRun.of(of).estimate[0, k] - DrawnRun.of(of).truth[0, k]
        assert error['y'][0] == pytest.approx(shift, abs=1e-4)
    silent = replace(run.estimate, covariances=None)
    assert '3 sigma' not in parsed(html_report(result_of(silent, run.ground_truth))).text


def test_a_thinned_line_keeps_its_peak_and_its_hole():
    y = np.sin(np.arange(10_000) / 100)
    y[4321], y[7000:7010] = 5.0, np.nan
    line = Curve(np.arange(10_000.0), y).thinned(100)
    assert len(line.y) <= 101
    assert np.nanmax(line.y) == 5.0
    (hole,) = np.flatnonzero(np.isnan(line.y))
    assert line.x[hole - 1] < 7000 < 7010 <= line.x[hole + 1]


def test_boxes_are_of_the_errors_that_the_figures_are_of(result):
    metrics = result.summary.metrics
    (_, position), (_, rotation) = relative_samples(result)
    for delta in result.config.rpe_deltas:
        for kind, errors in (('trans', position[delta]), ('rot', rotation[delta])):
            unit = 'm' if kind == 'trans' else 'deg'
            assert len(errors) == metrics[f'rpe_{delta}_pairs']
            for name, value in (('median', np.median(errors)), ('max', errors.max())):
                assert value == pytest.approx(metrics[f'rpe_{delta}_{kind}_{name}_{unit}'])
    (box,) = boxes('position [m]', position)['data']
    assert box['median'] == [np.median(errors) for errors in position.values()]
    assert box['q3'] == [np.quantile(errors, 0.75) for errors in position.values()]
    assert box['upperfence'] == [np.quantile(errors, 0.95) for errors in position.values()]


def test_segments_are_those_of_the_metrics(result):
    metrics = result.summary.metrics
    (_, drift), (_, turn) = segment_samples(result, (10.0,))
    assert len(drift['10 m']) == metrics['segment_10m_segments']
    assert drift['10 m'].mean() == pytest.approx(metrics['segment_10m_trans_percent'])
    assert turn['10 m'].mean() == pytest.approx(metrics['segment_10m_rot_deg_per_m'])


@pytest.mark.parametrize(
    ('path_m', 'lengths_m'),
    [(75.0, (5, 10, 20)), (3700.0, (200, 500, 1000)), (1.2, (0.1, 0.2, 0.5)), (math.nan, ())],
)
def test_lengths_of_segments_fit_the_path_where_none_are_given(path_m, lengths_m):
    assert usual_lengths(path_m) == pytest.approx(lengths_m)


def drawn(result: Result, parsed) -> list[str]:
    """Return the kinds of figures of a page that can be made at all."""
    text = html_report(result)
    assert 'NaN' not in text.partition('<body>')[2].partition('<noscript>')[0]
    return [figure['data'][0]['type'] for figure in parsed(text).figures]


def test_positions_without_orientations_are_drawn(parsed):
    run = simulate(duration_s=20.0)
    truth = replace(run.ground_truth, rotations=None)
    kinds = drawn(result_of(run.estimate, truth), parsed)
    assert kinds == ['scatter3d', *4 * ['scatter'], 'box', 'box']


def test_what_has_no_alignment_is_not_drawn_but_reported(parsed):
    run = simulate(duration_s=20.0)
    estimate = replace(run.estimate, rotations=None)
    result = result_of(estimate, run.ground_truth, alignment='origin')
    assert 'scatter3d' not in drawn(result, parsed)
    assert 'Nothing can be drawn' in html_report(result)
    single = result_of(run.estimate[:1], run.ground_truth)
    assert 'scatter3d' not in drawn(single, parsed)
    assert 'Nothing can be drawn' in html_report(single)


@pytest.mark.parametrize('alignment', ['scale', 'sim3'])
def test_an_estimate_that_stands_still_has_a_page_without_its_scale(alignment, parsed):
    run = simulate(duration_s=20.0)
    still = replace(run.estimate, positions=0 * run.estimate.positions)
    result = result_of(still, run.ground_truth, alignment=alignment)
    titles = [
        figure['layout']['yaxis']['title']['text']
        for figure in parsed(html_report(result)).figures
    ]
    assert 'rotation [deg]' in titles
    assert 'position [m]' not in titles


def test_an_estimate_without_any_error_is_drawn(parsed):
    run = simulate(duration_s=20.0)
    result = result_of(run.ground_truth, run.ground_truth, alignment='none')
    assert DrawnRun.of(result).jumps == []
    assert drawn(result, parsed)[:3] == ['scatter3d', 'scatter', 'scatter']


def test_far_coordinates_are_drawn_from_near_them(parsed):
    run = simulate(duration_s=20.0)
    far = replace(run.ground_truth, positions=run.ground_truth.positions + np.array([4e5, 5e6, 0]))
    figure = parsed(html_report(result_of(run.estimate, far))).figures[0]
    assert max(abs(y) for y in figure['data'][0]['y'] if y is not None) < 10
    assert re.match(r'y - 50000\d\d \[m\]', figure['layout']['scene']['yaxis']['title']['text'])
    near = parsed(html_report(result_of(run.estimate, run.ground_truth))).figures[0]
    assert near['layout']['scene']['yaxis']['title']['text'] == 'y [m]'


def test_a_metre_is_as_long_along_every_axis(result, parsed):
    path, above = parsed(html_report(result)).figures[:2]
    scene = path['layout']['scene']
    metres = [scene[f'{name}axis']['range'] for name in 'xyz']
    shown = [
        scene['aspectratio'][name] / (high - low)
        for name, (low, high) in zip('xyz', metres, strict=True)
    ]
    assert shown == pytest.approx([shown[0]] * 3)
    assert above['layout']['yaxis']['scaleanchor'] == 'x'
    for trace in path['data'][:2]:
        for name, (low, high) in zip('xyz', metres, strict=True):
            assert all(low < value < high for value in trace[name] if value is not None)


def test_a_run_that_is_flat_in_y_is_seen_along_y(parsed):
    run = simulate(duration_s=20.0)
    truth = replace(run.ground_truth, positions=run.ground_truth.positions[:, [0, 2, 1]])
    result = result_of(run.estimate, truth)
    assert parsed(html_report(result)).figures[1]['layout']['yaxis']['title']['text'] == 'z [m]'


def test_without_plotly_the_error_says_what_to_install(result, monkeypatch):
    monkeypatch.setitem(sys.modules, 'plotly.offline', None)
    with pytest.raises(ConfigError, match=r"needs plotly: pip install 'vio_eval_ros\[report\]'"):
        html_report(result)


@pytest.mark.parametrize('width', [400, 1400])
def test_a_real_run_looks_right_in_a_browser(width, real, window):
    window.open(html_report(real), width)
    assert len(window.page.query_selector_all('.js-plotly-plot')) == 9
    assert window.page.inner_text('header .badge') == 'fail'


def test_pointing_at_an_error_shows_where_that_was(real, window):
    window.open(html_report(real), 1400)
    page = window.page
    page.hover('.plot[data-shows=errors] .nsewdrag >> nth=0')
    window.wait(
        "[...document.querySelectorAll('[data-shows=path]')]"
        '.every(box => typeof box.data.at(-1).x[0] === "number")'
    )
    places = page.evaluate(
        "[...document.querySelectorAll('[data-shows=path]')]"
        '.map(box => [box.data.at(-1).x[0], box.data.at(-1).y[0]])'
    )
    assert places[0] == places[1]
    page.emulate_media(color_scheme='dark')
    window.wait(
        "document.querySelector('.plot').layout.font.color"
        ' === getComputedStyle(document.body).color'
    )
    window.check()


def test_hostile_names_do_nothing_in_a_browser(window):
    result = result_of(*harmed(), source=HOSTILE)
    warned = replace(result.summary, warnings=(*result.summary.warnings, HOSTILE))
    result = replace(result, summary=warned)
    window.open(html_report(result), 400)
    assert window.page.evaluate('typeof hacked') == 'undefined'
    assert '<script>hacked=1' in window.page.inner_text('h1')
    assert json.loads(window.page.evaluate('JSON.stringify(document.images.length)')) == 0
