"""
Whether a metric became worse: repeated runs of a baseline against those of a candidate.

A stack is not deterministic, so each side is a distribution over runs. A metric is worse when its
median moved by more than a rule allows, and a permutation test finds such a difference unlikely by
chance. The test compares means trimmed of the outermost fifth on either side: they resist outliers
as medians do, but the medians of five runs take too few values to test with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations
import math
from typing import Any, NamedTuple

import numpy as np

from vio_eval_ros.comparison.direction import worse_sign

RESAMPLES = 9999
SEED = 0
CONFIDENCE = 0.95
#: share of the values that a mean leaves out at either end
TRIMMED = 0.2
DEFAULT_P = 0.05
#: how often chance may tell anything in a whole family of comparisons
FAMILY_P = 0.02
#: of a build, a little less: measured rates of unchanged stacks shall not be above that
BUILD_P = 0.015
#: stands in for the value of a run without one, in multiples of the largest known value
MISSING_VALUE = 1e3


class Rule(NamedTuple):
    """
    When a metric is worse than the baseline's.

    Its median must be worse by more than each of ``relative`` (times the baseline's median),
    ``absolute`` and ``mad`` (times the baseline's median absolute deviation), and the p-value
    of that must be at most ``p``. Among the comparisons of a suite, ``p_adjusted`` bounds the
    probability that chance makes any of them as bad; 1 leaves each to itself.
    """

    metric: str
    relative: float = 0.16
    absolute: float = 0.0
    mad: float = 0.0
    p: float = DEFAULT_P
    p_adjusted: float = BUILD_P


@dataclass(frozen=True)
class Distribution:
    """The values of a metric over repeated runs; empty where no run has one."""

    values: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median; NaN where there are no values."""
        return float(np.median(self.values)) if self.values else math.nan

    @property
    def mad(self) -> float:
        """Median absolute deviation from the median; NaN where there are no values."""
        if not self.values:
            return math.nan
        return float(np.median(np.abs(np.array(self.values) - self.median)))

    def to_dict(self) -> dict[str, float]:
        """Return the summary of the distribution as results have it."""
        least, most = (min(self.values), max(self.values)) if self.values else (math.nan,) * 2
        return {
            'median': self.median,
            'mad': self.mad,
            'min': least,
            'max': most,
            'n': len(self.values),
        }


@dataclass(frozen=True)
class MetricComparison:
    """
    A metric of the candidate compared with the baseline.

    :param missing: runs of the candidate without a value; each counts as worse than any other.
    :param difference: of the medians, candidate minus baseline; NaN where either is unknown.
    :param allowed: by how much it may be worse.
    :param p_value: one-sided; NaN where there are too few runs for a test.
    :param p_adjusted: for all comparisons of a suite, see :mod:`vio_eval_ros.comparison.family`;
        NaN where it is not part of one.
    """

    rule: Rule
    baseline: Distribution
    candidate: Distribution
    missing: int
    difference: float
    allowed: float
    p_value: float
    worse: bool
    p_adjusted: float = math.nan

    @property
    def sides(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """The runs of the baseline and of the candidate, those without a value being infinite."""
        worst = worse_sign(self.rule.metric) * math.inf
        return self.baseline.values, (*self.candidate.values, *[worst] * self.missing)

    @cached_property
    def logarithms(self) -> np.ndarray:
        """Logarithms of the runs over their median, within limits; the candidate first."""
        values = finite_values(*self.sides)
        usual = float(np.median(np.abs(values))) or 1.0
        return np.log(np.clip(values / usual, 1 / MISSING_VALUE, MISSING_VALUE))

    @property
    def beyond(self) -> bool:
        """Whether the median is worse by more than is allowed, significantly or not."""
        return worse_sign(self.rule.metric) * self.difference > self.allowed

    @property
    def largest_p_adjusted(self) -> float:
        """
        The largest adjusted p-value of what is worse.

        It is that of the rule; where so few runs can hardly reach that, it is more by the smallest
        p-value that they can have: else no change whatever could be worse.
        """
        limit, least = self.rule.p_adjusted, self.least_p_value
        return limit + least if 2 * least > limit else limit

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Bootstrap confidence interval (95 %) of the difference; NaN for single runs."""
        if self.missing or min(len(self.baseline.values), len(self.candidate.values)) < 2:
            return math.nan, math.nan
        return _interval(self.baseline.values, self.candidate.values)

    @property
    def relative_difference(self) -> float:
        """The difference as a share of the baseline; NaN where that is 0 or unknown."""
        return self.difference / self.baseline.median if self.baseline.median else math.nan

    @property
    def least_p_value(self) -> float:
        """The smallest p-value that so many runs can have."""
        return _least_p_value(len(self.baseline.values), len(self.candidate.values) + self.missing)

    @property
    def contradicted(self) -> bool:
        """Whether the median is worse than allowed, but not the trimmed mean that is tested."""
        return not self.worse and self.beyond and self.p_value > 0.5

    @property
    def may_be_chance(self) -> bool:
        """Whether it is worse by itself, but not among all comparisons of the suite."""
        return not self.worse and self.beyond and self.p_value <= self.rule.p

    def to_dict(self) -> dict[str, Any]:
        """Return the comparison as results have it."""
        return {
            'metric': self.rule.metric,
            'baseline': self.baseline.to_dict(),
            'candidate': self.candidate.to_dict(),
            'missing': self.missing,
            'difference': self.difference,
            'relative_difference': self.relative_difference,
            'allowed': self.allowed,
            'p_value': self.p_value,
            'p_adjusted': self.p_adjusted,
            'confidence_interval': list(self.interval),
            'worse': self.worse,
        }


def compare(
    rule: Rule, baseline: Sequence[float], candidate: Sequence[float], missing: int = 0
) -> MetricComparison:
    """
    Return whether a metric is worse than in the baseline, beyond the noise of both.

    It is worse where most runs of the candidate have no value and the baseline had one. With so
    few runs that no outcome could be significant (1 and 1, say), the limits of the rule decide
    alone.

    :param missing: runs of the candidate without a value.
    """
    sign = worse_sign(rule.metric)
    old, new = Distribution(tuple(baseline)), Distribution(tuple(candidate))
    all_new = Distribution((*new.values, *[sign * math.inf] * missing))
    difference = all_new.median - old.median
    allowed = max(rule.relative * abs(old.median), rule.absolute, rule.mad * old.mad)
    p_value = math.nan
    if not math.isfinite(difference):
        difference, worse = math.nan, bool(old.values)
    else:
        if _least_p_value(len(old.values), len(all_new.values)) <= DEFAULT_P:
            p_value = _p_value(sign, old.values, all_new.values)
        worse = sign * difference > allowed and not p_value > rule.p
    return MetricComparison(
        rule=rule,
        baseline=old,
        candidate=new,
        missing=missing,
        difference=difference,
        allowed=allowed,
        p_value=p_value,
        worse=worse,
    )


def _least_p_value(old: int, new: int) -> float:
    """Return the smallest p-value that so many runs can have."""
    return 1 / math.comb(old + new, new)


def _p_value(sign: int, old: Sequence[float], new: Sequence[float]) -> float:
    """
    Return the one-sided p-value of a permutation test on the trimmed means.

    It is the share of all ways to divide the values into groups of these sizes that separates the
    groups at least as far; of RESAMPLES random ones where there are more ways than that. Where
    trimmed means are equal, as of runs that all give the same, the means decide.

    :param sign: 1 where higher values are worse, -1 where lower ones are.
    """
    values, size = finite_values(old, new), len(new)
    divided = values[divisions(len(values), size)]
    first, second = divided[:, :size], divided[:, size:]
    apart = sign * (trimmed_mean(first) - trimmed_mean(second))
    means = sign * (first.mean(axis=1) - second.mean(axis=1))
    # the first is the true division; equal ones may differ from it in the last bits
    rounding = 1e-12 * np.abs(values).max()
    further, equal = apart > apart[0] + rounding, np.abs(apart - apart[0]) <= rounding
    return float(np.mean(further | (equal & (means >= means[0] - rounding))))


def finite_values(old: Sequence[float], new: Sequence[float]) -> np.ndarray:
    """Return all values, the new ones first, in which infinite ones are very large."""
    values = np.array([*new, *old])
    most = np.abs(values[np.isfinite(values)]).max()
    return np.clip(values, -MISSING_VALUE * most, MISSING_VALUE * most)


@lru_cache(maxsize=8)
def divisions(count: int, size: int) -> np.ndarray:
    """
    Return the (ways, count) indices that divide runs into two groups; the first is 0, 1, 2...

    All of them; RESAMPLES random ones where there are more than that.

    :param size: of the first group.
    """
    if math.comb(count, size) > RESAMPLES:
        orders = np.tile(np.arange(count), (RESAMPLES, 1))
        orders[1:] = np.random.default_rng(SEED).permuted(orders[1:], axis=1)
        return orders
    first = np.array(list(combinations(range(count), size)))
    others = np.ones((len(first), count), bool)
    np.put_along_axis(others, first, False, axis=1)
    return np.hstack([first, np.nonzero(others)[1].reshape(len(first), -1)])


def trimmed_mean(values: np.ndarray) -> np.ndarray:
    """Return the mean of each row, trimmed by TRIMMED at either end."""
    cut = int(TRIMMED * values.shape[1])
    kept = np.sort(values, axis=1)[:, cut : values.shape[1] - cut]
    return np.asarray(kept.mean(axis=1))


def _interval(old: Sequence[float], new: Sequence[float]) -> tuple[float, float]:
    """Return the bootstrap confidence interval (percentiles) of the difference of the medians."""
    random = np.random.default_rng(SEED)
    one, other = (
        np.median(np.array(values)[random.integers(len(values), size=(RESAMPLES, len(values)))], 1)
        for values in (new, old)
    )
    beyond = (1 - CONFIDENCE) / 2
    low, high = np.quantile(one - other, [beyond, 1 - beyond])
    return float(low), float(high)


def differ(one: Sequence[float], other: Sequence[float]) -> tuple[float, tuple[float, float]]:
    """
    Return the two-sided p-value of the same test, and the interval of the difference of medians.

    :param one: may have infinite values, of runs that failed; the interval is NaN then.
    :returns: NaN for what so few runs do not tell.
    """
    unknown = math.nan, math.nan
    if not (np.isfinite(one).any() and np.isfinite(other).any()):
        return math.nan, unknown
    enough = 2 * _least_p_value(len(one), len(other)) <= DEFAULT_P
    p_value = 2 * min(_p_value(sign, other, one) for sign in (1, -1)) if enough else math.nan
    finite = np.isfinite([*one, *other]).all() and min(len(one), len(other)) > 1
    return min(p_value, 1.0), _interval(other, one) if finite else unknown
