"""The page of a suite: the worst first, each run beside the baseline's, and no name breaks out."""

from collections.abc import Iterable
from dataclasses import replace
import math
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import pytest

from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.scoring.baseline import Baseline, BaselineSequence, definition_sha256
from vio_eval_ros.scoring.html import suite_html
from vio_eval_ros.scoring.loading import load_suite
from vio_eval_ros.scoring.plots import MARKERS
from vio_eval_ros.scoring.results import SequenceResult, SuiteResult
from vio_eval_ros.scoring.scoring import compare_suite, score_suite
from vio_eval_ros.scoring.tables import problems
from vio_eval_ros.simulation import simulate

HOSTILE = '</script><img src=x onerror=hacked=1><a href="https://example.org">%{x}</a>'
ATE = 'ate_trans_rmse_m'
SUITE = """
gates: {ate_trans_rmse_m: {max: 0.3, warn: 0.1}, success_rate: {min: 0.5}}
sequences:
  - {name: steady, estimate: 'steady/*.tum', ground_truth: gt.tum}
  - {name: far off, estimate: 'far/*.tum', ground_truth: gt.tum}
  - {name: lost, estimate: 'lost/*.tum', ground_truth: gt.tum, gates: {success_rate: {min: 1}}}
  - {name: unreadable, estimate: 'unreadable/*.tum', ground_truth: gt.tum}
  - {name: single, estimate: lost/1.tum, ground_truth: gt.tum}
"""


def write_runs(folder: Path, errors: Iterable[float]) -> None:
    """Write a suite with runs that are as wrong as told, times that of the others [m]."""
    run = simulate(duration_s=20.0)
    truth, estimate = run.ground_truth, run.estimate
    noise = np.random.default_rng(3).standard_normal((20, len(estimate), 3))
    wander = np.cumsum(noise, axis=1) / math.sqrt(len(estimate))

    def write(name: str, poses: Trajectory) -> None:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(tum(poses))

    write('gt.tum', truth)
    for k, error in enumerate(errors):
        moved = estimate.positions + error * wander[k]
        write(f'steady/{k}.tum', replace(estimate, positions=moved))
        write(f'far/{k}.tum', replace(estimate, positions=estimate.positions + wander[k]))
        write(f'lost/{k}.tum', estimate if k else estimate[:100])
    (folder / 'unreadable').mkdir(exist_ok=True)
    (folder / 'unreadable' / '0.tum').write_text('1 2 3\n4 5\n')
    (folder / 'suite.yaml').write_text(SUITE)


@pytest.fixture(scope='module')
def result(tmp_path_factory) -> SuiteResult:
    """Return a suite that became worse than its baseline, and failed otherwise as well."""
    folder = tmp_path_factory.mktemp('suite')
    write_runs(folder, [0.02, 0.021, 0.022, 0.023, 0.024])
    before = score_suite(load_suite(folder / 'suite.yaml'), 2)
    write_runs(folder, [0.1, 0.101, 0.102, 0.103, 0.104])
    return against(score_suite(load_suite(folder / 'suite.yaml'), 2), before)


def against(result: SuiteResult, before: SuiteResult) -> SuiteResult:
    recorded: dict[str, BaselineSequence] = {
        one.sequence.name: one.recorded for one in before.sequences
    }
    return compare_suite(result, Baseline(definition_sha256(), recorded))


@pytest.fixture(scope='module')
def report(result) -> str:
    return suite_html(result)


def named(result: SuiteResult, name: str) -> SequenceResult:
    (found,) = (one for one in result.sequences if one.sequence.name == name)
    return found


def marks(figure: dict, kind: str) -> list[tuple[float, float]]:
    """Return line and value of the marks of a kind."""
    trace = figure['data'][list(MARKERS).index(kind)]
    return list(zip(trace['y'], trace['x'], strict=True))


@pytest.mark.slow
def test_the_worst_comes_first_and_all_that_is_wrong_is_reported(result, report, parsed):
    page = parsed(report)
    assert page.of('h1')[0][1] == '4 of 5 sequences failed'
    order = [text for attributes, text in page.of('a')]
    assert order == ['unreadable', 'far off', 'steady', 'lost', 'single']
    for one in result.sequences:
        for problem in problems(one):
            assert problem in page.text
    assert '1 could not be scored' in page.text
    assert result.notes
    for note in result.notes:
        assert note in page.text


@pytest.mark.slow
def test_each_row_leads_to_the_sequence(report, parsed):
    page = parsed(report)
    targets = [attributes['href'] for attributes, _ in page.of('a')]
    sections = [a for a, _ in page.of('details') if 'id' in a]
    assert targets == [f'#{section["id"]}' for section in sections]


def test_what_passed_is_folded_and_what_failed_is_not(report, parsed):
    details = [attributes for attributes, _ in parsed(report).of('details')]
    assert [('open' in one) for one in details if 'id' in one] == [True, True, True, True, False]
    # of the plots in space and time, only the worst sequence's are unfolded
    assert [('open' in one) for one in details if 'id' not in one].count(True) == 1


def test_every_run_is_drawn_beside_the_baseline_and_the_gates(result, report, parsed):
    figure = parsed(report).figures[0]
    at = figure['layout']['yaxis']['ticktext'].index('steady')
    steady = named(result, 'steady')
    (comparison,) = steady.comparisons
    assert comparison.worse
    values = [value for line, value in marks(figure, 'run') if line == at]
    assert sorted(values) == sorted(steady.metrics[ATE].values)
    (below,) = {line for line, _ in marks(figure, 'baseline') if at <= line < at + 1}
    before = [value for line, value in marks(figure, 'baseline') if line == below]
    assert sorted(before) == sorted(comparison.baseline.values)
    assert (at, steady.metrics[ATE].median) in marks(figure, 'median')
    assert [value for line, value in marks(figure, 'fail') if line == at] == [0.3]
    assert [value for line, value in marks(figure, 'warn') if line == at] == [0.1]
    assert len(marks(figure, 'failed run')) == 1


def test_the_median_run_is_the_one_that_is_shown(result, report, parsed):
    steady = named(result, 'steady')
    (name,) = (
        run.run.name
        for run in steady.runs
        if run.result.summary.metrics[ATE] == steady.metrics[ATE].median
    )
    summaries = [text for _, text in parsed(report).of('summary')]
    assert f'Where and when: {name}, the median run' in summaries
    assert 'Where and when: lost/1.tum' in summaries
    # of which the error is the least
    assert 'Where and when: lost/0.tum, the worst run' in summaries


def test_the_figures_are_such_as_plotly_knows(report, parsed):
    figures = parsed(report).figures
    # all runs; per sequence the runs where there are several, and five plots of one that is there
    # and of the worst
    assert len(figures) == 1 + (1 + 5 + 5) * 3 + 0 + 5
    for figure in figures:
        go.Figure(figure)


def test_empty_columns_are_left_out(result, parsed):
    alone = SuiteResult([named(result, 'single')])
    alone.sequences[0] = replace(alone.sequences[0], comparisons=None)
    heads = [text for _, text in parsed(suite_html(alone)).of('th')]
    assert {'sequence', 'runs', 'ATE [m]', 'verdict'} <= set(heads)
    assert not {'baseline', 'p', 'band'} & set(heads)
    assert 'All sequences passed' in suite_html(alone)


def test_a_gate_on_what_is_unknown_is_used_up(result, parsed):
    page = parsed(suite_html(SuiteResult([named(result, 'unreadable')])))
    gates = named(result, 'unreadable').sequence.gates
    bars = [attributes['style'] for attributes, _ in page.of('i')]
    assert bars == ['width:100%'] * len(gates)


def test_names_stay_text(result, parsed):
    sequences = [
        replace(
            one,
            sequence=replace(one.sequence, name=HOSTILE + one.sequence.name),
            runs=[
                replace(run, run=replace(run.run, name=HOSTILE), error=run.error and HOSTILE)
                for run in one.runs
            ],
        )
        for one in result.sequences
    ]
    page = parsed(suite_html(SuiteResult(sequences, (HOSTILE,))))
    assert HOSTILE in page.text
    assert not page.of('img')
    assert all(attributes['href'].startswith('#sequence-') for attributes, _ in page.of('a'))
    for figure in page.figures:
        for trace in figure['data']:
            assert not any('<' in text for text in trace.get('text', ()))
        assert not any(
            '<' in text for text in figure['layout'].get('yaxis', {}).get('ticktext', ())
        )


def test_the_page_is_the_same_when_made_twice(result, report):
    assert suite_html(result) == report


@pytest.fixture(scope='module')
def real(shared_data, tmp_path_factory) -> SuiteResult:
    """Return several systems on three EuRoC sequences, one of them far off, against themselves."""
    file = tmp_path_factory.mktemp('real') / 'suite.yaml'
    plsl, truth = f'{shared_data}/est_plsl_slam/euroc', f'{shared_data}/gt_euroc/open_vins_tum'
    orb = f'{shared_data}/est_orbslam3/spsingh37/f_dataset-MH01_mono.txt?stamps=ns'
    file.write_text(f"""
options: {{max_difference_s: 0.01}}
gates: {{ate_trans_rmse_m: {{max: 0.3, warn: 0.2}}}}
sequences:
  - name: V1_02
    estimate: {plsl}/V1-02/*.csv?quaternion=wxyz&stamps=ns
    ground_truth: {truth}/V1_02_medium.txt
  - name: MH_05
    estimate: {plsl}/MH-05/*?quaternion=wxyz&stamps=ns
    ground_truth: {truth}/MH_05_difficult.txt
  - name: MH_01 monocular
    estimate: {orb}
    ground_truth: {shared_data}/gt_euroc/orbslam3_left_cam/MH01_GT.txt
""")
    result = score_suite(load_suite(file), 2)
    return against(result, result)


@pytest.mark.parametrize('width', [400, 1400])
def test_a_real_suite_looks_right_in_a_browser(width, real, window):
    assert [one.passed for one in real.sequences] == [True, True, False]
    window.open(suite_html(real), width)
    assert window.page.inner_text('header .badge') == 'fail'
    assert len(window.page.query_selector_all('.js-plotly-plot')) == 6


def test_a_link_unfolds_a_sequence_and_folding_lets_go_of_its_plots(real, window):
    window.open(suite_html(real), 1400)
    page = window.page
    before = len(page.query_selector_all('.js-plotly-plot'))
    page.click('a[href="#sequence-1"]')
    window.wait("document.querySelector('#sequence-1').open")
    page.click('#sequence-1 details:has(.run) > summary')
    window.wait(f"document.querySelectorAll('.js-plotly-plot').length === {before + 6}")
    window.check()
    page.click('#sequence-1 > summary')
    window.wait("!document.querySelector('#sequence-1 .main-svg, #sequence-1 canvas')")


def test_hostile_names_do_nothing_in_a_browser(real, window):
    sequences = [
        replace(one, sequence=replace(one.sequence, name=HOSTILE)) for one in real.sequences
    ]
    window.open(suite_html(SuiteResult(sequences, real.notes)), 400)
    assert window.page.evaluate('typeof hacked') == 'undefined'
    assert window.page.evaluate('document.images.length') == 0
    links = window.page.evaluate(
        "[...document.querySelectorAll('a')].map(a => a.getAttribute('href') ?? '')"
    )
    assert not [link for link in links if 'example' in link]
