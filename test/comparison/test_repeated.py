"""Worse than a baseline is what is worse beyond the noise."""

import math

import numpy as np
import pytest
from scipy.stats import bootstrap, permutation_test, trim_mean

from vio_eval_ros.comparison import repeated
from vio_eval_ros.comparison.direction import worse_sign
from vio_eval_ros.comparison.repeated import compare, Distribution, Rule
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.core.evaluation import metric_names

ATE = Rule('ate_trans_rmse_m')
BEFORE = [0.10, 0.11, 0.09, 0.105, 0.095]


def test_a_distribution_is_reported_as_median_and_its_absolute_deviation():
    # deviations from 0.10 are 0, 0.01, 0.01, 0.005, 0.005
    found = Distribution(tuple(BEFORE)).to_dict()
    assert found == pytest.approx({'median': 0.1, 'mad': 0.005, 'min': 0.09, 'max': 0.11, 'n': 5})
    nothing = Distribution(()).to_dict()
    assert nothing.pop('n') == 0
    assert all(math.isnan(value) for value in nothing.values())


def test_the_same_runs_are_not_worse():
    found = compare(ATE, BEFORE, BEFORE)
    assert not found.worse
    assert found.difference == 0
    assert found.allowed == pytest.approx(0.016)
    assert found.p_value > 0.5
    assert found.interval[0] < 0 < found.interval[1]


def test_runs_that_are_all_a_third_worse_are_worse():
    found = compare(ATE, BEFORE, [1.3 * value for value in BEFORE])
    assert found.worse
    assert found.difference == pytest.approx(0.03)
    # of the 252 ways to choose five of ten. Exchanging the worst before with the best after, which
    # the trimmed means leave out, sets the means less far apart
    assert found.p_value == pytest.approx(1 / 252)
    assert 0 < found.interval[0] < 0.03 < found.interval[1]


def test_runs_that_give_the_same_every_time_are_worse_where_they_differ():
    found = compare(ATE, [0.1] * 5, [0.13] * 5)
    assert found.p_value == pytest.approx(1 / 252)
    assert found.worse
    assert not compare(ATE, [0.1] * 5, [0.1] * 5).worse


def test_better_is_never_worse():
    assert not compare(ATE, BEFORE, [0.5 * value for value in BEFORE]).worse


def test_a_median_that_is_worse_by_chance_is_not_worse():
    noisy = [0.02, 0.21, 0.12, 0.03, 0.13]
    found = compare(ATE, BEFORE, noisy)
    assert found.difference > found.allowed
    assert found.p_value > 0.05
    assert not found.worse


def test_runs_that_are_surely_but_hardly_worse_are_not_worse():
    found = compare(ATE, [0.100, 0.101, 0.102, 0.103, 0.104], [0.105, 0.106, 0.107, 0.108, 0.109])
    assert found.p_value == pytest.approx(1 / 252)
    assert found.difference < found.allowed
    assert not found.worse


def test_one_run_that_went_wrong_does_not_make_the_others_worse():
    assert not compare(ATE, BEFORE, [*BEFORE[1:], 3.0]).worse


@pytest.mark.parametrize(
    ('rule', 'allowed'),
    [
        (Rule('ate_trans_rmse_m', relative=0.5), 0.05),
        (Rule('ate_trans_rmse_m', relative=0, absolute=0.02), 0.02),
        (Rule('ate_trans_rmse_m', relative=0, mad=3), 0.015),
        (Rule('ate_trans_rmse_m', relative=0.1, absolute=0.02, mad=5), 0.025),
    ],
)
def test_all_limits_of_a_rule_must_be_exceeded(rule, allowed):
    assert compare(rule, BEFORE, BEFORE).allowed == pytest.approx(allowed)
    for more, worse in ((0.9, False), (1.1, True)):
        after = [value + more * allowed for value in BEFORE]
        assert compare(rule, BEFORE, after).worse is worse


def test_of_ratios_less_is_worse():
    before, less = [0.99, 0.98, 0.97, 0.99, 0.98], [0.7, 0.71, 0.69, 0.7, 0.72]
    assert compare(Rule('coverage_ratio'), before, less).worse
    assert not compare(Rule('coverage_ratio'), less, before).worse


def test_every_metric_is_worse_one_way_or_cannot_be_compared():
    config = EvaluationConfig(segment_lengths_m=(100,))
    ways = {name: worse_sign(name) for name in metric_names(config)}
    assert ways['ate_trans_rmse_m'] == ways['rpe_1s_rot_p95_deg'] == ways['drift_percent'] == 1
    assert ways['kitti_rot_deg_per_m'] == ways['loop_closure_gain'] == 1
    assert ways['coverage_ratio'] == ways['matched_ratio'] == -1
    neither = {name for name, way in ways.items() if way == 0}
    assert {'sim3_scale', 'path_length_m', 'nees_position_mean', 'rpe_1f_pairs'} <= neither
    assert not any('_trans_' in name or '_rot_' in name for name in neither)


def test_no_number_any_more_is_worse_and_no_number_yet_is_not():
    gone = compare(ATE, BEFORE, [])
    assert gone.worse
    assert math.isnan(gone.difference)
    assert all(math.isnan(bound) for bound in gone.interval)
    assert not compare(ATE, [], BEFORE).worse
    assert not compare(ATE, [], []).worse


def test_runs_without_a_number_are_worse_than_any_other():
    assert not compare(ATE, BEFORE, BEFORE, missing=1).worse
    found = compare(ATE, BEFORE, [0.13, 0.135, 0.14, 0.145], missing=1)
    assert found.difference == pytest.approx(0.04)  # of five, the last of which is beyond
    assert found.worse
    assert math.isnan(found.interval[0])
    found = compare(ATE, BEFORE, BEFORE[:2], missing=3)
    assert found.worse
    assert math.isnan(found.difference)
    coverage = [0.99, 0.98, 0.97, 0.99, 0.98]
    assert compare(Rule('coverage_ratio'), coverage, coverage[:2], missing=3).worse
    assert not compare(Rule('coverage_ratio'), coverage, coverage, missing=1).worse
    assert not compare(ATE, [], [], missing=5).worse


def test_a_stricter_p_never_makes_more_runs_worse():
    random = np.random.default_rng(8)
    levels = (1.0, 0.2, 0.05, 0.02, 0.0039, 0.001, 0.0)
    for before, after in ((5, 5), (3, 3), (2, 2), (5, 1)):
        for _ in range(50):
            old, new = random.normal(1, 0.1, before), random.normal(1.2, 0.1, after)
            worse = [compare(ATE._replace(p=p), old, new).worse for p in levels]
            assert worse == sorted(worse, reverse=True)
    assert not compare(ATE._replace(p=0.001), BEFORE, [10 * value for value in BEFORE]).worse


def test_a_test_that_contradicts_the_medians_is_noticed():
    one_wrong = compare(ATE, [0.1, 0.1, 0.1, 3.0], [0.3] * 4)
    assert one_wrong.contradicted
    assert not one_wrong.worse
    assert not compare(ATE, BEFORE, [3 * value for value in BEFORE]).contradicted
    assert not compare(ATE, BEFORE, BEFORE).contradicted
    # of five, one does not count
    assert compare(ATE, [0.1, 0.11, 0.1, 0.12, 3.0], [0.3] * 5).worse


def test_too_few_runs_to_test_are_compared_by_the_limits_alone():
    # one of two, and two of four, are one of 2 and of 6 outcomes: never as rare as 0.05
    for before, after in (([0.1], [0.13]), ([0.1, 0.11], [0.14, 0.15])):
        found = compare(ATE, before, after)
        assert math.isnan(found.p_value)
        assert found.worse
    assert math.isnan(compare(ATE, [0.1], [0.13]).interval[0])
    assert not compare(ATE, [0.1], [0.11]).worse
    # three of six are one of 20
    assert compare(ATE, BEFORE[:3], [0.2, 0.3, 0.4]).p_value == pytest.approx(0.05)
    assert compare(ATE, BEFORE[:3], [0.2, 0.3, 0.4]).worse
    assert not compare(ATE, BEFORE[:3], [0.2, 0.3, 0.1]).worse


@pytest.mark.parametrize(('before', 'after'), [(5, 5), (3, 7), (8, 4)])
def test_p_values_are_those_of_scipy(before, after):
    random = np.random.default_rng(3)
    old, new = 1 + 0.1 * random.random(before), 1.05 + 0.1 * random.random(after)
    expected = permutation_test(
        (new, old),
        lambda one, other, axis: (
            trim_mean(one, 0.2, axis)
            - trim_mean(other, 0.2, axis)
            + 1e-9 * (np.mean(one, axis) - np.mean(other, axis))
        ),
        vectorized=True,
        alternative='greater',
        n_resamples=np.inf,
    ).pvalue
    assert compare(ATE, old, new).p_value == pytest.approx(expected)


def test_of_many_runs_the_p_value_is_that_of_random_orders(monkeypatch):
    random = np.random.default_rng(4)
    old, new = 1 + 0.1 * random.random(6), 1.04 + 0.1 * random.random(6)
    exact = compare(ATE, old, new).p_value
    assert exact == pytest.approx(compare(ATE, old, new).p_value)
    monkeypatch.setattr(repeated, 'RESAMPLES', 900)  # fewer than the 924 orders there are
    # three standard deviations of a share of 900
    assert compare(ATE, old, new).p_value == pytest.approx(
        exact, abs=3 * math.sqrt(exact * (1 - exact) / 900)
    )
    assert compare(ATE, old, new) == compare(ATE, old, new)


def test_the_interval_is_that_of_a_bootstrap():
    random = np.random.default_rng(5)
    old, new = 1 + 0.1 * random.standard_normal(9), 1.2 + 0.1 * random.standard_normal(9)
    drawn = bootstrap(
        (new, old),
        lambda one, other, axis: np.median(one, axis=axis) - np.median(other, axis=axis),
        vectorized=True,
        n_resamples=20_000,
        method='percentile',
    ).bootstrap_distribution
    # medians of nine values take few values, so a percentile may lie on either side of a step
    for end, share in zip(compare(ATE, old, new).interval, (0.025, 0.975), strict=True):
        low, high = np.quantile(drawn, [share - 0.006, share + 0.006])
        assert low <= end <= high


@pytest.mark.slow
@pytest.mark.parametrize('draw', ['normal', 'lognormal', 'standard_t'])
def test_false_alarms_are_rare_and_what_got_worse_is_caught(draw):
    random = np.random.default_rng(6)

    def runs(factor: float) -> np.ndarray:
        if draw == 'standard_t':  # 3 degrees of freedom: a standard deviation of √3
            return factor * (1 + 0.1 / math.sqrt(3) * random.standard_t(3, 5))
        if draw == 'lognormal':
            return factor * random.lognormal(0, 0.1, 5)
        return factor * random.normal(1, 0.1, 5)

    failed = {factor: sum(compare(ATE, runs(1), runs(factor)).worse for _ in range(500))
              for factor in (1.0, 1.3)}  # fmt: skip
    assert failed[1.0] <= 10
    assert failed[1.3] >= 450
