"""The lag between any two signals of one quantity."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.diagnosis.correlation import correlate
from vio_eval_ros.diagnosis.fitting import least_squares
from vio_eval_ros.errors import NoPairs

FEWEST = 20
MOST_SAMPLES = 1 << 20
ITERATIONS = 15


@dataclass(frozen=True)
class SignalLag:
    """
    How much later the stamps of the first signal are.

    :param offset_s: seconds.
    :param uncertainty_s: half the width of its 95 % interval.
    :param peak: correlation coefficient at the best lag of the grid.
    :param next_peak: the highest more than a second away; NaN where there is none.
    """

    offset_s: float
    uncertainty_s: float
    peak: float
    next_peak: float


def lag_of_signals(
    first_s: np.ndarray, first: np.ndarray, second_s: np.ndarray, second: np.ndarray
) -> SignalLag:
    """
    Return how much later the stamps of one signal are than those of another.

    The peak of the normalised cross-correlation over all lags, refined by least squares: with
    gain and bias free, the second signal shifted by the offset has to be the first.

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
    peak = correlate(
        np.interp(grids[0], first_s, first), np.interp(grids[1], second_s, second), step_s
    )
    if math.isnan(peak.height):
        raise NoPairs('the signals have too little in common to be compared at any lag')
    start_s = float(first_s[0] - second_s[0])
    offset_s, uncertainty_s = peak.lag_s + start_s, math.inf
    for _ in range(ITERATIONS):
        at = first_s - offset_s
        inside = (at > second_s[0] + step_s) & (at < second_s[-1] - step_s)
        if np.count_nonzero(inside) < FEWEST:
            break
        now, before, after = (
            np.interp(at[inside] + shift, second_s, second) for shift in (0, -step_s, step_s)
        )
        slope = (before - after) / (2 * step_s)
        gain, bias = np.polyfit(now, first[inside], 1)
        design = np.stack([gain * slope, now, np.ones(len(now))], -1)[:, None]
        rest = (first[inside] - gain * now - bias)[:, None]
        fit = least_squares(design, rest, np.array([1e3 * step_s, 1e6, 1e6]), np.ones(len(now)))
        change_s = float(np.clip(fit.values[0], -step_s, step_s))
        offset_s, uncertainty_s = offset_s + change_s, fit.uncertainty(0)
        if abs(change_s) < 1e-9:
            break
    return SignalLag(offset_s, uncertainty_s, peak.height, peak.rival)
