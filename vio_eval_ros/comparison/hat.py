"""
Which party is wrong, one of the systems or the truth: from their pairwise differences alone.

The three-cornered hat (Gray and Allan 1974, doi:10.1109/FREQ.1974.200027) finds the own error of
each of three clocks from the variances of their differences. With more parties it is solved by
least squares, variances non-negative (Premoli and Tavella 1993, doi:10.1109/19.206671; Torcaso
et al. 1998, PTTI 30, 69-82). It believes that own errors are independent. Systems share errors, so
that a party is blamed only for what all camps, into which the others may part, have against it.

Before any difference is taken, that is projected out of it which a rigid alignment changes: the
result does not depend on how each system was aligned, nor is an error bent by it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import combinations
import math
from typing import Any, NamedTuple

import numpy as np

TRUTH = 'ground truth'
#: systems (of different families) that are needed; poses that they must share
LEAST_SYSTEMS, LEAST_STAMPS = 3, 60
#: two systems that are closer to each other than this share of the distance to any other are one
FAMILY = 1 / 2
#: own error, in that of the others among each other, from which a party is wrong
LEAST_RATIO = 1.4
#: correlation of what any two camps of the others have against it
LEAST_CORRELATION = 0.45
#: the truth is named before a system that is worse, unless by more than this
LEAST_SHARE = 0.7
#: of the solution for variances
SWEEPS = 300
#: windows along the run, as parts of it; neighbours overlap by half
PARTS = (1, 2, 4, 8)
#: parties of which every division into two camps is looked at
MOST_DIVIDED = 10


@dataclass(frozen=True)
class Doubt:
    """
    Which party is wrong on a sequence, if any.

    :param families: the systems by families; those of one share their errors.
    :param own_errors: RMS [m] of each family and the truth by the hat; by the first name of each.
    :param wrong: names of systems of one family, or TRUTH alone; empty for none.
    :param begin_s: since the first stamp; where along the run it is wrong.
    :param path_m: length of the truth in that.
    :param error_m: by which it is wrong there, RMS; ``agreement_m`` is what the others are apart
        from each other, over the root of two.
    :param why: it cannot be told; empty where it could.
    """

    families: tuple[tuple[str, ...], ...] = ()
    own_errors: Mapping[str, float] | None = None
    wrong: tuple[str, ...] = ()
    begin_s: float = math.nan
    end_s: float = math.nan
    path_m: float = math.nan
    error_m: float = math.nan
    agreement_m: float = math.nan
    why: str = ''

    @property
    def verdict(self) -> str:
        """The verdict in words."""
        if self.why:
            return 'cannot tell'
        if not self.wrong:
            return 'no party is wrong'
        return (
            'the ground truth is doubtful'
            if self.wrong == (TRUTH,)
            else 'a system disagrees alone'
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the doubt as results have it."""
        return {
            'verdict': self.verdict,
            'wrong': list(self.wrong),
            'begin_s': self.begin_s,
            'end_s': self.end_s,
            'path_m': self.path_m,
            'error_m': self.error_m,
            'agreement_m': self.agreement_m,
            'families': [list(one) for one in self.families],
            'own_errors_m': dict(self.own_errors or {}),
            'why': self.why or None,
        }


class _Window(NamedTuple):
    """A part of the run in which a party was looked at: own variance, that of the others."""

    begin: int
    end: int
    party: int
    own: float
    others: float
    correlation: float

    @property
    def ratio(self) -> float:
        """Own error in that of the others among each other."""
        return math.sqrt(max(self.own, 0.0) / max(self.others, 1e-18))

    @property
    def wrong(self) -> bool:
        """Whether the party is."""
        return self.ratio >= LEAST_RATIO and self.correlation >= LEAST_CORRELATION


def which_is_wrong(
    stamps_ns: np.ndarray,
    truth: np.ndarray,
    systems: Mapping[str, np.ndarray],
    first_ns: int | None = None,
) -> Doubt:
    """
    Return which party is wrong, and where.

    :param stamps_ns: (N,) shared by all, increasing.
    :param truth: (N, 3) positions [m]; ``systems`` has those of each, aligned to the truth.
    :param first_ns: from which times are counted; the first shared stamp by default.
    """
    if len(systems) < LEAST_SYSTEMS:
        return Doubt(why=f'{len(systems)} systems are too few, {LEAST_SYSTEMS} may tell')
    if len(stamps_ns) < LEAST_STAMPS:
        return Doubt(why=f'all systems share {len(stamps_ns)} poses, {LEAST_STAMPS} may tell')
    errors = np.stack([each - truth for each in systems.values()])
    errors = unaligned(errors, truth)
    families = _families(tuple(systems), errors)
    if len(families) < LEAST_SYSTEMS:
        told = '; '.join(' and '.join(one) for one in families if len(one) > 1)
        return Doubt(families, why=f'{told} share their errors, {LEAST_SYSTEMS} families may tell')
    order = list(systems)
    means = [errors[[order.index(name) for name in one]].mean(axis=0) for one in families]
    parties = np.stack([np.zeros_like(truth), *means])
    names = ((TRUTH,), *families)
    own = dict(zip((one[0] for one in names), own_errors(parties).tolist(), strict=True))
    found = [one for one in _windows(parties) if one.wrong]
    if not found:
        return Doubt(families, own)
    worst = max(found, key=lambda one: one.ratio)
    of_truth = max(
        (one for one in found if not one.party), key=lambda one: one.ratio, default=None
    )
    if of_truth is not None and of_truth.ratio >= LEAST_SHARE * worst.ratio:
        worst = of_truth
    since = (stamps_ns - (stamps_ns[0] if first_ns is None else first_ns)) / 1e9
    return _located(
        Doubt(families, own, names[worst.party]),
        [one for one in found if one.party == worst.party],
        (since, truth, parties),
    )


def unaligned(errors: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """
    Return (K, N, 3) errors without what a small rigid motion of the (N, 3) truth makes.

    By linearity each difference of two of them is then that under their best alignment.
    """
    arms = truth - truth.mean(axis=0)
    ones = np.broadcast_to(np.eye(3)[:, None], (3, *arms.shape))
    turns = np.cross(np.eye(3)[:, None], arms[None])
    basis, sizes, _ = np.linalg.svd(
        np.concatenate([ones, turns]).reshape(6, -1).T, full_matrices=False
    )
    basis = basis[:, sizes > 1e-9 * sizes[0]]
    flat = errors.reshape(len(errors), -1)
    return np.asarray(flat - (flat @ basis) @ basis.T).reshape(errors.shape)


def own_errors(parties: np.ndarray) -> np.ndarray:
    """
    Return the (K,) RMS [m] of the own error of each party, by the hat.

    :param parties: (K, N, 3) errors of each against anything that is common to them.
    """
    squares = _squares(_products(parties))
    pairs = np.array(list(combinations(range(len(parties)), 2)))
    apart = squares[pairs[:, 0], pairs[:, 1]]
    sums = np.zeros((len(pairs), len(parties)))
    np.put_along_axis(sums, pairs, 1.0, axis=1)
    # each difference is as uncertain as it is large
    weights = 1 / np.maximum(apart, 1e-18)
    return np.sqrt(_not_negative(sums * weights[:, None], apart * weights))


def _not_negative(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the least-squares solution without negatives, unknown by unknown in turn."""
    normal, right = matrix.T @ matrix, matrix.T @ values
    found = np.zeros(len(right))
    for _ in range(SWEEPS):
        for k in range(len(found)):
            found[k] = max(0.0, found[k] + (right[k] - normal[k] @ found) / normal[k, k])
    return found


def _products(parties: np.ndarray) -> np.ndarray:
    """Return the (K, K) mean inner products [m²]."""
    flat = parties.reshape(len(parties), -1)
    return np.asarray(flat @ flat.T / parties.shape[1])


def _squares(products: np.ndarray) -> np.ndarray:
    """Return the (K, K) mean squared distances [m²]."""
    own = np.diag(products)
    return np.maximum(own[:, None] + own - 2 * products, 0.0)


def _families(names: tuple[str, ...], errors: np.ndarray) -> tuple[tuple[str, ...], ...]:
    """Return the names by families: the closest two join while they are far from all others."""
    found: list[list[int]] = [[k] for k in range(len(names))]
    while len(found) > 1:
        distances = np.sqrt(_squares(_products(np.stack([errors[k].mean(axis=0) for k in found]))))
        np.fill_diagonal(distances, math.inf)
        i, j = sorted(map(int, np.unravel_index(np.argmin(distances), distances.shape)))
        rest = np.delete(distances[[i, j]], [i, j], axis=1)
        if not rest.size or distances[i, j] >= FAMILY * rest.min():
            break
        found[i] += found.pop(j)
    return tuple(tuple(names[k] for k in one) for one in found)


@cache
def _divisions(count: int) -> np.ndarray:
    """Return (D, K) booleans: divisions of K parties into two camps, each once."""
    if count <= MOST_DIVIDED:
        return (np.arange(1, 2 ** (count - 1))[:, None] >> np.arange(count) & 1).astype(bool)
    pairs = list(combinations(range(count), 2))
    alone = np.eye(count, dtype=bool)
    return np.concatenate([alone, [alone[i] | alone[j] for i, j in pairs]])


def _windows(parties: np.ndarray) -> Iterator[_Window]:
    """Yield each party in each window."""
    count, overall = parties.shape[1], _squares(_products(parties))
    for parts in PARTS:
        for k in range(2 * parts - 1):
            begin, end = (round(each * count / (2 * parts)) for each in (k, k + 2))
            products = _products(parties[:, begin:end])
            for party in range(len(parties)):
                yield _Window(begin, end, party, *_blamed(products, overall, party))


def _blamed(products: np.ndarray, overall: np.ndarray, party: int) -> tuple[float, float, float]:
    """
    Return variance [m²] and correlation of what the others have in common against a party.

    Both are the least over all divisions into two camps. Between them stands the variance of the
    others among each other over the whole run: half of the median squared distance.
    """
    others = np.delete(np.arange(len(products)), party)
    against = (
        products[np.ix_(others, others)]
        - products[others, party][:, None]
        - products[party, others]
        + products[party, party]
    )
    one = _divisions(len(others)).astype(float)
    two = 1 - one
    one, two = (each / each.sum(axis=1, keepdims=True) for each in (one, two))
    common, first, second = (
        np.sum((a @ against) * b, axis=1) for a, b in ((one, two), (one, one), (two, two))
    )
    correlation = common / np.sqrt(np.maximum(first * second, 1e-36))
    among = overall[np.ix_(others, others)][np.triu_indices(len(others), 1)]
    return float(common.min()), float(np.median(among) / 2), float(correlation.min())


def _located(
    doubt: Doubt, found: list[_Window], run: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> Doubt:
    """Return the doubt with where it is: the neighbouring smallest windows around the worst."""
    seconds, truth, parties = run
    least = min(one.end - one.begin for one in found)
    small = [one for one in found if one.end - one.begin <= least + 1]
    worst = max(small, key=lambda one: one.own)
    # an alignment spreads a part of the error over the rest of the run
    small = [one for one in small if one.own >= worst.own / 4]
    begin, end = worst.begin, worst.end
    for one in sorted(small):
        if one.begin <= end and one.end > end:
            end = one.end
    for one in sorted(small, reverse=True):
        if one.end >= begin and one.begin < begin:
            begin = one.begin
    part = parties[:, begin:end]
    own, _, _ = _blamed(_products(part), _squares(_products(part)), worst.party)
    others = np.delete(_squares(_products(part)), worst.party, axis=0)
    others = np.delete(others, worst.party, axis=1)
    apart = others[np.triu_indices(len(others), 1)]
    path = np.linalg.norm(np.diff(truth[begin:end], axis=0), axis=1).sum()
    return Doubt(
        doubt.families,
        doubt.own_errors,
        doubt.wrong,
        begin_s=float(seconds[begin]),
        end_s=float(seconds[end - 1]),
        path_m=float(path),
        error_m=math.sqrt(max(own, worst.own)),
        agreement_m=math.sqrt(float(np.median(apart)) / 2),
    )
