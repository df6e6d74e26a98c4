"""
Which column of a text file is what, and the poses that follow from it.

Three ways lead to a layout: what the user states (``?columns=``), what the header names
(:mod:`~vio_eval_ros.recordings.columns`), and the well-known files without names
(:mod:`~vio_eval_ros.recordings.headerless`). Whatever it is, orientations must be orientations;
columns that are none were taken for what they are not, and the file is refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import re
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core import rotation
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, ReadError
from vio_eval_ros.recordings.columns import (
    Column,
    COVARIANCE,
    EULER,
    expanded,
    GEODETIC,
    LEFT_OUT,
    MATRIX,
    named_columns,
    OPEN_QUATERNION,
    ORIENTATION_COVARIANCE,
    POSITION,
    POSITION_COVARIANCE,
    PX4_NAMES,
    QUATERNION,
    ROLES,
    ROTATION_VECTOR,
    STAMPS,
    stated_columns,
)
from vio_eval_ros.recordings.geographic import look_like_degrees, of_columns
from vio_eval_ros.recordings.headerless import known_layouts, TUM_NAME, unit_windows, used_columns
from vio_eval_ros.recordings.messages import covariance_blocks
from vio_eval_ros.recordings.motion_capture import poses_of_export
from vio_eval_ros.recordings.orientations import (
    from_euler,
    LEAST_SHARE,
    Matrices,
    share_of_unit,
    take,
)
from vio_eval_ros.recordings.stamp_columns import places, read_stamps
from vio_eval_ros.recordings.text import read_text, TextFile

METRES = {'m': 1.0, 'cm': 0.01, 'mm': 0.001, 'km': 1000.0}
#: the columns of each way to write an orientation, the ones that say most first
ORIENTATIONS = (QUATERNION, OPEN_QUATERNION, MATRIX, EULER, ROTATION_VECTOR)
USUAL = 'a trajectory has 8: stamp x y z qx qy qz qw'
CONVENTION = 't,x,y,z,qx,qy,qz,qw'
MOST_LISTED = 12
#: an angle of roll, pitch or yaw [rad] is not larger, unless it counts turns
LARGEST_RAD = 3 * np.pi


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


@dataclass(frozen=True)
class Layout:
    """
    What each column of a file is.

    :param source: what says so, for messages: 'its header' for example.
    :param columns: as many as the file has.
    :param is_euroc: whether the file is EuRoC's by its name or header.
    """

    source: str
    columns: tuple[Column, ...]
    is_euroc: bool

    def places(self, roles: Sequence[str]) -> list[int] | None:
        """Return the columns of some roles, or None where one of them is missing."""
        at = places(self.columns)
        return [at[role] for role in roles] if at.keys() >= set(roles) else None

    @property
    def has_stamps(self) -> bool:
        """Whether there is a stamp in each row."""
        return bool(places(self.columns).keys() & set(STAMPS))


class _Turns(NamedTuple):
    """One way to read orientations: quaternions x y z w, and what settles it."""

    statement: str
    rotations: np.ndarray | None


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
    if 'body' in statements:
        raise ConfigError(
            f'{file.path}: body chooses one in an export of motion capture, which this is not'
        )
    layout = _layout(file, times, statements, notes)
    stamps_ns = _stamps(file, layout, times, statements, notes)
    values = file.rows.values
    positions = _positions(file, layout, statements, notes)
    own = [k for k, column in enumerate(layout.columns) if column.role in STAMPS]
    positions[~np.isfinite(values[:, own]).all(axis=1)] = np.nan  # to be dropped, and counted
    turns = _turns(file, layout, statements, notes)
    covariances = _covariances(file, layout, turns[0].rotations)
    kind = 'euroc' if layout.is_euroc else 'tum'
    return kind if layout.has_stamps else 'kitti', [
        Reading(turn.statement, Poses(stamps_ns, positions, turn.rotations, covariances), usual)
        for turn, usual in zip(turns, (_has_rule(file, layout), False), strict=False)
    ]


def _has_rule(file: TextFile, layout: Layout) -> bool:
    """
    Return whether the quaternions of a file without names are x y z w by a rule, that of TUM.

    Files with commas or nanoseconds are called TUM's as well, and come in both orders.
    """
    stamp = file.rows.exact.get(0)
    is_seconds = stamp is not None and stamp.likely_unit == 's'
    return layout.source == TUM_NAME and is_seconds and file.separator != ','


def _layout(
    file: TextFile, times: Path | None, statements: dict[str, str], notes: list[str]
) -> Layout:
    """Return the layout that is stated, else named, else known."""
    width = file.rows.values.shape[1]
    is_euroc = _is_euroc(file)
    if 'columns' in statements:
        return Layout('?columns=', _stated(file, width, statements), False)
    columns = _named(file, width, notes)
    if columns is not None:
        source, columns = 'its header', _without_repeats(file, columns)
        _check_place(file, columns)
        if not places(columns).keys() & {*STAMPS, 'frame'} and times is None:
            raise ReadError(
                file.path,
                f'its header names no stamps ({_listed(file)}); give a file of stamps with '
                f'--times, or state the columns{_advice(file)}',
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
    return tuple([*columns, *[Column(LEFT_OUT)] * (width - len(columns))])


def _named(file: TextFile, width: int, notes: list[str]) -> list[Column] | None:
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
        f'its header names {len(file.names or ())} columns ({_listed(file)}), but its rows have '
        f'{file.rows.values.shape[1]}; state the columns{_advice(file)}',
    )


def _listed(file: TextFile) -> str:
    """Return the names in a header, not too many of them."""
    names = [name or "''" for name in file.names or ()]
    return ', '.join(names[:MOST_LISTED]) + ', ...' * (len(names) > MOST_LISTED)


def _without_repeats(file: TextFile, columns: list[Column]) -> list[Column]:
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
                f'{_statement(columns, found[column.role])}',
            )
        found.setdefault(column.role, place)
    return columns


def _statement(columns: Sequence[Column], left_out: int | None = None) -> str:
    """Return how to state columns, without one of them."""
    roles = [LEFT_OUT if k == left_out else c.role for k, c in enumerate(columns)]
    order = dict(zip(OPEN_QUATERNION, QUATERNION, strict=True))
    text = ','.join(
        f'{order.get(role, role)}_{column.unit}'
        if column.unit and column.unit in ROLES.get(role, ())
        else order.get(role, role)
        for role, column in zip(roles, columns, strict=True)
    )
    return f': append ?columns={text.rstrip(f",{LEFT_OUT}")}'


def _check_place(file: TextFile, columns: Sequence[Column]) -> None:
    """Check that a header names positions, and orientations wholly or not at all."""
    at = places(columns).keys()
    missing = [role for role in POSITION if role not in at]
    if missing and {'lat', 'lon'} <= at:
        missing = [role for role in GEODETIC if role not in at]
        if missing:
            raise ReadError(
                file.path,
                f'its header names latitude and longitude, but no altitude ({_listed(file)}); add '
                'it: without one there are no positions in space',
            )
    if missing:
        what = ', '.join(missing) if len(missing) < len(POSITION) else 'a position'
        raise ReadError(
            file.path,
            f'its header names no column as {what} ({_listed(file)}); state the columns'
            f'{_advice(file)}',
        )
    whole = next((roles for roles in ORIENTATIONS if at >= set(roles)), None)
    for roles in (QUATERNION, MATRIX, ROTATION_VECTOR):
        missing = [role for role in roles if role not in at]
        if whole is None and 0 < len(missing) < len(roles):
            raise ReadError(
                file.path,
                f'its header names a part of an orientation, but no column as '
                f'{", ".join(missing)} ({_listed(file)}); state the columns{_advice(file)}',
            )
    if whole is None and unit_windows(file):
        raise ReadError(
            file.path,
            f'its header names no orientation that is known ({_listed(file)}); state the columns'
            f'{_advice(file)}',
        )


def _known(file: TextFile, is_euroc: bool, notes: list[str]) -> tuple[str, list[Column]]:
    """Return the well-known layout that a file without names has, and its name."""
    found = known_layouts(file, is_euroc)
    width = file.rows.values.shape[1]
    if not found:
        raise ReadError(file.path, f'has {width} columns; {USUAL}{_advice(file)}')
    if len(found) > 1:
        both = ' or '.join(one.statement for one in found)
        raise ReadError(
            file.path, f'its columns may be {" or ".join(o.name for o in found)}; append {both}'
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
    roles = iter(f'q{letter}' for letter in order)
    quaternion = {*QUATERNION, *OPEN_QUATERNION}
    return [Column(next(roles)) if column.role in quaternion else column for column in columns]


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
) -> np.ndarray:
    """Return (N, 3) positions in metres, or in the unit that is stated."""
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
            f'columns {_numbers(place)} look like latitude, longitude (in degrees) and altitude'
            f'{_statement(columns)} (or lon,lat), or ?unit=m if they are metres',
        )
    return positions * _metres(file, layout, place, statements)


def _metres(
    file: TextFile, layout: Layout, place: list[int], statements: dict[str, str]
) -> np.ndarray:
    """Return how many metres the units of three columns have; 1 where a unit is stated."""
    units = [layout.columns[k].unit or 'm' for k in place]
    unknown = next((unit for unit in units if unit not in METRES), None)
    if 'unit' in statements or unknown == '-':
        return np.ones(3)
    if unknown is not None:
        raise ReadError(
            file.path,
            f"its header has positions in '{unknown}', which is not known (m, cm, mm, km); "
            'append ?unit=m if they are in metres',
        )
    return np.array([METRES[unit] for unit in units])


def _turns(
    file: TextFile, layout: Layout, statements: dict[str, str], notes: list[str]
) -> list[_Turns]:
    """Return the ways to read the orientations of a file."""
    values = file.rows.values
    roles = next((one for one in ORIENTATIONS if layout.places(one)), None)
    if roles and layout.places(POSITION) is None:
        if roles == EULER:
            notes.append(
                f'{file.path}: roll, pitch and yaw beside latitude and longitude are left out, '
                'since it is not known whether they count from north or from east'
            )
            return [_Turns('', None)]
        notes.append(f'{file.path}: orientations are read as those in east, north, up')
    if roles is None:
        partial = [role for role in EULER if layout.places([role])]
        if partial:
            notes.append(
                f'{file.path}: {layout.source} has {", ".join(partial)} only; the positions are '
                'used, and no orientations'
            )
        return [_Turns('', None)]
    columns = layout.places(roles) or []
    if roles in (QUATERNION, OPEN_QUATERNION):
        quaternions = take(values, sorted(columns))
        share = share_of_unit(quaternions)
        if share < LEAST_SHARE:
            raise ReadError(
                file.path,
                f'the quaternion that {layout.source} has in columns {_numbers(columns)} has no '
                f'unit length in {100 * (1 - share):.0f} % of the rows, so it is none'
                f'{_advice(file)}',
            )
        if roles == QUATERNION:
            return [_Turns('', values.take(columns, axis=1))]
        # both orders are views of one array
        twice = np.concatenate([quaternions, quaternions[:, :1]], axis=1)
        return [
            _Turns('quaternion=xyzw', twice[:, :4]),
            _Turns('quaternion=wxyz', twice[:, 1:]),
        ]
    if roles == MATRIX:
        return [_Turns('', _from_matrices(file, layout, columns, notes))]
    return _from_angles(file, layout, columns, roles, notes)


def _numbers(columns: Sequence[int]) -> str:
    return ' '.join(str(column + 1) for column in columns)


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
            f'the matrices that {layout.source} has in columns {_numbers(columns)} are not '
            f'rotations ({why}){_advice(file)}',
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
) -> list[_Turns]:
    """Return the ways to read roll, pitch and yaw, or a rotation vector."""
    angles = take(file.rows.values, columns)
    angles = np.where(np.isfinite(angles), angles, np.nan)  # the sine of inf is none
    unit = layout.columns[columns[0]].unit
    if unit not in ('rad', 'deg', None):
        raise ReadError(
            file.path, f"its header has angles in '{unit}', which is not known (rad, deg)"
        )
    if unit is None and (np.abs(angles[np.isfinite(angles)]) > LARGEST_RAD).any():
        unit = 'deg'
        notes.append(f'{file.path}: angles are read as degrees, by their size')
    convert = from_euler if roles == EULER else rotation.from_rotation_vector
    units = [unit] if unit else ['rad', 'deg']
    turns = []
    for one in units:
        stated = [Column(c.role, one) if k in columns else c for k, c in enumerate(layout.columns)]
        text = _statement(stated).removeprefix(': append ?') if unit is None else ''
        rad = np.deg2rad(angles) if one == 'deg' else angles
        turns.append(_Turns(text, convert(rad)))
    return turns


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
    if place is None or turn is None or rotations is None:
        return None
    full = [0, 1, 2, 1, 3, 4, 2, 4, 5]
    blocks = np.stack(
        [take(values, cells)[:, full].reshape(-1, 3, 3) for cells in (place, turn)], axis=1
    )
    matrices = rotation.to_matrix(rotation.normalize(rotations))
    blocks[:, 1] = matrices @ blocks[:, 1] @ matrices.transpose(0, 2, 1)
    return blocks if blocks.any() else None


def _advice(file: TextFile) -> str:
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
            f'; columns {_numbers(window)} have unit length, as a quaternion has'
            f'{_statement(columns)} (or qw,qx,qy,qz in place of qx,qy,qz,qw)'
        )
    return (
        f'; say what each column is, such as ?columns={CONVENTION} (roll,pitch,yaw and r11 to '
        'r33 are known, too; _ for a column to leave out)'
    )
