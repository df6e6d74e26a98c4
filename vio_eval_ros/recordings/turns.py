"""The ways to read the orientations in the columns of a text file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.advice import advice, MOST_LISTED, numbers, shown, statement_of
from vio_eval_ros.recordings.columns import (
    Column,
    COUNTED_QUATERNION,
    EULER,
    Layout,
    LEFT_OUT,
    MATRIX,
    OPEN_QUATERNION,
    OPEN_TURN,
    ORIENTATIONS,
    POSITION,
    QUATERNION,
    ROTATION_VECTOR,
    sounds_like_a_turn,
)
from vio_eval_ros.recordings.rotation_columns import (
    from_euler,
    LEAST_SHARE,
    Matrices,
    share_of_unit,
    take,
    unit_of_angles,
)
from vio_eval_ros.recordings.text import TextFile


class Turns(NamedTuple):
    """
    One way to read orientations.

    :param statement: what settles it, as it is appended to a spec.
    :param rotations: (N, 4) quaternions x y z w; None where there are none.
    :param usual: whether it holds where nothing shows otherwise.
    :param order: of a quaternion, as its columns stand: 'wxyz' for example; else empty.
    """

    statement: str
    rotations: np.ndarray | None
    usual: bool = False
    order: str = ''


def turns_of(
    file: TextFile, layout: Layout, statements: dict[str, str], notes: list[str]
) -> list[Turns]:
    """
    Return the ways to read the orientations of a file, the usual one first.

    :raises ReadError: they are no orientations.
    """
    roles = next((one for one in ORIENTATIONS if layout.places(one)), None)
    if roles and layout.places(POSITION) is None:
        if roles == EULER:
            notes.append(
                f'{file.path}: roll, pitch and yaw beside latitude and longitude are left out, '
                'since it is not known whether they count from north or from east'
            )
            return [Turns('', None)]
        notes.append(f'{file.path}: orientations are read as those in east, north, up')
    if roles is None:
        partial = [role for role in EULER if layout.places([role])]
        if partial:
            notes.append(
                f'{file.path}: {layout.source} has {", ".join(partial)} only; the positions are '
                'used, and no orientations'
            )
        _note_unused(file, layout, notes)
        return [Turns('', None)]
    columns = layout.places(roles) or []
    if roles in (QUATERNION, OPEN_QUATERNION, COUNTED_QUATERNION):
        return _from_quaternions(file, layout, columns, roles)
    if roles == MATRIX:
        rotations = _from_matrices(file, layout, columns, notes)
        side_by_side = columns == list(range(columns[0], columns[0] + 9))
        if layout.is_recognised and side_by_side and 'invert' not in statements:
            # nine cells side by side may be written by rows or by columns
            return [
                Turns(statement_of(layout.columns).removeprefix(': append ?'), rotations, True),
                Turns('invert=rotation', rotation.conjugate(rotations)),
            ]
        return [Turns('', rotations)]
    return _from_angles(file, layout, columns, roles, notes)


def _note_unused(file: TextFile, layout: Layout, notes: list[str]) -> None:
    """Note the names of columns that look like those of an orientation, but are not known."""
    unused = [
        name
        for name, column in zip(file.names or (), layout.columns, strict=False)
        if column.role == LEFT_OUT and sounds_like_a_turn(name)
    ]
    if unused:
        names = ', '.join(map(shown, unused[:MOST_LISTED]))
        notes.append(
            f'{file.path}: positions only; what its columns {names} are is not known, '
            'and they are left out; if they are an orientation, state the columns, such as '
            '?columns=t,x,y,z,roll_deg,pitch_deg,yaw_deg'
        )


def _from_quaternions(
    file: TextFile, layout: Layout, columns: list[int], roles: Sequence[str]
) -> list[Turns]:
    """Return the ways to read quaternions, whose order may be open."""
    values = file.rows.values
    quaternions = take(values, sorted(columns) if roles == QUATERNION else columns)
    share = share_of_unit(quaternions)
    if share < LEAST_SHARE:
        raise ReadError(
            file.path,
            f'the quaternion that {layout.source} has in columns {numbers(columns)} has no '
            f'unit length in {100 * (1 - share):.0f} % of the rows, so it is none{advice(file)}',
        )
    if roles == QUATERNION:
        order = ''.join(role[-1] for _, role in sorted(zip(columns, roles, strict=True)))
        return [Turns('', values.take(columns, axis=1), order=order)]
    # both orders are views of one array
    twice = np.concatenate([quaternions, quaternions[:, :1]], axis=1)
    ways = [
        Turns('quaternion=xyzw', twice[:, :4], order='xyzw'),
        Turns('quaternion=wxyz', twice[:, 1:], order='wxyz'),
    ]
    if roles == COUNTED_QUATERNION:  # q0 is the real part as a rule
        return [ways[1]._replace(usual=True), ways[0]]
    return ways


def _from_matrices(
    file: TextFile, layout: Layout, columns: list[int], notes: list[str]
) -> np.ndarray:
    """Return the quaternions of rotation matrices; a scale in all of them is taken out."""
    matrices = take(file.rows.values, columns).reshape(-1, 3, 3)
    found = Matrices.of(matrices)
    if not found.are_rotations:
        why = 'their determinant is -1, they mirror' if found.mirrored > 0.5 else 'not orthonormal'
        raise ReadError(
            file.path,
            f'the matrices that {layout.source} has in columns {numbers(columns)} are not '
            f'rotations ({why}){advice(file)}',
        )
    if found.has_scale:
        notes.append(
            f'{file.path}: its rotation matrices have a scale of {found.scale:.4g}, as those of a '
            'similarity; it is taken out of them, and the positions are left as they are'
        )
        matrices = matrices / found.scale
    return rotation.from_matrix(matrices)


def _from_angles(
    file: TextFile,
    layout: Layout,
    columns: list[int],
    roles: Sequence[str],
    notes: list[str],
) -> list[Turns]:
    """Return the ways to read three angles: roll, pitch and yaw, or a rotation vector."""
    angles = take(file.rows.values, columns)
    angles = np.where(np.isfinite(angles), angles, np.nan)  # the sine of inf is none
    unit = layout.columns[columns[0]].unit
    if unit not in ('rad', 'deg', None):
        raise ReadError(
            file.path, f"its header has angles in '{unit}', which is not known (rad, deg)"
        )
    kinds = (EULER, ROTATION_VECTOR) if roles == OPEN_TURN else (roles,)
    shown = unit_of_angles(angles) if unit is None and kinds == (EULER,) else None
    if shown:
        notes.append(
            f'{file.path}: angles are read as {"degrees" if shown == "deg" else "radians"}, as '
            'their range shows'
        )
    usual = unit or shown
    units = [unit] if unit else ['deg', 'rad'] if shown == 'deg' else ['rad', 'deg']
    is_open = len(kinds) * len(units) > 1
    turns = []
    for kind in kinds:
        convert = rotation.from_rotation_vector if kind == ROTATION_VECTOR else from_euler
        stated_as = dict(zip(columns, kind, strict=True))
        for one in units:
            stated = [
                Column(stated_as[k], one) if k in stated_as else column
                for k, column in enumerate(layout.columns)
            ]
            text = statement_of(stated).removeprefix(': append ?') if is_open else ''
            turn = convert(np.deg2rad(angles) if one == 'deg' else angles)
            turns.append(Turns(text, turn, usual=len(kinds) == 1 and one == usual))
    return turns
