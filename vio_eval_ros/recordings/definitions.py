"""
Where a message has its pose, by the definition of its type alone.

A pose is a field with a position (x y z) and an orientation (x y z w), with a translation and a
rotation, or with the numbers x y z and qx qy qz qw themselves. Types with one pose, or with one
list of them, need no line in a table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
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
DEEPEST = 6  # levels that are looked at: definitions may contain themselves
MOST_FIELDS = 10_000  # that are looked at: those of real messages are a few hundred


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
    :raises UnsupportedMessage: there is no pose, or several lists of poses, or the definition is
        too large to be searched.
    """
    types = _Types(source, msgtype, fields)
    places, lists = types.places(msgtype), types.lists(msgtype)
    oriented = bool(places or lists)
    places = places if oriented else types.positions(msgtype)
    _check_choice(source, msgtype, places, lists)
    # nearest to the pose, where there is only one
    stamps = types.stamp_paths(msgtype, places[0].path if len(places) == 1 else '')
    kind = 'pose' if oriented else 'position, without orientation,'
    notes = (
        f'{source}: {msgtype} is read by its definition: {_where(kind, places, lists, stamps)}',
    )

    def first_set(message: Any) -> int:
        """Return the nearest stamp that is not zero."""
        return next(filter(None, (stamp_ns(_get(message, path)) for path in stamps)), 0)

    stamp_of = first_set if stamps else None
    if not places:
        only, numbers = lists[0], lists[0].place.numbers
        by_index = not (only.name or only.names)
        return ArrayConverter(only.elements, numbers, stamp_of, notes, by_index=by_index)
    getters = [(one.path, one.numbers) for one in places]
    if len(places) > 1:
        return ArrayConverter(
            lambda message: ((path, (numbers, message)) for path, numbers in getters),
            lambda element: element[0](element[1]),
            stamp_of,
            notes,
        )
    numbers, name = getters[0][1], _text_name(fields(msgtype))
    if name:
        return ArrayConverter(
            lambda message: [(getattr(message, name), message)], numbers, stamp_of, notes
        )
    return Converter(
        lambda message: [(stamp_of(message) if stamp_of else 0, numbers(message))],
        is_stamped=bool(stamps),
        notes=notes,
    )


def _where(
    kind: str, places: Sequence[Place], lists: Sequence[PoseList], stamps: Sequence[str]
) -> str:
    """Return in words where a message has its poses and its stamp."""
    if places:
        poses = f'the {kind} is {" or ".join(one.path or "the message" for one in places)}'
    else:
        poses = f'the poses are in {lists[0].path}'
    named = ' or, where it is zero, '.join(stamps)
    return f'{poses}, {f"the stamp is {named}" if stamps else "it has no stamp"}'


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


class _Types:
    """
    The message types of a definition, each of which is searched once.

    :param fields: of each of them.
    """

    def __init__(self, source: str, msgtype: str, fields: Fields) -> None:
        self._source = source
        self._msgtype = msgtype
        self._fields = fields
        self._looked_at = 0
        # types are nested in each other, and asked for wherever they occur
        self._numbers_in = cache(self._numbers)
        self._pose_in = cache(self._pose)
        self._places_in = cache(self._places)
        self._below = cache(self._walk)

    def places(self, msgtype: str) -> list[Place]:
        """Return the poses in a message, but for those in lists."""
        return self._places_in(msgtype)

    def positions(self, msgtype: str) -> list[Place]:
        """Return the positions in a message."""
        found = []
        for path, field in self._below(msgtype):
            outer, _, name = path.rpartition('.')
            if name in POSITIONS and self._has(field, 'xyz'):
                found.append(Place(outer, _of(name, 'xyz')))
        return found

    def lists(self, msgtype: str) -> list[PoseList]:
        """Return the lists whose elements have one pose each."""
        found = []
        inside = self._fields(msgtype)
        beside = (name for name in ('name', 'names') if inside.get(name) == Field(TEXT, True))
        names = next(beside, '')
        for path, field in self._below(msgtype):
            if field.is_list and len(places := self._places_in(field.type)) == 1:
                name = _name_field(self._fields(field.type))
                found.append(PoseList(path, places[0], name, names))
        return found

    def stamp_paths(self, msgtype: str, path: str) -> list[str]:
        """Return the fields with seconds and nanoseconds around a path, the innermost first."""
        found, outer = [], ''
        for name in ['', *filter(None, path.split('.'))]:
            outer = f'{outer}.{name}'.strip('.')
            msgtype = self._fields(msgtype)[name].type if name else msgtype
            if stamp := self._stamp_path(msgtype):
                found.append(f'{outer}.{stamp}'.lstrip('.'))
        return found[::-1]

    def _walk(self, msgtype: str) -> list[tuple[str, Field]]:
        """Return all fields with their paths, level by level; not those of lists and of poses."""
        found, level = [], [('', msgtype)]
        for _ in range(DEEPEST):
            below = []
            for path, name in level:
                if self._pose_in(name):
                    continue
                for field, kind in self._fields(name).items():
                    self._count()
                    inner = f'{path}.{field}' if path else field
                    found.append((inner, kind))
                    if not kind.is_list:
                        below.append((inner, kind.type))
            level = below
        return found

    def _count(self) -> None:
        """Raise ``UnsupportedMessage`` where more fields are looked at than there may be."""
        self._looked_at += 1
        if self._looked_at > MOST_FIELDS:
            raise UnsupportedMessage(
                self._source,
                f'{self._msgtype} is not read: its definition nests more than {MOST_FIELDS} '
                'fields; publish its pose as PoseStamped or Odometry',
            )

    def _numbers(self, msgtype: str) -> frozenset[str]:
        """Return the fields of a type that are one number."""
        fields = self._fields(msgtype).items()
        return frozenset(name for name, kind in fields if kind == Field(NUMBER))

    def _has(self, field: Field | None, components: str) -> bool:
        """Return whether a field is a vector or quaternion with these components."""
        if field is None or field.is_list:
            return False
        numbers = self._numbers_in(field.type)
        return numbers >= set(components) and ('w' in components or 'w' not in numbers)

    def _pose(self, msgtype: str) -> tuple[str, ...]:
        """Return the numbers of a type that is a pose; none where it is not one."""
        inside = self._fields(msgtype)
        for position, orientation in POSES:
            both = inside.get(position), inside.get(orientation)
            if self._has(both[0], 'xyz') and self._has(both[1], 'xyzw'):
                return (*_of(position, 'xyz'), *_of(orientation, 'xyzw'))
        turned = [field for field, kind in inside.items() if self._has(kind, 'xyzw')]
        moved = [field for field, _ in POSES if self._has(inside.get(field), 'xyz')]
        if len(turned) == len(moved) == 1:
            return (*_of(moved[0], 'xyz'), *_of(turned[0], 'xyzw'))
        return FLAT if self._numbers_in(msgtype).issuperset(FLAT) else ()

    def _places(self, msgtype: str) -> list[Place]:
        if numbers := self._pose_in(msgtype):
            return [Place('', numbers)]
        return [
            Place(path, numbers)
            for path, field in self._below(msgtype)
            if not field.is_list and (numbers := self._pose_in(field.type))
        ]

    def _stamp_path(self, msgtype: str) -> str:
        """Return the field with seconds and nanoseconds; '' where there is none."""
        inside = self._fields(msgtype)
        header = self._fields(inside['header'].type) if 'header' in inside else {}
        candidates = [(f'header.{name}', header.get(name)) for name in STAMPS]
        candidates += [(name, inside.get(name)) for name in STAMPS]
        for path, field in candidates:
            parts = self._fields(field.type).keys() if field else set()
            if parts & SECONDS and parts & NANOSECONDS:
                return path
        return ''


def _of(vector: str, components: str) -> tuple[str, ...]:
    return tuple(f'{vector}.{component}' for component in components)


def _name_field(inside: Mapping[str, Field]) -> str:
    """Return which of its fields tells elements apart; '' where none does."""
    return _text_name(inside) or ('id' if inside.get('id') == Field(NUMBER) else '')


def _text_name(inside: Mapping[str, Field]) -> str:
    """Return the text among fields that names what has them; '' where there is none."""
    texts = (name for name, field in inside.items() if field == Field(TEXT))
    return next((name for name in texts if name in NAMES or name.endswith('_name')), '')
