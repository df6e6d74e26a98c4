"""
Whether two runs on one sequence differ beyond what their own errors would do by chance.

Errors of neighbouring poses are alike, so that a run of ten thousand poses may hold as few
independent pieces as a dozen. Both runs are therefore resampled together, in blocks of shared time
that are longer than their memory (Künsch 1989, doi:10.1214/aos/1176347265).
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import re

import numpy as np

from vio_eval_ros.core.alignment import Moments, solve
from vio_eval_ros.core.config import Delta
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.matching import nearest
from vio_eval_ros.core.metrics import ALWAYS_ALIGNED, position_errors, rotation_errors
from vio_eval_ros.core.relative import candidates, progress_along, relative_errors, RPE_KINDS
from vio_eval_ros.evaluation.result import Result

RESAMPLES = 4999
SEED = 0
CONFIDENCE = 0.95
#: a run with fewer independent pieces does not tell: the interval would be too narrow
LEAST_PIECES = 50
LEAST_BLOCKS = 8
#: a rarer tail is not told from what was resampled
LEAST_TAIL = 5e-7
#: standard errors that an interval reaches to; beyond that it is nonsense
MOST_ERRORS = 50.0
#: errors are averaged into as many pieces of time before anything else: bounds time and memory
MOST_CELLS = 4096
#: more do not make the interval better
MOST_BLOCKS = 128
ATE = re.compile(rf'ate(?:_({"|".join(ALWAYS_ALIGNED)}))?_(trans|rot)_(rmse|mean)_(?:m|deg)')
RPE = re.compile(rf'rpe_(.+)_({"|".join(RPE_KINDS)})_(rmse|mean)_(?:m|deg)')


@dataclass(frozen=True)
class PairedDifference:
    """
    How the errors of one run differ from those of another over the time that both have.

    :param pairs: how many errors both have.
    :param pieces: to how many independent ones these amount, as far as it matters: at most
        MOST_CELLS.
    :param difference: of the metric over these, one minus other, in its unit.
    :param interval: of the difference, at CONFIDENCE; NaN where there are too few pieces.
    :param ratio: one over other, with its interval.
    :param p_value: two-sided; NaN where there are too few pieces.
    """

    pairs: int
    pieces: float
    difference: float
    interval: tuple[float, float]
    ratio: float
    ratio_interval: tuple[float, float]
    p_value: float


def compare_runs(one: Result, other: Result, metric: str) -> PairedDifference | None:
    """
    Return how two runs differ in a metric, each under its own alignment.

    :param metric: the rmse or mean of an absolute or relative error.
    :returns: None for another metric, or where the runs have no time in common.
    """
    found, against = errors_over_time(one, metric), errors_over_time(other, metric)
    if found is None or against is None:
        return None
    i, j = shared(found[0], against[0], nanoseconds(one.config.max_difference_s))
    if not len(i):
        return None
    return compare_errors(found[1][i], against[1][j], rooted='_rmse_' in metric)


def errors_over_time(result: Result, metric: str) -> tuple[np.ndarray, np.ndarray] | None:
    """
    Return (N,) stamps [ns] of the ground truth and the errors whose rmse or mean a metric is.

    Relative errors have the stamp at which they begin. None where there are none.
    """
    pairs, alignment = result.summary.pairs, result.summary.alignment
    stamps = pairs.ground_truth.stamps_ns
    if match := ATE.fullmatch(metric):
        mode, kind, _ = match.groups()
        if mode is not None:
            alignment = solve(mode, Moments.of(pairs), pairs[:1])
        errors = (position_errors if kind == 'trans' else rotation_errors)(pairs, alignment)
    elif match := RPE.fullmatch(metric):
        delta = Delta.parse(match[1])
        found = candidates(progress_along(pairs, delta.unit), delta, result.config)
        begin, end = found.begin[found.usable], found.end[found.usable]
        errors = relative_errors(pairs, begin, end, alignment)[list(RPE_KINDS).index(match[2])]
        stamps = stamps[begin]
    else:
        return None
    return (stamps, errors) if len(errors) and np.isfinite(errors).all() else None


def shared(
    stamps: np.ndarray, others: np.ndarray, tolerance_ns: int
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the indices of the shorter series and those nearest to them of the other, each once.

    :param tolerance_ns: by which they may differ, or by half an interval of the sparser ones if
        that is more: systems that give every other frame need not choose the same ones.
    """
    if len(stamps) > len(others):
        j, i = shared(others, stamps, tolerance_ns)
        return i, j
    intervals = [float(np.median(np.diff(each))) for each in (stamps, others) if len(each) > 1]
    partner = nearest(stamps, others)
    apart = np.abs(stamps - others[partner])
    near = np.flatnonzero(apart <= max(tolerance_ns, max(intervals, default=0.0) / 2))
    j, first = np.unique(partner[near], return_index=True)
    return near[first], j


def compare_errors(one: np.ndarray, other: np.ndarray, rooted: bool = True) -> PairedDifference:
    """
    Return how the root mean square, or the mean, of errors differs from that of others.

    The interval is that of a studentised block bootstrap (Götze and Künsch 1996,
    doi:10.1214/aos/1069362303) with circular blocks. Both statistics are smooth functions of
    means, so their standard errors follow from the blocks of their influence functions.

    :param one: (N,) errors; ``other`` has those at the same times.
    :param rooted: whether it is the root mean square.
    """
    cells = np.stack([_averaged(each**2 if rooted else each) for each in (one, other)])
    means = cells.mean(axis=1)
    values = np.sqrt(means) if rooted else means
    difference = float(values[0] - values[1])
    ratio = float(values[0] / values[1]) if values[1] > 0 else math.nan
    if np.array_equal(*cells):
        return PairedDifference(len(one), 0.0, 0.0, (0.0, 0.0), ratio, (ratio, ratio), 1.0)
    unknown, pieces = (math.nan, math.nan), 0.0
    if (means > 0).all():
        length, share = _block_length(_slopes(means, rooted)[0] @ (cells - means[:, None]))
        pieces = share * cells.shape[1]
        enough = pieces >= LEAST_PIECES and cells.shape[1] // length >= LEAST_BLOCKS
        # blocks without any error could make a ratio infinite
        usable = enough and _block_means(cells, length).min() > 0
        if usable and (found := _studentised(cells, length, rooted)):
            (interval, ratios), p_value = found
            ratios = math.exp(min(ratios[0], 700)), math.exp(min(ratios[1], 700))
            return PairedDifference(len(one), pieces, difference, interval, ratio, ratios, p_value)
    return PairedDifference(len(one), pieces, difference, unknown, ratio, unknown, math.nan)


def _studentised(
    cells: np.ndarray, length: int, rooted: bool
) -> tuple[list[tuple[float, float]], float] | None:
    """
    Return the intervals of the difference and of the logarithm of the ratio, and their p-value.

    The p-value is the larger of the two, so that what is significant is so in both. None where the
    errors are so rarely anything at all that resampling them says nothing.
    """
    means = cells.mean(axis=1)
    drawn, spread = _resampled(cells, length)
    intervals, p_values = [], [2 * LEAST_TAIL]
    for value, slope, values, slopes in zip(
        _statistic(means, rooted),
        _slopes(means, rooted),
        _statistic(drawn, rooted),
        _slopes(drawn, rooted),
        strict=True,
    ):
        error = _standard_error(slope @ (cells - means[:, None]), length)
        if error <= 1e-9 * abs(value):  # as of a ratio, where errors are multiples of each other
            intervals.append((float(value), float(value)))
            continue
        variances = np.einsum('ir,ijr,jr->r', slopes, spread, slopes)
        studentised = (values - value) / np.sqrt(np.maximum(variances, (1e-6 * error) ** 2))
        low, high = np.quantile(studentised, [(1 + CONFIDENCE) / 2, (1 - CONFIDENCE) / 2])
        if max(low, -high) > MOST_ERRORS:
            return None
        intervals.append((float(value - low * error), float(value - high * error)))
        side = math.copysign(1.0, value)
        p_values.append(min(1.0, 2 * _tail(side * studentised, abs(float(value)) / error)))
    return intervals, max(p_values)


def _tail(drawn: np.ndarray, value: float) -> float:
    """
    Return how rarely a value is reached, beyond what was drawn as by an exponential tail.

    Such a tail is longer than that of any mean. It matters where many comparisons are made.
    """
    start, further = map(float, np.quantile(drawn, [0.99, 0.999]))
    if value <= further or further <= start:
        return (1 + float(np.sum(drawn >= value))) / (len(drawn) + 1)
    beyond = 0.001 * math.exp(-math.log(10) * (value - further) / (further - start))
    return max(beyond, LEAST_TAIL)


def _averaged(losses: np.ndarray) -> np.ndarray:
    """Return the means of consecutive losses, of equally many up to one, in MOST_CELLS cells."""
    cells = min(len(losses), MOST_CELLS)
    edges = np.arange(cells + 1) * len(losses) // cells
    return np.asarray(np.add.reduceat(losses, edges[:-1]) / np.diff(edges))


def _statistic(means: np.ndarray, rooted: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the difference and the logarithm of the ratio that follow from two means."""
    power = 0.5 if rooted else 1.0
    return means[0] ** power - means[1] ** power, power * np.log(means[0] / means[1])


def _slopes(means: np.ndarray, rooted: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives of these two by the means."""
    signs = np.array([1.0, -1.0]).reshape(-1, *[1] * (means.ndim - 1))
    power = 0.5 if rooted else 1.0
    return signs * power * means ** (power - 1), signs * power / means


def _block_length(series: np.ndarray) -> tuple[int, float]:
    """
    Return the length of circular blocks, and the share of (M,) values that are independent.

    The length is that of Politis and White (2004, doi:10.1081/ETR-120028836) with the correction
    of Patton, Politis and White (2009, doi:10.1080/07474930802459016). Their search for the lag
    beyond which nothing is correlated ends at the root of M; here at a quarter of M, since the
    errors of odometry may remember that long.
    """
    count = len(series)
    covariances = _autocovariances(series)
    if count < LEAST_BLOCKS or not covariances[0] > 0:
        return max(count, 1), 0.0
    consecutive = max(5, math.ceil(math.sqrt(math.log10(count))))
    most = max(math.ceil(math.sqrt(count)) + consecutive, count // 4)
    limit = 2 * math.sqrt(math.log10(count) / count)
    small = np.abs(covariances[1 : most + consecutive] / covariances[0]) < limit
    quiet = np.convolve(small, np.ones(consecutive), 'valid') == consecutive
    bandwidth = min(max(2 * int(np.argmax(quiet)), 1) if quiet.any() else most, most, count - 1)
    lags = np.arange(1, bandwidth + 1)
    weights = np.minimum(1, 2 * (1 - lags / bandwidth)) if bandwidth > 1 else np.ones(1)
    weighted = weights * covariances[lags]
    long_run = float(covariances[0] + 2 * weighted.sum())
    if not long_run > 0:
        # as of a drift, whose few swings look like one that always returns
        return count, 0.0
    slope = float(2 * (lags * weighted).sum())
    best = (2 * slope**2 / (4 / 3 * long_run**2)) ** (1 / 3) * count ** (1 / 3)
    length = min(max(math.ceil(best), math.ceil(count / MOST_BLOCKS), 1), count)
    return length, min(float(covariances[0]) / long_run, 1.0)


def _autocovariances(series: np.ndarray) -> np.ndarray:
    """Return the (M,) autocovariances of M values, by lag."""
    count = len(series)
    spectrum = np.fft.rfft(series - series.mean(), 1 << (2 * count - 1).bit_length())
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2)[:count] / count)


def _block_means(series: np.ndarray, length: int) -> np.ndarray:
    """Return the means of all M circular blocks of (..., M) values."""
    round_trip = np.concatenate([series, series[..., :length]], axis=-1)
    sums = np.cumsum(round_trip, axis=-1)
    sums = np.concatenate([np.zeros((*series.shape[:-1], 1)), sums], axis=-1)
    return np.asarray((sums[..., length:-1] - sums[..., : -length - 1]) / length)


def _standard_error(influence: np.ndarray, length: int) -> float:
    """
    Return the standard error of the mean of (M,) values with memory.

    From blocks of a length it is too small, by what neighbouring blocks have in common. The
    lugsail correction (Vats and Flegal 2022, doi:10.1093/biomet/asab049) with blocks of a third
    of the length makes up for that, and for a little more.
    """
    count = len(influence)

    def variance(block: int) -> float:
        return float(np.mean(_block_means(influence, block) ** 2)) * block / count

    long = variance(length)
    long = max(long, 2 * long - variance(max(length // 3, 1)))
    blocks = count / length
    return math.sqrt(long * blocks / (blocks - 1))


def _resampled(cells: np.ndarray, length: int) -> tuple[np.ndarray, np.ndarray]:
    """Return (2, R) means of resampled blocks, and the (2, 2, R) covariances of these means."""
    count = cells.shape[1] // length
    means = _block_means(cells, length)
    random = np.random.default_rng(SEED)
    chosen = random.integers(cells.shape[1], size=(RESAMPLES, count))
    blocks = means[:, chosen]
    drawn = blocks.mean(axis=2)
    blocks -= drawn[:, :, None]
    spread = np.einsum('irk,jrk->ijr', blocks, blocks) / (count * (count - 1))
    return drawn, spread
