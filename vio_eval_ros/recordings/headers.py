"""The columns that the header of a text file names, and what of them is missing or there twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
import re

import numpy as np

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.advice import advice, CONVENTION, listed, shown, statement_of
from vio_eval_ros.recordings.columns import (
    are_north_east_down,
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
    QUATERNION,
    ROTATION_VECTOR,
    STAMPS,
)
from vio_eval_ros.recordings.headerless import unit_windows, used_columns
from vio_eval_ros.recordings.rows import per_second
from vio_eval_ros.recordings.text import TextFile

#: of the steps between stamps, the share that goes up
RISING_SHARE = 0.9
#: how far apart [s] two columns of times are that are of one clock, and may both be meant
LEAST_APART_S, MOST_APART_S = 1e-3, 100.0
#: of the parts of a name
LONGEST_PREFIX = 6
#: columns in the statements of one message
MOST_STATED = 600
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
    if are_north_east_down(names):
        notes.append(
            f'{file.path}: poses are in north, east, down, of a body in forward, right, down; if '
            'the other source has z up, turn the body with --estimate-to-body 0 0 0 1 0 0 0 (or '
            '--ground-truth-to-body)'
        )
    notes += _other_times(file, columns)
    return columns


def _other_times(file: TextFile, columns: Sequence[Column]) -> Iterator[str]:
    """Yield what is left out of times beside the stamps, on the same clock but not the same."""
    stamp = next((k for k, column in enumerate(columns) if column.role == 't'), None)
    names, values = file.names or (), file.rows.values
    if stamp not in file.rows.exact or len(names) != len(columns):
        return
    scale = per_second(columns[stamp].unit or file.rows.exact[stamp].likely_unit)
    for place, name in enumerate(names):
        # of those that are known, the one that is meant has been taken
        is_known = named_columns([name])[0].role != LEFT_OUT
        if is_known or not re.search('time|stamp', name.lower()):
            continue
        between = values[:, place] - values[:, stamp]
        apart_s = abs(float(np.median(between))) / scale
        if LEAST_APART_S < apart_s < MOST_APART_S:
            yield (
                f'{file.path}: stamps are those of column {shown(names[stamp])}; those of '
                f'{shown(name)}, {apart_s:.3g} s apart, are left out; to take them, state the '
                'columns with ?columns='
            )


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
            _check_one_pose(file, columns)
            names = file.names or ()
            both = ' and '.join(
                f'{k + 1} ({shown(names[k])})' for k in (found[column.role], place)
            )
            raise ReadError(
                file.path,
                f'columns {both} may both be {column.role}; '
                + (
                    f'state which is meant{statement_of(columns, found[column.role])}'
                    if _is_only_repeated(columns, column.role)
                    else f'say what each column is, such as ?columns={CONVENTION}'
                ),
            )
        found.setdefault(column.role, place)
    return columns


def _check_one_pose(file: TextFile, columns: Sequence[Column]) -> None:
    """Refuse a file whose columns are several poses, by what their names begin with."""
    for depth in range(1, LONGEST_PREFIX):
        groups: dict[str, list[int]] = {}
        for place, name in enumerate(file.names or ()):
            if columns[place].role not in (LEFT_OUT, 'frame'):
                parts = re.split(r'(?<=[^/._])[/._]', name.strip())
                prefix = name[: sum(len(part) + 1 for part in parts[:depth]) - 1]
                groups.setdefault(prefix, []).append(place)
        roles = {key: [columns[k].role for k in places] for key, places in groups.items()}
        poses = [key for key, found in roles.items() if {*POSITION} <= {*found}]
        if not poses or any(len({*found}) < len(found) for found in roles.values()):
            continue
        stamps = [k for k, c in enumerate(columns) if c.role in STAMPS]
        bodies = [key for key, found in roles.items() if {*found} - {*STAMPS}]
        shared = [k for k in stamps if not any(k in groups[key] for key in poses)]
        ways, most = [], max(1, MOST_STATED // len(columns))
        for key in poses[:most]:
            own = [k for k in stamps if k in groups[key]]
            kept = {*groups[key], *([] if own else shared)}
            meant = [c if k in kept else Column(LEFT_OUT) for k, c in enumerate(columns)]
            ways.append(f'{statement_of(meant).removeprefix(": append ")} for {shown(key)}')
        more = [f'{len(bodies) - most} more'] if len(bodies) > most else []
        named = ', '.join([*map(shown, bodies[:most]), *more])
        raise ReadError(
            file.path,
            f'its header names columns of several bodies ({named}); append {" or ".join(ways)}',
        )


def _check_one_topic(
    file: TextFile, columns: Sequence[Column], orientation: Sequence[str]
) -> None:
    """Refuse names of topics, as /odom/pose/position/x, whose position and orientation differ."""
    at, names = places(columns), file.names or ()
    if len(names) < len(columns):  # vectors, by one name each
        return
    used = [[names[at[role]] for role in roles if role in at] for roles in (POSITION, orientation)]
    topics = [
        {name.split('/')[1] for name in each if name.startswith('/') and name.count('/') > 1}
        for each in used
    ]
    if len(topics[0] | topics[1]) > 1:
        raise ReadError(
            file.path,
            'its header names a pose of which parts are of several topics '
            f'({", ".join(sorted(topics[0] | topics[1]))}); if that is meant, append '
            f'{statement_of(columns).removeprefix(": append ")}',
        )


def stamp_advice(file: TextFile, columns: Sequence[Column]) -> str:
    """Return what to state where no name is that of a stamp, but of a position."""
    values = file.rows.values
    at = places(columns)
    free = (k for k in used_columns(file) if columns[k].role == LEFT_OUT)
    stamp = next((k for k in free if (np.diff(values[:, k]) > 0).mean() > RISING_SHARE), None)
    if stamp is None or not {*POSITION} <= at.keys():
        return advice(file)
    meant = [Column('t') if k == stamp else column for k, column in enumerate(columns)]
    return f'; if column {stamp + 1} is the stamp{statement_of(meant).replace(":", ",", 1)}'


def _is_only_repeated(columns: Sequence[Column], role: str) -> bool:
    """Return whether a role is the only one that columns have twice, and they have it twice."""
    counts = Counter(column.role for column in columns if column.role != LEFT_OUT)
    return [one for one, count in counts.items() if count > 1] == [role] and counts[role] == 2


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
    _check_one_topic(file, columns, whole or ())
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
