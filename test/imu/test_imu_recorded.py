"""The noise of a recording by its name, as a library gives it."""

import pytest

from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.imu import recorded
from vio_eval_ros.imu.limits import ImuNoiseLimits
from vio_eval_ros.imu.recorded import imu_noise
from vio_eval_ros.imu.simulated_noise import EUROC
from vio_eval_ros.simulation import at_rest, write_recording


@pytest.fixture(scope='module')
def recording(tmp_path_factory):
    pytest.importorskip('allantools')
    path = tmp_path_factory.mktemp('imu') / 'rest.mcap'
    write_recording(at_rest(120.0, 1, EUROC), path)
    return path


@pytest.mark.slow
def test_a_recording_is_analysed_by_its_name(recording):
    found = imu_noise(recording)
    assert found.source == f'{recording}:/imu0'
    assert found.topic == '/imu0'
    assert found.units['gyro'] == ('rad/s', 'by default')
    density = found.largest('gyro', 'density')
    assert density == pytest.approx(EUROC.gyro.density, rel=0.1)
    document = found.to_dict()
    assert document['kalibr']['gyroscope_noise_density'] == density
    assert document['axes']['gyro_x']['parameters']['bias_instability']['value'] is None


@pytest.mark.slow
def test_units_and_limits_are_those_stated(recording):
    strict = ImuNoiseLimits(gravity_error_m_s2=0.0)
    found = imu_noise(str(recording), '/imu0', gyro_unit='deg/s', limits=strict)
    assert found.units['gyro'] == ('deg/s', 'stated')
    assert any('its mean acceleration is' in warning for warning in found.warnings)
    assert found.limits == strict


def test_what_cannot_be_analysed_is_an_error_that_says_why(recording, monkeypatch):
    with pytest.raises(ConfigError, match=r"gyro_unit: 'rpm' is not one of rad/s, deg/s"):
        imu_noise(recording, gyro_unit='rpm')
    with pytest.raises(ReadError, match=r'missing\.csv'):
        imu_noise('missing.csv')
    monkeypatch.setattr(recorded, 'find_spec', lambda name: None)
    with pytest.raises(ConfigError, match='pip install allantools'):
        imu_noise(recording)
