"""
Many comparisons at once: how often chance alone makes any of them stand out.

Of eleven sequences with three metrics each, one in three suites would have a significant
difference at 1 % if nothing had changed. What is adjusted here states for each comparison how
often an unchanged stack would have one like it anywhere in the suite.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.comparison.direction import worse_sign
from vio_eval_ros.comparison.repeated import (
    divisions,
    finite_values,
    MetricComparison,
    SEED,
    trimmed_mean,
)

RESAMPLES = 4999
#: variance of the logarithm of a mean absolute deviation, times the number of values (normal)
SAMPLING = math.pi / 2 - 1
#: what is expected of the variance of these logarithms, over that by chance, and how many
#: comparisons this counts as: few cannot tell whether their spreads differ
PRIOR_VARIANCE, PRIOR_WEIGHT = 4.0, 5.0
#: spreads of logarithms below this are as good as none
LEAST_SPREAD = 1e-3
#: of separations, in what a set of comparisons is judged by: between their sum, for many that are
#: a little worse, and their maximum, for one that is much worse
POWER = 4


def adjusted(groups: Sequence[Sequence[MetricComparison]]) -> list[list[MetricComparison]]:
    """
    Return comparisons with p-values that are adjusted for all of them, and whether they are worse.

    A step-down permutation test (Westfall and Young, Resampling-Based Multiple Testing, 1993,
    section 2.8; Romano and Wolf 2005, doi:10.1198/016214504000000539): runs change sides within a
    sequence, all its metrics together, so that metrics may depend on each other in any way. The
    statistic of a set is the sum of :data:`POWER`-th powers of the separations, each of which is
    zero within the limits of its rule. The adjusted p-value of the largest separation is the share
    of permutations with such a statistic; then it leaves the set, and so on.

    :param groups: the comparisons of each sequence; those without a test stay as they are.
    """
    tested = [
        (k, n)
        for k, group in enumerate(groups)
        for n, one in enumerate(group)
        if not math.isnan(one.p_value)
    ]
    found = [list(group) for group in groups]
    p_values = _stepped_down([(k, groups[k][n]) for k, n in tested])
    for (k, n), p_value in zip(tested, p_values, strict=True):
        one = found[k][n]
        p_value = max(p_value, one.p_value)
        worse = one.worse and p_value <= one.largest_p_adjusted
        found[k][n] = replace(one, p_adjusted=p_value, worse=worse)
    return found


def _stepped_down(comparisons: Sequence[tuple[int, MetricComparison]]) -> list[float]:
    """Return the adjusted p-values of comparisons, each with the number of its sequence."""
    p_values = [1.0] * len(comparisons)
    if not any(one.beyond for _, one in comparisons):
        return p_values
    rest, p_value = np.zeros(RESAMPLES + 1), 0.0
    beyond: dict[int, np.ndarray] = {}
    for k, separations in enumerate(_separations(comparisons)):
        powers = separations**POWER
        rest += powers
        if powers[0] > 0:
            beyond[k] = powers
    for k in sorted(beyond, key=lambda k: -beyond[k][0]):
        # the first is the true division; equal ones may differ from it in the last bits
        p_value = max(p_value, float(np.mean(rest >= rest[0] * (1 - 1e-9))))
        p_values[k] = p_value
        rest -= beyond[k]
    return p_values


def _separations(comparisons: Sequence[tuple[int, MetricComparison]]) -> Iterator[np.ndarray]:
    """Yield the (R,) separations of each comparison over permutations, the true one first."""
    usual = _Spreads.of([one for _, one in comparisons])
    orders: dict[tuple[int, int, int], np.ndarray] = {}
    for sequence, one in comparisons:
        values = finite_values(*one.sides)
        size = len(one.sides[1])
        key = sequence, len(values), size
        if key not in orders:
            random = np.random.default_rng([SEED, *key])
            ways = divisions(len(values), size)
            chosen = random.integers(len(ways), size=RESAMPLES + 1)
            chosen[0] = 0
            orders[key] = ways[chosen]
        yield _separated(one, orders[key], usual)


class _Spreads(NamedTuple):
    """
    How the spreads of comparisons are distributed.

    :param usual: the median of the spreads of logarithms.
    :param own: 1 where they differ so much that each has its own, 0 where no more than by chance.
    """

    usual: float
    own: float

    @classmethod
    def of(cls, comparisons: Sequence[MetricComparison]) -> _Spreads:
        """Return it; no permutation of runs within a comparison changes it."""
        values = [one.logarithms for one in comparisons]
        spreads = np.array([np.abs(each - np.median(each)).mean() for each in values])
        logarithms = np.log(np.maximum(spreads, LEAST_SPREAD))
        by_chance = SAMPLING * float(np.mean([1 / len(each) for each in values]))
        squares = float(np.square(logarithms - logarithms.mean()).sum())
        expected = PRIOR_WEIGHT * PRIOR_VARIANCE * by_chance
        variance = (squares + expected) / (len(values) - 1 + PRIOR_WEIGHT)
        return cls(math.exp(float(np.median(logarithms))), max(1 - by_chance / variance, 0.0))

    def shrunk(self, spreads: np.ndarray) -> np.ndarray:
        """Return spreads nearer to the usual one, by as much as their differences are chance."""
        own = np.maximum(spreads, LEAST_SPREAD)
        return np.asarray(self.usual ** (1 - self.own) * own**self.own)


def _separated(one: MetricComparison, orders: np.ndarray, usual: _Spreads) -> np.ndarray:
    """
    Return how far each division of the runs separates the sides, in spreads of their logarithms.

    :param orders: (R, runs) indices, those of the candidate first.
    :param usual: towards which the own spread is shrunk, since that of few runs is too uncertain
        to divide by (as in Smyth 2004, doi:10.2202/1544-6115.1027).
    """
    sign, size = worse_sign(one.rule.metric), len(one.sides[1])
    values = finite_values(*one.sides)[orders]
    new_median, old_median = (
        np.median(side, axis=1) for side in (values[:, :size], values[:, size:])
    )
    rule = one.rule
    # by the baseline of each division: else the true one would be judged by other limits
    allowed = np.maximum(rule.relative * np.abs(old_median), rule.absolute)
    if rule.mad:
        deviations = np.abs(values[:, size:] - old_median[:, None])
        allowed = np.maximum(allowed, rule.mad * np.median(deviations, axis=1))
    separations = np.zeros(len(orders))
    beyond = np.flatnonzero(sign * (new_median - old_median) > allowed * (1 + 1e-12))
    beyond = beyond if one.beyond == (0 in beyond) else np.union1d(beyond, [0])
    logarithms = one.logarithms[orders[beyond]]
    new, old = logarithms[:, :size], logarithms[:, size:]
    deviations = np.hstack([side - np.median(side, axis=1, keepdims=True) for side in (new, old)])
    own = np.abs(deviations).sum(axis=1) / max(values.shape[1] - 2, 1)
    apart = sign * (trimmed_mean(new) - trimmed_mean(old)) / usual.shrunk(own)
    separations[beyond] = apart.clip(min=0)
    return separations
