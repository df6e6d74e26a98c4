"""Ways of writing a pose that were mistaken for one another."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.interpolation import Interpolator
from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.diagnosis.fitting import (
    horizon,
    mean_rotation,
    relative_turns,
    robust_similarity,
    robust_weights,
    turn_is_told,
)

HORIZON_S = 0.25
# the wrong convention fits many times worse; healthy runs fit to 0.1 and better
CLEARLY = 0.5
FITS = 0.15
# the nearest whole axes, where two worlds disagree
ALIGNED_RAD = math.radians(20.0)
# what two worlds are known to, with room
SURELY_RAD = math.radians(3.0)
W_LAST = [1, 2, 3, 0]
W_FIRST = [3, 0, 1, 2]
SWAPS = {'x and y': [1, 0, 2], 'y and z': [0, 2, 1], 'x and z': [2, 1, 0]}


@dataclass(frozen=True, eq=False)
class Convention:
    """
    A way in which the poses may have been written.

    :param name: of the cause; empty where all is as it should be.
    :param detail: in words.
    :param quaternion: where in what was read x, y, z and w are.
    :param axes: (3, 3) matrix that takes the positions as read to what was meant.
    :param conjugate: whether the rotations are inverse.
    :param inverse: whether the whole poses are.
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
    """Return all ways of writing that are told apart by the rotations; the right one first."""
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
class Finding:
    """
    The convention that fits.

    :param convention: see there.
    :param misfit: of the relative motions, or of the two worlds, under it; small is good.
    :param misfit_as_is: likewise as the poses were read.
    :param of_truth: whether the truth was written in that way, not the estimate.
    :param told: whether the motion tells conventions apart.
    """

    convention: Convention
    misfit: float
    misfit_as_is: float
    of_truth: bool = False
    told: bool = True


def find_convention(estimate: Trajectory, truth: Interpolator, lag_s: float) -> Finding:
    """
    Return how the poses were written.

    Rotation vectors of short relative motions fit those of the truth up to one rotation, that of
    the sensor, only under a convention that differs from the right one by constant rotations.
    Of those that fit, the right one needs the smallest turn of the sensor, and its orientations
    agree with its positions about the world. All this knows neither scale nor drift. Who turns
    about one axis only, as on a flat floor, does not show any of it.

    :param lag_s: how late the estimate's stamps are; the angular speed, which tells it, is the
        same under all conventions.
    """
    stamps_ns = estimate.stamps_ns - round(lag_s * 1e9)
    inside = truth.inside(stamps_ns)
    estimate, poses = estimate[inside], truth.at(stamps_ns[inside])
    interval_s = float(np.median(np.diff(stamps_ns))) / 1e9
    begin, end = horizon(stamps_ns[inside], max(HORIZON_S, interval_s))
    far = horizon(stamps_ns[inside], max(1.0, 2 * interval_s))
    if (
        estimate.rotations is None
        or poses.rotations is None
        or len(begin) < 10
        or len(far[0]) < 10
    ):
        return Finding(Convention(), math.nan, math.nan, told=False)
    motions = _Motions(poses, begin, end, *far)
    fitted = [motions.fit(candidate.undo(estimate)) for candidate in candidates()]
    as_is = fitted[0]
    if as_is.misfit < CLEARLY and not as_is.turn_told:
        return Finding(Convention(), as_is.misfit, as_is.misfit, told=False)
    best = min(fit.misfit for fit in fitted)
    if not best < CLEARLY:
        return Finding(Convention(), as_is.misfit, as_is.misfit)
    limit = max(2 * best, FITS)
    if as_is.misfit > limit:
        found = _least_strange(fitted, limit)
        mended = [
            _Motions(candidate.undo(poses), begin, end, *far).fit(estimate)
            for candidate in candidates()
        ]
        other = _least_strange(mended, limit)
        of_truth = other[0] < found[0] - ALIGNED_RAD
        _, chosen, fit = other if of_truth else found
        return Finding(candidates()[chosen], fit.misfit, as_is.misfit, of_truth)
    mirrored = motions.fit(estimate, parity=-1)
    if mirrored.strayed < CLEARLY * min(as_is.strayed, 1.0):
        axes, _, of_truth = mirrored.axes()
        return Finding(_swapped(axes), mirrored.strayed, as_is.strayed, of_truth)
    if as_is.strayed < CLEARLY and as_is.apart_rad > ALIGNED_RAD:
        axes, left_rad, of_truth = as_is.axes()
        _, chosen, fit = _least_strange(fitted, limit)
        if fit.turn_rad + fit.apart_rad < as_is.turn_rad + left_rad - ALIGNED_RAD:
            return Finding(candidates()[chosen], fit.strangeness, as_is.strangeness)
        if not np.array_equal(axes, np.eye(3)) and left_rad < ALIGNED_RAD:
            return Finding(_swapped(axes), left_rad, as_is.apart_rad, of_truth)
    return Finding(Convention(), as_is.misfit, as_is.misfit)


@dataclass(frozen=True, eq=False)
class _Fit:
    """
    How poses agree with the truth.

    :param misfit: what is left of relative rotations, over what there was.
    :param strayed: likewise of displacements.
    :param turn_rad: of the sensor.
    :param turn_told: whether the motion tells it.
    :param world_of_rotations: (3, 3) from the estimate's world to that of the truth.
    :param world_of_positions: likewise.
    """

    misfit: float
    strayed: float
    turn_rad: float
    turn_told: bool
    world_of_rotations: np.ndarray
    world_of_positions: np.ndarray

    @property
    def apart_rad(self) -> float:
        """The angle between the two worlds."""
        return rotation.angle_of_matrix(self.world_of_rotations.T @ self.world_of_positions)

    def axes(self) -> tuple[np.ndarray, float, bool]:
        """
        Return the (3, 3) axes that bring the two worlds together, and the angle that they leave.

        The last is whether they are those of the truth. Seen from there the worlds are turned, so
        that only on one side the axes are whole; where they are on both, it is the estimate.
        """
        sides = []
        for apart in (
            self.world_of_rotations.T @ self.world_of_positions,
            self.world_of_rotations @ self.world_of_positions.T,
        ):
            whole = _nearest_axes(apart)
            sides.append((whole, rotation.angle_of_matrix(apart @ whole.T)))
        of_truth = sides[1][1] < sides[0][1] - SURELY_RAD
        return *sides[of_truth], of_truth

    @property
    def strangeness(self) -> float:
        """How much would have to be wrong besides."""
        return self.turn_rad + self.apart_rad + math.pi * min(self.strayed, 1.0)


class _Motions:
    """The true relative motions, over a short and a longer time."""

    def __init__(
        self,
        truth: Trajectory,
        begin: np.ndarray,
        end: np.ndarray,
        far_begin: np.ndarray,
        far_end: np.ndarray,
    ) -> None:
        assert truth.rotations is not None
        self._truth = truth.rotations
        self._begin, self._end = begin, end
        self._far_begin, self._far_end = far_begin, far_end
        self._turned = relative_turns(truth.rotations, begin, end)
        self._moved = truth.positions[far_end] - truth.positions[far_begin]

    def fit(self, poses: Trajectory, parity: int = 1) -> _Fit:
        """Return how poses agree; parity -1 for positions seen in a mirror."""
        assert poses.rotations is not None
        turned = relative_turns(poses.rotations, self._begin, self._end)
        turn, _, misfit = robust_similarity(turned, self._turned, False)
        turned = turned @ turn.T
        told = turn_is_told(turned, self._turned, robust_weights(turned - self._turned))
        displaced = poses.positions[self._far_end] - poses.positions[self._far_begin]
        of_positions, _, strayed = robust_similarity(displaced, self._moved, True, parity)
        body = rotation.from_matrix(turn.T)
        worlds = rotation.multiply(
            self._truth, rotation.conjugate(rotation.multiply(poses.rotations, body))
        )
        angle = rotation.angle(body)
        of_rotations = rotation.to_matrix(mean_rotation(worlds))
        return _Fit(misfit, strayed, float(angle), told, of_rotations, of_positions)


def _least_strange(fits: list[_Fit], limit: float) -> tuple[float, int, _Fit]:
    """Return the strangeness, place and fit of the best among those that fit."""
    strangeness, k = min(
        ((fit.strangeness, k) for k, fit in enumerate(fits) if fit.misfit <= limit),
        default=(math.inf, 0),
    )
    return strangeness, k, fits[k]


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
    """Return the convention of positions whose axes have to be brought into another order."""
    names = [
        ('-' if row.sum() < 0 else '') + 'xyz'[int(np.abs(row).argmax())] for row in axes
    ]  # fmt: skip
    return Convention('axes_swapped', f'x y z of the positions are {" ".join(names)}', axes=axes)
