"""Poses from ROS recordings: ROS 1 bags, rosbag2 folders and bare .db3 or .mcap files."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import islice
import re
from typing import NamedTuple

import numpy as np

from vio_eval_ros.core.config import nearest_name
from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ReadError, UnsupportedMessage
from vio_eval_ros.recordings.container import Container, Topic
from vio_eval_ros.recordings.decoder import Decoder
from vio_eval_ros.recordings.messages import ArrayConverter, CONVERTERS
from vio_eval_ros.recordings.progress import Progress, silent
from vio_eval_ros.recordings.storage_files import reading
from vio_eval_ros.recordings.topic_poses import by_recording, collector_of, TopicPoses
from vio_eval_ros.recordings.transforms import static_topics, TransformTree, TREE_TYPES

ELEMENT = re.compile(r'(/.*?)\[(.*)\]')

# what follows the name of a TF topic in a spec
FRAMES = ':PARENT.CHILD'
# of a TF topic, an error lists some of the transforms in its first messages
FIRST_MESSAGES, LISTED_TRANSFORMS = 1000, 10
# Takes the time [ns] at which a message was recorded, and its bytes.
Sink = Callable[[int, bytes], None]


class Wanted(NamedTuple):
    """
    What is to be read of a recording.

    :param topic: its name.
    :param element: of an array, by name or index; None where none is chosen.
    :param frames: 'PARENT.CHILD' of a TF topic; None for others.
    :param stamps: 'recorded' where the time of recording takes the place of the stamps, 'header'
        where these are right whatever they look like; '' where nothing is stated.
    """

    topic: str
    element: str | None
    frames: str | None
    stamps: str

    @property
    def recorded(self) -> bool:
        """Whether the time of recording takes the place of the stamps."""
        return self.stamps == 'recorded'

    @classmethod
    def parse(cls, spec: str) -> Wanted:
        """Return what a spec of :meth:`Recording.read` names."""
        body, _, stated = spec.partition('?')
        name, colon, frames = body.partition(':')
        chosen = ELEMENT.fullmatch(name)
        topic, element = chosen.groups() if chosen else (name, None)
        return cls(topic, element, frames if colon else None, stated.removeprefix('stamps='))


class Frames(NamedTuple):
    """Names of the frames that poses are in, and of those whose poses they are, as found."""

    parents: tuple[str, ...] = ()
    children: tuple[str, ...] = ()


class Recording(Container):
    """A recording of which poses are read; ``warnings`` grow by what :meth:`read` leaves out."""

    def read(self, specs: Sequence[str], progress: Progress = silent) -> list[TopicPoses]:
        """
        Return the poses of topics and transforms, in a single pass over the recording.

        :param specs: '/topic', '/topic[NAME]' for an element of arrays, or '/tf:PARENT.CHILD' for
            the motion of CHILD in PARENT, chained through the tree on that TF topic and the static
            one beside it; with '?stamps=recorded', at the times at which the messages were
            recorded.
        :param progress: wraps the iterable of messages given their number, as ``tqdm`` would.
        :raises ReadError: unknown or empty topics, unknown frames, a damaged recording.
        :raises UnsupportedMessage: a topic whose messages carry no pose.
        """
        sinks: dict[str, list[Sink]] = defaultdict(list)
        results: dict[str, Callable[[], TopicPoses]] = {}
        trees: dict[tuple[str, bool], TransformTree] = {}
        for spec in dict.fromkeys(specs):
            wanted = Wanted.parse(spec)
            topic = self._topic(wanted)
            if wanted.frames is not None:
                key = wanted.topic, wanted.recorded
                if key not in trees:
                    trees[key] = self._feed_tree(topic, sinks, wanted.recorded)
                notes = (by_recording(f'{self.path}:{spec}'),) if wanted.recorded else ()
                results[spec] = partial(_looked_up, trees[key], wanted.frames, notes)
            else:
                collector = collector_of(self.decoder(topic), wanted.element, wanted.recorded)
                sinks[wanted.topic].append(collector.add)
                results[spec] = collector.read

        self.feed(sinks, progress)
        read = {spec: result() for spec, result in results.items()}
        for spec, found in read.items():
            self._check(spec, found.poses, Wanted.parse(spec).recorded)
        self._check_clocks(read)
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
        other = ', or its metadata.yaml belongs to another recording' * self.path.is_dir()
        for name, count in expected.items():
            if received[name] < count:
                raise ReadError(
                    f'{self.path}:{name}',
                    f'only {received[name]} of the {count} messages in the index are there; the '
                    f'recording is damaged{other}',
                )

    def _check(self, spec: str, poses: Poses, recorded: bool) -> None:
        """Raise ``ReadError`` where there is no pose, or where all have the same stamp."""
        source = f'{self.path}:{spec}'
        stamps = poses.stamps_ns
        if not len(stamps):
            raise ReadError(source, 'its messages have no poses')
        if not np.isfinite(poses.positions).all(axis=1).any():
            raise ReadError(
                source,
                f'none of its {len(poses)} messages has a position, or a fix with its altitude',
            )
        if np.ptp(stamps) or (len(stamps) == 1 and stamps[0]):
            return
        if recorded:
            raise ReadError(source, 'all its messages were recorded at the same time')
        seconds = int(stamps[0]) / 1e9
        value = f'is the same, {seconds:.3f} s' if seconds else 'is 0: it was never set'
        raise ReadError(
            source,
            f'the stamp of every message {value}; to take the time at which each was recorded, '
            f'write {spec}?stamps=recorded',
        )

    def _check_clocks(self, read: Mapping[str, TopicPoses]) -> None:
        """Raise ``ReadError`` where some stamps count from the start of a device, others not."""
        from_boot = [spec for spec, found in read.items() if found.from_boot]
        if len(from_boot) == len(read):
            return
        for spec in from_boot:
            wanted, first_ns = Wanted.parse(spec), int(read[spec].poses.stamps_ns[0])
            if wanted.stamps:
                continue
            msgtype = next(one.msgtype for one in self.topics if one.name == wanted.topic)
            raise ReadError(
                f'{self.path}:{spec}',
                f'the stamps of {msgtype} count from the boot of the autopilot (the first is '
                f'{first_ns / 1e9:.3f} s), those of the other topic do not; take the time of '
                f'recording with {spec}?stamps=recorded, or let `diagnose` find the offset with '
                f'{spec}?stamps=header',
            )

    def _topic(self, wanted: Wanted) -> Topic:
        """Return a topic, or explain why it cannot be evaluated."""
        name = wanted.topic
        source = f'{self.path}:{name}'
        found = [topic for topic in self.topics if topic.name == name]
        if not found:
            near = nearest_name(name, [topic.name for topic in self.topics])
            raise ReadError(source, f'there is no such topic{near or ";"} {self.choice()}')
        if len(found) > 1:
            types = ' and '.join(topic.msgtype for topic in found)
            raise ReadError(source, f'has messages of different types: {types}')
        (topic,) = found
        is_tree = topic.msgtype in TREE_TYPES
        if is_tree and wanted.frames is None:
            listed = self._transforms_of(topic)
            raise UnsupportedMessage(source, f'carries transforms; write {name}{FRAMES}{listed}')
        if wanted.frames is not None and not is_tree:
            raise UnsupportedMessage(source, f'carries {topic.msgtype}, not transforms')
        if not is_tree:
            self._check_poses(topic)
        if not topic.count:
            raise ReadError(source, f'has no messages; {self.choice()}')
        return topic

    def _check_poses(self, topic: Topic) -> None:
        """Raise ``UnsupportedMessage``, with what there is instead, where a topic has no pose."""
        try:
            _ = self.decoder(topic).converter
        except UnsupportedMessage as error:
            raise UnsupportedMessage(error.source, f'{error.problem}; {self.choice()}') from None

    def choice(self) -> str:
        """Return a sentence that lists what can be evaluated."""
        listed = self.choices()
        trees = [one for one in self.topics if one.count and self._selector(one) == FRAMES]
        sentence = f'topics with poses: {", ".join(listed)}' if listed else 'no topic has poses'
        return sentence + ''.join(map(self._transforms_of, trees))

    def _transforms_of(self, topic: Topic) -> str:
        """Return which transforms a TF topic has, by its first messages; empty if unreadable."""
        sinks: dict[str, list[Sink]] = defaultdict(list)
        try:
            tree = self._feed_tree(topic, sinks, recorded=False)
            for log_ns, channel, raw in islice(self.as_written(set(sinks)), FIRST_MESSAGES):
                for sink in sinks[channel.topic]:
                    sink(log_ns, raw)
        except ReadError:
            return ''
        sent = sorted(tree.sent(), key=len)
        more = ' and more' if len(sent) > LISTED_TRANSFORMS else ''
        motion = tree.main_motion()
        example = f'; write {topic.name}:{motion}, for example' if motion else ''
        return f'; {topic.name} has {", ".join(sent[:LISTED_TRANSFORMS])}{more}{example}'

    def frames(self, spec: str) -> Frames:
        """Return the frames that the first messages of a topic name; those of a spec of TF."""
        wanted = Wanted.parse(spec)
        if wanted.frames is not None:
            parent, dot, child = wanted.frames.partition('.')
            return Frames((parent,), (child,)) if dot and '.' not in child else Frames()
        decoder = self.decoder(self._topic(wanted))
        found: tuple[dict[str, None], dict[str, None]] = {}, {}
        for _, _, raw in islice(self.as_written({wanted.topic}), FIRST_MESSAGES):
            with decoder.reading():
                content = decoder.deserialize(raw)
            parent = getattr(getattr(content, 'header', content), 'frame_id', '')
            child = getattr(content, 'child_frame_id', '')
            for names, name in zip(found, (parent, child), strict=True):
                if isinstance(name, str) and name:
                    names[name] = None
        return Frames(*map(tuple, found))

    def choices(self) -> list[str]:
        """Return the specs of what can be evaluated, each with type and number of messages."""
        return [
            f'{topic.name}{selector} ({topic.msgtype}, {topic.count})'
            for topic in self.topics
            if (selector := self._selector(topic)) is not None
        ]

    def _selector(self, topic: Topic) -> str | None:
        """Return what follows the name of a topic in a spec; None where it has no poses."""
        if topic.msgtype in TREE_TYPES:
            # what is on a static topic does not move
            return None if static_topics('', [topic.name]) else FRAMES
        try:
            decoder = self.decoder(topic)
            is_array = isinstance(decoder.converter, ArrayConverter)
        except ReadError:
            return None
        # of the standard types that have a pose, the table has all that tell of a motion
        is_listed = decoder.msgtype in CONVERTERS or not decoder.is_standard
        return ('[NAME]' if is_array else '') if is_listed else None

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
        self, topic: Topic, sinks: dict[str, list[Sink]], recorded: bool
    ) -> TransformTree:
        """Return a tree that is fed with the messages of a TF topic and of the static ones."""
        names = [one.name for one in self.topics if one.msgtype in TREE_TYPES]
        static = static_topics(topic.name, names)
        tree = TransformTree(f'{self.path}:{topic.name}', static)

        def sink(decoder: Decoder, static: str, log_ns: int, message: bytes) -> None:
            with reading(decoder.source):
                recorded_ns = log_ns if recorded else None
                tree.add(decoder.deserialize(message), static, recorded_ns)

        for name in dict.fromkeys([topic.name, *static]):
            fed = next(one for one in self.topics if one.name == name)
            sinks[name].append(partial(sink, self.decoder(fed), name if name in static else ''))
        return tree


def _looked_up(tree: TransformTree, frames: str, warnings: tuple[str, ...]) -> TopicPoses:
    return TopicPoses(tree.lookup(frames), warnings=warnings)
