"""Whether gravity, as the accelerometer feels it, rotates as the gyroscope says."""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np

from vio_eval_ros.core.rotation import conjugate, from_rotation_vector, multiply, rotate
from vio_eval_ros.core.sensor_stream import SensorStream
from vio_eval_ros.inspection.finding import Finding
from vio_eval_ros.inspection.findings import FINDINGS
from vio_eval_ros.inspection.limits import InspectionLimits

#: length of the blocks over which specific force is averaged: accelerations mostly cancel out
BLOCK_S = 1.0
#: fewer blocks are no evidence
MIN_BLOCKS = 10
#: relative error of the length of a block in which no sample is missing
WHOLE_TOLERANCE = 0.1
#: rates are in degrees where the slope of the rotation of gravity, over that expected of rates in
#: degrees, is within this of 1 ...
SLOPE_TOLERANCE = 0.3
#: ... and at least this many standard deviations above 0
SLOPE_DEVIATIONS = 8.0
#: blocks of which each bias is the mean, since accelerations come and go
BIAS_BLOCKS = 5
#: least number of biases before and after a step ...
MIN_BIASES = 3
#: ... and least share of all: among many places, one with a short side stands out by chance
MIN_SIDE = 0.125
#: standard deviations beyond which a step is significant
STEP_DEVIATIONS = 5.0
#: least share of a step that happens within four biases
STEP_AT_ONCE = 0.5
#: share of the mean rate that an error of the scale explains
SCALE_ERROR = 0.05
#: least standard deviation of a step of the bias
MIN_NOISE_RAD_S = 1e-6


def consistency(
    stream: SensorStream, which: np.ndarray, period_s: float, limits: InspectionLimits
) -> Iterator[Finding]:
    """
    Yield where the gyroscope rotates otherwise than gravity does in the accelerometer.

    :param which: (N,) indices of those samples that are measured as they should be.
    """
    assert stream.numbers is not None
    size = max(round(BLOCK_S / period_s), 2)
    count = len(which) // size
    if count <= MIN_BLOCKS:
        return
    starts = which[: count * size : size]
    blocks = stream.numbers[which[: count * size]].reshape(count, size, 6)
    # from block to block nothing is missing where both are as long as they should be
    ends = np.append(starts[1:], which[count * size - 1])
    lengths = np.diff(stream.times_ns[np.stack([starts, ends], axis=1)], axis=1)[:, 0] / 1e9
    is_long = np.abs(lengths / (size * period_s) - 1) < WHOLE_TOLERANCE
    is_whole = is_long[:-1] & is_long[1:]
    rotations, left = tilts(blocks, period_s, 0.0), tilts(blocks, period_s, math.pi / 180)
    if _explains((rotations - left)[is_whole], rotations[is_whole]):
        yield FINDINGS['units'].found(
            stream,
            'gravity',
            factor=180 / math.pi,
            value=float(np.median(np.linalg.norm(blocks[:, :, :3], axis=2))),
            unit='rad/s',
        )
    else:
        rates = np.linalg.norm(blocks[:, :, :3].mean(axis=1), axis=1)
        tilted = np.where(is_whole[:, None], tilts(blocks, period_s), math.nan)
        yield from _bias_step(stream, starts, tilted, float(rates.mean()), limits)


def _explains(expected: np.ndarray, measured: np.ndarray) -> bool:
    """Return whether (N, 3) rotations are those expected, by the slope of one over the other."""
    square = float(np.sum(expected**2))
    if not square:
        return False
    slope = float(np.sum(expected * measured)) / square
    deviation = math.sqrt(float(np.mean((measured - slope * expected) ** 2)) / square)
    return abs(slope - 1) < SLOPE_TOLERANCE and slope > SLOPE_DEVIATIONS * deviation


def tilts(blocks: np.ndarray, period_s: float, scale: float = 1.0) -> np.ndarray:
    """
    Return by how much gravity rotates from block to block beyond what the gyroscope says.

    :param blocks: (B, M, 6) rates and specific forces, M samples that follow each other.
    :param scale: what makes rad/s of the rates.
    :return: (B - 1, 3) rad, rotation vectors in the axes of the sensor between two blocks;
        rotation about the vertical is not observable.
    """
    steps = from_rotation_vector(blocks[:, :, :3] * (scale * period_s))
    rotation = np.tile([0.0, 0.0, 0.0, 1.0], (len(blocks), 1))
    begin = np.zeros((len(blocks), 3))
    for k in range(blocks.shape[1]):
        begin += rotate(rotation, blocks[:, k, 3:])
        rotation = multiply(rotation, steps[:, k])
    expected, felt = rotate(conjugate(rotation), begin)[:-1], begin[1:]
    axes = np.cross(expected, felt)
    sines = np.linalg.norm(axes, axis=1)
    angles = np.arctan2(sines, np.sum(expected * felt, axis=1))
    return axes * (angles / np.maximum(sines, 1e-300))[:, None]


def _bias_step(
    stream: SensorStream,
    starts: np.ndarray,
    tilted: np.ndarray,
    rate: float,
    limits: InspectionLimits,
) -> Iterator[Finding]:
    """
    Yield where the bias of the gyroscope steps.

    :param starts: (B,) indices of the first samples of the blocks between which it ``tilted``,
        (B - 1, 3) rad, while it rotated at ``rate`` in the mean; NaN where that is not known.
    """
    count = len(tilted) // BIAS_BLOCKS
    parts = tilted[: count * BIAS_BLOCKS].reshape(count, BIAS_BLOCKS, 3)
    known = np.flatnonzero(~np.isnan(parts).all(axis=(1, 2)))
    bias = np.nanmean(parts[known], axis=1) / BLOCK_S
    certainty, k, step = _most_certain_step(bias)
    if not k:
        return
    tilt_rad = step * min(k, len(bias) - k) * (BIAS_BLOCKS * BLOCK_S)
    at_once = bias[k : k + 2].mean(axis=0) - bias[k - 2 : k].mean(axis=0)
    if (
        certainty > STEP_DEVIATIONS
        and step > limits.bias_step_rad_s + SCALE_ERROR * rate
        and tilt_rad > limits.bias_step_tilt_rad
        and np.linalg.norm(at_once) > STEP_AT_ONCE * step
    ):
        a, b = (int(starts[max(BIAS_BLOCKS * int(known[k]) - n, 0)]) for n in (1, -1))
        yield FINDINGS['bias_step'].found(stream, value=step, moments=(stream.moment(a, b),))


def _most_certain_step(bias: np.ndarray) -> tuple[float, int, float]:
    """
    Return by how many deviations (N, 3) biases step, before which, and by how much.

    The deviation is that of the difference of two means, of equal variances or of different ones
    (Welch), whichever is larger: a short side that is an outlier varies more than the long one.
    """
    best = (0.0, 0, 0.0)
    count = len(bias)
    least = max(MIN_BIASES, math.ceil(MIN_SIDE * count))
    for k in range(least, count - least + 1):
        before, after = bias[:k], bias[k:]
        step = float(np.linalg.norm(after.mean(axis=0) - before.mean(axis=0)))
        square = (len(before) * before.var(axis=0) + len(after) * after.var(axis=0)).sum()
        pooled = float(square) / (count - 2) * (1 / k + 1 / (count - k))
        welch = float((before.var(axis=0) / (k - 1) + after.var(axis=0) / (count - k - 1)).sum())
        noise = math.sqrt(max(pooled, welch))
        best = max(best, (step / max(noise, MIN_NOISE_RAD_S), k, step))
    return best
