"""
What is private in rclpy and used here all the same; a test names it.

Each has a reason that no public call serves: the executor of rclpy wakes up for every message and
event, which costs more than all else, quality of service must be known before the type is, and
who joins the graph is only told to those who ask again and again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
import ctypes
import sys
from typing import Any, NamedTuple

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import _declare_qos_parameters, QoSOverridingOptions
from rclpy.subscription import Subscription
from rclpy.waitable import NumberOfEntities, Waitable

LIBRARY = {'darwin': 'librcl.dylib', 'win32': 'rcl.dll'}.get(sys.platform, 'librcl.so')


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


class Taken(NamedTuple):
    """
    Messages in serialised form.

    :param numbers: that their publisher gave them, from 1; None where the middleware tells none.
    :param received_ns: when they arrived, by the clock of the system; 0 likewise.
    """

    messages: list[bytes]
    numbers: list[int | None]
    received_ns: list[int]

    def after(self, count: int) -> Taken:
        """Return those after the first few."""
        return Taken(self.messages[count:], self.numbers[count:], self.received_ns[count:])


def take_serialized(subscription: Subscription, message_type: type, most: int) -> Taken:
    """Return the messages that have arrived, at most so many, without deserialising them."""
    taken = Taken([], [], [])
    with subscription.handle:
        take = subscription.handle.take_message
        while len(taken.messages) < most and (one := take(message_type, True)) is not None:
            taken.messages.append(one[0])
            taken.numbers.append(one[1]['publication_sequence_number'])
            taken.received_ns.append(one[1]['received_timestamp'])
    return taken


class EventCounter:
    """
    How often something has happened to a subscription.

    Asked for, since with an event in the wait set every message would wake the executor.

    :raises UnsupportedEventTypeError: the middleware does not count it.
    """

    def __init__(self, subscription: Subscription, event: QoSSubscriptionEventType) -> None:
        self._handle: Any = rclpy_implementation.EventHandle(subscription.handle, event)

    def count(self) -> int:
        """Return the number since the last call."""
        with self._handle:
            status = self._handle.take_event()
        return 0 if status is None else int(status.total_count_change)


class GraphEvents(Waitable):
    """
    Calls a function when a node, a publisher or a subscription joins the graph or leaves it.

    rcl has a condition for that in every node, which rclpy does not hand on.

    :raises OSError: rcl is not where it is expected.
    :raises AttributeError: it has changed.
    """

    def __init__(self, node: Node, act: Callable[[], object]) -> None:
        super().__init__(MutuallyExclusiveCallbackGroup())
        rcl = ctypes.CDLL(LIBRARY)
        condition, self._add = (
            rcl.rcl_node_get_graph_guard_condition,
            rcl.rcl_wait_set_add_guard_condition,
        )
        condition.argtypes, condition.restype = [ctypes.c_void_p], ctypes.c_void_p
        self._add.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
        self._node = node
        self._act = act
        self._condition = condition(node.handle.pointer)
        self._index = ctypes.c_size_t()

    def __enter__(self) -> None:
        """Keep the node, whose condition it is, while it is waited for."""
        self._node.handle.__enter__()

    def __exit__(self, *error: object) -> None:
        """Keep it no longer."""
        self._node.handle.__exit__(*error)

    def get_num_entities(self) -> NumberOfEntities:
        """Return that there is one condition."""
        return NumberOfEntities(num_gcs=1)

    def add_to_wait_set(self, wait_set: Any) -> None:
        """Wait for it as well."""
        self._add(wait_set.pointer, self._condition, ctypes.byref(self._index))

    def is_ready(self, wait_set: Any) -> bool:
        """Return whether the graph has changed."""
        return bool(wait_set.is_ready('guard_condition', self._index.value))

    def take_data(self) -> None:
        """Return nothing: there is no more to know."""

    async def execute(self, taken_data: None) -> None:
        """Call the function."""
        self._act()
