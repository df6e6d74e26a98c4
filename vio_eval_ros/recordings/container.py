"""An opened recording: which files it consists of, which topics it has, and its messages."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import TypeVar

from vio_eval_ros.recordings.compression import decompressed_message, ZSTD_MAGIC
from vio_eval_ros.recordings.messages import Converter, CONVERTERS
from vio_eval_ros.recordings.rosbag2_folder import Folder, storage_files
from vio_eval_ros.recordings.sqlite_storage import journals
from vio_eval_ros.recordings.storage import Channel, merged, OfferedQos, Recorded
from vio_eval_ros.recordings.storage_files import open_file, reading, StorageFile

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
        """Whether each message is known to have one pose; one of a TF topic needs two frames."""
        return isinstance(CONVERTERS.get(self.msgtype), Converter)

    @property
    def has_usual_pose(self) -> bool:
        """Whether it is of a type that odometry and ground truth usually come in."""
        converter = CONVERTERS.get(self.msgtype)
        return isinstance(converter, Converter) and converter.is_usual


class Container:
    """
    A ROS 1 bag, a rosbag2 folder or a bare .db3 or .mcap, open for reading; a context manager.

    Each file of a folder is opened by itself, and decompressed where it is compressed.

    ``kind`` is 'ros1', 'rosbag2' (a bare .db3 too) or 'mcap', ``paths`` are the storage files that
    make it up, in the order in which they were recorded, ``topics`` lists its topics by name, and
    ``warnings`` has a line for whatever is unusual or had to be left out.

    :raises ReadError: there is no recording at ``path`` or it cannot be read; the message says
        why and what to do.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with reading(path):
            folder = storage_files(path) if path.is_dir() else Folder([path], {}, [])
        with ExitStack() as stack:
            self._files = [open_file(file, stack) for file in folder.files]
            self._stack = stack.pop_all()
        self.paths = tuple(
            part for file in folder.files for part in (file, *journals(file)) if part.is_file()
        )
        kinds = {file.kind for file in self._files}
        self.kind = 'rosbag2' if path.is_dir() and kinds != {'ros1'} else self._files[0].kind
        self.warnings = [f'{path}: {line}' for line in folder.warnings]
        for file in self._files:
            self.warnings += [f'{file.path}: {line}' for line in file.storage.warnings]
        counts: Counter[tuple[str, str]] = Counter()
        for channel in self.channels:
            counts[channel.topic, channel.msgtype] += channel.count
        self.topics = [Topic(*key, count) for key, count in sorted(counts.items())]
        self.warnings += [f'{path}: {line}' for line in _too_few(self.topics, folder.promised)]

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
        return [channel for file in self._files for channel in file.storage.channels]

    def span_ns(self) -> tuple[int, int] | None:
        """Return when the first and the last message were recorded; None without messages."""
        ends = [span for file in self._files if (span := file.storage.span_ns)]
        return (min(first for first, _ in ends), max(last for _, last in ends)) if ends else None

    def offers(self) -> dict[str, OfferedQos]:
        """Return what all publishers of each topic offered; the default where that is unknown."""
        offers: dict[str, list[OfferedQos]] = defaultdict(list)
        for file in self._files:
            with reading(file.path):
                for topic, found in file.storage.offers().items():
                    offers[topic] = max(offers[topic], found, key=len)  # all files say the same
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
            (span[0], _unpacked(file, file.storage.messages(names, begin_ns, end_ns)))
            for file in self._files
            if (span := file.storage.span_ns)
            and (end_ns is None or span[0] <= end_ns)
            and (begin_ns is None or span[1] >= begin_ns)
        )

    def as_written(self, names: set[str]) -> Iterator[Recorded]:
        """
        Return the messages of topics file by file, as they were written.

        :raises ReadError: at the point from which the recording is damaged.
        """
        return chain.from_iterable(
            _unpacked(file, file.storage.as_written(names)) for file in self._files
        )


def _unpacked(file: StorageFile, messages: Iterator[Recorded]) -> Iterator[Recorded]:
    """Yield messages, decompressed: no message of ROS begins as what zstd has compressed does."""
    with reading(file.path):
        for log_ns, channel, raw in messages:
            if raw.startswith(ZSTD_MAGIC) and channel.encoding == 'cdr':
                yield log_ns, channel, decompressed_message(raw)
            else:
                yield log_ns, channel, raw


def _too_few(topics: Iterable[Topic], promised: Mapping[str, int]) -> Iterator[str]:
    """Yield a sentence for each topic with fewer messages than metadata.yaml states."""
    there: Counter[str] = Counter()
    for topic in topics:
        there[topic.name] += topic.count
    for name, count in promised.items():
        if there[name] < count:
            yield f'metadata.yaml states {count} messages of {name}, but {there[name]} are there'
