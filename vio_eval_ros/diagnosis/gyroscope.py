"""A gyroscope against the rotations of an estimate: the lag between them, and the turn."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.interpolation import Interpolator
from vio_eval_ros.core.intervals import longest_tracked
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.clocks import fit_lag, HORIZON_S, Lag, speed_peak
from vio_eval_ros.diagnosis.fitting import horizon, relative_turns, robust_similarity
from vio_eval_ros.errors import NoPairs

FEWEST = 20
GAP_S = 0.1
ITERATIONS = 10
CONVERGED_RAD_S = 1e-4
# rates in degrees are 57 times those of the estimate, more or less by bias and noise
DEGREES = (25.0, 130.0)
FAST = 0.9
# a wrong handedness fits many times worse
CLEARLY = 0.5


@dataclass(frozen=True)
class Comparison:
    """
    What a gyroscope says of an estimate.

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


def compare(estimate: Trajectory, stamps_ns: np.ndarray, rates: np.ndarray) -> Comparison:
    """
    Return how the rotations of an estimate go with the rates of a gyroscope.

    The rates are integrated and compared over quarters of a second. A bias would turn the result
    where the body turns mostly one way: it is taken out, and lag and turn are fitted again.

    :param stamps_ns: (N,) in any order.
    :param rates: (N, 3) rad/s; where they are 57 times too fast, they are taken for deg/s.
    :raises NoPairs: where there is nothing to compare.
    """
    stamps_ns, first = np.unique(stamps_ns[np.isfinite(rates).all(axis=1)], return_index=True)
    rates = rates[np.isfinite(rates).all(axis=1)][first]
    if estimate.rotations is None:
        raise NoPairs('an estimate of positions only has no rotations to compare a gyroscope with')
    if min(len(stamps_ns), len(estimate)) < FEWEST:
        raise NoPairs(
            f'the gyroscope has {len(stamps_ns)} samples, the estimate {len(estimate)} poses; '
            f'{FEWEST} are needed'
        )
    degrees = _in_degrees(estimate, rates)
    rates = np.radians(rates) if degrees else rates
    gap_s = longest_tracked(GAP_S, float(np.median(np.diff(stamps_ns))) / 1e9)
    bias, start_s = np.zeros(3), math.nan
    for _ in range(ITERATIONS):
        turned = _integrated(stamps_ns, rates - bias)
        sensed = Trajectory(stamps_ns, np.zeros((len(stamps_ns), 3)), turned)
        if math.isnan(start_s):
            peak = speed_peak(estimate, sensed, gap_s)
            start_s = peak.lag_s
            if math.isnan(peak.height):
                raise NoPairs('the gyroscope and the estimate do not both turn for long enough')
        lag = fit_lag(estimate, Interpolator(sensed, gap_s), start_s, True)
        if not math.isfinite(lag.misfit):
            raise NoPairs('the gyroscope and the estimate share no instant')
        change = _bias(estimate, Interpolator(sensed, gap_s), lag)
        bias, start_s = bias + change, lag.offset_s
        if np.abs(change).max() < CONVERGED_RAD_S:
            break
    turn = rotation.from_matrix(lag.turn.T)
    angle = float(rotation.angle(turn))
    return Comparison(
        lag.offset_s,
        lag.offset_uncertainty_s,
        tuple(turn.tolist()),
        math.degrees(angle),
        math.degrees(lag.turn_uncertainty),
        tuple(bias.tolist()),
        lag.misfit,
        peak.height,
        degrees,
        _mirrored(estimate, Interpolator(sensed, gap_s), lag),
    )


def _in_degrees(estimate: Trajectory, rates: np.ndarray) -> bool:
    """Return whether rates are so much faster than the estimate turns that they are degrees."""
    assert estimate.rotations is not None
    begin, end = horizon(estimate.stamps_ns, _horizon_s(estimate))
    if not len(begin):
        return False
    seconds = (estimate.stamps_ns[end] - estimate.stamps_ns[begin]) / 1e9
    fast = np.quantile(lengths(relative_turns(estimate.rotations, begin, end)) / seconds, FAST)
    return bool(DEGREES[0] * fast < np.quantile(lengths(rates), FAST) < DEGREES[1] * fast)


def _horizon_s(estimate: Trajectory) -> float:
    return max(HORIZON_S, float(np.median(np.diff(estimate.stamps_ns))) / 1e9)


def _bias(estimate: Trajectory, sensed: Interpolator, lag: Lag) -> np.ndarray:
    """Return the (3,) rad/s by which the sensed rates exceed those of the estimate."""
    moved, turned, seconds = _turns(estimate, sensed, lag)
    return np.asarray(np.median((turned - moved @ lag.turn.T) / seconds[:, None], axis=0))


def _mirrored(estimate: Trajectory, sensed: Interpolator, lag: Lag) -> bool:
    """Return whether the turns fit much better with a reflection, whatever the bias."""
    moved, turned, _ = _turns(estimate, sensed, lag)
    moved, turned = moved - moved.mean(axis=0), turned - turned.mean(axis=0)
    misfits = [robust_similarity(moved, turned, False, parity)[2] for parity in (1, -1)]
    return misfits[1] < CLEARLY * misfits[0]


def _turns(
    estimate: Trajectory, sensed: Interpolator, lag: Lag
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (M, 3) turns of the estimate, those that were sensed, and their (M,) seconds."""
    stamps_ns = estimate.stamps_ns - round(lag.offset_s * 1e9)
    inside = sensed.inside(stamps_ns)
    begin, end = horizon(stamps_ns, _horizon_s(estimate))
    known = inside[begin] & inside[end]
    begin, end = begin[known], end[known]
    turned = sensed.at(stamps_ns).rotations
    assert estimate.rotations is not None
    assert turned is not None
    return (
        relative_turns(estimate.rotations, begin, end),
        relative_turns(turned, begin, end),
        (stamps_ns[end] - stamps_ns[begin]) / 1e9,
    )


def _integrated(stamps_ns: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Return (N, 4) orientations that turn at these rates, the first of them the identity."""
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
