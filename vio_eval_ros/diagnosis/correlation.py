"""The lag at which two signals correlate best."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np

#: of the shorter signal, the share that must overlap
OVERLAP_SHARE = 0.3
#: another peak rises by this share of the height of the best, out of the valley between
RISE_SHARE = 0.1
#: unexplained share of the variance under another lag that may be the right one: at most this many
#: times that under the best ...
RIVAL_RATIO = 2.0
#: ... plus this
RIVAL_RESIDUAL = 0.1


@dataclass(frozen=True)
class Peak:
    """
    The best of the lags of a normalised cross-correlation.

    :param lag_s: how much later the first signal's stamps are than the second's, in seconds.
    :param height: correlation coefficient there, -1 to 1.
    :param rival: the height of the highest other peak, beyond a valley, or of either end of the
        lags, so that a correlation that never falls has a rival too; NaN where there is none.
    :param others_s: lags of other peaks that are hardly lower, as those of motion in laps are.
    """

    lag_s: float
    height: float
    rival: float
    others_s: tuple[float, ...] = ()

    def later(self, seconds: float) -> Peak:
        """Return the peak where the first signal's clock begins so much later."""
        return replace(
            self,
            lag_s=self.lag_s + seconds,
            others_s=tuple(lag_s + seconds for lag_s in self.others_s),
        )


def correlate(
    first: np.ndarray, second: np.ndarray, step_s: float, max_lag_s: float = math.inf
) -> Peak:
    """
    Return where two evenly sampled signals correlate best.

    For every lag the coefficient is that of the samples that both have, so that neither ends nor
    gaps count as zeros; at least 30 % of the shorter signal must overlap.

    :param first: (N,) samples, NaN where unknown.
    :param second: (M,) samples that begin at the same time.
    :param step_s: between samples.
    """
    size = 1 << (len(first) + len(second) - 1).bit_length()
    known = [np.isfinite(signal) for signal in (first, second)]
    if not all(part.any() for part in known):
        return Peak(0.0, math.nan, math.nan)
    # removing the means beforehand keeps the digits of the sums
    a, b = (
        np.where(part, signal - signal[part].mean(), 0.0)
        for part, signal in zip(known, (first, second), strict=True)
    )
    ones, twos = (part.astype(float) for part in known)
    spectra = {
        name: np.fft.rfft(signal, size)
        for name, signal in {
            'a': a, 'aa': a * a, '1': ones, 'b': b, 'bb': b * b, '2': twos
        }.items()
    }  # fmt: skip

    def sums(left: str, right: str) -> np.ndarray:
        """Return the sum over all k of left[k + lag] right[k], for every lag."""
        return np.fft.irfft(spectra[left] * np.conj(spectra[right]), size)

    count = np.round(sums('1', '2'))
    usable = count >= max(3, OVERLAP_SHARE * min(part.sum() for part in known))
    lags = np.arange(size)
    lags[size - len(second) + 1 :] -= size
    usable &= (np.abs(lags) * step_s <= max_lag_s) & (lags < len(first))
    count = count.clip(min=1)
    mean_a, mean_b = sums('a', '2') / count, sums('1', 'b') / count
    spread = (sums('aa', '2') / count - mean_a**2) * (sums('1', 'bb') / count - mean_b**2)
    covariance = sums('a', 'b') / count - mean_a * mean_b
    floor = 1e-12 * float(np.max(spread, initial=0.0))
    height = np.where(
        usable & (spread > floor),
        covariance / np.sqrt(spread.clip(min=max(floor, 1e-300))),
        -np.inf,
    )
    # by increasing lag, with minus infinity beyond both ends
    height = np.pad(np.roll(height, len(second) - 1), 1, constant_values=-np.inf)
    best = int(np.argmax(height))
    if not math.isfinite(height[best]):
        return Peak(0.0, math.nan, math.nan)
    rival = max(_rival(side[np.isfinite(side)]) for side in (height[best::-1], height[best:]))
    return Peak(
        (best - len(second) + _vertex(*height[best - 1 : best + 2])) * step_s,
        float(height[best]),
        rival if math.isfinite(rival) else math.nan,
        tuple((np.array(_others(height, best)) - len(second)) * step_s),
    )


def _others(height: np.ndarray, best: int) -> list[int]:
    """Return the highest of each stretch of heights that nearly reach the best elsewhere."""
    limit = 1 - RIVAL_RATIO * (1 - height[best] ** 2) - RIVAL_RESIDUAL
    high = height > math.sqrt(max(limit, 0.0))
    edges = np.flatnonzero(np.diff(high, prepend=False, append=False))
    stretches = [slice(begin, end) for begin, end in edges.reshape(-1, 2).tolist()]
    highest = [one.start + int(np.argmax(height[one])) for one in stretches]
    return [k for k in highest if k != best]


def _rival(height: np.ndarray) -> float:
    """Return the highest other peak, or the end, given the heights from the peak outwards."""
    rising = height - np.minimum.accumulate(height) > RISE_SHARE * abs(height[0])
    rising[-1] = len(height) > 1
    return float(height[rising].max(initial=-np.inf))


def _vertex(before: float, at: float, after: float) -> float:
    """Return where the parabola through three samples one apart has its peak, from the middle."""
    curvature = before - 2 * at + after
    if not (math.isfinite(curvature) and curvature < 0):
        return 0.0
    return 0.5 * (before - after) / curvature
