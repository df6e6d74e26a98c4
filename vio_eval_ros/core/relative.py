"""
Relative errors: how far the motion from one pair to another is off.

From pair i to pair j the error of the rotation is the angle between A_i and A_j, where
A = R_g R_eᵀ is the rotation of a pair (``Pairs.rotations``).
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Alignment
from vio_eval_ros.core.config import Delta, EvaluationConfig
from vio_eval_ros.core.matching import nearest
from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.steps import distances
from vio_eval_ros.core.trajectory import as_slice, blocks, Pairs, rows

#: kinds of relative error and their units: of the pose, of the rotation, of the displacement in
#: the world, and of the distance between its ends
RPE_KINDS = {'trans': 'm', 'rot': 'deg', 'disp': 'm', 'dist': 'm'}
#: those that need no orientations
POSITION_KINDS = ('disp', 'dist')
#: pairs from the begin of one segment to that of the next
SEGMENT_STEP = 10


@dataclass(frozen=True, eq=False)
class RelativeMotions:
    """
    Relative motions of both sides, from pairs i to pairs j, M of them.

    :param estimate: (M, 3) displacements e_j - e_i, in the estimate's world.
    :param truth: (M, 3) displacements g_j - g_i, in the ground truth's world.
    :param rotated: (M, 3) displacements A_i (e_j - e_i): those of an estimate that had the true
        orientation at i; NaN without orientations.
    :param angles: (M,) radians between the relative rotations; NaN without orientations.
    """

    estimate: np.ndarray
    truth: np.ndarray
    rotated: np.ndarray
    angles: np.ndarray

    @classmethod
    def between(cls, pairs: Pairs, begin: np.ndarray, end: np.ndarray) -> RelativeMotions:
        """Return the relative motions between pairs with these (M,) indices."""
        i, j = as_slice(begin), as_slice(end)
        estimate, truth = pairs.estimate.positions, pairs.ground_truth.positions
        moved = rows(estimate, j) - rows(estimate, i)
        if pairs.rotations is None:
            rotated, angles = np.full_like(moved, math.nan), np.full(len(moved), math.nan)
        else:
            at_begin = rows(pairs.rotations, i)
            rotated = rotation.rotate(at_begin, moved)
            angles = rotation.angle_between(rows(pairs.rotations, j), at_begin)
        return cls(moved, rows(truth, j) - rows(truth, i), rotated, angles)

    def pose_errors(self, scale: float) -> np.ndarray:
        """Return the (M,) metres |E_t| of E = (G_i⁻¹ G_j)⁻¹ (P_i⁻¹ P_j)."""
        return lengths(scale * self.rotated - self.truth)

    def errors(self, alignment: Alignment) -> np.ndarray:
        """Return the (4, M) relative errors in the order of RPE_KINDS, in metres and degrees."""
        scale = alignment.scale
        aligned = (scale * self.estimate) @ alignment.matrix.T
        return np.stack(
            [
                self.pose_errors(scale),
                np.degrees(self.angles),
                lengths(aligned - self.truth),
                np.abs(scale * lengths(self.estimate) - lengths(self.truth)),
            ]
        )


def relative_errors(
    pairs: Pairs, begin: np.ndarray, end: np.ndarray, alignment: Alignment
) -> np.ndarray:
    """Return the (4, M) relative errors, in the order of RPE_KINDS, between these (M,) pairs."""
    errors = np.empty((len(RPE_KINDS), len(begin)))
    for part in blocks(len(begin)):
        errors[:, part] = RelativeMotions.between(pairs, begin[part], end[part]).errors(alignment)
    return errors


@dataclass(frozen=True, eq=False)
class ErrorMoments:
    """
    Second moments of relative motions, from which their RMSE follows under any alignment.

    During a run the alignment still changes. For errors |s R x - y|, the moments are therefore of
    (Q x, y - Q x) with Q near s R, so that small errors are not differences of large sums.

    :param products: for each kind the (2k, 2k) sum of outer products, k = 3 or 1.
    :param angles: sum of squared angles [rad²].
    :param reference: has Q.
    """

    count: int
    products: dict[str, np.ndarray]
    angles: float
    reference: Alignment

    @classmethod
    def of(cls, motions: RelativeMotions, reference: Alignment) -> ErrorMoments:
        """Return the moments of M motions about a reference."""
        far, far_truth = lengths(motions.estimate)[:, None], lengths(motions.truth)[:, None]
        compared = {
            'trans': (reference.scale * motions.rotated, motions.truth),
            'disp': (motions.estimate @ reference.linear.T, motions.truth),
            'dist': (reference.scale * far, far_truth),
        }
        products = {}
        for kind, (estimated, true) in compared.items():
            samples = np.hstack([estimated, true - estimated])
            products[kind] = samples.T @ samples
        angles = float(motions.angles @ motions.angles)
        return cls(len(motions.angles), products, angles, reference)

    def __add__(self, other: ErrorMoments) -> ErrorMoments:
        """Return the moments of both; they must share their reference."""
        products = {kind: self.products[kind] + other.products[kind] for kind in self.products}
        angles = self.angles + other.angles
        return ErrorMoments(self.count + other.count, products, angles, self.reference)

    def rmse(self, kind: str, alignment: Alignment) -> float:
        """Return the root of the mean squared error of a kind, in its unit."""
        if not self.count:
            return math.nan
        if kind == 'rot':
            return math.degrees(math.sqrt(self.angles / self.count))
        unit = np.eye(len(self.products[kind]) // 2)
        rotated = alignment.matrix @ self.reference.matrix.T if kind == 'disp' else unit
        similarity = np.hstack([alignment.scale / self.reference.scale * rotated - unit, -unit])
        square = float(np.sum((similarity @ self.products[kind]) * similarity))
        return math.sqrt(max(square, 0.0) / self.count)


def progress_along(pairs: Pairs, unit: str) -> np.ndarray:
    """
    Return (N,) how far each pair is from the first, in the unit of a delta.

    Frames are counted over pairs; nanoseconds pass between stamps of the estimate; metres and
    degrees accumulate along the ground truth. NaN for degrees without orientations.
    """
    if unit == 'f':
        return np.arange(len(pairs))
    if unit == 's':
        return pairs.estimate.stamps_ns - pairs.estimate.stamps_ns[:1]
    if unit == 'm':
        return distances(pairs.ground_truth.positions)
    else:
        rotations = pairs.ground_truth.rotations
        if rotations is None:
            return np.full(len(pairs), math.nan)
        steps = np.degrees(rotation.angle_between(rotations[1:], rotations[:-1]))
    return np.concatenate([np.zeros(min(len(pairs), 1)), np.cumsum(steps)])


@dataclass(frozen=True, eq=False)
class Candidates:
    """
    Which pairs may be a delta apart, in order.

    :param begin: (M,) indices.
    :param end: (M,) indices of the pairs nearest to a delta further.
    :param target: (M,) where ``end`` should be, along :func:`progress_along`.
    :param usable: (M,) whether it is near enough.
    """

    begin: np.ndarray
    end: np.ndarray
    target: np.ndarray
    usable: np.ndarray


def candidates(
    along: np.ndarray, delta: Delta, config: EvaluationConfig, origin: float = 0.0
) -> Candidates:
    """
    Return from which pair to which a delta leads.

    :param along: (N,) non-decreasing, from :func:`progress_along`.
    :param config: with ``rpe_pairs`` all, one begins at every pair; sequential ones go from mark
        to mark, every delta from ``origin`` on, and take the pair nearest to each mark.
    """
    unit = 1e9 if delta.unit == 's' else 1
    step = round(unit * delta.value) if delta.unit in 'fs' else delta.value
    if not len(along) or math.isnan(along[-1]):
        nothing = np.empty(0, np.int64)
        return Candidates(nothing, nothing, nothing, nothing.astype(bool))
    target: np.ndarray
    if config.rpe_pairs == 'all':
        begin, target = np.arange(len(along)), along + step
        frames = delta.unit == 'f'
        end = target.clip(max=len(along) - 1) if frames else _first_nearest(target, along)
    else:
        reached = (along - origin) / step
        marks = np.unique(np.concatenate([np.floor(reached), np.ceil(reached)]))
        places = marks * step + origin
        poses = _first_nearest(places, along)
        begin, end, target = poses[:-1], poses[1:], places[1:]
    # far above what rounding of coordinates can do to a path that is off by just the tolerance
    tolerance = unit * delta.tolerance(config.rpe_tolerance) * (1 + 1e-6)
    off = np.abs(along[end] - along[begin] - step)
    return Candidates(begin, end, target, (end > begin) & (off <= tolerance))


def _first_nearest(places: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Return the first of the indices nearest to each place; ``along`` may stand still."""
    index = nearest(places, along)
    return index if (np.diff(along) > 0).all() else np.searchsorted(along, along[index])


def segment_errors(pairs: Pairs, scale: float, path: np.ndarray, length_m: float) -> np.ndarray:
    """
    Return the (2, M) relative errors per metre over segments of a length, in metres and degrees.

    A segment begins at every tenth pair, and ends with the first that is further than its length.

    :param path: (N,) metres from the first pair, as :func:`progress_along` gives them.
    """
    begin = np.arange(0, len(path), SEGMENT_STEP)
    end = np.searchsorted(path, path[begin] + length_m, side='right')
    inside = end < len(path)
    begin, end = begin[inside], end[inside]
    errors = np.empty((2, len(begin)))
    for part in blocks(len(begin)):
        motions = RelativeMotions.between(pairs, begin[part], end[part])
        errors[0, part] = motions.pose_errors(scale)
        errors[1, part] = np.degrees(motions.angles)
    return errors / length_m
