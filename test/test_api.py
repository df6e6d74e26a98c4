"""The package as a library: every form of a trajectory gives the same numbers or a clear error."""

from __future__ import annotations

import dataclasses
from functools import cache
import json
import math
from pathlib import Path
import re
import subprocess
import sys

from jsonschema import validate
import numpy as np
import pandas as pd
import pytest

from verbs import call, transcript
import vio_eval_ros as vio

ROOT = Path(__file__).resolve().parents[1]
FLIGHT = ROOT / 'demo/simulated_flight'
SECOND = 10**9
GATE = 'ate_trans_rmse_m<=0.1'


read = cache(vio.read)


@pytest.fixture(scope='module')
def golden(shared_data):
    return json.loads((shared_data / 'golden.json').read_text())


def columns(source: vio.Source) -> tuple:
    return source.stamps_ns, source.positions, source.rotations


def frame(source: vio.Source, scale: float = 1.0) -> pd.DataFrame:
    """Return a DataFrame as evo's pandas_bridge makes it: w first, indexed by seconds."""
    names = ['x', 'y', 'z', 'qw', 'qx', 'qy', 'qz']
    values = np.column_stack([source.positions, np.roll(source.rotations, 1, axis=1)])
    return pd.DataFrame(values, index=source.stamps_ns * scale, columns=names)


FORMS = {
    'spec': lambda spec: spec,
    'path': Path,
    'source': read,
    'columns': lambda spec: columns(read(spec)),
    'poses': lambda spec: read(spec).poses,
    'nanoseconds': lambda spec: frame(read(spec), 1),
    'seconds': lambda spec: frame(read(spec), 1e-9),
    'dates': lambda spec: frame(read(spec)).set_index(pd.to_datetime(read(spec).stamps_ns)),
}


@pytest.mark.slow
@pytest.mark.parametrize('form', FORMS)
def test_every_form_of_a_trajectory_gives_the_golden_figures(form, golden, shared_data):
    compared = 0
    for pair in golden:
        specs = [f'{shared_data}/{pair[side]}' for side in ('estimate', 'ground_truth')]
        if form == 'path' and any('?' in spec for spec in specs):
            continue  # what is stated of a file is not part of its path
        estimate, truth = map(FORMS[form], specs)
        result = vio.evaluate(estimate, truth, max_difference_s=pair['max_difference_s'])
        expected = {f'ate_trans_{name}_m': value for name, value in pair['ate_se3_trans'].items()}
        del expected['ate_trans_sse_m']
        expected['ate_sim3_trans_rmse_m'] = pair['ate_sim3_trans']['rmse']
        expected['sim3_scale'] = pair['sim3_scale']
        found = {name: result.metrics[name] for name in expected}
        assert found == pytest.approx(expected, rel=1e-8, abs=1e-12)
        assert len(result.errors()) == pair['matched']
        compared += 1
    assert compared >= 9


def test_a_recording_is_read_in_one_call_or_topic_by_topic():
    whole = vio.evaluate(recording=FLIGHT)
    truth = vio.read('/ground_truth/pose', recording=FLIGHT)
    parts = vio.evaluate('/vio/odometry', truth, recording=FLIGHT)
    one_side = vio.evaluate(ground_truth=truth, recording=FLIGHT)
    assert whole.metrics['ate_trans_rmse_m'] == pytest.approx(0.07649911276649467, rel=1e-12)
    for other in (parts, one_side):
        assert np.array_equal(list(other.metrics.values()), list(whole.metrics.values()), True)
    assert whole.estimate.source == '/vio/odometry'


@pytest.fixture
def flight() -> vio.Result:
    return vio.evaluate(recording=FLIGHT, gates=['ate_trans_rmse_m<=0.1', 'coverage_ratio>=0.9'])


def test_a_result_has_its_errors_as_a_table(flight):
    errors = flight.errors()
    assert errors.index.name == 'stamp_ns'
    assert errors.index.dtype == np.int64
    assert list(errors) == [
        'ground_truth_stamp_ns', 'ate_trans_m', 'ate_rot_deg',
        'error_x_m', 'error_y_m', 'error_z_m',
    ]  # fmt: skip
    rmse = math.sqrt((errors['ate_trans_m'] ** 2).mean())
    assert rmse == pytest.approx(flight.metrics['ate_trans_rmse_m'], rel=1e-12)
    squares = (errors[['error_x_m', 'error_y_m', 'error_z_m']] ** 2).sum(axis=1)
    assert np.allclose(squares, errors['ate_trans_m'] ** 2, rtol=1e-9)


def test_stamps_of_errors_are_those_recorded_whatever_the_time_offset():
    estimate = vio.read('/vio/odometry', FLIGHT)
    shifted = vio.evaluate(estimate, '/ground_truth/pose', recording=FLIGHT, time_offset_s=0.01)
    assert set(shifted.errors().index) <= set(estimate.stamps_ns)


def test_a_result_is_json_of_its_schema(flight):
    schema = json.loads((ROOT / 'docs/schema/result-1.json').read_text())
    result = json.loads(flight.to_json())
    validate(result, schema)
    assert result['verdict'] == 'pass'
    assert flight.passed


@pytest.mark.slow
def test_a_result_is_shown_in_a_line_and_in_a_notebook_as_a_table(flight):
    assert repr(flight) == (
        '<Result /vio/odometry: 1,200 pairs, 99.9 % covered, ATE 0.0765 m, 1.453 deg, se3>'
    )
    page = flight._repr_html_()
    assert page.count('<tr>') == 1 + 8
    assert 'ATE 0.0765 m, 1.453 deg, se3</p>' in page
    assert '>ATE position [m]</td><td class="number">0.0765</td>' in page


def test_names_in_a_notebook_cannot_be_markup():
    estimate = vio.read('/vio/odometry', FLIGHT)
    hostile = vio.evaluate(
        vio.Source('<script>alert(1)</script>', 'tum', (), estimate.poses),
        '/ground_truth/pose',
        recording=FLIGHT,
    )
    assert '<script>' not in hostile._repr_html_()


@pytest.mark.parametrize('what', ['path', 'path_3d', 'errors'])
def test_a_result_is_drawn_by_plotly(flight, what):
    figure = flight.plot(what)
    assert type(figure).__module__.startswith('plotly.')
    points = [len(trace.x) for trace in figure.data if trace.x is not None]
    assert max(points) > 500


def test_there_is_no_other_plot(flight):
    with pytest.raises(vio.ConfigError, match="'map' is not one of path, path_3d, errors"):
        flight.plot('map')


def test_what_has_no_alignment_cannot_be_drawn_but_shown():
    result = vio.evaluate((STAMPS, POSITIONS), (STAMPS, POSITIONS), alignment='origin')
    with pytest.raises(vio.ConfigError, match='nothing to draw: the alignment is not determined'):
        result.plot()
    assert 'ATE - m' in repr(result)
    assert '<td class="number">-</td>' in result._repr_html_()
    assert result.errors()['ate_trans_m'].isna().all()
    assert json.loads(result.to_json())['metrics']['ate_trans_rmse_m'] is None


def test_a_source_becomes_a_table_and_back():
    source = vio.read('/vio/odometry', FLIGHT)
    assert repr(source) == '<Source /vio/odometry (rosbag2): 1,200 poses, 59.95 s>'
    table = source.to_dataframe()
    assert list(table) == ['x', 'y', 'z', 'qx', 'qy', 'qz', 'qw']
    result = vio.evaluate(table, '/ground_truth/pose', recording=FLIGHT)
    assert result.metrics['ate_trans_rmse_m'] == pytest.approx(0.07649911276649467, rel=1e-12)
    positions = vio.trajectory(source.stamps_ns, source.positions)
    assert list(positions.to_dataframe()) == ['x', 'y', 'z']
    assert 'positions only' in repr(positions)


STAMPS = 1403636579 * SECOND + np.arange(20) * SECOND // 10
POSITIONS = np.random.default_rng(1).normal(size=(20, 3))
ROTATIONS = np.tile([0.0, 0.0, 0.0, 1.0], (20, 1))


def with_nan(values: np.ndarray) -> np.ndarray:
    values = values.copy()
    values[3, 1] = math.nan
    return values


WRONG = {
    'five stamps': (
        (STAMPS[:5], POSITIONS, ROTATIONS), r'positions: expected shape (5, 3), got (20, 3)'
    ),
    'two columns': (
        (STAMPS, POSITIONS[:, :2], None), r'positions: expected shape (20, 3), got (20, 2)'
    ),
    'transposed': ((STAMPS, POSITIONS.T), 'positions: expected shape (20, 3), got (3, 20)'),
    'matrices': (
        (STAMPS, POSITIONS, np.zeros((20, 3, 3))),
        'rotations: expected shape (20, 4), got (20, 3, 3)',
    ),
    'too few rotations': (
        (STAMPS, POSITIONS, ROTATIONS[:7]), 'rotations: expected shape (20, 4), got (7, 4)'
    ),
    'a table of stamps': (
        (STAMPS[:, None], POSITIONS), 'stamps: expected shape (N,) with N >= 1, got (20, 1)'
    ),
    'nothing': (
        ([], np.empty((0, 3))), 'stamps: expected shape (N,) with N >= 1, got (0,)'
    ),
    'float seconds': (
        (STAMPS / 1e9, POSITIONS),
        'stamps: expected integers, nanoseconds, got float64; from seconds: '
        'numpy.round(stamps * 1e9).astype(numpy.int64)',
    ),
    'whole seconds': (
        (1403636579 + np.arange(20), POSITIONS),
        'stamps: expected nanoseconds, got 1403636579 to 1403636598, 1 apart: another unit or '
        'row numbers?',
    ),
    'whole microseconds': (
        (STAMPS // 1000 // 2, POSITIONS),
        'stamps: expected nanoseconds, got 701818289500000 to 701818290450000, 50000 apart: '
        'another unit or row numbers?',
    ),
    'one stamp': (
        (STAMPS * 0 + 5, POSITIONS), 'stamps: expected increasing, got 5 in all 20 rows'
    ),
    'stamps beyond int64': (
        (STAMPS.astype(np.uint64) + np.uint64(1 << 63), POSITIONS),
        'stamps: expected nanoseconds, got 10627008617754775808: more than 146 years',
    ),
    'masked stamps': (
        (np.ma.masked_less(STAMPS, STAMPS[2]), POSITIONS),
        'stamps: expected no masked values, got 2; drop these rows from all columns',
    ),
    'masked positions': (
        (STAMPS, np.ma.masked_where(POSITIONS == POSITIONS[3, 1], POSITIONS)),
        'positions: expected no masked values, got 1; drop these rows from all columns',
    ),
    'ragged stamps': (
        ([[1, 2], [3]], POSITIONS),
        'stamps: expected shape (N,), got rows of different lengths',
    ),
    'huge positions': (
        (STAMPS, POSITIONS * 0 + 1e200), 'positions: expected numbers below 1e+100, got 1e+200'
    ),
    'huge rotations': (
        (STAMPS, POSITIONS, ROTATIONS * 1e200),
        'rotations: expected numbers below 1e+100, got 1e+200',
    ),
    'words': ((['a'] * 20, POSITIONS), 'stamps: expected integers, nanoseconds, got <U1'),
    'ragged lists': (
        (STAMPS[:2], [[1, 2, 3], [4, 5]]),
        'positions: expected shape (2, 3), got rows of different lengths',
    ),
    'objects': (
        (STAMPS, POSITIONS.astype(object)), 'positions: expected float64, got object'
    ),
    'complex numbers': (
        (STAMPS, POSITIONS.astype(complex)), 'positions: expected float64, got complex128'
    ),
    'NaN': (
        (STAMPS, with_nan(POSITIONS)),
        'positions: expected finite numbers, got NaN or infinity in 1 of 20 rows, first in row 3; '
        'drop these rows from all columns',
    ),
    'NaN in a rotation': (
        (STAMPS, POSITIONS, with_nan(ROTATIONS)), 'rotations: expected finite numbers, got NaN'
    ),
    'zero quaternions': (
        (STAMPS, POSITIONS, 0 * ROTATIONS),
        'rotations: expected unit quaternions x y z w, got zero in row 0; leave rotations out '
        'where they are unknown',
    ),
    'unsorted': (
        (STAMPS[::-1], POSITIONS),
        'stamps: expected in increasing order, got 1403636580800000000 after 1403636580900000000 '
        'in row 1; sort all columns by stamp first',
    ),
}  # fmt: skip


@pytest.mark.parametrize('case', WRONG)
def test_what_is_wrong_with_columns_is_said_with_what_was_expected(case):
    given, message = WRONG[case]
    with pytest.raises(vio.InputError) as caught:
        vio.trajectory(*given)
    assert str(caught.value).startswith(message)
    assert isinstance(caught.value, ValueError)
    with pytest.raises(vio.InputError) as caught:
        vio.evaluate(given, (STAMPS, POSITIONS))
    assert str(caught.value).startswith(f'estimate: {message}')


def test_lists_are_taken_as_arrays():
    lists = vio.trajectory(STAMPS.tolist(), POSITIONS.tolist(), ROTATIONS.tolist())
    assert lists.stamps_ns.dtype == np.int64
    assert np.array_equal(lists.positions, POSITIONS)


def test_what_is_computed_later_does_not_change_with_the_arrays_given():
    positions = POSITIONS.copy()
    source = vio.trajectory(STAMPS, positions)
    positions[:] = 0
    assert np.array_equal(source.positions, POSITIONS)


def test_the_layout_in_memory_changes_no_bit():
    source = vio.trajectory(STAMPS, np.asfortranarray(POSITIONS), np.asfortranarray(ROTATIONS))
    assert source.positions.flags.c_contiguous
    assert source.rotations.flags.c_contiguous


def test_equal_stamps_are_counted_as_in_files():
    stamps = STAMPS.copy()
    stamps[7] = stamps[6]
    result = vio.evaluate((stamps, POSITIONS), (STAMPS, POSITIONS))
    assert 'estimate: dropped 1 duplicate' in result.warnings


def test_stamps_of_which_each_is_there_twice_are_still_nanoseconds():
    stamps = np.repeat(STAMPS[::2], 2)
    result = vio.evaluate((stamps, POSITIONS), (STAMPS, POSITIONS))
    assert 'estimate: dropped 10 duplicate' in result.warnings


def table(**columns) -> pd.DataFrame:
    return pd.DataFrame(dict(zip('xyz', POSITIONS.T, strict=True)) | columns, index=STAMPS / 1e9)


WRONG_TABLES = {
    'row numbers': (
        lambda: table().reset_index(drop=True),
        'index: expected nanoseconds, got 0 to 19, 1 apart: another unit or row numbers?',
    ),
    'float nanoseconds': (
        lambda: table().set_index(STAMPS.astype(float)),
        'index: expected seconds as floats, got 1.403636579e+18; give nanoseconds as integers',
    ),
    'no columns': (
        lambda: table().rename(columns={'x': 'p_x'}),
        'expected a DataFrame with columns x y z qx qy qz qw (or x y z), got p_x y z',
    ),
    'half a quaternion': (
        lambda: table(qx=0.0, qw=1.0), 'expected a DataFrame with columns x y z qx qy qz qw'
    ),
    'NaN seconds': (
        lambda: table().set_index(np.full(20, math.nan)), 'index: expected finite seconds, got NaN'
    ),
    'NaN': (
        lambda: table(x=math.nan),
        'positions: expected finite numbers, got NaN or infinity in 20 of 20 rows',
    ),
    'unsorted': (lambda: table().iloc[::-1], 'index: expected in increasing order, got'),
    'no rows': (lambda: table().iloc[:0], 'index: expected shape (N,) with N >= 1, got (0,)'),
    'a word': (
        lambda: table(y='a'), 'positions: expected float64, got object'
    ),
    'no date': (
        lambda: table().set_index(pd.DatetimeIndex([*pd.to_datetime(STAMPS[:19]), pd.NaT])),
        'index: expected dates, got NaT in row 19',
    ),
    'durations': (
        lambda: table().set_index(pd.to_timedelta(STAMPS)),
        'index: expected dates, float seconds or integer nanoseconds, got timedelta64[ns]',
    ),
    'nothing in a column of its own type': (
        lambda: table().convert_dtypes().mask(table() == POSITIONS[3, 1]),
        'positions: expected finite numbers, got NaN or infinity in 1 of 20 rows, first in row 3',
    ),
}  # fmt: skip


@pytest.mark.parametrize('case', WRONG_TABLES)
def test_what_is_wrong_with_a_table_is_said_with_what_was_expected(case):
    make, message = WRONG_TABLES[case]
    with pytest.raises(vio.InputError) as caught:
        vio.evaluate((STAMPS, POSITIONS), make())
    assert str(caught.value).startswith(f'ground_truth: {message}')


@pytest.mark.parametrize(
    'make',
    [
        lambda: table().convert_dtypes(),
        lambda: table().astype('Float64'),
        lambda: table().set_index(pd.to_datetime(STAMPS).tz_localize('UTC')),
        lambda: table().set_index(
            pd.to_datetime(STAMPS).tz_localize('UTC').tz_convert('Asia/Tokyo')
        ),
        lambda: table().set_index(pd.Index(STAMPS, dtype='Int64')),
    ],
)
def test_types_of_pandas_and_time_zones_are_taken(make):
    result = vio.evaluate(make(), (STAMPS, POSITIONS), alignment='none')
    assert result.metrics['ate_trans_max_m'] == 0
    assert len(result.errors()) == 20


def test_what_is_no_trajectory_is_said_to_be_none():
    with pytest.raises(vio.InputError, match=r'estimate: expected .* got ndarray of shape \(20'):
        vio.evaluate(POSITIONS, (STAMPS, POSITIONS))
    with pytest.raises(vio.InputError, match=r'ground_truth: expected .* got int'):
        vio.evaluate((STAMPS, POSITIONS), 3)


def test_wrong_options_and_files_are_our_errors(tmp_path):
    both = (STAMPS, POSITIONS), (STAMPS, POSITIONS)
    with pytest.raises(vio.ConfigError, match="unknown option 'alignement'; did you mean 'align"):
        vio.evaluate(*both, alignement='se3')
    with pytest.raises(vio.ConfigError, match='config: give an EvaluationConfig alone'):
        vio.evaluate(*both, config=vio.EvaluationConfig(), alignment='se3')
    with pytest.raises(vio.ConfigError, match="no metric 'ate_rmse'"):
        vio.evaluate(*both, gates=['ate_rmse<=1'])
    with pytest.raises(vio.ConfigError, match='give a recording, or both an estimate and'):
        vio.evaluate(both[0])
    with pytest.raises(vio.ReadError):
        vio.evaluate(tmp_path / 'none.txt', both[1])
    with pytest.raises(vio.NoPairs):
        vio.evaluate((STAMPS + 10**6 * SECOND, POSITIONS), both[1])
    config = vio.EvaluationConfig(alignment='none')
    assert vio.evaluate(*both, config=config).config is config


def test_options_may_be_numbers_and_arrays_of_numpy():
    config = vio.EvaluationConfig(
        alignment=np.str_('sim3'),
        max_difference_s=np.float32(0.5),
        rpe_deltas=np.array(['1f', '2s']),
        segment_lengths_m=np.int64(10),
        estimate_to_body=np.array([0, 0, 0, 0, 0, 0, 1]),
    )
    assert config == vio.EvaluationConfig(
        alignment='sim3', max_difference_s=0.5, rpe_deltas=['1f', '2s'], segment_lengths_m=[10]
    )
    with pytest.raises(vio.ConfigError, match="max_difference_s: 'True' is not a finite number"):
        vio.EvaluationConfig(max_difference_s=np.True_)
    with pytest.raises(vio.ConfigError, match='rpe_deltas: a set is not a list'):
        vio.EvaluationConfig(rpe_deltas={'1f'})


@pytest.mark.parametrize(
    'gates',
    [
        'coverage_ratio>=0.9',
        vio.Gate.parse('coverage_ratio>=0.9'),
        (text for text in ['coverage_ratio>=0.9']),
    ],
)
def test_one_gate_needs_no_list(gates):
    both = (STAMPS, POSITIONS), (STAMPS, POSITIONS)
    assert vio.evaluate(*both, gates=gates).passed


@pytest.mark.parametrize(
    ('gates', 'problem'),
    [
        (None, 'gates: expected a list, got NoneType'),
        ({'pairs': {'max': 1}}, 'gates: expected a list, got dict'),
        ([5], "gates: expected texts such as 'ate_trans_rmse_m<=0.1', got int"),
        ([vio.Gate('pairs', '<', 1)], "gate pairs: expected '<=' or '>='"),
        ([vio.Gate('pairs', '<=', 'a')], "gate pairs: 'a' is not a finite number"),
    ],
)
def test_what_is_no_gate_is_said(gates, problem):
    with pytest.raises(vio.ConfigError) as caught:
        vio.evaluate((STAMPS, POSITIONS), (STAMPS, POSITIONS), gates=gates)
    assert str(caught.value).startswith(problem)


@pytest.mark.parametrize(
    ('call_wrongly', 'problem'),
    [
        (lambda: vio.evaluate(recording=5), 'recording: expected a path, got int'),
        (lambda: vio.evaluate(recording=''), "recording: expected a path, got ''"),
        (lambda: vio.evaluate('', recording=FLIGHT), "'': expected a topic or a file"),
        (lambda: vio.evaluate('a\0b', (STAMPS, POSITIONS)), 'a\0b: embedded null'),
        (lambda: vio.evaluate('x' * 5000, (STAMPS, POSITIONS)), 'xxx'),
        (lambda: vio.read(None), 'spec: expected a source spec or a path, got NoneType'),
        (lambda: vio.read('x.txt', times=5), 'times: expected a path, got int'),
        (lambda: vio.inspect(None), 'recording: expected a path, got NoneType'),
        (lambda: vio.inspect('x' * 5000), 'xxx'),
        (lambda: vio.inspect(FLIGHT, 'none.yaml'), 'none.yaml: No such file'),
        (lambda: vio.inspect(FLIGHT, [5]), 'calibrations: expected a path, got int'),
        (lambda: vio.inspect(FLIGHT, expectations={}), 'expectations: expected a path, got dict'),
        (lambda: vio.inspect(FLIGHT, profile=None), "profile: 'None' is not one of"),
        (lambda: vio.inspect(FLIGHT, limits=[1]), 'limits: expected a mapping of names to'),
        (lambda: vio.imu_noise(FLIGHT / 'none', topic='/imu0'), f'{FLIGHT}/none: '),
        (lambda: vio.imu_noise(5), 'recording: expected a path, got int'),
        (lambda: vio.diagnose(recording=FLIGHT, imu=5), 'imu: expected a source spec or a path'),
        (lambda: vio.diagnose(recording=FLIGHT, imu=Path('no.csv')), 'no.csv: No such file'),
    ],
)
def test_what_is_no_path_is_our_error(call_wrongly, problem):
    with pytest.raises(vio.VioEvalError) as caught:
        call_wrongly()
    assert str(caught.value).startswith(problem)
    assert '\n' not in str(caught.value)


@pytest.fixture(scope='module')
def faulty(tmp_path_factory) -> Path:
    """Return a recording with an estimate that is late and too large, and an IMU."""
    path = tmp_path_factory.mktemp('faulty') / 'run.mcap'
    done = call('simulate', path, '--fault', 'time_offset=0.03', '--fault', 'scale=1.08')
    assert done.returncode == 0, transcript(done)
    return path


@pytest.mark.slow
def test_a_diagnosis_is_that_of_the_command_line(faulty):
    found = vio.diagnose(recording=faulty, imu='/imu0')
    assert repr(found) == '<Diagnosis: time_offset, scale>'
    assert found.to_json() == call('diagnose', faulty, '--imu', '/imu0', '--json').stdout
    assert found._repr_html_().startswith('<pre>1. time_offset  (confidence')
    healthy = vio.diagnose(recording=faulty, limits={'scale_percent': 20})
    assert [cause.name for cause in healthy.causes] == ['time_offset']
    assert vio.diagnose(recording=faulty, profile='car').to_dict()['profile'] == 'car'


@pytest.mark.slow
def test_an_inspection_is_that_of_the_command_line(faulty):
    found = vio.inspect(faulty)
    assert repr(found).startswith(f'<Inspection {faulty}: 3 streams, ')
    assert found.to_json() == call('inspect', faulty, '--json').stdout
    assert '/imu0' in found._repr_html_()
    expectations = faulty.parent / 'expectations.yaml'
    expectations.write_text('streams: {imu0: {topic: /imu0, rate_hz: 100}}')
    unmet = vio.inspect(faulty, expectations=expectations).expectations
    words = {(one.topic, one.check): one.word for one in unmet}
    assert words['/imu0', 'rate_hz'] == 'fail'


@pytest.mark.slow
def test_the_noise_of_an_imu_is_that_of_the_command_line(tmp_path):
    path = tmp_path / 'still.mcap'
    assert call('simulate', path, '--still', '--duration-s', '600').returncode == 0
    found = vio.imu_noise(path, profile='car')
    assert found.to_json() == call('imu_noise', path, '--profile', 'car', '--json').stdout
    assert re.fullmatch(
        r'<ImuNoise \S+:/imu0: 600 s, 0.0001[67]\d* rad/s/sqrt\(Hz\), '
        r'0.00[12]\d* m/s2/sqrt\(Hz\)>',
        repr(found),
    )
    assert 'white noise density' in found._repr_html_()


@pytest.mark.slow
def test_limits_are_those_of_the_verb(faulty):
    with pytest.raises(vio.ConfigError, match="no limit 'scale_percnt' here; did you mean"):
        vio.diagnose(recording=faulty, limits={'scale_percnt': 1})
    with pytest.raises(vio.ConfigError, match='expected DiagnosisLimits, got InspectionLimits'):
        vio.diagnose(recording=faulty, limits=vio.inspect(faulty).inspection.limits)
    with pytest.raises(vio.ConfigError, match="profile: 'boat' is not one of drone, car"):
        vio.inspect(faulty, profile='boat')


def test_the_face_has_all_that_it_promises():
    assert all(getattr(vio, name) is not None for name in vio.__all__)
    assert set(vio.__all__) <= set(dir(vio))
    with pytest.raises(AttributeError, match='no attribute'):
        vio.evalute  # noqa: B018


def test_command_lines_start_without_the_face():
    code = 'import sys, vio_eval_ros; sys.exit("numpy" in sys.modules)'
    assert subprocess.run([sys.executable, '-c', code]).returncode == 0


def test_a_recording_or_times_that_nothing_uses_is_an_error():
    both = (STAMPS, POSITIONS), (STAMPS, POSITIONS)
    with pytest.raises(vio.ConfigError, match=r'recording: none\.bag is not used'):
        vio.evaluate(*both, recording='none.bag')
    with pytest.raises(vio.ConfigError, match='these times are not used'):
        vio.evaluate(*both, times='times.txt')
    with pytest.raises(vio.ReadError, match='no such file; for a topic, give recording='):
        vio.evaluate('/vio/odometry', both[1])


def test_a_source_made_by_hand_is_checked():
    poses = vio.trajectory(STAMPS, POSITIONS).poses
    short = dataclasses.replace(poses, stamps_ns=STAMPS[:5])
    for wrong, message in (
        (POSITIONS, r'estimate: poses: expected Poses, got ndarray of shape \(20, 3\)'),
        (short, r'estimate: positions: expected shape \(5, 3\), got \(20, 3\)'),
    ):
        with pytest.raises(vio.InputError, match=message):
            vio.evaluate(vio.Source('mine', 'tum', (), wrong), (STAMPS, POSITIONS))


def test_a_run_that_is_over_at_once_may_have_another_unit():
    microseconds = STAMPS // 10**5 * 1000  # at 10 Hz: 1 ms apart if they were nanoseconds
    result = vio.evaluate((microseconds, POSITIONS), (microseconds, POSITIONS))
    warning = 'arrays: all stamps within 0.019 s; are they nanoseconds?'
    assert warning in result.warnings


def test_a_diagnosis_of_arrays_gives_no_convention_to_append_to_a_file():
    estimate, truth = (
        vio.read(topic, FLIGHT) for topic in ('/vio/odometry', '/ground_truth/pose')
    )
    w_first = vio.trajectory(
        estimate.stamps_ns, estimate.positions, np.roll(estimate.rotations, 1, axis=1)
    )
    cause = vio.diagnose(w_first, truth).causes[0]
    assert cause.name == 'quaternion_order'
    assert cause.flags == ()


def test_every_number_of_a_comparison_is_that_of_the_system_alone():
    estimate, truth = (
        vio.read(f'{FLIGHT}:{topic}') for topic in ('/vio/odometry', '/ground_truth/pose')
    )
    half = tuple(column[::2] for column in columns(estimate))
    found = vio.compare({'all': f'{FLIGHT}:/vio/odometry', 'half': half}, truth, gates=GATE)
    for name, one in (('all', estimate), ('half', half)):
        alone = vio.evaluate(one, truth, gates=GATE)
        assert found.results[name].metrics == pytest.approx(alone.metrics, rel=0, nan_ok=True)
        row = found.to_dataframe().loc[name]
        assert row.to_dict() == {metric: alone.metrics[metric] for metric in found.chosen}
    assert found.passed
    assert found.results['half'].plot() is not None
    assert json.loads(found.to_json())['schema'] == 'vio_eval_ros.comparison/1'
    assert 'half' in found._repr_html_()
    assert 'half' in found.to_latex()


def test_a_system_that_cannot_be_scored_is_named_and_the_others_are_compared():
    found = vio.compare({'good': '/vio/odometry', 'bad': 'nix.txt'}, recording=FLIGHT)
    assert list(found.results) == ['good']
    assert 'nix.txt' in found.unscored['bad']
    assert not found.passed
    assert repr(found) == '<Comparison of 2 systems: good, bad, 1 could not be scored>'


@pytest.mark.parametrize(
    ('estimates', 'options', 'problem'),
    [
        ({}, {}, 'estimates: give a mapping'),
        (['a.txt'], {}, 'estimates: give a mapping'),
        ({'a': 'nix', 'b': 'nothing'}, {}, 'no system could be scored: a: '),
        ({'a': 3}, {}, 'a: expected a source spec'),
        ({'a': '/vio/odometry'}, {'metrics': 'ate'}, "no metric 'ate'"),
        ({'a': '/vio/odometry'}, {'metrics': ['sim3_scale'] * 2}, 'given twice'),
        ({'a': '/vio/odometry'}, {'ground_truth': '/nowhere'}, 'there is no such topic'),
    ],
)
def test_what_cannot_be_compared_is_refused(estimates, options, problem):
    with pytest.raises(vio.VioEvalError, match=re.escape(problem)):
        vio.compare(estimates, recording=FLIGHT, **options)
