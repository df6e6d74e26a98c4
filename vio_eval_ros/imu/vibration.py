"""Vibrations: lines of the spectrum that raise the noise density."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from vio_eval_ros.imu.allan import Curve
from vio_eval_ros.imu.fit import fit_noise
from vio_eval_ros.imu.limits import ImuNoiseLimits

SPECTRUM_SAMPLES = 4096  # of each spectrum that is averaged
MIN_SPECTRA = 8
NEIGHBOUR_BINS = 32  # on either side of a line in the spectrum
LINE_TO_MEDIAN = 4.0  # power of a line, over the median of its neighbours


class Vibration(NamedTuple):
    """The strongest line of a spectrum, and by which share all of them raise the density."""

    frequency_hz: float
    density_rise: float


def vibration(
    segments: Sequence[np.ndarray], curve: Curve, limits: ImuNoiseLimits
) -> Vibration | None:
    """
    Return the strongest vibration; None where the density is not raised beyond the limit.

    The lines of the spectrum, filtered as each averaging time filters them, are taken from the
    Allan variances, which are fitted again.

    :param segments: (n,) samples, without gaps.
    """
    cycles, powers = _lines(segments)
    if not len(cycles):
        return None
    factors = curve.factors[:, None].astype(float)
    filters = np.sin(np.pi * cycles * factors) ** 4 / (factors * np.sin(np.pi * cycles)) ** 2
    raised = 2 * filters @ powers
    variances = np.maximum(curve.variances - raised, 1e-3 * curve.variances)
    without = replace(curve, deviations=np.sqrt(variances))
    with_lines, without_lines = (fit_noise(one, limits=limits) for one in (curve, without))
    rise = with_lines.density.value / without_lines.density.value - 1
    if not rise > limits.vibration_ratio:
        return None
    return Vibration(float(cycles[powers.argmax()] * curve.rate_hz), rise)


def _lines(segments: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (cycles per sample) and powers of what stands out of the spectrum."""
    window = np.hanning(SPECTRUM_SAMPLES)
    power, count = np.zeros(SPECTRUM_SAMPLES // 2 + 1), 0
    for values in segments:
        for begin in range(0, len(values) - SPECTRUM_SAMPLES + 1, SPECTRUM_SAMPLES):
            piece = values[begin : begin + SPECTRUM_SAMPLES]
            power += np.abs(np.fft.rfft(window * (piece - piece.mean()))) ** 2
            count += 1
    if count < MIN_SPECTRA:
        return np.empty(0), np.empty(0)
    power *= 2 / (count * SPECTRUM_SAMPLES * window @ window)
    windows = np.lib.stride_tricks.sliding_window_view(power, 2 * NEIGHBOUR_BINS + 1)
    usual = np.pad(np.median(windows, axis=1), NEIGHBOUR_BINS, constant_values=np.inf)
    above = np.where(power > LINE_TO_MEDIAN * usual, power - usual, 0)
    # adjacent bins are one line, at their mean frequency
    edges = np.flatnonzero(np.diff(above > 0, prepend=False))[::2]
    powers = np.add.reduceat(above, edges) if len(edges) else np.empty(0)
    moments = np.add.reduceat(above * np.arange(len(above)), edges) if len(edges) else powers
    return moments / powers / SPECTRUM_SAMPLES, powers
