"""
The overlapping Allan deviation of a signal, and its covariance.

allantools, which computes it, is imported where it is used: it takes a second, and is an extra.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

TAUS_PER_DECADE = 10
CONFIDENCE = 0.95


class Variances(NamedTuple):
    """
    The three terms of the model, each squared; u is rad/s or m/s².

    The Allan variance is N²/τ + (2 ln 2/π) B² + K² τ/3 (IEEE Std 952-1997, annex C).

    :param white: N², u²/Hz.
    :param flicker: B², u².
    :param walk: K², u²/s²/Hz.
    """

    white: float
    flicker: float
    walk: float


@dataclass(frozen=True, eq=False)
class Curve:
    """
    The Allan deviation of one axis.

    :param factors: (T,) numbers of samples averaged.
    :param deviations: (T,) in the unit of the samples.
    :param terms: (T,) numbers of differences whose mean square each is.
    :param rate_hz: of the samples.
    :param samples: number of samples.
    """

    factors: np.ndarray
    deviations: np.ndarray
    terms: np.ndarray
    rate_hz: float
    samples: int

    @cached_property
    def taus_s(self) -> np.ndarray:
        """(T,) averaging times."""
        return np.asarray(self.factors / self.rate_hz)

    @property
    def variances(self) -> np.ndarray:
        """(T,) Allan variances."""
        return np.asarray(self.deviations**2)

    def covariance(self, model: Variances) -> np.ndarray:
        """
        Return the covariance of the Allan variances of noise of the model, (T, T).

        Each is the mean of the squares of a filtered signal. The covariance of two such means is
        2/n times the integral, over all frequencies, of the product of the filtered spectra: the
        theorem of Isserlis and that of Parseval. The n is that of the longer averaging time.
        """
        whole = np.einsum('i,j,ijtu->tu', model, model, self._products)
        return np.asarray(2 * whole / np.minimum(self.terms[:, None], self.terms))

    @cached_property
    def _products(self) -> np.ndarray:
        """(3, 3, T, T) integrals of filtered spectra, for each pair of terms at unit size."""
        factors = self.factors[:, None].astype(float)
        # cycles per sample; what is slower than a thirtieth of the longest time does not matter
        frequencies = np.geomspace(min(1 / (30 * factors[-1, 0]), 0.1), 0.5, 4000)
        gain = 2 * np.sin(np.pi * frequencies)
        filters = (2 * np.sin(np.pi * frequencies * factors)) ** 4 / (2 * factors**2 * gain**2)
        spectra = np.stack(
            [np.full_like(gain, self.rate_hz), 1 / gain, 1 / (self.rate_hz * gain**2)]
        )
        products = np.empty((3, 3, len(factors), len(factors)))
        for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
            weights = 2 * spectra[i] * spectra[j] * np.gradient(frequencies)
            products[i, j] = products[j, i] = (filters * weights) @ filters.T
        return products


def interval(deviation: float, freedom: float) -> tuple[float, float]:
    """Return the 95 % confidence interval of a deviation with ``freedom`` degrees of freedom."""
    from allantools import confidence_interval

    low, high = confidence_interval(deviation, freedom, CONFIDENCE)
    return float(low), float(high)


def allan_curve(segments: Iterable[np.ndarray], rate_hz: float) -> Curve:
    """
    Return the overlapping Allan deviation at ten averaging times per decade.

    They go up to a quarter of the record, as usual, or to where gaps leave half of it. Segments
    are pooled, weighted by their numbers of differences.

    :param segments: (n,) arrays of evenly spaced samples, without gaps.
    """
    from allantools import oadev

    pooled: dict[int, tuple[float, int]] = {}
    total = 0
    for values in segments:
        total += len(values)
        for factor, deviation, terms in zip(*_segment(oadev, values), strict=True):
            before, count = pooled.get(factor, (0.0, 0))
            pooled[factor] = before + terms * deviation**2, count + terms
    kept = {
        factor: (squares / count, count)
        for factor, (squares, count) in sorted(pooled.items())
        if 2 * count >= total
    }
    means, numbers = np.array(list(kept.values())).reshape(-1, 2).T
    factors = np.array(list(kept), np.int64)
    return Curve(factors, np.sqrt(means), numbers.astype(np.int64), rate_hz, total)


def _segment(
    oadev: Callable[..., Any], values: np.ndarray
) -> tuple[list[int], list[float], list[int]]:
    """Return factors, deviations and numbers of terms of one segment."""
    longest = max(len(values) // 4, 1)
    count = int(TAUS_PER_DECADE * np.log10(longest)) + 1
    # the same factors for every segment
    factors = np.unique(np.rint(10 ** (np.arange(count) / TAUS_PER_DECADE)))
    factors = factors[2 * factors < len(values)]
    if not len(factors):
        return [], [], []
    used, deviations, _, terms = oadev(values, 1.0, 'freq', factors)
    return used.astype(int).tolist(), deviations.tolist(), terms.astype(int).tolist()
