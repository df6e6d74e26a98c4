"""Lags of signals, known because they were put there."""

import numpy as np
import pytest

from vio_eval_ros.diagnosis.correlation import correlate
from vio_eval_ros.diagnosis.signals import lag_of_signals
from vio_eval_ros.errors import NoPairs


def wiggle(seconds: np.ndarray) -> np.ndarray:
    rates, phases = np.array([[0.7, 1.9, 3.1, 5.3], [0.3, 1.0, 2.0, 0.1]])
    return np.sin(np.outer(seconds, rates) + phases).sum(axis=1)


@pytest.mark.parametrize('lag', [-731, -40, 0, 3, 999])
def test_a_lag_of_whole_samples_is_found_among_all(lag):
    signal = np.random.default_rng(1).normal(size=4000)
    first, second = signal[1000:3000], signal[1000 + lag : 3000 + lag]
    peak = correlate(first, second, 0.01)
    assert peak.lag_s == pytest.approx(0.01 * lag, abs=2e-3)
    assert peak.height == pytest.approx(1.0, abs=1e-6)
    assert peak.rival < 0.2


def test_what_is_unknown_counts_for_nothing():
    signal = np.random.default_rng(1).normal(size=2000).cumsum()
    first, second = signal[30:1900].copy(), signal[:1870].copy()
    first[400:700], second[1200:1300] = np.nan, np.nan
    peak = correlate(first, second, 0.01)
    assert peak.lag_s == pytest.approx(-0.3, abs=1e-3)
    assert peak.height == pytest.approx(1.0, abs=1e-6)


def test_lags_beyond_the_largest_asked_for_are_not_looked_at():
    signal = np.random.default_rng(1).normal(size=2000)
    assert abs(correlate(signal[500:], signal[:1500], 0.01, 2.0).lag_s) <= 2.0


def test_a_constant_has_no_peak():
    assert np.isnan(correlate(np.ones(100), np.ones(100), 0.01).height)


@pytest.mark.slow
@pytest.mark.parametrize('offset_s', [-3.2, -0.0123, 0.0, 0.0071, 12.5])
def test_signals_with_gain_and_bias_and_rates_of_their_own_are_aligned(offset_s):
    first_s, second_s = np.arange(0, 60, 0.005), np.arange(0.3, 58, 0.033)
    rng = np.random.default_rng(2)
    first = 2.5 * wiggle(first_s) + 4 + rng.normal(0, 0.05, len(first_s))
    second = wiggle(second_s) + rng.normal(0, 0.02, len(second_s))
    found = lag_of_signals(first_s + offset_s, first, second_s, second)
    assert found.offset_s == pytest.approx(offset_s, abs=2e-3)
    assert abs(found.offset_s - offset_s) <= found.uncertainty_s + 5e-4
    assert found.peak > 0.9


def random_signal(rng: np.random.Generator, size: int, samples: float) -> np.ndarray:
    """Return noise of variance 1 that forgets what it was in so many samples."""
    age = np.arange(size) / samples
    spectrum = np.fft.rfft(rng.normal(size=2 * size)) * np.fft.rfft(age * np.exp(-age), 2 * size)
    values = np.fft.irfft(spectrum)[size:]
    return np.asarray(values / values.std())


@pytest.mark.slow
@pytest.mark.parametrize(
    ('rates_hz', 'noises', 'coloured_s'),
    [
        ((200, 20), (0.3, 0.0), 0),
        ((20, 200), (0.1, 0.1), 0),
        ((100, 100), (0.2, 0.2), 0),
        ((10, 10), (0.2, 0.2), 0),
        ((500, 10), (0.5, 0.1), 0),
        ((250, 250), (1.0, 1.0), 0),
        ((200, 20), (0.2, 0.2), 0.1),
    ],
)
def test_intervals_hold_whichever_side_is_noisy_and_no_peak_is_better(
    rates_hz, noises, coloured_s
):
    rng = np.random.default_rng(4)
    seconds = np.arange(0, 30, 0.001)
    errors, peaks, held = [], [], 0
    for _ in range(40):
        truth, sides = random_signal(rng, len(seconds), 300), []
        for rate_hz, size in zip(rates_hz, noises, strict=True):
            every = slice(int(rng.integers(1000 // rate_hz)), None, 1000 // rate_hz)
            at = seconds[every]
            noise = rng.normal(size=len(at))
            if coloured_s:
                noise = random_signal(rng, len(at), coloured_s * rate_hz)
            sides += [at, truth[every] + size * noise]
        sides[0] = sides[0] + 0.037
        found = lag_of_signals(*sides)
        errors.append(found.offset_s - 0.037)
        held += abs(errors[-1]) <= found.uncertainty_s
        step_s = 1 / max(rates_hz)
        even = [np.arange(0.2, 29.8, step_s)] * 2
        grids = [np.interp(t, *side) for t, side in zip(even, (sides[:2], sides[2:]), strict=True)]
        peaks.append(correlate(*grids, step_s).lag_s - 0.037)
    assert held >= 35
    # the peak is as good where there is little noise, give or take the luck of 40 runs
    assert np.std(errors) < 1.25 * np.std(peaks)
    # not so wide that anything would hold
    assert found.uncertainty_s < 6 * np.std(errors) + 1e-3


@pytest.mark.slow
@pytest.mark.parametrize('noise', [0.0, 0.5])
@pytest.mark.parametrize('gain', [-2.0, 0.5])
def test_signals_of_opposite_sign_are_aligned_and_named(gain, noise):
    rng = np.random.default_rng(6)
    seconds = np.arange(0, 60, 0.01)
    signal = random_signal(rng, len(seconds), 30)
    first, second = (signal + noise * rng.normal(size=len(signal)) for _ in range(2))
    found = lag_of_signals(seconds - 0.037, first, seconds, gain * second)
    assert found.offset_s == pytest.approx(-0.037, abs=2e-2 * noise + 1e-9)
    assert found.sign == np.sign(gain)
    assert found.peak > 0.7
    assert not found.ambiguous


@pytest.mark.slow
def test_a_lag_that_another_explains_as_well_is_called_ambiguous():
    seconds = np.arange(0, 60, 0.01)
    noise = np.random.default_rng(3).normal(0, 0.1, (2, len(seconds)))
    for signal in (np.sin(3 * seconds) + 0.5 * np.sin(6 * seconds), np.sin(20 * seconds), seconds):
        for noisy in (0, 1):
            first, second = signal + noisy * noise
            assert lag_of_signals(seconds - 0.037, first, seconds, second).ambiguous
    for pulse in (
        np.exp(-((seconds - 30) ** 2)),
        random_signal(np.random.default_rng(1), 6000, 90),
    ):
        assert not lag_of_signals(seconds, pulse, seconds, pulse).ambiguous


def test_a_signal_that_never_changes_is_refused():
    seconds = np.arange(100.0)
    with pytest.raises(NoPairs, match='never changes'):
        lag_of_signals(seconds, np.ones(100), seconds, wiggle(seconds))
    with pytest.raises(NoPairs, match='5 and 100 samples'):
        lag_of_signals(seconds[:5], seconds[:5], seconds, wiggle(seconds))
