"""How far the clocks of the two sides are apart, and how one sensor is turned to the other."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.interpolation import Interpolator
from vio_eval_ros.core.intervals import longest_tracked, nanoseconds
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.correlation import correlate, Peak
from vio_eval_ros.diagnosis.fitting import (
    horizon,
    least_squares,
    relative_turns,
    robust_weights,
    similarity,
    turn_is_told,
)
from vio_eval_ros.diagnosis.geometry import UP

GRID_S = 0.01
WINDOW_S = 0.1
# a stamp of zero among those of today must not take all memory
MOST_SAMPLES = 1 << 21
# Over a few samples of the truth a difference is all noise, which would pass for motion.
PROBE_S = 0.05
ITERATIONS = 15
# where only positions tell the lag, scale and heading may follow polynomials: their degree rises
# by one in so many seconds
WALK_S, MOST_WALK = 15.0, 8
HORIZON_S = 0.25
LARGEST_TURN = 2.6
MIN_MOTIONS = 10
CONVERGED_S = 1e-6
# what interpolation and the rounding of stamps leave, even of a perfect run
FLOOR_S, FLOOR_INTERVALS = 2e-4, 0.02


def speed_peak(estimate: Trajectory, truth: Trajectory, max_gap_s: float) -> Peak:
    """
    Return the lag of the estimate's stamps at which both turn alike.

    Angular speeds know of no frame: neither the worlds nor a turned sensor matter to them. Where
    a side has positions only, both sides' linear speeds stand in.
    """
    turning = estimate.rotations is not None and truth.rotations is not None
    sides = (estimate, truth)
    longest_s = max(float(np.ptp(side.stamps_ns)) for side in sides) / 1e9
    step_s = max(GRID_S, longest_s / MOST_SAMPLES)
    first, second = (_speeds(side, step_s, turning, max_gap_s) for side in sides)
    peak = correlate(first, second, step_s)
    apart_s = int(estimate.stamps_ns[0] - truth.stamps_ns[0]) / 1e9
    return Peak(peak.lag_s + apart_s, peak.height, peak.rival)


def _speeds(side: Trajectory, step_s: float, turning: bool, max_gap_s: float) -> np.ndarray:
    """Return (N,) speeds [rad/s or m/s] at even times from the first pose on; NaN in gaps."""
    interval_s = float(np.median(np.diff(side.stamps_ns))) / 1e9
    poses = Interpolator(side, longest_tracked(max_gap_s, interval_s))
    grid = np.arange(side.stamps_ns[0], side.stamps_ns[-1], nanoseconds(step_s))
    half = max(WINDOW_S, interval_s) / 2
    ends_ns = [grid - nanoseconds(half), grid + nanoseconds(half)]
    known = poses.inside(ends_ns[0]) & poses.inside(ends_ns[1])
    before, after = (poses.at(stamps_ns) for stamps_ns in ends_ns)
    if turning:
        assert before.rotations is not None
        assert after.rotations is not None
        speeds = rotation.angle_between(after.rotations, before.rotations) / (2 * half)
    else:
        speeds = lengths(after.positions - before.positions) / (2 * half)
    speeds[~known] = math.nan
    if known.any():
        # a few wild poses must not be all that the correlation sees
        speeds = np.minimum(speeds, 1.5 * np.quantile(speeds[known], 0.98))
    return speeds


@dataclass(frozen=True, eq=False)
class Lag:
    """
    How late the stamps of the estimate are, and how its vectors are turned to the true ones.

    :param offset_s: how late they are in the middle of the run.
    :param drift: how much later they become, seconds a second.
    :param turn: (3, 3) R of g = R e: of rotation vectors, R_sᵀ with R_s the body in the tracked
        frame; of displacements, the world's.
    :param offset_uncertainty_s: half the width of the 95 % interval of ``offset_s``.
    :param drift_uncertainty: likewise.
    :param turn_uncertainty: likewise of the worst axis, radians; infinite where all vectors are
        along one axis, about which any turn fits.
    :param misfit: the median length of what is left, over that of the vectors.
    """

    offset_s: float
    drift: float
    turn: np.ndarray
    offset_uncertainty_s: float
    drift_uncertainty: float
    turn_uncertainty: float
    misfit: float


def true_stamps(
    stamps_ns: np.ndarray, middle_ns: int, offset_s: float, drift: float
) -> np.ndarray:
    """Return the stamps that poses should have had which are late, and become later."""
    late = offset_s + drift * ((stamps_ns - middle_ns) / 1e9)
    return np.asarray(stamps_ns - np.round(late * 1e9).astype(np.int64))


def fit_lag(estimate: Trajectory, truth: Interpolator, start_s: float, turning: bool) -> Lag:
    """
    Return the lag that makes short relative motions agree best.

    Gauss-Newton over offset, drift and turn (and, of displacements, scale and heading, which
    walk) at once, with the truth interpolated at the shifted stamps. Relative rotations over a
    quarter of a second have neither drift nor a world; where a side has no rotations,
    displacements stand in.

    :param start_s: within a few tenths of a second of the offset.
    :param turning: whether by rotations.
    """
    stamps_ns = estimate.stamps_ns
    middle_ns = int(stamps_ns[0] + stamps_ns[-1]) // 2
    interval_s = float(np.median(np.diff(stamps_ns))) / 1e9
    begin, end = horizon(stamps_ns, max(HORIZON_S, interval_s))

    def motion(poses: Trajectory) -> np.ndarray:
        if turning:
            assert poses.rotations is not None
            return relative_turns(poses.rotations, begin, end)
        return np.asarray(poses.positions[end] - poses.positions[begin])

    moved = motion(estimate)
    elapsed = ((stamps_ns[begin] + stamps_ns[end]) / 2 - middle_ns) / 1e9
    lag = Lag(start_s, 0.0, np.eye(3), math.inf, math.inf, math.inf, math.inf)
    weights = np.ones(len(moved))
    reach = float(np.abs(elapsed).max(initial=1.0))
    # offset [s], drift [s a run], turn [rad]
    prior = np.array([1.0, 0.1, 1.0, 1.0, 1.0])
    if not turning:  # and what walks along the run: scale and heading, each a polynomial
        degree = int(np.clip(2 * reach / WALK_S, 1, MOST_WALK))
        along = np.polynomial.legendre.legvander(elapsed / reach, degree)[:, None]
        prior = np.append(prior, np.ones(2 * degree + 1))
    for _ in range(ITERATIONS):
        shifted = true_stamps(stamps_ns, middle_ns, lag.offset_s, lag.drift)
        probe_ns = nanoseconds(PROBE_S)
        earlier, now, later = (
            motion(truth.at(shifted + step)) for step in (-probe_ns, 0, probe_ns)
        )
        inside = truth.inside(shifted)
        known = inside[begin] & inside[end]
        if turning:
            known &= (lengths(moved) < LARGEST_TURN) & (lengths(now) < LARGEST_TURN)
        if np.count_nonzero(known) < MIN_MOTIONS:
            return lag
        weights = weights * known
        turn, scale = similarity(moved, now, weights, not turning)
        expected = scale * moved @ turn.T
        # the truth at a stamp less the lag moves against it
        slope = (earlier - later) / (2 * PROBE_S)
        columns = [slope, slope * (elapsed / reach)[:, None]]
        columns += [np.cross(expected, axis) for axis in np.eye(3)]
        if not turning:
            columns += list(np.moveaxis(-expected[..., None] * along, -1, 0))
            heading = np.cross(expected, UP)
            columns += list(np.moveaxis(heading[..., None] * along[..., 1:], -1, 0))
        fit = least_squares(
            np.stack(columns, -1)[known], expected[known] - now[known], prior, weights[known]
        )
        step = float(np.clip(fit.values[0], -0.1, 0.1))
        told = turn_is_told(expected[known], now[known], weights[known])
        lag = Lag(
            lag.offset_s + step,
            lag.drift + float(fit.values[1]) / reach,
            turn,
            math.hypot(fit.uncertainty(0), FLOOR_S, FLOOR_INTERVALS * truth.interval_s),
            fit.uncertainty(1) / reach,
            max(fit.uncertainty(k) for k in (2, 3, 4)) if told else math.inf,
            float(np.median(lengths(now[known] - expected[known])))
            / (float(np.median(lengths(now[known]))) + 1e-12),
        )
        weights = np.zeros(len(moved))
        weights[known] = robust_weights(now[known] - expected[known])
        if abs(step) < CONVERGED_S:
            break
    return lag
