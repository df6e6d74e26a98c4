"""Over sequences, a system is better where its signed ranks are so more than by chance."""

import math

import numpy as np
import pytest
from scipy.stats import wilcoxon

from vio_eval_ros.comparison.signed_ranks import compare_over_sequences


def values(random, sequences=11, factor=1.0):
    """Return the values of two systems on sequences, some of which are much harder."""
    hard = random.lognormal(0, 1, sequences)
    return factor * hard * random.lognormal(0, 0.2, sequences), hard


@pytest.mark.parametrize('sequences', [6, 11, 13])
def test_p_values_are_those_of_scipy(sequences):
    random = np.random.default_rng(sequences)
    one, other = values(random, sequences, 0.85)
    (found,) = compare_over_sequences([one], [other])
    expected = wilcoxon(np.log(one / other), method='exact').pvalue
    assert found.p_value == pytest.approx(expected)
    assert found.p_adjusted == found.p_value


def test_many_sequences_are_judged_by_random_signs():
    one, other = values(np.random.default_rng(1), 40, 0.93)
    (found,) = compare_over_sequences([one], [other])
    expected = wilcoxon(np.log(one / other)).pvalue
    assert found.p_value == pytest.approx(expected, abs=0.01)
    assert [found] == compare_over_sequences([one], [other])


def test_the_ratio_is_the_median_of_all_means_of_two():
    one, other = values(np.random.default_rng(2), 8, 0.8)
    (found,) = compare_over_sequences([one], [other])
    logs = np.log(one / other)
    means = sorted((logs[i] + logs[j]) / 2 for i in range(8) for j in range(i, 8))
    assert found.ratio == pytest.approx(math.exp(np.median(means)))
    # the table of Wilcoxon's test: of 8 values, a sum of ranks of 3 or less is as rare as 2.5 %
    assert found.interval == pytest.approx((math.exp(means[3]), math.exp(means[-4])))
    few = compare_over_sequences([one[:5]], [other[:5]])[0]
    assert all(map(math.isnan, few.interval))


def test_failures_are_worse_than_any_value_and_those_of_both_tell_nothing():
    one, other = np.full(8, 1.0), np.full(8, 1.1)
    (beaten,) = compare_over_sequences([one], [other])
    one[:4] = math.inf
    (failed,) = compare_over_sequences([one], [other])
    assert beaten.p_value == pytest.approx(2 / 256)
    assert failed.p_value > 0.2
    other[:3] = math.inf
    other[3] = math.nan
    (both,) = compare_over_sequences([one], [other])
    assert both.sequences == 4
    (none,) = compare_over_sequences([[math.nan] * 3], [[1.0] * 3])
    assert (none.sequences, none.p_value) == (0, 1)
    assert math.isnan(none.ratio)


def test_equal_values_are_no_difference():
    (found,) = compare_over_sequences([[1.0, 0.0, 3.0]], [[1.0, 0.0, 3.0]])
    assert (found.ratio, found.p_value) == (1, 1)


def test_metrics_that_say_the_same_are_not_adjusted_for():
    one, other = values(np.random.default_rng(3), 11, 0.8)
    (alone,) = compare_over_sequences([one], [other])
    three = compare_over_sequences([one] * 3, [other] * 3)
    assert {each.p_adjusted for each in three} == {alone.p_value}
    mixed = compare_over_sequences([one, *np.ones((2, 11))], [other, *np.ones((2, 11))])
    assert mixed[0].p_adjusted == pytest.approx(alone.p_value)


@pytest.mark.slow
def test_chance_rarely_tells_in_any_metric_and_the_interval_holds():
    random = np.random.default_rng(4)
    told, held = [], []
    for _ in range(200):
        pairs = [values(random) for _ in range(3)]
        found = compare_over_sequences([p[0] for p in pairs], [p[1] for p in pairs])
        told.append(any(each.p_adjusted <= 0.02 for each in found))
        held += [each.interval[0] <= 1 <= each.interval[1] for each in found]
    # of 2 % and 95 %, three standard deviations
    assert np.mean(told) <= 0.05
    assert 0.92 <= np.mean(held) <= 0.98
