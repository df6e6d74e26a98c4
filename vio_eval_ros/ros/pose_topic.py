"""A topic with poses: found out about, taken in serialised form, decoded in columns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
import importlib
import time
from typing import Any

import numpy as np
from rclpy.callback_groups import CallbackGroup
from rclpy.event_handler import (
    QoSSubscriptionEventType,
    SubscriptionEventCallbacks,
    UnsupportedEventTypeError,
)
from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
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
from vio_eval_ros.live.deliveries import Deliveries
from vio_eval_ros.live.health import counted, mixed, sent_before, undecodable
from vio_eval_ros.live.queues import PathQueue, Progress, RunQueue, TimeJump
from vio_eval_ros.live.snapshot import TopicState
from vio_eval_ros.live.timeliness import Arrivals
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
from vio_eval_ros.recordings.storage import spelled
from vio_eval_ros.ros.parameters import override_quality
from vio_eval_ros.ros.private import EventCounter, take_serialized

#: of the queue of the middleware, and of one look at it: more than any sensor sends between two
DEPTH = 20_000
#: how long a publisher that sends nothing keeps those of another type from being heard
SILENCE_S = 1.0
MISSING = ('sent_before', 'lost', 'full', 'undecodable')
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

    Its quality of service is what was asked for, but that it is latched where all publishers are:
    then what they sent before is heard.

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
        self._msgtype = spelled(msgtype)
        self._type_is_given = bool(msgtype)
        self._published_types: tuple[str, ...] = ()
        self._publishers: tuple[str, ...] = ()
        self._mixed = ''  # of the run: who sent it at once
        self._received_before = 0
        self._incompatibility = ''
        self._frame = ''
        self._counts = dict.fromkeys([*MISSING, *EVENTS], 0)
        self._counts_before: dict[str, int] = {}
        self._deliveries = Deliveries()
        self._heard_up_to = 0  # the number of the last message that the subscription before had
        self._node = node
        self._asked = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._raw: list[bytes] = []
        self._received_ns: list[int] = []  # of each of these, by the clock of the system
        self._arrivals: list[Arrivals] = []
        self._class: Any = None
        self._adjustment: Adjustment | None = None
        self._subscription: Subscription | None = None
        self._subscribed_s = 0.0  # monotonic
        self._events: dict[str, EventCounter] = {}
        override_quality(node, self.topic, self._asked)
        self._quality = self._asked
        if self._msgtype:
            self._subscribe(self._msgtype)

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
        """Look at the publishers; subscribe when the type is known, and as they offer."""
        found = self._node.get_publishers_info_by_topic(self._given)
        self._publishers = tuple(sorted(_full_name(info) for info in found))
        self._published_types = tuple(sorted({info.topic_type for info in found}))
        quality = _as_offered(self._asked, [info.qos_profile for info in found])
        if quality.durability != self._quality.durability:
            self._quality = quality
            if self._subscription is not None:
                self._subscribe(self._msgtype)
        self._choose_type()
        self._incompatibility = ''
        for info in found:
            verdict, reason = qos_check_compatible(info.qos_profile, self._quality)
            if verdict == QoSCompatibility.ERROR:
                reason = ' '.join(reason.split())
                self._incompatibility = reason.removeprefix('ERROR: ').rstrip(';')

    def read(self) -> None:
        """Take all messages that have arrived, and hand their poses to the queue."""
        self.drain()
        self._count_events()
        self._choose_type()
        if self.received > self._received_before:
            self._mixed = mixed(self.topic, self._publishers) or self._mixed
        self._received_before = self.received
        for arrived in self._decode():
            self.queue.add(arrived, self.received_s)

    def drain(self) -> None:
        """Take all messages that have arrived; decoding them can wait."""
        if self._subscription is None:
            return
        taken = take_serialized(self._subscription, self._class, DEPTH)
        if not taken.messages:
            return
        # what it had no room for was overwritten, which is no event
        is_bounded = self._quality.history == HistoryPolicy.KEEP_LAST
        is_full = is_bounded and len(taken.messages) >= self._quality.depth
        self._counts['full'] += is_full
        if taken.numbers[0] is not None:
            taken = taken.after(self._heard_again(taken.numbers))
            if taken.numbers:
                are_mixed = len(self._publishers) > 1
                self._deliveries.note(np.array(taken.numbers, np.int64), are_mixed, is_full)
        self._raw += taken.messages
        self._received_ns += taken.received_ns
        self.received += len(taken.messages)
        self.received_s = time.monotonic()

    def _heard_again(self, numbers: Sequence[int | None]) -> int:
        """Return how many of the first messages the subscription before this one had as well."""
        again = 0
        for number in numbers if self._heard_up_to else ():
            if number is None or number > self._heard_up_to:
                self._heard_up_to = 0
                break
            again += 1
        return again

    def resume(self, msgtype: str, poses: Poses) -> None:
        """Begin with what an evaluator before this one had received."""
        if self._subscription is None and msgtype:
            self._subscribe(msgtype)
        self.queue.resume(poses)
        self.received += len(poses)

    def notes(self) -> list[str]:
        """Return what is missing of the run: no other figure shows what did not arrive."""
        self._count_events()
        before, lost, full, bad = (
            self._counts[name] - self._counts_before.get(name, 0) for name in MISSING
        )
        found = []
        if before:
            found.append(sent_before(before, self.topic))
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
        received_ns, self._received_ns = self._received_ns, []
        if not raw:
            return
        if not self._frame:
            header = getattr(next(self._messages(raw), None), 'header', None)
            # what is adjusted is no longer in the frame of its messages
            self._frame = (header and not self._adjustment and header.frame_id) or 'world'
        if self._msgtype == PATH:
            yield from self._of_paths(raw)
            return
        found, twists = self._of_block(raw)
        if len(found) == len(raw) and received_ns[0]:
            times = np.array(received_ns, np.int64)
            self._arrivals.append(Arrivals(found, times, twists))
        yield found

    def _of_block(self, raw: list[bytes]) -> tuple[Poses, np.ndarray | None]:
        """Return the poses of messages, and their twists where the type has them."""
        if self._msgtype == cdr.ODOMETRY and (odometry := cdr.decode_odometry(raw)):
            stamps, numbers, twists = odometry
            return poses(stamps, numbers), twists
        columns = cdr.decode(self._msgtype, raw, ros1=False)
        return poses(*columns) if columns is not None else self._collected(raw), None

    def arrivals(self) -> list[Arrivals]:
        """Return what was read since the last call, and when it arrived, as far as is known."""
        arrivals, self._arrivals = self._arrivals, []
        return arrivals

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

    def _choose_type(self) -> None:
        """
        Subscribe to the type that is published, where it is not given.

        A publisher that has sent nothing does not stand in the way of one of another type.
        """
        if self._type_is_given or self.received:
            return
        scorable = [msgtype for msgtype in self._published_types if msgtype in STREAMED]
        others = [msgtype for msgtype in scorable if msgtype != self._msgtype]
        is_silent = self._msgtype not in scorable or self._subscribed_for_s > SILENCE_S
        if len(others) == 1 and (self._subscription is None or is_silent):
            self._subscribe(others[0])

    @property
    def _subscribed_for_s(self) -> float:
        return time.monotonic() - self._subscribed_s

    def _subscribe(self, msgtype: str) -> None:
        """Subscribe to a type, in place of what was subscribed to before."""
        if msgtype not in STREAMED:
            raise ConfigError(
                f'{self.name}_type: {msgtype} carries no pose that can be scored live; types that '
                f'do are {", ".join(STREAMED)}'
            )
        package, _, name = msgtype.split('/')
        try:
            kind = getattr(importlib.import_module(f'{package}.msg'), name)
        except ImportError:
            raise ConfigError(
                f'{self.topic}: {msgtype} needs the ROS package {package}; install it, or source '
                'the workspace that has it'
            ) from None
        self._unsubscribe()
        if kind is not self._class:
            self._msgtype = msgtype
            self._class = kind
            self.queue = PathQueue(self.topic) if msgtype == PATH else RunQueue()
            self._adjustment = adjustment_of(msgtype)
        self._subscription = self._node.create_subscription(
            kind,
            self._given,
            lambda message: None,
            self._quality,
            callback_group=Polled(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            raw=True,
        )
        self._subscribed_s = time.monotonic()
        for event_name, event in EVENTS.items():
            with suppress(UnsupportedEventTypeError):  # not all middlewares count
                self._events[event_name] = EventCounter(self._subscription, event)

    def _unsubscribe(self) -> None:
        if self._subscription is None:
            return
        self.drain()
        self._count_events()
        self._heard_up_to = max(self._deliveries.last or 0, 0)
        self._events.clear()
        self._node.destroy_subscription(self._subscription)
        self._subscription = None

    def _count_events(self) -> None:
        for name, event in self._events.items():
            self._counts[name] += event.count()
        self._counts['sent_before'] = self._deliveries.sent_before
        if self._deliveries.last is not None:  # by their numbers, which also tells what was full
            self._counts['lost'] = self._deliveries.lost


def _as_offered(asked: QoSProfile, offers: Sequence[QoSProfile]) -> QoSProfile:
    """Return a quality that is latched where all offers are; such messages are sent reliably."""
    latched = DurabilityPolicy.TRANSIENT_LOCAL
    if not offers or any(offer.durability != latched for offer in offers):
        return asked
    is_reliable = all(offer.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
    return QoSProfile(
        history=asked.history,
        depth=asked.depth,
        reliability=ReliabilityPolicy.RELIABLE if is_reliable else asked.reliability,
        durability=latched,
    )


def _full_name(info: TopicEndpointInfo) -> str:
    """Return the name of the node that publishes, with its namespace."""
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'
