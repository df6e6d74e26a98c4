"""
Mcap files, read with the mcap library.

It is as fast as rosbags there, and reads what that refuses: another profile than ros2, as
converted and merged files have; topics that are not ROS's; files without an index whose messages
are out of order, as rosbag2's fastwrite preset may leave them.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import ExitStack
from io import SEEK_END
from itertools import chain
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, SeekingReader
import mcap.records
from mcap.records import ChunkIndex, Schema
from mcap.summary import Summary

from vio_eval_ros.recordings.mcap_internals import chunk_messages
from vio_eval_ros.recordings.rosbags_internals import profiles_in
from vio_eval_ros.recordings.storage import (
    Channel,
    Definition,
    merged,
    OfferedQos,
    Recorded,
    rooted,
    spelled,
)

MAGIC = b'\x89MCAP0\r\n'  # begins and ends a file


class McapStorage:
    """An mcap file; front to back where it has no full index."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self.warnings: list[str] = []
        self._stream = stack.enter_context(path.open('rb'))
        reader = SeekingReader(self._stream, validate_crcs=True)
        self._stream.seek(-len(MAGIC), SEEK_END)
        if self._stream.read() != MAGIC:
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
            self._channels[key] = Channel(
                rooted(record.topic),
                spelled(schema.name),
                counts[key],
                record.message_encoding,
                Definition(schema.encoding, schema.data),
            )
        self.channels = list(self._channels.values())

    def offers(self) -> dict[str, list[OfferedQos]]:
        """Return what the publishers of each topic offered."""
        offers: dict[str, list[OfferedQos]] = defaultdict(list)
        for record in self._records.values():
            profiles = profiles_in(record.metadata.get('offered_qos_profiles', ''))
            offers[rooted(record.topic)] += map(OfferedQos.of, profiles)
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
