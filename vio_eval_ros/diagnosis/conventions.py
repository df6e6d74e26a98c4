"""Conventions of writing a pose, and which of them an estimate or a truth was written in."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.interpolation import Interpolator
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.fitting import (
    FEWEST_MOTIONS,
    horizon,
    mean_rotation,
    relative_rotations,
    robust_similarity,
    robust_weights,
    rotation_is_observable,
)

#: over which relative rotations and displacements are compared
ROTATION_S, DISPLACEMENT_S = 0.25, 1.0
#: residuals: a wrong convention has many times that of the right one, which in healthy runs is
#: 0.1 and less
WRONG_RESIDUAL_RATIO, RIGHT_RESIDUAL_RATIO = 0.5, 0.15
#: two worlds agree up to this angle
SAME_WORLD_RAD = math.radians(20.0)
#: the accuracy of the angle between two worlds, with room
WORLD_ACCURACY_RAD = math.radians(3.0)
W_LAST = [1, 2, 3, 0]
W_FIRST = [3, 0, 1, 2]
SWAPS = {'x and y': [1, 0, 2], 'y and z': [0, 2, 1], 'x and z': [2, 1, 0]}


@dataclass(frozen=True, eq=False)
class Convention:
    """
    A way in which the poses may have been written.

    :param name: of the cause; empty where all is as it should be.
    :param detail: what was mistaken for what, in words.
    :param quaternion: the indices of x, y, z and w among the components as read.
    :param axes: (3, 3) matrix that takes the positions as read to what was meant.
    :param conjugate: whether the rotations are inverse.
    :param inverse: whether whole poses are inverse.
    """

    name: str = ''
    detail: str = ''
    quaternion: tuple[int, ...] = (0, 1, 2, 3)
    axes: np.ndarray | None = None
    conjugate: bool = False
    inverse: bool = False

    def undo(self, poses: Trajectory) -> Trajectory:
        """Return the poses as they were meant."""
        positions, rotations = poses.positions, poses.rotations
        if self.axes is not None:
            positions = positions @ self.axes.T
        if rotations is not None:
            rotations = rotations[:, list(self.quaternion)]
            if self.conjugate or self.inverse:
                rotations = rotation.conjugate(rotations)
            if self.inverse:
                positions = -rotation.rotate(rotations, positions)
        return replace(poses, positions=positions, rotations=rotations, covariances=None)


def candidates() -> list[Convention]:
    """Return all conventions that rotations distinguish; the right one first."""
    return [
        Convention(),
        Convention('quaternion_conjugated', conjugate=True),
        Convention('pose_inverted', inverse=True),
        *(
            Convention('quaternion_order', detail + also, tuple(order), conjugate=bool(also))
            for also in ('', ', and its rotations are inverse')
            for detail, order in (
                ('w was read as x: the source has w first', W_LAST),
                ('x was read as w: the source has w last', W_FIRST),
            )
        ),
        *(
            Convention(
                'axes_swapped', f'{axes} are swapped', (*order, 3), np.eye(3)[order]
            )
            for axes, order in SWAPS.items()
        ),
    ]  # fmt: skip


@dataclass(frozen=True)
class FoundConvention:
    """
    The convention that agrees best.

    :param convention: that the poses were written in.
    :param residual: of the relative motions, or of the two worlds, under it; small is good.
    :param residual_as_is: likewise as the poses were read.
    :param of_truth: whether the truth was written in it, not the estimate.
    :param observable: whether the motion distinguishes conventions.
    """

    convention: Convention
    residual: float
    residual_as_is: float
    of_truth: bool = False
    observable: bool = True


def find_convention(estimate: Trajectory, truth: Interpolator, lag_s: float) -> FoundConvention:
    """
    Return how the poses were written.

    Rotation vectors of short relative motions agree with those of the truth up to one rotation,
    that of the sensor, only under a convention that differs from the right one by constant
    rotations. Of those that agree, the right one needs the smallest rotation of the sensor, and
    its orientations agree with its positions about the world. None of this depends on scale or
    drift. A body that rotates about one axis only, as on a flat floor, reveals none of this.

    :param lag_s: how late the estimate's stamps are; the angular speed, which determines it, is
        the same under all conventions.
    """
    stamps_ns = estimate.stamps_ns - round(lag_s * 1e9)
    inside = truth.inside(stamps_ns)
    motions = ComparedMotions.of(estimate[inside], truth.at(stamps_ns[inside]), stamps_ns, inside)
    if motions is None:
        return FoundConvention(Convention(), math.nan, math.nan, observable=False)
    return _of_motions(motions)


def _of_motions(motions: ComparedMotions) -> FoundConvention:
    """Return the convention under which relative motions agree."""
    agreements = motions.under_all_conventions()
    as_is = agreements[0]
    if as_is.residual < WRONG_RESIDUAL_RATIO and not as_is.observable:
        return FoundConvention(Convention(), as_is.residual, as_is.residual, observable=False)
    best = min(agreement.residual for agreement in agreements)
    if not best < WRONG_RESIDUAL_RATIO:
        return FoundConvention(Convention(), as_is.residual, as_is.residual)
    limit = max(2 * best, RIGHT_RESIDUAL_RATIO)
    if as_is.residual > limit:
        return _rotations_disagree(motions, agreements, limit)
    return (
        _mirrored_positions(motions, as_is)
        or _worlds_disagree(agreements, limit)
        or FoundConvention(Convention(), as_is.residual, as_is.residual)
    )


def _rotations_disagree(
    motions: ComparedMotions, agreements: list[Agreement], limit: float
) -> FoundConvention:
    """Return the convention of the estimate or of the truth under which rotations agree."""
    found = _most_plausible(agreements, limit)
    other = _most_plausible(motions.with_truth_under_all_conventions(), limit)
    of_truth = other[0] < found[0] - SAME_WORLD_RAD
    _, chosen, agreement = other if of_truth else found
    return FoundConvention(
        candidates()[chosen], agreement.residual, agreements[0].residual, of_truth
    )


def _mirrored_positions(motions: ComparedMotions, as_is: Agreement) -> FoundConvention | None:
    """Return the axes of positions that agree only when mirrored, if they do."""
    mirrored = motions.agreement(motions.estimate, parity=-1)
    if not mirrored.position_residual < WRONG_RESIDUAL_RATIO * min(as_is.position_residual, 1.0):
        return None
    axes, _, of_truth = mirrored.axes()
    return FoundConvention(
        _swapped(axes), mirrored.position_residual, as_is.position_residual, of_truth
    )


def _worlds_disagree(agreements: list[Agreement], limit: float) -> FoundConvention | None:
    """Return what brings the worlds of rotations and positions together, if they disagree."""
    as_is = agreements[0]
    if not (as_is.position_residual < WRONG_RESIDUAL_RATIO and as_is.worlds_rad > SAME_WORLD_RAD):
        return None
    axes, left_rad, of_truth = as_is.axes()
    _, chosen, agreement = _most_plausible(agreements, limit)
    if agreement.sensor_rad + agreement.worlds_rad < as_is.sensor_rad + left_rad - SAME_WORLD_RAD:
        return FoundConvention(
            candidates()[chosen], agreement.implausibility, as_is.implausibility
        )
    if not np.array_equal(axes, np.eye(3)) and left_rad < SAME_WORLD_RAD:
        return FoundConvention(_swapped(axes), left_rad, as_is.worlds_rad, of_truth)
    return None


@dataclass(frozen=True, eq=False)
class Agreement:
    """
    How poses agree with the truth.

    :param residual: what is left of relative rotations, over what there was.
    :param position_residual: likewise of displacements.
    :param sensor_rad: the angle of the sensor.
    :param observable: whether the motion determines the rotation of the sensor.
    :param world_of_rotations: (3, 3) from the estimate's world to that of the truth.
    :param world_of_positions: likewise.
    """

    residual: float
    position_residual: float
    sensor_rad: float
    observable: bool
    world_of_rotations: np.ndarray
    world_of_positions: np.ndarray

    @property
    def worlds_rad(self) -> float:
        """The angle between the two worlds."""
        return rotation.angle_of_matrix(self.world_of_rotations.T @ self.world_of_positions)

    def axes(self) -> tuple[np.ndarray, float, bool]:
        """
        Return the (3, 3) axes that bring the two worlds together, and the angle that they leave.

        The last is whether they are those of the truth. Seen from there the worlds are rotated,
        so that axes are whole on one side only; where they are on both, it is the estimate.
        """
        sides = []
        for between in (
            self.world_of_rotations.T @ self.world_of_positions,
            self.world_of_rotations @ self.world_of_positions.T,
        ):
            whole = _nearest_axes(between)
            sides.append((whole, rotation.angle_of_matrix(between @ whole.T)))
        of_truth = sides[1][1] < sides[0][1] - WORLD_ACCURACY_RAD
        return *sides[of_truth], of_truth

    @property
    def implausibility(self) -> float:
        """How much else would have to be wrong [rad]."""
        return self.sensor_rad + self.worlds_rad + math.pi * min(self.position_residual, 1.0)


class ComparedMotions:
    """
    Poses of both sides, with the rows that are a short and a longer time apart.

    :param estimate: N poses, with rotations.
    :param truth: the true ones.
    :param short: (M,), (M,) rows between which rotations are compared.
    :param long: likewise for displacements.
    """

    def __init__(
        self,
        estimate: Trajectory,
        truth: Trajectory,
        short: tuple[np.ndarray, np.ndarray],
        long: tuple[np.ndarray, np.ndarray],
    ) -> None:
        assert truth.rotations is not None
        self.estimate = estimate
        self._truth, self._true_rotations = truth, truth.rotations
        self._short, self._long = short, long
        self._rotated = relative_rotations(truth.rotations, *short)
        self._displaced = truth.positions[long[1]] - truth.positions[long[0]]

    @classmethod
    def of(
        cls, estimate: Trajectory, truth: Trajectory, stamps_ns: np.ndarray, inside: np.ndarray
    ) -> ComparedMotions | None:
        """
        Return the motions of poses; None without rotations or with too few of them.

        :param stamps_ns: of all poses, on the clock of the truth.
        :param inside: which of them the two sides have.
        """
        interval_s = float(np.median(np.diff(stamps_ns))) / 1e9
        short, long = (
            horizon(stamps_ns[inside], seconds)
            for seconds in (max(ROTATION_S, interval_s), max(DISPLACEMENT_S, 2 * interval_s))
        )
        if estimate.rotations is None or truth.rotations is None:
            return None
        if min(len(short[0]), len(long[0])) < FEWEST_MOTIONS:
            return None
        return cls(estimate, truth, short, long)

    def under_all_conventions(self) -> list[Agreement]:
        """Return how the estimate agrees under every convention."""
        return [self.agreement(convention.undo(self.estimate)) for convention in candidates()]

    def with_truth_under_all_conventions(self) -> list[Agreement]:
        """Return how the estimate agrees with the truth under every convention of that."""
        return [
            ComparedMotions(
                self.estimate, convention.undo(self._truth), self._short, self._long
            ).agreement(self.estimate)
            for convention in candidates()
        ]

    def agreement(self, poses: Trajectory, parity: int = 1) -> Agreement:
        """Return how poses agree; parity -1 for positions seen in a mirror."""
        assert poses.rotations is not None
        rotated = relative_rotations(poses.rotations, *self._short)
        of_rotations = robust_similarity(rotated, self._rotated, scaled=False)
        rotated = rotated @ of_rotations.rotation.T
        observable = rotation_is_observable(
            rotated, self._rotated, robust_weights(rotated - self._rotated)
        )
        begin, end = self._long
        displaced = poses.positions[end] - poses.positions[begin]
        of_positions = robust_similarity(displaced, self._displaced, scaled=True, parity=parity)
        body = rotation.from_matrix(of_rotations.rotation.T)
        worlds = rotation.multiply(
            self._true_rotations, rotation.conjugate(rotation.multiply(poses.rotations, body))
        )
        return Agreement(
            residual=of_rotations.residual,
            position_residual=of_positions.residual,
            sensor_rad=float(rotation.angle(body)),
            observable=observable,
            world_of_rotations=rotation.to_matrix(mean_rotation(worlds)),
            world_of_positions=of_positions.rotation,
        )


def _most_plausible(agreements: list[Agreement], limit: float) -> tuple[float, int, Agreement]:
    """Return implausibility, index and agreement of the best of those with a small residual."""
    implausibility, k = min(
        (
            (agreement.implausibility, k)
            for k, agreement in enumerate(agreements)
            if agreement.residual <= limit
        ),
        default=(math.inf, 0),
    )
    return implausibility, k, agreements[k]


def _nearest_axes(matrix: np.ndarray) -> np.ndarray:
    """Return the signed permutation nearest to an orthogonal matrix."""
    axes = np.zeros((3, 3))
    left = np.abs(matrix)
    for _ in range(3):
        row, column = np.unravel_index(np.argmax(left), left.shape)
        axes[row, column] = np.sign(matrix[row, column])
        left[row], left[:, column] = -1.0, -1.0
    return axes


def _swapped(axes: np.ndarray) -> Convention:
    """Return the convention of positions whose axes have to be reordered."""
    names = [
        ('-' if row.sum() < 0 else '') + 'xyz'[int(np.abs(row).argmax())] for row in axes
    ]  # fmt: skip
    return Convention('axes_swapped', f'x y z of the positions are {" ".join(names)}', axes=axes)
