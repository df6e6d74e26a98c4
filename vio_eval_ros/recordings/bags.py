"""Poses out of ROS recordings: ROS 1 bags, rosbag2 folders and bare .db3 or .mcap files."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError, UnsupportedMessage
from vio_eval_ros.recordings import cdr, messages
from vio_eval_ros.recordings.messages import CONVERTERS, PATH, PathRevisions
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.storage import (
    Channel,
    identify,
    open_storage,
    rosbag2_files,
    standard_types,
    Timed,
    unreadable,
)
from vio_eval_ros.recordings.transforms import TF_TYPES, TransformTree

HEADER = 'std_msgs/msg/Header'
BLOCK_BYTES = 4 << 20  # decoded at once; larger blocks are not faster

Sink = Callable[[int, bytes], None]  # takes when a message was recorded [ns], and its bytes


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


class Read(NamedTuple):
    """
    What was read of a topic or transform.

    :param poses: as last revised, where the topic revises them.
    :param causal: as first published; None of a topic that revises nothing.
    """

    poses: Poses
    causal: Poses | None = None


class Recording:
    """
    A recording, open for reading; a context manager.

    ``kind`` is 'ros1', 'rosbag2' (a bare .db3 too) or 'mcap', ``paths`` are the storage files that
    make it up, in the order in which they were recorded, ``topics`` lists what there is, by name.
    ``warnings`` holds a line for whatever :meth:`read` had to leave out.

    :raises ReadError: where there is no recording at ``path`` or it cannot be read, with the
        reason and what to do.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.warnings: list[str] = []
        try:
            self.paths, compressed = rosbag2_files(path) if path.is_dir() else ((path,), False)
            kinds = [identify(file, compressed) for file in self.paths]
        except Exception as error:
            raise unreadable(path, error) from error
        self.kind = 'rosbag2' if path.is_dir() else kinds[0]
        # Compressed folders are left to rosbags. Of others each file is opened by itself: rosbags
        # finds no message in a folder whose metadata.yaml has another QoS than its storage.
        opened = [(path, 'rosbag2')] if compressed else list(zip(self.paths, kinds, strict=True))
        with ExitStack() as stack:
            self._storages = [open_storage(file, kind, stack) for file, kind in opened]
            self._stack = stack.pop_all()
        counts: Counter[tuple[str, str]] = Counter()
        for storage in self._storages:
            for channel in storage.channels:
                counts[channel.topic, channel.msgtype] += channel.count
        self.topics = [Topic(*key, count) for key, count in sorted(counts.items())]

    def __enter__(self) -> Recording:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stack.close()

    def read(self, specs: Sequence[str], progress: Progress = silent) -> list[Read]:
        """
        Return the poses of topics and transforms, in one pass over the storage for all of them.

        :param specs: '/topic', or '/tf:PARENT.CHILD' for the motion of CHILD in PARENT, chained
            through the tree on that TF topic and the static one beside it.
        :param progress: wraps the iterable of messages given their number, as ``tqdm`` would.
        :raises ReadError: unknown or empty topics, unknown frames, a damaged recording.
        :raises UnsupportedMessage: a topic whose messages carry no pose.
        """
        sinks: dict[str, list[Sink]] = defaultdict(list)
        results: dict[str, Callable[[], Read]] = {}
        trees: dict[str, TransformTree] = {}
        for spec in dict.fromkeys(specs):
            name, colon, frames = spec.partition(':')
            topic = self._topic(name, transforms=bool(colon))
            if colon:
                if name not in trees:
                    trees[name] = self._feed_tree(topic, sinks)
                results[spec] = partial(_looked_up, trees[name], frames)
            else:
                collector = _Collector(self.decoder(topic))
                sinks[name].append(collector.add)
                results[spec] = collector.read

        self.feed(sinks, progress)
        read = {spec: result() for spec, result in results.items()}
        for spec, found in read.items():
            if not len(found.poses):
                raise ReadError(f'{self.path}:{spec}', 'there are no poses in its messages')
        self.warnings += [line for tree in trees.values() for line in tree.warnings]
        return [read[spec] for spec in specs]

    def feed(self, sinks: Mapping[str, Sequence[Sink]], progress: Progress = silent) -> None:
        """
        Hand each message of some topics to the sinks of its topic, file by file as written.

        :raises ReadError: a recording that is damaged or lacks messages.
        """
        received: Counter[str] = Counter()
        expected = {topic.name: topic.count for topic in self.topics if topic.name in sinks}
        for log_ns, name, raw in progress(self._messages(set(sinks)), sum(expected.values())):
            received[name] += 1
            for sink in sinks[name]:
                sink(log_ns, raw)
        for name, count in expected.items():
            if received[name] < count:
                raise ReadError(
                    f'{self.path}:{name}',
                    f'only {received[name]} of the {count} messages in the index are there; the '
                    'recording is damaged, or its metadata.yaml belongs to another',
                )

    def _messages(self, names: set[str]) -> Iterator[Timed]:
        for storage in self._storages:
            try:
                yield from storage.messages(names)
            except Exception as error:
                raise unreadable(storage.path, error) from error

    def _topic(self, name: str, transforms: bool) -> Topic:
        """Return the topic of this name, or explain why it cannot be evaluated."""
        source = f'{self.path}:{name}'
        found = [topic for topic in self.topics if topic.name == name]
        if not found:
            raise ReadError(source, f'there is no such topic; {self.choice()}')
        if len(found) > 1:
            types = ' and '.join(topic.msgtype for topic in found)
            raise ReadError(source, f'has messages of different types: {types}')
        (topic,) = found
        is_tree = topic.msgtype in TF_TYPES
        if is_tree and not transforms:
            raise UnsupportedMessage(source, f'carries transforms; write {name}:PARENT.CHILD')
        if transforms and not is_tree:
            raise UnsupportedMessage(source, f'carries {topic.msgtype}, not transforms')
        if not is_tree and not topic.has_pose:
            raise UnsupportedMessage(
                source, f'{topic.msgtype} carries no pose that can be scored; {self.choice()}'
            )
        if not topic.count:
            raise ReadError(source, f'has no messages; {self.choice()}')
        return topic

    def choice(self) -> str:
        """Return a sentence that lists what can be evaluated."""
        listed = [
            f'{topic.name}{":PARENT.CHILD" * (topic.msgtype in TF_TYPES)} '
            f'({topic.msgtype}, {topic.count})'
            for topic in self.topics
            if topic.has_pose or topic.msgtype in TF_TYPES
        ]
        return f'topics with poses: {", ".join(listed)}' if listed else 'no topic of it has poses'

    def decoder(self, topic: Topic) -> Decoder:
        """
        Return what decodes the messages of a topic, by the definition in its first file.

        :raises ReadError: another serialisation, a definition that is damaged.
        """
        source = f'{self.path}:{topic.name}'
        storage, channel = next(
            (storage, channel)
            for storage in self._storages
            for channel in storage.channels
            if channel.topic == topic.name
        )
        try:
            return Decoder(source, channel, storage.types(topic.msgtype))
        except Exception as error:
            raise unreadable(source, error) from error

    def _feed_tree(self, topic: Topic, sinks: dict[str, list[Sink]]) -> TransformTree:
        """Return a tree that is fed with the messages of a TF topic and of its static twin."""
        tree = TransformTree(f'{self.path}:{topic.name}')

        def sink(decoder: Decoder, static: bool, _: int, message: bytes) -> None:
            try:
                tree.add(decoder.deserialize(message), static)
            except Exception as error:
                raise unreadable(decoder.source, error) from error

        for fed in self.topics:
            if fed.name in (topic.name, f'{topic.name}_static') and fed.msgtype in TF_TYPES:
                static = fed.name.endswith('_static')
                sinks[fed.name].append(partial(sink, self.decoder(fed), static))
        return tree


def _looked_up(tree: TransformTree, frames: str) -> Read:
    return Read(tree.lookup(frames))


class Decoder:
    """
    Makes messages, or columns of numbers, of the raw bytes of one topic.

    ``ros1`` says how they are serialised, ``is_standard`` whether the definition of their type is
    the one that ROS has, ``is_known`` whether there is any, and ``has_header`` whether they begin
    with a header.
    """

    def __init__(self, source: str, channel: Channel, types: Typestore) -> None:
        if channel.encoding not in ('cdr', 'ros1'):
            raise ReadError(
                source, f'is serialised as {channel.encoding!r}; only cdr and ros1 can be read'
            )
        self.source = source
        self.msgtype = channel.msgtype
        self.ros1 = channel.encoding == 'ros1'
        self._function = types.deserialize_ros1 if self.ros1 else types.deserialize_cdr
        standard = standard_types(self.ros1)
        self.is_standard = self.msgtype in standard.fielddefs and (
            types.hash_rihs01(self.msgtype) == standard.hash_rihs01(self.msgtype)
        )
        self.is_known = self.msgtype in types.fielddefs
        _, fields = types.fielddefs.get(self.msgtype, ((), []))
        self.has_header = bool(fields) and fields[0][1] == (Nodetype.NAME, HEADER)

    def deserialize(self, message: bytes) -> Any:
        """Return one message."""
        return self._function(message, self.msgtype)

    def columns(self, block: list[bytes]) -> tuple[np.ndarray, np.ndarray]:
        """Return the stamps and numbers of the poses in many messages."""
        if self.is_standard:
            fast = (
                cdr.decode_path(block[0], self.ros1)
                if self.msgtype == PATH
                else cdr.decode(self.msgtype, block, self.ros1)
            )
            if fast is not None:
                return fast
        convert = CONVERTERS[self.msgtype]
        try:
            rows = [row for message in block for row in convert(self.deserialize(message))]
        except Exception as error:
            raise unreadable(self.source, error) from error
        return messages.columns(rows)


class _Collector:
    """The poses of one topic, decoded a block at a time: memory holds columns, not messages."""

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder
        self._path = PathRevisions(decoder.source) if decoder.msgtype == PATH else None
        self._block: list[bytes] = []
        self._bytes = 0
        self._columns: list[tuple[np.ndarray, np.ndarray]] = []

    def add(self, _: int, message: bytes) -> None:
        """Take one message."""
        if self._path:
            self._path.add(messages.poses(*self._decoder.columns([message])))
            return
        self._block.append(message)
        self._bytes += len(message)
        if self._bytes > BLOCK_BYTES:
            self._decode()

    def read(self) -> Read:
        """Return the poses of all messages."""
        if self._path:
            return Read(self._path.final(), self._path.causal())
        self._decode()
        stamps, numbers = zip(*self._columns, strict=True)
        return Read(messages.poses(np.concatenate(stamps), np.concatenate(numbers)))

    def _decode(self) -> None:
        if self._block:
            self._columns.append(self._decoder.columns(self._block))
            self._block, self._bytes = [], 0
