"""
What the names of columns mean: from headers, as people write them, to roles.

A role is what a column is in a pose. Users state roles outright, ``?columns=t,x,y,z,qx,qy,qz,qw``;
headers use the synonyms of :data:`SYNONYMS`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
import re
from typing import NamedTuple

LEFT_OUT = '_'
POSITION = ('x', 'y', 'z')
#: latitude, longitude and height above the ellipsoid, in place of a position
GEODETIC = ('lat', 'lon', 'alt')
QUATERNION = ('qx', 'qy', 'qz', 'qw')
#: a quaternion in the order of its columns, w being the last of them or the first
OPEN_QUATERNION = ('q1', 'q2', 'q3', 'q4')
#: fixed axes, as in ROS: R = Rz(yaw) Ry(pitch) Rx(roll)
EULER = ('roll', 'pitch', 'yaw')
ROTATION_VECTOR = ('rx', 'ry', 'rz')
#: where a layout comes from, unless it is recognised
HEADER, STATEMENT = 'its header', '?columns='
#: a quaternion that is counted from 0, w first as a rule
COUNTED_QUATERNION = ('q_0', 'q_1', 'q_2', 'q_3')
#: three angles that may be roll, pitch and yaw, or a rotation vector
OPEN_TURN = ('turn_x', 'turn_y', 'turn_z')
MATRIX = tuple(f'r{i}{j}' for i in '123' for j in '123')
#: the columns of each way to write an orientation, the ones that say most first
ORIENTATIONS = (
    QUATERNION,
    OPEN_QUATERNION,
    COUNTED_QUATERNION,
    MATRIX,
    EULER,
    ROTATION_VECTOR,
    OPEN_TURN,
)
#: what is stated of columns whose names leave something open
USUAL = dict(
    zip(
        (*OPEN_QUATERNION, *COUNTED_QUATERNION, *OPEN_TURN),
        (*QUATERNION, 'qw', 'qx', 'qy', 'qz', *ROTATION_VECTOR),
        strict=True,
    )
)
UPPER = ('11', '12', '13', '22', '23', '33')
#: covariances as ov_eval writes them: of the position, and of the orientation about body axes
POSITION_COVARIANCE = tuple(f'pt{cell}' for cell in UPPER)
ORIENTATION_COVARIANCE = tuple(f'pr{cell}' for cell in UPPER)
#: the row-major 6 x 6 covariance of a ROS message
COVARIANCE = tuple(f'cov{k}' for k in range(36))

LENGTHS = ('m', 'cm', 'mm', 'km')
ANGLES = ('rad', 'deg')
TIMES = ('s', 'ms', 'us', 'ns')
#: the roles, and the units that each may have
ROLES: dict[str, tuple[str, ...]] = {
    't': TIMES,
    **dict.fromkeys(('sec', 'frame'), ()),
    'nsec': ('us', 'ms'),
    **dict.fromkeys(POSITION, LENGTHS),
    **dict.fromkeys(('lat', 'lon'), ANGLES),
    'alt': ('m',),
    **dict.fromkeys(QUATERNION, ()),
    **dict.fromkeys((*EULER, *ROTATION_VECTOR), ANGLES),
    **dict.fromkeys(MATRIX, ()),
    **dict.fromkeys((*POSITION_COVARIANCE, *ORIENTATION_COVARIANCE, *COVARIANCE), ()),
}
STAMPS = ('t', 'sec', 'nsec')

# How people spell units. Others, in brackets behind a name that needs one, are refused.
UNITS = {
    's': r's|secs?|seconds?',
    'ms': r'ms|msecs?|milli ?sec(ond)?s?',
    'us': r'[uµμ]s|[uµμ]secs?|micro ?sec(ond)?s?',
    'ns': r'ns|nsecs?|nano ?sec(ond)?s?',
    'm': r'm|met(er|re)s?',
    'cm': r'cm|centimet(er|re)s?',
    'mm': r'mm|millimet(er|re)s?',
    'km': r'km|kilomet(er|re)s?',
    'rad': r'rad|radians?',
    'deg': r'deg|degrees?|°',
}
_BRACKETS = r'[\[(][^\])]{0,100}[\])]'
LONGEST_NAME = 300  # characters of a name that may mean something
# Words before the first one that means something: /odom/pose/pose/position/x, gt_x, field.pose...
PREFIXES = (
    'field|pose|poses|transform|msg|data|gt|ground|truth|groundtruth|est|estimate|estimated|odom|'
    'odometry|world|body|slam|vio|rigid|marker|tracker|vicon|optitrack|mocap'
)
_OF_WHAT_IN_WHAT = r'(?:_(?:[a-z]{1,2}|rsr|wsw|map|odom|imu|cam|world|body|global|local))*'
_PLACE = rf'(?:(?:t|p|pos|position|trans|translation|loc|location){_OF_WHAT_IN_WHAT}_?)?'
_TURN = (
    rf'(?:q|quat|quaternion|ori|orient|orientation|rot|rotation|att|attitude){_OF_WHAT_IN_WHAT}'
)
_FIX = r'(?:(?:gps|gnss|geo|fix|position)_)?'
_EASTING = rf'(?:{_PLACE}(?:utm_)?(?:east|easting)(?:_utm)?|utm_x)'
_NORTHING = rf'(?:{_PLACE}(?:utm_)?(?:north|northing)(?:_utm)?|utm_y)'
_DOWN = rf'{_PLACE}down'
_TIME = r'(?:t|ts|time|times|timestamps?|time_?stamps?|stamps?|unix_?time|epoch)'
_UNIT = '(?:_(?P<unit>{}))?'
_LENGTH = _UNIT.format('m|cm|mm|km')
_ANGLE = _UNIT.format('rad|deg|radians?|degrees?')
_SECOND = _UNIT.format('s|ms|us|ns|msecs?|usecs?')
#: What headers say, in small letters with _ between the words, and the role that it is. In a role
#: {0} and {1} are what the first and second pair of brackets match.
SYNONYMS: dict[str, str] = {
    rf'{_TIME}(?:_kf|_sample)?{_SECOND}': 't',
    rf'(?:header_)?stamp{_SECOND}': 't',
    rf'(?:(?:header_)?{_TIME}_|tv_)?(?:secs?|seconds?)': 'sec',
    rf'(?:(?:header_)?{_TIME}_|tv_)?(?:nsecs?|nano_?secs?|nano_?seconds?)': 'nsec',
    r'(?:tv_|header_)?(?P<unit>[um]secs?)': 't',
    r'(?:frame|index|idx|id|counter|count|seq|num|number|no|frames)': 'frame',
    r'(?:frame|image|header)_(?:id|idx|index|number|no|num|count|seq)': 'frame',
    rf'{_PLACE}([xyz]){_LENGTH}': '{0}',
    r'(?:pos|position)_0?0': 'x',
    r'(?:pos|position)_0?1': 'y',
    r'(?:pos|position)_0?2': 'z',
    rf'{_EASTING}{_LENGTH}': 'east',
    rf'{_NORTHING}{_LENGTH}': 'north',
    rf'{_PLACE}up(?:_baseline)?{_LENGTH}': 'up',
    rf'{_DOWN}{_LENGTH}': 'down',
    rf'{_FIX}lat(?:itude)?{_ANGLE}': 'lat',
    rf'{_FIX}(?:lon|long|lng|longitude){_ANGLE}': 'lon',
    rf'{_FIX}(?:alt|altitude|height|hgt|elevation|ellipsoidal_height|h_ell)(?:_m)?': 'alt',
    rf'{_TURN}_?([xyzw])': 'q{0}',
    rf'{_TURN}_?0?([0-4])': 'q_{0}',
    rf'{_TURN}_?(?:w|r|re|real|s|scalar)': 'qw',
    rf'{_TURN}_?(?:i|im_i|imag_i)': 'qx',
    rf'{_TURN}_?(?:j|im_j|imag_j)': 'qy',
    rf'{_TURN}_?(?:k|im_k|imag_k)': 'qz',
    rf'(?:euler_|rpy_|ang_|angle_|orientation_|rotation_|rot_)?(roll|pitch|yaw){_ANGLE}': '{0}',
    rf'(?:rvec|rotvec|rotation_vector|axis_angle|helical|rodrigues)_?([xyz]){_ANGLE}': 'r{0}',
    rf'(?:r|angles?|ang|euler|rpy)_?([xyz]){_ANGLE}': 'turn_{0}',
    r'(?:r|rot|rotation|m|mat|matrix|t|h)_?([0-4])_?([0-4])': 'r{0}{1}',
    r'p([rt])_([123])_?([123])': 'p{0}{1}{2}',
    r'covariance_(\d|[12]\d|3[0-5])': 'cov{0}',
    # of a fix, row by row; the cells below the diagonal repeat those above it
    **{
        f'position_covariance_{cell}': role
        for cell, role in zip((0, 1, 2, 4, 5, 8), POSITION_COVARIANCE, strict=True)
    },
}
#: the axes of the earth by their letters, where all three are there
LETTERS = {('e', 'n', 'u'): ('east', 'north', 'up'), ('n', 'e', 'd'): ('north', 'east', 'down')}
TURN_WORDS = frozenset(
    'q quat quaternion ori orient orientation rot rotation att attitude euler rpy roll pitch yaw '
    'heading azimuth phi theta psi rvec rotvec angle angles axis'.split()
)
RATE_WORDS = frozenset('rate rates vel velocity dot std sigma cov var err error'.split())
# A header may name a vector by one word; how many columns that is.
VECTORS = {
    **dict.fromkeys(('q', 'quat', 'quaternion'), 4),
    **dict.fromkeys(('p', 'pos', 'position', 'translation', 'v', 'vel', 'velocity'), 3),
    **dict.fromkeys(('bg', 'ba'), 3),
}
#: names that only logs of PX4 have, whose stamps are microseconds
PX4_NAMES = frozenset(('q[0]', 'timestamp_sample'))
#: ... and whose quaternions have w first
_CLOSED = dict(zip(COUNTED_QUATERNION, ('qw', 'qx', 'qy', 'qz'), strict=True))
# OpenVINS writes JPL quaternions from world to body: as Hamilton ones they are body to world.
OPENVINS = ('q', 'p', 'v', 'bg', 'ba')


class Column(NamedTuple):
    """
    What a column is.

    :param role: one of :data:`ROLES` or :data:`OPEN_QUATERNION`, or :data:`LEFT_OUT`.
    :param unit: as the name states it, or None.
    """

    role: str
    unit: str | None = None


def places(columns: Sequence[Column]) -> dict[str, int]:
    """Return the column of each role."""
    return {column.role: place for place, column in enumerate(columns)}


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
    def is_recognised(self) -> bool:
        """Whether neither a header nor the user says what its columns are."""
        return self.source not in (HEADER, STATEMENT)

    @property
    def has_stamps(self) -> bool:
        """Whether there is a stamp in each row."""
        return bool(places(self.columns).keys() & set(STAMPS))


def stated_columns(text: str) -> list[Column]:
    """Return the columns in a statement: roles, with their unit after an underscore."""
    columns = []
    for name in text.split(','):
        role, _, unit = (name, '', '') if name == LEFT_OUT else name.partition('_')
        columns.append(Column(role, unit or None))
    return columns


#: what a statement of columns looks like
STATED = '({0})(,({0}))*'.format(
    '|'.join([LEFT_OUT, *ROLES, *(f'{r}_{unit}' for r, units in ROLES.items() for unit in units)])
)


def named_columns(names: Sequence[str]) -> list[Column]:
    """
    Return what names of columns mean; a name that means nothing is left out.

    Of several stamps the one of the header of a message is meant (beside the time at which it was
    recorded), and the one of a sample (beside the time at which it was logged).
    """
    words = [_words(name) for name in names]
    turn = ''
    for place, (text, _) in enumerate(words):
        # orientation, x, y, z, w: a message as rows, its fields before what is in them
        if turn and text in 'xyzw':
            words[place] = (f'{turn}_{text}', None)
        else:
            turn = text if re.fullmatch(rf'{_TURN}(?<!_[wxyz])', text) else ''
    columns = [_meant(*each) for each in words]
    _index_from_one(columns)
    _axes_of_the_earth(words, columns)
    _parts_of_seconds(words, columns)
    meant = max((_rank(text) for text, _, column in _stamps(words, columns)), default=0)
    for text, place, column in list(_stamps(words, columns)):
        if _rank(text) < meant:
            columns[place] = Column(LEFT_OUT)
        elif PX4_NAMES.intersection(names) and column.unit is None:
            columns[place] = column._replace(unit='us')
    if PX4_NAMES.intersection(names):
        columns = [
            column._replace(role=_CLOSED.get(column.role, column.role)) for column in columns
        ]
    return columns


def _stamps(
    words: list[tuple[str, str | None]], columns: list[Column]
) -> Iterable[tuple[str, int, Column]]:
    for place, ((text, _), column) in enumerate(zip(words, columns, strict=True)):
        if column.role in STAMPS:
            yield text, place, column


def _rank(text: str) -> int:
    """Return which stamp is meant of several: the one with the highest rank."""
    return 2 if 'sample' in text else 'header_' in text


def _index_from_one(columns: list[Column]) -> None:
    """Give matrices and quaternions whose cells count otherwise the roles that they have."""
    roles = {column.role for column in columns}
    if 'q_4' in roles:  # q1 to q4: no saying whether w is first or last
        order = dict(zip((*COUNTED_QUATERNION[1:], 'q_4'), OPEN_QUATERNION, strict=True))
        columns[:] = [Column(order.get(role, role), unit) for role, unit in columns]
    cells = [re.fullmatch(r'r(\d)(\d)', role) for role in roles]
    base = 0 if any(cell and '0' in cell[0] for cell in cells) else 1
    for place, (role, unit) in enumerate(columns):
        if cell := re.fullmatch(r'r(\d)(\d)', role):
            row, column = int(cell[1]) - base, int(cell[2]) - base
            known = POSITION[row] if column == 3 and row < 3 else f'r{row + 1}{column + 1}'
            columns[place] = Column(known if row < 3 and column < 4 else LEFT_OUT, unit)


def _axes_of_the_earth(words: Sequence[tuple[str, str | None]], columns: list[Column]) -> None:
    """Give east, north and up, or north, east and down, the roles of a position."""
    letters = {text for text, _ in words}
    for axes in LETTERS if not {*POSITION} & {column.role for column in columns} else ():
        if {*axes} <= letters:
            for place, (text, unit) in enumerate(words):
                if text in axes:
                    columns[place] = Column(LETTERS[axes][axes.index(text)], unit_of(unit))
            break
    roles = {column.role for column in columns}
    order = ('north', 'east', 'down') if 'down' in roles else ('east', 'north', 'up')
    named = dict(zip(order, POSITION, strict=True))
    if {'x', 'y'} <= {named.get(role, role) for role in roles} and not {'z', order[2]} & roles:
        named['alt'] = 'z'
    if [named.get(role, role) in POSITION for role, _ in columns].count(True) > len(POSITION):
        named = dict.fromkeys((*order, 'up', 'down'), LEFT_OUT)  # beside x, y and z
    columns[:] = [Column(named.get(role, role), unit) for role, unit in columns]


def are_north_east_down(names: Sequence[str]) -> bool:
    """Return whether names are those of axes that point north, east and down."""
    texts = {_words(name)[0] for name in names}
    return {'n', 'e', 'd'} <= texts or any(re.fullmatch(_DOWN, text) for text in texts)


def sounds_like_a_turn(name: str) -> bool:
    """Return whether a name is that of a part of an orientation, as far as it can be told."""
    words = set(_words(name)[0].split('_'))
    return bool(words & TURN_WORDS) and not words & RATE_WORDS


def _parts_of_seconds(words: Sequence[tuple[str, str | None]], columns: list[Column]) -> None:
    """Take what is named beside whole seconds as milli- or microseconds for their part."""
    if not any(column.role == 'sec' for column in columns):
        return
    for place, (text, _) in enumerate(words):
        if columns[place].role == 't' and (part := re.search(r'(?:^|_)([mun])secs?$', text)):
            columns[place] = Column('nsec', f'{part[1]}s')


@lru_cache(1 << 12)
def _words(name: str) -> tuple[str, str | None]:
    """Return the words of a name, small and with _ between them, and the unit behind it."""
    if len(name) > LONGEST_NAME:
        return '', None
    name = re.sub(r'\[(\d+)\]', r'_\1', name.strip(' \t"\'#%'))
    bare, unit = name, None
    if brackets := re.search(r'[\[(]([^\])]*)[\])]?\s*$', name):
        bare, unit = name[: brackets.start()], brackets[1].strip().lower()
    parts = [part for part in re.split(r'[./]', bare) if part.strip()]
    # of a path, its end: /odom/pose/pose/position/x
    kept = [re.sub(r'(?<=[a-z])(?=[A-Z])', '_', part) for part in parts[-2:]]
    words = re.findall(r'[a-z]+|\d+', '_'.join(kept).lower())
    return '_'.join(words), unit


@lru_cache(1 << 12)  # files have the same names again and again, and many that mean nothing
def _meant(text: str, unit: str | None) -> Column:
    """Return what a name in plain words means."""
    while shorter := re.match(rf'(?:{PREFIXES})_(?=.)', text):
        text = text[shorter.end() :]
    for pattern, role in SYNONYMS.items():
        if match := re.fullmatch(pattern, text):
            found = match.groupdict().get('unit')
            groups = [group for group in match.groups() if group != found]
            return Column(role.format(*groups), unit_of(unit or found))
    return Column(LEFT_OUT)


def unit_of(text: str | None) -> str | None:
    """Return a unit as it is spelled here; as it was given where it is not known."""
    known = (unit for unit, spelled in UNITS.items() if text and re.fullmatch(spelled, text))
    return next(known, text or None)


def names_in(line: str) -> list[str]:
    """Return the names in a line of a header, each with the unit in brackets behind it."""
    line = line.strip(' \r\n').lstrip('#%').strip(' ')  # a tab in front is an empty name
    separator = next((mark for mark in ',;\t' if mark in line), None)
    if separator:
        return [name.strip(' \t"\'') for name in line.rstrip(', ;\t').split(separator)]
    return re.findall(rf'(?=\S)(?:[^\s\[(]*(?:\s*{_BRACKETS})+[^\s\[(]*|\S+)', line)


def expanded(names: Sequence[str], width: int) -> list[Column] | None:
    """
    Return the columns of a header that names vectors by one word, such as ``t q p v``.

    None where it does not, or names no position. What comes after what is known is left out.
    """
    words = [_words(name)[0] for name in names]
    columns: list[Column] = []
    for word, name in zip(words, names, strict=True):
        size = VECTORS.get(word)
        if size == 4:
            is_jpl = tuple(words[1 : 1 + len(OPENVINS)]) == OPENVINS
            columns += map(Column, QUATERNION if is_jpl else OPEN_QUATERNION)
        elif size:
            is_place = word in ('p', 'pos', 'position', 'translation')
            columns += map(Column, POSITION if is_place else [LEFT_OUT] * 3)
        elif len(columns) < 3 and (known := named_columns([name])[0]).role != LEFT_OUT:
            columns.append(known)
        else:
            break
    has_place = {*POSITION} <= {column.role for column in columns}
    return columns if has_place and len(columns) <= width else None
