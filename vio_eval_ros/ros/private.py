"""
What is private in rclpy and used here all the same; a test names it.

Each has a reason that no public call serves: the executor of rclpy wakes up for every message and
event, which costs more than all else, and quality of service must be known before the type is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import _declare_qos_parameters, QoSOverridingOptions
from rclpy.subscription import Subscription


def parameter_overrides(node: Node) -> Mapping[str, Parameter]:
    """Return the parameters that were given to a node, declared or not."""
    overrides: Mapping[str, Parameter] = node._parameter_overrides
    return overrides


def declare_quality(node: Node, topic: str, quality: QoSProfile) -> None:
    """
    Declare the parameters ``qos_overrides.TOPIC`` and apply them to the quality of service.

    That is what ``create_subscription`` does; this is before the message type is known.
    """
    policies = QoSOverridingOptions.with_default_policies()
    _declare_qos_parameters(Subscription, node, topic, quality, policies)


def take_serialized(subscription: Subscription, message_type: type, most: int) -> list[bytes]:
    """Return the messages that have arrived, at most so many, without deserialising them."""
    messages: list[bytes] = []
    with subscription.handle:
        take = subscription.handle.take_message
        while len(messages) < most and (message := take(message_type, True)) is not None:
            messages.append(message[0])
    return messages


class EventCounter:
    """
    How often something has happened to a subscription.

    Asked for, since with an event in the wait set every message would wake the executor.

    :raises UnsupportedEventTypeError: the middleware does not count it.
    """

    def __init__(self, subscription: Subscription, event: QoSSubscriptionEventType) -> None:
        self._handle: Any = rclpy_implementation.EventHandle(subscription.handle, event)
        self._count = 0

    def count(self) -> int:
        """Return the number since the subscription began."""
        with self._handle:
            status = self._handle.take_event()
        if status is not None:
            self._count = int(status.total_count)
        return self._count
