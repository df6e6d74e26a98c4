"""`imu_noise` as its users run it: arguments in, output and an exit status out."""

from functools import partial
import json

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import get_typestore, Stores

from verbs import call, complaint, document, start, transcript
from vio_eval_ros.imu import recorded
from vio_eval_ros.imu.simulated_noise import EUROC, simulate_noise

pytestmark = pytest.mark.needs('allantools')

IMU = 'sensor_msgs/msg/Imu'
RATE_HZ = 50.0
imu_noise = partial(call, 'imu_noise')


@pytest.fixture(scope='module')
def samples():
    noise = simulate_noise(round(1800 * RATE_HZ), RATE_HZ, EUROC, np.random.default_rng(1))
    noise[:, 5] += 9.81
    return noise


@pytest.fixture(scope='module')
def recording(samples, tmp_path_factory):
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    path = tmp_path_factory.mktemp('imu') / 'rest'
    vector, none = types['geometry_msgs/msg/Vector3'], np.zeros(9)
    level = types['geometry_msgs/msg/Quaternion'](0.0, 0.0, 0.0, 1.0)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection('/imu0', IMU, typestore=store)
        for index, row in enumerate(samples.tolist()):
            stamp_ns = 10**18 + round(index * 1e9 / RATE_HZ)
            time = types['builtin_interfaces/msg/Time'](*divmod(stamp_ns, 10**9))
            header = types['std_msgs/msg/Header'](time, 'imu')
            one = types[IMU](header, level, none, vector(*row[:3]), none, vector(*row[3:]), none)
            writer.write(connection, stamp_ns, store.serialize_cdr(one, IMU))
    return path


@pytest.fixture(scope='module')
def file(samples, tmp_path_factory):
    path = tmp_path_factory.mktemp('imu') / 'rest.csv'
    stamps_ns = 10**18 + np.arange(len(samples)) * 20_000_000
    rows = zip(stamps_ns.tolist(), samples.tolist(), strict=True)
    path.write_text(''.join(f'{stamp},{",".join(map(repr, row))}\n' for stamp, row in rows))
    return path


@pytest.mark.slow
def test_a_recording_gives_a_table_and_the_files_asked_for(recording, tmp_path):
    pytest.importorskip('matplotlib')
    paths = {
        'png': tmp_path / 'allan.png',
        'kalibr': tmp_path / 'imu.yaml',
        'json': tmp_path / 'noise.json',
    }
    reports = (f'--report={kind}:{path}' for kind, path in paths.items())
    done = start('imu_noise', recording, *reports)
    assert (done.returncode, done.stderr) == (0, ''), transcript(done)
    assert done.stdout.startswith(f'{recording}:/imu0: 90,000 samples, 0.5 h at 50 Hz\n')
    assert 'white noise density' in done.stdout
    assert paths['png'].read_bytes().startswith(b'\x89PNG')
    assert 'rostopic: "/imu0"' in paths['kalibr'].read_text()
    assert json.loads(paths['json'].read_text())['schema'] == 'vio_eval_ros.imu_noise/1'
    assert set(tmp_path.iterdir()) == set(paths.values())


@pytest.mark.slow
def test_recording_and_csv_give_the_same_figures(recording, file):
    documents = [document('imu_noise', path) for path in (recording, file)]
    assert documents[0]['axes'] == documents[1]['axes']
    density = documents[0]['axes']['gyro_x']['parameters']['white_noise_density']['value']
    assert density == pytest.approx(EUROC.gyro.density, rel=0.05)


@pytest.mark.slow
def test_a_unit_can_be_stated(file):
    units = document('imu_noise', file, '--gyro-unit', 'deg/s')['input']['units']
    assert units['gyro'] == {'name': 'deg/s', 'known': 'stated'}
    assert units['accel'] == {'name': 'm/s2', 'known': 'by default'}


@pytest.mark.parametrize(
    ('arguments', 'problem'),
    [
        (['missing.csv'], 'missing.csv'),
        (
            ['{recording}', '--topic', '/imu'],
            'no such topic; choose --topic /imu0 (90000 messages)',
        ),
        (['{recording}', '--report', 'jpg:allan.jpg'], 'FORMAT one of html, json, kalibr, png'),
        (['{recording}', '--report', 'png:{recording}/none/allan.png'], 'there is no folder'),
        (['{file}', '--report', 'kalibr:{file}'], 'overwrite the input'),
        (['{recording}', '--gyro-unit', 'rpm'], 'invalid choice'),
    ],
)
def test_what_cannot_be_done_is_one_line_and_status_2(recording, file, arguments, problem):
    given = (a.format(recording=recording, file=file) for a in arguments)
    assert problem in complaint('imu_noise', *given)


def test_a_kalibr_file_that_cannot_be_known_is_status_2_after_the_result(file, tmp_path):
    short = tmp_path / 'short.csv'
    short.write_text(''.join(file.read_text().splitlines(keepends=True)[:2_000]))
    kalibr = tmp_path / 'imu.yaml'
    done = imu_noise(short, '--report', f'kalibr:{kalibr}')
    assert done.returncode == 2
    assert 'white noise density' in done.stdout
    assert 'imu_noise: kalibr: gyroscope_random_walk is not known' in done.stderr
    assert not kalibr.exists()


@pytest.mark.parametrize('library', ['allantools', 'matplotlib', 'plotly'])
def test_a_missing_library_is_named_before_anything_is_read(library, monkeypatch):
    monkeypatch.setattr(recorded, 'find_spec', lambda name: None if name == library else name)
    reports = ('--report=png:a.png', '--report=html:a.html')
    assert f'pip install {library}' in complaint('imu_noise', 'missing.csv', *reports)


def test_limits_are_chosen_by_profile_and_file(file, tmp_path):
    short = tmp_path / 'short.csv'
    short.write_text(''.join(file.read_text().splitlines(keepends=True)[:5_000]))
    limits = tmp_path / 'limits.yaml'
    limits.write_text('imu_noise: {gravity_error_m_s2: 0}\n')
    given = (short, '--profile', 'car', '--limits', limits)
    found = document('imu_noise', *given)
    assert found['profile'] == 'car'
    assert found['limits']['gravity_error_m_s2'] == 0.0
    assert any('its mean acceleration is' in warning for warning in found['warnings'])
    assert 'overwrite the input' in complaint('imu_noise', *given, f'--report=json:{limits}')
    limits.write_text('imu_noise: {gravity_error: 0}\n')
    problem = "line 1: there is no 'gravity_error' here; did you mean 'gravity_error_m_s2'?"
    assert problem in complaint('imu_noise', *given)
