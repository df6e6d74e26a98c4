"""Simulated noise is what it says it is, by its spectrum and not by what the fit makes of it."""

import numpy as np
import pytest

from vio_eval_ros.imu.simulated_noise import EUROC, Noise, simulate_axis, simulate_noise

RATE_HZ = 100.0


def spectral_density(values, low_hz, high_hz):
    """Return the mean two-sided spectral density between two frequencies."""
    density = np.abs(np.fft.rfft(values)) ** 2 / len(values) / RATE_HZ
    frequencies = np.fft.rfftfreq(len(values), 1 / RATE_HZ)
    return density[(frequencies >= low_hz) & (frequencies < high_hz)].mean()


def mean_density(noise, low_hz, high_hz):
    sources = (np.random.default_rng(seed) for seed in range(20))
    runs = [simulate_axis(40_000, RATE_HZ, noise, source) for source in sources]
    return np.mean([spectral_density(run, low_hz, high_hz) for run in runs])


def test_white_noise_has_its_density_at_every_frequency():
    for band in ((0.1, 1), (1, 10), (10, 50)):
        assert np.sqrt(mean_density(Noise(3e-3, 0), *band)) == pytest.approx(3e-3, rel=0.03)


def test_flicker_noise_falls_with_the_frequency():
    instability = 2e-3
    for low_hz in (0.05, 0.5, 5):
        expected = instability**2 / (2 * np.pi) * np.log(1.5) / (0.5 * low_hz)
        found = mean_density(Noise(0, 0, instability), low_hz, 1.5 * low_hz)
        assert found == pytest.approx(expected, rel=0.1)


def test_a_random_walk_spreads_with_the_root_of_time():
    source = np.random.default_rng(1)
    ends = [simulate_axis(400, RATE_HZ, Noise(0, 5e-3), source)[-1] for _ in range(2000)]
    assert np.std(ends) == pytest.approx(5e-3 * np.sqrt(4.0), rel=0.06)


def test_the_axes_are_those_of_the_sensor_and_independent():
    samples = simulate_noise(20_000, 200.0, EUROC, np.random.default_rng(1))
    assert samples.shape == (20_000, 6)
    short = np.diff(samples, axis=0).std(axis=0) / np.sqrt(2 * 200.0)
    np.testing.assert_allclose(short, [1.6968e-4] * 3 + [2e-3] * 3, rtol=0.03)
    assert np.abs(np.corrcoef(np.diff(samples, axis=0).T) - np.eye(6)).max() < 0.05


def test_the_same_source_gives_the_same_noise():
    one, other = (simulate_noise(100, 200.0, EUROC, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(one, other)
