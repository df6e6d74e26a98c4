"""A suite that has not changed hardly ever fails, however much it compares."""

from dataclasses import replace
from itertools import combinations, product
import math

import numpy as np
import pytest

from vio_eval_ros.comparison.family import adjusted
from vio_eval_ros.comparison.repeated import compare, Rule

METRICS = ('ate_trans_rmse_m', 'ate_rot_rmse_deg', 'rpe_1s_trans_rmse_m')
BEFORE = np.array([0.10, 0.11, 0.09, 0.105, 0.095])
AFTER = np.array([0.104, 0.097, 0.108, 0.092, 0.1])


def suite(random, sequences=11, runs=5, factor=1.0, worse=()):
    """Return the comparisons of each sequence; all metrics of the worse ones have grown."""
    groups = []
    for k in range(sequences):
        shared = random.standard_normal((2, runs))
        group = []
        for metric in METRICS:
            old, new = np.exp(0.07 * (shared + random.standard_normal((2, runs))))
            group.append(compare(Rule(metric), old, new * (factor if k in worse else 1)))
        groups.append(group)
    return groups


def named(groups):
    """Return which comparisons are worse, as sequence and number."""
    return {(k, n) for k, group in enumerate(groups) for n, one in enumerate(group) if one.worse}


def test_one_comparison_is_not_adjusted():
    ((found,),) = adjusted([[compare(Rule(METRICS[0]), BEFORE, 1.3 * BEFORE)]])
    assert found.worse
    assert found.p_adjusted == pytest.approx(2 / 252, abs=0.004)


def test_the_p_value_is_that_of_all_joint_permutations():
    """Two sequences of 3 + 3 runs have 400 joint permutations, which can be listed."""
    sides = [((1.0, 1.05, 1.1), (1.5, 1.4, 1.6)), ((2.0, 2.3, 2.1), (2.2, 2.6, 2.9))]
    groups = [[compare(Rule(METRICS[0], relative=0.0), *each)] for each in sides]
    logs = [np.log(np.array([*new, *old]) / np.median([*new, *old])) for old, new in sides]
    usual = np.median([np.abs(each - np.median(each)).mean() for each in logs])

    def separation(values, chosen):
        new, old = values[list(chosen)], np.delete(values, chosen)
        own = sum(np.abs(side - np.median(side)).sum() for side in (new, old)) / 4
        moved = np.median(np.exp(new)) > np.median(np.exp(old))
        return max(new.mean() - old.mean(), 0) / (own / 2 + usual / 2) if moved else 0

    ways = list(combinations(range(6), 3))
    one, other = ([separation(values, way) for way in ways] for values in logs)
    drawn = np.array(list(product(one, other)))
    true, total = drawn[0], (drawn**4).sum(axis=1)
    assert true[0] > true[1]  # so the first is judged with both, the second alone
    expected = [np.mean(total >= total[0] - 1e-12), np.mean(drawn[:, 1] >= true[1] - 1e-12)]
    expected[1] = max(expected)
    expected = [max(p, one.p_value) for p, (one,) in zip(expected, groups, strict=True)]
    # three standard deviations of a share of 5000
    assert [one.p_adjusted for (one,) in adjusted(groups)] == pytest.approx(expected, abs=0.02)


def test_metrics_that_say_the_same_do_not_count_twice():
    old, new = BEFORE, AFTER * 1.25
    others = [[compare(Rule(METRICS[0]), old, new[::-1] * 0.8)] for _ in range(6)]
    once = adjusted([[compare(Rule(METRICS[0]), old, new)], *others])
    thrice = adjusted([[compare(Rule(metric), old, new) for metric in METRICS], *others])
    assert thrice[0][0].p_adjusted <= once[0][0].p_adjusted


def test_more_comparisons_need_more_evidence():
    random = np.random.default_rng(3)
    groups = suite(random, worse=(0,), factor=1.2)
    alone = adjusted(groups[:1])[0][0].p_adjusted
    assert alone < adjusted(groups)[0][0].p_adjusted


def test_a_stack_without_noise_that_got_worse_everywhere_is_worse_everywhere():
    groups = [[compare(Rule(METRICS[0]), [1.0] * 5, [1.3] * 5)] for _ in range(11)]
    assert len(named(adjusted(groups))) == 11


def test_what_is_three_times_as_bad_is_worse_with_few_runs_too():
    groups = [[compare(Rule(METRICS[0]), BEFORE[:3], AFTER[:3])] for _ in range(10)]
    for runs in (3, 4, 5):
        bad = compare(Rule(METRICS[0]), BEFORE[:runs], 3 * AFTER[:runs])
        assert named(adjusted([[bad], *groups])) == {(0, 0)}
        assert bad.largest_p_adjusted == pytest.approx(
            {3: 0.065, 4: 0.015 + 1 / 70, 5: 0.015}[runs]
        )


def test_an_adjusted_p_of_one_leaves_each_to_itself():
    random = np.random.default_rng(5)
    groups = [suite(random, 1, factor=1.16, worse=(0,))[0] for _ in range(20)]
    loose = [
        [compare(one.rule._replace(p_adjusted=1.0), *one.sides) for one in group]
        for group in groups
    ]
    assert named(adjusted(loose)) == named(loose)
    assert named(adjusted(groups)) < named(groups)
    held = [one for group in adjusted(groups) for one in group if one.may_be_chance]
    assert held
    assert not any(one.worse for one in held)


def test_what_has_no_test_is_left_as_it_is():
    single = compare(Rule(METRICS[0]), [0.1], [0.2])
    gone = compare(Rule(METRICS[1]), BEFORE, [], missing=5)
    found = adjusted([[single], [gone], []])
    assert found == [[single], [gone], []]
    assert math.isnan(found[0][0].p_adjusted)


def test_runs_without_a_value_count_as_the_worst():
    groups = [[compare(Rule(METRICS[0]), BEFORE, AFTER)] for _ in range(5)]
    groups[2] = [compare(Rule(METRICS[0]), BEFORE, 1.4 * AFTER[:4], missing=1)]
    assert named(adjusted(groups)) == {(2, 0)}
    assert adjusted(groups) == adjusted(groups)


def test_nothing_within_its_limits_is_worse():
    groups = [[replace(one, p_adjusted=math.nan) for one in each] for each in suite(
        np.random.default_rng(1), 3, factor=1.1, worse=(0, 1, 2))]  # fmt: skip
    for group in adjusted(groups):
        for one in group:
            assert one.beyond or one.p_adjusted == 1


@pytest.mark.slow
def test_chance_fails_few_suites_and_a_sequence_that_got_worse_is_caught():
    random = np.random.default_rng(11)
    by_itself = sum(bool(named(suite(random))) for _ in range(100))
    assert by_itself > 10
    # of 200 at most 2 %: more than ten is a chance of one in a hundred
    assert sum(bool(named(adjusted(suite(random)))) for _ in range(200)) <= 10
    groups = (adjusted(suite(random, factor=1.3, worse=(4,))) for _ in range(60))
    assert sum(any(k == 4 for k, _ in named(each)) for each in groups) >= 40
