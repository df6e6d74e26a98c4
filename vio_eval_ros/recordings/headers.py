"""The columns that the header of a text file names, and what of them is missing or there twice."""

from __future__ import annotations

from collections.abc import Sequence

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.advice import advice, listed, statement_of
from vio_eval_ros.recordings.columns import (
    Column,
    COUNTED_QUATERNION,
    expanded,
    GEODETIC,
    LEFT_OUT,
    MATRIX,
    named_columns,
    OPEN_QUATERNION,
    OPEN_TURN,
    ORIENTATIONS,
    places,
    POSITION,
    PX4_NAMES,
    QUATERNION,
    ROTATION_VECTOR,
)
from vio_eval_ros.recordings.headerless import unit_windows, used_columns
from vio_eval_ros.recordings.text import TextFile

#: of an orientation that is named in part, the others are missing
PARTS = (QUATERNION, OPEN_QUATERNION, COUNTED_QUATERNION, MATRIX, ROTATION_VECTOR, OPEN_TURN)


def header_columns(file: TextFile, width: int, notes: list[str]) -> list[Column] | None:
    """Return the columns that a header names; None where it has no names for them."""
    if file.names is None:
        return None
    names = list(file.names)
    if len(names) == width + 1 and file.has_end:
        names.pop()
    columns = named_columns(names)
    if len(names) < width:
        columns = expanded(names, width) or columns
        last = max((k for k, one in enumerate(columns) if one.role != LEFT_OUT), default=0)
        is_gapless = all(one.role != LEFT_OUT for one in columns[: last + 1])
        if (not is_gapless and 'q' not in names) or not {*POSITION} <= places(columns).keys():
            return None if file.header.lstrip().startswith((b'#', b'%')) else _miscounted(file)
        columns += [Column(LEFT_OUT)] * (width - len(columns))
    elif len(names) > width:
        columns = named_columns(names[-width:])
        if any(one.role == LEFT_OUT for one in columns):
            return _miscounted(file)
    if PX4_NAMES.intersection(names):
        notes.append(
            f'{file.path}: as PX4 writes them, poses are in north, east, down, of a body in '
            'forward, right, down; if the other source has z up, turn the body with '
            '--estimate-to-body 0 0 0 1 0 0 0 (or --ground-truth-to-body)'
        )
    return columns


def _miscounted(file: TextFile) -> list[Column] | None:
    """Refuse a file whose header has not the columns of its rows."""
    raise ReadError(
        file.path,
        f'its header names {len(file.names or ())} columns ({listed(file)}), but its rows have '
        f'{file.rows.values.shape[1]}; state the columns{advice(file)}',
    )


def without_repeats(file: TextFile, columns: list[Column]) -> list[Column]:
    """Return columns of which each role is there once; refuse a file in which it is not."""
    used = set(used_columns(file))
    columns = [c if k in used else Column(LEFT_OUT) for k, c in enumerate(columns)]
    roles = [column.role for column in columns]
    if 'sec' in roles and 'nsec' in roles:
        columns = [Column(LEFT_OUT) if c.role == 't' else c for c in columns]
    found: dict[str, int] = {}
    for place, column in enumerate(columns):
        if column.role in found and column.role == 'frame':
            columns[place] = Column(LEFT_OUT)
        elif column.role in found and column.role != LEFT_OUT:
            names = file.names or ()
            both = ' and '.join(f'{k + 1} ({names[k]})' for k in (found[column.role], place))
            raise ReadError(
                file.path,
                f'columns {both} may both be {column.role}; state which is meant'
                f'{statement_of(columns, found[column.role])}',
            )
        found.setdefault(column.role, place)
    return columns


def check_place(file: TextFile, columns: Sequence[Column]) -> None:
    """Check that a header names positions, and orientations wholly or not at all."""
    at = places(columns).keys()
    missing = [role for role in POSITION if role not in at]
    if missing and {'lat', 'lon'} <= at:
        missing = [role for role in GEODETIC if role not in at]
        if missing:
            raise ReadError(
                file.path,
                f'its header names latitude and longitude, but no altitude ({listed(file)}); add '
                'it: without one there are no positions in space',
            )
    if missing:
        what = ', '.join(missing) if len(missing) < len(POSITION) else 'a position'
        raise ReadError(
            file.path,
            f'its header names no column as {what} ({listed(file)}); state the columns'
            f'{advice(file)}',
        )
    whole = next((roles for roles in ORIENTATIONS if at >= set(roles)), None)
    for roles in PARTS:
        missing = [role for role in roles if role not in at]
        if whole is None and 0 < len(missing) < len(roles):
            raise ReadError(
                file.path,
                f'its header names a part of an orientation, but no column as '
                f'{", ".join(missing)} ({listed(file)}); state the columns{advice(file)}',
            )
    if whole is None and unit_windows(file):
        raise ReadError(
            file.path,
            f'its header names no orientation that is known ({listed(file)}); state the columns'
            f'{advice(file)}',
        )
