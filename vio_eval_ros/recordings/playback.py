"""
What a recording plays: its messages in the order of time, as ROS 2 serialises them.

ROS 2 messages keep their bytes. ROS 1 messages are converted without loss but for the counter
``header.seq``, which ROS 2 does not have. EuRoC's ASL folders become the messages of EuRoC's bags.
All is read while it is played: memory does not grow with the recording.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType

from rosbags.typesys import get_typestore, Stores

from vio_eval_ros.errors import ReadError
from vio_eval_ros.recordings.container import Container, Topic
from vio_eval_ros.recordings.decoder import HEADER
from vio_eval_ros.recordings.euroc import EurocFolder, sensors_in
from vio_eval_ros.recordings.rosbags_internals import to_cdr, Typestore
from vio_eval_ros.recordings.storage import Channel, OfferedQos, standard_types
from vio_eval_ros.recordings.storage_files import reading

MOST_LATCHED = 1000  # messages of a topic that are kept for late subscribers
RENAMED = {'tf/msg/tfMessage': 'tf2_msgs/msg/TFMessage'}  # the name before ROS 1 Hydro

TimedMessage = tuple[int, str, bytes]  # when a message was recorded [ns], its topic and its CDR


class Playback:
    """
    A recording, open to be played; a context manager.

    ``topics`` lists what can be played, by name, with its type in ROS 2; ``offers`` has what is
    known of their publishers. ``first_ns`` and ``last_ns`` are when the first and the last message
    were recorded. ``warnings`` has a line for each topic that is left out, ``notes`` what is
    unusual about the files.

    :param path: a ROS 1 bag, a rosbag2 folder, a bare .db3 or .mcap, or an ASL folder.
    :raises ReadError: where there is no recording at ``path``, it is empty or cannot be read.
    """

    def __init__(self, path: Path) -> None:
        with ExitStack() as stack:
            sensors = sensors_in(path)
            self._source: EurocFolder | _Converted = (
                EurocFolder(path, sensors)
                if sensors
                else _Converted(stack.enter_context(Container(path)))
            )
            if self._source.span_ns is None:
                raise ReadError(path, 'there are no messages in it')
            self._stack = stack.pop_all()
        self.first_ns, self.last_ns = self._source.span_ns
        self.topics: list[Topic] = self._source.topics
        self.offers: Mapping[str, OfferedQos] = self._source.offers
        self.warnings: list[str] = self._source.warnings
        self.notes: list[str] = self._source.notes

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

        :raises ReadError: where the recording does not have it, and it is not a standard one.
        """
        return self._source.definition(topic)

    def messages(self, names: set[str], start_ns: int, end_ns: int) -> Iterator[TimedMessage]:
        """
        Return the messages of topics recorded from ``start_ns`` to ``end_ns``, both included.

        :raises ReadError: at once where an image cannot be read without Pillow, and at the point
            from which a recording is damaged.
        """
        return self._source.messages(names, start_ns, end_ns)


class _Converted:
    """An open recording whose messages are given in ROS 2's types and bytes."""

    def __init__(self, container: Container) -> None:
        self._container = container
        self.span_ns = container.span_ns()
        self.notes = container.warnings
        self.warnings: list[str] = []
        self.topics: list[Topic] = []
        self._converters: dict[Channel, Callable[[bytes], bytes]] = {}
        counts: dict[str, Counter[str]] = defaultdict(Counter)
        for channel in container.channels:
            try:
                with reading(channel.topic):
                    self._converters[channel] = _converter(channel)
            except ReadError as error:
                line = f'{channel.topic} {error.problem}'
                self.warnings += [] if line in self.warnings else [line]
            else:
                counts[channel.topic][_today(channel)] += channel.count
        for name, types in sorted(counts.items()):
            if len(types) > 1:
                self.warnings.append(f'{name} has messages of types {" and ".join(types)}')
            else:
                self.topics += [Topic(name, *item) for item in types.items()]
        offers = container.offers()
        self.offers = {
            topic.name: _for_all(offers[topic.name], topic.count)
            for topic in self.topics
            if topic.name in offers
        }

    def messages(self, names: set[str], start_ns: int, end_ns: int) -> Iterator[TimedMessage]:
        """Yield the messages of topics from one time to another, both included."""
        with reading(self._container.path):
            for log_ns, channel, raw in self._container.messages(names, start_ns, end_ns):
                if convert := self._converters.get(channel):
                    yield log_ns, channel.topic, convert(raw)

    def definition(self, topic: str) -> str:
        """Return the definition of the messages of a topic, as ROS 2 writes it."""
        channel = next(channel for channel in self._converters if channel.topic == topic)
        types, msgtype = channel.types(), _today(channel)
        if channel.encoding == 'ros1':
            types = _of_ros2(types, msgtype)
        if msgtype not in types.fielddefs:
            raise ReadError(topic, f'the recording has no definition of {msgtype}')
        return types.generate_msgdef(msgtype, ros_version=2)[0]


def _for_all(offer: OfferedQos, count: int) -> OfferedQos:
    """
    Return an offer with which one publisher stands for all that there were.

    Which of them sent a message was not recorded. Late subscribers get the last latched ones of
    each of them only where they get all.
    """
    if not offer.latched or offer.publishers == 1:
        return offer
    return replace(offer, depth=min(max(offer.depth, count), MOST_LATCHED))


def _today(channel: Channel) -> str:
    """Return the name that the message type of a channel has in ROS 2."""
    return RENAMED.get(channel.msgtype, channel.msgtype)


def _converter(channel: Channel) -> Callable[[bytes], bytes]:
    """Return what turns a recorded message into ROS 2's bytes."""
    if channel.encoding == 'cdr':
        return bytes
    if channel.encoding != 'ros1':
        raise ReadError(channel.topic, f'is serialised as {channel.encoding!r}')
    types, msgtype = channel.types(), _today(channel)
    return to_cdr(types, _of_ros2(types, msgtype), channel.msgtype, msgtype)


def _of_ros2(types: Typestore, msgtype: str) -> Typestore:
    """Return the definitions of ROS 2 for a type that a recording of ROS 1 defines."""
    standard = standard_types(ros1=False)
    if msgtype in standard.fielddefs:
        return standard
    target = get_typestore(Stores.EMPTY)
    target.register({**types.fielddefs, HEADER: standard.fielddefs[HEADER]})
    return target
