"""Scale, lever arm, tilt and drift of an estimate whose stamps and conventions are right."""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.alignment import Moments, solve
from vio_eval_ros.core.trajectory import Pairs
from vio_eval_ros.diagnosis.fitting import (
    BLOCKS,
    fit_slope,
    horizon,
    least_squares,
    mean_rotation,
    robust_similarity,
    rotation_is_observable,
    Solution,
    T_95,
)

#: over which displacements are compared
BODY_MOTION_S = 0.5
UP = np.array([0.0, 0.0, 1.0])
#: what is left of displacements by one explanation, over what another leaves, where both hold
AS_WELL = 1.002
#: Gauss-Newton steps of a lever arm and the world of a truth without orientations ...
WORLD_STEPS = 8
#: ... and what is expected of lever arm [m], scale and its drift, lag [s], world [rad], heading
POSITIONS_PRIOR = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class Estimated:
    """A parameter, and half the width of its 95 % interval; infinite where not observable."""

    value: float
    uncertainty: float

    @classmethod
    def unknown(cls, value: float = 0.0) -> Estimated:
        """Return a parameter that is not observable, at its most likely value."""
        return cls(value, math.inf)

    def significantly_beyond(self, size: float) -> bool:
        """Return whether all of its interval is beyond this, in one direction or the other."""
        return abs(self.value) - self.uncertainty > size

    def over(self, divisor: float) -> Estimated:
        """Return the parameter over a known number."""
        return Estimated(self.value / divisor, self.uncertainty / divisor)


@dataclass(frozen=True, eq=False)
class Body:
    """
    What short relative motions determine.

    :param lever: (3,) metres of the estimate, the position of the body in the tracked frame.
    :param lever_length: its length in metres of the truth, in which a body has its size whatever
        the scale of the estimate.
    :param scale_drift: by how much more of itself the scale grows, per second.
    :param positions_late: seconds by which positions are of earlier moments than orientations,
        whatever the lever arm, or than those of a truth without orientations; to first order, and
        so too small where it is large.
    :param lever_for_scale: whether a lever arm alone explains the displacements as well as a scale
        alone does, as on a circle.
    """

    lever: np.ndarray
    lever_length: Estimated
    scale_drift: Estimated
    positions_late: Estimated
    lever_for_scale: bool = False

    @classmethod
    def unknown(cls) -> Body:
        """Return that nothing is observable."""
        nothing = Estimated.unknown()
        return cls(np.zeros(3), nothing, nothing, nothing)


def fit_body(pairs: Pairs, sensor: np.ndarray) -> Body:
    """
    Return lever arm and scale drift, from displacements over half a second in the body's frame.

    There R_eᵀ Δe = s u - (R_ij - I) l, with u the true displacement in the tracked frame, R_ij
    its relative rotation and l the lever arm: linear in both, without world, yaw drift or
    gravity. It is solved together with a scale that changes evenly over the run.

    :param sensor: (4,) rotation of the body in the tracked frame.
    """
    estimate, truth = pairs.estimate, pairs.ground_truth
    if estimate.rotations is None or len(pairs) < 2:
        return Body.unknown()
    if truth.rotations is None:
        return _fit_body_to_positions(pairs)
    stamps_ns = estimate.stamps_ns
    interval_s = float(np.median(np.diff(stamps_ns))) / 1e9
    begin, end = horizon(stamps_ns, max(BODY_MOTION_S, interval_s))
    if len(begin) < 2 * BLOCKS:
        return Body.unknown()
    back = rotation.conjugate(estimate.rotations[begin])
    displaced = rotation.rotate(back, estimate.positions[end] - estimate.positions[begin])
    rotated = rotation.to_matrix(rotation.multiply(back, estimate.rotations[end])) - np.eye(3)
    to_tracked = rotation.multiply(sensor, rotation.conjugate(truth.rotations[begin]))
    true = rotation.rotate(to_tracked, truth.positions[end] - truth.positions[begin])
    middle_ns, half_s = (stamps_ns[0] + stamps_ns[-1]) / 2, np.ptp(stamps_ns) / 2e9
    elapsed = ((stamps_ns[begin] + stamps_ns[end]) / 2 - middle_ns) / 1e9 / half_s
    design = np.concatenate(
        [true[..., None], (true * elapsed[:, None])[..., None], -rotated], axis=-1
    )
    prior = np.array([100.0, 100.0, 1.0, 1.0, 1.0])
    fit = least_squares(design, displaced, prior)
    scale, lever = abs(float(fit.values[0])), fit.values[2:]
    if not scale > 0:
        return Body.unknown()
    drift = Estimated(float(fit.values[1]), fit.uncertainty(1)).over(scale * half_s)
    length = Estimated(float(np.linalg.norm(lever)), _worst(fit, slice(2, 5))).over(scale)
    speeds = np.gradient(truth.positions, stamps_ns / 1e9, axis=0)
    earlier = rotation.rotate(to_tracked, speeds[begin] - speeds[end])[..., None]
    both = least_squares(
        np.concatenate([design, earlier], axis=-1), displaced, np.append(prior, 100.0), fit.weights
    )
    late = Estimated(float(both.values[5]), both.uncertainty(5)).over(scale)
    return Body(lever, length, drift, late, _lever_for_scale(design, displaced, fit.weights))


def _lever_for_scale(design: np.ndarray, displaced: np.ndarray, weights: np.ndarray) -> bool:
    """Return whether a lever arm alone leaves no more of the displacements than a scale alone."""
    true, rotated = design[..., :1], design[..., 2:]
    scaled = least_squares(true, displaced, np.array([100.0]), weights)
    moved = least_squares(rotated, displaced - true[..., 0], np.ones(3), weights)
    left_by_scale = displaced - true[..., 0] * scaled.values[0]
    left_by_lever = displaced - true[..., 0] - rotated @ moved.values
    of_scale, of_lever = (
        float(np.sum(weights[:, None] * left**2)) for left in (left_by_scale, left_by_lever)
    )
    return of_lever < AS_WELL**2 * of_scale


def _fit_body_to_positions(pairs: Pairs) -> Body:
    """
    Return the lever arm by the orientations of the estimate, of a truth that has positions only.

    As a prism on a stick is displaced: R_wᵀ s Δg = Δe + (R_j - R_i) l. The rotation R_w between
    the worlds, a heading that drifts evenly and the scale are not known from orientations, and are
    solved for together with l, by Gauss-Newton.
    """
    estimate, truth = pairs.estimate, pairs.ground_truth
    assert estimate.rotations is not None
    stamps_ns = estimate.stamps_ns
    interval_s = float(np.median(np.diff(stamps_ns))) / 1e9
    begin, end = horizon(stamps_ns, max(BODY_MOTION_S, interval_s))
    if len(begin) < 2 * BLOCKS:
        return Body.unknown()
    half_s = np.ptp(stamps_ns) / 2e9
    elapsed = ((stamps_ns[begin] + stamps_ns[end] - stamps_ns[0] - stamps_ns[-1]) / 2e9) / half_s
    rotated = np.diff(rotation.to_matrix(estimate.rotations[[begin, end]]), axis=0)[0]
    true = truth.positions[end] - truth.positions[begin]
    speeds = np.gradient(truth.positions, stamps_ns / 1e9, axis=0)
    slope = speeds[begin] - speeds[end]
    displaced = estimate.positions[end] - estimate.positions[begin]
    lever = np.zeros(3)
    for _ in range(WORLD_STEPS):
        fitted = robust_similarity(true, displaced + rotated @ lever, scaled=True)
        expected, later = (fitted.scale * each @ fitted.rotation.T for each in (true, slope))
        turned = np.stack([np.cross(axis, expected) for axis in np.eye(3)], -1)
        columns = [expected, expected * elapsed[:, None], later]
        design = np.concatenate(
            [
                -rotated,
                np.stack(columns, -1),
                turned,
                turned[..., 2:] * elapsed[:, None, None],
            ],
            axis=-1,
        )
        fit = least_squares(design, displaced - expected, POSITIONS_PRIOR)
        lever = fit.values[:3]
    scale = fitted.scale
    if not (
        scale > 0 and rotation_is_observable(expected, displaced + rotated @ lever, fit.weights)
    ):
        return Body.unknown()
    length = Estimated(float(np.linalg.norm(lever)), _worst(fit, slice(0, 3))).over(scale)
    drift = Estimated(float(fit.values[4]), fit.uncertainty(4)).over(half_s)
    return Body(lever, length, drift, Estimated(float(fit.values[5]), fit.uncertainty(5)))


def _worst(fit: Solution, rows: slice) -> float:
    """Return half the 95 % interval of some parameters along their worst direction."""
    largest = float(np.linalg.eigvalsh(fit.covariance[rows, rows])[-1])
    return T_95 * math.sqrt(max(largest, 0.0))


def fit_scale(pairs: Pairs) -> Estimated:
    """
    Return estimated over true length, rotated as the similarity that aligns all positions best.

    It is the slope of the estimate over the truth, which has the smaller errors. The scale of that
    similarity is the other slope, which errors of the estimate make smaller.
    """
    aligned = solve('sim3', Moments.of(pairs), pairs[:1])
    if len(pairs) < 2 * BLOCKS or not aligned.scale > 0:
        return Estimated.unknown(1.0)
    rotated = rotation.rotate(aligned.rotation, pairs.estimate.positions)
    scale, uncertainty = fit_slope(pairs.ground_truth.positions, rotated)
    return Estimated(scale, uncertainty) if scale > 0 else Estimated.unknown(1.0)


@dataclass(frozen=True, eq=False)
class World:
    """
    The estimate's world against that of the truth.

    :param level: (4,) the rotation that makes the estimate's world upright.
    :param tilt_rad: its angle.
    :param yaw_drift: rad/s by which the estimated heading drifts.
    """

    level: np.ndarray
    tilt_rad: Estimated
    yaw_drift: Estimated


def fit_world(pairs: Pairs) -> World:
    """
    Return tilt and yaw drift of the estimate's world against that of the truth.

    By orientations where both sides have them: each pose gives A = R_g R_eᵀ. Otherwise the
    tilt is that of the alignment of the positions, and the yaw drift is unknown.
    """
    if pairs.rotations is None or len(pairs) < 2 * BLOCKS:
        return _world_of_positions(pairs)
    mean = mean_rotation(pairs.rotations)
    apart = rotation.multiply(pairs.rotations, rotation.conjugate(mean))
    errors = rotation.to_rotation_vector(apart)
    stamps_ns = pairs.estimate.stamps_ns
    seconds = (stamps_ns - (stamps_ns[0] + stamps_ns[-1]) / 2) / 1e9
    half_s = float(np.ptp(seconds)) / 2
    design = np.stack([np.ones(len(seconds)), seconds / half_s], axis=-1)[:, None]
    yaw = least_squares(design, errors[:, 2:], np.array([1.0, 10.0]))
    level, tilt = _level(mean)
    tilts = np.array([rows.mean(axis=0) for rows in np.array_split(errors[:, :2], BLOCKS)])
    spread = math.sqrt(float(np.var(tilts, axis=0).sum()) / (BLOCKS - 1))
    return World(
        level,
        Estimated(tilt, T_95 * spread),
        Estimated(-float(yaw.values[1]) / half_s, fit_slope(seconds[:, None], errors[:, 2:])[1]),
    )


def _world_of_positions(pairs: Pairs) -> World:
    """Return the tilt that the alignment of the positions has; the yaw drift is unknown."""
    aligned = solve('sim3', Moments.of(pairs), pairs[:1])
    if len(pairs) < 2 * BLOCKS or not aligned.observable:
        return World(rotation.IDENTITY, Estimated.unknown(), Estimated.unknown())
    level, tilt = _level(aligned.rotation)
    truth = pairs.ground_truth.positions
    rotated = rotation.rotate(aligned.rotation, pairs.estimate.positions)
    errors = aligned.scale * rotated - truth
    # a rotation about a level axis a moves positions g along a x g
    spreads = (fit_slope(np.cross(axis, truth), errors)[1] for axis in np.eye(3)[:2])
    return World(level, Estimated(tilt, math.hypot(*spreads)), Estimated.unknown())


def _level(world: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the smallest rotation that makes a world upright, given its (4,) orientation."""
    up = rotation.rotate(rotation.conjugate(world), UP)
    axis = np.cross(up, UP)
    sine, cosine = float(np.linalg.norm(axis)), float(up @ UP)
    angle = math.atan2(sine, cosine)
    if sine < 1e-12:
        axis, sine = np.array([1.0, 0.0, 0.0]), 1.0
    return rotation.from_rotation_vector(axis / sine * angle), angle
