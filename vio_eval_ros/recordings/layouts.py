"""
Which column of a text file is what: TUM, EuRoC csv and KITTI.

A further layout is a test that recognises it, a function from its rows to poses, and a line in
:data:`READERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.motion_capture import poses_of_export
from vio_eval_ros.recordings.text import read_text, TextFile

QUATERNION_COLUMNS = {'xyzw': [4, 5, 6, 7], 'wxyz': [5, 6, 7, 4]}


class Reading(NamedTuple):
    """
    One way to read a file whose layout leaves something open.

    :param statement: what settles it, as it is appended to a spec: 'quaternion=wxyz'.
    :param poses: what the file holds, read so.
    :param usual: whether this is the rule of the layout, which holds where nothing shows
        otherwise. Without a rule, and where the other side does not settle it, the user is asked.
    """

    statement: str
    poses: Poses
    usual: bool = False


def poses_of(
    file: TextFile, times: Path | None, statements: dict[str, str], notes: list[str]
) -> tuple[str, list[Reading]]:
    """
    Return the kind of a text file and all ways to read its poses, the likeliest first.

    :param times: a file of stamps beside it, for KITTI poses.
    :param statements: what the user stated of it.
    :param notes: takes a sentence for whatever was taken for granted.
    :raises ReadError: no layout that is known.
    """
    if 'body' in statements and file.export is None:
        raise ConfigError(
            f'{file.path}: body chooses one in an export of motion capture, which this is not'
        )
    for kind, reader in READERS.items():
        if reader.recognises(file, times):
            return kind, reader.read(file, times, statements, notes)
    raise ReadError(
        file.path,
        f'has {file.rows.values.shape[1]} columns; a trajectory has 8: stamp x y z qx qy qz qw',
    )


def _is_euroc(file: TextFile) -> bool:
    """Return whether a file is EuRoC's by its name or header; it has stamps [ns] and w first."""
    return file.path.name == 'data.csv' or bool(
        re.match(rb'#timestamp(kf)?( \[ns\])?,', _names(file))
    )


def _names(file: TextFile) -> bytes:
    """Return the header with the names of columns as everybody spells them."""
    return file.header.lower().replace(b'_', b'')


def _named_order(file: TextFile) -> str | None:
    """Return the order of quaternions that the header names, if it does."""
    w, x = (re.search(rb'\bq(rs)?%c\b' % letter, _names(file)) for letter in b'wx')
    return None if not w or not x else 'wxyz' if w.start() < x.start() else 'xyzw'


def _are_euroc(file: TextFile, times: Path | None) -> bool:
    """Return whether rows are EuRoC's: a stamp and a pose, or a position only."""
    columns = file.rows.values.shape[1]
    return _is_euroc(file) and (columns >= 8 or columns == 4)


def _euroc(
    file: TextFile, times: Path | None, statements: dict[str, str], notes: list[str]
) -> list[Reading]:
    """Return the poses of EuRoC's rows: nanoseconds, quaternions w x y z."""
    is_seconds = file.rows.likely_unit == 's' and file.rows.decimals.any()
    unit = _unit(file, 's' if is_seconds else 'ns', 'ns', statements, notes)
    order = statements.get('quaternion') or _named_order(file) or 'wxyz'
    return [Reading('', _stamped(file, unit, order))]


def _are_tum(file: TextFile, times: Path | None) -> bool:
    """Return whether rows have at least the columns of TUM's: stamp x y z qx qy qz qw."""
    return not _is_euroc(file) and file.rows.values.shape[1] >= 8


def _tum(
    file: TextFile, times: Path | None, statements: dict[str, str], notes: list[str]
) -> list[Reading]:
    """Return the poses of TUM's rows: seconds, quaternions x y z w."""
    unit = _unit(file, file.rows.likely_unit, 's', statements, notes)
    order = statements.get('quaternion') or _named_order(file)
    orders = (order,) if order else ('xyzw', 'wxyz')
    # files with commas or nanoseconds are called TUM's as well, and come in both orders
    is_tum = not file.has_commas and unit != 'ns'
    return [
        Reading(f'quaternion={one}', _stamped(file, unit, one), is_tum and one == 'xyzw')
        for one in orders
    ]


def _unit(
    file: TextFile, likely: str, usual: str, statements: dict[str, str], notes: list[str]
) -> str:
    """Return the unit of stamps: as stated, else as likely; note where that is not the usual."""
    if 'stamps' in statements:
        return statements['stamps']
    if likely != usual:
        notes.append(f'{file.path}: stamps are read as {likely}, not {usual}, by their size')
    return likely


def _stamped(file: TextFile, unit: str, order: str) -> Poses:
    """Return the poses of rows that begin with a stamp and a position."""
    values = file.rows.values
    stamps_ns = file.rows.nanoseconds(file.path, unit)
    if values.shape[1] == 4:
        return Poses(stamps_ns, values[:, 1:4])
    return Poses(stamps_ns, values[:, 1:4].copy(), values[:, QUATERNION_COLUMNS[order]])


def _are_matrices(file: TextFile, times: Path | None) -> bool:
    """Return whether rows of 12 numbers are KITTI's 3x4 matrices, as the first one shows."""
    values = file.rows.values
    if values.shape[1] != 12:
        return False
    matrix = values[0].reshape(3, 4)[:, :3]
    return times is not None or bool(np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-3))


def _matrices(
    file: TextFile, times: Path | None, statements: dict[str, str], notes: list[str]
) -> list[Reading]:
    """Return the poses of rows of 3x4 matrices, with stamps [s] from another file."""
    if times is None:
        raise ReadError(
            file.path, 'these are KITTI poses; give the file of their stamps with --times'
        )
    file_of_times = read_text(times)
    stamps = file_of_times.rows
    notes += file_of_times.notes
    values = file.rows.values
    if len(stamps.values) != len(values):
        raise ReadError(
            times, f'{len(stamps.values)} stamps for {len(values)} poses in {file.path}'
        )
    matrices = values.reshape(-1, 3, 4).copy()
    matrices[~np.isfinite(stamps.values[:, 0]), :, 3] = np.nan  # to be dropped, and counted
    rotations = rotation.from_matrix(matrices[:, :, :3])
    poses = Poses(stamps.nanoseconds(times, 's'), matrices[:, :, 3], rotations)
    return [Reading('', poses)]


class Reader(NamedTuple):
    """
    How a kind of text file becomes poses.

    :param recognises: whether a file, perhaps with a file of stamps beside it, is of this kind.
    :param read: the poses, given also what was stated of it; notes what was taken for granted.
    """

    recognises: Callable[[TextFile, Path | None], bool]
    read: Callable[[TextFile, Path | None, dict[str, str], list[str]], list[Reading]]


def _is_export(file: TextFile, times: Path | None) -> bool:
    """Return whether a motion capture system exported the file."""
    return file.export is not None


def _export(
    file: TextFile, times: Path | None, statements: dict[str, str], notes: list[str]
) -> list[Reading]:
    """Return the poses of one body of an export."""
    assert file.export is not None
    poses = poses_of_export(file.path, file.export, file.rows.values, statements, notes)
    return [Reading('', poses)]


READERS = {
    'motion capture': Reader(_is_export, _export),
    'kitti': Reader(_are_matrices, _matrices),
    'euroc': Reader(_are_euroc, _euroc),
    'tum': Reader(_are_tum, _tum),
}
