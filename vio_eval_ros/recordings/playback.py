"""
What a recording plays: its messages in the order of time, as ROS 2 serialises them.

ROS 2 messages keep their bytes. ROS 1 messages are converted without loss but for the counter
``header.seq``, which ROS 2 does not have. EuRoC's ASL folders become the messages of EuRoC's bags.
All is read while it is played: what is in memory does not grow with the recording.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
import heapq
from operator import itemgetter
from pathlib import Path
from types import TracebackType

from rosbags.convert.converter import is_same_wireformat, migrate_bytes
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosReliability
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.asl import AslFolder, sensors_in
from vio_eval_ros.recordings.bags import HEADER, Topic
from vio_eval_ros.recordings.storage import (
    Channel,
    identify,
    McapStorage,
    rosbag2_files,
    RosbagsStorage,
    standard_types,
    Timed,
    unreadable,
)

RENAMED = {'tf/msg/tfMessage': 'tf2_msgs/msg/TFMessage'}  # the name before ROS 1 Hydro


@dataclass(frozen=True)
class Offer:
    """
    What the publisher of a topic offered its subscribers when it was recorded.

    :param reliable: lost messages are sent again.
    :param latched: who subscribes late gets the last messages ('transient local').
    :param depth: of the queue; 0 where that is not known.
    """

    reliable: bool = True
    latched: bool = False
    depth: int = 0

    @classmethod
    def of(cls, profile: Qos) -> Offer:
        """Return the offer in a recorded profile; what is unknown there is as by default."""
        return cls(
            profile.reliability != QosReliability.BEST_EFFORT,
            profile.durability == QosDurability.TRANSIENT_LOCAL,
            profile.depth if profile.history == QosHistory.KEEP_LAST else 0,
        )


class Playback:
    """
    A recording, open to be played; a context manager.

    ``topics`` lists what can be played, by name, with its type in ROS 2; ``offers`` has what is
    known of their publishers. ``first_ns`` and ``last_ns`` are when the first and the last message
    were recorded. ``warnings`` has a line for each topic that is left out.

    :param path: a ROS 1 bag, a rosbag2 folder, a bare .db3 or .mcap, or an ASL folder.
    :raises ReadError: where there is no recording at ``path``, it is empty or cannot be read.
    """

    def __init__(self, path: Path) -> None:
        with ExitStack() as stack:
            sensors = sensors_in(path)
            sources = [AslFolder(path, sensors)] if sensors else _storages(path, stack)
            self._sources = [source for source in sources if source.span_ns]
            if not self._sources:
                raise ReadError(path, 'there are no messages in it')
            self._stack = stack.pop_all()
        spans = [source.span_ns for source in self._sources]
        self.first_ns = min(first for first, _ in spans)
        self.last_ns = max(last for _, last in spans)
        self.warnings: list[str] = []
        self.topics: list[Topic] = []
        self.offers = {
            name: _common([offer for source in self._sources for offer in source.offers[name]])
            for source in self._sources
            for name in source.offers
        }
        counts: dict[str, Counter[str]] = defaultdict(Counter)
        for source in self._sources:
            for topic in source.topics:
                counts[topic.name][topic.msgtype] += topic.count
            self.warnings += [line for line in source.warnings if line not in self.warnings]
        for name, types in sorted(counts.items()):
            if len(types) > 1:
                self.warnings.append(f'{name} has messages of types {" and ".join(types)}')
            else:
                self.topics += [Topic(name, *item) for item in types.items()]

    def __enter__(self) -> Playback:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stack.close()

    def definition(self, topic: str) -> str:
        """
        Return the definition of the messages of a topic, as ROS 2 writes it.

        :raises ReadError: where the recording does not have it, and it is no standard one.
        """
        source = next(s for s in self._sources if topic in {one.name for one in s.topics})
        return source.definition(topic)

    def messages(self, names: set[str], start_ns: int, end_ns: int) -> Iterator[Timed]:
        """
        Return the messages of topics recorded from ``start_ns`` to ``end_ns``, both included.

        :raises ReadError: at once where an image cannot be read without Pillow, and at the point
            from which a recording is damaged.
        """
        streams = [
            _when_due(source.path, source.span_ns[0], source.messages(names, start_ns, end_ns))
            for source in self._sources
            if source.span_ns[0] <= end_ns and source.span_ns[1] >= start_ns
        ]
        return (message for _, message in heapq.merge(*streams, key=itemgetter(0)) if message)


def _when_due(
    path: Path, first_ns: int, messages: Iterator[Timed]
) -> Iterator[tuple[int, Timed | None]]:
    """Yield messages behind their times; of many files, those that are not yet due stay shut."""
    yield first_ns, None
    try:
        for message in messages:
            yield message[0], message
    except Exception as error:
        raise unreadable(path, error) from error


def _common(offers: list[Offer]) -> Offer:
    """Return what all publishers of a topic offered."""
    return Offer(
        all(offer.reliable for offer in offers),
        bool(offers) and all(offer.latched for offer in offers),
        max((offer.depth for offer in offers), default=0),
    )


class _TimedRosbags(RosbagsStorage):
    """A ROS 1 bag, an SQLite file or a compressed folder, with times and offers."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        super().__init__(path, stack)
        self.offers: dict[str, list[Offer]] = defaultdict(list)
        for connection, channel in zip(self._reader.connections, self.channels, strict=True):
            extension = connection.ext
            self.offers[channel.topic] += (
                [Offer.of(profile) for profile in extension.offered_qos_profiles]
                if self._reader.is2
                else [Offer(latched=bool(extension.latching))]
            )

    @property
    def span_ns(self) -> tuple[int, int] | None:
        """When the first and the last message were recorded, if there are any."""
        if not any(channel.count for channel in self.channels):
            return None
        return self._reader.start_time, self._reader.end_time - 1  # rosbags' end is one behind

    def timed(self, names: set[str], start_ns: int, end_ns: int) -> Iterator[Timed]:
        """Yield the raw messages of some topics from one time to another."""
        wanted = [
            connection
            for connection, channel in zip(self._reader.connections, self.channels, strict=True)
            if channel.topic in names
        ]
        if wanted:  # to rosbags, none means all
            topics = dict(zip(map(id, self._reader.connections), self.channels, strict=True))
            for connection, log_ns, raw in self._reader.messages(wanted, start_ns, end_ns + 1):
                yield log_ns, topics[id(connection)].topic, raw


class _TimedMcap(McapStorage):
    """An mcap file, with times and offers."""

    def __init__(self, path: Path, stack: ExitStack) -> None:
        super().__init__(path, stack)
        self.offers: dict[str, list[Offer]] = defaultdict(list)
        self.span_ns: tuple[int, int] | None = None
        summary = self._reader.get_summary()
        channels = summary.channels if self._is_indexed else {}
        if self._is_indexed and summary.chunk_indexes:
            chunks = [chunk for chunk in summary.chunk_indexes if chunk.message_end_time]
            self.span_ns = chunks and (
                min(chunk.message_start_time for chunk in chunks),
                max(chunk.message_end_time for chunk in chunks),
            )
        else:
            for _, channel, message in self._records():
                channels[channel.id] = channel
                first, last = self.span_ns or (message.log_time, message.log_time)
                self.span_ns = min(first, message.log_time), max(last, message.log_time)
        for channel in channels.values():
            profiles = parse_qos(channel.metadata.get('offered_qos_profiles', ''))
            self.offers['/' + channel.topic.lstrip('/')] += map(Offer.of, profiles)

    def timed(self, names: set[str], start_ns: int, end_ns: int) -> Iterator[Timed]:
        """Yield the raw messages of some topics from one time to another."""
        topics = {*names, *(name[1:] for name in names)}
        # a file without an index is played in the order in which it was written
        records = self._reader.iter_messages(topics) if self._is_indexed else self._records(topics)
        for _, channel, message in records:
            if message.log_time > end_ns and self._is_indexed:
                return
            if start_ns <= message.log_time <= end_ns:
                yield message.log_time, '/' + channel.topic.lstrip('/'), message.data


class _Converted:
    """A storage file whose messages are given in ROS 2's types and bytes."""

    def __init__(self, storage: _TimedRosbags | _TimedMcap) -> None:
        self.path = storage.path
        self.span_ns = storage.span_ns
        self.offers = storage.offers
        self.warnings: list[str] = []
        self.topics: list[Topic] = []
        self._storage = storage
        self._converters: dict[str, Callable[[bytes], bytes] | None] = {}
        self._channels: dict[str, Channel] = {}
        for channel in storage.channels:
            if channel.encoding not in ('cdr', 'ros1'):
                self.warnings.append(f'{channel.topic} is serialised as {channel.encoding!r}')
                continue
            msgtype = RENAMED.get(channel.msgtype, channel.msgtype)
            self.topics.append(Topic(channel.topic, msgtype, channel.count))
            self._channels[channel.topic] = channel
            self._converters[channel.topic] = _converter(
                storage.types(channel.msgtype), channel.msgtype, channel.encoding == 'ros1'
            )

    def messages(self, names: set[str], start_ns: int, end_ns: int) -> Iterator[Timed]:
        """Yield the messages of some topics from one time to another."""
        for log_ns, topic, raw in self._storage.timed(names, start_ns, end_ns):
            convert = self._converters[topic]
            yield log_ns, topic, convert(raw) if convert else raw

    def definition(self, topic: str) -> str:
        """Return the definition of the messages of a topic, as ROS 2 writes it."""
        channel = self._channels[topic]
        types = self._storage.types(channel.msgtype)
        msgtype = RENAMED.get(channel.msgtype, channel.msgtype)
        if channel.encoding == 'ros1':
            types = _of_ros2(types, msgtype)
        if msgtype not in types.fielddefs:
            raise ReadError(topic, f'the recording has no definition of {msgtype}')
        return types.generate_msgdef(msgtype, ros_version=2)[0]


def _storages(path: Path, stack: ExitStack) -> Sequence[_Converted]:
    """Return the open storage files of a recording; the stack closes them."""
    try:
        files, compressed = rosbag2_files(path) if path.is_dir() else ((path,), False)
        kinds = [identify(file, compressed) for file in files]
        # Compressed folders are left to rosbags, as in bags.Recording.
        opened = [(path, 'rosbag2')] if compressed else zip(files, kinds, strict=True)
        return [
            _Converted((_TimedMcap if kind == 'mcap' else _TimedRosbags)(file, stack))
            for file, kind in opened
        ]
    except Exception as error:
        raise unreadable(path, error) from error


def _converter(types: Typestore, msgtype: str, ros1: bool) -> Callable[[bytes], bytes] | None:
    """
    Return what makes ROS 2's bytes of a recorded message; None where they are that already.

    A few types have fields in ROS 2 that they do not have in ROS 1; those take their defaults.
    """
    if not ros1:
        return None
    today = RENAMED.get(msgtype, msgtype)
    target = _of_ros2(types, today)
    if is_same_wireformat(types, target, msgtype, today):
        return lambda raw: bytes(target.ros1_to_cdr(raw, today))
    migrate = partial(migrate_bytes, types, target, msgtype, today, {})
    return lambda raw: bytes(migrate(raw, src_is2=False, dst_is2=True))


def _of_ros2(types: Typestore, msgtype: str) -> Typestore:
    """Return the definitions of ROS 2 for a type that a recording of ROS 1 defines."""
    standard = standard_types(ros1=False)
    if msgtype in standard.fielddefs:
        return standard
    target = get_typestore(Stores.EMPTY)
    target.register({**types.fielddefs, HEADER: standard.fielddefs[HEADER]})
    return target
