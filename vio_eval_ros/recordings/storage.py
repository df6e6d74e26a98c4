"""
What recordings of all kinds consist of: topics, the definitions of their messages, and bytes.

Each kind of storage file is read in a module of its own, which has the three functions that
``Storage`` names.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
import heapq
from itertools import chain
from operator import itemgetter
import re
from typing import Any, NamedTuple, Protocol

from rosbags.interfaces import Nodetype, Qos, QosDurability, QosHistory, QosReliability
from rosbags.typesys import get_types_from_idl, get_types_from_msg, get_typestore, Stores

from vio_eval_ros.recordings.rosbags_internals import Typestore


class Definition(NamedTuple):
    """
    How a storage file defines a message type.

    :param encoding: such as 'ros1msg', 'ros2msg', 'ros2idl', 'jsonschema' or 'protobuf'; '' where
        nothing is stored.
    :param data: as it is stored.
    """

    encoding: str = ''
    data: bytes = b''


@dataclass(frozen=True, eq=False)
class Channel:
    """
    A topic in one storage file.

    :param topic: with a leading slash, which is optional in ROS 1.
    :param msgtype: the type as ROS 2 spells it, in ROS 1 recordings too.
    :param encoding: of its messages: 'cdr' or 'ros1', in an mcap also 'json', 'protobuf' ...
    :param definition: of the message type, as the file stores it.
    """

    topic: str
    msgtype: str
    count: int
    encoding: str
    definition: Definition = field(default=Definition(), repr=False)

    def types(self) -> Typestore:
        """
        Return the message type as the file defines it, or the standard one where it does not.

        Types that a definition uses without defining them are the standard ones.

        :raises RefusedError: a definition that cannot be read, such as that of a service.
        """
        standard = standard_types(ros1=self.encoding == 'ros1')
        encoding, data = self.definition
        if not data.strip() or encoding not in ('ros1msg', 'ros2msg', 'ros2idl'):
            return standard
        text = data.decode(errors='replace')  # such as names and degrees in comments
        types = get_typestore(Stores.EMPTY)
        try:
            is_idl = encoding == 'ros2idl'
            defined = _types_of_idl(text) if is_idl else get_types_from_msg(text, self.msgtype)
            types.register(_completed(defined, standard))
        except Exception as error:  # of rosbags, anything
            lines = str(error).splitlines()
            # of the parser: what it parsed, and at which character it ended, before the rest
            where = f' from {lines[3][:40]!r} on' if len(lines) > 3 else f' ({"".join(lines[:1])})'
            raise RefusedError(
                f'has a definition of {self.msgtype} that cannot be read{where}'
            ) from error
        return types


# When a message was recorded [ns], its channel and its bytes.
Recorded = tuple[int, Channel, bytes]


@dataclass(frozen=True)
class OfferedQos:
    """
    The QoS that the publishers of a topic offered when it was recorded.

    :param reliable: lost messages are sent again.
    :param latched: late subscribers get the last messages ('transient local').
    :param depth: of the queue; 0 where it is not known.
    :param publishers: how many there were.
    """

    reliable: bool = True
    latched: bool = False
    depth: int = 0
    publishers: int = 1

    @classmethod
    def of(cls, profile: Qos) -> OfferedQos:
        """Return the offer in a recorded profile; the default for what is unknown there."""
        return cls(
            profile.reliability != QosReliability.BEST_EFFORT,
            profile.durability == QosDurability.TRANSIENT_LOCAL,
            profile.depth if profile.history == QosHistory.KEEP_LAST else 0,
        )

    @classmethod
    def common(cls, offers: Sequence[OfferedQos]) -> OfferedQos:
        """Return what all publishers of a topic offered."""
        return cls(
            all(offer.reliable for offer in offers),
            bool(offers) and all(offer.latched for offer in offers),
            max((offer.depth for offer in offers), default=0),
            max(len(offers), 1),
        )


class Storage(Protocol):
    """
    An open storage file.

    ``channels`` lists its topics, ``span_ns`` is when the first and the last message were
    recorded (None without messages), and ``warnings`` has what a user should know of it.
    """

    channels: list[Channel]
    span_ns: tuple[int, int] | None
    warnings: list[str]

    def offers(self) -> dict[str, list[OfferedQos]]:
        """Return what the publishers of each topic offered."""
        ...

    def messages(
        self, names: set[str], begin_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Recorded]:
        """Yield the messages of topics in the order of time, both ends included."""
        ...

    def as_written(self, names: set[str]) -> Iterator[Recorded]:
        """Yield the messages of topics in the order of the file."""
        ...


class RefusedError(Exception):
    """A storage file that is not damaged, but cannot be read; the text says what to do."""


def merged(parts: Iterable[tuple[int, Iterable[Recorded]]]) -> Iterator[Recorded]:
    """
    Yield the messages of several parts in the order of time; of equal times, as the parts come.

    :param parts: of each, the time [ns] before which it has no message, and its messages, in the
        order of time. Those are not asked for before that time is due.
    """
    streams = (chain([(first_ns, None, b'')], messages) for first_ns, messages in parts)
    for log_ns, channel, raw in heapq.merge(*streams, key=itemgetter(0)):
        if channel is not None:
            yield log_ns, channel, raw


@cache
def standard_types(*, ros1: bool) -> Typestore:
    """Return the message definitions of ROS 1 Noetic or ROS 2 Jazzy."""
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)


def rooted(topic: str) -> str:
    """Return the topic with a leading slash, which is optional in ROS 1, and none twice."""
    return '/' + '/'.join(part for part in topic.split('/') if part)


def spelled(msgtype: str) -> str:
    """
    Return the name of a message type as ROS 2 spells it.

    ROS 1 and the first releases of ROS 2 write nav_msgs/Odometry, and recorders that listen to DDS
    itself nav_msgs::msg::dds_::Odometry_.
    """
    if found := re.fullmatch(r'(\w+)::(\w+)::dds_::(\w+)_', msgtype):
        return '/'.join(found.groups())
    return msgtype.replace('/', '/msg/') if msgtype.count('/') == 1 else msgtype


def _types_of_idl(text: str) -> dict[str, Any]:
    """
    Return definitions in IDL: several, each under a title, as rosbag2 joins them.

    rosbags does not know of ``#include``, which is of no use where all is in one text.
    """
    types: dict[str, Any] = {}
    without = re.sub(r'^#.*\n', '', text, flags=re.MULTILINE)
    for part in re.split(r'^=+\n(?:IDL: .*\n)?', without, flags=re.MULTILINE):
        types |= get_types_from_idl(part) if part.strip() else {}
    return types


def _completed(defined: dict[str, Any], standard: Typestore) -> dict[str, Any]:
    """Return definitions together with the standard ones that they lead to and lack."""
    complete, open_ends = dict(defined), [*defined.values()]
    while open_ends:
        _, fields = open_ends.pop()
        for _, (kind, of) in fields:
            nested, name = of[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, of)
            if nested == Nodetype.NAME and name not in complete:
                if name not in standard.fielddefs:
                    raise ValueError(f'it nests {name}, which it does not define')
                complete[name] = standard.fielddefs[name]
                open_ends.append(complete[name])
    return complete
