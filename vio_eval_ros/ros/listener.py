"""A topic whose messages are taken in serialised form, many at a time, and none lost unseen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live.deliveries import Deliveries
from vio_eval_ros.live.health import counted, sent_before
from vio_eval_ros.ros.parameters import override_quality
from vio_eval_ros.ros.private import EventCounter, take_serialized

#: of the queue of the middleware, and of one look at it: more than any sensor sends between two
DEPTH = 20_000
EVENTS = {
    'incompatible': QoSSubscriptionEventType.RCL_SUBSCRIPTION_REQUESTED_INCOMPATIBLE_QOS,
    'lost': QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST,
}
COUNTED = ('sent_before', 'lost', 'full', 'incompatible')


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


class Listener:
    """
    A topic that is listened to, as soon as its type is known.

    Its quality of service is what was asked for, but that it is latched where all publishers are:
    then what they sent before is heard.

    :param topic: as written in a parameter, or to be remapped.
    :raises ConfigError: a quality of service that does not exist.
    """

    def __init__(self, node: Node, topic: str) -> None:
        self.topic = node.resolve_topic_name(topic)
        self.published_types: tuple[str, ...] = ()
        #: the full names of the nodes that publish it
        self.publishers: tuple[str, ...] = ()
        #: why publisher and subscription do not understand each other
        self.incompatibility = ''
        #: how many messages have come
        self.received = 0
        #: when the last came [monotonic s]; at first, when this began
        self.received_s = time.monotonic()
        #: how many were lost, and how
        self.counts = dict.fromkeys(COUNTED, 0)
        self._node = node
        self._given = topic  # a name that is resolved would be remapped once more
        self._deliveries = Deliveries()
        self._heard_up_to = 0  # the number of the last message that the subscription before had
        self._asked = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._raw: list[bytes] = []
        self._received_ns: list[int] = []  # of each of these, by the clock of the system
        self._class: Any = None
        self._subscription: Subscription | None = None
        self._subscribed_s = 0.0  # monotonic
        self._events: dict[str, EventCounter] = {}
        override_quality(node, self.topic, self._asked)
        self._quality = self._asked

    @property
    def silent_s(self) -> float:
        """How long nothing has come."""
        return time.monotonic() - self.received_s

    @property
    def is_subscribed(self) -> bool:
        """Whether there is a subscription."""
        return self._subscription is not None

    @property
    def subscribed_for_s(self) -> float:
        """How long there has been this subscription."""
        return time.monotonic() - self._subscribed_s

    def close(self) -> None:
        """Count no more events: that keeps the subscription in the graph."""
        self._events.clear()

    def discover(self) -> None:
        """Look at the publishers; subscribe as they offer."""
        found = self._node.get_publishers_info_by_topic(self._given)
        self.publishers = tuple(sorted(_full_name(info) for info in found))
        self.published_types = tuple(sorted({info.topic_type for info in found}))
        quality = _as_offered(self._asked, [info.qos_profile for info in found])
        if quality.durability != self._quality.durability:
            self._quality = quality
            if self.is_subscribed:
                self._subscribe()
        self.incompatibility = ''
        for info in found:
            verdict, reason = qos_check_compatible(info.qos_profile, self._quality)
            if verdict == QoSCompatibility.ERROR:
                reason = ' '.join(reason.split())
                self.incompatibility = reason.removeprefix('ERROR: ').rstrip(';')

    def subscribe(self, msgtype: str) -> None:
        """
        Subscribe to a type, in place of what was subscribed to before.

        :raises ConfigError: its package is not installed.
        """
        package, _, name = msgtype.split('/')
        try:
            self._class = getattr(importlib.import_module(f'{package}.msg'), name)
        except ImportError:
            raise ConfigError(
                f'{self.topic}: {msgtype} needs the ROS package {package}; install it, or source '
                'the workspace that has it'
            ) from None
        self._subscribe()

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
        self.counts['full'] += is_full
        if taken.numbers[0] is not None:
            taken = taken.after(self._heard_again(taken.numbers))
            if taken.numbers:
                are_mixed = len(self.publishers) > 1
                self._deliveries.note(np.array(taken.numbers, np.int64), are_mixed, is_full)
        self._raw += taken.messages
        self._received_ns += taken.received_ns
        self.received += len(taken.messages)
        self.received_s = time.monotonic()

    def take(self) -> tuple[list[bytes], list[int]]:
        """Return the messages that have come since the last call, and when each came [ns]."""
        self.drain()
        self.count_events()
        raw, self._raw = self._raw, []
        received_ns, self._received_ns = self._received_ns, []
        return raw, received_ns

    def deserialised(self, raw: bytes) -> Any:
        """Return a message; None where it is not what its type says."""
        try:
            return deserialize_message(raw, self._class)
        except RuntimeError:  # the middleware's
            return None

    def count_events(self) -> None:
        """Bring the counts up to date."""
        for name, event in self._events.items():
            self.counts[name] += event.count()
        self.counts['sent_before'] = self._deliveries.sent_before
        if self._deliveries.last is not None:  # by their numbers, which also tells what was full
            self.counts['lost'] = self._deliveries.lost

    def missing(self, before: Mapping[str, int]) -> list[str]:
        """Return what was lost since some earlier counts, in words."""
        earlier, lost, full = (
            self.counts[name] - before.get(name, 0) for name in ('sent_before', 'lost', 'full')
        )
        found = []
        if earlier:
            found.append(sent_before(earlier, self.topic))
        if lost:
            found.append(f'{counted(lost, "message")} lost on {self.topic}; make it reliable')
        if full:
            times = counted(full, 'time')
            found.append(f'{self.topic}: the queue was full {times}, and may have lost messages')
        return found

    def _heard_again(self, numbers: Sequence[int | None]) -> int:
        """Return how many of the first messages the subscription before this one had as well."""
        again = 0
        for number in numbers if self._heard_up_to else ():
            if number is None or number > self._heard_up_to:
                self._heard_up_to = 0
                break
            again += 1
        return again

    def _subscribe(self) -> None:
        self._unsubscribe()
        self._subscription = self._node.create_subscription(
            self._class,
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
        self.count_events()
        self._heard_up_to = max(self._deliveries.last or 0, 0)
        self._events.clear()
        self._node.destroy_subscription(self._subscription)
        self._subscription = None


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
