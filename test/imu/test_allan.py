"""The Allan deviation is allantools', whatever segments there are, and its scatter is known."""

import allantools
import numpy as np
import pytest

from vio_eval_ros.imu.allan import allan_curve, Variances
from vio_eval_ros.imu.simulated_noise import Noise, simulate_axis

NOISE = Noise(density=2e-3, walk=3e-3)


def signal(count, seed=1, noise=NOISE, rate_hz=100.0):
    return simulate_axis(count, rate_hz, noise, np.random.default_rng(seed))


def test_the_curve_is_that_of_oadev():
    values = 9.81 + signal(20_000)
    curve = allan_curve([values], 100.0)
    taus_s, deviations, _, terms = allantools.oadev(values, 100.0, 'freq', curve.taus_s)
    np.testing.assert_array_equal(curve.terms, terms)
    np.testing.assert_allclose(curve.taus_s, taus_s, rtol=1e-12)
    np.testing.assert_allclose(curve.deviations, deviations, rtol=1e-9)


def test_averaging_times_go_from_one_sample_to_a_quarter_of_the_record():
    curve = allan_curve([signal(20_000)], 100.0)
    assert curve.taus_s[0] == 0.01
    assert 39 < curve.taus_s[-1] <= 50
    assert (np.diff(curve.taus_s) > 0).all()


def test_segments_are_pooled_by_their_numbers_of_differences():
    parts = [signal(8_000, 1), 5 + signal(4_000, 2)]
    curve = allan_curve(parts, 100.0)
    squares = np.zeros(len(curve.factors))
    for part in parts:
        phase = np.concatenate([[0], np.cumsum(part)])
        for index, m in enumerate(curve.factors):
            second = phase[2 * m :] - 2 * phase[m:-m] + phase[: -2 * m]
            squares[index] += second @ second / (2 * m**2)
    np.testing.assert_allclose(curve.variances, squares / curve.terms, rtol=1e-6)


def test_a_jump_of_the_mean_between_segments_does_not_matter():
    values = signal(8_000)
    apart = allan_curve([values, 100 + values], 100.0)
    np.testing.assert_allclose(apart.deviations, allan_curve([values] * 2, 100.0).deviations)


def test_averaging_times_beyond_what_most_segments_hold_are_left_out():
    curve = allan_curve([signal(1_000, seed) for seed in range(10)], 100.0)
    assert curve.taus_s[-1] <= 2.5


def test_too_few_samples_give_an_empty_curve():
    assert len(allan_curve([np.zeros(2)], 100.0).factors) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ('noise', 'model'),
    [
        (Noise(2e-3, 0.0), Variances(4e-6, 0.0, 0.0)),
        (Noise(2e-3, 3e-3), Variances(4e-6, 0.0, 9e-6)),
        (Noise(1e-3, 0.0, 2e-3), Variances(1e-6, 4e-6, 0.0)),
    ],
)
def test_the_covariance_is_how_simulated_curves_scatter(noise, model):
    curves = [allan_curve([signal(4_000, seed, noise)], 100.0) for seed in range(300)]
    variances = np.array([curve.variances for curve in curves])
    known = 4 * curves[0].terms >= 3 * curves[0].samples  # what is fitted
    predicted = curves[0].covariance(model)[np.ix_(known, known)]
    found = np.cov(variances[:, known].T)
    np.testing.assert_allclose(np.sqrt(np.diag(found) / np.diag(predicted)), 1, atol=0.17)
    spread = np.sqrt(np.diag(predicted))
    np.testing.assert_allclose(
        found / np.sqrt(np.outer(np.diag(found), np.diag(found))),
        predicted / np.outer(spread, spread),
        atol=0.25,
    )
