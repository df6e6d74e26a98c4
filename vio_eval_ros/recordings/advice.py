"""How to state the columns of a file, for messages: what to append to its path."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vio_eval_ros.recordings.columns import Column, LEFT_OUT, POSITION, QUATERNION, ROLES, USUAL
from vio_eval_ros.recordings.headerless import unit_windows, used_columns
from vio_eval_ros.recordings.text import TextFile

CONVENTION = 't,x,y,z,qx,qy,qz,qw'
#: names that a message lists, and characters of each that it shows
MOST_LISTED, LONGEST_SHOWN = 12, 60
#: by how much the length of a quaternion may differ from one, and in which share of rows more
UNIT_NORM, MOST_WRONG = 0.01, 0.5
ANGLES = 't,x,y,z,roll_rad,pitch_rad,yaw_rad'


def listed(file: TextFile) -> str:
    """Return the names in a header, not too many of them."""
    names = file.names or ()
    return ', '.join(map(shown, names[:MOST_LISTED])) + ', ...' * (len(names) > MOST_LISTED)


def shown(name: str) -> str:
    """Return a name as messages show it, cut off where it is long."""
    return name[:LONGEST_SHOWN] + '...' * (len(name) > LONGEST_SHOWN) or "''"


def numbers(columns: Sequence[int]) -> str:
    return ' '.join(str(column + 1) for column in columns)


def statement_of(columns: Sequence[Column], left_out: int | None = None) -> str:
    """Return how to state columns, without one of them."""
    roles = [USUAL.get(column.role, column.role) for column in columns]
    if left_out is not None:
        roles[left_out] = LEFT_OUT
    text = ','.join(
        f'{role}_{column.unit}' if column.unit and column.unit in ROLES.get(role, ()) else role
        for role, column in zip(roles, columns, strict=True)
    )
    return f': append ?columns={text.rstrip(f",{LEFT_OUT}")}'


def advice(file: TextFile) -> str:
    """Return what to state of columns that are not recognised, by what their values may be."""
    windows = unit_windows(file)
    used = used_columns(file)
    for window in windows:
        columns = [Column(LEFT_OUT)] * file.rows.values.shape[1]
        others = [k for k in used if k not in window]
        before = [k for k in others[1:] if k < window[0]][-3:]
        place = before if len(before) == 3 else [k for k in others[1:] if k > window[0]][:3]
        if len(place) < 3:
            continue
        roles = zip([others[0], *place, *window], ('t', *POSITION, *QUATERNION), strict=True)
        for k, role in roles:
            columns[k] = Column(role)
        return (
            f'; columns {numbers(window)} have unit length, as a quaternion has'
            f'{statement_of(columns)} (or qw,qx,qy,qz in place of qx,qy,qz,qw)'
        )
    if len(used) == len(ANGLES.split(',')):
        return (
            f'; if they are stamp, position and angles, append ?columns={ANGLES} (or _deg for '
            '_rad, and in the order that they have)'
        )
    return (
        f'; say what each column is, such as ?columns={CONVENTION} (roll,pitch,yaw and r11 to '
        'r33 are known, too; _ for a column to leave out)'
    )


def why_not_tum(file: TextFile) -> str:
    """Return why eight columns are no TUM file after all; empty where they are something else."""
    values = file.rows.values
    if values.shape[1] != 8 or not len(values):
        return ''
    norms = np.linalg.norm(values[:, 4:], axis=1)
    wrong = np.flatnonzero(~(np.abs(norms - 1) <= UNIT_NORM))
    if 0 < len(wrong) <= MOST_WRONG * len(values):
        first = ' '.join(f'{value:g}' for value in values[wrong[0], 1:])
        return (
            f'the quaternions in columns 5 to 8 are not of unit length in {len(wrong)} of '
            f'{len(values)} rows, the first in row {wrong[0] + 1}: {first}; where there is no '
            'pose, write none'
        )
    steps = np.diff(values[:, 0])
    if not len(wrong) and (steps < 0).any():
        how = (
            'fall from the first row to the last'
            if (steps <= 0).all()
            else f'go back in {np.count_nonzero(steps < 0)} of {len(steps)} rows'
        )
        return (
            f'the stamps in column 1 {how}; sort the rows by their stamps, or if they are meant '
            f'so, append ?columns={CONVENTION}'
        )
    return ''
