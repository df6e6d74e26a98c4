"""Two single runs differ only where their errors hold enough independent pieces to tell."""

import math
import time

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import bootstrap

from vio_eval_ros.comparison.paired import (
    _autocovariances,
    _block_length,
    _block_means,
    compare_errors,
    compare_runs,
    errors_over_time,
    LEAST_PIECES,
    shared,
)
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.evaluation.recorded import score_run
from vio_eval_ros.recordings.sources import Source
from vio_eval_ros.simulation import simulate


def remembering(random, count, memory, scale=1.0):
    """Return the lengths of vectors of an Ornstein-Uhlenbeck process with a memory in samples."""
    decay = math.exp(-1 / memory) if memory else 0.0
    noise = random.standard_normal((count, 3)) * math.sqrt(1 - decay**2)
    noise[0] = random.standard_normal(3)
    return scale * np.linalg.norm(lfilter([1], [1, -decay], noise, axis=0), axis=1)


def test_independent_errors_are_resampled_as_scipy_does():
    random = np.random.default_rng(1)
    one, other = remembering(random, 800, 0), remembering(random, 800, 0, 1.05)
    found = compare_errors(one, other)

    def difference(one, other, axis):
        return np.sqrt(np.mean(one**2, axis)) - np.sqrt(np.mean(other**2, axis))

    expected = bootstrap(
        (one, other), difference, paired=True, vectorized=True, n_resamples=4999, method='BCa'
    )
    assert found.difference == pytest.approx(difference(one, other, 0))
    assert found.interval == pytest.approx(expected.confidence_interval, abs=0.012)
    assert found.ratio == pytest.approx(math.sqrt(np.mean(one**2) / np.mean(other**2)))
    assert found.ratio_interval[0] < found.ratio < found.ratio_interval[1]


def test_the_other_way_round_is_the_opposite():
    random = np.random.default_rng(2)
    one, other = remembering(random, 3000, 3), remembering(random, 3000, 3, 1.1)
    found, turned = compare_errors(one, other), compare_errors(other, one)
    assert turned.difference == -found.difference
    assert turned.interval == pytest.approx([-found.interval[1], -found.interval[0]])
    assert turned.ratio == pytest.approx(1 / found.ratio)
    assert turned.p_value == pytest.approx(found.p_value)
    assert found == compare_errors(one, other)


@pytest.mark.parametrize('rooted', [True, False])
def test_a_clear_difference_tells_in_any_unit(rooted):
    random = np.random.default_rng(3)
    one, other = remembering(random, 4000, 5), remembering(random, 4000, 5, 1.5)
    found, scaled = (compare_errors(k * one, k * other, rooted) for k in (1, 1000))
    assert found.p_value < 0.002
    assert found.interval[1] < 0
    assert found.ratio_interval[1] < 1
    assert scaled.interval == pytest.approx([1000 * end for end in found.interval])
    assert scaled.ratio_interval == pytest.approx(found.ratio_interval)


def test_what_both_runs_share_does_not_blur_their_difference():
    random = np.random.default_rng(4)
    common = remembering(random, 5000, 10)
    own = [common * (1 + 0.02 * random.standard_normal(5000)) for _ in range(2)]
    apart = compare_errors(own[0], 1.02 * own[1])
    mixed = compare_errors(own[0], 1.02 * np.roll(own[1], 2500))
    assert np.diff(apart.interval) < np.diff(mixed.interval) / 5
    assert apart.p_value < 0.002 < mixed.p_value


def test_a_drift_does_not_tell_however_densely_it_is_sampled():
    random = np.random.default_rng(5)
    for count in (300, 3000, 30_000):
        one, other = np.cumsum(random.standard_normal((2, count, 3)), axis=1) / math.sqrt(count)
        one, other = (np.linalg.norm(each - each.mean(0), axis=1) for each in (one, other))
        found = compare_errors(one, 2 * other)
        assert found.pieces < LEAST_PIECES
        assert math.isnan(found.p_value)
        assert math.isnan(found.interval[0])
        assert found.difference < 0


def test_repeating_every_error_adds_no_pieces():
    random = np.random.default_rng(6)
    one, other = remembering(random, 1000, 4), remembering(random, 1000, 4)
    once = compare_errors(one, other)
    often = compare_errors(np.repeat(one, 8), np.repeat(other, 8))
    assert often.pieces == pytest.approx(once.pieces, rel=0.2)
    width = float(np.diff(once.interval)[0])
    assert np.diff(often.interval)[0] == pytest.approx(width, rel=0.15)


def test_equal_and_degenerate_errors_are_no_difference():
    errors = remembering(np.random.default_rng(7), 500, 2)
    same = compare_errors(errors, errors)
    assert (same.difference, same.interval, same.p_value) == (0, (0, 0), 1)
    for count in (1, 2, 30):
        few = compare_errors(errors[:count], 2 * errors[:count])
        assert math.isnan(few.p_value)
    multiple = compare_errors(errors, 1.5 * errors)
    assert multiple.ratio_interval == pytest.approx((1 / 1.5, 1 / 1.5))
    assert multiple.interval[1] < 0
    constant = compare_errors(np.full(500, 0.1), np.full(500, 0.2))
    assert math.isnan(constant.p_value)
    nothing = compare_errors(np.zeros(500), errors)
    assert math.isnan(nothing.p_value)
    assert nothing.ratio == 0


def test_blocks_are_as_long_as_theory_has_them():
    """Politis and White: (2 G² / D)^(1/3) N^(1/3), where D = 4/3 g²."""
    random = np.random.default_rng(8)
    decay, count = 0.9, 4096
    # of autocovariances decay^|k|: G = sum |k| decay^|k|, g = sum decay^|k|
    slope, level = 2 * decay / (1 - decay) ** 2, (1 + decay) / (1 - decay)
    expected = (1.5 * slope**2 / level**2 * count) ** (1 / 3)
    found = []
    for _ in range(40):
        series = lfilter([1], [1, -decay], random.standard_normal(count))
        length, share = _block_length(series - series.mean())
        found.append((length, share))
    length, share = np.median(found, axis=0)
    assert length == pytest.approx(expected, rel=0.25)
    assert share == pytest.approx(1 / level, rel=0.25)


def test_autocovariances_and_blocks_are_those_of_their_definitions():
    series = np.random.default_rng(9).standard_normal(50)
    centred = series - series.mean()
    expected = [centred[: 50 - k] @ centred[k:] / 50 for k in range(50)]
    assert _autocovariances(series) == pytest.approx(expected)
    circle = [np.mean(np.roll(series, -k)[:7]) for k in range(50)]
    assert _block_means(series, 7) == pytest.approx(circle)


def test_errors_are_paired_by_stamps_of_the_truth():
    one, other = np.array([0, 10, 20, 30, 40]), np.array([1, 20, 22, 29, 38, 300])
    assert [list(index) for index in shared(one, other, 0)] == [[0, 2, 3, 4], [0, 1, 3, 4]]
    assert [list(index) for index in shared(other, one, 0)] == [[0, 1, 3, 4], [0, 2, 3, 4]]
    assert [len(index) for index in shared(one, one + 1000, 0)] == [0, 0]
    # two that take every other frame in turn, and one that takes all
    frames = 50 * np.arange(20)
    for halves in (shared(frames[::2], frames[1::2], 20), shared(frames[1::2], frames, 20)):
        assert len(halves[0]) == len(halves[1]) >= 9


@pytest.fixture(scope='module')
def runs():
    """Return two results on one truth, the second at half the rate."""
    found = []
    for seed, step in ((1, 1), (2, 2)):
        flight = simulate(60.0, seed=seed)
        truth, estimate = simulate(60.0, seed=1).ground_truth, flight.estimate[::step]
        sources = (Source('e', 'tum', (), estimate), Source('t', 'tum', (), truth))
        found.append(score_run(*sources, EvaluationConfig(rpe_deltas=('1s', '5m')), hashed=False))
    return found


@pytest.mark.parametrize(
    'metric',
    [
        'ate_trans_rmse_m', 'ate_trans_mean_m', 'ate_rot_rmse_deg', 'ate_none_trans_rmse_m',
        'ate_sim3_trans_rmse_m', 'rpe_1s_trans_rmse_m', 'rpe_1s_rot_mean_deg',
        'rpe_5m_disp_rmse_m',
    ],
)  # fmt: skip
def test_the_errors_of_a_metric_are_those_it_is_computed_of(runs, metric):
    for run in runs:
        stamps, errors = errors_over_time(run, metric)
        value = math.sqrt(np.mean(errors**2)) if 'rmse' in metric else np.mean(errors)
        assert value == pytest.approx(run.summary.metrics[metric])
        assert len(stamps) == len(errors)
    found = compare_runs(*runs, metric)
    assert 0 < found.pairs <= len(runs[1].summary.pairs)
    assert found.interval[0] <= found.difference <= found.interval[1] or math.isnan(found.p_value)


def test_what_is_no_mean_of_errors_is_not_compared(runs):
    for metric in ('coverage_ratio', 'ate_trans_max_m', 'kitti_trans_percent', 'drift_percent'):
        assert compare_runs(*runs, metric) is None


def test_a_long_run_takes_no_longer_than_a_blink():
    random = np.random.default_rng(10)
    for count in (36_000, 1_000_000):
        one, other = np.abs(random.standard_normal((2, count)))
        begin = time.process_time()
        compare_errors(one, other)
        assert time.process_time() - begin < 0.3


@pytest.mark.slow
@pytest.mark.parametrize('memory', [0, 5, 25])
def test_intervals_hold(memory):
    random = np.random.default_rng(11)
    true = math.sqrt(3) * (1 - 1.2)
    held = []
    for _ in range(150):
        one, other = remembering(random, 3000, memory), remembering(random, 3000, memory, 1.2)
        low, high = compare_errors(one, other).interval
        held.append(low <= true <= high)
    # 95 % of 150 within three standard deviations
    assert 0.897 <= np.mean(held) <= 1
