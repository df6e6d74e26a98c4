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
from rclpy.node import Node
from rclpy.qos import (
    HistoryPolicy,
    qos_check_compatible,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from vio_eval_ros.core.trajectory import Poses
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live.health import counted, mixed, undecodable
from vio_eval_ros.live.queues import PathQueue, Progress, RunQueue, TimeJump
from vio_eval_ros.live.snapshot import TopicState
from vio_eval_ros.recordings import cdr
from vio_eval_ros.recordings.messages import (
    Adjustment,
    adjustment_of,
    collect,
    PATH,
    PathRevisions,
    poses,
    STREAMED,
)
from vio_eval_ros.ros.parameters import override_quality
from vio_eval_ros.ros.private import EventCounter, take_serialized

#: of the queue of the middleware, and of one look at it: more than any sensor sends between two
DEPTH = 20_000
MISSING = ('lost', 'full', 'undecodable')
EVENTS = {
    'incompatible': QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS,
    'lost': QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST,
}


class Polled(CallbackGroup):
    """
    A group whose subscriptions the executor leaves alone.

    Waking up for a message costs rclpy about 200 µs; taking many at a timer costs next to nothing.
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
    One of the two inputs: finds out its type, takes its messages and hands on their poses.

    :param name: ``estimate`` or ``ground_truth``.
    :param topic: as written in a parameter, or to be remapped.
    :param msgtype: its message type; empty finds it out from the publishers.
    :raises ConfigError: a message type without poses, or a quality of service that does not exist.
    """

    def __init__(self, node: Node, name: str, topic: str, msgtype: str) -> None:
        self.name = name
        self.topic = node.resolve_topic_name(topic)
        self._given = topic  # a name that is resolved would be remapped once more
        self.queue = RunQueue()
        self.received = 0
        #: when something came last [monotonic s]; at first, when this began
        self.received_s = time.monotonic()
        self._msgtype = msgtype
        self._type_is_given = bool(msgtype)
        self._published_types: tuple[str, ...] = ()
        self._publishers: tuple[str, ...] = ()
        self._mixed = ''  # of the run: who sent it at once
        self._received_before = 0
        self._incompatibility = ''
        self._frame = ''
        self._counts = {'full': 0, 'undecodable': 0, **dict.fromkeys(EVENTS, 0)}
        self._counts_before: dict[str, int] = {}
        self._node = node
        self._quality = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._raw: list[bytes] = []
        self._class: Any = None
        self._adjustment: Adjustment | None = None
        self._subscription: Subscription | None = None
        self._events: dict[str, EventCounter] = {}
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
        return self.queue.revisions if isinstance(self.queue, PathQueue) else None

    @property
    def silent_s(self) -> float:
        """How long nothing has come."""
        return time.monotonic() - self.received_s

    @property
    def progress(self) -> Progress:
        """How far its poses have come."""
        return Progress(self.topic, self.received_s, self._jump)

    @property
    def state(self) -> TopicState:
        """What is known of it."""
        return TopicState(
            name=self.name,
            topic=self.topic,
            oldest_ns=self.queue.oldest_ns,
            newest_ns=self.queue.newest_ns,
            msgtype=self._msgtype,
            type_is_given=self._type_is_given,
            published_types=self._published_types,
            publishers=self._publishers,
            received=self.received,
            incompatibility=self._incompatibility,
            silent_s=self.silent_s,
            unstamped=self.queue.unstamped,
            jump=self._jump,
            **self._counts,
        )

    @property
    def _jump(self) -> TimeJump | None:
        return self.queue.jumps[0] if self.queue.jumps else None

    def close(self) -> None:
        """Count no more events: that keeps the subscription in the graph."""
        self._events.clear()

    def discover(self) -> None:
        """Look at the publishers and at what was lost; subscribe when the type is known."""
        self._count_events()
        found = self._node.get_publishers_info_by_topic(self._given)
        self._publishers = tuple(sorted(_full_name(info) for info in found))
        if self.received > self._received_before:
            self._mixed = mixed(self.topic, self._publishers) or self._mixed
        self._received_before = self.received
        self._published_types = tuple(sorted({info.topic_type for info in found}))
        scorable = [msgtype for msgtype in self._published_types if msgtype in STREAMED]
        if self._subscription is None and len(scorable) == 1:
            self._subscribe(scorable[0])
        self._incompatibility = ''
        for info in found:
            verdict, reason = qos_check_compatible(info.qos_profile, self._quality)
            if verdict == QoSCompatibility.ERROR:
                reason = ' '.join(reason.split())
                self._incompatibility = reason.removeprefix('ERROR: ').rstrip(';')

    def read(self) -> None:
        """Take all messages that have arrived, and hand their poses to the queue."""
        self.drain()
        for arrived in self._decode():
            self.queue.add(arrived, self.received_s)

    def drain(self) -> None:
        """Take all messages that have arrived; decoding them can wait."""
        if self._subscription is None:
            return
        arrived = take_serialized(self._subscription, self._class, DEPTH)
        if arrived:
            self._raw += arrived
            self.received += len(arrived)
            self.received_s = time.monotonic()
        # what it had no room for was overwritten, which is no event
        is_bounded = self._quality.history == HistoryPolicy.KEEP_LAST
        self._counts['full'] += is_bounded and len(arrived) >= self._quality.depth

    def notes(self) -> list[str]:
        """Return what is missing of the run: no other figure shows what did not arrive."""
        self._count_events()
        lost, full, bad = (
            self._counts[name] - self._counts_before.get(name, 0) for name in MISSING
        )
        found = []
        if lost:
            found.append(f'{counted(lost, "message")} lost on {self.topic}; make it reliable')
        if full:
            times = counted(full, 'time')
            found.append(f'{self.topic}: the queue was full {times}, and may have lost messages')
        if bad:
            found.append(undecodable(bad, self.topic, self._msgtype))
        if self._mixed:
            found.append(self._mixed)
        return [f'{self.name.replace("_", " ")}: {line}' for line in found]

    def next_run(self) -> None:
        """Go on to the next run."""
        self.queue.next_run()
        self._mixed = ''
        self._count_events()
        self._counts_before = dict(self._counts)

    def _decode(self) -> Iterator[Poses]:
        """Yield the poses of the messages taken since the last call; of each Path by itself."""
        raw, self._raw = self._raw, []
        if not raw:
            return
        if not self._frame:
            header = getattr(next(self._messages(raw), None), 'header', None)
            # what is adjusted is no longer in the frame of its messages
            self._frame = (header and not self._adjustment and header.frame_id) or 'world'
        if self._msgtype == PATH:
            yield from self._of_paths(raw)
            return
        columns = cdr.decode(self._msgtype, raw, ros1=False)
        yield poses(*columns) if columns is not None else self._collected(raw)

    def _of_paths(self, raw: list[bytes]) -> Iterator[Poses]:
        for message in raw:
            columns = cdr.decode_path(message, ros1=False)
            revision = poses(*columns) if columns else self._collected([message])
            if len(revision):
                yield revision

    def _collected(self, raw: list[bytes]) -> Poses:
        """Return the poses of messages one by one, without those that are not of their type."""
        messages = list(self._messages(raw))
        self._counts['undecodable'] += len(raw) - len(messages)
        return collect(self._msgtype, messages, self._adjustment)

    def _messages(self, raw: list[bytes]) -> Iterator[Any]:
        """Yield the messages, but for those that are not what their type says."""
        for one in raw:
            try:
                message = deserialize_message(one, self._class)
            except RuntimeError:  # the middleware's
                continue
            yield message

    def _subscribe(self, msgtype: str) -> None:
        if msgtype not in STREAMED:
            raise ConfigError(
                f'{self.name}_type: {msgtype} carries no pose that can be scored live; types that '
                f'do are {", ".join(STREAMED)}'
            )
        self._msgtype = msgtype
        self.queue = PathQueue(self.topic) if msgtype == PATH else RunQueue()
        self._adjustment = adjustment_of(msgtype)
        package, _, name = msgtype.split('/')
        try:
            self._class = getattr(importlib.import_module(f'{package}.msg'), name)
        except ImportError:
            raise ConfigError(
                f'{self.topic}: {msgtype} needs the ROS package {package}; install it, or source '
                'the workspace that has it'
            ) from None
        self._subscription = self._node.create_subscription(
            self._class,
            self._given,
            lambda message: None,
            self._quality,
            callback_group=Polled(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )
        for name, event in EVENTS.items():
            with suppress(UnsupportedEventTypeError):  # not all middlewares count
                self._events[name] = EventCounter(self._subscription, event)

    def _count_events(self) -> None:
        for name, event in self._events.items():
            self._counts[name] = event.count()


def _full_name(info: TopicEndpointInfo) -> str:
    """Return the name of the node that publishes, with its namespace."""
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'
