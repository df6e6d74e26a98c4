"""An opened recording: which files it consists of, which topics it has, and its messages."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, ExitStack
from dataclasses import dataclass
from itertools import chain
from pathlib import Path, PurePath
from types import TracebackType
from typing import NamedTuple, TypeVar

from ruamel.yaml import YAML

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.messages import CONVERTERS
from vio_eval_ros.recordings.storage import (
    Channel,
    MCAP_MAGIC,
    McapStorage,
    merged,
    OfferedQos,
    Recorded,
    RosbagsStorage,
    Storage,
)


class FileKind(NamedTuple):
    """A kind of storage file: how it begins, its suffix, its name, and what repairs it."""

    magic: bytes
    suffix: str
    name: str
    repair: str


FILE_KINDS = {
    'ros1': FileKind(b'#ROSBAG V2.0\n', '.bag', 'a ROS 1 bag', '`rosbag reindex`'),
    'rosbag2': FileKind(
        b'SQLite format 3\0', '.db3', 'an SQLite recording', '`sqlite3 FILE .recover`'
    ),
    'mcap': FileKind(MCAP_MAGIC, '.mcap', 'an mcap file', '`mcap recover`'),
}

Opened = TypeVar('Opened', bound='Container')


@dataclass(frozen=True)
class Topic:
    """
    A topic of a recording.

    :param msgtype: the type as ROS 2 spells it, in ROS 1 recordings too.
    :param count: the number of its messages.
    """

    name: str
    msgtype: str
    count: int

    @property
    def has_pose(self) -> bool:
        """Whether each message can be scored as it is; one of a TF topic needs two frames."""
        return self.msgtype in CONVERTERS


class Container:
    """
    A ROS 1 bag, a rosbag2 folder or a bare .db3 or .mcap, open for reading; a context manager.

    ``kind`` is 'ros1', 'rosbag2' (a bare .db3 too) or 'mcap', ``paths`` are the storage files that
    make it up, in the order in which they were recorded, ``topics`` lists its topics by name.

    :raises ReadError: there is no recording at ``path`` or it cannot be read; the message says
        why and what to do.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with reading(path):
            self.paths, compressed = rosbag2_files(path) if path.is_dir() else ((path,), False)
            kinds = [identify(file, compressed) for file in self.paths]
        self.kind = 'rosbag2' if path.is_dir() else kinds[0]
        # Compressed folders are left to rosbags. Of others each file is opened by itself: rosbags
        # finds no message in a folder whose metadata.yaml has another QoS than its storage.
        opened = [(path, 'rosbag2')] if compressed else list(zip(self.paths, kinds, strict=True))
        with ExitStack() as stack:
            self._storages = [open_storage(file, kind, stack) for file, kind in opened]
            self._stack = stack.pop_all()
        counts: Counter[tuple[str, str]] = Counter()
        for channel in self.channels:
            counts[channel.topic, channel.msgtype] += channel.count
        self.topics = [Topic(*key, count) for key, count in sorted(counts.items())]

    def __enter__(self: Opened) -> Opened:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close its files."""
        self._stack.close()

    @property
    def channels(self) -> list[Channel]:
        """The topics of each file, the files in the order in which they were recorded."""
        return [channel for storage in self._storages for channel in storage.channels]

    def span_ns(self) -> tuple[int, int] | None:
        """Return when the first and the last message were recorded; None without messages."""
        with reading(self.path):
            spans = [storage.span_ns for storage in self._storages]
        ends = [span for span in spans if span]
        return (min(first for first, _ in ends), max(last for _, last in ends)) if ends else None

    def offers(self) -> dict[str, OfferedQos]:
        """Return what all publishers of each topic offered; the default where that is unknown."""
        offers: dict[str, list[OfferedQos]] = defaultdict(list)
        for storage in self._storages:
            with reading(storage.path):
                for topic, found in storage.offers().items():
                    offers[topic] += found
        return {topic: OfferedQos.common(found) for topic, found in offers.items()}

    def messages(
        self, names: set[str], begin_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Recorded]:
        """
        Return the messages of topics in the order of time, both ends included.

        Files that are not due yet stay unread.

        :raises ReadError: at the point from which the recording is damaged.
        """
        return merged(
            (span[0], _guarded(storage, storage.messages(names, begin_ns, end_ns)))
            for storage in self._storages
            if (span := storage.span_ns)
            and (end_ns is None or span[0] <= end_ns)
            and (begin_ns is None or span[1] >= begin_ns)
        )

    def as_written(self, names: set[str]) -> Iterator[Recorded]:
        """
        Return the messages of topics file by file, as they were written.

        :raises ReadError: at the point from which the recording is damaged.
        """
        return chain.from_iterable(
            _guarded(storage, storage.as_written(names)) for storage in self._storages
        )


def _guarded(storage: Storage, messages: Iterator[Recorded]) -> Iterator[Recorded]:
    with reading(storage.path):
        yield from messages


def rosbag2_files(path: Path) -> tuple[tuple[Path, ...], bool]:
    """Return the storage files of a rosbag2 folder, and whether anything in it is compressed."""
    metadata = path / 'metadata.yaml'
    if not metadata.exists():
        raise ReadError(
            path,
            'is not a rosbag2 folder, it has no metadata.yaml; name one of its .db3 or .mcap '
            'files, or write it with `ros2 bag reindex`',
        )
    with reading(metadata):
        content = YAML(typ='safe', pure=True).load(metadata)['rosbag2_bagfile_information']
        files = tuple(path / PurePath(name).name for name in content['relative_file_paths'])
        mode = content.get('compression_mode') or ''
        return files, mode.lower() not in ('', 'none')


def identify(path: Path, compressed: bool) -> str:
    """Return the kind of a storage file by its content and its suffix, which must agree."""
    with path.open('rb') as stream:
        begin = stream.read(100)
    if not begin:
        raise ReadError(path, 'is empty (0 bytes)')
    if begin.startswith(b'version https://git-lfs'):
        raise ReadError(path, 'is a Git LFS pointer, not the recording; run `git lfs pull`')
    if compressed:
        return 'rosbag2'
    named = next((kind for kind, one in FILE_KINDS.items() if one.suffix == path.suffix), None)
    found = next((kind for kind, one in FILE_KINDS.items() if begin.startswith(one.magic)), None)
    if found and found != named:
        right = FILE_KINDS[found]
        raise ReadError(path, f'is {right.name}; rename it to end in {right.suffix}')
    if not named:
        raise ReadError(
            path, 'is not a recording (expected .bag, .db3, .mcap or a rosbag2 folder)'
        )
    if not found:
        name = FILE_KINDS[named].name
        raise ReadError(path, f'does not begin like {name}; it is damaged or something else')
    return found


def open_storage(path: Path, kind: str, stack: ExitStack) -> Storage:
    """Return an open storage file of the given kind; the stack closes it."""
    with reading(path):
        return McapStorage(path, stack) if kind == 'mcap' else RosbagsStorage(path, stack)


def unreadable(source: object, error: Exception) -> ReadError:
    """
    Return the error for the user when reading the bytes of a source failed.

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
    repairs = [one.repair for one in FILE_KINDS.values() if str(source).endswith(one.suffix)]
    rescue = f'; {repairs[0]} may save what is left' if repairs else ''
    return ReadError(source, f'is damaged or was cut short ({reason}){rescue}')


@contextmanager
def reading(source: object) -> Iterator[None]:
    """Turn what libraries raise while they read a source into a ``ReadError``."""
    try:
        yield
    except Exception as error:
        raise unreadable(source, error) from error
