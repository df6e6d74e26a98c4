"""What is wrong with a calibration is named, what is right is told in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import re
from typing import Any

import numpy as np
import pytest
import yaml

from vio_eval_ros.core import rotation
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.inspection.calibration import Calibration, check_calibration
from vio_eval_ros.inspection.calibration_files import read_calibrations
from vio_eval_ros.inspection.inspection import inspect_streams as inspect


def pose(vector_deg: list[float], position: list[float]) -> np.ndarray:
    matrix = np.eye(4)
    turn = rotation.from_rotation_vector(np.radians([vector_deg]))
    matrix[:3, :3] = rotation.to_matrix(turn)[0]
    matrix[:3, 3] = position
    return matrix


# as EuRoC's rig: x of the IMU is up, the left camera 11 cm to the left
LEFT = pose([0, 0, 90], [-0.02, -0.065, 0.01])
RIGHT = pose([0.4, 0.2, 90], [-0.02, 0.045, 0.008])


def written(path: Path, **cameras: dict[str, Any]) -> Path:
    content = {
        name: {key: np.asarray(value).tolist() for key, value in camera.items()}
        for name, camera in cameras.items()
    }
    path.write_text(yaml.safe_dump(content))
    return path


def checked(*paths: Path) -> Calibration:
    return check_calibration(read_calibrations(paths), inspect([]))


def stereo(key: str, left: np.ndarray, right: np.ndarray) -> dict[str, dict[str, Any]]:
    return {'cam0': {key: left}, 'cam1': {key: right}}


@pytest.mark.parametrize(
    ('cameras', 'names'),
    [
        (stereo('T_imu_cam', LEFT, RIGHT), set()),
        (stereo('T_cam_imu', np.linalg.inv(LEFT), np.linalg.inv(RIGHT)), set()),
        (stereo('T_cam_imu', LEFT, RIGHT), {'direction'}),
        (stereo('T_imu_cam', np.linalg.inv(LEFT), np.linalg.inv(RIGHT)), {'direction'}),
        (stereo('T_imu_cam', RIGHT, LEFT), {'camera_order'}),
        (stereo('T_imu_cam', LEFT, LEFT), {'baseline'}),
        ({'cam0': {'T_imu_cam': LEFT @ np.diag([-1, 1, 1, 1])}}, {'not_a_rotation'}),
        ({'cam0': {'T_imu_cam': LEFT @ np.diag([1.1, 1, 1, 1])}}, {'not_a_rotation'}),
        ({'cam0': {'T_imu_cam': LEFT.T}}, {'not_a_rotation'}),
        ({'cam0': {'T_imu_cam': pose([0, 0, 90], [-20, -65, 10])}}, {'lever_arm'}),
        ({'cam0': {'T_imu_cam': LEFT, 'timeshift_cam_imu': 0.3}}, {'timeshift'}),
        ({'imu0': {'T_i_b': 2 * np.eye(4)}}, {'not_a_rotation'}),
        (
            {'cam0': {'T_imu_cam': LEFT}, 'cam1': {'T_imu_cam': RIGHT, 'T_cn_cnm1': np.eye(4)}},
            {'chain_mismatch'},
        ),
    ],
)
def test_wrong_calibrations_are_named(tmp_path, cameras, names):
    found = checked(written(tmp_path / 'chain.yaml', **cameras)).findings
    assert {one.name for one in found} == names


def turned(matrix: np.ndarray) -> np.ndarray:
    other = matrix.copy()
    other[:3, :3] = matrix[:3, :3].T
    return other


# as TUM-VI's rig, whose rotations are nearly their own inverse
TUM_LEFT = np.linalg.inv(pose([1.5, 126, 127.3], [0.047, -0.047, -0.068]))
TUM_RIGHT = np.linalg.inv(pose([0, 128.8, 126.4], [-0.054, -0.046, -0.071]))


@pytest.mark.parametrize('key', ['T_imu_cam', 'T_cam_imu'])
@pytest.mark.parametrize('rig', [(LEFT, RIGHT), (TUM_LEFT, TUM_RIGHT)])
@pytest.mark.parametrize('harmed', [('cam0',), ('cam1',), ('cam0', 'cam1')])
@pytest.mark.parametrize(
    ('harm', 'words'),
    [(np.linalg.inv, 'were the inverse of what the name says'), (turned, 'were transposed')],
)
def test_a_chain_that_does_not_close_shows_what_is_inverted(
    tmp_path, key, rig, harmed, harm, words
):
    cameras = stereo(key, *(m if key == 'T_imu_cam' else np.linalg.inv(m) for m in rig))
    cameras['cam1']['T_cn_cnm1'] = np.linalg.inv(rig[1]) @ rig[0]
    right = written(tmp_path / 'right.yaml', **cameras)
    assert checked(right).findings == []
    for name in harmed:
        cameras[name][key] = harm(cameras[name][key])
    (found,) = checked(written(tmp_path / 'chain.yaml', **cameras)).findings
    assert found.name == 'direction'
    said = ' and '.join(f'{key} of {name}' for name in harmed)
    assert f'{said} {words}' in found.message


def test_a_camera_before_that_is_inverted_is_reported(tmp_path):
    second = {'T_imu_cam': RIGHT, 'T_cn_cnm1': np.linalg.inv(LEFT) @ RIGHT}
    file = written(tmp_path / 'chain.yaml', cam0={'T_imu_cam': LEFT}, cam1=second)
    (found,) = checked(file).findings
    assert (found.name, 'T_cn_cnm1 were its inverse' in found.message) == ('direction', True)


@pytest.mark.parametrize(
    ('rotation_deg', 'up', 'level'),
    [
        ([0, 0, 90], [9.81, 0, 0], None),  # upright
        ([0, 0, -90], [9.81, 0, 0], 'info'),  # upside down, and upright if it were inverted
        ([0, 180, 0], [0, 0, 9.81], None),  # looks down, whichever way it is read
        ([69.28, 69.28, 69.28], [9.81, 0, 0], None),
        ([69.28, -69.28, -69.28], [9.81, 0, 0], 'warn'),
    ],
)
def test_a_camera_that_would_be_upright_the_other_way_is_reported(
    tmp_path, rig, rotation_deg, up, level
):
    numbers = np.random.default_rng(1).normal(0, 0.003, rig['imu'].numbers.shape)
    still = replace(rig['imu'], numbers=numbers + np.append([0, 0, 0], up))
    camera = {'T_imu_cam': pose(rotation_deg, [0.01, 0.02, 0.03])}
    chains = read_calibrations([written(tmp_path / 'chain.yaml', cam0=camera)])
    found = check_calibration(chains, inspect([still])).findings
    assert [(one.name, one.level) for one in found] == [('direction', level)] * bool(level)


def test_a_chain_of_cameras_gives_the_same_as_one_from_the_imu(tmp_path):
    first, second = {'T_cam_imu': np.linalg.inv(LEFT)}, np.linalg.inv(RIGHT) @ LEFT
    file = written(tmp_path / 'camchain.yaml', cam0=first, cam1={'T_cn_cnm1': second})
    calibration = checked(file)
    assert calibration.findings == []
    np.testing.assert_allclose(calibration.files[0].cameras['cam1'], RIGHT, atol=1e-12)


def test_a_chain_without_an_imu_is_compared_from_camera_to_camera(tmp_path):
    whole = written(tmp_path / 'whole.yaml', **stereo('T_imu_cam', LEFT, RIGHT))
    second = {'T_cn_cnm1': np.linalg.inv(RIGHT) @ LEFT}
    file = written(tmp_path / 'camchain.yaml', cam0={'rostopic': '/a'}, cam1=second)
    calibration = checked(whole, file)
    assert calibration.findings == []
    told = calibration.sentences[str(file)]
    assert told[0] == 'cam0 is the origin; no IMU is given'
    assert told[1].endswith('cam1 is at 110.0 0.0 -2.0 mm in the frame of cam0')
    assert any(f'differs from {whole} by' in sentence for sentence in told)


def test_files_that_differ_are_reported_with_how_much(tmp_path):
    one = written(tmp_path / 'one.yaml', cam0={'T_imu_cam': LEFT})
    moved = pose([0, 0, 91], [-0.02, -0.065, 0.04])
    other = written(tmp_path / 'other.yaml', cam0={'T_imu_cam': moved})
    (found,) = checked(one, other).findings
    assert found.name == 'chain_mismatch'
    assert 'by 30 mm and 1 deg' in found.message


def test_the_files_of_a_folder_are_one_chain(tmp_path):
    for name, matrix in (('cam0', LEFT), ('cam1', RIGHT), ('imu0', np.eye(4))):
        kind = 'imu' if name == 'imu0' else 'camera'
        values = {'cols': 4, 'rows': 4, 'data': matrix.ravel().tolist()}
        (tmp_path / name).mkdir()
        text = '%YAML:1.0\n' + yaml.safe_dump({'sensor_type': kind, 'T_BS': values})
        (tmp_path / name / 'sensor.yaml').write_text(text)
    whole = checked(tmp_path)
    files = checked(*sorted(tmp_path.glob('*/sensor.yaml')))
    assert whole.sentences == files.sentences
    assert whole.findings == []
    (told,) = whole.sentences.values()
    assert 'cam0 is the left camera, cam1 the right' in told


KALIBR = {
    'gyroscope_noise_density': 1.7e-4,
    'gyroscope_random_walk': 2e-5,
    'accelerometer_noise_density': 2e-3,
    'accelerometer_random_walk': 3e-3,
    'update_rate': 200.0,
}


def noted(path: Path, **changed: float) -> Calibration:
    path.write_text(yaml.safe_dump(KALIBR | changed))
    return checked(path)


def test_a_file_of_noise_alone_is_one_of_kalibrs(tmp_path):
    calibration = noted(tmp_path / 'imu.yaml')
    assert calibration.findings == []
    (told,) = calibration.sentences.values()
    assert told[0].startswith('imu0: gyroscope_noise_density 0.00017 rad/s/√Hz')
    assert calibration.to_dict()['chains'][0]['imus'] == {'imu0': KALIBR}


@pytest.mark.parametrize(('rate_hz', 'count'), [(100.0, 1), (195.0, 0), (200.0, 0)])
def test_a_rate_that_the_imu_of_the_recording_does_not_have_is_named(
    tmp_path, rig, rate_hz, count
):
    file = tmp_path / 'imu.yaml'
    file.write_text(yaml.safe_dump(KALIBR | {'update_rate': rate_hz}))
    found = check_calibration(read_calibrations([file]), inspect([rig['imu']])).findings
    assert [(one.name, one.level) for one in found] == [('imu_noise', 'warn')] * count


@pytest.mark.parametrize(
    ('sensor', 'density', 'walk', 'count'),
    [
        ('gyroscope', 2e-5, 1.7e-4, 1),
        ('accelerometer', 2e-4, 2e-3, 1),
        ('accelerometer', 2e-3, 3e-3, 0),  # as EuRoC's
    ],
)
def test_densities_that_are_exchanged_with_walks_are_named(tmp_path, sensor, density, walk, count):
    changed = {f'{sensor}_noise_density': density, f'{sensor}_random_walk': walk}
    found = noted(tmp_path / 'imu.yaml', **changed).findings
    assert [one.level for one in found if 'exchanged?' in one.message] == ['warn'] * count
    assert len(found) == count


@pytest.mark.parametrize('key', KALIBR)
@pytest.mark.parametrize(
    ('value', 'level'), [(-1e-3, 'fail'), (0.0, 'fail'), (1e7, 'warn'), (1e-12, 'warn')]
)
def test_noise_that_no_imu_has_is_named(tmp_path, key, value, level):
    (found,) = noted(tmp_path / 'imu.yaml', **{key: value}).findings
    assert (found.name, found.level) == ('imu_noise', level)
    assert key in found.message


def test_noise_of_which_a_part_lacks_is_named(tmp_path):
    file = tmp_path / 'chain.yaml'
    file.write_text(yaml.safe_dump({'imu0': {**KALIBR, 'T_i_b': np.eye(4).tolist()}}))
    assert checked(file).findings == []
    file.write_text('gyroscope_noise_density: 1.0e-4\ngyroscope_random_walk: 1.0e-5\n')
    (found,) = checked(file).findings
    assert found.message == (
        'accelerometer_noise_density and accelerometer_random_walk are missing'
    )


@pytest.mark.parametrize('key', ['T_imu_cam', 'T_cam_imu'])
def test_a_last_row_that_is_none_is_found_whichever_way_it_maps(tmp_path, key):
    given = (m.copy() if key == 'T_imu_cam' else np.linalg.inv(m) for m in (LEFT, RIGHT))
    left, right = given
    right[3] = [0, 0, 0, 2]
    (found,) = checked(written(tmp_path / 'chain.yaml', **stereo(key, left, right))).findings
    assert (found.name, found.level) == ('not_a_rotation', 'fail')
    assert '[0.0, 0.0, 0.0, 2.0]' in found.message


@pytest.mark.parametrize('key', ['T_imu_cam', 'T_cam_imu'])
@pytest.mark.parametrize('harmed', [('cam0',), ('cam1',), ('cam0', 'cam1')])
def test_millimetres_are_one_finding(tmp_path, key, harmed):
    cameras = stereo(key, *(m if key == 'T_imu_cam' else np.linalg.inv(m) for m in (LEFT, RIGHT)))
    for name in harmed:
        cameras[name][key] = cameras[name][key].copy()
        cameras[name][key][:3, 3] *= 1000
    right = written(tmp_path / 'right.yaml', **stereo('T_imu_cam', LEFT, RIGHT))
    (found,) = checked(right, written(tmp_path / 'chain.yaml', **cameras)).findings
    assert (found.name, found.level, found.count) == ('lever_arm', 'fail', len(harmed))
    assert 'in millimetres?' in found.message


@pytest.mark.parametrize(
    ('text', 'problem'),
    [
        (f'a: {"x" * 2**20}', 'too large for a calibration'),
        (
            'cam0:\n  T_cam_imu: [1, 2]\n',
            'line 2: T_cam_imu: expected a matrix of 4 rows and 4 columns',
        ),
        ('cam0:\n  T_cam_imu: {data: x}\n', 'line 2: T_cam_imu: expected a matrix of 4 rows'),
        (
            'cam0:\n  T_cam_imu: [[.nan, 0, 0, 0]]\n',
            'line 2: T_cam_imu: expected a matrix of 4 rows',
        ),
        (f'cam0:\n  T_cam_imu: {np.diag([1e200, 1, 1, 1]).tolist()}\n', 'of numbers below 1e+06'),
        (
            'cam0:\n  timeshift_cam_imu: .nan\n',
            'line 2: timeshift_cam_imu: expected a finite number',
        ),
        (
            'cam0:\n  timeshift_cam_imu: abc\n',
            'line 2: timeshift_cam_imu: expected a finite number',
        ),
        (
            'gyroscope_noise_density: .inf\n',
            'line 1: gyroscope_noise_density: expected a finite number',
        ),
        ('imu0:\n  update_rate: [200]\n', 'line 2: update_rate: expected a finite number'),
        ('cam0: {}\ncam1: {}\n', 'line 2: cam1 has none of T_imu_cam'),
        ('cam0: !!python/object:os.system {}\n', 'is not plain data'),
        ('a: 1\n', 'there is no T_BS, and no sensor'),
        ('[1]\n', 'expected a calibration, a mapping of names to values'),
    ],
)
def test_files_that_are_no_calibration_are_reported(tmp_path, text, problem):
    file = tmp_path / 'chain.yaml'
    file.write_text(text)
    with pytest.raises((ConfigError, ReadError), match=re.escape(problem)):
        checked(file)


def test_a_folder_without_calibration_is_reported(tmp_path):
    with pytest.raises(ReadError, match=r'there is no sensor\.yaml in it'):
        checked(tmp_path)
