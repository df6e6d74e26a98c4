"""Poses in columns: as received (Poses), in order (Trajectory), and matched (Pairs)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from vio_eval_ros.core import rotation

Columns = TypeVar('Columns', bound='Poses')

BLOCK_ROWS = 1 << 13
MAX_RESERVED_PAIRS = 1 << 22
#: smallest over largest eigenvalue, below which a covariance is singular
MIN_EIGENVALUE_RATIO = 1e-12
COLUMNS = ('stamps_ns', 'positions', 'rotations', 'covariances', 'weights')


def blocks(count: int) -> Iterator[slice]:
    """Yield slices of ``count`` rows, so small that temporary arrays fit into a cache."""
    return (slice(start, start + BLOCK_ROWS) for start in range(0, count, BLOCK_ROWS))


def as_slice(index: np.ndarray) -> np.ndarray | slice:
    """Return consecutive indices as a slice, which selects rows without a copy; others as is."""
    if len(index) and index[-1] - index[0] + 1 == len(index) and (np.diff(index) == 1).all():
        return slice(int(index[0]), int(index[-1]) + 1)
    return index


def rows(column: np.ndarray, index: np.ndarray | slice) -> np.ndarray:
    """Return some rows of a column; ``take`` is several times faster than indexing."""
    return column[index] if isinstance(index, slice) else column.take(index, axis=0)


@dataclass(frozen=True, eq=False)
class Poses:
    """
    Poses of a body in a world frame, in columns, in the order in which they arrived.

    The values may be anything: stamps may repeat or go backwards, numbers may be NaN, quaternions
    need not have unit length. :func:`~vio_eval_ros.core.cleaning.clean` makes a
    :class:`Trajectory` of them.

    :param stamps_ns: (N,) int64 nanoseconds.
    :param positions: (N, 3) float64 metres, world frame.
    :param rotations: (N, 4) float64 quaternions x y z w, body to world; None where only positions
        are known.
    :param covariances: (N, 2, 3, 3) float64: of the position [m²] and of the orientation
        [rad²] (rotations about the fixed world axes); NaN where unknown, None where the source
        has none.
    :param zero_is_unset: whether a stamp of 0 says that there was none, as in messages published
        before ``/clock``.
    :param origin: of a world that is metres east, north and up: its latitude and longitude [deg]
        and height [m]; None for any other world.
    :param weights: (N,) float64, how much each position counts where an alignment is fitted to
        them, relative to others of the stream; 0 leaves it out. None where all count the same.
    """

    stamps_ns: np.ndarray
    positions: np.ndarray
    rotations: np.ndarray | None = None
    covariances: np.ndarray | None = None
    zero_is_unset: bool = False
    origin: tuple[float, float, float] | None = None
    weights: np.ndarray | None = None

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.stamps_ns)

    def __getitem__(self: Columns, index: Any) -> Columns:
        """Return the rows that a slice, mask or index array selects."""
        columns = {name: getattr(self, name) for name in COLUMNS}
        selected: dict[str, Any] = {
            name: None if column is None else column[index] for name, column in columns.items()
        }
        return type(self)(**selected, zero_is_unset=self.zero_is_unset, origin=self.origin)

    @classmethod
    def concatenate(cls: type[Columns], parts: Sequence[Columns]) -> Columns:
        """
        Return all parts as one.

        Where a non-empty part has no rotations or weights, there are none; unknown covariances are
        NaN.
        """
        parts = [part for part in parts if len(part)] or list(parts[:1])
        if len(parts) == 1:
            return parts[0]
        rotations: list[Any] = [part.rotations for part in parts]
        weights: list[Any] = [part.weights for part in parts]
        covariances: list[Any] = [part.covariances for part in parts]
        known = any(column is not None for column in covariances)
        return cls(
            np.concatenate([part.stamps_ns for part in parts]),
            np.concatenate([part.positions for part in parts]),
            None if any(column is None for column in rotations) else np.concatenate(rotations),
            np.concatenate([part.covariances_or_nan() for part in parts]) if known else None,
            any(part.zero_is_unset for part in parts),
            parts[0].origin,
            None if any(column is None for column in weights) else np.concatenate(weights),
        )

    def covariances_or_nan(self) -> np.ndarray:
        """Return the (N, 2, 3, 3) covariances, NaN where the source has none."""
        if self.covariances is not None:
            return self.covariances
        return np.full((len(self), 2, 3, 3), np.nan)


@dataclass(frozen=True, eq=False)
class Trajectory(Poses):
    """
    Poses of a body in a world frame, in columns, sorted by stamp.

    As :class:`Poses`, and ``stamps_ns`` is strictly increasing, every number is finite and
    ``rotations`` are unit quaternions.
    """

    @classmethod
    def empty(cls) -> Trajectory:
        """Return a trajectory without poses."""
        return cls(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 4)))

    def within(self, begin_ns: int, end_ns: int) -> Trajectory:
        """Return the poses with stamps in [begin, end]."""
        inside = (self.stamps_ns >= begin_ns) & (self.stamps_ns <= end_ns)
        return self if inside.all() else self[inside]


@dataclass(frozen=True, eq=False)
class Pairs:
    """
    Associated poses: row k of all columns belongs together.

    :param estimate: N poses; stamps include the configured time offset.
    :param ground_truth: N poses; where they were interpolated, at the estimate's stamps.
    :param deviations: (N, 2, 6) float32, the lower triangles L of the estimate's covariances L Lᵀ
        (position, orientation), to seven digits; NaN where one is not positive definite, None
        where there are none. The trajectories of pairs have no covariances.
    """

    estimate: Trajectory
    ground_truth: Trajectory
    deviations: np.ndarray | None = None

    @classmethod
    def of(cls, estimate: Trajectory, ground_truth: Trajectory) -> Pairs:
        """Return the pairs of N estimated and N true poses."""
        covariances = estimate.covariances
        return cls(
            replace(estimate, covariances=None),
            replace(ground_truth, covariances=None),
            None if covariances is None else _deviations(covariances),
        )

    @property
    def oriented(self) -> bool:
        """Whether the orientations of both sides are known."""
        return self.estimate.rotations is not None and self.ground_truth.rotations is not None

    @cached_property
    def rotations(self) -> np.ndarray | None:
        """(N, 4) quaternions of A = R_g R_eᵀ, from the estimated to the true orientation."""
        estimate, truth = self.estimate.rotations, self.ground_truth.rotations
        if estimate is None or truth is None:
            return None
        return rotation.multiply(truth, rotation.conjugate(estimate))

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.estimate)

    def __getitem__(self, index: Any) -> Pairs:
        """Return the pairs that a slice, mask or index array selects."""
        deviations = None if self.deviations is None else self.deviations[index]
        return Pairs(self.estimate[index], self.ground_truth[index], deviations)

    def without_rotations(self, estimate: bool, ground_truth: bool) -> Pairs:
        """Return the pairs without the orientations of these sides."""
        sides = {'estimate': estimate, 'ground_truth': ground_truth}
        return replace(
            self,
            **{
                name: replace(getattr(self, name), rotations=None)
                for name, without in sides.items()
                if without
            },
        )

    def deviations_or_nan(self) -> np.ndarray:
        """Return the (N, 2, 6) deviations, NaN where the estimate has no covariances."""
        if self.deviations is not None:
            return self.deviations
        return np.full((len(self), 2, 6), np.nan, np.float32)

    @classmethod
    def empty(cls) -> Pairs:
        """Return no pairs."""
        return cls.of(Trajectory.empty(), Trajectory.empty())


def _deviations(covariances: np.ndarray) -> np.ndarray:
    """Return the (N, 2, 6) lower triangles of (N, 2, 3, 3) covariances that are usable."""
    deviations = np.full((*covariances.shape[:2], 6), np.nan, np.float32)
    usable = np.isfinite(covariances).all(axis=(2, 3))
    variances = np.linalg.eigvalsh(covariances[usable])
    usable[usable] = variances[:, 0] > MIN_EIGENVALUE_RATIO * variances[:, 2]
    row, column = np.tril_indices(3)
    deviations[usable] = np.linalg.cholesky(covariances[usable])[:, row, column]
    return deviations


class PairLog:
    """
    The pairs of a run, appended in batches; reading them copies nothing.

    All are kept until :meth:`downsample` is called. ``count`` pairs were appended; from index
    ``first_of_all`` on, none is missing.

    :param capacity: for how many pairs addresses are reserved at once. Memory is used only as
        they are filled; growing in steps would fragment it.
    """

    def __init__(self, capacity: int = 0) -> None:
        self._capacity = min(capacity, MAX_RESERVED_PAIRS)
        self.count = 0
        self.first_of_all = 0
        #: whether orientations of the estimate and of the ground truth say nothing, so that pairs
        #: are returned without them
        self.position_only = (False, False)
        self._kept = 0
        self._stride = 1
        self._pairs = Pairs.empty()

    def __deepcopy__(self, memo: dict[int, Any]) -> PairLog:
        """Return a log that shares its rows with this one, until this one is appended to."""
        return copy.copy(self)

    def append(self, pairs: Pairs) -> None:
        """Add pairs at the end; where they have no rotations, all lose theirs."""
        if not len(pairs):
            return
        if self._kept:
            deviations = self._pairs.deviations
            if deviations is None and pairs.deviations is not None:
                deviations = self._pairs.deviations_or_nan()
            self._pairs = Pairs(
                self._extended(self._pairs.estimate, pairs.estimate),
                self._extended(self._pairs.ground_truth, pairs.ground_truth),
                None
                if deviations is None
                else self._appended(deviations, pairs.deviations_or_nan()),
            )
        else:
            self._pairs = pairs
        self._kept += len(pairs)
        self.count += len(pairs)

    @property
    def dropped(self) -> int:
        """How many pairs are no longer kept."""
        return self.count - self._kept

    def all(self) -> Pairs:
        """Return all pairs that are kept."""
        return self._pairs[: self._kept].without_rotations(*self.position_only)

    def evenly(self) -> Pairs:
        """Return kept pairs that are spread evenly over the run."""
        if self._stride == 1:
            return self.all()
        old = self.first_of_all - self.dropped
        newest = np.arange(self.first_of_all, self.count)
        even = np.flatnonzero(newest % self._stride == 0) + old
        return self.all()[np.concatenate([np.arange(old), even])]

    def since(self, index: int) -> Pairs:
        """Return the pairs from an index of the run on, as far as none is missing."""
        return self.received_since(index).without_rotations(*self.position_only)

    def received_since(self, index: int) -> Pairs:
        """Return the same with orientations as received: they may yet come to say something."""
        return self._pairs[max(index, self.first_of_all) - self.dropped : self._kept]

    def downsample(self, limit: int) -> None:
        """
        Keep no more pairs than a limit.

        Where there are more, the newest limit / 2 of them stay, and of the older ones every k-th,
        evenly over the run and beginning with the first.
        """
        if self._kept <= limit:
            return
        old = self.first_of_all - self.dropped
        index = np.concatenate(
            [self._stride * np.arange(old), np.arange(self.first_of_all, self.count)]
        )
        self.first_of_all = self.count - limit // 2
        while self.first_of_all // self._stride >= max(limit // 4, 1):
            self._stride *= 2
        keep = (index >= self.first_of_all) | (index % self._stride == 0)
        self._pairs = self._pairs[: self._kept][keep]
        self._kept = len(self._pairs)

    def _extended(self, trajectory: Trajectory, new: Trajectory) -> Trajectory:
        return Trajectory(
            self._appended(trajectory.stamps_ns, new.stamps_ns),
            self._appended(trajectory.positions, new.positions),
            self._appended(trajectory.rotations, new.rotations),
            weights=self._appended(trajectory.weights, new.weights),
        )

    def _appended(self, column: Any, new: np.ndarray | None) -> Any:
        """Return the column and the new rows, in a buffer that doubles when it is full."""
        if column is None or new is None:
            return None
        end = self._kept + len(new)
        if end > len(column):
            rows = max(end, 2 * len(column), self._capacity)
            bigger = np.empty((rows, *column.shape[1:]), column.dtype)
            bigger[: self._kept] = column[: self._kept]
            column = bigger
        column[self._kept : end] = new
        return column
