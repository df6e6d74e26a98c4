"""What gyroscope and accelerometer say of each other: gravity turns as the gyroscope says."""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np

from vio_eval_ros.core.rotation import conjugate, from_rotation_vector, multiply, rotate
from vio_eval_ros.core.sensor_stream import SensorStream
from vio_eval_ros.inspection.findings import Finding

# Specific force is averaged over so long, within which accelerations mostly cancel out
BLOCK_S, LEAST_BLOCKS = 1.0, 10
# Gravity turns as rates in degrees say: by what they make of it, less this part, for certain
DEGREES_OFF, DEVIATIONS = 0.3, 8.0
# Means of so many blocks vary less by accelerations, which come and go. Both sides of a step have
# some, and this part of all, since of many places one is odd by chance, and most so where one side
# is short; at the step itself the bias changes by most of it
BLOCKS, LEAST_MEANS, LEAST_PART, CERTAIN, AT_ONCE = 5, 3, 0.125, 5.0, 0.5
# A bias steps by this, by that part of how fast the sensor turns (no scale is perfect), and tilts
# by a radian: whoever accelerates as much is elsewhere
BIAS_RAD_S, BIAS_OF_RATE, TILT_RAD = 0.03, 0.05, 1.0


def consistency(stream: SensorStream, which: np.ndarray, period_s: float) -> Iterator[Finding]:
    """
    Yield where the gyroscope turns otherwise than gravity does in the accelerometer.

    :param which: (N,) indices of those samples that are measured as they should be.
    """
    assert stream.numbers is not None
    size = max(round(BLOCK_S / period_s), 2)
    count = len(which) // size
    if count <= LEAST_BLOCKS:
        return
    starts = which[: count * size : size]
    blocks = stream.numbers[which[: count * size]].reshape(count, size, 6)
    # from block to block nothing is missing where both are as long as they should be
    ends = np.append(starts[1:], which[count * size - 1])
    lengths = np.diff(stream.times_ns[np.stack([starts, ends], axis=1)], axis=1)[:, 0] / 1e9
    is_long = np.abs(lengths / (size * period_s) - 1) < 0.1
    is_whole = is_long[:-1] & is_long[1:]
    turns, left = tilts(blocks, period_s, 0.0), tilts(blocks, period_s, math.pi / 180)
    if _explains((turns - left)[is_whole], turns[is_whole]):
        rate = float(np.median(np.linalg.norm(blocks[:, :, :3], axis=2)))
        yield Finding(
            'units', stream.topic, 'fail',
            f'gravity turns {180 / math.pi:.0f} times slower than the gyroscope says, '
            f'{rate:.3g} rad/s in the median: in degrees?',
            value=rate, unit='rad/s',
        )  # fmt: skip
    else:
        rates = np.linalg.norm(blocks[:, :, :3].mean(axis=1), axis=1)
        tilted = np.where(is_whole[:, None], tilts(blocks, period_s), math.nan)
        yield from _bias_step(stream, starts, tilted, float(rates.mean()))


def _explains(expected: np.ndarray, turns: np.ndarray) -> bool:
    """Return whether (N, 3) turns are those expected, by the slope of one over the other."""
    square = float(np.sum(expected**2))
    if not square:
        return False
    slope = float(np.sum(expected * turns)) / square
    deviation = math.sqrt(float(np.mean((turns - slope * expected) ** 2)) / square)
    return abs(slope - 1) < DEGREES_OFF and slope > DEVIATIONS * deviation


def tilts(blocks: np.ndarray, period_s: float, scale: float = 1.0) -> np.ndarray:
    """
    Return by how much gravity turns from block to block, other than the gyroscope says.

    :param blocks: (B, M, 6) rates and specific forces, M samples that follow each other.
    :param scale: what makes rad/s of the rates.
    :return: (B - 1, 3) rad, rotation vectors in the axes of the sensor between two blocks; about
        the vertical there is nothing to tell.
    """
    steps = from_rotation_vector(blocks[:, :, :3] * (scale * period_s))
    turned = np.tile([0.0, 0.0, 0.0, 1.0], (len(blocks), 1))
    begin = np.zeros((len(blocks), 3))
    for k in range(blocks.shape[1]):
        begin += rotate(turned, blocks[:, k, 3:])
        turned = multiply(turned, steps[:, k])
    expected, felt = rotate(conjugate(turned), begin)[:-1], begin[1:]
    axes = np.cross(expected, felt)
    sines = np.linalg.norm(axes, axis=1)
    angles = np.arctan2(sines, np.sum(expected * felt, axis=1))
    return axes * (angles / np.maximum(sines, 1e-300))[:, None]


def _bias_step(
    stream: SensorStream, starts: np.ndarray, tilted: np.ndarray, rate: float
) -> Iterator[Finding]:
    """
    Yield where the bias of the gyroscope steps.

    :param starts: (B,) indices of the first samples of the blocks between which it ``tilted``,
        (B - 1, 3) rad, while it turned by ``rate`` in the mean; NaN where that is not known.
    """
    seconds, count = BLOCKS * BLOCK_S, len(tilted) // BLOCKS
    parts = tilted[: count * BLOCKS].reshape(count, BLOCKS, 3)
    known = np.flatnonzero(~np.isnan(parts).all(axis=(1, 2)))
    bias, count = np.nanmean(parts[known], axis=1) / BLOCK_S, len(known)
    best = (0.0, 0, 0.0)
    least = max(LEAST_MEANS, math.ceil(LEAST_PART * count))
    for k in range(least, count - least + 1):
        before, behind = bias[:k], bias[k:]
        step = float(np.linalg.norm(behind.mean(axis=0) - before.mean(axis=0)))
        square = (len(before) * before.var(axis=0) + len(behind) * behind.var(axis=0)).sum()
        pooled = float(square) / (count - 2) * (1 / k + 1 / (count - k))
        # a short side that is odd varies more than the long one
        own = float((before.var(axis=0) / (k - 1) + behind.var(axis=0) / (count - k - 1)).sum())
        noise = math.sqrt(max(pooled, own))
        best = max(best, (step / max(noise, 1e-6), k, step))
    certainty, k, step = best
    tilt_rad = step * min(k, count - k) * seconds
    if not k:
        return
    around = bias[k : k + 2].mean(axis=0) - bias[k - 2 : k].mean(axis=0)
    if (
        certainty > CERTAIN
        and step > BIAS_RAD_S + BIAS_OF_RATE * rate
        and tilt_rad > TILT_RAD
        and np.linalg.norm(around) > AT_ONCE * step
    ):
        a, b = (int(starts[max(BLOCKS * int(known[k]) - n, 0)]) for n in (1, -1))
        yield Finding(
            'bias_step', stream.topic, 'warn',
            f'the bias of the gyroscope steps by {step:.2g} rad/s: from there on gravity turns '
            'otherwise than it says',
            value=step, unit='rad/s', moments=(stream.moment(a, b),),
        )  # fmt: skip
