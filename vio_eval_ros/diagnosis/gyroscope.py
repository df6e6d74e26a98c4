"""A gyroscope against the rotations of an estimate: lag, rotation and bias."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.interpolation import Interpolator
from vio_eval_ros.core.intervals import longest_tracked
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.fitting import horizon, relative_rotations, robust_similarity
from vio_eval_ros.diagnosis.lag import fit_lag, Lag, MOTION_S, speed_peak
from vio_eval_ros.errors import NoPairs

FEWEST_RATES = 20
#: rates are not integrated over longer intervals
LONGEST_INTERVAL_S = 0.1
BIAS_STEPS, CONVERGED_RAD_S = 10, 1e-4
#: rates in degrees are 57 times those of the estimate, more or less by bias and noise
DEGREE_RATIOS = (25.0, 130.0)
#: the quantile of rates that is compared
FAST_QUANTILE = 0.9
#: the right handedness has a residual of no more than this share of that of the wrong one
MIRRORED_RESIDUAL_SHARE = 0.5


@dataclass(frozen=True)
class GyroscopeComparison:
    """
    How the rates of a gyroscope agree with the rotations of an estimate.

    :param offset_s: how late the estimate's stamps are against those of the gyroscope.
    :param offset_uncertainty_s: half the width of the 95 % interval.
    :param turn_xyzw: rotation of the gyroscope in the tracked frame.
    :param turn_deg: its angle.
    :param turn_uncertainty_deg: half the width of the 95 % interval, of the worst axis.
    :param bias_rad_s: of the gyroscope, in its own axes.
    :param misfit: what is left of relative rotations, over what there was; near 0 is good.
    :param peak: correlation of the angular speeds at the best lag.
    :param degrees: whether the rates were taken for degrees a second.
    :param mirrored: whether the rates fit only with one axis mirrored, or two swapped.
    """

    offset_s: float
    offset_uncertainty_s: float
    turn_xyzw: tuple[float, ...]
    turn_deg: float
    turn_uncertainty_deg: float
    bias_rad_s: tuple[float, ...]
    misfit: float
    peak: float
    degrees: bool
    mirrored: bool


def compare(estimate: Trajectory, stamps_ns: np.ndarray, rates: np.ndarray) -> GyroscopeComparison:
    """
    Return how the rotations of an estimate agree with the rates of a gyroscope.

    The rates are integrated and compared over quarters of a second. Where the body rotates mostly
    in one direction a bias would rotate the result: it is removed, and lag and rotation are fitted
    again.

    :param stamps_ns: (N,) in any order.
    :param rates: (N, 3) rad/s; where they are 57 times too fast, they are taken for deg/s.
    :raises NoPairs: where there is nothing to compare.
    """
    stamps_ns, first = np.unique(stamps_ns[np.isfinite(rates).all(axis=1)], return_index=True)
    rates = rates[np.isfinite(rates).all(axis=1)][first]
    if estimate.rotations is None:
        raise NoPairs('an estimate of positions only has no rotations to compare a gyroscope with')
    if min(len(stamps_ns), len(estimate)) < FEWEST_RATES:
        raise NoPairs(
            f'the gyroscope has {len(stamps_ns)} samples, the estimate {len(estimate)} poses; '
            f'{FEWEST_RATES} are needed'
        )
    degrees = _in_degrees(estimate, rates)
    rates = np.radians(rates) if degrees else rates
    gap_s = longest_tracked(LONGEST_INTERVAL_S, float(np.median(np.diff(stamps_ns))) / 1e9)
    bias, start_s = np.zeros(3), math.nan
    for _ in range(BIAS_STEPS):
        orientations = _integrated(stamps_ns, rates - bias)
        sensed = Trajectory(stamps_ns, np.zeros((len(stamps_ns), 3)), orientations)
        if math.isnan(start_s):
            peak = speed_peak(estimate, sensed, gap_s)
            start_s = peak.lag_s
            if math.isnan(peak.height):
                raise NoPairs('the gyroscope and the estimate do not both rotate for long enough')
        lag = fit_lag(estimate, Interpolator(sensed, gap_s), start_s, by_rotations=True)
        if not math.isfinite(lag.residual):
            raise NoPairs('the gyroscope and the estimate do not overlap in time')
        change = _bias(estimate, Interpolator(sensed, gap_s), lag)
        bias, start_s = bias + change, lag.offset_s
        if np.abs(change).max() < CONVERGED_RAD_S:
            break
    angle = float(rotation.angle(lag.sensor))
    return GyroscopeComparison(
        offset_s=lag.offset_s,
        offset_uncertainty_s=lag.offset_uncertainty_s,
        turn_xyzw=tuple(lag.sensor.tolist()),
        turn_deg=math.degrees(angle),
        turn_uncertainty_deg=math.degrees(lag.rotation_uncertainty),
        bias_rad_s=tuple(bias.tolist()),
        misfit=lag.residual,
        peak=peak.height,
        degrees=degrees,
        mirrored=_mirrored(estimate, Interpolator(sensed, gap_s), lag),
    )


def _in_degrees(estimate: Trajectory, rates: np.ndarray) -> bool:
    """Return whether rates are as many times those of the estimate as degrees would be."""
    assert estimate.rotations is not None
    begin, end = horizon(estimate.stamps_ns, _motion_s(estimate))
    if not len(begin):
        return False
    seconds = (estimate.stamps_ns[end] - estimate.stamps_ns[begin]) / 1e9
    rotated = lengths(relative_rotations(estimate.rotations, begin, end))
    estimated, sensed = (
        float(np.quantile(speeds, FAST_QUANTILE)) for speeds in (rotated / seconds, lengths(rates))
    )
    least, most = DEGREE_RATIOS
    return least * estimated < sensed < most * estimated


def _motion_s(estimate: Trajectory) -> float:
    """Return over how many seconds rotations are compared."""
    return max(MOTION_S, float(np.median(np.diff(estimate.stamps_ns))) / 1e9)


def _bias(estimate: Trajectory, sensed: Interpolator, lag: Lag) -> np.ndarray:
    """Return the (3,) rad/s by which the sensed rates exceed those of the estimate."""
    estimated, rotated, seconds = _rotations(estimate, sensed, lag)
    return np.asarray(np.median((rotated - estimated @ lag.rotation.T) / seconds[:, None], axis=0))


def _mirrored(estimate: Trajectory, sensed: Interpolator, lag: Lag) -> bool:
    """Return whether the rotations agree much better with a reflection, whatever the bias."""
    estimated, rotated, _ = _rotations(estimate, sensed, lag)
    estimated, rotated = estimated - estimated.mean(axis=0), rotated - rotated.mean(axis=0)
    proper, mirrored = (
        robust_similarity(estimated, rotated, scaled=False, parity=parity).residual
        for parity in (1, -1)
    )
    return mirrored < MIRRORED_RESIDUAL_SHARE * proper


def _rotations(
    estimate: Trajectory, sensed: Interpolator, lag: Lag
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (M, 3) rotations of the estimate, those that were sensed, their (M,) seconds."""
    stamps_ns = estimate.stamps_ns - round(lag.offset_s * 1e9)
    inside = sensed.inside(stamps_ns)
    begin, end = horizon(stamps_ns, _motion_s(estimate))
    known = inside[begin] & inside[end]
    begin, end = begin[known], end[known]
    rotations = sensed.at(stamps_ns).rotations
    assert estimate.rotations is not None
    assert rotations is not None
    return (
        relative_rotations(estimate.rotations, begin, end),
        relative_rotations(rotations, begin, end),
        (stamps_ns[end] - stamps_ns[begin]) / 1e9,
    )


def _integrated(stamps_ns: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return (N, 4) orientations that rotate at these rates, the first of them the identity."""
    seconds = np.diff(stamps_ns)[:, None] / 1e9
    steps = rotation.from_rotation_vector((rates[:-1] + rates[1:]) / 2 * seconds)
    orientations = np.concatenate([[[0.0, 0.0, 0.0, 1.0]], steps])
    # products of prefixes, by doubling: log₂ N passes instead of N products one by one
    reach = 1
    while reach < len(orientations):
        joined = rotation.multiply(orientations[:-reach], orientations[reach:])
        orientations = np.concatenate([orientations[:reach], rotation.normalize(joined)])
        reach *= 2
    return orientations
