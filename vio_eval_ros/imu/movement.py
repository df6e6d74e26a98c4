"""Whether a sensor was at rest, second by second, and whether its values show its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vio_eval_ros.core.sensor_stream import spread
from vio_eval_ros.imu.limits import ImuNoiseLimits

MIN_SECOND_SAMPLES = 20
WINDOWS_S = 1, 10  # whose means are compared with those before
MIN_CHANGES = 30  # of means, to know their usual size
RESOLUTION_SAMPLES = 100_000  # of which the distance of neighbouring values is taken
MIN_REPEATED_RATIO = 0.1  # of the samples; values that are not rounded hardly ever repeat


@dataclass(frozen=True, eq=False)
class Seconds:
    """
    One axis, second by second; a second has at least 20 samples.

    :param means: (S_i,) of each segment.
    :param scatter: (S,) standard deviations, of all segments, as are the others.
    :param still: (S,) whether all values are equal.
    :param resolution: distance of neighbouring values where too coarse to show the noise, else 0.
    """

    means: list[np.ndarray]
    scatter: np.ndarray
    still: np.ndarray
    resolution: float

    def moving(self, limits: ImuNoiseLimits) -> np.ndarray:
        """
        Return the seconds in which the sensor was not at rest, (S,) bool.

        They scatter much more than usual, or their mean differs from the previous one by more
        than noise and random walk explain in the rest of the record. Seconds in which the value
        is constant are not judged.
        """
        changing = self.scatter[~self.still]
        if not len(changing):
            return np.zeros(len(self.scatter), bool)
        rounding = self.resolution / np.sqrt(12)
        usual_scatter = max(float(np.median(changing)), rounding)
        found = self.scatter > limits.scatter_ratio * usual_scatter
        for width in WINDOWS_S:
            places, changes = self._changes(width)
            if len(changes) >= MIN_CHANGES:
                off = np.abs(changes - np.median(changes))
                usual = max(spread(changes), rounding)
                # the wider window adds nothing where the narrower one found a movement
                before = np.concatenate([[0], np.cumsum(found)])
                new = before[places + width] == before[places - width]
                found[places[(off > limits.mean_change_sigmas * usual) & new]] = True
        return found

    def turning(self, limit: float) -> np.ndarray:
        """Return the (S,) seconds whose mean differs from that before by more than a limit."""
        changes = [np.abs(np.diff(means, prepend=means[:1])) for means in self.means]
        return np.concatenate(changes) > limit

    def _changes(self, width: int) -> tuple[np.ndarray, np.ndarray]:
        """Return where windows of ``width`` seconds begin, and how their means change there."""
        places, changes, begin = [], [], 0
        for means in self.means:
            still = self.still[begin : begin + len(means)]
            known = np.where(still, np.nan, means)[: len(means) // width * width]
            changes.append(np.diff(known.reshape(-1, width).mean(axis=1)))
            places.append(begin + width * np.arange(1, len(changes[-1]) + 1))
            begin += len(means)
        place, change = np.concatenate(places), np.concatenate(changes)
        return place[~np.isnan(change)], change[~np.isnan(change)]


def second_samples(rate_hz: float) -> int:
    """Return how many samples count as a second."""
    return max(round(rate_hz), MIN_SECOND_SAMPLES)


def seconds(
    segments: Sequence[np.ndarray], rate_hz: float, averaged: int, limits: ImuNoiseLimits
) -> Seconds:
    """
    Return one axis, second by second.

    :param segments: (n,) samples, without gaps.
    :param averaged: how many recorded samples each is the mean of.
    """
    size = second_samples(rate_hz)
    rows = [values[: len(values) // size * size].reshape(-1, size) for values in segments]
    scatter = np.concatenate([row.std(axis=1) for row in rows])
    still = np.concatenate([row.max(axis=1) == row.min(axis=1) for row in rows])
    steps = np.abs(np.diff(max(segments, key=len)[:RESOLUTION_SAMPLES]))
    resolution = 0.0
    if steps.any() and (steps == 0).mean() > MIN_REPEATED_RATIO and not still.all():
        usual = float(np.median(scatter[~still]))
        step = float(np.median(steps[steps > 0]))
        if step * np.sqrt(averaged) > limits.resolution_sigmas * usual:
            resolution = step * averaged
    return Seconds([row.mean(axis=1) for row in rows], scatter, still, resolution)
