"""
Where a message has its pose, by the definition of its type alone.

A pose is a field with a position (x y z) and an orientation (x y z w), with a translation and a
rotation, or with the numbers x y z and qx qy qz qw themselves. Types with one pose, or with one
list of them, need no line in a table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import islice
from operator import attrgetter
from typing import Any, NamedTuple

from vio_eval_ros.errors import UnsupportedMessage
from vio_eval_ros.recordings.messages import (
    ArrayConverter,
    Converter,
    Numbers,
    stamp_ns,
)

TEXT, NUMBER = 'text', 'number'
#: the fields that make a pose, of which the second may have any name where no other is like it,
#: and those that are a position
POSES = (('position', 'orientation'), ('translation', 'rotation'))
POSITIONS = ('position', 'point', 'translation')
NAMES = ('name', 'id', 'label', 'child_frame_id')
FLAT = ('x', 'y', 'z', 'qx', 'qy', 'qz', 'qw')
STAMPS = ('stamp', 'timestamp', 'time')
SECONDS, NANOSECONDS = {'sec', 'seconds'}, {'nanosec', 'nsec', 'nanos'}
DEEPEST, MOST_FIELDS = 6, 1000  # that are looked at: definitions may contain themselves


class Field(NamedTuple):
    """
    A field of a message.

    :param type: TEXT, NUMBER or the name of a message type.
    """

    type: str
    is_list: bool = False


# From the name of a message type to its fields; to none where it is not known.
Fields = Callable[[str], Mapping[str, Field]]


class Place(NamedTuple):
    """
    Where a message or an element of a list has a pose.

    :param path: names of fields joined by dots; '' where it is one itself.
    :param fields: below it, the x y z of its position and, if it has any, the x y z w of its
        orientation.
    """

    path: str
    fields: tuple[str, ...]

    @property
    def numbers(self) -> Callable[[Any], Numbers]:
        """What returns position and quaternion x y z w of a message."""
        return attrgetter(*(f'{self.path}.{field}'.lstrip('.') for field in self.fields))


class PoseList(NamedTuple):
    """
    A list of poses in a message.

    :param path: of the list.
    :param place: where each of its elements has the pose.
    :param name: where an element has its name; '' where it has none.
    :param names: the list of their names beside it; '' where there is none.
    """

    path: str
    place: Place
    name: str
    names: str

    def elements(self, message: Any) -> Iterable[tuple[str, Any]]:
        """Yield the elements with their names or, where they have none, with their indices."""
        listed = _get(message, self.path)
        if self.names:
            return zip(map(str, _get(message, self.names)), listed, strict=True)
        if self.name:
            return ((str(getattr(one, self.name)), one) for one in listed)
        return ((str(k), one) for k, one in enumerate(listed))


def converter_of(source: str, msgtype: str, fields: Fields) -> Converter | ArrayConverter:
    """
    Return how the poses in messages of a type are read.

    Of several poses in a message, each is an element named by its path. One pose of a body with a
    name is an element too: the messages of several bodies may come on one topic.

    :param source: what notes and errors name.
    :raises UnsupportedMessage: there is no pose, or several lists of poses.
    """
    places, lists = _places(msgtype, fields), _lists(msgtype, fields)
    oriented = bool(places or lists)
    places = places if oriented else _positions(msgtype, fields)
    _check_choice(source, msgtype, places, lists)
    # nearest to the pose, where there is only one
    stamps = _stamp_paths(msgtype, places[0].path if len(places) == 1 else '', fields)
    if places:
        where = f'is {" or ".join(one.path or "the message" for one in places)}'
        where = f'the {"pose" if oriented else "position, without orientation,"} {where}'
    else:
        where = f'the poses are in {lists[0].path}'
    named = ' or, where it is zero, '.join(stamps)
    when = f'the stamp is {named}' if stamps else 'it has no stamp'
    note = f'{source}: {msgtype} is read by its definition: {where}, {when}'

    def first_set(message: Any) -> int:
        """Return the nearest stamp that is not zero."""
        return next(filter(None, (stamp_ns(_get(message, path)) for path in stamps)), 0)

    stamp_of = first_set if stamps else None
    if not places:
        only = lists[0]
        return ArrayConverter(
            only.elements,
            only.place.numbers,
            stamp_of,
            (note,),
            by_index=not (only.name or only.names),
        )
    getters = [(one.path, one.numbers) for one in places]
    if len(places) > 1:
        return ArrayConverter(
            lambda message: ((path, (numbers, message)) for path, numbers in getters),
            lambda element: element[0](element[1]),
            stamp_of,
            (note,),
        )
    numbers, name = getters[0][1], _text_name(fields(msgtype))
    if name:
        return ArrayConverter(
            lambda message: [(getattr(message, name), message)], numbers, stamp_of, (note,)
        )
    return Converter(
        lambda message: [(stamp_of(message) if stamp_of else 0, numbers(message))],
        is_stamped=bool(stamps),
        notes=(note,),
    )


def _check_choice(
    source: str, msgtype: str, places: Sequence[Place], lists: Sequence[PoseList]
) -> None:
    """Raise ``UnsupportedMessage`` where there is no pose, or several lists of poses."""
    if places or len(lists) == 1:
        return
    if not lists:
        raise UnsupportedMessage(
            source,
            f'{msgtype} is not read: no field of it has a position (x y z) and an orientation '
            '(x y z w); publish it as PoseStamped or Odometry',
        )
    listed = ', '.join(one.path for one in lists)
    raise UnsupportedMessage(
        source,
        f'{msgtype} is not read: it has several lists of poses ({listed}); publish one of '
        'them as a PoseArray',
    )


def _get(message: Any, path: str) -> Any:
    return attrgetter(path)(message) if path else message


def _walk(msgtype: str, fields: Fields) -> Iterator[tuple[str, Field]]:
    """Yield all fields with their paths, level by level; not those of lists and of poses."""
    level = [('', msgtype)]
    for _ in range(DEEPEST):
        below = []
        for path, name in level:
            if _pose_fields(name, fields):
                continue
            for field, kind in fields(name).items():
                inner = f'{path}.{field}' if path else field
                yield inner, kind
                if not kind.is_list:
                    below.append((inner, kind.type))
        level = below


def _fields_in(msgtype: str, fields: Fields) -> Iterator[tuple[str, Field]]:
    return islice(_walk(msgtype, fields), MOST_FIELDS)


def _pose_fields(name: str, fields: Fields) -> tuple[str, ...]:
    """Return the numbers of a type that is a pose; none where it is not one."""
    inside = fields(name)
    for position, orientation in POSES:
        both = inside.get(position), inside.get(orientation)
        if _has(both[0], 'xyz', fields) and _has(both[1], 'xyzw', fields):
            return (*_of(position, 'xyz'), *_of(orientation, 'xyzw'))
    turned = [field for field, kind in inside.items() if _has(kind, 'xyzw', fields)]
    moved = [field for field, _ in POSES if _has(inside.get(field), 'xyz', fields)]
    if len(turned) == len(moved) == 1:
        return (*_of(moved[0], 'xyz'), *_of(turned[0], 'xyzw'))
    return FLAT if all(inside.get(number) == Field(NUMBER) for number in FLAT) else ()


def _of(vector: str, components: str) -> tuple[str, ...]:
    return tuple(f'{vector}.{component}' for component in components)


def _has(field: Field | None, components: str, fields: Fields) -> bool:
    """Return whether a field is a vector or quaternion with these components."""
    if field is None or field.is_list:
        return False
    numbers = {name for name, kind in fields(field.type).items() if kind == Field(NUMBER)}
    return numbers >= set(components) and ('w' in components or 'w' not in numbers)


def _places(msgtype: str, fields: Fields) -> list[Place]:
    """Return the poses in a message, but for those in lists."""
    if numbers := _pose_fields(msgtype, fields):
        return [Place('', numbers)]
    return [
        Place(path, numbers)
        for path, field in _fields_in(msgtype, fields)
        if not field.is_list and (numbers := _pose_fields(field.type, fields))
    ]


def _positions(msgtype: str, fields: Fields) -> list[Place]:
    """Return the positions in a message."""
    found = []
    for path, field in _fields_in(msgtype, fields):
        outer, _, name = path.rpartition('.')
        if name in POSITIONS and _has(field, 'xyz', fields):
            found.append(Place(outer, _of(name, 'xyz')))
    return found


def _lists(msgtype: str, fields: Fields) -> list[PoseList]:
    """Return the lists whose elements have one pose each."""
    found = []
    texts = {path: field for path, field in fields(msgtype).items() if field == Field(TEXT, True)}
    for path, field in _fields_in(msgtype, fields):
        if not field.is_list:
            continue
        places = _places(field.type, fields)
        if len(places) == 1:
            beside = next((name for name in ('name', 'names') if name in texts), '')
            found.append(PoseList(path, places[0], _name_field(field.type, fields), beside))
    return found


def _name_field(msgtype: str, fields: Fields) -> str:
    """Return the field that tells elements of a type apart; '' where there is none."""
    inside = fields(msgtype)
    return _text_name(inside) or ('id' if inside.get('id') == Field(NUMBER) else '')


def _text_name(inside: Mapping[str, Field]) -> str:
    """Return the text among fields that names what has them; '' where there is none."""
    texts = (name for name, field in inside.items() if field == Field(TEXT))
    return next((name for name in texts if name in NAMES or name.endswith('_name')), '')


def _stamp_paths(msgtype: str, path: str, fields: Fields) -> list[str]:
    """Return the fields with seconds and nanoseconds around a path, the innermost first."""
    found, outer = [], ''
    for name in ['', *filter(None, path.split('.'))]:
        outer = f'{outer}.{name}'.strip('.')
        msgtype = fields(msgtype)[name].type if name else msgtype
        if stamp := _stamp_path(msgtype, fields):
            found.append(f'{outer}.{stamp}'.lstrip('.'))
    return found[::-1]


def _stamp_path(msgtype: str, fields: Fields) -> str:
    """Return the field with seconds and nanoseconds; '' where there is none."""
    inside = fields(msgtype)
    header = fields(inside['header'].type) if 'header' in inside else {}
    candidates = [(f'header.{name}', header.get(name)) for name in STAMPS]
    candidates += [(name, inside.get(name)) for name in STAMPS]
    for path, field in candidates:
        parts = fields(field.type).keys() if field else set()
        if parts & SECONDS and parts & NANOSECONDS:
            return path
    return ''
