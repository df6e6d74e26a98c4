"""`diagnose` as its users run it: arguments in, output and an exit status out."""

from dataclasses import replace
from functools import partial
import json
from pathlib import Path

import numpy as np
import pytest

import verbs
from verbs import start, transcript
from vio_eval_ros.cli import replay
from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.imu.simulated_noise import EUROC
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import simulate, write_recording
from vio_eval_ros.simulation.faults import inject

ROOT = Path(__file__).resolve().parents[2]
DEMO = ROOT / 'demo' / 'simulated_flight'
diagnose, complaint = (partial(how, 'diagnose') for how in (verbs.call, verbs.complaint))


@pytest.fixture(scope='module')
def flight(tmp_path_factory) -> Path:
    """Return a folder with gt.txt and estimates of it: late.txt, larger.txt, conjugated.txt."""
    folder, run = tmp_path_factory.mktemp('flight'), simulate(duration_s=40.0)
    estimate = run.estimate
    jumped = estimate.positions.copy()
    jumped[400:] += [0.5, 0.5, 0.0]
    estimates = {
        'est': estimate,
        'late': replace(estimate, stamps_ns=estimate.stamps_ns + 80_000_000),
        'larger': replace(estimate, positions=1.3 * estimate.positions),
        'conjugated': replace(estimate, rotations=rotation.conjugate(estimate.rotations)),
        'jumped': replace(estimate, positions=jumped),
        'gt': run.ground_truth,
    }
    for name, poses in estimates.items():
        (folder / f'{name}.txt').write_text(tum(poses))
    q, stamps_ns = run.ground_truth.rotations, run.ground_truth.stamps_ns
    steps = rotation.to_rotation_vector(rotation.multiply(rotation.conjugate(q[:-1]), q[1:]))
    rows = np.column_stack([steps * 200, np.zeros((len(steps), 3))])
    lines = [
        ','.join([str(stamp), *(f'{value:.9f}' for value in row)])
        for stamp, row in zip((stamps_ns[:-1] + 2_500_000).tolist(), rows, strict=True)
    ]
    header = '#timestamp [ns],w_x [rad s^-1],w_y,w_z,a_x [m s^-2],a_y,a_z'
    (folder / 'imu.csv').write_text('\n'.join([header, *lines]) + '\n')
    return folder


def pair(folder: Path, name: str) -> list[str]:
    return ['--estimate', f'{folder}/{name}.txt', '--ground-truth', f'{folder}/gt.txt']


def test_nothing_is_unusual_about_the_demo():
    done = diagnose(DEMO)
    assert done.returncode == 0, transcript(done)
    assert done.stdout.startswith('nothing unusual\n')
    assert start('diagnose', DEMO).stdout == done.stdout  # in an interpreter of its own as well


def test_a_late_estimate_gets_cause_evidence_advice_and_flags(flight):
    done = diagnose(*pair(flight, 'late'))
    assert done.returncode == 0, done.stderr
    first, *rest = done.stdout.splitlines()
    assert first.startswith('1. time_offset  (confidence 100.0 %)')
    text = '\n'.join(rest)
    assert 'its stamps are 80.' in text or 'its stamps are 79.' in text
    assert 'ATE' in text
    assert 'Make both clocks the same' in text
    assert 'replay: --time-offset-s -0.0' in text


def test_a_jump_is_reported_with_its_moment(flight):
    assert '(20.00 s into the run): 0.7' in diagnose(*pair(flight, 'jumped')).stdout


def test_what_to_state_of_a_source_is_shown_where_it_goes(flight):
    done = diagnose(*pair(flight, 'conjugated'))
    assert "append to the spec of the estimate: '?invert=rotation'" in done.stdout


def test_a_statement_advised_is_a_statement_understood(flight):
    done = diagnose(
        '--estimate',
        f'{flight}/conjugated.txt?invert=rotation',
        '--ground-truth',
        f'{flight}/gt.txt',
    )
    assert done.stdout.startswith('nothing unusual')


FLAGGED = {
    'time_offset': (0.08,),
    'scale': (1.2,),
    'sensor_rotation': (40.0,),
    'lever_arm': (0.3,),
    'quaternion_conjugated': (),
    'pose_inverted': (),
    'quaternion_order': (1.0,),
}


@pytest.mark.slow
@pytest.mark.parametrize('name', FLAGGED)
def test_replay_with_the_flags_has_the_errors_of_the_unharmed_run(name, flight, tmp_path, capsys):
    def measured(spec: str, *flags: str) -> dict[str, float]:
        given = ['--estimate', spec, '--ground-truth', f'{flight}/gt.txt', *flags]
        assert replay.main([*given, '--json']) == 0
        return json.loads(capsys.readouterr().out)['metrics']

    clean = measured(f'{flight}/est.txt')
    run = simulate(duration_s=40.0)
    harmed = inject(run, name, FLAGGED[name], np.random.default_rng(0)).estimate
    (tmp_path / 'harmed.txt').write_text(tum(harmed))
    found = diagnose(*pair(flight, 'est')[2:], '--estimate', tmp_path / 'harmed.txt', '--json')
    (cause,) = json.loads(found.stdout)['causes']
    assert cause['name'] == name
    stated = [flag for flag in cause['flags'] if flag.startswith('?')]
    flags = [flag for flag in cause['flags'] if flag not in stated]
    mended = measured(f'{tmp_path}/harmed.txt' + ''.join(stated), *flags)
    # under sim3 the run's own scale goes as well, and a frame's noise is taken with it
    assert mended['ate_sim3_trans_rmse_m'] == pytest.approx(
        clean['ate_sim3_trans_rmse_m'], rel=0.05
    )
    assert mended['ate_trans_rmse_m'] < 1.05 * clean['ate_trans_rmse_m']
    assert mended['rpe_1f_rot_rmse_deg'] < 1.05 * clean['rpe_1f_rot_rmse_deg']


def test_a_tilt_that_the_alignment_does_not_remove_is_reported_with_one_that_does(
    flight, tmp_path, capsys
):
    run = simulate(duration_s=40.0)
    tilted = inject(run, 'gravity_tilt', (5.0,), np.random.default_rng(0)).estimate
    (tmp_path / 'tilted.txt').write_text(tum(tilted))
    files = ['--estimate', f'{tmp_path}/tilted.txt', *pair(flight, 'est')[2:]]
    (cause,) = json.loads(diagnose(*files, '--alignment', 'posyaw', '--json').stdout)['causes']
    assert (cause['name'], cause['flags']) == ('gravity_tilt', ['--alignment', 'se3'])

    def ate_m(*arguments: str) -> float:
        assert replay.main([*arguments, '--json']) == 0
        return json.loads(capsys.readouterr().out)['metrics']['ate_trans_rmse_m']

    assert ate_m(*files, '--alignment', 'posyaw') == pytest.approx(cause['ate_before_m'])
    assert ate_m(*files, *cause['flags']) == pytest.approx(
        ate_m(*pair(flight, 'est'), '--alignment', 'se3'), rel=1e-6
    )
    (cause,) = json.loads(diagnose(*files, '--json').stdout)['causes']  # se3 as it is
    assert (cause['name'], cause['flags']) == ('gravity_tilt', [])


def test_poses_that_cannot_be_used_are_pointed_out(flight, tmp_path):
    poses = (flight / 'est.txt').read_text().splitlines()
    poses[100] = poses[100].replace(poses[100].split()[1], 'nan', 1)
    stray = '4000000000.0' + poses[-1][poses[-1].index(' ') :]
    (tmp_path / 'est.txt').write_text('\n'.join([*poses, stray]) + '\n')
    done = diagnose('--estimate', tmp_path / 'est.txt', *pair(flight, 'est')[2:])
    assert done.returncode == 0, done.stderr
    said, *rest = done.stdout.splitlines()
    assert said == 'nothing unusual, apart from the warnings below'
    assert 'warning: the estimate has poses that were left out: 1 non_finite.' in rest
    assert any('stamps far from all others, left out: 1.' in line for line in rest)


def test_orientations_that_were_never_filled_in_are_pointed_out(flight, tmp_path):
    poses = simulate(duration_s=40.0).estimate
    blank = np.tile([0.0, 0.0, 0.0, 1.0], (len(poses), 1))
    (tmp_path / 'est.txt').write_text(tum(replace(poses, rotations=blank)))
    files = ['--estimate', tmp_path / 'est.txt', *pair(flight, 'est')[2:]]
    said = diagnose(*files).stdout
    assert said.startswith('nothing unusual, apart from the warnings below\n')
    assert 'all orientations of the estimate are the same' in said
    found = json.loads(diagnose(*files, '--json').stdout)
    assert found['findings']['orientations_that_never_change'] == ['estimate']
    assert {'sensor_rotation', 'quaternion_order'} <= set(found['cannot_tell'])


@pytest.mark.slow
def test_no_statement_is_advised_that_says_how_the_file_was_read(flight, tmp_path):
    poses = simulate(duration_s=40.0).estimate
    (tmp_path / 'moved.txt').write_text(
        tum(replace(poses, rotations=np.roll(poses.rotations, -1, axis=1)))
    )
    truth = ['--ground-truth', f'{flight}/gt.txt']
    for statement in ('', '?quaternion=xyzw'):
        done = diagnose('--estimate', f'{tmp_path}/moved.txt{statement}', *truth)
        assert done.stdout.startswith('1. quaternion_order')
        assert 'append to the spec' not in done.stdout
    # a file of x y z w that was read as if w came first
    done = diagnose('--estimate', f'{flight}/est.txt?quaternion=wxyz', *truth)
    assert '?quaternion=xyzw' in done.stdout


def test_applying_shows_the_errors_before_and_after(flight):
    done = diagnose(*pair(flight, 'larger'), '--apply')
    row = next(line for line in done.stdout.splitlines() if line.startswith('ATE [m]'))
    before, after = map(float, row.split()[-2:])
    assert after < 0.2 * before


def test_json_is_the_document_and_nothing_else(flight):
    done = diagnose(*pair(flight, 'larger'), '--json', '--apply')
    assert done.stderr == ''
    found = json.loads(done.stdout)
    assert found['schema'] == 'vio_eval_ros.diagnosis/1'
    (cause,) = found['causes']
    assert cause['name'] == 'scale'
    assert cause['value'] == pytest.approx(1.3, abs=0.02)
    assert found['findings']['errors']['ATE [m]']['after'] < cause['ate_before_m']


@pytest.mark.slow
def test_a_named_cause_fails_and_others_do_not(flight):
    assert diagnose(*pair(flight, 'late'), '--fail-on', 'scale,time_offset').returncode == 1
    assert diagnose(*pair(flight, 'late'), '--fail-on', 'scale').returncode == 0
    assert "there is no cause 'scales'" in complaint(DEMO, '--fail-on', 'scales')


def test_a_gyroscope_is_held_against_the_estimate(flight):
    done = diagnose(*pair(flight, 'late'), '--imu', flight / 'imu.csv', '--json')
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)['findings']['gyroscope']
    assert found['offset_s'] == pytest.approx(0.08, abs=1e-3)
    assert found['turn_deg'] < 0.5


@pytest.mark.slow
@pytest.mark.parametrize('name', ['run.bag', 'run.mcap', 'run'])
def test_the_gyroscope_of_a_recording_gives_offset_turn_and_bias(tmp_path, name):
    # the IMU is turned in the body, and its stamps are 25 ms early
    turn = rotation.from_rotation_vector(np.array([0.3, -0.8, 0.2]))
    bias = np.array([0.02, -0.01, 0.005])
    run = simulate(duration_s=40.0, imu_noise=EUROC)
    samples = run.imu.samples.copy()
    samples[:, :3] = rotation.rotate(rotation.conjugate(turn), samples[:, :3]) + bias
    imu = replace(run.imu, stamps_ns=run.imu.stamps_ns - 25_000_000, samples=samples)
    write_recording(replace(run, imu=imu), tmp_path / name)
    done = diagnose(tmp_path / name, '--imu', '/imu0', '--json')
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document['causes'] == []
    found = document['findings']['gyroscope']
    assert found['offset_s'] == pytest.approx(0.025, abs=1e-3)
    assert abs(found['offset_s'] - 0.025) <= found['offset_uncertainty_s'] < 5e-3
    apart = rotation.angle_between(np.array(found['turn_xyzw']), turn)
    assert np.degrees(apart) < 0.3
    assert found['bias_rad_s'] == pytest.approx(bias.tolist(), abs=3e-3)
    assert found['misfit'] < 0.2
    text = diagnose(tmp_path / name, '--imu', '/imu0').stdout
    assert 'gyroscope     the stamps of the estimate are 2' in text


@pytest.mark.slow
def test_a_headline_does_not_contradict_the_gyroscope(flight, tmp_path):
    lines = (flight / 'imu.csv').read_text().splitlines()
    rows = np.array([line.split(',')[1:4] for line in lines[1:]], float)
    stamps = [line.split(',')[0] for line in lines[1:]]

    def said(rates: np.ndarray, later_ns: int = 0) -> str:
        """Return what is said of a healthy estimate and a gyroscope with a header of no units."""
        written = ['#timestamp,w_x,w_y,w_z,a_x,a_y,a_z'] + [
            f'{int(stamp) + later_ns},{x:.9f},{y:.9f},{z:.9f},0,0,9.81'
            for stamp, (x, y, z) in zip(stamps, rates.tolist(), strict=True)
        ]
        (tmp_path / 'imu.csv').write_text('\n'.join(written) + '\n')
        done = diagnose(*pair(flight, 'est'), '--imu', tmp_path / 'imu.csv')
        assert done.returncode == 0, done.stderr
        return done.stdout

    healthy = said(rows)
    assert healthy.splitlines()[0] == 'nothing unusual'
    assert 'disagrees' not in healthy
    for text, named in (
        (said(rows, -90_000_000), 'the estimate is 90.'),
        (said(rows[:, [1, 2, 0]]), 'it is rotated by 1'),
        (said(rows * [1, -1, 1]), 'an axis mirrored or two swapped'),
    ):
        assert text.splitlines()[0] == 'nothing unusual, apart from the warnings below'
        assert 'warning: the gyroscope disagrees: ' in text
        assert named in text
    degrees = said(np.degrees(rows))
    assert degrees.splitlines()[0] == 'nothing unusual, apart from the warnings below'
    assert 'were taken for deg/s' in degrees
    assert 'disagrees' not in degrees


def test_a_gyroscope_that_never_turns_is_refused(flight, tmp_path):
    stamps_ns = 1_403_715_524_907_140_096 + 5_000_000 * np.arange(4000)
    rows = [f'{stamp},0,0,0,0,0,9.81' for stamp in stamps_ns.tolist()]
    (tmp_path / 'imu.csv').write_text('\n'.join(rows) + '\n')
    said = complaint(*pair(flight, 'est'), '--imu', tmp_path / 'imu.csv')
    assert 'do not both rotate' in said


def test_a_truth_that_was_interpolated_is_pointed_out(flight, tmp_path):
    truth = simulate(duration_s=40.0).ground_truth
    knots = truth[::10]
    stamps_ns = truth.stamps_ns[truth.stamps_ns <= knots.stamps_ns[-1]]
    points = [
        np.interp(stamps_ns - stamps_ns[0], knots.stamps_ns - stamps_ns[0], column)
        for column in knots.positions.T
    ]
    straight = Trajectory(stamps_ns, np.stack(points, -1), truth.rotations[: len(stamps_ns)])
    (tmp_path / 'gt.txt').write_text(tum(straight))
    files = ['--estimate', f'{flight}/est.txt', '--ground-truth', f'{tmp_path}/gt.txt']
    assert 'interpolated from poses 50 ms apart' in diagnose(*files).stdout
    assert 'interpolated' not in diagnose(*pair(flight, 'est')).stdout


def test_two_signals_are_aligned_without_any_trajectory(tmp_path):
    seconds = np.arange(0, 30, 0.01)

    def signal(at: np.ndarray) -> np.ndarray:
        return np.sin(1.3 * at) + np.sin(3.7 * at + 1)

    for name, late_s in (('a', 0.25), ('b', 0.0)):
        values = signal(seconds) * (2 if name == 'a' else 1)
        rows = np.column_stack([1_403_636_580 + seconds + late_s, values])
        lines = ['# time value', *(f'{t:.6f} {v:.9f}' for t, v in rows)]
        (tmp_path / f'{name}.csv').write_text('\n'.join(lines) + '\n')
    files = ['--signals', tmp_path / 'a.csv', tmp_path / 'b.csv']
    done = diagnose(*files, '--json')
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found['offset_s'] == pytest.approx(0.25, abs=1e-4)
    assert found['left_out'] == [0, 0]
    assert 'are 250.00 ± ' in diagnose(*files).stdout

    rows = (tmp_path / 'a.csv').read_text().splitlines()
    rows[10] = rows[10].split()[0] + ' nan'
    (tmp_path / 'a.csv').write_text('\n'.join([*rows, rows[5]]) + '\n')
    assert json.loads(diagnose(*files, '--json').stdout)['left_out'] == [2, 0]
    said = diagnose(*files).stdout
    assert '2 rows of ' in said
    assert 'a.csv repeat a stamp or are not finite numbers' in said


def test_opposite_signs_and_ambiguous_lags_are_reported(tmp_path):
    seconds = np.arange(0, 40, 0.01)
    wave, pulse = np.sin(3 * seconds), np.exp(-((seconds - 20) ** 2))
    for name, values in {'wave': wave, 'pulse': pulse, 'negative': -2 * pulse}.items():
        lines = [f'{t:.6f} {v:.9f}' for t, v in zip(seconds, values, strict=True)]
        (tmp_path / f'{name}.csv').write_text('\n'.join(lines) + '\n')

    def found(*names: str) -> tuple[dict, str]:
        files = [tmp_path / f'{name}.csv' for name in names]
        document = json.loads(diagnose('--signals', *files, '--json').stdout)
        return document, diagnose('--signals', *files).stdout

    document, text = found('pulse', 'negative')
    assert (document['sign'], document['ambiguous']) == (-1, False)
    assert document['offset_s'] == pytest.approx(0, abs=1e-6)
    assert 'correlation -1' in text
    assert 'signs are opposite' in text
    assert 'the lag is ambiguous' not in text
    document, text = found('wave', 'wave')
    assert (document['sign'], document['ambiguous']) == (1, True)
    assert 'the lag is ambiguous' in text
    assert 'signs are opposite' not in text


def test_signals_that_cannot_be_compared_are_refused_in_one_line(tmp_path):
    seconds = np.arange(0, 10, 0.01)
    contents = {
        'good': np.column_stack([seconds, np.sin(seconds) + np.sin(3 * seconds)]),
        'unknown': np.column_stack([seconds, np.full(len(seconds), np.nan)]),
        'huge': np.column_stack([seconds, 1e300 * np.cos(seconds)]),
        'constant': np.column_stack([seconds, np.ones(len(seconds))]),
        'few': np.column_stack([seconds, seconds])[:3],
        'narrow': seconds[:, None],
    }
    for name, rows in contents.items():
        lines = [' '.join(map(str, row)) for row in rows.tolist()]
        (tmp_path / f'{name}.csv').write_text('\n'.join(lines) + '\n')
    good = tmp_path / 'good.csv'
    for name, said in {
        'unknown': 'no finite value',
        'huge': 'no finite value',
        'constant': 'never changes',
        'few': '1000 and 3 samples',
        'narrow': 'two columns, time and value',
        'missing': 'No such file',
    }.items():
        assert said in complaint('--signals', good, tmp_path / f'{name}.csv')
    assert '2 arguments' in complaint('--signals', good)
    for flag in (['--apply'], ['--fail-on', 'scale'], ['--imu', '/imu0']):
        assert f'leave out {flag[0]}' in complaint('--signals', good, good, *flag)
    assert 'leave out RECORDING' in complaint(DEMO, '--signals', good, good)


def test_causes_to_fail_on_are_names_with_commas_between(flight):
    assert diagnose(*pair(flight, 'late'), '--fail-on', 'scale, time_offset').returncode == 1
    assert "did you mean 'scale'?" in complaint(*pair(flight, 'est'), '--fail-on', 'scalee')
    for nothing in ('', ',', 'scale,'):
        assert "there is no cause ''" in complaint(DEMO, '--fail-on', nothing)


def test_a_crop_that_leaves_nothing_is_one_line(flight):
    assert 'has 0 usable poses' in complaint(*pair(flight, 'est'), '--start-s', 500, '--apply')


def test_what_cannot_be_done_is_one_line(flight, tmp_path):
    (tmp_path / 'few.txt').write_text('1 0 0 0 0 0 0 1\n2 1 0 0 0 0 0 1\n')
    message = complaint('--estimate', tmp_path / 'few.txt', '--ground-truth', flight / 'gt.txt')
    assert 'the estimate has 2 usable poses' in message
    assert 'RECORDING' in complaint()
    assert 'a topic needs a RECORDING' in complaint(*pair(flight, 'est'), '--imu', '/imu0')


def test_an_imu_topic_that_is_not_there_is_reported_with_what_to_write(tmp_path):
    path = tmp_path / 'run.mcap'
    write_recording(simulate(duration_s=5.0, imu_noise=EUROC), path)
    advice = 'there is no such topic; choose --imu'
    assert f'{advice} /imu0 (1000 messages)' in complaint(path, '--imu', '/imu')
    assert f'{advice} {path}:/imu0 (1000' in complaint(path, '--imu', f'{path}:/imu')
    write_recording(simulate(duration_s=5.0), tmp_path / 'without.mcap')
    said = complaint(tmp_path / 'without.mcap', '--imu', '/imu0')
    assert 'no such topic; the recording has no topic of type sensor_msgs/msg/Imu' in said


def test_a_profile_and_a_file_of_limits_decide_what_is_healthy(flight, tmp_path):
    larger = simulate(duration_s=40.0).estimate
    larger = replace(larger, positions=1.045 * larger.positions)
    (tmp_path / 'larger.txt').write_text(tum(larger))
    files = ['--estimate', tmp_path / 'larger.txt', '--ground-truth', flight / 'gt.txt']
    limits = tmp_path / 'limits.yaml'
    limits.write_text('diagnose: {scale_percent: 6}\n')

    def found(*flags: object) -> tuple[str, float, list[str]]:
        document = json.loads(diagnose(*files, *flags, '--json').stdout)
        names = [cause['name'] for cause in document['causes']]
        return document['profile'], document['limits']['scale_percent'], names

    assert found() == ('drone', 3.0, ['scale'])
    assert found('--profile', 'indoor_robot') == ('indoor_robot', 5.0, [])
    assert found('--limits', limits) == ('drone', 6.0, [])
    limits.write_text('diagnose: {scale_pct: 6}\n')
    assert "did you mean 'scale_percent'" in complaint(*files, '--limits', limits)
    assert 'leave out --limits' in complaint('--signals', 'a', 'b', '--limits', limits)


def test_warnings_are_in_the_document(flight, tmp_path):
    poses = simulate(duration_s=40.0).estimate
    blank = np.tile([0.0, 0.0, 0.0, 1.0], (len(poses), 1))
    (tmp_path / 'est.txt').write_text(tum(replace(poses, rotations=blank)))
    files = ['--estimate', tmp_path / 'est.txt', *pair(flight, 'est')[2:]]
    (warning,) = json.loads(diagnose(*files, '--json').stdout)['warnings']
    assert warning in diagnose(*files).stdout
