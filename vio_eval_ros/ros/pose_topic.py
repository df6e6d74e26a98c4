"""A topic with poses: found out about, taken in serialised form, decoded in columns."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
import importlib
import time
from typing import Any

from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import (
    QoSSubscriptionEventType,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.node import Node
from rclpy.qos import (
    HistoryPolicy,
    qos_check_compatible,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.serialization import deserialize_message

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live.queues import PathQueue, RunQueue
from vio_eval_ros.recordings import cdr
from vio_eval_ros.recordings.messages import collect, CONVERTERS, PATH, PathRevisions, poses
from vio_eval_ros.ros.parameters import override_quality

# more than any sensor sends between two looks
DEPTH = 20_000
MISSING = ('lost', 'full', 'undecodable')
COUNTED = {
    'incompatible': QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS,
    'lost': QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST,
}


class Polled(CallbackGroup):
    """
    What the executor leaves alone.

    Waking up for a message costs rclpy some 200 µs; taking many at a timer costs next to nothing.
    """

    def can_execute(self, entity: Any) -> bool:
        """Return False: the owner takes the messages itself."""
        return False

    def beginning_execution(self, entity: Any) -> bool:
        """Return False, likewise."""
        return False

    def ending_execution(self, entity: Any) -> None:
        """Do nothing."""


class PoseTopic:
    """
    One of the two inputs.

    :param name: ``estimate`` or ``ground_truth``; remap it to the topic.
    :param msgtype: its message type; empty finds it out from the publishers.
    :raises ConfigError: a message type without poses, or a quality of service that does not exist.
    """

    def __init__(self, node: Node, name: str, msgtype: str) -> None:
        self.name = name
        self.topic = node.resolve_topic_name(name)
        self.msgtype = msgtype
        self.is_given = bool(msgtype)
        self.published_types: list[str] = []
        self._frame = ''
        self.publishers = 0
        self.received = 0
        self.lost = 0
        self.incompatible = 0
        self.incompatibility = ''
        self.undecodable = 0
        self.full = 0
        self.runs = RunQueue()
        self._node = node
        self._quality = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._raw: list[bytes] = []
        self._before: dict[str, int] = {}
        self._class: Any = None
        self._subscription: Any = None
        self._events: dict[str, Any] = {}
        #: when something came last [monotonic s]; at first, when this began
        self.received_s = time.monotonic()
        override_quality(node, self.topic, self._quality)
        if msgtype:
            self._subscribe(msgtype)

    @property
    def frame(self) -> str:
        """The frame of its poses."""
        return self._frame or 'world'

    @property
    def revisions(self) -> PathRevisions | None:
        """What the messages of the run said, where they are Paths."""
        return self.runs.revisions if isinstance(self.runs, PathQueue) else None

    def discover(self) -> None:
        """Look at the publishers and at what was lost; subscribe when the type is known."""
        self._count_events()
        # its name, since a name that is resolved would be remapped once more
        found = self._node.get_publishers_info_by_topic(self.name)
        self.publishers = len(found)
        self.published_types = sorted({info.topic_type for info in found})
        scorable = [msgtype for msgtype in self.published_types if msgtype in CONVERTERS]
        if self._subscription is None and len(scorable) == 1:
            self._subscribe(scorable[0])
        self.incompatibility = ''
        for info in found:
            verdict, reason = qos_check_compatible(info.qos_profile, self._quality)
            if verdict == QoSCompatibility.ERROR:
                self.incompatibility = ' '.join(reason.split()).removeprefix('ERROR: ').rstrip(';')

    def read(self) -> None:
        """Take all messages that have arrived, and hand their poses to ``runs``."""
        self.drain()
        for arrived in self.decode():
            self.runs.add(arrived, self.received_s)

    def drain(self) -> None:
        """Take all messages that have arrived."""
        if self._subscription is None:
            return
        taken = len(self._raw)
        with self._subscription.handle:
            take = self._subscription.handle.take_message
            while (message := take(self._class, True)) is not None:
                self._raw.append(message[0])
                if len(self._raw) - taken >= DEPTH:
                    break
        count = len(self._raw) - taken
        if count:
            self.received += count
            self.received_s = time.monotonic()
        # what it had no room for was overwritten, which is no event
        is_bounded = self._quality.history == HistoryPolicy.KEEP_LAST
        self.full += is_bounded and count >= self._quality.depth

    def decode(self) -> Iterator[Poses]:
        """Yield the poses of the messages taken since the last call; of each Path by itself."""
        raw, self._raw = self._raw, []
        if not raw:
            return
        if not self._frame:
            first = next(self._messages(raw), None)
            self._frame = (first and first.header.frame_id) or 'world'
        if self.msgtype == PATH:
            yield from self._of_paths(raw)
            return
        columns = cdr.decode(self.msgtype, raw, ros1=False)
        yield poses(*columns) if columns is not None else self._collected(raw)

    def notes(self) -> list[str]:
        """Return what is missing of the run: what did not arrive no other figure tells."""
        self._count_events()
        lost, full, undecodable = (
            getattr(self, counter) - self._before.get(counter, 0) for counter in MISSING
        )
        found = []
        if lost:
            found.append(f'{lost} messages on {self.topic} were lost; make it reliable')
        if full:
            found.append(f'{self.topic}: {full} times the queue was full, and may have lost some')
        if undecodable:
            found.append(f'{undecodable} messages on {self.topic} are no {self.msgtype}')
        return [f'{self.name.replace("_", " ")}: {line}' for line in found]

    def silent_s(self) -> float:
        """Return for how long nothing has come."""
        return time.monotonic() - self.received_s

    def next_run(self) -> None:
        """Go on to the next run."""
        self.runs.next_run()
        self._count_events()
        self._before = {counter: getattr(self, counter) for counter in MISSING}

    def release(self) -> None:
        """Hand on what is withheld: no more will come to tell what it is."""
        self.runs.release()

    def _of_paths(self, raw: list[bytes]) -> Iterator[Poses]:
        for message in raw:
            columns = cdr.decode_path(message, ros1=False)
            revision = poses(*columns) if columns else self._collected([message])
            if len(revision):
                yield revision

    def _collected(self, raw: list[bytes]) -> Poses:
        """Return the poses of messages one by one, without those that are not of their type."""
        messages = list(self._messages(raw))
        self.undecodable += len(raw) - len(messages)
        return collect(self.msgtype, messages)

    def _messages(self, raw: list[bytes]) -> Iterator[Any]:
        """Yield the messages, but for those that are not what their type says."""
        for one in raw:
            try:
                message = deserialize_message(one, self._class)
            except RuntimeError:  # the middleware's
                continue
            yield message

    def _subscribe(self, msgtype: str) -> None:
        if msgtype not in CONVERTERS:
            raise ConfigError(
                f'{self.name}_type: {msgtype} carries no pose; types that do are '
                f'{", ".join(CONVERTERS)}'
            )
        self.msgtype = msgtype
        self.runs = PathQueue(self.topic) if msgtype == PATH else RunQueue()
        package, _, name = msgtype.split('/')
        self._class = getattr(importlib.import_module(f'{package}.msg'), name)
        self._subscription = self._node.create_subscription(
            self._class,
            self.name,
            lambda message: None,
            self._quality,
            callback_group=Polled(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )
        for counter, event in COUNTED.items():
            with suppress(UnsupportedEventTypeError):  # not all middlewares count
                self._events[counter] = _rclpy.EventHandle(self._subscription.handle, event)

    def _count_events(self) -> None:
        # asked for, since with an event in the wait set every message would wake the executor
        for name, event in self._events.items():
            with event:
                status = event.take_event()
            if status is not None:
                setattr(self, name, status.total_count)
