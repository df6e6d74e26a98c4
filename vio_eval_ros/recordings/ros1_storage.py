"""
ROS 1 bags, format 2.0 (https://wiki.ros.org/Bags/Format/2.0), read a chunk at a time.

A bag is a sequence of records, each a header of named fields and data. Messages are in chunks,
which may be compressed; the index at the end says which topics a chunk has and from when to when.
rosbags reads message by message instead, and decompresses a chunk again whenever two topics that
lie in different chunks alternate.
"""

from __future__ import annotations

import bz2
from collections import Counter, defaultdict, OrderedDict
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import chain
from operator import attrgetter, itemgetter
from os import SEEK_CUR, SEEK_END
from pathlib import Path
import struct
from typing import NamedTuple

import lz4.frame

from vio_eval_ros.recordings.storage import (
    Channel,
    Definition,
    merged,
    OfferedQos,
    Recorded,
    RefusedError,
    rooted,
    spelled,
)

MAGIC = b'#ROSBAG V'  # the version and a line feed follow
VERSION = b'2.0\n'
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7  # what a record is
MAX_CHUNK_BYTES = 1 << 30
CACHE_BYTES = 1 << 28  # of decompressed chunks, while they are read in the order of time

U32 = struct.Struct('<I')
U64 = struct.Struct('<Q')
TIME = struct.Struct('<II')


class Fields(dict[bytes, bytes]):
    """The named fields of a header."""

    def __missing__(self, name: bytes) -> bytes:
        raise ValueError(f"a record has no field '{name.decode()}'")


class Chunk(NamedTuple):
    """
    What the index says of a chunk.

    :param position: of its record in the file.
    :param counts: the number of messages of each connection.
    """

    position: int
    first_ns: int
    last_ns: int
    counts: dict[int, int]


class Located(NamedTuple):
    """A message in a chunk: when it was recorded [ns], its connection, and where its bytes are."""

    log_ns: int
    connection: int
    begin: int
    end: int


class Ros1Storage:
    """
    A ROS 1 bag.

    One without an index, as a recorder that was killed leaves it, is read from front to back when
    it is opened; it is refused where it ends in the middle of a record.
    """

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self.warnings: list[str] = []
        self._stream = stack.enter_context(path.open('rb'))
        self._size = self._stream.seek(0, SEEK_END)
        self._cache: OrderedDict[int, bytes] = OrderedDict()
        self._connections: dict[int, tuple[Fields, Fields]] = {}
        self._chunks: list[Chunk] = []
        self._survey()
        counts: Counter[int] = Counter()
        for chunk in self._chunks:
            counts.update(chunk.counts)
        self._channels = {
            key: Channel(
                rooted(named[b'topic'].decode()),
                spelled(defined[b'type'].decode()),
                counts[key],
                'ros1',
                Definition('ros1msg', defined[b'message_definition']),
            )
            for key, (named, defined) in self._connections.items()
        }
        self.channels = list(self._channels.values())
        filled = [chunk for chunk in self._chunks if chunk.counts]
        self.span_ns: tuple[int, int] | None = None
        if filled:
            self.span_ns = (
                min(chunk.first_ns for chunk in filled),
                max(chunk.last_ns for chunk in filled),
            )

    def offers(self) -> dict[str, list[OfferedQos]]:
        """Return what the publishers of each topic offered: each latches its last message."""
        offers: dict[str, list[OfferedQos]] = defaultdict(list)
        for key, (_, defined) in self._connections.items():
            latched = defined.get(b'latching') == b'1'
            offers[self._channels[key].topic].append(
                OfferedQos(latched=latched, depth=int(latched))
            )
        return offers

    def messages(
        self, names: set[str], begin_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Recorded]:
        """Yield the messages of topics in the order of time, both ends included."""
        begin = float('-inf') if begin_ns is None else begin_ns
        end = float('inf') if end_ns is None else end_ns
        ordered = merged(
            (chunk.first_ns, self._sorted_chunk(chunk, names))
            for chunk in self._with(names)
            if chunk.first_ns <= end and chunk.last_ns >= begin
        )
        return (message for message in ordered if begin <= message[0] <= end)

    def as_written(self, names: set[str]) -> Iterator[Recorded]:
        """Yield the messages of topics in the order of the file, a chunk in memory at a time."""
        return chain.from_iterable(self._chunk(chunk, names) for chunk in self._with(names))

    def _with(self, names: set[str]) -> list[Chunk]:
        """Return the chunks that have messages of topics, in the order of the file."""
        wanted = {key for key, channel in self._channels.items() if channel.topic in names}
        return [chunk for chunk in self._chunks if wanted & chunk.counts.keys()]

    def _chunk(self, chunk: Chunk, names: set[str]) -> Iterator[Recorded]:
        data = self._data(chunk.position)
        for log_ns, key, begin, end in self._located(data, names):
            yield log_ns, self._channels[key], data[begin:end]

    def _sorted_chunk(self, chunk: Chunk, names: set[str]) -> Iterator[Recorded]:
        """Yield the messages of topics in a chunk in the order of time; read when begun."""
        found = self._located(self._cached(chunk.position), names)
        for log_ns, key, begin, end in sorted(found, key=itemgetter(0)):
            yield log_ns, self._channels[key], self._cached(chunk.position)[begin:end]

    def _located(self, data: bytes, names: set[str]) -> Iterator[Located]:
        for message in _messages(data):
            if message.connection not in self._channels:
                raise ValueError('a message is of a topic that the index does not name')
            if self._channels[message.connection].topic in names:
                yield message

    def _cached(self, position: int) -> bytes:
        """Return a decompressed chunk; chunks that overlap in time are asked for in turns."""
        if position in self._cache:
            self._cache.move_to_end(position)
            return self._cache[position]
        data = self._data(position)
        while self._cache and sum(map(len, self._cache.values())) + len(data) > CACHE_BYTES:
            self._cache.popitem(last=False)
        self._cache[position] = data
        return data

    def _data(self, position: int) -> bytes:
        """Return the records in a chunk, decompressed."""
        self._stream.seek(position)
        fields, size = self._header(CHUNK)
        packed, length = self._read(size), U32.unpack(fields[b'size'])[0]
        if length > MAX_CHUNK_BYTES:
            raise RefusedError(f'has a chunk of {length / 2**30:.3g} GiB; only 1 GiB can be read')
        compression = fields[b'compression'].decode()
        if compression not in DECOMPRESSORS:
            raise RefusedError(
                f'has chunks that are compressed with {compression!r}; `rosbag compress --bz2` '
                'makes ones that can be read'
            )
        data = DECOMPRESSORS[compression](packed, length)
        if len(data) != length:
            raise ValueError(f'a chunk has {len(data)} bytes instead of {length}')
        return data

    def _survey(self) -> None:
        """Find the connections and the chunks."""
        self._stream.seek(len(MAGIC))
        version = self._stream.readline(10)
        if version != VERSION:
            shown = version.decode(errors='replace').strip()
            raise RefusedError(f'is a ROS bag of version {shown}; `rosbag fix` makes it a 2.0')
        fields, size = self._header(BAG)
        if encryptor := fields.get(b'encryptor'):
            shown = encryptor.decode(errors='replace')
            raise RefusedError(f'is encrypted with {shown}; run `rosbag decrypt` first')
        (index,) = U64.unpack(fields[b'index_pos'])
        counts = [U32.unpack(fields[name])[0] for name in (b'conn_count', b'chunk_count')]
        if not index:
            self._stream.seek(size, SEEK_CUR)
            self._scan(counts[1])
            return
        self._stream.seek(index)
        for _ in range(counts[0]):
            named, size = self._header(CONNECTION)
            self._connect(named, self._read(size))
        for _ in range(counts[1]):
            fields, size = self._header(CHUNK_INFO)
            (position,) = U64.unpack(fields[b'chunk_pos'])
            times = _time_ns(fields[b'start_time']), _time_ns(fields[b'end_time'])
            found = dict(struct.iter_unpack('<II', self._read(size)))
            if not found.keys() <= self._connections.keys():
                raise ValueError('its index counts messages of a topic that it does not name')
            self._chunks.append(Chunk(position, *times, found))
        self._chunks.sort(key=attrgetter('position'))

    def _scan(self, least: int) -> None:
        """
        Find the connections and the chunks without an index, by reading all.

        :param least: the number of chunks that there must be, 0 where it was not noted.
        """
        try:
            while (position := self._stream.tell()) < self._size:
                fields, size = self._header(CHUNK, INDEX, CONNECTION, CHUNK_INFO)
                if fields[b'op'][0] == CHUNK:
                    self._chunks.append(self._scanned(position))
                else:
                    self._read(size)
            if len(self._chunks) < least:
                raise ValueError('chunks are missing')
        except Exception as error:  # as of what is damaged: nearly anything
            raise RefusedError(
                'has no index, since its recorder was stopped, and ends in the middle of a '
                'record; `rosbag reindex` saves what is complete'
            ) from error
        self.warnings.append('has no index, since its recorder was stopped; read to its end')

    def _scanned(self, position: int) -> Chunk:
        """Return what an index would say of a chunk, and note its connections."""
        data = self._data(position)
        for fields, begin, end in _records(data):
            if fields[b'op'][0] == CONNECTION:
                self._connect(fields, data[begin:end])
        located = list(_messages(data))
        times = [message.log_ns for message in located] or [0]
        counts = Counter(message.connection for message in located)
        return Chunk(position, min(times), max(times), dict(counts))

    def _connect(self, named: Fields, data: bytes) -> None:
        (key,) = U32.unpack(named[b'conn'])
        self._connections[key] = named, _fields(data)

    def _header(self, *kinds: int) -> tuple[Fields, int]:
        """Return the fields of the record that comes next, and the length of its data."""
        fields = _fields(self._read(*U32.unpack(self._read(4))))
        if fields[b'op'][0] not in kinds:
            raise ValueError(f'a record is of kind {fields[b"op"][0]} instead of {kinds[0]}')
        return fields, U32.unpack(self._read(4))[0]

    def _read(self, size: int) -> bytes:
        if size > self._size - self._stream.tell():  # before memory is taken for it
            raise ValueError('a record ends behind the end of the file')
        return self._stream.read(size)


def _fields(header: bytes) -> Fields:
    """Return the named fields of a header."""
    found, at = Fields(), 0
    while at < len(header):
        (size,) = U32.unpack_from(header, at)
        name, _, value = header[at + 4 : at + 4 + size].partition(b'=')
        found[name] = value
        at += 4 + size
    return found


def _records(data: bytes) -> Iterator[tuple[Fields, int, int]]:
    """Yield the records in a chunk: the fields of each, and where its data begins and ends."""
    end = 0
    while end < len(data):
        begin = end + 4 + U32.unpack_from(data, end)[0]
        fields = _fields(data[end + 4 : begin])
        (size,) = U32.unpack_from(data, begin)
        end = begin + 4 + size
        if end > len(data):
            raise ValueError('a message ends behind the end of its chunk')
        yield fields, begin + 4, end


def _messages(data: bytes) -> Iterator[Located]:
    """Yield where the messages in a chunk are, in the order of the file."""
    for fields, begin, end in _records(data):
        if fields[b'op'][0] == MESSAGE:
            (connection,) = U32.unpack(fields[b'conn'])
            yield Located(_time_ns(fields[b'time']), connection, begin, end)


def _time_ns(field: bytes) -> int:
    seconds, nanoseconds = TIME.unpack(field)
    return seconds * 1_000_000_000 + nanoseconds


def _unbz2(packed: bytes, length: int) -> bytes:
    return bz2.BZ2Decompressor().decompress(packed, length)


def _unlz4(packed: bytes, length: int) -> bytes:
    return lz4.frame.LZ4FrameDecompressor().decompress(packed, length)


def _as_is(packed: bytes, _: int) -> bytes:
    return packed


# Each takes the bytes and the length that it must give, so that no bomb takes more memory.
DECOMPRESSORS: dict[str, Callable[[bytes, int], bytes]] = {
    'none': _as_is,
    'bz2': _unbz2,
    'lz4': _unlz4,
}
