"""
Orientations in columns of numbers, and whether they are orientations at all.

Quaternions have unit length and rotation matrices orthonormal rows. Numbers that do not are
something else: the columns were taken for what they are not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation

#: the share of rows that must be orientations; of the rest, some numbers are damaged
LEAST_SHARE = 0.99
#: how far the length of a quaternion, or of a row of a matrix, may be from 1: two decimals suffice
TOLERANCE = 0.015
MIN_SCALE = 1e-6
#: a pitch [rad] is not larger, with some room for rounding
QUARTER_RAD = 1.05 * np.pi / 2
#: of a turn, the least jump of an angle that begins anew
WRAPPED = 0.9


def take(values: np.ndarray, columns: Sequence[int]) -> np.ndarray:
    """Return some columns, those that are side by side without a copy."""
    first, count = columns[0], len(columns)
    if list(columns) == list(range(first, first + count)):
        return values[:, first : first + count]
    return values[:, list(columns)]


def share_of_unit(quaternions: np.ndarray) -> float:
    """
    Return the share of (N, 4) rows with unit length, of those that are finite and not all zero.

    NaN where none is: all zero says that there is no orientation.
    """
    squares = np.einsum('ij,ij->i', quaternions, quaternions)
    if (np.abs(squares - 1) <= TOLERANCE).all():  # what most files have
        return 1.0
    known = np.isfinite(squares) & (squares > 0)
    if not known.any():
        return float('nan')
    unit = np.abs(np.sqrt(squares[known]) - 1) <= TOLERANCE
    return float(np.count_nonzero(unit) / len(unit))


def are_unit(quaternions: np.ndarray) -> bool:
    """Return whether (N, 4) rows have unit length, as far as they say anything."""
    return not share_of_unit(quaternions) < LEAST_SHARE


class Matrices(NamedTuple):
    """
    What (N, 3, 3) matrices are.

    :param share: of the rows that are finite, how many are rotations but for the scale.
    :param scale: the median length of their columns, 1 of rotations.
    :param mirrored: the share with a negative determinant.
    """

    share: float
    scale: float
    mirrored: float

    @classmethod
    def of(cls, matrices: np.ndarray) -> Matrices:
        """Return what matrices are; the share is NaN where none is finite."""
        known = matrices[np.isfinite(matrices).all(axis=(1, 2))]
        if not len(known):
            return cls(float('nan'), 1.0, 0.0)
        products = known @ known.transpose(0, 2, 1)
        squares = np.trace(products, axis1=1, axis2=2) / 3
        scale = float(np.sqrt(np.median(squares)))
        if scale < MIN_SCALE:
            return cls(0.0, scale, 0.0)
        # of lengths 1 + e the squares are 1 + 2 e
        away = np.abs(products / scale**2 - np.eye(3)).max(axis=(1, 2))
        determinants = np.linalg.det(known / scale)
        similar = (away <= 2 * TOLERANCE) & (determinants > 0)
        return cls(float(similar.mean()), scale, float((determinants < 0).mean()))

    @property
    def are_rotations(self) -> bool:
        """Whether they are rotations but for one scale, as far as they say anything."""
        return not self.share < LEAST_SHARE

    @property
    def has_scale(self) -> bool:
        """Whether all of them are larger or smaller than rotations."""
        return abs(self.scale - 1) > TOLERANCE


def from_euler(angles: np.ndarray) -> np.ndarray:
    """
    Return the quaternions of (N, 3) roll, pitch and yaw [rad] about fixed axes, as in ROS.

    R = Rz(yaw) Ry(pitch) Rx(roll), REP 103.
    """
    turns = [rotation.from_rotation_vector(angles[:, k : k + 1] * np.eye(3)[k]) for k in range(3)]
    return rotation.multiply(turns[2], rotation.multiply(turns[1], turns[0]))


def unit_of_angles(angles: np.ndarray) -> str | None:
    """
    Return the unit of (N, 3) roll, pitch and yaw where their range shows it: 'deg' or 'rad'.

    Angles that begin anew jump by a whole turn, and a pitch is not beyond a quarter of one. Large
    angles alone show nothing: they may count turns.
    """
    known = angles[np.isfinite(angles).all(axis=1)]
    if not len(known):
        return None
    for unit, turn in (('deg', 360.0), ('rad', 2 * np.pi)):
        jumps = np.abs(np.diff(known, axis=0)) > WRAPPED * turn
        if jumps.any() and (np.ptp(known, axis=0) <= 1.001 * turn).all():
            return unit
    return 'deg' if np.abs(known[:, 1]).max() > QUARTER_RAD else None
