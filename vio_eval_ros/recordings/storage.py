"""
The files that recordings consist of, each read with a library.

An mcap is read with the mcap library: it is as fast as rosbags there, and reads what that refuses
(another profile than ros2, as converted and merged files have; topics that are not ROS's; files
without an index whose messages are out of order, as rosbag2's fastwrite preset may leave them).
Everything else is read with rosbags.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cache
import heapq
from io import SEEK_END
from itertools import chain
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any, NamedTuple

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, SeekingReader
import mcap.records
from mcap.records import ChunkIndex, Schema
from mcap.summary import Summary
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    MessageDefinition,
    MessageDefinitionFormat,
    Qos,
    QosDurability,
    QosHistory,
    QosReliability,
)
from rosbags.typesys import get_types_from_idl, get_types_from_msg, get_typestore, Stores

from vio_eval_ros.recordings.mcap_internals import chunk_messages
from vio_eval_ros.recordings.rosbags_internals import profiles_in, Typestore

MCAP_MAGIC = b'\x89MCAP0\r\n'  # begins and ends a file


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

    :param msgtype: the type as ROS 2 spells it, in ROS 1 recordings too.
    :param encoding: of its messages: 'cdr' or 'ros1', in an mcap also 'json', 'protobuf' ...
    :param definition: of the message type, as the file stores it.
    """

    topic: str
    msgtype: str
    count: int
    encoding: str
    storage: Storage = field(repr=False)
    definition: Definition = field(default=Definition(), repr=False)

    def types(self) -> Typestore:
        """
        Return the message type as the file defines it, or the standard one where it does not.

        What rosbags raises where the definition is damaged passes through.
        """
        encoding, data = self.definition
        if not data.strip() or encoding not in ('ros1msg', 'ros2msg', 'ros2idl'):
            return standard_types(self.encoding == 'ros1')
        text, types = data.decode(), get_typestore(Stores.EMPTY)
        types.register(
            types_of_idl(text) if encoding == 'ros2idl' else get_types_from_msg(text, self.msgtype)
        )
        return types


# When a message was recorded [ns], its channel and its bytes.
Recorded = tuple[int, Channel, bytes]


@dataclass(frozen=True)
class OfferedQos:
    """
    The QoS that the publisher of a topic offered when it was recorded.

    :param reliable: lost messages are sent again.
    :param latched: late subscribers get the last messages ('transient local').
    :param depth: of the queue; 0 where it is not known.
    """

    reliable: bool = True
    latched: bool = False
    depth: int = 0

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
        )


class RosbagsStorage:
    """A ROS 1 bag, an SQLite file or a compressed folder, read with rosbags."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self.path = path
        self._reader = stack.enter_context(
            AnyReader([path], default_typestore=standard_types(ros1=False))
        )
        self._channels = {
            id(connection): Channel(
                _rooted(connection.topic),
                connection.msgtype,
                connection.msgcount,
                getattr(connection.ext, 'serialization_format', 'ros1'),
                self,
                self._definition(connection.msgdef),
            )
            for connection in self._reader.connections
        }

    def _definition(self, stored: MessageDefinition) -> Definition:
        if stored.format == MessageDefinitionFormat.NONE:
            return Definition()
        version = 2 if self._reader.is2 else 1
        return Definition(f'ros{version}{stored.format.name.lower()}', stored.data.encode())

    @property
    def channels(self) -> list[Channel]:
        """The topics of the file."""
        return list(self._channels.values())

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """When the first and the last message were recorded; None without messages."""
        if not any(channel.count for channel in self.channels):
            return None
        return self._reader.start_time, self._reader.end_time - 1  # rosbags excludes the end

    def offers(self) -> dict[str, list[OfferedQos]]:
        """Return what the publishers of each topic offered."""
        offers: dict[str, list[OfferedQos]] = defaultdict(list)
        for connection in self._reader.connections:
            extension: Any = connection.ext
            offers[_rooted(connection.topic)] += (
                [OfferedQos.of(profile) for profile in extension.offered_qos_profiles]
                if self._reader.is2
                else [OfferedQos(latched=bool(extension.latching))]
            )
        return offers

    def messages(
        self, names: set[str], begin_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Recorded]:
        """Yield the messages of topics in the order of time, both ends included."""
        wanted = [one for one in self._reader.connections if _rooted(one.topic) in names]
        stop_ns = None if end_ns is None else end_ns + 1
        if wanted:  # to rosbags, none means all
            for connection, log_ns, raw in self._reader.messages(wanted, begin_ns, stop_ns):
                yield log_ns, self._channels[id(connection)], raw

    def as_written(self, names: set[str]) -> Iterator[Recorded]:
        """Yield the messages of topics; rosbags knows no other order than that of time."""
        return self.messages(names)


class McapStorage:
    """An mcap file, read with the mcap library; front to back where it has no full index."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self.path = path
        self._stream = stack.enter_context(path.open('rb'))
        reader = SeekingReader(self._stream, validate_crcs=True)
        self._stream.seek(-len(MCAP_MAGIC), SEEK_END)
        if self._stream.read() != MCAP_MAGIC:
            raise McapError('its end is missing')
        summary = reader.get_summary() or Summary()
        #: in the order of the file; None where there is no full index
        self._index: list[ChunkIndex] | None = None
        if summary.channels and all(
            channel.schema_id in (0, *summary.schemas) for channel in summary.channels.values()
        ):
            by_offset = attrgetter('chunk_start_offset')
            self._index = sorted(summary.chunk_indexes, key=by_offset) or None
        counts = self._survey(summary)
        self._records = dict(summary.channels)
        self._channels: dict[int, Channel] = {}
        for key, record in summary.channels.items():
            schema = summary.schemas.get(record.schema_id) or Schema(0, b'', '', '')
            # ROS 1 writes nav_msgs/Odometry
            is_ros1 = schema.name.count('/') == 1
            msgtype = schema.name.replace('/', '/msg/') if is_ros1 else schema.name
            self._channels[key] = Channel(
                _rooted(record.topic),
                msgtype,
                counts[key],
                record.message_encoding,
                self,
                Definition(schema.encoding, schema.data),
            )

    @property
    def channels(self) -> list[Channel]:
        """The topics of the file."""
        return list(self._channels.values())

    def offers(self) -> dict[str, list[OfferedQos]]:
        """Return what the publishers of each topic offered."""
        offers: dict[str, list[OfferedQos]] = defaultdict(list)
        for record in self._records.values():
            profiles = profiles_in(record.metadata.get('offered_qos_profiles', ''))
            offers[_rooted(record.topic)] += map(OfferedQos.of, profiles)
        return offers

    def messages(
        self, names: set[str], begin_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Recorded]:
        """
        Yield the messages of topics in the order of time, both ends included.

        Those of a file without an index come in the order of the file.
        """
        begin = float('-inf') if begin_ns is None else begin_ns
        end = float('inf') if end_ns is None else end_ns
        if self._index is None:
            ordered = self._front_to_back(names)
        else:
            ordered = merged(
                (index.message_start_time, self._sorted_chunk(index, names))
                for index in self._chunks(names)
                if index.message_start_time <= end and index.message_end_time >= begin
            )
        return (message for message in ordered if begin <= message[0] <= end)

    def as_written(self, names: set[str]) -> Iterator[Recorded]:
        """Yield the messages of topics in the order of the file, a chunk in memory at a time."""
        if self._index is None:
            return self._front_to_back(names)
        return chain.from_iterable(self._chunk(index, names) for index in self._chunks(names))

    def _survey(self, summary: Summary) -> Counter[int]:
        """Find the span; return the messages of each channel, and complete the summary."""
        counts: Counter[int] = Counter()
        self.span_ns: tuple[int, int] | None = None
        if self._index is None:
            for schema, channel, message in self._all_records():
                counts[channel.id] += 1
                summary.channels[channel.id] = channel
                summary.schemas[channel.schema_id] = schema
                first, last = self.span_ns or (message.log_time, message.log_time)
                self.span_ns = min(first, message.log_time), max(last, message.log_time)
            return counts
        if filled := [index for index in self._index if index.message_end_time]:
            self.span_ns = (
                min(index.message_start_time for index in filled),
                max(index.message_end_time for index in filled),
            )
        if summary.statistics:
            counts.update(summary.statistics.channel_message_counts)
        else:
            for index in self._index:
                for message in chunk_messages(self._stream, index):
                    counts[summary.channels[message.channel_id].id] += 1
        return counts

    def _chunks(self, names: set[str]) -> Iterator[ChunkIndex]:
        """Yield the chunks that may have messages of topics, in the order of the file."""
        wanted = {key for key, channel in self._channels.items() if channel.topic in names}
        for index in self._index or ():
            # offsets may be left out; then only the chunk itself shows what is in it
            if not index.message_index_offsets or wanted & index.message_index_offsets.keys():
                yield index

    def _chunk(self, index: ChunkIndex, names: set[str]) -> list[Recorded]:
        """Return the messages of topics in a chunk, in the order of the file."""
        found = (
            (message.log_time, self._channels[message.channel_id], message.data)
            for message in chunk_messages(self._stream, index)
        )
        return [message for message in found if message[1].topic in names]

    def _sorted_chunk(self, index: ChunkIndex, names: set[str]) -> Iterator[Recorded]:
        """Yield the messages of topics in a chunk in the order of time; read when begun."""
        yield from sorted(self._chunk(index, names), key=itemgetter(0))

    def _front_to_back(self, names: set[str]) -> Iterator[Recorded]:
        """Yield the messages of topics in the order of the file, without an index."""
        for _, record, message in self._all_records():
            channel = self._channels[record.id]
            if channel.topic in names:
                yield message.log_time, channel, message.data

    def _all_records(self) -> Iterator[tuple[Any, mcap.records.Channel, mcap.records.Message]]:
        self._stream.seek(0)
        reader = NonSeekingReader(self._stream, validate_crcs=True)
        return reader.iter_messages(log_time_order=False)


Storage = RosbagsStorage | McapStorage


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
def standard_types(ros1: bool) -> Typestore:
    """Return the message definitions of ROS 1 Noetic or ROS 2 Jazzy."""
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)


def types_of_idl(text: str) -> dict[str, Any]:
    """Return the definitions in IDL, of which rosbag2 joins several as it does messages'."""
    types: dict[str, Any] = {}
    for part in text.split('=' * 80 + '\n'):
        title, _, rest = part.partition('\n')
        body = rest if title.startswith('IDL: ') else part
        types |= get_types_from_idl(body) if body.strip() else {}
    return types


def _rooted(topic: str) -> str:
    """Return the topic with a leading slash, which is optional in ROS 1."""
    return '/' + topic.lstrip('/')
