"""
Whether the orientations of a stream say anything.

Prisms, GNSS and total stations are often written as poses, with orientations that are all the
same, of length zero or not a number. Such a stream carries positions only.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from vio_eval_ros.core.rotation import lengths
from vio_eval_ros.core.trajectory import Poses

Columns = TypeVar('Columns', bound=Poses)

MIN_QUATERNION_NORM = 1e-6
#: larger numbers overflow where they are squared
LARGEST_NUMBER = 1e100
#: far below what any sensor resolves, far above what rounding adds
SAME_ROTATION = 1e-9
MOVED_M = 1e-6

UNUSABLE = 'no orientation is usable (quaternions of length zero or not a number)'
CONSTANT = 'the orientation is the same in every pose, while the position moves'


def finite(column: np.ndarray) -> np.ndarray:
    """Return (N,) whether all numbers of each row are finite, and so are their squares."""
    # nearly always all are, which is faster to find out at once than for each row
    if np.abs(column).max(initial=0) < LARGEST_NUMBER:
        return np.ones(len(column), bool)
    return np.asarray((np.abs(column) < LARGEST_NUMBER).all(axis=1))


def usable(rotations: np.ndarray | None) -> np.ndarray:
    """Return (N,) whether each quaternion is finite and not of length zero."""
    assert rotations is not None
    is_finite = finite(rotations)
    return is_finite & (lengths(np.where(is_finite[:, None], rotations, 0)) >= MIN_QUATERNION_NORM)


class Orientations:
    """What the orientations of a stream, which arrives in batches, are so far."""

    def __init__(self) -> None:
        self._first: np.ndarray | None = None
        self._low = np.full(3, np.inf)
        self._high = -self._low
        self._turns = False

    def add(self, poses: Poses) -> None:
        """Take in finite poses with unit quaternions, or with none."""
        if self._turns or poses.rotations is None or not len(poses):
            return
        if self._first is None:
            self._first = poses.rotations[0]
        self._turns = not _same(poses.rotations, self._first)
        self._low = np.minimum(self._low, poses.positions.min(axis=0))
        self._high = np.maximum(self._high, poses.positions.max(axis=0))

    @property
    def constant(self) -> bool:
        """Whether all are the same though the position moves, so that they say nothing."""
        if self._first is None or self._turns:
            return False
        return bool((self._high - self._low).max() > MOVED_M)


def _same(rotations: np.ndarray, first: np.ndarray) -> bool:
    """Return whether (N, 4) unit quaternions are all the same rotation as another."""
    off = np.minimum(np.abs(rotations - first), np.abs(rotations + first))
    return bool(off.max(initial=0) <= SAME_ROTATION)


def some_usable(poses: Poses) -> bool:
    """Return whether some pose with a finite position has a usable orientation."""
    if poses.rotations is None:
        return False
    # nearly always the first one has, which is faster to find out than for each row
    return any(
        bool((finite(some.positions) & usable(some.rotations)).any())
        for some in (poses[:1], poses)
    )


def why_positions_only(poses: Poses) -> str:
    """
    Return why the orientations of a whole stream say nothing; empty where they do.

    :param poses: as received; empty as well where they have no orientations to begin with.
    """
    if poses.rotations is None:
        return ''
    placed = finite(poses.positions)
    oriented = placed & usable(poses.rotations)
    if not oriented.any():
        return UNUSABLE if placed.any() else ''
    rotations = poses.rotations[oriented]
    unit = rotations / lengths(rotations)[:, None]
    orientations = Orientations()
    orientations.add(Poses(poses.stamps_ns[oriented], poses.positions[oriented], unit))
    return CONSTANT if orientations.constant else ''


def with_known_orientations(poses: Columns) -> Columns:
    """Return a whole stream, as received, without orientations where these say nothing."""
    return replace(poses, rotations=None) if why_positions_only(poses) else poses
