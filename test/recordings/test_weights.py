"""What the ground truth's own covariances weigh where its spec asks for it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recorded import build, fixes, header, LATENCY_NS, numbers, odometry, stamp, Stream, write
from verbs import call, complaint, document
from vio_eval_ros import compare, evaluate, read
from vio_eval_ros.core import rotation
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.agreement.orders import alone
from vio_eval_ros.recordings.messages import collect

COUNT = 400
WEIGHTS = 'weights=covariance'
POOR = 0.3
#: standard deviations of good and poor positions: a hundred times the covariance
GOOD_M, POOR_M = 0.05, 0.5
FIX = 'sensor_msgs/msg/NavSatFix'


def deviations(seed: int = 0, count: int = COUNT) -> np.ndarray:
    """Return (N,) standard deviations, 30 % of them in stretches ten times as large."""
    stretches = np.random.default_rng(seed).uniform(size=-(-count // 20)) < POOR
    return np.where(np.repeat(stretches, 20)[:count], POOR_M, GOOD_M)


def noisy_fixes(stds: np.ndarray, seed: int = 0, kinds: Sequence[int] = (2,)) -> Stream:
    """Return fixes with errors of these standard deviations, which their covariances tell."""
    rng = np.random.default_rng(seed)
    stream, messages = fixes(len(stds)), []
    for k, (fix, std) in enumerate(zip(stream.messages, stds.tolist(), strict=True)):
        east, north, up = rng.normal(0, std, 3)
        messages.append(
            dict(fix)
            | {
                'longitude': fix['longitude'] + east / 75_400,
                'latitude': fix['latitude'] + north / 111_200,
                'altitude': fix['altitude'] + up,
                'position_covariance': np.diag([std**2] * 3).ravel().tolist(),
                'position_covariance_type': kinds[k % len(kinds)],
            }
        )
    return stream._replace(messages=messages)


def recorded(path: Path, truth: Stream, kind: str = 'mcap') -> Path:
    return write(path / 'run', kind, odometry(COUNT), truth)


def replayed(path: Path, truth: str, *options: Any) -> dict[str, Any]:
    return document('replay', path, *inputs(truth), *options)


def inputs(truth: str = f'/fix?{WEIGHTS}', estimate: str = '/vio/odometry') -> list[str]:
    return ['--estimate', estimate, '--ground-truth', truth]


def turned_rad(found: dict[str, Any]) -> float:
    """Return by how much an alignment turns what lies as it should."""
    return float(rotation.angle(np.array(found['alignment']['rotation_xyzw'])))


@pytest.mark.parametrize('kind', ['ros1', 'sqlite', 'mcap'])
@pytest.mark.parametrize('alignment', ['posyaw', 'se3', 'sim3'])
def test_poor_fixes_turn_the_alignment_less(tmp_path, kind, alignment):
    path = recorded(tmp_path, noisy_fixes(deviations()), kind)
    plain, weighted = (
        replayed(path, truth, '--alignment', alignment) for truth in ('/fix', f'/fix?{WEIGHTS}')
    )
    assert turned_rad(weighted) < 0.8 * turned_rad(plain)
    assert weighted['inputs']['ground_truth']['source'] == f'/fix?{WEIGHTS}'
    assert (plain['alignment']['weights'], weighted['alignment']['weights']) == (
        None,
        'covariance',
    )
    assert weighted['warnings'][0] == (
        f'/fix?{WEIGHTS}: the alignment is fitted with weights, the inverse variances of true '
        'positions (standard deviations 0.05 to 0.5 m); errors are not weighted'
    )
    # of all alignments the unweighted one has the smallest unweighted error
    rmse = [found['metrics']['ate_trans_rmse_m'] for found in (plain, weighted)]
    assert rmse[0] < rmse[1] < 1.02 * rmse[0]


def test_over_many_runs_the_weighted_alignment_is_nearer_to_the_true_one(tmp_path):
    turned = []
    for seed in range(12):
        folder = tmp_path / str(seed)
        folder.mkdir()
        path = recorded(folder, noisy_fixes(deviations(seed), seed))
        sides = [evaluate(recording=path, estimate='/vio/odometry', ground_truth=truth)
                 for truth in ('/fix', f'/fix?{WEIGHTS}')]  # fmt: skip
        turned.append([rotation.angle(one.summary.alignment.rotation) for one in sides])
    plain, weighted = np.sqrt(np.mean(np.square(turned), axis=0))
    assert weighted < 0.5 * plain


def test_without_being_asked_covariances_change_nothing(tmp_path):
    with_them, without = tmp_path / 'with', tmp_path / 'without'
    stream = noisy_fixes(deviations())
    bare = [{**m, 'position_covariance': None} for m in stream.messages]
    found = []
    for folder, each in ((with_them, stream), (without, stream._replace(messages=bare))):
        folder.mkdir()
        found.append(replayed(recorded(folder, each), '/fix'))
    assert found[0]['metrics'] == found[1]['metrics']
    assert found[0]['alignment'] == found[1]['alignment']


@pytest.mark.parametrize('association', ['nearest', 'interpolate'])
@pytest.mark.parametrize('options', [(), ('--align-first-s', '8'), ('--start-s', '2')])
def test_the_series_ends_with_the_result(tmp_path, association, options):
    path = recorded(tmp_path, noisy_fixes(deviations()))
    series = tmp_path / 'series.csv'
    found = replayed(
        path, f'/fix?{WEIGHTS}', '--association', association, *options, '--series',
        f'csv:{series}',
    )  # fmt: skip
    names, *_, last = (line.split(',') for line in series.read_text().splitlines())
    row = dict(zip(names, last, strict=True))
    for name in ('ate_trans_rmse_m', 'ate_sim3_trans_rmse_m', 'sim3_scale'):
        assert float(row[name]) == pytest.approx(found['metrics'][name], rel=1e-9)
    plain = replayed(path, '/fix', '--association', association, *options)
    assert plain['metrics']['sim3_scale'] != found['metrics']['sim3_scale']


def test_unusable_covariances_are_counted_and_left_out(tmp_path):
    stream = noisy_fixes(np.full(COUNT, GOOD_M))
    unusable = {
        1: [0.0] * 9,
        2: [-1.0, *[0.0] * 8],
        3: [float('nan'), *[1.0] * 8],
        4: [1e-3, 0, 0, 0, -1e-3, 0, 0, 0, 1e-3],
    }
    off_m = 50.0
    messages = [dict(message) for message in stream.messages]
    for k, cells in unusable.items():
        messages[k]['position_covariance'] = cells
    for message in messages[300:]:  # what is left out is not in the fit
        message['latitude'] += off_m / 111_200
        message['position_covariance_type'] = 0
    found = replayed(recorded(tmp_path, stream._replace(messages=messages)), f'/fix?{WEIGHTS}')
    assert f'; 104 of {COUNT} poses, whose covariance is zero, ' in found['warnings'][0]
    assert '; all are equal, so that they change nothing;' in found['warnings'][0]
    assert turned_rad(found) < 0.02
    assert found['metrics']['ate_trans_median_m'] < 3 * GOOD_M
    assert found['metrics']['ate_trans_max_m'] == pytest.approx(off_m, rel=0.02)


@pytest.mark.parametrize('kinds', [(0,), (2,)])
def test_where_none_is_usable_it_is_refused(tmp_path, kinds):
    stream = noisy_fixes(np.zeros(COUNT) + (GOOD_M if kinds == (0,) else 0.0), kinds=kinds)
    told = complaint('replay', recorded(tmp_path, stream), *inputs())
    assert told == (
        f'replay: /fix?{WEIGHTS}: no position has a covariance that weights could follow from '
        '(there is none, or each is zero, negative, not a number or of unknown type); leave '
        f'{WEIGHTS} out\n'
    )


@pytest.mark.parametrize(
    ('alignment', 'why'), [('none', 'fits nothing'), ('origin', 'takes the first pair alone')]
)
@pytest.mark.parametrize('verb', ['replay', 'diagnose'])
def test_an_alignment_that_they_cannot_change_is_refused(tmp_path, verb, alignment, why):
    path = recorded(tmp_path, noisy_fixes(deviations()))
    assert complaint(verb, path, *inputs(), '--alignment', alignment) == (
        f'{verb}: /fix?{WEIGHTS}: weights change nothing under alignment {alignment}, which '
        f'{why}; leave them out, or write --alignment se3\n'
    )


@pytest.mark.parametrize('verb', ['replay', 'diagnose'])
def test_the_estimate_has_no_weights(tmp_path, verb):
    path = recorded(tmp_path, noisy_fixes(deviations()))
    estimate = f'/vio/odometry?{WEIGHTS}'
    for truth in ('/fix', f'/fix?{WEIGHTS}'):
        assert complaint(verb, path, *inputs(truth, estimate)) == (
            f'{verb}: {estimate}: weights are those of the ground truth; leave them out here, and '
            f'write --ground-truth /fix?{WEIGHTS}\n'
        )


def test_what_weights_nothing_refuses_them(tmp_path):
    path = recorded(tmp_path, noisy_fixes(deviations()))
    spec = f'{path}:/fix?{WEIGHTS}'
    told = f'{spec}: {WEIGHTS} is for the ground truth of replay, score, diagnose and'
    assert told in complaint('info', spec)
    assert told in complaint('convert', spec, tmp_path / 'out.txt')
    with pytest.raises(ConfigError, match='leave it out here'):
        alone(read(spec))
    assert 'weights must be covariance' in complaint('replay', path, *inputs('/fix?weights=yes'))


def test_weights_and_inverted_poses_do_not_go_together(tmp_path):
    path = recorded(tmp_path, odometry_with(deviations()))
    for invert in ('pose', 'rotation'):
        told = complaint('replay', path, *inputs(f'/truth?{WEIGHTS}&invert={invert}'))
        assert 'what is inverted has none' in told


def odometry_with(stds: np.ndarray, topic: str = '/truth', seed: int = 0) -> Stream:
    """Return noisy odometry whose covariances tell the noise."""
    rng = np.random.default_rng(seed)
    messages = []
    for k, std in enumerate(stds.tolist()):
        position, turn = numbers(k)
        x, y, z = (position + rng.normal(0, std, 3)).tolist()
        qx, qy, qz, qw = turn.tolist()
        pose = {
            'position': {'x': x, 'y': y, 'z': z},
            'orientation': {'x': qx, 'y': qy, 'z': qz, 'w': qw},
        }
        covariance = np.diag([std**2] * 3 + [1e-4] * 3).ravel().tolist()
        messages.append({'header': header(k), 'pose': {'pose': pose, 'covariance': covariance}})
    return Stream(topic, 'nav_msgs/msg/Odometry', messages)


def as_text(form: str, stds: np.ndarray, unit: float = 1.0) -> str:
    """Return the same noisy truth in a text file with columns of covariances."""
    rows = []
    for k, message in enumerate(odometry_with(stds).messages):
        position = [unit * value for value in message['pose']['pose']['position'].values()]
        turn = list(message['pose']['pose']['orientation'].values())
        variance = float(unit * stds[k]) ** 2
        upper = [variance, 0.0, 0.0, variance, 0.0, variance]
        cells = {
            'ov_eval': [*position, *turn, *[1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6], *upper],
            'positions': [*position, *upper],
            'echo': [*position, *turn, *message['pose']['covariance']],
        }[form]
        rows.append([f'{stamp(k) / 1e9:.9f}', *map(repr, cells)])
    name = {
        'ov_eval': '# timestamp(s) tx ty tz qx qy qz qw Pr11 Pr12 Pr13 Pr22 Pr23 Pr33 '
        'Pt11 Pt12 Pt13 Pt22 Pt23 Pt33',
        'positions': '# timestamp tx ty tz Pt11 Pt12 Pt13 Pt22 Pt23 Pt33',
        'echo': '# t x y z qx qy qz qw ' + ' '.join(f'covariance_{k}' for k in range(36)),
    }[form]
    return '\n'.join([name, *map(' '.join, rows)]) + '\n'


@pytest.mark.parametrize('form', ['ov_eval', 'positions', 'echo'])
def test_a_text_file_weighs_as_the_message_does(tmp_path, form):
    stds = deviations()
    path = recorded(tmp_path, odometry_with(stds))
    expected = replayed(path, f'/truth?{WEIGHTS}')
    file = tmp_path / 'truth.txt'
    file.write_text(as_text(form, stds))
    found = replayed(path, f'{file}?{WEIGHTS}')
    assert turned_rad(found) == pytest.approx(turned_rad(expected), rel=1e-6)
    for name in ('ate_trans_rmse_m', 'ate_sim3_trans_rmse_m', 'sim3_scale'):
        assert found['metrics'][name] == pytest.approx(expected['metrics'][name], rel=1e-6)
    assert 'standard deviations 0.05 to 0.5 m' in found['warnings'][0]
    plain = replayed(path, f'{file}')
    assert plain['alignment']['weights'] is None
    assert plain['metrics']['sim3_scale'] != found['metrics']['sim3_scale']


def test_a_unit_scales_the_covariances_too(tmp_path):
    stds = deviations()
    path = recorded(tmp_path, odometry_with(stds))
    file = tmp_path / 'truth.txt'
    file.write_text(as_text('ov_eval', stds, unit=1000.0))
    found = replayed(path, f'{file}?unit=mm&{WEIGHTS}')
    assert 'standard deviations 0.05 to 0.5 m' in found['warnings'][0]
    expected = replayed(path, f'/truth?{WEIGHTS}')['metrics']
    assert found['metrics']['sim3_scale'] == pytest.approx(expected['sim3_scale'], rel=1e-6)


def test_a_fix_that_was_echoed_weighs_as_the_message_does(tmp_path):
    stream = noisy_fixes(deviations())
    path = recorded(tmp_path, stream)
    names = ['latitude', 'longitude', 'altitude']
    rows = [
        ','.join(
            [
                str(stamp(k)),
                *(repr(float(m[name])) for name in names),
                *map(repr, m['position_covariance']),
            ]
        )
        for k, m in enumerate(stream.messages)
    ]
    cells = (f'field.position_covariance{k}' for k in range(9))
    title = ','.join(['%time', *(f'field.{name}' for name in names), *cells])
    file = tmp_path / 'fix.csv'
    file.write_text('\n'.join([title, *rows]) + '\n')
    found, expected = replayed(path, f'{file}?{WEIGHTS}'), replayed(path, f'/fix?{WEIGHTS}')
    assert turned_rad(found) == pytest.approx(turned_rad(expected), rel=1e-5)
    assert turned_rad(found) < 0.8 * turned_rad(replayed(path, f'{file}'))


def test_truth_of_another_rate_is_interpolated_with_its_variance(tmp_path):
    stds = deviations(2)
    stream = noisy_fixes(stds, 2)
    sparse = stream._replace(
        messages=list(stream.messages)[::4],
        logged_ns=[stamp(k) + LATENCY_NS for k in range(0, COUNT, 4)],
    )
    path = recorded(tmp_path, sparse)
    options = ('--association', 'interpolate')
    found = replayed(path, f'/fix?{WEIGHTS}', *options)
    assert found['association']['pairs'] == COUNT // 4
    assert turned_rad(found) < turned_rad(replayed(path, '/fix', *options))


def test_a_suite_weighs_where_its_truth_says_so(tmp_path):
    path = recorded(tmp_path, noisy_fixes(deviations()))
    (tmp_path / 'suite.yaml').write_text(
        f'sequences:\n- name: drive\n  recording: {path.name}\n  estimate: /vio/odometry\n'
        f'  ground_truth: /fix?{WEIGHTS}\n'
    )
    done = call('score', tmp_path / 'suite.yaml', '--json')
    assert 'the alignment is fitted with weights' in done.stdout, done.stderr


def test_systems_are_compared_under_the_same_weights(tmp_path):
    path = recorded(tmp_path, noisy_fixes(deviations()))
    truth = read(f'{path}:/fix?{WEIGHTS}')
    estimate = read(f'{path}:/vio/odometry')
    found = compare({'a': estimate, 'b': replace(estimate, spec='b')}, truth)
    own = evaluate(estimate, truth).summary.metrics
    assert found.results['a'].summary.metrics == pytest.approx(own, rel=1e-12, nan_ok=True)
    assert found.results['a'].summary.pairs.ground_truth.weights is not None


def test_a_diagnosis_has_the_ate_of_the_result(tmp_path):
    stds = np.full(COUNT, GOOD_M)
    stds[::4] = POOR_M
    late = odometry(COUNT)
    messages = [
        {**m, 'header': header(k + 3, 'odom')} for k, m in enumerate(late.messages)
    ]  # 150 ms
    path = write(tmp_path / 'run', 'mcap', late._replace(messages=messages), odometry_with(stds))
    result = replayed(path, f'/truth?{WEIGHTS}')
    found = document('diagnose', path, *inputs(f'/truth?{WEIGHTS}'))
    plain = document('diagnose', path, *inputs('/truth'))
    ates = [
        one['ate_before_m'] for each in (found, plain) for one in each['causes']
        if one['name'] == 'time_offset'
    ]  # fmt: skip
    assert ates[0] == pytest.approx(result['metrics']['ate_trans_rmse_m'], rel=1e-9)
    assert ates[0] != ates[1]


def test_weights_of_arrays_come_with_their_source(tmp_path):
    path = recorded(tmp_path, odometry_with(deviations()))
    truth, estimate = read(f'{path}:/truth'), read(f'{path}:/vio/odometry')
    arrays = (estimate.stamps_ns, estimate.positions, estimate.rotations)
    plain = evaluate(arrays, truth)
    weighted = evaluate(arrays, read(f'{path}:/truth?{WEIGHTS}'))
    assert plain.summary.pairs.ground_truth.weights is None
    assert weighted.summary.pairs.ground_truth.weights is not None
    with pytest.raises(ReadError, match='no position has a covariance'):
        evaluate(arrays, read(f'{path}:/vio/odometry?{WEIGHTS}'))
    with pytest.raises(ConfigError, match=r'write --ground-truth \.\.\.\?weights=covariance'):
        evaluate(read(f'{path}:/truth?{WEIGHTS}'), arrays)


def test_a_live_fix_has_the_covariance_of_the_recorded_one(tmp_path):
    from rosbags.typesys import get_typestore, Stores

    stream = noisy_fixes(deviations()[:40], kinds=(2, 1, 3, 0))
    types = get_typestore(Stores.ROS2_JAZZY)
    live = collect(FIX, [build(types, FIX, message) for message in stream.messages])
    read_ = read(f'{recorded(tmp_path, stream)}:/fix').poses
    np.testing.assert_array_equal(live.covariances, read_.covariances)
    known = np.isfinite(live.covariances[:, 0]).all(axis=(1, 2))
    assert known.tolist() == [k % 4 != 3 for k in range(40)]
    assert np.isnan(live.covariances[:, 1]).all()


def test_fixes_as_an_estimate_are_as_consistent_as_their_covariances_say(tmp_path):
    path = recorded(tmp_path, noisy_fixes(deviations()))
    found = document('replay', path, *inputs('/vio/odometry', '/fix'))
    assert found['metrics']['nees_position_mean'] == pytest.approx(3, rel=0.15)
    assert found['metrics']['nees_orientation_mean'] is None
    assert not [line for line in found['warnings'] if 'nees' in line]
