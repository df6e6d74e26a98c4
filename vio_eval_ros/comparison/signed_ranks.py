"""
Whether one system is better than another over many sequences: signed ranks of their ratios.

Each sequence counts once, whatever its size, since sequences are what independent evidence there
is. If the systems were alike, either could have had either result: all signs are as likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np

CONFIDENCE = 0.95
#: all signs of so many sequences are tried
MOST_EXACT = 14
RESAMPLES = 19_999
SEED = 0


@dataclass(frozen=True)
class RankedDifference:
    """
    How the values of one system over many sequences differ from those of another.

    :param sequences: how many have a value of either.
    :param ratio: one over other: of the median (Hodges and Lehmann) of the logarithms of ratios.
    :param interval: of the ratio, at CONFIDENCE; NaN of too few sequences.
    :param p_value: two-sided, of the signed ranks (Wilcoxon 1945).
    :param p_adjusted: the same for all metrics that were compared together.
    """

    sequences: int
    ratio: float
    interval: tuple[float, float]
    p_value: float
    p_adjusted: float


def compare_over_sequences(
    one: Sequence[Sequence[float]], other: Sequence[Sequence[float]]
) -> list[RankedDifference]:
    """
    Return how two systems differ in each metric over the sequences.

    The signs of a sequence change together in all metrics, which may depend on each other in any
    way; the adjusted p-value is that of the largest standardised sum of signed ranks, step by step
    (Westfall and Young 1993, section 2.8).

    :param one: for each metric its values on all sequences, none of them negative: infinite on one
        where the system failed, NaN where there is none.
    """
    logarithms = np.array(
        [list(map(_log_ratio, *pair)) for pair in zip(one, other, strict=True)], float
    )
    known = ~np.isnan(logarithms)
    signs = _signs(logarithms.shape[1])
    sums = np.empty((len(logarithms), len(signs)))
    for k, values in enumerate(logarithms):
        ranks = np.where(known[k], _ranks(np.abs(values)), 0.0) * np.sign(np.nan_to_num(values))
        size = math.sqrt(float(ranks @ ranks)) or 1.0
        sums[k] = signs @ (ranks / size)
    # all signs as they are come first; equal sums may differ in the last bits
    observed, drawn = np.abs(sums[:, :1]) - 1e-9, np.abs(sums)
    p_values = (drawn >= observed).mean(axis=1)
    adjusted, largest = np.ones(len(sums)), 0.0
    order = np.argsort(-drawn[:, 0], kind='stable')
    for place, k in enumerate(order):
        most = drawn[order[place:]].max(axis=0)
        largest = max(largest, float(np.mean(most >= observed[k])))
        adjusted[k] = largest
    return [
        RankedDifference(
            int(known[k].sum()),
            *_estimate(values[known[k]]),
            float(p_values[k]),
            float(adjusted[k]),
        )
        for k, values in enumerate(logarithms)
    ]


def _log_ratio(one: float, other: float) -> float:
    """Return log(one / other); NaN where neither is better, as where both have failed."""
    if math.isnan(one) or math.isnan(other) or (math.isinf(one) and math.isinf(other)):
        return math.nan
    if one == other:
        return 0.0
    if one <= 0 or math.isinf(other):
        return -math.inf
    return math.inf if other <= 0 or math.isinf(one) else math.log(one / other)


def _signs(count: int) -> np.ndarray:
    """Return (S, count) signs: all there are, or random ones; the first are all positive."""
    if count <= MOST_EXACT:
        return 1.0 - 2.0 * (np.arange(1 << count)[:, None] >> np.arange(count) & 1)
    signs = np.random.default_rng(SEED).choice([-1.0, 1.0], (RESAMPLES + 1, count))
    signs[0] = 1
    return signs


def _ranks(values: np.ndarray) -> np.ndarray:
    """Return the ranks of values from 1 on, those of equal ones being their mean; NaN are last."""
    values = np.where(np.isnan(values), math.inf, values)
    below = (values[:, None] > values * (1 + 1e-12)).sum(axis=1)
    equal = np.isclose(values[:, None], values, rtol=1e-12, atol=0).sum(axis=1)
    return np.asarray(below + (1 + equal) / 2)


def _estimate(logarithms: np.ndarray) -> tuple[float, tuple[float, float]]:
    """Return the ratio and its interval, from the means of all pairs of logarithms."""
    count, unknown = len(logarithms), (math.nan, math.nan)
    if not count:
        return math.nan, unknown
    i, j = np.triu_indices(count)
    with np.errstate(invalid='ignore'):
        # of a failure of one and a failure of the other, nothing follows
        means = np.sort(np.nan_to_num((logarithms[i] + logarithms[j]) / 2, nan=0.0,
                                      posinf=math.inf, neginf=-math.inf))  # fmt: skip
        ratio = float(np.exp(np.median(means)))
    ranks = np.arange(1, count + 1)
    positive = (_signs(count) @ ranks + ranks.sum()) / 2
    # the largest rank sum that is as rare as what the interval leaves out at either end
    cut = int(np.quantile(positive, (1 - CONFIDENCE) / 2, method='lower'))
    while cut >= 0 and np.mean(positive <= cut) > (1 - CONFIDENCE) / 2:
        cut -= 1
    if cut < 0:
        return ratio, unknown
    low, high = np.exp(means[cut]), np.exp(means[-cut - 1])
    return ratio, (float(low), float(high))
