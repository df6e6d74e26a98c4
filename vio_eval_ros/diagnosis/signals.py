"""The lag between any two signals of one quantity."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.diagnosis.correlation import correlate
from vio_eval_ros.diagnosis.fitting import BLOCKS, T_95
from vio_eval_ros.errors import NoPairs

FEWEST = 20
MOST_SAMPLES = 1 << 20
ITERATIONS = 8
CONVERGED_S = 1e-7
# The smoothing is chosen by how certain so many parts make the lag, and so much more certain has
# a wider one to be; a narrow one that is so much less certain follows the noise
PARTS, WIDER, WORSE = 30, 1.3, 1.6
# 95 % of Student's distribution with 29 degrees of freedom are within this
T_95_OF_PARTS = 2.045
# of the longer interval between samples, for each radian that the signals turn in it: what
# interpolation leaves of hardly sampled ones
FLOOR_INTERVALS = 0.04
# another peak may be the right one where no more than this is left unexplained
AMBIGUOUS, ANYHOW = 1.1, 0.02


@dataclass(frozen=True)
class SignalLag:
    """
    How much later the stamps of the first signal are.

    :param offset_s: seconds.
    :param uncertainty_s: half the width of its 95 % interval.
    :param sign: of the gain, 1 or -1.
    :param peak: correlation coefficient at the best lag of the grid, with that sign made good.
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
    if min(len(first), len(second)) < FEWEST:
        raise NoPairs(f'the signals have {len(first)} and {len(second)} samples; {FEWEST} needed')
    spans = [float(np.ptp(stamps)) for stamps in (first_s, second_s)]
    if not min(np.ptp(first), np.ptp(second)) > 0:
        raise NoPairs('a signal that never changes has no lag')
    step_s = min(float(np.median(np.diff(stamps))) for stamps in (first_s, second_s))
    step_s = max(step_s, sum(spans) / MOST_SAMPLES)
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
    offset_s, uncertainty_s = _refined(first_s, first, second_s, sign * second, start_s)
    next_peak = float(np.fmax(best.rival, other.height))
    ambiguous = _rivals(next_peak, best.height)
    return SignalLag(offset_s, uncertainty_s, sign, best.height, next_peak, ambiguous)


def _rivals(height: float, peak: float) -> bool:
    """Return whether a correlation leaves hardly more unexplained than that of the peak."""
    return height > 0 and 1 - height**2 < AMBIGUOUS * (1 - peak**2) + ANYHOW


def _refined(
    first_s: np.ndarray,
    first: np.ndarray,
    second_s: np.ndarray,
    second: np.ndarray,
    start_s: float,
) -> tuple[float, float]:
    """
    Return the lag, and half the width of its 95 % interval.

    Both signals are noisy, so neither is fitted to the other: at the lag, Σ a'b - ab' is zero in
    the mean, whatever their noise, and its slope is 2 Σ a'b'. Both are smoothed alike, as widely
    as makes the lag most certain.
    """
    intervals_s = [float(np.median(np.diff(stamps))) for stamps in (first_s, second_s)]
    span_s = float(np.ptp(first_s))
    step_s = max(min(*intervals_s, max(intervals_s) / 4), span_s / MOST_SAMPLES)
    grid_s = np.arange(first_s[0], first_s[-1], step_s)
    values = np.interp(grid_s, first_s, first)

    def smoothed(offset_s: float, width: int) -> tuple[np.ndarray, np.ndarray]:
        """Return both signals at the times that they share."""
        at = grid_s - offset_s
        shared = (at >= second_s[0]) & (at <= second_s[-1])
        if np.count_nonzero(shared) < 2 * (width + PARTS):
            return np.zeros(0), np.zeros(0)
        a = _smoothed(values[shared], width)
        b = _smoothed(np.interp(at[shared], second_s, second), width)
        return a - a.mean(), b - b.mean()

    def pulls(offset_s: float, width: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the terms of the sum that is zero at the lag, and of its slope."""
        a, b = smoothed(offset_s, width)
        if not len(a):
            return a, b
        rise_a, rise_b = np.gradient(a, step_s), np.gradient(b, step_s)
        return rise_a * b - a * rise_b, 2 * rise_a * rise_b

    def converged(width: int) -> float:
        offset_s = start_s
        for _ in range(ITERATIONS):
            pull, slope = (float(terms.sum()) for terms in pulls(offset_s, width))
            if not slope > 0:
                break
            change_s = float(np.clip(pull / slope, -width * step_s, width * step_s))
            offset_s += change_s
            if abs(change_s) < CONVERGED_S:
                break
        return offset_s

    widths = [max(round(max(intervals_s) / step_s / 2), 1)]
    power = float(np.vdot(*smoothed(start_s, widths[0])))
    while float(np.vdot(*smoothed(start_s, widths[-1]))) > power / 2 and widths[
        -1
    ] * step_s < span_s / (2 * PARTS):
        widths.append(2 * widths[-1])
    # From wide to narrow. How certain a width makes the lag is told at the lag of the one before:
    # a peak that noise made would seem sharp.
    offset_s, best_s, best = start_s, math.inf, 0
    for width in reversed(widths):
        certain_s = _jackknife(*pulls(offset_s, width), PARTS)
        if certain_s > WORSE * best_s:
            break
        if certain_s < WIDER * best_s:
            best_s, best = min(certain_s, best_s), width
        offset_s = converged(width)
    if not best:
        return start_s, math.inf
    offset_s = converged(best)
    # a few long parts know of errors that last, many short ones are told more surely
    terms = pulls(offset_s, best)
    told_s = max(T_95 * _jackknife(*terms, BLOCKS), T_95_OF_PARTS * _jackknife(*terms, PARTS))
    if not math.isfinite(told_s):
        return offset_s, math.inf
    turning = math.sqrt(terms[1].sum() / 2 / abs(np.vdot(*smoothed(offset_s, best))))
    return offset_s, math.hypot(told_s, FLOOR_INTERVALS * turning * max(intervals_s) ** 2)


def _smoothed(values: np.ndarray, width: int) -> np.ndarray:
    """Return the values that a moving mean leaves, applied twice."""
    for _ in range(2):
        sums = np.cumsum(np.append(0.0, values))
        values = (sums[width:] - sums[:-width]) / width
    return values


def _jackknife(pulls: np.ndarray, slopes: np.ndarray, parts: int) -> float:
    """Return the standard deviation of a lag, from parts that tell as much of it each."""
    if not len(pulls):
        return math.inf
    told = np.cumsum(np.abs(slopes))
    edges = np.searchsorted(told, told[-1] * np.arange(1, parts) / parts)
    pull, slope = (np.array([part.sum() for part in np.split(terms, edges)])
                   for terms in (pulls, slopes))  # fmt: skip
    without = slope.sum() - slope
    if not without.min() > 0:
        return math.inf
    lags = (pull.sum() - pull) / without
    return math.sqrt((parts - 1) * float(np.var(lags)))
