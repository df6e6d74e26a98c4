"""Robust fits, and how uncertain they are."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.matching import nearest
from vio_eval_ros.core.rotation import lengths

#: iterations of iteratively reweighted least squares
REWEIGHTINGS = 12
#: blocks of the run whose scatter gives the uncertainty of a fit ...
BLOCKS = 6
#: ... the degrees of freedom of Student's distribution that it follows ...
FREEDOM = BLOCKS - 1
#: ... and half of the 95 % interval of that distribution, in standard errors
T_95 = 2.571
#: keeps a spread of zero from dividing
TINY = 1e-12
#: weight of a block that is left out, less than one: a direction that it alone constrains keeps a
#: little weight
LEFT_OUT_WEIGHT = 1 - 1e-9
#: variance of a residual before any is known: small enough for the prior not to matter
FIRST_VARIANCE = 1e-8
#: largest deviation of two samples from the interval asked for, as a share of it
HORIZON_TOLERANCE = 0.25
#: fewest relative motions that anything can be fitted to
FEWEST_MOTIONS = 10


def student(t: float) -> float:
    """
    Return the cumulative distribution of Student's t with five degrees of freedom.

    Abramowitz and Stegun, Handbook of Mathematical Functions, 26.7.3.
    """
    angle = math.atan(t / math.sqrt(FREEDOM))
    sine, cosine = math.sin(angle), math.cos(angle)
    return 0.5 + (angle + sine * cosine * (1 + 2 * cosine**2 / 3)) / math.pi


def horizon(stamps_ns: np.ndarray, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (M,), (M,) indices of samples that are ``seconds`` apart, to a quarter of it."""
    target = stamps_ns + round(seconds * 1e9)
    end = nearest(target, stamps_ns)
    begin = np.arange(len(stamps_ns))
    near = np.abs(stamps_ns[end] - target) < HORIZON_TOLERANCE * 1e9 * seconds
    usable = near & (end > begin)
    return begin[usable], end[usable]


def robust_weights(residuals: np.ndarray) -> np.ndarray:
    """Return (M,) weights of residual vectors (M, D), by Geman and McClure about their median."""
    size = lengths(residuals)
    spread = float(np.median(size)) / 1.5 + TINY if len(size) else 1.0
    return np.asarray(1 / (1 + (size / (2 * spread)) ** 2) ** 2)


class Similarity(NamedTuple):
    """
    A rotation and a scale that take vectors to others.

    :param rotation: (3, 3), with a reflection where it was asked for.
    :param scale: 1 where none was asked for.
    :param residual: median length of what is left over that of the target; NaN without vectors.
    """

    rotation: np.ndarray
    scale: float
    residual: float


def similarity(
    source: np.ndarray, target: np.ndarray, weights: np.ndarray, scaled: bool, parity: int = 1
) -> tuple[np.ndarray, float]:
    """
    Return the (3, 3) R and the s that minimise Σ w |s R source - target|².

    :param parity: 1 for a rotation, -1 for a rotation with a reflection.
    """
    u, d, vt = np.linalg.svd((target * weights[:, None]).T @ source)
    signs = np.array([1.0, 1.0, parity * np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    spread = float(np.sum(weights[:, None] * source**2))
    scale = float(d @ signs) / spread if scaled and spread > 0 else 1.0
    return (u * signs) @ vt, scale


def rotation_is_observable(rotated: np.ndarray, target: np.ndarray, weights: np.ndarray) -> bool:
    """
    Return whether vectors determine all of the rotation that was fitted to them.

    How well they constrain it about each axis is the Hessian of Wahba's problem, tr(C) I - C with
    their cross-covariance C, to which the noise of one side alone does not contribute. Vectors
    along a single axis constrain the rotation about it no better than their noise does.

    :param rotated: (M, 3) with the rotation applied, to be equal to the (M, 3) ``target``.
    """
    cross = (target * weights[:, None]).T @ rotated
    spread = np.linalg.eigvalsh((cross + cross.T) / 2)
    noise = float(np.sum(weights[:, None] * (rotated - target) ** 2)) / 3
    return bool(spread[0] + spread[1] > noise)


def robust_similarity(
    source: np.ndarray, target: np.ndarray, scaled: bool, parity: int = 1
) -> Similarity:
    """Return the similarity that takes most of (M, 3) vectors to the (M, 3) target."""
    weights = np.ones(len(source))
    if scaled:  # long vectors would dominate at first, and lengths are known without a rotation
        ratios = np.log((lengths(source) + TINY) / (lengths(target) + TINY))
        weights = robust_weights((ratios - np.median(ratios))[:, None])
    for _ in range(REWEIGHTINGS):
        matrix, scale = similarity(source, target, weights, scaled, parity)
        residuals = scale * source @ matrix.T - target
        weights = robust_weights(residuals)
    if not len(target):
        return Similarity(matrix, scale, math.nan)
    usual = float(np.median(lengths(target)))
    return Similarity(matrix, scale, float(np.median(lengths(residuals))) / (usual + TINY))


@dataclass(frozen=True, eq=False)
class Solution:
    """
    The solution of a robust linear least-squares problem.

    :param values: (P,) parameters.
    :param covariance: (P, P) of them.
    :param weights: (M,) of the last iteration.
    :param residuals: (M, D) of the last iteration.
    """

    values: np.ndarray
    covariance: np.ndarray
    weights: np.ndarray
    residuals: np.ndarray

    def uncertainty(self, index: int) -> float:
        """Return half the width of the 95 % interval of a parameter."""
        return T_95 * float(np.sqrt(self.covariance[index, index]))


def least_squares(
    design: np.ndarray, target: np.ndarray, prior: np.ndarray, weights: np.ndarray | None = None
) -> Solution:
    """
    Return the robust solution x of design x = target.

    Errors of neighbouring rows are correlated, so the covariance is that of how much the solution
    changes without each of the consecutive blocks of rows (the jackknife, clustered), and that of
    white noise, since few blocks may agree by chance. A direction that no row constrains keeps the
    uncertainty of the prior.

    :param design: (M, D, P).
    :param target: (M, D).
    :param prior: (P,) standard deviations beyond which no value is expected, about zero.
    :param weights: (M,) fixed weights; else they follow from the residuals.
    """
    iterate = weights is None
    weights = np.ones(len(target)) if weights is None else weights
    noise = FIRST_VARIANCE
    for _ in range(REWEIGHTINGS if iterate else 1):
        weighted = design * weights[:, None, None]
        normal = np.einsum('mdp,mdq->pq', weighted, design)
        information = normal + noise * np.diag(prior**-2)
        values = np.linalg.solve(information, np.einsum('mdp,md->p', weighted, target))
        residuals = design @ values - target
        if iterate:
            weights = robust_weights(residuals)
        noise = _noise(residuals, weights)
    # How much the solution changes without each of the blocks, and more since weights would have
    # followed the residuals: the slope of w r is w (1 - 4u²/D(1 + u²)) in the mean, less than w
    slopes = weights * (1 - 4 * (1 - np.sqrt(weights)) / target.shape[1])
    growth = float(weights.sum()) / max(float(slopes.sum()), TINY)
    changes = []
    for rows in np.array_split(np.arange(len(target)), BLOCKS):
        block = np.einsum('mdp,mdq->pq', weighted[rows], design[rows])
        gradient = np.einsum('mdp,md->p', weighted[rows], residuals[rows])
        changes.append(np.linalg.solve(information - LEFT_OUT_WEIGHT * block, gradient))
    deviations = np.array(changes) - np.mean(changes, axis=0)
    spread = growth**2 * (BLOCKS - 1) / BLOCKS * deviations.T @ deviations
    return Solution(values, spread + noise * np.linalg.inv(information), weights, residuals)


def fit_slope(along: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """
    Return the slope of a random walk, and half the width of its 95 % interval.

    The error of an odometry is one: it is correlated over all of a run, but its changes from pose
    to pose are not. With x about its mean the slope of values over x is off by Σ cₖ·Δeₖ, where cₖ
    is the sum of x / Σ|x|² from k on. Its uncertainty is estimated from the scatter of parts of
    this sum that carry as much information about the slope each.

    :param along: (N, D) x.
    :param values: (N, D).
    """
    along, values = along - along.mean(axis=0), values - values.mean(axis=0)
    total = float(np.sum(along**2))
    if not total > 0:
        return math.nan, math.inf
    slope = float(np.sum(along * values)) / total
    after = np.cumsum(along[:0:-1], axis=0)[::-1] / total
    influences = np.sum(after * np.diff(values - slope * along, axis=0), axis=1)
    information = np.cumsum(np.abs(np.sum(after * np.diff(along, axis=0), axis=1)))
    edges = np.searchsorted(information, information[-1] * np.arange(1, BLOCKS) / BLOCKS)
    square = sum(float(part.sum()) ** 2 for part in np.split(influences, edges))
    return slope, T_95 * math.sqrt(BLOCKS / (BLOCKS - 1) * square)


def _noise(residuals: np.ndarray, weights: np.ndarray) -> float:
    """Return the variance of a residual, with a floor that keeps the arithmetic finite."""
    total = float(weights.sum()) * residuals.shape[1]
    return float(np.sum(weights[:, None] * residuals**2)) / max(total, TINY) + TINY


def mean_rotation(rotations: np.ndarray) -> np.ndarray:
    """Return the (4,) robust mean of (N, 4) quaternions."""
    weights = np.ones(len(rotations))
    for _ in range(REWEIGHTINGS):
        moments = (rotations * weights[:, None]).T @ rotations
        mean = np.linalg.eigh(moments)[1][:, -1]
        weights = robust_weights(rotation.angle_between(rotations, mean)[:, None])
    return np.asarray(mean)


def relative_rotations(rotations: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the (M, 3) rotation vectors from pose to pose, in the body's frame."""
    return rotation.to_rotation_vector(
        rotation.multiply(rotation.conjugate(rotations[begin]), rotations[end])
    )
