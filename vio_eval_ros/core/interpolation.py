"""Poses between those of a trajectory: positions on a line, rotations on the shorter arc."""

from __future__ import annotations

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.intervals import nanoseconds
from vio_eval_ros.core.trajectory import Poses, Trajectory

#: samples further apart are first made denser by cubic curves
DENSE_S = 0.011
#: most samples that they are made: where so many are not enough, as of stamps in a wrong unit,
#: they stay sparser
MOST_SAMPLES = 1 << 20


def between(begin: Poses, end: Poses, stamps_ns: np.ndarray, weighted: bool = False) -> Trajectory:
    """
    Return the poses at stamps, row by row between two others.

    :param begin: N poses at or before the stamps.
    :param end: N poses at or after them.
    :param stamps_ns: (N,) int64 nanoseconds.
    :param weighted: compute positions as a weighted mean, which is exact at both ends, instead of
        as a share of the step, which is not at the far one; the two differ by rounding only.
        Covariances are weighted means as well.
    """
    weight = (stamps_ns - begin.stamps_ns) / np.maximum(end.stamps_ns - begin.stamps_ns, 1)
    share = weight[:, None]
    if weighted:
        positions = begin.positions * (1 - share) + end.positions * share
    else:
        positions = begin.positions + share * (end.positions - begin.positions)
    rotations = None
    if begin.rotations is not None and end.rotations is not None:
        rotations = rotation.slerp(begin.rotations, end.rotations, weight)
    covariances = None
    if begin.covariances is not None and end.covariances is not None:
        share = weight[:, None, None, None]
        covariances = begin.covariances * (1 - share) + end.covariances * share
    weights = None
    if begin.weights is not None and end.weights is not None:
        weights = _weights(begin.weights, end.weights, weight)
    return Trajectory(stamps_ns, positions, rotations, covariances, weights=weights)


def _weights(begin: np.ndarray, end: np.ndarray, share: np.ndarray) -> np.ndarray:
    """
    Return weights between others, which are inverse variances: those of the mean variance.

    Where one of two is 0, so is what lies between.
    """
    with np.errstate(divide='ignore', invalid='ignore'):
        inverse = np.where(share < 1, (1 - share) / begin, 0.0)
        return np.asarray(1 / (inverse + np.where(share > 0, share / end, 0.0)))


def interpolated(poses: Poses, stamps_ns: np.ndarray) -> Trajectory:
    """
    Return the poses at stamps; at stamps outside, those of the ends.

    :param poses: at least two, in order of their stamps.
    """
    known = poses.stamps_ns
    stamps_ns = np.asarray(stamps_ns).clip(known[0], known[-1])
    before = (np.searchsorted(known, stamps_ns, side='right') - 1).clip(0, len(known) - 2)
    return between(poses[before], poses[before + 1], stamps_ns)


class Interpolator:
    """
    Poses between those of a trajectory, which is first upsampled where it is sparse.

    Between samples 5 ms apart a straight line is as good as any curve. Between samples 50 or
    100 ms apart it cuts the corners of a flight by more than a time offset of milliseconds
    shifts it. Such a trajectory is upsampled with cubic Hermite curves, through its positions and
    through its rotations as rotation vectors relative to the sample before.

    :param trajectory: at least two poses.
    :param max_gap_s: over longer intervals nothing is interpolated.
    """

    def __init__(self, trajectory: Trajectory, max_gap_s: float) -> None:
        intervals = np.diff(trajectory.stamps_ns)
        self._gap_ns = nanoseconds(max_gap_s)
        #: between the samples there were
        self.interval_s = float(np.median(intervals)) / 1e9
        most = MOST_SAMPLES // len(trajectory)
        self._pieces = pieces = max(int(min(np.ceil(self.interval_s / DENSE_S), most)), 1)
        self._poses = trajectory if pieces < 2 else _refined(trajectory, pieces)
        #: whether the interval after each sample is too long to be interpolated over
        self._broken = np.repeat(intervals > self._gap_ns, pieces)

    def inside(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Return whether each stamp lies between two samples that are near enough."""
        known = self._poses.stamps_ns
        before = np.searchsorted(known, stamps_ns, side='right') - 1
        within = (before >= 0) & (stamps_ns <= known[-1])
        before = before.clip(0, len(known) - 2)
        sampled = (known[before] == stamps_ns) & (before % self._pieces == 0)
        sampled |= stamps_ns == known[-1]
        return np.asarray(within & (sampled | ~self._broken[before]))

    def at(self, stamps_ns: np.ndarray) -> Trajectory:
        """Return the poses at these stamps; outside the trajectory, those of its ends."""
        return interpolated(self._poses, stamps_ns)


def _refined(poses: Trajectory, pieces: int) -> Trajectory:
    """Return the trajectory with every interval cut into as many pieces."""
    seconds = (poses.stamps_ns - poses.stamps_ns[0]) / 1e9
    length = np.diff(seconds)[:, None]
    weight = (np.arange(pieces) / pieces)[None, :, None]
    stamps_ns = poses.stamps_ns[:-1, None] + np.round(
        weight[..., 0] * np.diff(poses.stamps_ns)[:, None]
    ).astype(np.int64)
    steps = np.diff(poses.positions, axis=0)
    slopes = _slopes(steps / length, length)
    offsets = _hermite(steps, slopes[:-1] * length, slopes[1:] * length, weight)
    positions = (poses.positions[:-1, None] + offsets).reshape(-1, 3)
    rotations = None
    if poses.rotations is not None:
        q = poses.rotations
        # a body rate is the same vector at both ends of a small rotation
        vectors = rotation.to_rotation_vector(rotation.multiply(rotation.conjugate(q[:-1]), q[1:]))
        rates = _slopes(vectors / length, length)
        curves = _hermite(vectors, rates[:-1] * length, rates[1:] * length, weight)
        fine = rotation.multiply(q[:-1, None], rotation.from_rotation_vector(curves))
        rotations = np.concatenate([fine.reshape(-1, 4), q[-1:]])
    weights = poses.weights
    if weights is not None:
        fine = _weights(weights[:-1, None], weights[1:, None], weight[..., 0])
        weights = np.append(fine.ravel(), weights[-1])
    return Trajectory(
        np.append(stamps_ns.ravel(), poses.stamps_ns[-1]),
        np.concatenate([positions, poses.positions[-1:]]),
        rotations,
        weights=weights,
    )


def _slopes(rates: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Return the (N, 3) slopes at N samples of a parabola through each and its neighbours."""
    inner = (rates[:-1] * length[1:] + rates[1:] * length[:-1]) / (length[:-1] + length[1:])
    return np.concatenate([rates[:1], inner, rates[-1:]])


def _hermite(
    step: np.ndarray, begin: np.ndarray, end: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """Return (N, W, 3) points of N cubics from 0 to (N, 3) ``step`` with these end slopes."""
    step, begin, end = step[:, None], begin[:, None], end[:, None]
    square, cube = weight**2, weight**3
    return np.asarray(
        (3 * square - 2 * cube) * step
        + (cube - 2 * square + weight) * begin
        + (cube - square) * end
    )
