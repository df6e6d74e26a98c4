"""Every report holds the figures of the result, whatever the names in it."""

import csv
import dataclasses
import io
import json
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from xmlschema import XMLSchema

from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.core.gates import Gate, judge
from vio_eval_ros.core.statistics import STATISTICS
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.errors import ConfigError, WriteError
from vio_eval_ros.evaluation.result import Input, Result
from vio_eval_ros.recordings.sources import read_sources
from vio_eval_ros.rendering.files import write
from vio_eval_ros.rendering.text import number
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.reports.text import text_report
from vio_eval_ros.simulation import simulate

TEXTS = [name for name in REPORTS if name not in ('mcap', 'rerun')]
HOSTILE = 'a<script>alert(1)</script>|`b`*c*&"\x1b[2J\x00\n# d'


def result_of(
    gates: tuple[str, ...] = (),
    source: str = 'est',
    position_only: bool = False,
    begins_late: bool = False,
) -> Result:
    run = simulate(duration_s=20.0)
    evaluation = Evaluation(EvaluationConfig(segment_lengths_m=(10,)))
    truth = run.ground_truth
    if position_only:
        truth = dataclasses.replace(truth, rotations=None)
    evaluation.add_ground_truth(truth)
    evaluation.add_estimate(run.estimate[100:] if begins_late else run.estimate)
    evaluation.flush()
    summary = evaluation.summary()
    streams = evaluation.associator
    return Result(
        Input.of(source, 'tum', streams.estimate, sha256='0' * 64),
        Input.of('gt', 'tum', streams.ground_truth),
        evaluation.config,
        summary,
        judge([Gate.parse(gate) for gate in gates], summary.metrics),
    )


@pytest.fixture(scope='module')
def passing() -> Result:
    return result_of(('ate_trans_rmse_m<=1', 'coverage_ratio>=0.9'))


@pytest.fixture(scope='module')
def failing() -> Result:
    return result_of(('ate_trans_rmse_m<=1e-9', 'coverage_ratio>=0.9'))


def test_json_holds_every_figure_to_the_last_bit(passing):
    parsed = json.loads(REPORTS['json'](passing))
    assert parsed['schema'] == 'vio_eval_ros.result/1'
    assert parsed['metrics'].keys() == passing.summary.metrics.keys()
    for name, value in parsed['metrics'].items():
        expected = passing.summary.metrics[name]
        assert value == expected or (value is None and math.isnan(expected)), name
    assert parsed['metrics']['kitti_trans_percent'] is None
    assert parsed['config'] == passing.config.to_dict()
    assert EvaluationConfig.from_mapping(parsed['config']) == passing.config
    assert parsed['association']['pairs'] == 400
    assert parsed['verdict'] == 'pass'
    assert parsed['gates'][0] == {
        'metric': 'ate_trans_rmse_m',
        'comparison': '<=',
        'limit': 1.0,
        'severity': 'fail',
        'value': passing.summary.metrics['ate_trans_rmse_m'],
        'passed': True,
    }
    estimate = parsed['inputs']['estimate']
    assert estimate['poses'] == 400
    assert estimate['rate_hz'] == pytest.approx(20)
    assert set(estimate['dropped'].values()) == {0}


def test_json_has_null_and_never_nan():
    parsed = json.loads(REPORTS['json'](result_of(position_only=True)))
    assert parsed['metrics']['ate_rot_rmse_deg'] is None
    assert parsed['metrics']['ate_trans_rmse_m'] > 0
    assert parsed['verdict'] is None


def test_junit_has_a_case_for_each_gate_and_fails_where_one_fails(passing, failing):
    good = ElementTree.fromstring(REPORTS['junit'](passing))
    bad = ElementTree.fromstring(REPORTS['junit'](failing))
    assert (good.get('tests'), good.get('failures')) == ('2', '0')
    assert (bad.get('tests'), bad.get('failures')) == ('2', '1')
    assert good.find('.//failure') is None
    case = bad.find('.//testcase')
    assert case.get('name') == 'ate_trans_rmse_m<=1e-09'
    assert 'the gate is ate_trans_rmse_m<=1e-09' in case.find('failure').get('message')


def test_junit_keeps_the_schema_of_jenkins(passing, failing):
    schema = XMLSchema(Path(__file__).resolve().parents[1] / 'junit.xsd')
    for result in (passing, failing, result_of(source=HOSTILE), result_of(position_only=True)):
        schema.validate(REPORTS['junit'](result))


def test_an_estimate_that_began_late_is_not_said_to_have_lost_track():
    late = result_of(begins_late=True)
    assert 'since the first estimate, after 5 s' in text_report(late)
    assert 'since the first estimate, after 5 s' in REPORTS['html'](late)
    assert late.to_dict()['success'] is True
    assert late.to_dict()['association']['initialisation_s'] == pytest.approx(5.0, abs=0.1)
    assert 'since the first estimate' not in text_report(result_of())


def test_a_result_says_whether_it_is_a_success_and_why(passing):
    parsed = json.loads(REPORTS['json'](passing))
    assert parsed['success'] is True
    assert [
        (gate['metric'], gate['comparison'], gate['limit'], gate['passed'])
        for gate in parsed['success_gates']
    ] == [('tracked_ratio', '>=', 0.9, True), ('ate_extent_ratio', '<=', 0.5, True)]
    metrics = passing.summary.metrics | {'ate_extent_ratio': 0.6, 'tracked_ratio': math.nan}
    summary = dataclasses.replace(passing.summary, metrics=metrics)
    lost = json.loads(REPORTS['json'](dataclasses.replace(passing, summary=summary)))
    assert lost['success'] is False
    assert [gate['value'] for gate in lost['success_gates']] == [None, 0.6]
    assert lost['verdict'] == 'pass'


def test_junit_of_a_run_without_gates_says_that_it_was_evaluated():
    root = ElementTree.fromstring(REPORTS['junit'](result_of()))
    assert [case.get('name') for case in root.iter('testcase')] == ['evaluated']


def test_markdown_shows_the_verdict_and_the_errors(passing, failing):
    assert '✅ pass' in REPORTS['markdown'](passing)
    text = REPORTS['markdown'](failing)
    assert '❌ fail' in text
    assert f'| ATE position [m] | {failing.summary.metrics["ate_trans_rmse_m"]:.4g} |' in text
    tables = [line for line in text.splitlines() if line.startswith('|')]
    assert {line.count('|') for line in tables} == {4, 10}
    for metric, value in failing.summary.metrics.items():
        if (
            value
            and not np.isnan(value)
            and not metric.startswith(('ate_trans', 'ate_rot', 'rpe'))
        ):
            assert f'| {number(value)} | `{metric}` |' in text, metric


@pytest.mark.parametrize('name', [*TEXTS, 'text'])
def test_hostile_names_do_not_break_out(name):
    text = (REPORTS | {'text': text_report})[name](result_of(source=HOSTILE))
    assert '\x1b' not in text
    assert '\x00' not in text
    if name in ('junit', 'markdown'):
        assert '<script>' not in text.replace(r'\<script\>', '')
    if name == 'json':
        assert json.loads(text)['inputs']['estimate']['source'] == HOSTILE
    if name == 'junit':
        assert 'script' in ElementTree.fromstring(text).find('testsuite').get('name')


@pytest.mark.parametrize('name', [*TEXTS, 'mcap'])
def test_a_report_is_the_same_when_made_twice(name, passing):
    assert REPORTS[name](passing) == REPORTS[name](passing)


@pytest.mark.parametrize('name', TEXTS)
def test_a_text_ends_with_its_last_line(name, passing):
    assert REPORTS[name](passing).endswith('\n')


def test_csv_has_the_errors_of_every_pair(passing):
    rows = list(csv.DictReader(io.StringIO(REPORTS['csv'](passing))))
    pairs = passing.summary.pairs
    assert [int(row['estimate_stamp_ns']) for row in rows] == pairs.estimate.stamps_ns.tolist()
    assert [int(row['ground_truth_stamp_ns']) for row in rows] == (
        pairs.ground_truth.stamps_ns.tolist()
    )
    for quantity, unit in (('trans', 'm'), ('rot', 'deg')):
        errors = np.array([float(row[f'ate_{quantity}_{unit}']) for row in rows])
        rmse = passing.summary.metrics[f'ate_{quantity}_rmse_{unit}']
        # 9 digits are printed
        assert math.sqrt(np.mean(errors**2)) == pytest.approx(rmse, rel=1e-8)


def test_csv_leaves_unknown_rotation_errors_empty():
    rows = list(csv.DictReader(io.StringIO(REPORTS['csv'](result_of(position_only=True)))))
    assert {row['ate_rot_deg'] for row in rows} == {''}
    assert all(float(row['ate_trans_m']) > 0 for row in rows)


def test_tum_is_the_aligned_estimate_with_nine_decimals(tmp_path, passing):
    path = tmp_path / 'aligned.txt'
    path.write_text(REPORTS['tum'](passing))
    row = path.read_text().splitlines()[1].split()
    assert [len(word.partition('.')[2]) for word in row] == [9] * 8
    (read,) = read_sources([str(path)])
    summary = passing.summary
    assert np.array_equal(read.poses.stamps_ns, summary.pairs.estimate.stamps_ns)
    difference = read.poses.positions - summary.pairs.ground_truth.positions
    rmse = math.sqrt(np.mean(np.sum(difference**2, axis=1)))
    assert rmse == pytest.approx(summary.metrics['ate_trans_rmse_m'], rel=1e-7)


def test_tum_is_refused_without_orientations():
    run = simulate(duration_s=5.0)
    evaluation = Evaluation(EvaluationConfig())
    evaluation.add_ground_truth(run.ground_truth)
    evaluation.add_estimate(dataclasses.replace(run.estimate, rotations=None))
    evaluation.flush()
    result = dataclasses.replace(result_of(), summary=evaluation.summary())
    with pytest.raises(ConfigError, match='use a csv report'):
        REPORTS['tum'](result)


def test_latex_has_a_row_of_statistics_for_each_error(passing):
    begin, top, heads, middle, *body, bottom, end = REPORTS['latex'](passing).splitlines()
    assert (begin, end) == (r'\begin{tabular}{lrrrrrrr}', r'\end{tabular}')
    assert [top, middle, bottom] == [r'\toprule', r'\midrule', r'\bottomrule']
    cells = [[cell.strip(' \\') for cell in row.split('&')] for row in [heads, *body]]
    assert cells[0] == ['error', *STATISTICS]
    assert len(body) == 2 + 2 * len(passing.config.rpe_deltas)
    values = [passing.summary.metrics[f'ate_trans_{name}_m'] for name in STATISTICS]
    assert cells[1] == ['ATE position [m]', *(f'{value:.4g}' for value in values)]


def test_latex_has_a_dash_for_what_is_unknown():
    text = REPORTS['latex'](result_of(position_only=True))
    row = next(line for line in text.splitlines() if 'ATE rotation' in line)
    assert row.count(' - ') == len(STATISTICS)


def test_text_names_every_gate_and_warning(failing):
    text = text_report(failing)
    assert 'fail  ate_trans_rmse_m<=1e-09' in text
    assert 'pass  coverage_ratio>=0.9' in text
    assert 'drift over 10m' in text
    for warning in failing.summary.warnings:
        assert warning in text


def test_text_shows_displacement_where_orientations_are_unknown():
    text = text_report(result_of(position_only=True))
    assert 'RPE 1f displacement [m]' in text
    assert 'RPE 1f position [m]' not in text
    assert 'positions only' in text


def test_a_file_is_written_whole_or_not_at_all(tmp_path):
    path = tmp_path / 'report.json'
    write(path, 'old')
    with pytest.raises(UnicodeEncodeError):
        write(path, 'new \ud800')
    assert path.read_text() == 'old'
    write(path, 'new')
    assert path.read_text() == 'new'
    assert path.stat().st_mode & 0o444 == 0o444


def test_bytes_are_written_as_they_are(tmp_path):
    write(tmp_path / 'report.mcap', b'\x89MCAP\r\n\x00\xff')
    assert (tmp_path / 'report.mcap').read_bytes() == b'\x89MCAP\r\n\x00\xff'
    assert list(tmp_path.iterdir()) == [tmp_path / 'report.mcap']


def test_a_link_is_followed_and_a_pipe_is_written_to(tmp_path):
    (tmp_path / 'link').symlink_to(tmp_path / 'target')
    write(tmp_path / 'link', 'text')
    assert (tmp_path / 'link').is_symlink()
    assert (tmp_path / 'target').read_text() == 'text'
    write(Path('/dev/null'), 'text')
    assert not Path('/dev/null').is_file()


def test_tum_has_negative_stamps():
    trajectory = Trajectory(np.array([-19_000_000]), np.zeros((1, 3)), np.array([[0, 0, 0, 1.0]]))
    assert tum(trajectory).splitlines()[1].split()[0] == '-0.019000000'


def test_stamps_are_reported_as_recorded_and_only_those_that_were_used():
    run = simulate(duration_s=20.0)
    evaluation = Evaluation(EvaluationConfig(start_s=5, end_s=10, time_offset_s=0.004))
    evaluation.add_ground_truth(run.ground_truth)
    evaluation.add_estimate(run.estimate)
    evaluation.flush()
    result = dataclasses.replace(
        result_of(),
        summary=evaluation.summary(),
        config=evaluation.config,
        estimate=Input.of('est', 'tum', evaluation.associator.estimate, offset_s=0.004),
    )
    facts = result.estimate.to_dict()
    assert facts['poses'] == 100
    assert facts['dropped']['cropped'] == 300
    assert facts['rate_hz'] == pytest.approx(20)
    assert facts['first_stamp_ns'] in run.estimate.stamps_ns
    rows = list(csv.DictReader(io.StringIO(REPORTS['csv'](result))))
    assert int(rows[0]['estimate_stamp_ns']) == facts['first_stamp_ns']


def test_what_cannot_be_written_is_named(tmp_path):
    folder = tmp_path / 'report.json'
    folder.mkdir()
    with pytest.raises(WriteError, match=r'report\.json: cannot write'):
        write(folder, 'text')
    assert list(tmp_path.iterdir()) == [folder]
