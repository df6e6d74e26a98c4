"""
What motion capture systems write above their rows: which columns are whose pose, in what unit.

Vicon (Tracker, Nexus; csv), Motive of OptiTrack (csv) and Qualisys Track Manager (tsv).
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
import re
from typing import NamedTuple

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.spec import LENGTH_UNITS

#: of the units as exports spell them
METRES = LENGTH_UNITS | {'meters': 1.0, 'centimeters': 0.01, 'millimeters': 0.001}
METRES |= {'inches': 0.0254, 'feet': 0.3048}
SEPARATOR = re.compile(rb'[,;\t]')
TIMECODE = re.compile(rb'\b\d\d:\d\d:\d\d:\d\d(?:\.\d+)?')
LONGEST_PREAMBLE = 100  # lines


class Body(NamedTuple):
    """
    A rigid body, or a marker, of an export.

    :param position: the columns of x, y and z.
    :param orientation: those of a quaternion x y z w, a rotation vector, or a matrix by columns;
        empty where there is none that can be read.
    """

    name: str
    position: tuple[int, ...]
    orientation: tuple[int, ...] = ()


class Export(NamedTuple):
    """
    What a preamble says of the rows below it.

    :param system: that wrote it.
    :param start: where the rows begin and
    :param end: end, in bytes.
    :param bodies: of which there are poses.
    :param metres: of a unit of positions; None where the preamble does not say it.
    :param rate_hz: of the rows.
    :param time: the column of seconds; None where frames are counted, or rows if they are not.
    :param frames: the columns of the frame, counted from 1, and of the part of it.
    :param degrees: whether rotation vectors are in degrees.
    :param notes: what the preamble leaves open, in sentences.
    """

    system: str
    start: int
    end: int
    bodies: tuple[Body, ...]
    metres: float | None
    rate_hz: float | None
    time: int | None = None
    frames: tuple[int, ...] = ()
    degrees: bool = False
    notes: tuple[str, ...] = ()


def export_of(path: Path, data: bytes) -> Export | None:
    """Return what the preamble of an export says; None where the text begins otherwise."""
    for beginning, read in (
        (rb'Format Version[,;\t]', _motive),
        (rb'(?:FILE_VERSION|NO_OF_FRAMES)\t', _qualisys),
        (VICON_SECTION, _vicon),
    ):
        if re.match(beginning, data[:1000].lstrip()):
            return read(path, data)
    return None


def rows_of(data: bytes, export: Export) -> bytes:
    """Return the rows of an export between commas, on the lines on which they were."""
    above = data.count(b'\n', 0, export.start)
    rows = re.sub(rb'[;\t]', b',', data[export.start : export.end].replace(b'\r', b''))
    rows = TIMECODE.sub(b'', rows)
    return b'\n' * above + re.sub(rb',(?=\n|\Z)', b',nan', rows)  # what is hidden has no numbers


def _lines(data: bytes, start: int = 0) -> Iterator[tuple[list[str], int]]:
    """Yield the cells of each line, and where the next one begins."""
    while start < len(data):
        end = data.find(b'\n', start) + 1 or len(data)
        line = data[start:end].strip(b'\r\n')
        yield [cell.decode(errors='replace').strip() for cell in SEPARATOR.split(line)], end
        start = end


VICON_SECTION = (
    rb'(?m)^[ \t\r]*(Objects|Segments|Trajectories|Joints|Model Outputs|Devices)'
    rb'(?:[,; \t\r]*\n)+[ \t\r]*\d+(?:\.\d*)?[,; \t\r]*\n'
)
VICON_AXES = (('TX', 'TY', 'TZ'), ('X', 'Y', 'Z'))


def _vicon(path: Path, data: bytes) -> Export:
    """Return the first section of poses: rate, names, columns and units stand above its rows."""
    section = _vicon_section(path, data)
    above, columns, units, start = _vicon_preamble(path, data, section.start())
    groups = _groups(columns)
    names = [cell for row in above[2:] for cell in row if cell and not _is_rotation_kind(cell)]
    if len(names) != len(groups):
        names = [str(number) for number in range(1, len(groups) + 1)]
    is_helical = 'helical' in ' '.join(cell for row in above for cell in row).lower()
    bodies = tuple(
        body
        for name, group in zip(names, groups, strict=True)
        if (body := _vicon_body(name, group, is_helical)) is not None
    )
    end = re.compile(rb'\n[,;\t \r]*\n').search(data, start)
    has_angles = any('RX' in group for group in groups)
    is_left_out = has_angles and not any(body.orientation for body in bodies)
    return Export(
        system='Vicon',
        start=start,
        end=end.start() + 1 if end else len(data),
        bodies=bodies,
        metres=METRES.get(units[bodies[0].position[0]]) if bodies else None,
        rate_hz=_number(above[1][0]),
        frames=(0, 1),
        degrees=has_angles and units[columns.index('RX')] == 'deg',
        notes=(ORIENTATIONS_LEFT_OUT.format('helical angles or quaternions'),) * is_left_out,
    )


def _vicon_section(path: Path, data: bytes) -> re.Match[bytes]:
    """Return where the first section begins that has poses or positions."""
    sections = list(re.finditer(VICON_SECTION, data))
    for section in sections:
        if section[1] in (b'Objects', b'Segments', b'Trajectories'):
            return section
    what = sections[0][1].decode().lower()
    raise ReadError(path, f'this is a Vicon export of {what}, which have no poses; export objects')


def _vicon_preamble(
    path: Path, data: bytes, begin: int
) -> tuple[list[list[str]], list[str], list[str], int]:
    """Return the rows above the names of columns, those, their units, and where rows begin."""
    above: list[list[str]] = []
    lines = islice(_lines(data, begin), LONGEST_PREAMBLE)
    for cells, start in lines:
        if cells[0].lower() == 'frame':
            units, after = next(lines, ([''], start))
            if re.fullmatch(r'\d+', units[0]):
                units, after = [], start
            padded = [unit.lower() for unit in units] + [''] * len(cells)
            return above, [cell.upper() for cell in cells], padded, after
        above.append(cells)
    raise ReadError(
        path, 'this is a Vicon export without its row of columns: Frame,Sub Frame,RX,...'
    )


ORIENTATIONS_LEFT_OUT = (
    'only positions are read, since the export does not say how its angles are meant; export '
    'orientations as {}'
)


def _is_rotation_kind(cell: str) -> bool:
    """Return whether a cell among the names says what the angles are: Global Angle (Helical)."""
    return bool(re.search(r'(?i)\b(global|local) (angle|rotation)|helical|euler|quaternion', cell))


def _groups(columns: list[str]) -> list[dict[str, int]]:
    """Return the columns of each object by name; a name that repeats begins the next one."""
    groups: list[dict[str, int]] = []
    for column, name in enumerate(columns[2:], 2):
        if name and (not groups or name in groups[-1]):
            groups.append({})
        if name:
            groups[-1][name] = column
    return groups


def _vicon_body(name: str, group: dict[str, int], is_helical: bool) -> Body | None:
    """Return an object whose columns have names; None where it has no position."""
    for axes in VICON_AXES:
        if all(axis in group for axis in axes):
            position = tuple(group[axis] for axis in axes)
            turns = ('RX', 'RY', 'RZ', 'RW') if 'RW' in group else ('RX', 'RY', 'RZ')
            is_known = 'RW' in group or is_helical
            if is_known and all(turn in group for turn in turns):
                return Body(name, position, tuple(group[turn] for turn in turns))
            return Body(name, position)
    return None


def _motive(path: Path, data: bytes) -> Export:
    """Return what the rows Type, Name, (ID, Parent,) property and axis say of the columns."""
    lines = [line for line in islice(_lines(data), LONGEST_PREAMBLE) if any(line[0])]
    facts = dict(zip(lines[0][0][::2], lines[0][0][1::2], strict=False))
    last = next((k for k, (cells, _) in enumerate(lines) if cells[0] == 'Frame'), 0)
    rows = [cells for cells, _ in lines[1:last]]
    if len(rows) < 3:
        raise ReadError(
            path, 'this is an export of Motive without the header of its columns; export it with'
        )
    axes, start = lines[last]
    columns: dict[tuple[str, ...], dict[tuple[str, ...], int]] = {}
    described = zip(rows[0], rows[1], rows[-1], axes, strict=False)
    for column, (kind, name, quantity, axis) in enumerate(described):
        columns.setdefault((kind, name), {}).setdefault((quantity, axis.upper()), column)
    is_quaternion = facts.get('Rotation Type', '').lower() == 'quaternion'
    of_type = {kind: _motive_bodies(columns, kind, is_quaternion) for kind in MOTIVE_TYPES}
    chosen = next((kind for kind in MOTIVE_TYPES if of_type[kind]), MOTIVE_TYPES[0])
    if chosen == 'Bone' and facts.get('Coordinate Space', 'Global').lower() != 'global':
        raise ReadError(path, 'its bones are relative to each other; export global coordinates')
    notes = [
        _counted_from('take', facts.get('Capture Start Time')),
        'y points up, unless the export changed that; --alignment posyaw needs z up',
    ]
    if chosen != 'Marker' and not is_quaternion:
        notes.append(ORIENTATIONS_LEFT_OUT.format('quaternions'))
    rate = facts.get('Export Frame Rate') or facts.get('Capture Frame Rate') or ''
    return Export(
        system='Motive',
        start=start,
        end=len(data),
        bodies=of_type[chosen],
        metres=METRES.get(facts.get('Length Units', '').lower()),
        rate_hz=_number(rate),
        time=axes.index('Time (Seconds)') if 'Time (Seconds)' in axes else None,
        notes=tuple(notes),
    )


#: what has poses in an export of Motive, the first that there is
MOTIVE_TYPES = ('Rigid Body', 'Bone', 'Marker')


def _motive_bodies(
    columns: dict[tuple[str, ...], dict[tuple[str, ...], int]], kind: str, is_quaternion: bool
) -> tuple[Body, ...]:
    """Return those of one type, given the columns of all by type and name, quantity and axis."""
    bodies = []
    for (of, name), found in columns.items():
        position = _all_of(found, 'Position', 'XYZ')
        if of == kind and position:
            turns = _all_of(found, 'Rotation', 'XYZW') if is_quaternion else ()
            bodies.append(Body(name, position, turns))
    return tuple(bodies)


def _all_of(found: dict[tuple[str, ...], int], quantity: str, axes: str) -> tuple[int, ...]:
    """Return the columns of all axes of a quantity; nothing where one is missing."""
    if any((quantity, axis) not in found for axis in axes):
        return ()
    return tuple(found[quantity, axis] for axis in axes)


def _counted_from(begin: str, at: str | None) -> str:
    """Return the sentence that says from when on stamps are counted."""
    told = f', {at} by the clock of the computer that recorded it' if at else ''
    return f'stamps count from the start of the {begin}{told}'


def _qualisys(path: Path, data: bytes) -> Export:
    """Return what the header says; columns are known by their number, 16 a body or 3 a marker."""
    facts: dict[str, list[str]] = {}
    start = 0
    lines = _lines(data)
    for cells, end in islice(lines, LONGEST_PREAMBLE):
        if re.fullmatch(r'-?\d+(?:\.\d*)?', cells[0]):
            break
        facts.setdefault(cells[0], [cell for cell in cells[1:] if cell])
        start = end
    columns = len(cells) - (cells[-1] == '')
    included = ''.join(facts.get('DATA_INCLUDED', []))
    names = facts.get('BODY_NAMES', []) if included == '6D' else facts.get('MARKER_NAMES', [])
    width = {'6D': 16, '3D': 3}.get(included, 0)
    before = columns - width * len(names)
    if not names or not width or before not in ((2,) if 'Frame' in facts else (0, 2)):
        raise ReadError(
            path,
            f'this is a Qualisys export of {included or "unknown data"} with {columns} columns; '
            'export 6D data as TSV with its header, and all columns of each body',
        )
    bodies = []
    for number, name in enumerate(names):
        first = before + number * width
        matrix = tuple(range(first + 7, first + 16)) if width == 16 else ()
        bodies.append(Body(name, (first, first + 1, first + 2), matrix))
    return Export(
        system='Qualisys',
        start=start,
        end=len(data),
        bodies=tuple(bodies),
        metres=0.001,
        rate_hz=_number(''.join(facts.get('FREQUENCY', [])[:1])),
        time=1 if before else None,
        notes=(_counted_from('measurement', ' '.join(facts.get('TIME_STAMP', [])[:1])),),
    )


def _number(text: str) -> float | None:
    """Return a number greater than zero, or None."""
    return float(text) if re.fullmatch(r'\d+(?:\.\d*)?', text) and float(text) > 0 else None
