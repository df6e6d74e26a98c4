"""Poses of a rigid body in the export of a motion capture system."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.preambles import Body, Export
from vio_eval_ros.recordings.spec import quoted

MAX_DEVIATION = 0.01  # of the rows of a matrix from unit length, where three decimals are written
MIN_SHARE = 0.99
LATEST = 1e9  # frames, or seconds from the start of a recording
#: what a preamble says already
SETTLED = ('quaternion', 'stamps', 'columns')


def poses_of_export(
    path: Path, export: Export, values: np.ndarray, statements: dict[str, str], notes: list[str]
) -> Poses:
    """
    Return the poses of one body.

    :param values: (N, C) the rows.
    :param statements: of these ``body`` chooses one by name, and ``unit`` is applied later on.
    :param notes: takes a sentence for whatever was taken for granted.
    :raises ReadError: it cannot be told which body, or its numbers are no poses.
    """
    for name in SETTLED:
        if name in statements:
            raise ConfigError(
                f'{path}: {name} does not apply to an export of {export.system}, which says it'
            )
    body = _chosen(path, export, statements.get('body'))
    if max(body.position + body.orientation) >= values.shape[1]:
        raise ReadError(path, f'its rows have {values.shape[1]} columns, its header has more')
    positions = values[:, body.position]
    if 'unit' not in statements:
        if export.metres is None:
            raise ReadError(path, 'the unit of its positions is unknown; append ?unit=mm or m')
        positions = positions * export.metres
    turns = values[:, body.orientation] if body.orientation else None
    hidden = _hidden(positions, turns)
    positions[hidden] = np.nan
    notes += (f'{path}: {note}' for note in export.notes)
    if hidden.any():
        notes.append(
            f"{path}: '{body.name}' was not seen in {hidden.sum():,} of {len(hidden):,} frames"
        )
    rotations = None
    if turns is not None and not hidden.all():
        rotations = _rotations(path, np.where(hidden[:, None], np.nan, turns), export.degrees)
    return Poses(_stamps(path, export, values, notes), positions, rotations)


def _chosen(path: Path, export: Export, name: str | None) -> Body:
    """Return the body of that name, or the only one."""
    names = [body.name for body in export.bodies]
    if not names:
        raise ReadError(path, f'this export of {export.system} has no positions')
    if name is None:
        if len(names) > 1:
            shown = ', '.join(names[:8]) + ', ...' * (len(names) > 8)
            raise ReadError(
                path,
                f'it has {len(names)} bodies ({shown}); append ?body={quoted(names[0])} or '
                'another',
            )
        return export.bodies[0]
    if names.count(name) != 1:
        raise ReadError(
            path,
            f"it has {'no' if name not in names else 'more than one'} body '{name}' (there are "
            f'{", ".join(names[:8])}){nearest_name(name, names)}',
        )
    return export.bodies[names.index(name)]


def _hidden(positions: np.ndarray, turns: np.ndarray | None) -> np.ndarray:
    """Return in which frames a body was not seen: systems write nothing, or zeros only."""
    everything = positions if turns is None else np.hstack((positions, turns))
    return ~np.isfinite(everything).all(axis=1) | (everything == 0).all(axis=1)


def _rotations(path: Path, turns: np.ndarray, are_degrees: bool) -> np.ndarray:
    """Return (N, 4) quaternions x y z w of what has 4, 3 or 9 columns; matrices are by columns."""
    if turns.shape[1] == 4:
        return turns
    if turns.shape[1] == 3:
        return rotation.from_rotation_vector(np.radians(turns) if are_degrees else turns)
    matrices = turns.reshape(-1, 3, 3).transpose(0, 2, 1)
    seen = np.isfinite(matrices[:, 0, 0])
    gram = matrices[seen] @ matrices[seen].transpose(0, 2, 1)
    are_right = np.abs(gram - np.eye(3)).max(axis=(1, 2)) < MAX_DEVIATION
    are_right &= np.linalg.det(matrices[seen]) > 0
    if are_right.mean() < MIN_SHARE:
        raise ReadError(path, 'its rotation matrices are not orthonormal')
    quaternions = np.full((len(matrices), 4), np.nan)
    quaternions[seen] = rotation.from_matrix(matrices[seen])
    return quaternions


def _stamps(path: Path, export: Export, values: np.ndarray, notes: list[str]) -> np.ndarray:
    """Return (N,) int64 nanoseconds, from the column of times or by the rate."""
    counted = values[:, export.frames if export.time is None else (export.time,)]
    if not (np.abs(counted) < LATEST).all():
        raise ReadError(path, 'some of its rows have no frame or time')
    if export.time is not None:
        seconds = counted[:, 0]
    elif export.rate_hz is None:
        raise ReadError(path, 'its preamble says no frame rate, and its rows have no times')
    else:
        count = np.arange(len(values), dtype=float)
        if export.frames:
            frame, part = counted.T
            count = (frame - 1) * (part.max(initial=0) + 1) + part
        seconds = count / export.rate_hz
        first = 'frame 1' if export.frames else 'the first'
        notes.append(f'{path}: stamps are its frames at {export.rate_hz:g} Hz, {first} at 0 s')
    if np.abs(seconds).max(initial=0) > LATEST:
        raise ReadError(path, 'its frames are too many for its rate')
    stamps: np.ndarray = np.rint(seconds * 1e9).astype(np.int64)
    return stamps
