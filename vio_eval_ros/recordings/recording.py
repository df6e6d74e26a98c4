"""Poses from ROS recordings: ROS 1 bags, rosbag2 folders and bare .db3 or .mcap files."""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError, ReadError, UnsupportedMessage
from vio_eval_ros.recordings import messages
from vio_eval_ros.recordings.container import Container, Topic
from vio_eval_ros.recordings.decoder import Blocks, Decoder
from vio_eval_ros.recordings.messages import PATH, PathRevisions
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.storage_files import reading
from vio_eval_ros.recordings.transforms import static_topics, TF_TYPES, TransformTree

# Takes the time [ns] at which a message was recorded, and its bytes.
Sink = Callable[[int, bytes], None]


class TopicPoses(NamedTuple):
    """
    The poses of a topic or transform.

    :param poses: as last revised, where the topic revises them.
    :param causal: as first published; None where the topic revises nothing.
    :param warnings: what was taken for granted, in sentences.
    """

    poses: Poses
    causal: Poses | None = None
    warnings: tuple[str, ...] = ()


class Wanted(NamedTuple):
    """
    What is to be read of a recording.

    :param topic: its name.
    :param frames: 'PARENT.CHILD' of a TF topic.
    :param by_recording: whether the time of recording takes the place of the stamps.
    """

    topic: str
    frames: str
    by_recording: bool

    @classmethod
    def parse(cls, spec: str) -> Wanted:
        """Return what a spec of :meth:`Recording.read` names."""
        body, _, stated = spec.partition('?')
        topic, _, frames = body.partition(':')
        return cls(topic, frames, stated == 'stamps=recorded')


class Recording(Container):
    """A recording of which poses are read; ``warnings`` grow by what :meth:`read` leaves out."""

    def read(self, specs: Sequence[str], progress: Progress = silent) -> list[TopicPoses]:
        """
        Return the poses of topics and transforms, in a single pass over the recording.

        :param specs: '/topic', or '/tf:PARENT.CHILD' for the motion of CHILD in PARENT, chained
            through the tree on that TF topic and the static one beside it; with
            '?stamps=recorded', at the times at which the messages were recorded.
        :param progress: wraps the iterable of messages given their number, as ``tqdm`` would.
        :raises ReadError: unknown or empty topics, unknown frames, a damaged recording.
        :raises UnsupportedMessage: a topic whose messages carry no pose.
        """
        sinks: dict[str, list[Sink]] = defaultdict(list)
        results: dict[str, Callable[[], TopicPoses]] = {}
        trees: dict[tuple[str, bool], TransformTree] = {}
        for spec in dict.fromkeys(specs):
            wanted = Wanted.parse(spec)
            topic = self._topic(wanted.topic, transforms=':' in spec)
            if ':' in spec:
                key = wanted.topic, wanted.by_recording
                if key not in trees:
                    trees[key] = self._feed_tree(topic, sinks, wanted.by_recording)
                notes = (_by_recording(f'{self.path}:{spec}'),) if wanted.by_recording else ()
                results[spec] = partial(_looked_up, trees[key], wanted.frames, notes)
            else:
                collector = _PoseColumns(self.decoder(topic), wanted.by_recording)
                sinks[wanted.topic].append(collector.add)
                results[spec] = collector.read

        self.feed(sinks, progress)
        read = {spec: result() for spec, result in results.items()}
        for spec, found in read.items():
            self._check(spec, found.poses, Wanted.parse(spec).by_recording)
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

    def _check(self, spec: str, poses: Poses, by_recording: bool) -> None:
        """Raise ``ReadError`` where there is no pose, or where all have the same stamp."""
        source = f'{self.path}:{spec}'
        stamps = poses.stamps_ns
        if not len(stamps):
            raise ReadError(source, 'its messages have no poses')
        if np.ptp(stamps) or (len(stamps) == 1 and stamps[0]):
            return
        if by_recording:
            raise ReadError(source, 'all its messages were recorded at the same time')
        seconds = int(stamps[0]) / 1e9
        value = f'is the same, {seconds:.3f} s' if seconds else 'is 0: it was never set'
        raise ReadError(
            source,
            f'the stamp of every message {value}; to take the time at which each was recorded, '
            f'write {spec}?stamps=recorded',
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

    def _feed_tree(
        self, topic: Topic, sinks: dict[str, list[Sink]], by_recording: bool
    ) -> TransformTree:
        """Return a tree that is fed with the messages of a TF topic and of the static ones."""
        names = [one.name for one in self.topics if one.msgtype in TF_TYPES]
        static = static_topics(topic.name, names)
        tree = TransformTree(f'{self.path}:{topic.name}', static)

        def sink(decoder: Decoder, static: str, log_ns: int, message: bytes) -> None:
            with reading(decoder.source):
                recorded_ns = log_ns if by_recording else None
                tree.add(decoder.deserialize(message), static, recorded_ns)

        for name in dict.fromkeys([topic.name, *static]):
            fed = next(one for one in self.topics if one.name == name)
            sinks[name].append(partial(sink, self.decoder(fed), name if name in static else ''))
        return tree


def _looked_up(tree: TransformTree, frames: str, warnings: tuple[str, ...]) -> TopicPoses:
    return TopicPoses(tree.lookup(frames), warnings=warnings)


def _by_recording(source: str) -> str:
    """Return the sentence that says which times stand for stamps."""
    return (
        f'{source}: each pose has the time at which it was recorded, which is later than it was '
        'measured; `diagnose` finds how much later'
    )


class _PoseColumns:
    """The poses of one topic, decoded a block at a time: memory holds columns, not messages."""

    def __init__(self, decoder: Decoder, by_recording: bool) -> None:
        self._decoder = decoder
        self._path = PathRevisions(decoder.source) if decoder.msgtype == PATH else None
        self._blocks = Blocks(self._decode)
        self._columns: list[tuple[np.ndarray, np.ndarray]] = []
        self._logged = array('q') if by_recording else None
        if self._path and by_recording:
            raise ConfigError(
                f'{decoder.source}: stamps=recorded does not apply to a Path, each message of '
                'which has many poses'
            )

    def add(self, log_ns: int, message: bytes) -> None:
        """Take one message."""
        if self._path:
            self._path.add(messages.poses(*self._decoder.columns([message])))
            return
        if self._logged is not None:
            self._logged.append(log_ns)
        self._blocks.add(message)

    def read(self) -> TopicPoses:
        """Return the poses of all messages."""
        if self._path:
            return TopicPoses(self._path.final(), self._path.causal())
        self._blocks.flush()
        stamps, numbers = map(np.concatenate, zip(*self._columns, strict=True))
        if self._logged is None:
            return TopicPoses(messages.poses(stamps, numbers))
        warnings = (_by_recording(self._decoder.source),)
        return TopicPoses(messages.poses(np.array(self._logged), numbers), warnings=warnings)

    def _decode(self, block: list[bytes]) -> None:
        self._columns.append(self._decoder.columns(block))
