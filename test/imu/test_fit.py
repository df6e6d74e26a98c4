"""What is put in is found again: over many seeds, and never where it cannot be told."""

from functools import cache

import numpy as np
import pytest

from vio_eval_ros.imu.allan import allan_curve, Curve
from vio_eval_ros.imu.fit import fit_noise
from vio_eval_ros.imu.simulated_noise import EUROC, Noise, simulate_axis

pytestmark = [pytest.mark.needs('allantools'), pytest.mark.slow]
SEEDS = range(20)


@cache
def fit_of(noise, hours, rate_hz, seed):
    source = np.random.default_rng(seed)
    values = simulate_axis(round(hours * 3600 * rate_hz), rate_hz, noise, source)
    return fit_noise(allan_curve([values], rate_hz))


def fits(noise, hours, rate_hz=20.0, seeds=SEEDS):
    """Return a fit for each seed; the rate matters little, since the noises are slower."""
    return [fit_of(noise, hours, rate_hz, seed) for seed in seeds]


def values(found, name):
    return np.array([getattr(fit, name).value for fit in found])


@pytest.mark.parametrize('noise', [EUROC.gyro, EUROC.accel], ids=['gyro', 'accel'])
def test_three_hours_of_euroc_s_imu_give_its_published_noise_for_every_seed(noise):
    found = fits(noise, 3.0)
    np.testing.assert_allclose(values(found, 'density'), noise.density, rtol=0.05)
    np.testing.assert_allclose(values(found, 'walk'), noise.walk, rtol=0.15)
    assert np.isnan(values(found, 'instability')).all()


def test_what_is_found_is_right_on_average():
    """A fit that keeps terms which are not there takes from those that are."""
    found = fits(EUROC.gyro, 3.0)
    assert values(found, 'density').mean() == pytest.approx(EUROC.gyro.density, rel=0.005)
    assert values(found, 'walk').mean() == pytest.approx(EUROC.gyro.walk, rel=0.03)


def test_all_three_terms_are_found_where_all_are_there():
    noise = Noise(1.7e-4, 1e-5, 5e-5)
    found = fits(noise, 6.0)
    np.testing.assert_allclose(values(found, 'density'), noise.density, rtol=0.05)
    np.testing.assert_allclose(values(found, 'instability'), noise.instability, rtol=0.2)
    np.testing.assert_allclose(values(found, 'walk'), noise.walk, rtol=0.25)
    assert np.median(values(found, 'walk')) == pytest.approx(noise.walk, rel=0.05)


@pytest.mark.parametrize('noise', [EUROC.gyro, Noise(1.7e-4, 1e-5, 5e-5)], ids=['two', 'three'])
def test_confidence_intervals_hold_the_truth_nineteen_times_in_twenty(noise):
    found = fits(noise, 3.0, seeds=range(40))
    for name in ('density', 'walk'):
        inside = sum(
            getattr(fit, name).low <= getattr(noise, name) <= getattr(fit, name).high
            for fit in found
        )
        assert inside >= 34  # 38 expected; fewer than 34 has a chance of 1 in 80


def test_white_noise_alone_gives_no_bias_instability_and_no_random_walk():
    for fit in fits(Noise(1.7e-4, 0.0), 3.0):
        assert fit.density.value == pytest.approx(1.7e-4, rel=0.03)
        assert np.isnan([fit.instability.value, fit.walk.value]).all()
        assert 'record longer' in fit.walk.reason
        assert fit.walk.high < 1e-5
        assert not fit.residual
        assert not fit.ramp


def test_a_walk_that_the_record_is_too_short_for_is_null_below_an_upper_limit_that_holds():
    noise = Noise(1.7e-4, 1e-6)
    found = fits(noise, 0.5)
    assert np.isnan(values(found, 'walk')).all()
    assert sum(fit.walk.high >= noise.walk for fit in found) >= 18


def test_the_upper_limit_of_a_bias_instability_that_is_not_determined_holds():
    """The lowest of deviations that scatter is too low a limit on average."""
    noise = Noise(1.7e-4, 0.0, 3e-5)
    found = [fit for fit in fits(noise, 1 / 3, seeds=range(60)) if np.isnan(fit.instability.value)]
    assert len(found) > 20
    held = [fit.instability.high >= noise.instability for fit in found]
    assert np.mean(held) >= 0.9


def test_a_record_of_seconds_gives_nothing_but_the_reason():
    fit = fits(EUROC.gyro, 1 / 3600, 20.0, [0])[0]
    for parameter in (fit.density, fit.instability, fit.walk):
        assert np.isnan(parameter.value)
        assert 'too short' in parameter.reason
    assert fit.range_s is None


def test_a_random_walk_without_white_noise_is_not_given_a_density():
    for fit in fits(Noise(0.0, 3e-3), 1.0, seeds=range(5)):
        assert np.isnan(fit.density.value)
        assert fit.walk.value == pytest.approx(3e-3, rel=0.05)


def test_the_filter_of_a_sensor_does_not_lower_the_density():
    """A low-pass flattens the curve at short times; the white line begins behind it."""
    for seed in range(5):
        raw = simulate_axis(1_080_000, 100.0, EUROC.gyro, np.random.default_rng(seed))
        low_passed = np.convolve(raw, np.full(5, 1 / 5), 'valid')
        fit = fit_noise(allan_curve([low_passed], 100.0))
        assert fit.range_s[0] >= 0.1
        assert fit.density.value == pytest.approx(EUROC.gyro.density, rel=0.03)
        assert fit.walk.value == pytest.approx(EUROC.gyro.walk, rel=0.2)


def test_vibration_does_not_raise_the_density():
    times_s = np.arange(1_080_000) / 100.0
    raw = simulate_axis(len(times_s), 100.0, EUROC.gyro, np.random.default_rng(1))
    fit = fit_noise(allan_curve([raw + 0.003 * np.sin(2 * np.pi * 23.7 * times_s)], 100.0))
    assert fit.range_s[0] >= 0.1
    assert fit.density.value == pytest.approx(EUROC.gyro.density, rel=0.03)


def test_a_steady_drift_is_distinguished_from_a_random_walk():
    times_s = np.arange(216_000) / 20.0
    white = simulate_axis(len(times_s), 20.0, Noise(1.7e-4, 0.0), np.random.default_rng(1))
    assert fit_noise(allan_curve([white + 2e-7 * times_s], 20.0)).ramp


def test_slow_oscillations_are_reported_as_more_than_the_model():
    times_s = np.arange(216_000) / 20.0
    white = simulate_axis(len(times_s), 20.0, Noise(1.7e-4, 0.0), np.random.default_rng(1))
    fit = fit_noise(allan_curve([white + 1e-4 * np.sin(2 * np.pi * times_s / 100)], 20.0))
    excess, tau_s = fit.residual
    assert abs(excess) > 0.1
    assert 5 < tau_s < 1500


def test_dominance_shows_which_term_is_largest_where():
    fit = fits(EUROC.gyro, 3.0, seeds=[0])[0]
    crossing_s = np.sqrt(3) * EUROC.gyro.density / EUROC.gyro.walk
    assert fit.density.dominates_s[1] < 1.3 * crossing_s
    assert fit.walk.dominates_s[0] > crossing_s / 1.3


def curve_of(folder, imu, sensor, axis, unit):
    taus_s, deviations = (
        np.loadtxt(folder / f'data_{imu}_{sensor}_{name}.txt') for name in ('t', axis)
    )
    factors = np.rint(taus_s / taus_s[0]).astype(int)
    # The record is not published, its length is: the longest averaging time is the largest
    # power of two below half of it, so that it is between two and four times as long.
    samples = 3 * factors[-1]
    return Curve(factors, deviations * unit, samples - 2 * factors, 1 / taus_s[0], samples)


def published(folder, imu):
    """Return the parameters that imu_utils printed, by sensor, axis and letter."""
    text = (folder / f'{imu}_imu_param.yaml').read_text()
    found, axis = {}, ''
    for line in text.splitlines():
        name, _, value = line.strip().partition(':')
        if name.endswith('-axis'):
            axis = name[0]
        elif name[:4] in ('gyr_', 'acc_'):
            found[name[:3], axis, name[-1]] = float(value)
    return found


@pytest.mark.parametrize('imu', ['16448', 'A3'])
@pytest.mark.parametrize('axis', 'xyz')
@pytest.mark.parametrize('sensor', ['gyr', 'acc'])
def test_published_curves_give_what_was_published_beside_them(shared_data, imu, sensor, axis):
    """
    imu_utils' n is its fit at τ = 1 s, all terms together, and its w the lowest point of it.

    Its curves of gyroscopes are in deg/h.
    """
    folder = shared_data / 'imu' / 'imu_utils'
    unit = np.pi / 180 / 3600 if sensor == 'gyr' else 1.0
    curve = curve_of(folder, imu, sensor, axis, unit)
    fit, theirs = fit_noise(curve), published(folder, imu)
    at_1_s = np.exp(np.interp(0, np.log(curve.taus_s), np.log(fit.deviations)))
    assert at_1_s == pytest.approx(theirs[sensor, axis, 'n'], rel=0.15)
    assert fit.deviations.min() == pytest.approx(theirs[sensor, axis, 'w'], rel=0.25)
    assert fit.density.value < 1.05 * at_1_s


def test_the_adis16448_published_has_the_density_that_euroc_states_of_its_own(shared_data):
    """EuRoC's sensor is one of this type; the walk it states is above any of these curves."""
    folder = shared_data / 'imu' / 'imu_utils'
    unit = np.pi / 180 / 3600
    fits_ = [fit_noise(curve_of(folder, '16448', 'gyr', axis, unit)) for axis in 'xyz']
    np.testing.assert_allclose(values(fits_, 'density'), EUROC.gyro.density, rtol=0.05)
