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


def test_a_signal_that_never_changes_is_refused():
    seconds = np.arange(100.0)
    with pytest.raises(NoPairs, match='never changes'):
        lag_of_signals(seconds, np.ones(100), seconds, wiggle(seconds))
    with pytest.raises(NoPairs, match='5 and 100 samples'):
        lag_of_signals(seconds[:5], seconds[:5], seconds, wiggle(seconds))
