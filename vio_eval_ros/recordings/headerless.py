"""
Files whose columns nobody names: the layouts that are well known, recognised by their values.

A further layout is a line in :data:`STAMPS_FIRST` or :data:`BODIES`: the roles of its columns.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vio_eval_ros.recordings.columns import (
    Column,
    COVARIANCE,
    LEFT_OUT,
    OPEN_QUATERNION,
    ORIENTATION_COVARIANCE,
    POSITION_COVARIANCE,
    QUATERNION,
)
from vio_eval_ros.recordings.rotation_columns import are_unit, Matrices, share_of_unit, take
from vio_eval_ros.recordings.stamp_columns import EARLIEST_S, has_fractions
from vio_eval_ros.recordings.text import TextFile

W_FIRST = ('qw', 'qx', 'qy', 'qz')
#: what may come before a pose; None has neither stamps nor frame numbers
STAMPS_FIRST = ('t', 'sec nsec', 'frame t', 'frame sec nsec', 'frame', '')
#: The poses, those of which the values say most first. `q1 q2 q3 q4` has w last or first.
BODIES = {
    'matrices 4x4': 'r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z _ _ _ _',
    'matrices 4x4 by columns': 'r11 r21 r31 _ r12 r22 r32 _ r13 r23 r33 _ x y z _',
    'matrices 3x4': 'r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z',
    'rotation matrix, position': 'r11 r12 r13 r21 r22 r23 r31 r32 r33 x y z',
    'position, rotation matrix': 'x y z r11 r12 r13 r21 r22 r23 r31 r32 r33',
    'position, quaternion': 'x y z q1 q2 q3 q4',
    'quaternion, position': 'q1 q2 q3 q4 x y z',
    'position': 'x y z',
}
#: those that may have further columns behind them; more would be a guess with the others
MAY_HAVE_MORE = (
    'matrices 4x4',
    'matrices 4x4 by columns',
    'matrices 3x4',
    'rotation matrix, position',
    'position, rotation matrix',
    'position, quaternion',
)
TUM = ('t', 'position, quaternion')
TUM_NAME = 't, position, quaternion'
MOST_FRAMES = 1e7
RISING_SHARE = 0.9
#: of the steps between stamps, the share that may go back; where there are enough to tell
MOST_BACK, FEWEST_STEPS = 0.3, 8
NSEC = 1_000_000_000
#: nanoseconds have larger ones among them; what has not is another unit, or a flag
LEAST_NSEC = 1_000_000
VINS_COLUMNS = (8, 11)  # without and with velocities
CELLS = 16  # of a matrix 4x4
OV_EVAL_COLUMNS = 20
#: of a state, without its calibration; and how well velocities are the steps between positions
OPENVINS_COLUMNS, LEAST_SPEED_M_S, SAME_VELOCITY = 17, 0.05, 0.3
#: numbers that ros2 topic echo --csv prints of messages with a covariance: its place, all of them
ECHOED = {'PoseWithCovarianceStamped': 9 + 36, 'Odometry': 9 + 36 + 6 + 36}


class Known(NamedTuple):
    """
    A layout that a file has.

    :param name: what it is, for messages.
    :param columns: what each column is.
    """

    name: str
    columns: tuple[Column, ...]

    @classmethod
    def of(cls, name: str, roles: str, used: list[int], width: int) -> Known:
        """Return the layout with roles for the columns that are used, in order."""
        columns = [Column(LEFT_OUT)] * width
        for place, role in zip(used, roles.split(), strict=False):
            columns[place] = Column(role)
        return cls(name, tuple(columns))

    @property
    def statement(self) -> str:
        """What states it."""
        roles = [column.role for column in self.columns]
        order = dict(zip(OPEN_QUATERNION, QUATERNION, strict=True))
        text = ','.join(order.get(role, role) for role in roles)
        return f'?columns={text.rstrip(f",{LEFT_OUT}")}'


def used_columns(file: TextFile) -> list[int]:
    """Return the columns with numbers: neither text nor empty."""
    values = file.rows.values
    empty = [k for k in file.blank if np.isnan(values[:, k]).all()]
    return [k for k in range(values.shape[1]) if k not in file.text and k not in empty]


def known_layouts(file: TextFile, is_euroc: bool) -> list[Known]:
    """
    Return the well-known layouts that the values of a file have; several fit equally well.

    :param is_euroc: whether its name or header says that it is EuRoC's.
    """
    used, width = used_columns(file), file.rows.values.shape[1]
    if is_euroc and (len(used) >= 8 or len(used) == 4):
        body = ' '.join(W_FIRST) if len(used) >= 8 else ''
        return [Known.of('EuRoC', f't x y z {body}', used, width)]
    if _is_vins(file, used):
        return [Known.of('VINS-Mono', f't x y z {" ".join(W_FIRST)}', used, width)]
    if _is_openvins(file, used):
        return [Known.of('OpenVINS', f't {" ".join(QUATERNION)} x y z', used, width)]
    found = _found(file, used)
    if len(found) > 1 and TUM in found:
        found = [TUM]
    return [
        Known.of(f'{first}, {name}', _roles(file, used, first, name), used, width)
        for first, name in found
    ]


def _is_vins(file: TextFile, used: list[int]) -> bool:
    """Return whether rows are those of VINS-Mono and -Fusion, which end in a comma."""
    return (
        file.separator == ','
        and file.has_end
        and len(used) == file.rows.values.shape[1]
        and len(used) in VINS_COLUMNS
        and file.rows.exact[0].likely_unit == 'ns'
    )


def _is_openvins(file: TextFile, used: list[int]) -> bool:
    """
    Return whether rows are states of OpenVINS: t, orientation, position, velocity, biases, more.

    That the columns behind the position are its velocity is what no other layout has.
    """
    if len(used) < OPENVINS_COLUMNS or not _is_first(file, 't', used, 'quaternion, position'):
        return False
    values = take(file.rows.values, used[:11])
    if not are_unit(values[:, 1:5]):
        return False
    seconds = values[:, 0] / (1e9 if file.rows.exact[0].likely_unit == 'ns' else 1)
    steps = np.diff(seconds)
    moving = steps > 0
    moved = np.diff(values[:, 5:8], axis=0)[moving] / steps[moving, None]
    stated = (values[1:, 8:11] + values[:-1, 8:11])[moving] / 2
    speeds = np.linalg.norm(moved, axis=1)
    if len(speeds) < FEWEST_STEPS or not np.median(speeds) > LEAST_SPEED_M_S:
        return False
    off = np.linalg.norm(moved - stated, axis=1)
    return bool(np.median(off) < SAME_VELOCITY * np.median(speeds))


def _found(file: TextFile, used: list[int]) -> list[tuple[str, str]]:
    """Return the stamps and body of layouts that fit, of those of which the values say most."""
    for name, roles in BODIES.items():
        size = len(roles.split())
        fitting = []
        for first in STAMPS_FIRST:
            begin = len(first.split())
            more = len(used) - begin - size
            has_place = more == 0 or (more > 0 and first and name in MAY_HAVE_MORE)
            if name == 'matrices 3x4' and more == 4:  # a matrix 4x4 whose last row is not one
                continue
            body = used[begin : begin + size]
            if has_place and _is_first(file, first, used, name) and _is_body(file, name, body):
                fitting.append((first, name))
        if fitting:
            return fitting
    return []


def _roles(file: TextFile, used: list[int], first: str, name: str) -> str:
    """Return the roles of a layout, with what is known of the columns behind the pose."""
    roles = f'{first} {BODIES[name]}'
    if name != 'position, quaternion':
        return roles
    closed = roles.replace(' '.join(OPEN_QUATERNION), ' '.join(QUATERNION))
    is_echoed = first == 'sec nsec' and file.separator == ',' and 2 not in used
    if is_echoed:  # the frame is between the stamp and the pose
        more = ' '.join(COVARIANCE) if len(used) in ECHOED.values() else ''
        return f'{closed} {more}'
    if first == 't' and len(used) == OV_EVAL_COLUMNS and _are_variances(file, used[8:]):
        return f'{closed} {" ".join((*ORIENTATION_COVARIANCE, *POSITION_COVARIANCE))}'
    return roles


def _are_variances(file: TextFile, columns: list[int]) -> bool:
    """Return whether the diagonals of two upper triangles are positive, as variances are."""
    return bool((take(file.rows.values, columns)[:, [0, 3, 5, 6, 9, 11]] > 0).all())


def _is_first(file: TextFile, first: str, used: list[int], name: str) -> bool:
    """Return whether the columns before a pose may be what a layout has there."""
    values = file.rows.values
    if not first:
        return name != 'position'
    if first == 't':
        # numbers of frames before a matrix, as KITTI-360 has them, are no stamps
        if name.startswith('matri') and _are_frames(file, used[0]):
            return False
        if name == 'position':
            return _rise(values[:, used[0]])
        return _may_be_stamps(file, used)
    if first == 'frame':
        return name.startswith('matri') and _are_frames(file, used[0])
    at = dict(zip(first.split(), used, strict=False))
    if 'frame' in at and not _count(values[:, at['frame']]):
        return False
    if 'nsec' in at:
        return _are_sec_nsec(file, at['sec'], at['nsec'])
    return _rise(values[:, at['t']])


def _is_body(file: TextFile, name: str, columns: list[int]) -> bool:
    """Return whether columns hold poses of a kind: their orientations are orientations."""
    values = file.rows.values
    roles = BODIES[name].split()
    if name == 'position':
        return True
    if 'q1' in roles:
        return are_unit(take(values, columns[roles.index('q1') :][:4]))
    cells = [columns[k] for k, role in enumerate(roles) if role.startswith('r')]
    found = Matrices.of(values[:, cells].reshape(-1, 3, 3))
    if LEFT_OUT in roles and not _is_last_row(values[:, columns], roles):
        return False
    return found.are_rotations


def _is_last_row(values: np.ndarray, roles: list[str]) -> bool:
    """Return whether what a 4x4 matrix has in its last row is 0 0 0 1."""
    below = values[:, [k for k, role in enumerate(roles) if role == LEFT_OUT]]
    below = below[np.isfinite(below).all(axis=1)]
    return bool((below == [0, 0, 0, 1]).all())


def why_not_matrices(file: TextFile) -> str:
    """Return why 16 columns are not read as matrices, though their rotations are; else ''."""
    used = used_columns(file)
    for begin in (0, 1, 2):
        body = used[begin:]
        if len(body) == CELLS and _is_body(file, 'matrices 3x4', body[:12]):
            return (
                f'columns {body[0] + 1} to {body[-1] + 1} look like a matrix 4x4, but its last '
                'row is not 0 0 0 1; '
            )
    return ''


def _rise(values: np.ndarray) -> bool:
    """Return whether numbers go up, as stamps do."""
    known = values[np.isfinite(values)]
    return len(known) < 2 or bool((np.diff(known) > 0).mean() >= RISING_SHARE)


def _may_be_stamps(file: TextFile, used: list[int]) -> bool:
    """Return whether the first column may be stamps, perhaps of runs one after the other."""
    steps = np.diff(file.rows.values[:, used[0]])
    if len(steps) > FEWEST_STEPS and (steps < 0).mean() > MOST_BACK:
        return False
    first = file.rows.values[:, used]
    known = np.abs(np.nan_to_num(first)).max(axis=0) >= EARLIEST_S
    # times since 1970 in a later column are the stamps, and not what goes up in the first
    return bool(known[0]) or not any(known[k] and _rise(first[:, k]) for k in range(1, len(used)))


def _count(values: np.ndarray) -> bool:
    """Return whether numbers are those of rows or frames, one more in each row."""
    return len(values) > 1 and values[0] < MOST_FRAMES and bool((np.diff(values) == 1).all())


def _are_frames(file: TextFile, column: int) -> bool:
    """Return whether a column has whole numbers that go up and are too small for stamps."""
    values = file.rows.values[:, column]
    whole = not (values % 1).any()
    return whole and _rise(values) and 0 <= values[0] and values[-1] < MOST_FRAMES


def _are_sec_nsec(file: TextFile, sec: int, nsec: int) -> bool:
    """Return whether two columns are whole seconds and nanoseconds."""
    exact = file.rows.exact
    if sec not in exact or nsec not in exact or exact[sec].largest > 64 * EARLIEST_S:
        return False
    rest = exact[nsec].digits
    is_whole = not has_fractions(exact[sec]) and not has_fractions(exact[nsec])
    if not is_whole or rest.min() < 0 or not LEAST_NSEC <= rest.max() < NSEC:
        return False
    return _rise(exact[sec].digits * 1.0 + rest / NSEC)


def unit_windows(file: TextFile) -> list[list[int]]:
    """Return four columns side by side, wherever they have unit length as quaternions do."""
    used, values = used_columns(file), file.rows.values
    windows = [used[k : k + 4] for k in range(len(used) - 3)]
    return [one for one in windows if share_of_unit(values[:, one]) >= 0.99]
