"""`simulate` as its users run it: arguments in, output and an exit status out."""

from pathlib import Path

import numpy as np
import pytest

from verbs import call, complaint, document, start, transcript
from vio_eval_ros.imu.simulated_noise import EUROC
from vio_eval_ros.rendering.tum import tum
from vio_eval_ros.simulation import FAULTS, simulate
from vio_eval_ros.simulation.formats import FORMATS

NOISE = """gyroscope_noise_density: 2.0e-4
gyroscope_random_walk: 3.0e-5
accelerometer_noise_density: 4.0e-3
accelerometer_random_walk: 5.0e-3
"""
FIVE_SECONDS = ('--duration-s', 5, '--fault', 'outliers=0.05,1')


def simulated(*arguments: object) -> str:
    """Return what is printed where all goes well."""
    done = call('simulate', *arguments)
    assert (done.returncode, done.stderr) == (0, ''), transcript(done)
    return done.stdout


def ate_m(*arguments: object) -> float:
    return document('replay', *arguments)['metrics']['ate_trans_rmse_m']


@pytest.fixture(scope='module')
def flight(tmp_path_factory) -> Path:
    """Return a folder with est.txt and gt.txt, of a real run as far as the verb can tell."""
    folder, run = tmp_path_factory.mktemp('flight'), simulate(duration_s=30, seed=3)
    (folder / 'est.txt').write_text(tum(run.estimate))
    (folder / 'gt.txt').write_text(tum(run.ground_truth))
    return folder


def test_every_format_gives_replay_the_same_run(tmp_path):
    found = {}
    for kind, how in FORMATS.items():
        out = tmp_path / f'{kind}{how.suffix}'
        printed = simulated(out, '--format', kind, '--duration-s', 10, '--fault', 'scale=1.1')
        assert printed == (
            f'{out} ({kind}): 2,000 ground truth, 200 estimates, 2,000 IMU samples\n'
            'faults: scale=1.1\n'
        )
        if kind in ('tum', 'euroc'):
            truth = out / {'tum': 'ground_truth.tum', 'euroc': 'mav0'}[kind]
            found[kind] = ate_m('--estimate', out / 'estimate.tum', '--ground-truth', truth)
        else:
            found[kind] = ate_m(out)
    # TUM files have nine decimals
    assert found == pytest.approx(dict.fromkeys(found, found['mcap']), abs=1e-9)


@pytest.mark.slow
def test_diagnose_names_what_was_put_in(tmp_path):
    out = tmp_path / 'run.mcap'
    printed = simulated(out, '--fault', 'time_offset=0.08', '--fault', 'lever_arm=0.3')
    assert printed.endswith('faults: time_offset=0.08, lever_arm=0.3\n')
    causes = document('diagnose', out)['causes']
    assert {cause['name'] for cause in causes} == {'time_offset', 'lever_arm'}


@pytest.mark.slow
def test_the_same_command_writes_the_same_bytes_and_another_seed_others(tmp_path):
    def bytes_of(name: str, *more: object) -> bytes:
        out = tmp_path / name / 'run.mcap'  # which has its own name in it
        out.parent.mkdir()
        simulated(out, *FIVE_SECONDS, *more)
        return out.read_bytes()

    first = bytes_of('first')
    assert bytes_of('second') == first
    started = tmp_path / 'started' / 'run.mcap'
    started.parent.mkdir()
    assert start('simulate', started, *FIVE_SECONDS).returncode == 0
    assert started.read_bytes() == first
    assert bytes_of('other', '--seed', 8) != first


def test_a_fault_is_added_to_a_real_run_and_its_truth_kept(flight, tmp_path):
    out = tmp_path / 'harmed'
    simulated(
        *(out, '--format', 'tum', '--from', flight / 'est.txt'),
        *('--ground-truth', flight / 'gt.txt', '--fault', 'sensor_rotation=20'),
    )
    kept, given = (np.loadtxt(path) for path in (out / 'ground_truth.tum', flight / 'gt.txt'))
    np.testing.assert_allclose(kept, given, rtol=0, atol=2e-9)  # quaternions are normalised
    both = ('--estimate', out / 'estimate.tum', '--ground-truth', out / 'ground_truth.tum')
    (cause,) = document('diagnose', *both)['causes']
    assert cause['name'] == 'sensor_rotation'
    assert cause['value'] == pytest.approx(20, abs=0.5)


def test_a_real_run_without_faults_and_truth_is_only_converted(flight, tmp_path):
    printed = simulated(tmp_path / 'run.bag', '--from', flight / 'est.txt')
    assert printed == f'{tmp_path / "run.bag"} (ros1): 600 estimates\nfaults: none\n'
    estimate = f'{tmp_path / "run.bag"}:/vio/odometry'
    gate = ('--ground-truth', flight / 'gt.txt')
    assert ate_m('--estimate', estimate, *gate) == ate_m('--estimate', flight / 'est.txt', *gate)


def test_an_estimate_without_drift_is_the_truth(tmp_path):
    out = tmp_path / 'run.mcap'
    simulated(out, '--duration-s', 10, '--drift', 'none', '--drift', 'scale=0.8')
    metrics = document('replay', out, '--association', 'interpolate')['metrics']
    assert metrics['ate_sim3_trans_rmse_m'] < 1e-4  # what interpolation leaves
    assert metrics['sim3_scale'] == pytest.approx(1 / 0.8, abs=1e-4)


@pytest.mark.slow
def test_imu_noise_finds_the_densities_of_a_record_at_rest(tmp_path):
    pytest.importorskip('allantools')
    out = tmp_path / 'rest.mcap'
    more = ('--gyro-noise-density', 5e-4, '--gyro-random-walk', 0)
    printed = simulated(out, '--still', '--duration-s', 600, *more)
    assert printed == f'{out} (mcap): 120,000 IMU samples\nfaults: none\n'
    axes = document('imu_noise', out)['axes']
    for name, axis in axes.items():
        expected = 5e-4 if name.startswith('gyro') else EUROC.accel.density
        found = axis['parameters']['white_noise_density']['value']
        assert found == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    'content',
    [
        NOISE,
        '%YAML:1.0\n' + NOISE,
        'imu0:\n' + ''.join(f'  {line}\n' for line in NOISE.split('\n')),
    ],
    ids=['kalibr', 'euroc', 'chain'],
)
def test_noise_is_that_of_a_calibration_file(tmp_path, content):
    (tmp_path / 'imu.yaml').write_text(content)
    out = tmp_path / 'run'
    noise = ('--imu-noise', tmp_path / 'imu.yaml', '--accel-noise-density', 6e-3)
    simulated(out, '--format', 'euroc', '--duration-s', 1, *noise)
    written = (out / 'mav0' / 'imu0' / 'sensor.yaml').read_text()
    assert 'gyroscope_random_walk: 3e-05' in written
    assert 'accelerometer_noise_density: 0.006' in written


@pytest.mark.parametrize(
    ('arguments', 'problem'),
    [
        (['{out}', '--fault', 'tme_offset=1'], "did you mean 'time_offset'"),
        (['{out}', '--fault', 'scale'], 'write scale=FACTOR'),
        (['{out}', '--still', '--fault', 'jump=1'], 'jump needs a run with estimate'),
        (['{out}', '--still', '--drift', 'none'], '--drift does not go with --still'),
        (['{out}', '--drift', 'yaw_wlk=1'], "did you mean 'yaw_walk'"),
        (['{out}', '--drift', 'scale=-1'], 'a number above 0'),
        (['{out}', '--drift', 'scale_drift=x'], 'expected a number'),
        (['{out}', '--fault', 'time_offset=-2e9'], 'are limited to 1970 to 2038'),
        (['{out}', '--duration-s', '0'], '--duration-s'),
        (['{out}', '--duration-s', '0.05'], 'too short'),
        (['{out}', '--seed', '-1'], '--seed'),
        (['{out}', '--gyro-random-walk', 'x'], '--gyro-random-walk'),
        (['{out}', '--imu-noise', '{flight}/none.yaml'], 'No such file'),
        (['{out}', '--imu-noise', '{flight}/est.txt'], 'gyroscope_noise_density'),
        (['{out}', '--ground-truth', '{flight}/gt.txt'], '--ground-truth goes with --from'),
        (['{out}', '--from', '{flight}/est.txt', '--still'], '--still does not go with --from'),
        (
            ['{out}', '--from', '{flight}/est.txt', '--gyro-random-walk', '1'],
            '--gyro-random-walk does not go with --from',
        ),
        (['{out}', '--from', '{flight}/none.txt'], 'none.txt'),
        (['{flight}'], 'exists already'),
        (['{out}/none/run'], 'there is no folder'),
        (['{out}.mcap', '--format', 'euroc'], 'for euroc, OUT is a folder: drop .mcap'),
        (['{out}', '--format', 'ros1'], 'name it with .bag'),
    ],
)
def test_what_cannot_be_done_is_one_line_and_status_2(flight, tmp_path, arguments, problem):
    out = tmp_path / 'run'
    given = (each.format(out=out, flight=flight) for each in arguments)
    assert problem in complaint('simulate', *given)
    assert list(tmp_path.iterdir()) == []


def test_the_help_lists_every_fault():
    printed = call('simulate', '--help').stdout
    for name, fault in FAULTS.items():
        assert f'  {name}' in printed
        assert fault.does in printed


def test_a_fault_of_a_real_run_is_named_from_the_shared_data(shared_data, tmp_path):
    out = tmp_path / 'harmed'
    printed = simulated(
        *(out, '--format', 'tum', '--fault', 'time_offset=0.1'),
        *('--from', shared_data / 'evo_test_data/V102.txt'),
        *('--ground-truth', shared_data / 'gt_euroc/open_vins_tum/V1_02_medium.txt'),
    )
    assert 'V102.txt: 4 poses left out: duplicate\n' in printed
    both = ('--estimate', out / 'estimate.tum', '--ground-truth', out / 'ground_truth.tum')
    causes = document('diagnose', *both)['causes']
    assert [cause['name'] for cause in causes] == ['time_offset']
