"""Poses from ROS recordings: ROS 1 bags, rosbag2 folders and bare .db3 or .mcap files."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError, UnsupportedMessage
from vio_eval_ros.recordings import messages
from vio_eval_ros.recordings.container import Container, reading, Topic
from vio_eval_ros.recordings.decoder import Blocks, Decoder
from vio_eval_ros.recordings.messages import PATH, PathRevisions
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.transforms import TF_TYPES, TransformTree

# Takes the time [ns] at which a message was recorded, and its bytes.
Sink = Callable[[int, bytes], None]


class TopicPoses(NamedTuple):
    """
    The poses of a topic or transform.

    :param poses: as last revised, where the topic revises them.
    :param causal: as first published; None where the topic revises nothing.
    """

    poses: Poses
    causal: Poses | None = None


class Recording(Container):
    """
    A recording of which poses are read.

    ``warnings`` holds a line for whatever :meth:`read` had to leave out.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.warnings: list[str] = []

    def read(self, specs: Sequence[str], progress: Progress = silent) -> list[TopicPoses]:
        """
        Return the poses of topics and transforms, in a single pass over the recording.

        :param specs: '/topic', or '/tf:PARENT.CHILD' for the motion of CHILD in PARENT, chained
            through the tree on that TF topic and the static one beside it.
        :param progress: wraps the iterable of messages given their number, as ``tqdm`` would.
        :raises ReadError: unknown or empty topics, unknown frames, a damaged recording.
        :raises UnsupportedMessage: a topic whose messages carry no pose.
        """
        sinks: dict[str, list[Sink]] = defaultdict(list)
        results: dict[str, Callable[[], TopicPoses]] = {}
        trees: dict[str, TransformTree] = {}
        for spec in dict.fromkeys(specs):
            name, colon, frames = spec.partition(':')
            topic = self._topic(name, transforms=bool(colon))
            if colon:
                if name not in trees:
                    trees[name] = self._feed_tree(topic, sinks)
                results[spec] = partial(_looked_up, trees[name], frames)
            else:
                collector = _PoseColumns(self.decoder(topic))
                sinks[name].append(collector.add)
                results[spec] = collector.read

        self.feed(sinks, progress)
        read = {spec: result() for spec, result in results.items()}
        for spec, found in read.items():
            if not len(found.poses):
                raise ReadError(f'{self.path}:{spec}', 'its messages have no poses')
        self.warnings += [line for tree in trees.values() for line in tree.warnings]
        return [read[spec] for spec in specs]

    def feed(self, sinks: Mapping[str, Sequence[Sink]], progress: Progress = silent) -> None:
        """
        Hand each message of some topics to the sinks of its topic, file by file as written.

        :raises ReadError: a recording that is damaged or lacks messages.
        """
        received: Counter[str] = Counter()
        expected = {topic.name: topic.count for topic in self.topics if topic.name in sinks}
        messages = self.as_written(set(sinks))
        for log_ns, channel, raw in progress(messages, sum(expected.values())):
            received[channel.topic] += 1
            for sink in sinks[channel.topic]:
                sink(log_ns, raw)
        for name, count in expected.items():
            if received[name] < count:
                raise ReadError(
                    f'{self.path}:{name}',
                    f'only {received[name]} of the {count} messages in the index are there; the '
                    'recording is damaged, or its metadata.yaml belongs to another recording',
                )

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
        listed = self.choices()
        return f'topics with poses: {", ".join(listed)}' if listed else 'no topic has poses'

    def choices(self) -> list[str]:
        """Return the specs of what can be evaluated, each with type and number of messages."""
        return [
            f'{topic.name}{":PARENT.CHILD" * (topic.msgtype in TF_TYPES)} '
            f'({topic.msgtype}, {topic.count})'
            for topic in self.topics
            if topic.has_pose or topic.msgtype in TF_TYPES
        ]

    def decoder(self, topic: Topic) -> Decoder:
        """
        Return the decoder for the messages of a topic, as its first file defines them.

        :raises ReadError: another serialisation, a definition that is damaged.
        """
        source = f'{self.path}:{topic.name}'
        channel = next(channel for channel in self.channels if channel.topic == topic.name)
        with reading(source):
            return Decoder(source, channel)

    def _feed_tree(self, topic: Topic, sinks: dict[str, list[Sink]]) -> TransformTree:
        """Return a tree that is fed with the messages of a TF topic and of its static twin."""
        tree = TransformTree(f'{self.path}:{topic.name}')

        def sink(decoder: Decoder, static: bool, _: int, message: bytes) -> None:
            with reading(decoder.source):
                tree.add(decoder.deserialize(message), static)

        for fed in self.topics:
            if fed.name in (topic.name, f'{topic.name}_static') and fed.msgtype in TF_TYPES:
                static = fed.name.endswith('_static')
                sinks[fed.name].append(partial(sink, self.decoder(fed), static))
        return tree


def _looked_up(tree: TransformTree, frames: str) -> TopicPoses:
    return TopicPoses(tree.lookup(frames))


class _PoseColumns:
    """The poses of one topic, decoded a block at a time: memory holds columns, not messages."""

    def __init__(self, decoder: Decoder) -> None:
        self._decoder = decoder
        self._path = PathRevisions(decoder.source) if decoder.msgtype == PATH else None
        self._blocks = Blocks(self._decode)
        self._columns: list[tuple[np.ndarray, np.ndarray]] = []

    def add(self, _: int, message: bytes) -> None:
        """Take one message."""
        if self._path:
            self._path.add(messages.poses(*self._decoder.columns([message])))
        else:
            self._blocks.add(message)

    def read(self) -> TopicPoses:
        """Return the poses of all messages."""
        if self._path:
            return TopicPoses(self._path.final(), self._path.causal())
        self._blocks.flush()
        stamps, numbers = zip(*self._columns, strict=True)
        return TopicPoses(messages.poses(np.concatenate(stamps), np.concatenate(numbers)))

    def _decode(self, block: list[bytes]) -> None:
        self._columns.append(self._decoder.columns(block))
