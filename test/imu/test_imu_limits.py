"""The limits of a record at rest: each of them changes what it says it does."""

from dataclasses import fields

import numpy as np
import pytest

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.imu.analysis import analyse, Analysis
from vio_eval_ros.imu.limits import ImuNoiseLimits
from vio_eval_ros.imu.record import Record
from vio_eval_ros.imu.simulated_noise import EUROC, simulate_noise

RATE_HZ = 50.0


def analysed(samples: np.ndarray, kept: np.ndarray | None = None, **stated: float) -> Analysis:
    pytest.importorskip('allantools')
    limits = ImuNoiseLimits(**stated)
    record = Record('test', limits=limits)
    stamps_ns = round(1e9 / RATE_HZ) * np.arange(len(samples))
    if kept is not None:
        stamps_ns, samples = stamps_ns[kept], samples[kept]
    record.add(stamps_ns, samples)
    return analyse('test', record.finish(), limits=limits)


@pytest.fixture(scope='module')
def rest() -> np.ndarray:
    samples = simulate_noise(40_000, RATE_HZ, EUROC, np.random.default_rng(1))
    samples[:, 5] += 9.81
    return samples


@pytest.fixture(scope='module')
def by_default(rest) -> Analysis:
    return analysed(rest)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('stated', 'warning'),
    [
        ({'scatter_ratio': 1.0}, 'the sensor was not at rest'),
        ({'mean_change_sigmas': 2.0}, 'the sensor was not at rest'),
        ({'max_rate_rad_s': 1e-9}, 'its mean angular rate is'),
        ({'gravity_error_m_s2': 0.0}, 'its mean acceleration is'),
        ({'degrees_density': 1e-5}, 'the gyro is taken to be in deg/s'),
        ({'g_error': 9.0}, 'the accel is taken to be in g'),
        ({'min_averaging_times': 100.0}, 'too short to determine the white noise density'),
        ({'detection_sigmas': 1e6}, 'too short to determine the random walk of any axis'),
        ({'certainty_sigmas': 1e6}, 'too short to determine the white noise density of any axis'),
        ({'residual_ratio': 0.0, 'detection_sigmas': 1e6}, 'the fit: something beside'),
    ],
)
def test_a_limit_that_is_moved_gives_its_warning(rest, by_default, stated, warning):
    assert not any(warning in line for line in by_default.warnings)
    assert any(warning in line for line in analysed(rest, **stated).warnings)


@pytest.mark.slow
def test_limits_of_losses_are_those_stated(rest, by_default):
    kept = np.delete(np.arange(len(rest)), np.r_[100:105, 2_000:20_000:500])
    assert analysed(rest, kept).warnings == by_default.warnings
    warnings = ' '.join(analysed(rest, kept, missing_ratio=1e-4, max_lost_samples=4).warnings)
    assert '0.1 % of the samples are missing' in warnings
    assert 'cut into 2 segments; gaps: 1, samples lost in them: 5' in warnings
    nothing = analysed(rest, kept, missing_ratio=1e-4, max_missing_ratio=1e-4)
    assert any('too many to determine any noise' in line for line in nothing.warnings)
    assert np.isnan(nothing.axes['gyro_x'].fit.density.value)


@pytest.mark.slow
def test_limits_of_stamps_resolution_and_vibration_are_those_stated(rest):
    twice = rest.copy()
    stamps_ns = round(1e9 / RATE_HZ) * np.arange(len(rest))
    stamps_ns[1_000] = stamps_ns[999]
    record = Record('test')
    record.add(stamps_ns, twice)
    signal = record.finish()
    found = analyse('test', signal, limits=ImuNoiseLimits(equal_stamps_ratio=0.0)).warnings
    assert any('1 samples have the stamp of the previous one' in line for line in found)
    assert not any('have the stamp' in line for line in analyse('test', signal).warnings)
    twice[:, 0] = 1e-3 * np.round(twice[:, 0] / 1e-3)
    assert any('resolution' in line for line in analysed(twice, resolution_sigmas=0.1).warnings)
    assert not any('resolution' in line for line in analysed(twice).warnings)
    shaken = rest.copy()
    shaken[:, 0] += 0.02 * np.sin(2 * np.pi * 11.5 * np.arange(len(rest)) / RATE_HZ)
    assert any('vibration of' in line for line in analysed(shaken).warnings)
    calm = analysed(shaken, vibration_ratio=1e3).warnings
    assert not any('vibration of' in line for line in calm)


def test_a_profile_that_does_not_exist_is_refused(rest):
    record = Record('test')
    record.add(20_000_000 * np.arange(len(rest)), rest)
    with pytest.raises(ConfigError, match="'submarine' is not one of"):
        analyse('test', record.finish(), profile='submarine')


@pytest.mark.slow
def test_the_result_states_its_limits(rest):
    found = analysed(rest, scatter_ratio=5.0).to_dict()
    assert found['profile'] == 'drone'
    assert set(found['limits']) == {item.name for item in fields(ImuNoiseLimits)}
    assert found['limits']['scatter_ratio'] == 5.0
