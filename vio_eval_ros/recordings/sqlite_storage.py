"""
The SQLite files of rosbag2, read with Python's own sqlite3.

A recorder that was killed leaves a journal beside its file: a write-ahead log with messages that
are not in the file yet, or what it takes to undo a transaction. SQLite needs it, and would write
both; so both are copied, and the user's folder stays as it is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import closing, ExitStack
from pathlib import Path
import shutil
import sqlite3
from tempfile import TemporaryDirectory

from vio_eval_ros.recordings.rosbags_internals import profiles_in
from vio_eval_ros.recordings.storage import (
    Channel,
    Definition,
    OfferedQos,
    Recorded,
    RefusedError,
    rooted,
    spelled,
)

MAGIC = b'SQLite format 3\0'
TABLES = {'topics', 'messages'}
PAGE_BYTES = 4096  # of SQLite by default


class SqliteStorage:
    """An SQLite file of rosbag2, of any of its schemas."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        self.warnings = [
            f'its recorder was stopped before it closed the file; read together with {beside.name}'
            for beside in journals(path)
        ]
        self._database = _opened(path, stack)
        # views are not read: a query may run for ever
        tables = {name for (name,) in self._rows("name FROM sqlite_master WHERE type = 'table'")}
        if not tables >= TABLES:
            raise RefusedError('is an SQLite file, but not a recording of ROS 2')
        optional = {'offered_qos_profiles'} & {
            row[1] for row in self._database.execute('PRAGMA table_info(topics)')
        }
        definitions: dict[str, Definition] = {}
        if 'message_definitions' in tables:
            columns = 'topic_type, encoding, encoded_message_definition'
            for msgtype, encoding, text in self._rows(f'{columns} FROM message_definitions'):
                definitions.setdefault(msgtype, Definition(encoding, text.encode()))
        counts = Counter(dict(self._rows('topic_id, count(*) FROM messages GROUP BY topic_id')))
        columns = ', '.join(['id', 'name', 'type', 'serialization_format', *optional])
        self._channels: dict[int, Channel] = {}
        self._profiles: dict[str, str] = {}
        for key, name, msgtype, encoding, *profiles in self._rows(f'{columns} FROM topics'):
            self._channels[key] = Channel(
                rooted(name),
                spelled(msgtype),
                counts[key],
                encoding,
                definitions.get(msgtype, Definition()),
            )
            self._profiles[rooted(name)] = ''.join(profiles)
        self.channels = list(self._channels.values())
        ((first, last),) = self._rows('min(timestamp), max(timestamp) FROM messages')
        self.span_ns: tuple[int, int] | None = None if first is None else (first, last)

    def offers(self) -> dict[str, list[OfferedQos]]:
        """Return what the publishers of each topic offered."""
        return {
            topic: [OfferedQos.of(profile) for profile in profiles_in(text)]
            for topic, text in self._profiles.items()
        }

    def messages(
        self, names: set[str], begin_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Recorded]:
        """Yield the messages of topics in the order of time, both ends included."""
        span = [*(self.span_ns or (0, 0))]
        span[0] = span[0] if begin_ns is None else begin_ns
        span[1] = span[1] if end_ns is None else end_ns
        return self._select(names, 'AND timestamp BETWEEN ? AND ? ORDER BY timestamp, id', span)

    def as_written(self, names: set[str]) -> Iterator[Recorded]:
        """Yield the messages of topics in the order in which they were inserted."""
        return self._select(names, 'ORDER BY id', [])

    def _select(self, names: set[str], rest: str, values: list[int]) -> Iterator[Recorded]:
        keys = [key for key, channel in self._channels.items() if channel.topic in names]
        places = ', '.join('?' * len(keys))
        query = f'timestamp, topic_id, data FROM messages WHERE topic_id IN ({places}) {rest}'
        for log_ns, key, raw in self._rows(query, *keys, *values):
            yield log_ns, self._channels[key], raw

    def _rows(self, query: str, *values: int) -> sqlite3.Cursor:
        return self._database.execute(f'SELECT {query}', values)


def journals(path: Path) -> list[Path]:
    """Return the journals beside an SQLite file that have something in them."""
    beside = [path.with_name(f'{path.name}{suffix}') for suffix in ('-wal', '-journal')]
    return [journal for journal in beside if journal.is_file() and journal.stat().st_size]


def _opened(path: Path, stack: ExitStack) -> sqlite3.Connection:
    """Return a connection that reads a file; one with a journal beside it, in a copy."""
    beside = journals(path)
    if not beside:
        # immutable: neither locks nor looks for journals, and works in folders that one may only
        # read; as_uri: names may have ? and # in them
        uri = f'{path.absolute().as_uri()}?immutable=1'
        return stack.enter_context(closing(sqlite3.connect(uri, uri=True)))
    folder = Path(stack.enter_context(TemporaryDirectory(prefix='vio_eval_ros_')))
    needed = sum(file.stat().st_size for file in (path, *beside))
    if needed > shutil.disk_usage(folder).free:
        raise RefusedError(
            f'has {beside[0].name} beside it, and a copy of both does not fit into {folder.parent}'
            "; set TMPDIR to a folder with more room, or close it: sqlite3 FILE 'PRAGMA "
            "wal_checkpoint(TRUNCATE)'"
        )
    for file in (path, *beside):
        shutil.copyfile(file, folder / file.name)
    if not path.stat().st_size:  # else SQLite deletes the log, which has all pages then
        (folder / path.name).write_bytes(bytes(PAGE_BYTES))
    database = stack.enter_context(closing(sqlite3.connect(folder / path.name)))
    ((found,),) = database.execute('PRAGMA quick_check(1)')
    if found != 'ok':
        raise ValueError(f'with {beside[0].name}, which may be that of another file: {found}')
    return database
