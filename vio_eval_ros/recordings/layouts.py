"""
Which column of a text file is what, and the poses that follow from it.

Three ways lead to a layout: what the user states (``?columns=``), what the header names
(:mod:`~vio_eval_ros.recordings.columns`), and the well-known files without names
(:mod:`~vio_eval_ros.recordings.headerless`). Whatever it is, orientations must be orientations;
columns that are none were taken for what they are not, and the file is refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
import re
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings import px4
from vio_eval_ros.recordings.advice import advice, listed, numbers, statement_of, why_not_tum
from vio_eval_ros.recordings.bodies import of_one_body
from vio_eval_ros.recordings.columns import (
    Column,
    COUNTED_QUATERNION,
    COVARIANCE,
    GEODETIC,
    HEADER,
    Layout,
    LEFT_OUT,
    MATRIX,
    named_columns,
    OPEN_QUATERNION,
    ORIENTATION_COVARIANCE,
    ORIENTATIONS,
    places,
    POSITION,
    POSITION_COVARIANCE,
    PX4_NAMES,
    QUATERNION,
    STAMPS,
    stated_columns,
    STATEMENT,
)
from vio_eval_ros.recordings.geographic import look_like_degrees, of_columns, Origin
from vio_eval_ros.recordings.headerless import known_layouts, TUM_NAME, why_not_matrices
from vio_eval_ros.recordings.headers import (
    check_place,
    header_columns,
    stamp_advice,
    without_repeats,
)
from vio_eval_ros.recordings.messages import covariance_blocks
from vio_eval_ros.recordings.motion_capture import poses_of_export
from vio_eval_ros.recordings.rotation_columns import take
from vio_eval_ros.recordings.spec import LENGTH_UNITS
from vio_eval_ros.recordings.stamp_columns import read_stamps
from vio_eval_ros.recordings.text import read_text, TextFile
from vio_eval_ros.recordings.turns import turns_of

#: columns behind a pose in which another position has room
LEFT_OUT_NOTED = 3
EXPECTED = 'a trajectory has 8: stamp x y z qx qy qz qw'


class Reading(NamedTuple):
    """
    One way to read a file whose layout leaves something open.

    :param statement: what settles it, as it is appended to a spec: 'quaternion=wxyz'.
    :param poses: what the file holds, read so.
    :param usual: whether this is the rule of the layout, which holds where nothing shows
        otherwise. Without a rule, and where the other side does not settle it, the user is asked.
    :param order: of its quaternions, as their columns stand: 'wxyz' for example; else empty.
    """

    statement: str
    poses: Poses
    usual: bool = False
    order: str = ''


def stated_stamps(statements: Mapping[str, str]) -> tuple[int, ...] | None:
    """Return the columns that are stated to be stamps; None where no columns are stated."""
    if 'columns' not in statements:
        return None
    columns = enumerate(stated_columns(statements['columns']))
    return tuple(place for place, column in columns if column.role in STAMPS)


def poses_of(
    file: TextFile, times: Path | None, statements: dict[str, str], notes: list[str]
) -> tuple[str, list[Reading]]:
    """
    Return the kind of a text file and all ways to read its poses, the likeliest first.

    :param times: a file of stamps beside it, for poses without stamps.
    :param statements: what the user stated of it.
    :param notes: takes a sentence for whatever was taken for granted.
    :raises ReadError: no layout that is known, or columns that are not what it says.
    """
    if file.export is not None:
        poses = poses_of_export(file.path, file.export, file.rows.values, statements, notes)
        return 'motion capture', [Reading('', poses)]
    layout = _layout(file, times, statements, notes)
    file = of_one_body(file, layout, statements)
    stamps_ns = _stamps(file, layout, times, statements, notes)
    values = file.rows.values
    positions, origin = _positions(file, layout, statements, notes)
    own = [k for k, column in enumerate(layout.columns) if column.role in STAMPS]
    positions[~np.isfinite(values[:, own]).all(axis=1)] = np.nan  # to be dropped, and counted
    turns = turns_of(file, layout, statements, notes)
    covariances = _covariances(file, layout, turns[0].rotations)
    readings = [
        Reading(
            turn.statement,
            Poses(stamps_ns, positions, turn.rotations, covariances, origin=origin),
            usual=turn.usual or (turn is turns[0] and _has_rule(file, layout)),
            order=turn.order,
        )
        for turn in turns
    ]
    if layout.source == HEADER and PX4_NAMES.intersection(file.names or ()):
        readings = _upright(file, readings, notes)
    kind = 'euroc' if layout.is_euroc else 'tum'
    return kind if layout.has_stamps else 'kitti', readings


def _upright(file: TextFile, readings: list[Reading], notes: list[str]) -> list[Reading]:
    """Return the readings of a log of PX4 with z up, as its messages are read."""
    values, names = file.rows.values, list(file.names or ())
    has_frame = 'pose_frame' in names and len(names) == values.shape[1]
    frames = values[:, names.index('pose_frame')] if has_frame else np.full(len(values), px4.NED)
    upright, turned = px4.Upright(), []
    for reading in readings:
        poses = reading.poses
        parts = [poses.positions, poses.rotations, np.nan_to_num(frames)]
        up = upright(np.column_stack([part for part in parts if part is not None]))
        rotations = None if poses.rotations is None else up[:, 3:]
        poses = replace(poses, positions=up[:, :3], rotations=rotations, covariances=None)
        turned.append(reading._replace(poses=poses))
    notes += [f'{file.path}: {note}' for note in upright.notes()]
    return turned


def _has_rule(file: TextFile, layout: Layout) -> bool:
    """
    Return whether the quaternions of a file without names are x y z w by a rule.

    It is that of TUM, and of ORB-SLAM, which writes the same columns with nanoseconds. Files with
    commas are called TUM's as well, and come in both orders.
    """
    stamp = file.rows.exact.get(0)
    is_known = stamp is not None and stamp.likely_unit in ('s', 'ns')
    return layout.source == TUM_NAME and is_known and file.separator != ','


def _layout(
    file: TextFile, times: Path | None, statements: dict[str, str], notes: list[str]
) -> Layout:
    """Return the layout that is stated, else named, else known."""
    width = file.rows.values.shape[1]
    is_euroc = _is_euroc(file)
    if 'columns' in statements:
        return Layout(STATEMENT, _stated(file, width, statements), False)
    columns = header_columns(file, width, notes)
    if columns is not None:
        source, columns = HEADER, without_repeats(file, columns)
        check_place(file, columns)
        if not places(columns).keys() & {*STAMPS, 'frame'} and times is None:
            raise ReadError(
                file.path,
                f'its header names no stamps ({listed(file)}); give a file of stamps with '
                f'--times, or state the columns{stamp_advice(file, columns)}',
            )
    else:
        source, columns = _known(file, is_euroc, notes)
    columns = _with_frames(file, columns, times, statements, notes)
    if 'quaternion' in statements:
        columns = _in_order(columns, statements['quaternion'])
    elif (order := _order_in(file.header)) and 'q1' in places(columns):
        columns = _in_order(columns, order)
    return Layout(source, tuple(columns), is_euroc)


def _is_euroc(file: TextFile) -> bool:
    """Return whether a file is EuRoC's by its name or header; it has stamps [ns] and w first."""
    header = file.header.lower().replace(b'_', b'')
    return file.path.name == 'data.csv' or bool(re.match(rb'#timestamp(kf)?( \[ns\])?,', header))


def _order_in(header: bytes) -> str | None:
    """Return the order of quaternions that comments in a header speak of, if they do."""
    text = header.lower().replace(b'_', b'')
    w, x = (re.search(rb'\bq(rs)?%c\b' % letter, text) for letter in b'wx')
    return None if not w or not x else 'wxyz' if w.start() < x.start() else 'xyzw'


def _stated(file: TextFile, width: int, statements: dict[str, str]) -> tuple[Column, ...]:
    columns = stated_columns(statements['columns'])
    roles = [column.role for column in columns if column.role != LEFT_OUT]
    if 'quaternion' in statements:
        raise ConfigError(f'{file.path}: columns= says the order of the quaternion already')
    repeated = next((role for role in roles if roles.count(role) > 1), None)
    if repeated:
        raise ConfigError(f'{file.path}: columns= has {repeated} twice')
    if len(columns) > width:
        raise ReadError(
            file.path, f'columns= names {len(columns)} columns, but its rows have {width}'
        )
    if not any({*position} <= {*roles} for position in (POSITION, GEODETIC)):
        raise ConfigError(
            f'{file.path}: columns= has no position; it needs x, y and z (or lat, lon and alt)'
        )
    if missing := _missing_of_orientation(roles):
        raise ConfigError(
            f'{file.path}: columns= has a part of an orientation, without {", ".join(missing)}; '
            'name all of it, or write _ for what is to be left out'
        )
    return tuple([*columns, *[Column(LEFT_OUT)] * (width - len(columns))])


def _missing_of_orientation(roles: Sequence[str]) -> list[str]:
    """Return what an orientation lacks of which a part is there; nothing where one is whole."""
    parts = [[role for role in one if role not in roles] for one in ORIENTATIONS]
    begun = [
        missing
        for missing, one in zip(parts, ORIENTATIONS, strict=True)
        if len(missing) < len(one)
    ]
    return min(begun, key=len, default=[])


def _known(file: TextFile, is_euroc: bool, notes: list[str]) -> tuple[str, list[Column]]:
    """Return the well-known layout that a file without names has, and its name."""
    found = known_layouts(file, is_euroc)
    width = file.rows.values.shape[1]
    if not found:
        raise ReadError(
            file.path,
            why_not_tum(file)
            or f'{why_not_matrices(file)}has {width} columns; {EXPECTED}{advice(file)}',
        )
    if len(found) > 1:
        both = ' or '.join(one.statement for one in found)
        raise ReadError(
            file.path, f'its columns may be {" or ".join(o.name for o in found)}; append {both}'
        )
    if found[0].name.endswith('by columns'):
        notes.append(
            f'{file.path}: its matrices are written column by column, the translation behind the '
            'rotation, and read so'
        )
    left_out = found[0].columns[-LEFT_OUT_NOTED:]
    if 'rotation matrix' in found[0].name and not any(c.role != LEFT_OUT for c in left_out):
        notes.append(
            f'{file.path}: columns are read as {found[0].name}, and those behind are left out; to '
            f'state it, write {file.path}{found[0].statement}'
        )
    if found[0].name.endswith('t, position') and width > 3:
        read = found[0].name.replace(',', '').replace('position', 'x y z')
        notes.append(f'{file.path}: columns are read as {read}: positions without orientations')
    return found[0].name, list(found[0].columns)


def _with_frames(
    file: TextFile,
    columns: list[Column],
    times: Path | None,
    statements: dict[str, str],
    notes: list[str],
) -> list[Column]:
    """Return columns in which frame numbers and stamps are told apart."""
    at = places(columns)
    values = file.rows.values
    if 't' in at and times is not None and 'stamps' not in statements:
        numbers = values[:, at['t']]
        if len(numbers) > 2 and numbers[0] in (0, 1) and (np.diff(numbers) == 1).all():
            columns[at['t']] = Column('frame')
    elif 'frame' in at and not at.keys() & set(STAMPS):
        exact = file.rows.exact.get(at['frame'])
        if exact is not None and exact.largest > 1e9:
            columns[at['frame']] = Column('t')
            name = (file.names or ())[at['frame']]
            notes.append(
                f'{file.path}: column {at["frame"] + 1} ({name}) is read as the stamp, by its size'
            )
    return columns


def _in_order(columns: list[Column], order: str) -> list[Column]:
    """Return columns whose quaternion is in an order that was stated."""
    found = [column.role for column in columns]
    whole = (one for one in (OPEN_QUATERNION, COUNTED_QUATERNION) if {*one} <= {*found})
    # those that are named one by one come in the order that is stated, whatever their names
    names = next(whole, None) or [role for role in found if role in QUATERNION]
    roles = dict(zip(names, (f'q{letter}' for letter in order), strict=False))
    return [Column(roles.get(column.role, column.role), column.unit) for column in columns]


def _stamps(
    file: TextFile,
    layout: Layout,
    times: Path | None,
    statements: dict[str, str],
    notes: list[str],
) -> np.ndarray:
    """Return the stamps [ns] of a file, its own or those beside it."""
    if layout.has_stamps:
        usual = 'ns' if layout.is_euroc else 's'
        return read_stamps(file, layout.columns, usual, statements, notes)
    matrices = ' (KITTI, matrices 3x4 or 4x4)' if layout.places(MATRIX) else ''
    if times is None:
        numbers = ', but numbers of frames' if 'frame' in places(layout.columns) else ''
        raise ReadError(
            file.path,
            f'these are poses without stamps{numbers}{matrices}; give the file of their stamps '
            'with --times',
        )
    stamps_ns, known = _beside(times, notes)
    count = len(file.rows.values)
    frame = layout.places(['frame'])
    if frame is not None:
        frames = file.rows.values[:, frame[0]]
        if np.isfinite(frames).all() and 0 <= frames.min() and frames.max() < len(stamps_ns):
            index = frames.astype(np.int64)
            stamps_ns, known = stamps_ns[index], known[index]
    if len(stamps_ns) != count:
        raise ReadError(times, f'{len(stamps_ns)} stamps for {count} poses in {file.path}')
    file.rows.values[~known] = np.nan  # to be dropped, and counted
    return stamps_ns


def _beside(times: Path, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return the stamps [ns] in a file that has nothing else of use, and which are numbers."""
    file = read_text(times)
    notes += file.notes
    columns = named_columns(file.names or ())
    if not {*STAMPS} & places(columns).keys():
        columns = [Column('t')]
    stamps_ns = read_stamps(file, columns, 's', {}, notes)
    used = [k for k, column in enumerate(columns) if column.role in STAMPS]
    return stamps_ns, np.isfinite(file.rows.values[:, used]).all(axis=1)


def _positions(
    file: TextFile, layout: Layout, statements: dict[str, str], notes: list[str]
) -> tuple[np.ndarray, Origin | None]:
    """Return (N, 3) positions in metres, or in the unit that is stated, and their origin."""
    values = file.rows.values
    place = layout.places(POSITION)
    if place is None:
        geodetic = layout.places(GEODETIC)
        assert geodetic is not None  # every layout has one of the two
        if 'unit' in statements:
            raise ConfigError(f'{file.path}: unit does not apply to latitude and longitude')
        unit = layout.columns[geodetic[0]].unit
        return of_columns(file.path, values.take(geodetic, axis=1), unit, notes)
    positions = values.take(place, axis=1)
    if not {'unit', 'columns'} & statements.keys() and look_like_degrees(positions):
        roles = dict(zip(place, GEODETIC, strict=True))
        columns = [c._replace(role=roles.get(k, c.role)) for k, c in enumerate(layout.columns)]
        raise ReadError(
            file.path,
            f'columns {numbers(place)} look like latitude, longitude (in degrees) and altitude'
            f'{statement_of(columns)} (or lon,lat), or ?unit=m if they are metres',
        )
    return positions * _metres(file, layout, place, statements), None


def _metres(
    file: TextFile, layout: Layout, place: list[int], statements: dict[str, str]
) -> np.ndarray:
    """Return how many metres the units of three columns have; 1 where a unit is stated."""
    units = [layout.columns[k].unit or 'm' for k in place]
    unknown = next((unit for unit in units if unit not in LENGTH_UNITS), None)
    if 'unit' in statements or unknown == '-':
        return np.ones(3)
    if unknown is not None:
        raise ReadError(
            file.path,
            f"its header has positions in '{unknown}', which is not known (m, cm, mm, km); "
            'append ?unit=m if they are in metres',
        )
    return np.array([LENGTH_UNITS[unit] for unit in units])


def _covariances(
    file: TextFile, layout: Layout, rotations: np.ndarray | None
) -> np.ndarray | None:
    """
    Return the (N, 2, 3, 3) covariances of a file, or None where it has none that is usable.

    ov_eval has those of the orientation about the axes of the body: its error is R R_est^T of
    rotations from world to body.
    """
    values = file.rows.values
    if cells := layout.places(COVARIANCE):
        return covariance_blocks(take(values, cells))
    place, turn = layout.places(POSITION_COVARIANCE), layout.places(ORIENTATION_COVARIANCE)
    if place is None:
        return None
    full = [0, 1, 2, 1, 3, 4, 2, 4, 5]
    if turn is None or rotations is None:
        return covariance_blocks(take(values, place)[:, full])
    blocks = np.stack(
        [take(values, cells)[:, full].reshape(-1, 3, 3) for cells in (place, turn)], axis=1
    )
    matrices = rotation.to_matrix(rotation.normalize(rotations))
    blocks[:, 1] = matrices @ blocks[:, 1] @ matrices.transpose(0, 2, 1)
    return blocks if blocks.any() else None
