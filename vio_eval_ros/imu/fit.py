"""
White noise density, bias instability and random walk, fitted to an Allan deviation.

All three terms are fitted together to the Allan variance, which is linear in their squares, so
that none is read where another disturbs it. A term that is not significant is left out and the
others are fitted again: chance would give it a value, which cannot be negative, at the expense of
its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.statistics import NORMAL_95
from vio_eval_ros.imu.allan import Curve, interval, Variances
from vio_eval_ros.imu.limits import ImuNoiseLimits

FLAT = 2 * np.log(2) / np.pi  # the Allan variance of flicker noise over B²: 0.664²
WALK, RAMP = 2, 3  # the columns of a random walk and of a steady drift
MODEL_ERROR = 0.02  # of a variance: no real sensor follows the model more closely
WHITE_SLOPE, SLOPE_TOLERANCE = -0.5, 0.02  # of the Allan deviation, logarithmic
MAX_SLOPE_ERROR = 0.1  # a slope known less well does not show where white noise begins
RESIDUAL_SIGMAS = 3  # of the curve, that chance explains
ITERATIONS = 5  # of weights that depend on the result

#: why an axis has no noise
CONSTANT = 'its value never changes'
SI = {'gyro': 'rad/s', 'accel': 'm/s2'}


class Quantity(NamedTuple):
    """
    What a parameter of the noise is called in reports.

    :param units: of 'gyro' and of 'accel'.
    :param read_at_tau_s: the averaging time at which its line is read off the curve.
    """

    name: str
    units: dict[str, str]
    read_at_tau_s: float | None

    @property
    def label(self) -> str:
        """The name in words."""
        return self.name.replace('_', ' ')


#: The parameters of a fit, by attribute.
PARAMETERS = {
    'density': Quantity(
        'white_noise_density', {'gyro': 'rad/s/sqrt(Hz)', 'accel': 'm/s2/sqrt(Hz)'}, 1.0
    ),
    'instability': Quantity('bias_instability', SI, None),
    'walk': Quantity('random_walk', {'gyro': 'rad/s2/sqrt(Hz)', 'accel': 'm/s3/sqrt(Hz)'}, 3.0),
}


@dataclass(frozen=True)
class Parameter:
    """
    One parameter of the noise.

    :param value: NaN where it cannot be determined; ``reason`` says why.
    :param low: end of the 95 % confidence interval, as is ``high``. Where there is no value, low
        is NaN and high an upper limit, NaN where there is none.
    :param dominates_s: first and last averaging time at which its term is the largest; None
        where it never is.
    :param too_short: whether it cannot be determined because the record is too short.
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
    The noise fitted to a curve; u is the unit of its samples.

    :param density: N, u/√Hz, the white noise line at τ = 1 s.
    :param instability: B, u; the flat part of the curve is at 0.664 B.
    :param walk: K, u/s/√Hz, the random walk line at τ = 3 s.
    :param range_s: the averaging times that were fitted; None where there were too few.
    :param deviations: (T,) of the fit at each averaging time of the curve.
    :param scatter: (T,) relative standard deviation of the curve's deviations.
    :param residual: the largest relative distance of the curve from the fit, and its averaging
        time, where it is beyond the limit and chance; -0.2 is 20 % below.
    :param ramp: whether the curve rises faster than under a random walk.
    """

    density: Parameter
    instability: Parameter
    walk: Parameter
    range_s: tuple[float, float] | None
    deviations: np.ndarray
    scatter: np.ndarray
    residual: tuple[float, float] | None
    ramp: bool


def fit_noise(curve: Curve, missing: float = 0.0, limits: ImuNoiseLimits | None = None) -> Fit:
    """
    Return the noise parameters of a curve.

    :param missing: share of the samples that is missing, where those on either side are taken for
        neighbours and the rate of the curve is that of the samples there are. The density is
        that of a full record.
    """
    limits = limits or ImuNoiseLimits()
    if missing > limits.max_missing_ratio:
        reason = f'{100 * missing:.0f} % of the samples are missing'
        return _without_fit(curve, Parameter(reason=reason))
    if not curve.deviations.all():
        return _without_fit(curve, Parameter(reason=CONSTANT))
    used = fit_range(curve)
    if used.sum() < limits.min_averaging_times:
        seconds = curve.samples / curve.rate_hz
        reason = f'the record is too short: {seconds:.3g} s without long gaps'
        return _without_fit(curve, Parameter(reason=reason, too_short=True))
    whole = _estimate(curve, used, [0, 1, 2])
    best = _significant(curve, used, whole, limits)

    range_s = float(curve.taus_s[used][0]), float(curve.taus_s[used][-1])
    parts = _basis(curve)[:, :3] * best.squares.clip(min=0)
    variances = parts.sum(axis=1)
    scatter = np.sqrt(np.diag(best.covariance)) / variances / 2
    upper = _upper_limits(curve, used, whole)
    density, instability, walk = (
        _parameter(best, term, curve.taus_s[used], parts[used], limits)
        if term in best.kept
        else Parameter(
            high=float(upper[term]), reason=_reason(term, range_s), too_short=term == WALK
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
        residual=_residual(curve, used, variances, scatter, limits),
        ramp=_is_significant(curve, used, best, RAMP, limits),
    )


def fit_range(curve: Curve) -> np.ndarray:
    """
    Return which averaging times are fitted, (T,) bool.

    From where the white noise line begins: the filter of a sensor flattens the curve before it,
    vibration and quantisation make it steeper. Up to an eighth of the record, or to where gaps
    leave three quarters of it: beyond, too few differences are independent.
    """
    long_enough = 4 * curve.terms >= 3 * curve.samples
    slopes, errors = _slopes(curve)
    known = np.logical_and.accumulate(long_enough[: len(slopes)] & (errors < MAX_SLOPE_ERROR))
    slopes, errors = slopes[known], errors[known]
    if not len(slopes):
        return long_enough
    steep = np.flatnonzero(slopes < WHITE_SLOPE - SLOPE_TOLERANCE - 3 * errors)
    first = min(steep[-1] + 1, len(slopes) - 1) if len(steep) else 0
    level = max(slopes[first:].min(), WHITE_SLOPE)
    first += int(np.flatnonzero(slopes[first:] <= level + SLOPE_TOLERANCE + errors[first:])[0])
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
    The squares of the terms that were kept, and their errors.

    :param squares: (3,), 0 for the others.
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
    for _ in range(ITERATIONS):
        squares[kept] = gain @ found
        covariance = curve.covariance(Variances(*squares.clip(min=0).tolist()))
        inside = covariance[np.ix_(used, used)]
        gain = _gain(terms, np.sqrt(np.diag(inside) + (MODEL_ERROR * found) ** 2))
    squares[kept] = gain @ found
    spreads[kept] = np.sqrt(np.diag(gain @ inside @ gain.T))
    return _Estimate(kept, squares, spreads, covariance)


def _gain(terms: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Return the matrix from Allan variances with these standard errors to coefficients."""
    weighted = terms / errors[:, None]
    scale = np.linalg.norm(weighted, axis=0)
    return np.asarray(np.linalg.pinv(weighted / scale) / scale[:, None] / errors)


def _significant(
    curve: Curve, used: np.ndarray, whole: _Estimate, limits: ImuNoiseLimits
) -> _Estimate:
    """Return the estimate without its weakest terms, as long as chance explains them."""
    best = whole
    while len(best.kept) > 1:
        weakest = best.kept[int(best.strength.argmin())]
        without = _estimate(curve, used, [term for term in best.kept if term != weakest])
        if _is_significant(curve, used, without, weakest, limits):
            break
        best = without
    return best


def _is_significant(
    curve: Curve, used: np.ndarray, without: _Estimate, term: int, limits: ImuNoiseLimits
) -> bool:
    """Return whether a further term is more than chance would add to an estimate."""
    found, inside = curve.variances[used], without.covariance[np.ix_(used, used)]
    terms = _basis(curve)[np.ix_(used, np.array([*without.kept, term]))]
    gain = _gain(terms, np.sqrt(np.diag(inside) + (MODEL_ERROR * found) ** 2))[-1]
    return bool(gain @ found > limits.detection_sigmas * np.sqrt(gain @ inside @ gain))


def _upper_limits(curve: Curve, used: np.ndarray, whole: _Estimate) -> np.ndarray:
    """Return what each term is at most, (3,), by the estimate of all three."""
    upper = np.sqrt(np.maximum(whole.squares, 0) + NORMAL_95 * whole.spreads)
    lowest = np.flatnonzero(used)[curve.variances[used].argmin()]
    at_most = curve.variances[lowest] + NORMAL_95 * np.sqrt(whole.covariance[lowest, lowest])
    upper[1] = min(upper[1], np.sqrt(at_most / FLAT))
    return np.asarray(upper)


def _residual(
    curve: Curve,
    used: np.ndarray,
    variances: np.ndarray,
    scatter: np.ndarray,
    limits: ImuNoiseLimits,
) -> tuple[float, float] | None:
    """Return the largest residual beyond the limit and its averaging time, if there is one."""
    excess = curve.deviations / np.sqrt(variances) - 1
    allowed = limits.residual_ratio + RESIDUAL_SIGMAS * scatter
    beyond = np.where(used & (np.abs(excess) > allowed), np.abs(excess), 0)
    worst = int(beyond.argmax())
    return (float(excess[worst]), float(curve.taus_s[worst])) if beyond.any() else None


def _parameter(
    estimate: _Estimate, term: int, taus_s: np.ndarray, parts: np.ndarray, limits: ImuNoiseLimits
) -> Parameter:
    """Return the parameter of a term that was kept."""
    square, spread = estimate.squares[term], estimate.spreads[term]
    low, high = interval(np.sqrt(max(square, 0)), 2 * (square / spread) ** 2)
    if square < limits.certainty_sigmas * spread:
        reason = 'it is present, but its size cannot be determined; record longer'
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
        f'from τ = {first} on, the curve nowhere falls as white noise does',
        'there is no flat part that white noise and random walk do not explain',
        f'it does not rise above the other noise up to τ = {last}, the longest that the '
        'record supports; record longer',
    )[term]


def _without_fit(curve: Curve, unknown: Parameter) -> Fit:
    nan = np.full(len(curve.factors), np.nan)
    return Fit(
        unknown,
        unknown,
        unknown,
        range_s=None,
        deviations=nan,
        scatter=nan,
        residual=None,
        ramp=False,
    )
