"""The lag between any two signals of one quantity."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.diagnosis.correlation import correlate
from vio_eval_ros.diagnosis.fitting import BLOCKS, T_95
from vio_eval_ros.errors import NoPairs

#: fewest samples of each signal
FEWEST_SAMPLES = 20
#: most samples of the grid on which signals are correlated
MOST_SIGNAL_SAMPLES = 1 << 20
#: most steps of Newton's method ...
ROOT_STEPS = 8
#: ... and the change up to which the lag has converged
ROOT_CONVERGED_S = 1e-7
#: short parts of the signals whose scatter gives the uncertainty of the lag ...
PARTS = 30
#: ... and half of the 95 % interval of Student's distribution for them, in standard errors
T_95_OF_PARTS = 2.045
#: uncertainty of the lag under a narrower smoothing, over the best one, up to which the narrower
#: one is preferred ...
PREFERENCE_RATIO = 1.3
#: ... and above which it follows the noise, as all narrower ones would
WORSE_RATIO = 1.6
#: uncertainty that interpolation leaves, as a share of the longer interval between samples, for
#: each radian by which the signals change in it
INTERPOLATION_FLOOR = 0.04
#: unexplained share of the variance under another peak that may be the right one: at most this
#: many times that under the highest ...
RIVAL_RATIO = 1.1
#: ... plus this
RIVAL_RESIDUAL = 0.02


@dataclass(frozen=True)
class SignalLag:
    """
    How much later the stamps of the first signal are.

    :param offset_s: seconds.
    :param uncertainty_s: half the width of its 95 % interval.
    :param sign: of the gain, 1 or -1.
    :param peak: correlation coefficient at the best lag of the grid, times that sign.
    :param next_peak: the highest of another peak, of either sign; NaN where there is none.
    :param ambiguous: whether another lag may be the right one.
    """

    offset_s: float
    uncertainty_s: float
    sign: int
    peak: float
    next_peak: float
    ambiguous: bool


def lag_of_signals(
    first_s: np.ndarray, first: np.ndarray, second_s: np.ndarray, second: np.ndarray
) -> SignalLag:
    """
    Return how much later the stamps of one signal are than those of another.

    The peak of the normalised cross-correlation over all lags, refined. The signs are taken to be
    equal unless opposite ones agree clearly better.

    :param first_s: (N,) stamps in seconds, increasing.
    :param first: (N,) values.
    :param second_s: (M,) stamps, on a clock of their own.
    :param second: (M,) values.
    :raises NoPairs: where there is too little to compare.
    """
    if min(len(first), len(second)) < FEWEST_SAMPLES:
        raise NoPairs(
            f'the signals have {len(first)} and {len(second)} samples; {FEWEST_SAMPLES} needed'
        )
    if not min(np.ptp(first), np.ptp(second)) > 0:
        raise NoPairs('a signal that never changes has no lag')
    spans = [float(np.ptp(stamps)) for stamps in (first_s, second_s)]
    step_s = min(float(np.median(np.diff(stamps))) for stamps in (first_s, second_s))
    step_s = max(step_s, sum(spans) / MOST_SIGNAL_SAMPLES)
    grids = [stamps[0] + step_s * np.arange(int(np.ptp(stamps) / step_s) + 1)
             for stamps in (first_s, second_s)]  # fmt: skip
    sampled = np.interp(grids[0], first_s, first), np.interp(grids[1], second_s, second)
    best, other = (correlate(sampled[0], sign * sampled[1], step_s) for sign in (1, -1))
    if math.isnan(best.height):
        raise NoPairs('the signals have too little in common to be compared at any lag')
    sign = 1
    if not _rivals(best.height, other.height):
        best, other, sign = other, best, -1
    start_s = float(best.lag_s + first_s[0] - second_s[0])
    offset_s, uncertainty_s = _SignalPair(first_s, first, second_s, sign * second).refined(start_s)
    next_peak = float(np.fmax(best.rival, other.height))
    return SignalLag(
        offset_s=offset_s,
        uncertainty_s=uncertainty_s,
        sign=sign,
        peak=best.height,
        next_peak=next_peak,
        ambiguous=_rivals(next_peak, best.height),
    )


def _rivals(height: float, peak: float) -> bool:
    """Return whether a correlation leaves hardly more unexplained than that of the peak."""
    return height > 0 and 1 - height**2 < RIVAL_RATIO * (1 - peak**2) + RIVAL_RESIDUAL


class _SignalPair:
    """
    Two signals whose lag is known to about a sample.

    Both are noisy, so neither is fitted to the other: at the lag, Σ a'b - ab' is zero in the
    mean, whatever their noise, and its slope is 2 Σ a'b'.
    """

    def __init__(
        self, first_s: np.ndarray, first: np.ndarray, second_s: np.ndarray, second: np.ndarray
    ) -> None:
        self._second_s, self._second = second_s, second
        intervals_s = [float(np.median(np.diff(stamps))) for stamps in (first_s, second_s)]
        #: the longer interval between samples
        self._interval_s = max(intervals_s)
        self._span_s = float(np.ptp(first_s))
        self._step_s = max(
            min(*intervals_s, max(intervals_s) / 4), self._span_s / MOST_SIGNAL_SAMPLES
        )
        self._grid_s = np.arange(first_s[0], first_s[-1], self._step_s)
        self._first = np.interp(self._grid_s, first_s, first)

    def refined(self, start_s: float) -> tuple[float, float]:
        """
        Return the lag, and half the width of its 95 % interval.

        Both signals are smoothed by the same filter, as widely as makes the lag most precise.
        """
        width = self._best_width(start_s)
        if not width:
            return start_s, math.inf
        offset_s = self._root(width, start_s)
        # few long parts include errors that last, many short ones have a precise scatter
        terms = self._terms(offset_s, width)
        scatter_s = max(
            T_95 * _jackknife(*terms, BLOCKS), T_95_OF_PARTS * _jackknife(*terms, PARTS)
        )
        if not math.isfinite(scatter_s):
            return offset_s, math.inf
        power = abs(np.vdot(*self._smoothed(offset_s, width)))
        rad_s = math.sqrt(terms[1].sum() / 2 / power)
        return offset_s, math.hypot(scatter_s, INTERPOLATION_FLOOR * rad_s * self._interval_s**2)

    def _smoothed(self, offset_s: float, width: int) -> tuple[np.ndarray, np.ndarray]:
        """Return both signals, smoothed, at the times that they share."""
        at = self._grid_s - offset_s
        shared = (at >= self._second_s[0]) & (at <= self._second_s[-1])
        if np.count_nonzero(shared) < 2 * (width + PARTS):
            return np.zeros(0), np.zeros(0)
        a = _moving_mean(self._first[shared], width)
        b = _moving_mean(np.interp(at[shared], self._second_s, self._second), width)
        return a - a.mean(), b - b.mean()

    def _terms(self, offset_s: float, width: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the terms of the sum that is zero at the lag, and of its slope."""
        a, b = self._smoothed(offset_s, width)
        if not len(a):
            return a, b
        slope_a, slope_b = np.gradient(a, self._step_s), np.gradient(b, self._step_s)
        return slope_a * b - a * slope_b, 2 * slope_a * slope_b

    def _root(self, width: int, start_s: float) -> float:
        """Return the lag at which the sum is zero, by Newton's method."""
        offset_s = start_s
        for _ in range(ROOT_STEPS):
            value, slope = (float(terms.sum()) for terms in self._terms(offset_s, width))
            if not slope > 0:
                break
            largest_s = width * self._step_s
            change_s = float(np.clip(value / slope, -largest_s, largest_s))
            offset_s += change_s
            if abs(change_s) < ROOT_CONVERGED_S:
                break
        return offset_s

    def _widths(self, start_s: float) -> list[int]:
        """Return widths of smoothing, in samples, up to the one that halves the power."""
        widths = [max(round(self._interval_s / self._step_s / 2), 1)]
        power = float(np.vdot(*self._smoothed(start_s, widths[0])))
        while (
            float(np.vdot(*self._smoothed(start_s, widths[-1]))) > power / 2
            and widths[-1] * self._step_s < self._span_s / (2 * PARTS)
        ):  # fmt: skip
            widths.append(2 * widths[-1])
        return widths

    def _best_width(self, start_s: float) -> int:
        """
        Return the smoothing that makes the lag most precise; 0 where none does.

        From wide to narrow, the precision of each is taken at the lag of the one before: a peak
        that noise made would seem sharp.
        """
        offset_s, best_s, best = start_s, math.inf, 0
        for width in reversed(self._widths(start_s)):
            deviation_s = _jackknife(*self._terms(offset_s, width), PARTS)
            if deviation_s > WORSE_RATIO * best_s:
                break
            if deviation_s < PREFERENCE_RATIO * best_s:
                best_s, best = min(deviation_s, best_s), width
            offset_s = self._root(width, start_s)
        return best


def _moving_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Return the values that a moving mean leaves, applied twice."""
    for _ in range(2):
        sums = np.cumsum(np.append(0.0, values))
        values = (sums[width:] - sums[:-width]) / width
    return values


def _jackknife(values: np.ndarray, slopes: np.ndarray, parts: int) -> float:
    """Return the standard deviation of a lag, from parts of as much information each."""
    if not len(values):
        return math.inf
    information = np.cumsum(np.abs(slopes))
    edges = np.searchsorted(information, information[-1] * np.arange(1, parts) / parts)
    value, slope = (np.array([part.sum() for part in np.split(terms, edges)])
                    for terms in (values, slopes))  # fmt: skip
    without = slope.sum() - slope
    if not without.min() > 0:
        return math.inf
    lags = (value.sum() - value) / without
    return math.sqrt((parts - 1) * float(np.var(lags)))
