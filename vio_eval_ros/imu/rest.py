"""What tells that a sensor was not at rest, or that its values are not its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vio_eval_ros.imu.allan import Curve
from vio_eval_ros.imu.fit import fit_noise, MISFIT

FEWEST_SAMPLES = 20  # of what is called a second
SHAKEN = 4.0  # times the usual scatter within a second
WIDTHS = 1, 10  # s, of the neighbours whose means are compared
FEWEST_CHANGES = 30  # of means, to say what is usual
# Standard deviations of the usual change; chance exceeds them once in 100,000 records of 6 h.
JUMP = 6.5
NORMAL = 1.4826  # standard deviations in a median of absolute deviations
LOOKED_AT = 100_000  # samples that tell how far apart the values of an axis are
REPEATED = 0.1  # of the samples; values that are not rounded hardly ever repeat
# Times the scatter that values may be apart: 1.5 times the noise of the sensor, beyond which
# rounding adds more than 10 % to the density, or takes from it.
COARSE = 1.4
SPECTRUM = 4096  # samples of each spectrum that is averaged
FEWEST_SPECTRA = 8
BESIDE = 32  # neighbours on either side of a line in the spectrum
LINE = 4.0  # times their median


@dataclass(frozen=True, eq=False)
class Seconds:
    """
    Each second (or 20 samples) of one axis.

    :param means: (S_i,) of each segment.
    :param scatter: (S,) standard deviations, of all segments, as are the others.
    :param still: (S,) whether all values are the same.
    :param step: how far values are apart where that is too far to show the noise, else 0.
    """

    means: list[np.ndarray]
    scatter: np.ndarray
    still: np.ndarray
    step: float

    def unrest(self) -> np.ndarray:
        """
        Return which seconds are not those of a sensor at rest, (S,) bool.

        Those of much more scatter than usual, and those whose mean differs from the one before
        by more than noise and random walk make it differ in the rest of the record. Seconds in
        which the value stands still tell nothing.
        """
        changing = self.scatter[~self.still]
        if not len(changing):
            return np.zeros(len(self.scatter), bool)
        rounding = self.step / np.sqrt(12)
        found = self.scatter > SHAKEN * max(float(np.median(changing)), rounding)
        for width in WIDTHS:
            places, changes = self._changes(width)
            if len(changes) >= FEWEST_CHANGES:
                off = np.abs(changes - np.median(changes))
                usual = max(NORMAL * float(np.median(off)), rounding)
                # the wider tell nothing new where the narrower have told
                before = np.concatenate([[0], np.cumsum(found)])
                new = before[places + width] == before[places - width]
                found[places[(off > JUMP * usual) & new]] = True
        return found

    def _changes(self, width: int) -> tuple[np.ndarray, np.ndarray]:
        """Return how the mean of some seconds differs from that of those before, and where."""
        places, changes, begin = [], [], 0
        for means in self.means:
            still = self.still[begin : begin + len(means)]
            moving = np.where(still, np.nan, means)[: len(means) // width * width]
            changes.append(np.diff(moving.reshape(-1, width).mean(axis=1)))
            places.append(begin + width * np.arange(1, len(changes[-1]) + 1))
            begin += len(means)
        place, change = np.concatenate(places), np.concatenate(changes)
        return place[~np.isnan(change)], change[~np.isnan(change)]


def second_samples(rate_hz: float) -> int:
    """Return how many samples are taken for a second."""
    return max(round(rate_hz), FEWEST_SAMPLES)


def seconds(segments: Sequence[np.ndarray], rate_hz: float, averaged: int) -> Seconds:
    """
    Return each second of one axis.

    :param segments: (n,) samples, without gaps.
    :param averaged: how many recorded samples each is the mean of.
    """
    size = second_samples(rate_hz)
    rows = [values[: len(values) // size * size].reshape(-1, size) for values in segments]
    scatter = np.concatenate([row.std(axis=1) for row in rows])
    still = np.concatenate([row.max(axis=1) == row.min(axis=1) for row in rows])
    steps = np.abs(np.diff(max(segments, key=len)[:LOOKED_AT]))
    step = 0.0
    if steps.any() and (steps == 0).mean() > REPEATED and not still.all():
        usual = float(np.median(scatter[~still]))
        found = float(np.median(steps[steps > 0]))
        if found * np.sqrt(averaged) > COARSE * usual:
            step = found * averaged
    return Seconds([row.mean(axis=1) for row in rows], scatter, still, step)


def vibration(segments: Sequence[np.ndarray], curve: Curve) -> tuple[float, float] | None:
    """
    Return the strongest vibration and by how much it raises the density, if by more than 10 %.

    The lines of the spectrum, filtered as each averaging time filters them, are taken from the
    Allan variances, which are fitted again.

    :return: frequency in Hz, relative rise of the density; None where there is nothing to tell.
    """
    cycles, powers = _lines(segments)
    if not len(cycles):
        return None
    factors = curve.factors[:, None].astype(float)
    filters = np.sin(np.pi * cycles * factors) ** 4 / (factors * np.sin(np.pi * cycles)) ** 2
    raised = 2 * filters @ powers
    variances = np.maximum(curve.variances - raised, 1e-3 * curve.variances)
    without = replace(curve, deviations=np.sqrt(variances))
    rise = fit_noise(curve).density.value / fit_noise(without).density.value - 1
    return (float(cycles[powers.argmax()] * curve.rate_hz), rise) if rise > MISFIT else None


def _lines(segments: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies (in cycles a sample) and powers of what stands out of the spectrum."""
    window = np.hanning(SPECTRUM)
    power, count = np.zeros(SPECTRUM // 2 + 1), 0
    for values in segments:
        for begin in range(0, len(values) - SPECTRUM + 1, SPECTRUM):
            piece = values[begin : begin + SPECTRUM]
            power += np.abs(np.fft.rfft(window * (piece - piece.mean()))) ** 2
            count += 1
    if count < FEWEST_SPECTRA:
        return np.empty(0), np.empty(0)
    power *= 2 / (count * SPECTRUM * window @ window)
    windows = np.lib.stride_tricks.sliding_window_view(power, 2 * BESIDE + 1)
    usual = np.pad(np.median(windows, axis=1), BESIDE, constant_values=np.inf)
    above = np.where(power > LINE * usual, power - usual, 0)
    # neighbours are one line, at their mean frequency
    edges = np.flatnonzero(np.diff(above > 0, prepend=False))[::2]
    powers = np.add.reduceat(above, edges) if len(edges) else np.empty(0)
    moments = np.add.reduceat(above * np.arange(len(above)), edges) if len(edges) else powers
    return moments / powers / SPECTRUM, powers
