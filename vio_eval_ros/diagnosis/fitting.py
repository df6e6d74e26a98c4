"""Fits that a few wild values cannot bend, and that know how uncertain they are."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.association import nearest
from vio_eval_ros.core.rotation import lengths

ITERATIONS = 12
# How uncertain a fit is, the scatter of so many blocks of the run tells: by Student's distribution
# with one degree of freedom less, of which 95 % are within this
BLOCKS, FREEDOM, T_95 = 6, 5, 2.571
TINY = 1e-12
# a block that alone speaks of a direction does not leave it without any weight
ALMOST = 1 - 1e-9
# a noise before any is known: so little that the prior does not matter
UNKNOWN = 1e-8


def student(t: float) -> float:
    """
    Return the cumulative distribution of Student's t with five degrees of freedom.

    Abramowitz and Stegun, Handbook of Mathematical Functions, 26.7.3.
    """
    angle = math.atan(t / math.sqrt(FREEDOM))
    sine, cosine = math.sin(angle), math.cos(angle)
    return 0.5 + (angle + sine * cosine * (1 + 2 * cosine**2 / 3)) / math.pi


def horizon(stamps_ns: np.ndarray, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return (M,), (M,) indices of samples that are so far apart, to a quarter."""
    target = stamps_ns + round(seconds * 1e9)
    end = nearest(target, stamps_ns)
    begin = np.arange(len(stamps_ns))
    near = np.abs(stamps_ns[end] - target) < 0.25e9 * seconds
    usable = near & (end > begin)
    return begin[usable], end[usable]


def robust_weights(residuals: np.ndarray) -> np.ndarray:
    """Return (M,) weights of residual vectors (M, D), by Geman and McClure about their median."""
    size = lengths(residuals)
    spread = float(np.median(size)) / 1.5 + TINY if len(size) else 1.0
    return np.asarray(1 / (1 + (size / (2 * spread)) ** 2) ** 2)


def similarity(
    source: np.ndarray, target: np.ndarray, weights: np.ndarray, scaled: bool, parity: int = 1
) -> tuple[np.ndarray, float]:
    """
    Return the (3, 3) R and the s that minimise Σ w |s R source - target|².

    :param parity: 1 for a rotation, -1 for a rotation with a reflection.
    """
    u, d, vt = np.linalg.svd((target * weights[:, None]).T @ source)
    signs = np.array([1.0, 1.0, parity * np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    own = float(np.sum(weights[:, None] * source**2))
    scale = float(d @ signs) / own if scaled and own > 0 else 1.0
    return (u * signs) @ vt, scale


def turn_is_told(turned: np.ndarray, target: np.ndarray, weights: np.ndarray) -> bool:
    """
    Return whether vectors tell all of the rotation that was fitted to them.

    How firmly they hold it about each axis is the Hessian of Wahba's problem, tr(C) I - C with
    their cross-covariance C, in which the noise of one side does not pass for vectors of the
    other. Vectors along a single axis hold the turn about it no better than their noise does.

    :param turned: (M, 3) with the rotation applied, to be equal to the (M, 3) ``target``.
    """
    cross = (target * weights[:, None]).T @ turned
    held = np.linalg.eigvalsh((cross + cross.T) / 2)
    noise = float(np.sum(weights[:, None] * (turned - target) ** 2)) / 3
    return bool(held[0] + held[1] > noise)


def robust_similarity(
    source: np.ndarray, target: np.ndarray, scaled: bool, parity: int = 1
) -> tuple[np.ndarray, float, float]:
    """Return R, s and the median of what is left, over the median length of the target."""
    weights = np.ones(len(source))
    if scaled:  # long vectors would have their way at first, and lengths are told without a turn
        ratios = np.log((lengths(source) + TINY) / (lengths(target) + TINY))
        weights = robust_weights((ratios - np.median(ratios))[:, None])
    turn, scale = np.eye(3), 1.0
    for _ in range(ITERATIONS):
        turn, scale = similarity(source, target, weights, scaled, parity)
        rest = scale * source @ turn.T - target
        weights = robust_weights(rest)
    usual = float(np.median(lengths(target))) if len(target) else 0.0
    return turn, scale, float(np.median(lengths(rest))) / (usual + TINY) if len(target) else np.nan


@dataclass(frozen=True, eq=False)
class Fit:
    """
    The solution of a robust linear least-squares problem.

    :param values: (P,) parameters.
    :param covariance: (P, P) of them.
    :param weights: (M,) in the end.
    :param residuals: (M, D) in the end.
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
) -> Fit:
    """
    Return the robust solution x of design x = target.

    Neighbouring rows err alike, so the covariance is that of how much the solution changes without
    each of the blocks of rows, one behind the other in time (the jackknife, clustered), and that
    of white noise, since few blocks may agree by chance. A direction that no row speaks of keeps
    the uncertainty of the prior.

    :param design: (M, D, P).
    :param target: (M, D).
    :param prior: (P,) standard deviations beyond which no value is expected, about zero.
    :param weights: (M,) fixed weights; else they follow from the residuals.
    """
    iterate = weights is None
    weights = np.ones(len(target)) if weights is None else weights
    noise = UNKNOWN
    for _ in range(ITERATIONS if iterate else 1):
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
    steep = weights * (1 - 4 * (1 - np.sqrt(weights)) / target.shape[1])
    follow = float(weights.sum()) / max(float(steep.sum()), TINY)
    changes = []
    for rows in np.array_split(np.arange(len(target)), BLOCKS):
        rest = information - ALMOST * np.einsum('mdp,mdq->pq', weighted[rows], design[rows])
        pull = np.einsum('mdp,md->p', weighted[rows], residuals[rows])
        changes.append(np.linalg.solve(rest, pull))
    apart = np.array(changes) - np.mean(changes, axis=0)
    spread = follow**2 * (BLOCKS - 1) / BLOCKS * apart.T @ apart
    return Fit(values, spread + noise * np.linalg.inv(information), weights, residuals)


def fit_slope(along: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """
    Return the slope of what walks at random, and half the width of its 95 % interval.

    The error of an odometry does: poses err alike over all of a run, but by how much the error
    changes from pose to pose does not. With x about its mean the slope of values over x is off by
    Σ cₖ·Δeₖ, where cₖ is the sum of x / Σ|x|² from k on. How uncertain that is, the scatter of
    parts of this sum tells, each of which tells as much of the slope.

    :param along: (N, D) x.
    :param values: (N, D).
    """
    along, values = along - along.mean(axis=0), values - values.mean(axis=0)
    total = float(np.sum(along**2))
    if not total > 0:
        return math.nan, math.inf
    slope = float(np.sum(along * values)) / total
    behind = np.cumsum(along[:0:-1], axis=0)[::-1] / total
    pulls = np.sum(behind * np.diff(values - slope * along, axis=0), axis=1)
    told = np.cumsum(np.abs(np.sum(behind * np.diff(along, axis=0), axis=1)))
    edges = np.searchsorted(told, told[-1] * np.arange(1, BLOCKS) / BLOCKS)
    square = sum(float(part.sum()) ** 2 for part in np.split(pulls, edges))
    return slope, T_95 * math.sqrt(BLOCKS / (BLOCKS - 1) * square)


def _noise(residuals: np.ndarray, weights: np.ndarray) -> float:
    """Return the variance of a residual, with a floor that keeps the arithmetic finite."""
    total = float(weights.sum()) * residuals.shape[1]
    return float(np.sum(weights[:, None] * residuals**2)) / max(total, TINY) + TINY


def mean_rotation(rotations: np.ndarray) -> np.ndarray:
    """Return the (4,) robust mean of (N, 4) quaternions."""
    weights = np.ones(len(rotations))
    for _ in range(ITERATIONS):
        moments = (rotations * weights[:, None]).T @ rotations
        mean = np.linalg.eigh(moments)[1][:, -1]
        weights = robust_weights(rotation.angle_between(rotations, mean)[:, None])
    return np.asarray(mean)


def relative_turns(rotations: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return the (M, 3) rotation vectors from pose to pose, in the body's frame."""
    return rotation.to_rotation_vector(
        rotation.multiply(rotation.conjugate(rotations[begin]), rotations[end])
    )
