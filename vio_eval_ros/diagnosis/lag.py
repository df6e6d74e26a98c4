"""How far the clocks of the two sides are apart, and how one sensor is rotated to the other."""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.interpolation import Interpolator
from vio_eval_ros.core.intervals import longest_tracked, nanoseconds
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.correlation import correlate, Peak
from vio_eval_ros.diagnosis.fitting import (
    FEWEST_MOTIONS,
    horizon,
    least_squares,
    relative_rotations,
    robust_weights,
    rotation_is_observable,
    similarity,
)
from vio_eval_ros.diagnosis.geometry import UP

#: interval between the samples at which speeds are correlated
GRID_S = 0.01
#: window over which each speed is taken
WINDOW_S = 0.1
#: most samples of that grid: a stamp of zero among those of today must not take all memory
MOST_GRID_SAMPLES = 1 << 20
#: half of the interval over which the truth is differentiated; over a shorter one noise would pass
#: for motion
PROBE_S = 0.05
#: interval over which relative motions are compared
MOTION_S = 0.25
#: largest rotation that is compared: rotation vectors are ambiguous near π
LARGEST_ROTATION_RAD = 2.6
#: duration of a run for each degree of the polynomials that scale and heading follow, where only
#: positions determine the lag ...
SECONDS_PER_DEGREE = 15.0
#: ... and their largest degree
LARGEST_DEGREE = 8
#: most steps of Gauss-Newton ...
GAUSS_NEWTON_STEPS = 15
#: ... the largest change of the lag in one of them ...
LARGEST_STEP_S = 0.1
#: ... and the change up to which the lag has converged
LAG_CONVERGED_S = 1e-6
#: smallest uncertainty of a lag, even of a perfect run: the rounding of stamps ...
FLOOR_S = 2e-4
#: ... and interpolation, in intervals of the truth
FLOOR_INTERVALS = 0.02


def speed_peak(estimate: Trajectory, truth: Trajectory, max_gap_s: float) -> Peak:
    """
    Return the lag of the estimate's stamps at which angular speeds correlate best.

    Angular speeds depend on no frame: neither the worlds nor a rotated sensor matter. Where a
    side has positions only, the linear speeds of both sides stand in.
    """
    by_rotations = estimate.rotations is not None and truth.rotations is not None
    sides = (estimate, truth)
    longest_s = max(float(np.ptp(side.stamps_ns)) for side in sides) / 1e9
    step_s = max(GRID_S, longest_s / MOST_GRID_SAMPLES)
    first, second = (_speeds(side, step_s, by_rotations, max_gap_s) for side in sides)
    peak = correlate(first, second, step_s)
    apart_s = int(estimate.stamps_ns[0] - truth.stamps_ns[0]) / 1e9
    return peak.later(apart_s)


def _speeds(side: Trajectory, step_s: float, by_rotations: bool, max_gap_s: float) -> np.ndarray:
    """Return (N,) speeds [rad/s or m/s] at even times from the first pose on; NaN in gaps."""
    interval_s = float(np.median(np.diff(side.stamps_ns))) / 1e9
    poses = Interpolator(side, longest_tracked(max_gap_s, interval_s))
    grid = np.arange(side.stamps_ns[0], side.stamps_ns[-1], nanoseconds(step_s))
    half = max(WINDOW_S, interval_s) / 2
    ends_ns = [grid - nanoseconds(half), grid + nanoseconds(half)]
    known = poses.inside(ends_ns[0]) & poses.inside(ends_ns[1])
    before, after = (poses.at(stamps_ns) for stamps_ns in ends_ns)
    if by_rotations:
        assert before.rotations is not None
        assert after.rotations is not None
        speeds = rotation.angle_between(after.rotations, before.rotations) / (2 * half)
    else:
        speeds = lengths(after.positions - before.positions) / (2 * half)
    speeds[~known] = math.nan
    if known.any():
        # a few wild poses must not dominate the correlation
        speeds = np.minimum(speeds, 1.5 * np.quantile(speeds[known], 0.98))
    return speeds


@dataclass(frozen=True, eq=False)
class Lag:
    """
    How late the stamps of the estimate are, and how its vectors are rotated to the true ones.

    :param offset_s: how late they are in the middle of the run.
    :param drift: how much later they become, seconds a second.
    :param rotation: (3, 3) R of g = R e: of rotation vectors, R_sᵀ with R_s the body in the
        tracked frame; of displacements, the world's.
    :param offset_uncertainty_s: half the width of the 95 % interval of ``offset_s``.
    :param drift_uncertainty: likewise.
    :param rotation_uncertainty: likewise of the worst axis, radians; infinite where all vectors
        are along one axis, about which any rotation fits.
    :param residual: the median length of what is left, over that of the vectors.
    """

    offset_s: float
    drift: float = 0.0
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))
    offset_uncertainty_s: float = math.inf
    drift_uncertainty: float = math.inf
    rotation_uncertainty: float = math.inf
    residual: float = math.inf

    @property
    def sensor(self) -> np.ndarray:
        """The (4,) rotation of the body in the tracked frame, where rotations were fitted."""
        return rotation.from_matrix(self.rotation.T)


def fit_lag(estimate: Trajectory, truth: Interpolator, start_s: float, by_rotations: bool) -> Lag:
    """
    Return the lag that makes short relative motions agree best.

    Gauss-Newton over offset, drift and rotation (and, of displacements, scale and heading, which
    drift) at once, with the truth interpolated at the shifted stamps. Relative rotations over a
    quarter of a second have neither drift nor a world; where a side has no rotations,
    displacements stand in.

    :param start_s: within a few tenths of a second of the offset.
    :param by_rotations: whether to use rotations; else displacements.
    """
    problem = _LagProblem(estimate, truth, by_rotations)
    lag, weights = Lag(start_s), np.ones(len(problem.begin))
    for _ in range(GAUSS_NEWTON_STEPS):
        motions = problem.true_motions(lag)
        if np.count_nonzero(motions.known) < FEWEST_MOTIONS:
            return lag
        lag, weights, change_s = problem.step(lag, motions, weights * motions.known)
        if abs(change_s) < LAG_CONVERGED_S:
            break
    return lag


@dataclass(frozen=True, eq=False)
class _TrueMotions:
    """
    The true relative motions at the stamps of the estimate under a lag.

    :param earlier: (M, 3), a little before.
    :param now: (M, 3).
    :param later: (M, 3), a little after.
    :param known: (M,) whether both ends are inside the truth.
    """

    earlier: np.ndarray
    now: np.ndarray
    later: np.ndarray
    known: np.ndarray


class _LagProblem:
    """The relative motions of an estimate, to be compared with the true ones under a lag."""

    def __init__(self, estimate: Trajectory, truth: Interpolator, by_rotations: bool) -> None:
        self._truth, self._by_rotations = truth, by_rotations
        self._stamps_ns = stamps_ns = estimate.stamps_ns
        self._middle_ns = int(stamps_ns[0] + stamps_ns[-1]) // 2
        interval_s = float(np.median(np.diff(stamps_ns))) / 1e9
        self.begin, self._end = horizon(stamps_ns, max(MOTION_S, interval_s))
        self._estimated = self._motions(estimate)
        elapsed = ((stamps_ns[self.begin] + stamps_ns[self._end]) / 2 - self._middle_ns) / 1e9
        self._half_s = float(np.abs(elapsed).max(initial=1.0))
        #: -1 to 1 over the run
        self._elapsed = elapsed / self._half_s
        # offset [s], drift [s over half the run], rotation [rad]
        self._prior = np.array([1.0, 0.1, 1.0, 1.0, 1.0])
        if not by_rotations:  # and what drifts along the run: scale and heading, polynomials
            degree = int(np.clip(2 * self._half_s / SECONDS_PER_DEGREE, 1, LARGEST_DEGREE))
            self._polynomials = np.polynomial.legendre.legvander(self._elapsed, degree)[:, None]
            self._prior = np.append(self._prior, np.ones(2 * degree + 1))

    def _motions(self, poses: Trajectory) -> np.ndarray:
        """Return (M, 3) relative rotations or displacements."""
        if self._by_rotations:
            assert poses.rotations is not None
            return relative_rotations(poses.rotations, self.begin, self._end)
        return np.asarray(poses.positions[self._end] - poses.positions[self.begin])

    def true_motions(self, lag: Lag) -> _TrueMotions:
        """Return the true motions at the stamps that poses should have had under a lag."""
        late = lag.offset_s + lag.drift * ((self._stamps_ns - self._middle_ns) / 1e9)
        shifted_ns = self._stamps_ns - np.round(late * 1e9).astype(np.int64)
        probe_ns = nanoseconds(PROBE_S)
        earlier, now, later = (
            self._motions(self._truth.at(shifted_ns + step)) for step in (-probe_ns, 0, probe_ns)
        )
        inside = self._truth.inside(shifted_ns)
        known = inside[self.begin] & inside[self._end]
        if self._by_rotations:
            known &= lengths(self._estimated) < LARGEST_ROTATION_RAD
            known &= lengths(now) < LARGEST_ROTATION_RAD
        return _TrueMotions(earlier, now, later, known)

    def step(
        self, lag: Lag, motions: _TrueMotions, weights: np.ndarray
    ) -> tuple[Lag, np.ndarray, float]:
        """Return the next lag, the (M,) weights after it, and by how much the offset changed."""
        known, now = motions.known, motions.now
        matrix, scale = similarity(self._estimated, now, weights, scaled=not self._by_rotations)
        expected = scale * self._estimated @ matrix.T
        fit = least_squares(
            self._design(motions, expected)[known],
            expected[known] - now[known],
            self._prior,
            weights[known],
        )
        observable = rotation_is_observable(expected[known], now[known], weights[known])
        residuals = now[known] - expected[known]
        change_s = float(np.clip(fit.values[0], -LARGEST_STEP_S, LARGEST_STEP_S))
        lag = Lag(
            offset_s=lag.offset_s + change_s,
            drift=lag.drift + float(fit.values[1]) / self._half_s,
            rotation=matrix,
            offset_uncertainty_s=math.hypot(
                fit.uncertainty(0), FLOOR_S, FLOOR_INTERVALS * self._truth.interval_s
            ),
            drift_uncertainty=fit.uncertainty(1) / self._half_s,
            rotation_uncertainty=(
                max(fit.uncertainty(k) for k in (2, 3, 4)) if observable else math.inf
            ),
            residual=float(np.median(lengths(residuals)))
            / (float(np.median(lengths(now[known]))) + 1e-12),
        )
        weights = np.zeros(len(known))
        weights[known] = robust_weights(residuals)
        return lag, weights, change_s

    def _design(self, motions: _TrueMotions, expected: np.ndarray) -> np.ndarray:
        """Return the (M, 3, P) derivatives of what is left, by every parameter."""
        # the truth at a stamp less the lag moves against it
        slope = (motions.earlier - motions.later) / (2 * PROBE_S)
        columns = [slope, slope * self._elapsed[:, None]]
        columns += [np.cross(expected, axis) for axis in np.eye(3)]
        if not self._by_rotations:
            columns += list(np.moveaxis(-expected[..., None] * self._polynomials, -1, 0))
            heading = np.cross(expected, UP)[..., None] * self._polynomials[..., 1:]
            columns += list(np.moveaxis(heading, -1, 0))
        return np.stack(columns, -1)
