"""
White noise density, bias instability and random walk, fitted to an Allan deviation.

All three terms are fitted together to the Allan variance, which is linear in their squares, so
that none is read off where another disturbs it. A term that does not stand out is left out and
the others are fitted again: kept at a value that is chance, but cannot be negative, it would take
from its neighbours on average.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vio_eval_ros.imu.allan import Curve, interval, Variances

FLAT = 2 * np.log(2) / np.pi  # the Allan variance of flicker noise over B²: 0.664²
# of the parameters of a Fit, as documents have them
NAMES = {
    'density': 'white_noise_density',
    'instability': 'bias_instability',
    'walk': 'random_walk',
}
NORMAL_95 = 1.96  # standard deviations
SIGNIFICANT = 3.0  # standard deviations of chance that a term must exceed
CERTAIN = 2.0  # standard deviations of its own that the square of a term must be above zero
WALK, RAMP = 2, 3  # the columns of a random walk and of a steady drift
FLOOR = 0.02  # of a variance: no real sensor follows the model more closely
POINTS = 8  # fewer cannot tell three terms apart
WHITE, NEAR = -0.5, 0.02  # the slope of white noise, and how close to it is
SURE = 0.1  # a slope with a larger error does not tell where white noise begins
MISFIT = 0.1
# Share of missing samples. The rate of a sensor that loses half of its samples cannot be told,
# and so many seem to be missing then.
MOST_MISSING = 0.15


@dataclass(frozen=True)
class Parameter:
    """
    One parameter of the noise.

    :param value: NaN where it cannot be told; ``reason`` says why.
    :param low: end of the 95 % confidence interval, as ``high``; of a parameter that cannot be
        told, low is NaN and high an upper limit, NaN where there is none.
    :param dominates_s: from and up to which averaging time its term is the largest; None where
        it nowhere is.
    :param too_short: whether it cannot be told because the record is too short for it.
    """

    value: float = np.nan
    low: float = np.nan
    high: float = np.nan
    dominates_s: tuple[float, float] | None = None
    reason: str | None = None
    too_short: bool = False


@dataclass(frozen=True, eq=False)
class Fit:
    """
    What was fitted to a curve; u is the unit of its samples.

    :param density: N, u/√Hz, the white noise line at τ = 1 s.
    :param instability: B, u; the flat part of the curve is at 0.664 B.
    :param walk: K, u/s/√Hz, the random walk line at τ = 3 s.
    :param range_s: the averaging times that were fitted; None where there were too few.
    :param deviations: (T,) of the fit at each averaging time of the curve.
    :param scatter: (T,) relative standard deviation of the curve's deviations.
    :param misfit: how far the curve is off the fit where it is farthest, and at which averaging
        time, if that is more than chance; -0.2 is 20 % below.
    :param ramp: whether the curve rises faster than a random walk lets it.
    """

    density: Parameter
    instability: Parameter
    walk: Parameter
    range_s: tuple[float, float] | None
    deviations: np.ndarray
    scatter: np.ndarray
    misfit: tuple[float, float] | None
    ramp: bool


def fit_noise(curve: Curve, missing: float = 0.0) -> Fit:
    """
    Return the noise parameters of a curve.

    :param missing: which share of the samples is missing, with the others passed for neighbours
        and the rate of the curve that of those: what a full record would have of white noise is
        told, whatever is left of it.
    """
    if missing > MOST_MISSING:
        reason = f'{100 * missing:.0f} % of the samples are missing'
        return _nothing(curve, Parameter(reason=reason))
    if not curve.deviations.all():
        return _nothing(curve, Parameter(reason='its value never changes'))
    used = fitted(curve)
    if used.sum() < POINTS:
        seconds = curve.samples / curve.rate_hz
        reason = f'the record is too short: {seconds:.3g} s without long gaps'
        return _nothing(curve, Parameter(reason=reason, too_short=True))
    best = _estimate(curve, used, [0, 1, 2])
    limits = np.sqrt(np.maximum(best.squares, 0) + NORMAL_95 * best.spreads)
    lowest = np.flatnonzero(used)[curve.variances[used].argmin()]
    at_most = curve.variances[lowest] + NORMAL_95 * np.sqrt(best.covariance[lowest, lowest])
    limits[1] = min(limits[1], np.sqrt(at_most / FLAT))
    while len(best.kept) > 1:
        weakest = best.kept[int(best.strength.argmin())]
        without = _estimate(curve, used, [term for term in best.kept if term != weakest])
        if _stands_out(curve, used, without, weakest):
            break
        best = without

    taus_s = curve.taus_s
    range_s = float(taus_s[used][0]), float(taus_s[used][-1])
    parts = _basis(curve)[:, :3] * best.squares.clip(min=0)
    variances = parts.sum(axis=1)
    scatter = np.sqrt(np.diag(best.covariance)) / variances / 2
    excess = curve.deviations / np.sqrt(variances) - 1
    odd = np.where(used & (np.abs(excess) > MISFIT + 3 * scatter), np.abs(excess), 0)
    worst = int(odd.argmax())
    density, instability, walk = (
        _told(best.squares[term], best.spreads[term], taus_s[used], parts[used], term)
        if term in best.kept
        else Parameter(
            high=float(limits[term]), reason=_reason(term, range_s), too_short=term == WALK
        )
        for term in range(3)
    )
    return Fit(
        _scaled(density, float(np.sqrt(1 - missing))),
        instability,
        walk,
        range_s=range_s,
        deviations=np.sqrt(variances),
        scatter=scatter,
        misfit=(float(excess[worst]), float(taus_s[worst])) if odd.any() else None,
        ramp=_stands_out(curve, used, best, RAMP),
    )


def fitted(curve: Curve) -> np.ndarray:
    """
    Return which averaging times are fitted, (T,) bool.

    From where the white noise line begins: the filter of a sensor flattens the curve before it,
    vibration and quantisation make it steeper. Up to an eighth of the record, or to where gaps
    leave three quarters of it: beyond, too few differences are independent.
    """
    long_enough = 4 * curve.terms >= 3 * curve.samples
    slopes, errors = _slopes(curve)
    sure = np.logical_and.accumulate(long_enough[: len(slopes)] & (errors < SURE))
    slopes, errors = slopes[sure], errors[sure]
    if not len(slopes):
        return long_enough
    steep = np.flatnonzero(slopes < WHITE - NEAR - 3 * errors)
    first = min(steep[-1] + 1, len(slopes) - 1) if len(steep) else 0
    level = max(slopes[first:].min(), WHITE)
    first += int(np.flatnonzero(slopes[first:] <= level + NEAR + errors[first:])[0])
    return long_enough & (np.arange(len(long_enough)) >= first)


def _slopes(curve: Curve) -> tuple[np.ndarray, np.ndarray]:
    """Return the slopes over octaves, of logarithms, and their standard errors in white noise."""
    taus, deviations = np.log(curve.taus_s), np.log(curve.deviations)
    ends = np.searchsorted(curve.factors, 2 * curve.factors)
    begins = np.flatnonzero(ends < len(taus))
    ends = ends[begins]
    lengths = taus[ends] - taus[begins]
    white = curve.covariance(Variances(1.0, 0.0, 0.0)) * np.outer(curve.taus_s, curve.taus_s) / 4
    variances = white[begins, begins] + white[ends, ends] - 2 * white[begins, ends]
    return (deviations[ends] - deviations[begins]) / lengths, np.sqrt(variances) / lengths


def _basis(curve: Curve) -> np.ndarray:
    """
    Return the Allan variances of N, B, K and a steady drift at unit size, (T, 4).

    The random walk is one that is sampled, not averaged, as in Kalibr's model of an IMU: its
    variance is K² τ/3 times 1 + 1/2m² where m samples are averaged.
    """
    taus_s = curve.taus_s
    walk = taus_s / 3 * (1 + 0.5 / curve.factors.astype(float) ** 2)
    return np.stack([1 / taus_s, np.full(len(taus_s), FLAT), walk, taus_s**2 / 2], axis=1)


class _Estimate(NamedTuple):
    """
    The squares of the terms that were kept, and what is known of their errors.

    :param squares: (3,), 0 of the others.
    :param spreads: (3,) standard deviations.
    :param covariance: (T, T) of the Allan variances, were the estimate true.
    """

    kept: list[int]
    squares: np.ndarray
    spreads: np.ndarray
    covariance: np.ndarray

    @property
    def strength(self) -> np.ndarray:
        """How many standard deviations each kept term is above zero."""
        return np.asarray(self.squares[self.kept] / self.spreads[self.kept])


def _estimate(curve: Curve, used: np.ndarray, kept: list[int]) -> _Estimate:
    """Return the least-squares estimate of some terms; its weights depend on the result."""
    terms, found = _basis(curve)[np.ix_(used, np.array(kept))], curve.variances[used]
    squares, spreads = np.zeros(3), np.zeros(3)
    gain = _gain(terms, found)
    for _ in range(5):
        squares[kept] = gain @ found
        covariance = curve.covariance(Variances(*squares.clip(min=0).tolist()))
        inside = covariance[np.ix_(used, used)]
        gain = _gain(terms, np.sqrt(np.diag(inside) + (FLOOR * found) ** 2))
    squares[kept] = gain @ found
    spreads[kept] = np.sqrt(np.diag(gain @ inside @ gain.T))
    return _Estimate(kept, squares, spreads, covariance)


def _gain(terms: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Return what makes coefficients of Allan variances with these standard errors."""
    weighted = terms / errors[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    return np.asarray(np.linalg.pinv(weighted / scale) / scale[:, None] / errors)


def _stands_out(curve: Curve, used: np.ndarray, without: _Estimate, term: int) -> bool:
    """Return whether a further term is more than chance would make of those of an estimate."""
    found, inside = curve.variances[used], without.covariance[np.ix_(used, used)]
    terms = _basis(curve)[np.ix_(used, np.array([*without.kept, term]))]
    gain = _gain(terms, np.sqrt(np.diag(inside) + (FLOOR * found) ** 2))[-1]
    return bool(gain @ found > SIGNIFICANT * np.sqrt(gain @ inside @ gain))


def _told(
    square: float, spread: float, taus_s: np.ndarray, parts: np.ndarray, term: int
) -> Parameter:
    """Return a parameter whose term was kept."""
    low, high = interval(np.sqrt(max(square, 0)), 2 * (square / spread) ** 2)
    if square < CERTAIN * spread:
        reason = 'it is there, but how large cannot be told; record longer'
        return Parameter(high=high, reason=reason, too_short=True)
    largest = taus_s[parts.argmax(axis=1) == term]
    dominates_s = (float(largest[0]), float(largest[-1])) if len(largest) else None
    return Parameter(float(np.sqrt(square)), low, high, dominates_s)


def _scaled(parameter: Parameter, factor: float) -> Parameter:
    value, low, high = (
        factor * number for number in (parameter.value, parameter.low, parameter.high)
    )
    return replace(parameter, value=value, low=low, high=high)


def _reason(term: int, range_s: tuple[float, float]) -> str:
    """Return why a term was left out."""
    first, last = (f'{tau_s:.3g} s' for tau_s in range_s)
    return (
        f'nowhere from τ = {first} on does the curve fall as white noise does',
        'there is no flat part that white noise and random walk do not explain',
        f'it does not rise above the other noise up to τ = {last}, the longest that the '
        'record supports; record longer',
    )[term]


def _nothing(curve: Curve, unknown: Parameter) -> Fit:
    nan = np.full(len(curve.factors), np.nan)
    return Fit(unknown, unknown, unknown, None, nan, nan, None, False)
