"""
The files that recordings are made of, and the libraries that read them.

An mcap is read with the mcap library: it is as fast as rosbags there, and reads what that refuses
(another profile than ros2, as converted and merged files have; topics that are not ROS's; files
without an index whose messages are out of order, as rosbag2's fastwrite preset may leave them).
Everything else is read with rosbags.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from io import SEEK_END
from operator import attrgetter
from pathlib import Path, PurePath
from typing import Any

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Chunk, Message, Schema
from mcap.stream_reader import breakup_chunk
from mcap.summary import Summary
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_types_from_msg, get_typestore, Stores
from rosbags.typesys.store import Typestore
import yaml

from vio_eval_ros.errors import ReadError

Timed = tuple[int, str, bytes]  # nanoseconds at which a message was recorded, topic, bytes

_MCAP_MAGIC = b'\x89MCAP0\r\n'  # begins and ends a file

# The first bytes of each kind of file, the suffix it must have, its name, and how to mend it.
_FILES = {
    'ros1': (b'#ROSBAG V2.0\n', '.bag', 'a ROS 1 bag', '`rosbag reindex`'),
    'rosbag2': (b'SQLite format 3\0', '.db3', 'an SQLite recording', '`sqlite3 FILE .recover`'),
    'mcap': (_MCAP_MAGIC, '.mcap', 'an mcap file', '`mcap recover`'),
}


@dataclass(frozen=True)
class Channel:
    """A topic in one storage file; ``encoding`` is 'cdr' or 'ros1' where it can be decoded."""

    topic: str
    msgtype: str
    count: int
    encoding: str


class RosbagsStorage:
    """A ROS 1 bag, an SQLite file or a compressed folder, read with rosbags."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self.path = path
        self._reader = stack.enter_context(
            AnyReader([path], default_typestore=standard_types(ros1=False))
        )
        self.channels = [
            Channel(
                _rooted(connection.topic),
                connection.msgtype,
                connection.msgcount,
                getattr(connection.ext, 'serialization_format', 'ros1'),
            )
            for connection in self._reader.connections
        ]

    def types(self, msgtype: str) -> Typestore:
        """Return the definitions of a message type, the standard ones where none are stored."""
        stored = self._reader.typestore
        return stored if msgtype in stored.fielddefs else standard_types(not self._reader.is2)

    def messages(self, names: set[str]) -> Iterator[Timed]:
        """Yield the messages of some topics, in the order in which they were recorded."""
        wanted = [c for c in self._reader.connections if _rooted(c.topic) in names]
        if wanted:  # to rosbags, none means all
            for connection, log_ns, message in self._reader.messages(wanted):
                yield log_ns, _rooted(connection.topic), message


class McapStorage:
    """An mcap file, read with the mcap library; front to back where it has no full index."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self.path = path
        self._stream = stack.enter_context(path.open('rb'))
        self._reader = SeekingReader(self._stream, validate_crcs=True)
        self._stream.seek(-len(_MCAP_MAGIC), SEEK_END)
        if self._stream.read() != _MCAP_MAGIC:
            raise McapError('its end is missing')
        self._summary = summary = self._reader.get_summary() or Summary()
        schemas, channels = dict(summary.schemas), dict(summary.channels)
        self._is_indexed = bool(summary.chunk_indexes and channels) and all(
            channel.schema_id in (0, *schemas) for channel in channels.values()
        )
        if self._is_indexed and summary.statistics:
            counts = Counter(summary.statistics.channel_message_counts)
        else:
            counts = Counter()
            for schema, channel, _ in self._records():
                counts[channel.id] += 1
                channels[channel.id] = channel
                schemas[channel.schema_id] = schema
        self._schemas = {}
        self.channels = []
        for key, channel in channels.items():
            schema = schemas.get(channel.schema_id) or Schema(0, b'', '', '')
            # ROS 1 writes nav_msgs/Odometry
            is_ros1 = schema.name.count('/') == 1
            msgtype = schema.name.replace('/', '/msg/') if is_ros1 else schema.name
            self._schemas[msgtype] = schema
            self.channels.append(
                Channel(_rooted(channel.topic), msgtype, counts[key], channel.message_encoding)
            )

    def types(self, msgtype: str) -> Typestore:
        """Return the definitions of a message type, the standard ones where none are stored."""
        schema = self._schemas[msgtype]
        if schema.encoding not in ('ros1msg', 'ros2msg') or not schema.data:
            return standard_types(ros1=schema.encoding.startswith('ros1'))
        types = get_typestore(Stores.EMPTY)
        types.register(get_types_from_msg(schema.data.decode(), msgtype))
        return types

    def messages(self, names: set[str]) -> Iterator[Timed]:
        """Yield the messages of some topics, in the order of the file."""
        # ROS 1 allows names without the leading slash
        for _, channel, message in self._records({*names, *(name[1:] for name in names)}):
            yield message.log_time, _rooted(channel.topic), message.data

    def _records(self, topics: set[str] | None = None) -> Iterator[tuple[Any, Any, Any]]:
        if self._is_indexed:
            return self._indexed_records(topics)
        self._stream.seek(0)
        reader = NonSeekingReader(self._stream, validate_crcs=True)
        return reader.iter_messages(topics, log_time_order=False)

    def _indexed_records(self, topics: set[str] | None) -> Iterator[tuple[Any, Any, Any]]:
        """
        Yield schema, channel and message of each record, in the order of the file.

        One chunk is in memory at a time; the mcap library's own ``iter_messages`` without an order
        reads them all before it yields.
        """
        schemas, channels = self._summary.schemas, self._summary.channels
        wanted = {
            key for key, channel in channels.items() if topics is None or channel.topic in topics
        }
        for index in sorted(self._summary.chunk_indexes, key=attrgetter('chunk_start_offset')):
            # offsets may be left out; then only the chunk itself tells what is in it
            if index.message_index_offsets and wanted.isdisjoint(index.message_index_offsets):
                continue
            self._stream.seek(index.chunk_start_offset + 1 + 8)  # behind opcode and length
            chunk = Chunk.read(ReadDataStream(self._stream))
            for record in breakup_chunk(chunk, validate_crc=True):
                if isinstance(record, Message):
                    channel = channels[record.channel_id]
                    if channel.id in wanted:
                        yield schemas.get(channel.schema_id), channel, record


def rosbag2_files(path: Path) -> tuple[tuple[Path, ...], bool]:
    """Return the storage files of a rosbag2 folder, and whether anything in it is compressed."""
    metadata = path / 'metadata.yaml'
    if not metadata.exists():
        raise ReadError(
            path,
            'is not a rosbag2 folder, it has no metadata.yaml; name one of its .db3 or .mcap '
            'files, or let `ros2 bag reindex` write it',
        )
    try:
        content = yaml.safe_load(metadata.read_text())['rosbag2_bagfile_information']
        files = tuple(path / PurePath(name).name for name in content['relative_file_paths'])
        mode = content.get('compression_mode') or ''
        return files, mode.lower() not in ('', 'none')
    except Exception as error:
        raise unreadable(metadata, error) from error


def identify(path: Path, compressed: bool) -> str:
    """Return the kind of a storage file, after its content and its name, which must agree."""
    with path.open('rb') as stream:
        begin = stream.read(100)
    if not begin:
        raise ReadError(path, 'is empty (0 bytes)')
    if begin.startswith(b'version https://git-lfs'):
        raise ReadError(path, 'is a Git LFS pointer, not the recording; run `git lfs pull`')
    if compressed:
        return 'rosbag2'
    named = next((kind for kind, row in _FILES.items() if row[1] == path.suffix), None)
    found = next((kind for kind, row in _FILES.items() if begin.startswith(row[0])), None)
    if found and found != named:
        _, suffix, name, _ = _FILES[found]
        raise ReadError(path, f'is {name}; rename it to end in {suffix}')
    if not named:
        raise ReadError(path, 'is no recording; those are .bag, .db3, .mcap and rosbag2 folders')
    if not found:
        name = _FILES[named][2]
        raise ReadError(path, f'does not begin as {name} does; it is damaged or something else')
    return found


def open_storage(path: Path, kind: str, stack: ExitStack) -> RosbagsStorage | McapStorage:
    """Return an open storage file of the given kind; the stack closes it."""
    try:
        return McapStorage(path, stack) if kind == 'mcap' else RosbagsStorage(path, stack)
    except Exception as error:
        raise unreadable(path, error) from error


def unreadable(source: object, error: Exception) -> ReadError:
    """
    Return what to tell the user of an exception on the way to the bytes.

    Recordings come from anywhere, and on damaged ones the libraries raise nearly anything:
    struct.error, KeyError, AssertionError, UnicodeDecodeError, zstd's and SQLite's errors, and
    MemoryError where a damaged length is absurd. So Exception is caught around each call of
    theirs, and only there.
    """
    if isinstance(error, ReadError):
        return error
    if isinstance(error, FileNotFoundError):
        return ReadError(error.filename or source, 'there is no such file or folder')
    if isinstance(error, PermissionError):
        return ReadError(source, 'there is no permission to read it')
    reason = ' '.join(str(error).split()) or type(error).__name__
    if isinstance(error, KeyError):
        reason = f'no entry {reason}'
    mends = [row[3] for row in _FILES.values() if str(source).endswith(row[1])]
    rescue = f'; {mends[0]} may save what is left' if mends else ''
    return ReadError(source, f'is damaged or was cut short ({reason}){rescue}')


@cache
def standard_types(ros1: bool) -> Typestore:
    """Return the message definitions of ROS 1 Noetic or ROS 2 Jazzy."""
    return get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)


def _rooted(topic: str) -> str:
    """Return the topic with a leading slash, which ROS 1 lets one leave out."""
    return '/' + topic.lstrip('/')
