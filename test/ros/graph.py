"""A ROS graph of the test's own: publishes poses, listens, calls, and waits for conditions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import importlib
import subprocess
import time
from typing import Any
import warnings

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import Odometry, Path
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter  # noqa: F401  # the tests take it from here
from rclpy.parameter_client import AsyncParameterClient
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from vio_eval_ros.core.trajectory import Poses

with warnings.catch_warnings():
    warnings.simplefilter('ignore', DeprecationWarning)
    import rosidl_generator_py  # noqa: F401  # rclpy would later; its parser imports sre_parse

LIMIT_S = 60  # for what takes a second or two on an idle machine
SPIN_S = 0.01
LEVELS = {
    DiagnosticStatus.OK: 'OK',
    DiagnosticStatus.WARN: 'WARN',
    DiagnosticStatus.ERROR: 'ERROR',
    DiagnosticStatus.STALE: 'STALE',
}
ESTIMATE, GROUND_TRUTH = 'nav_msgs/msg/Odometry', 'geometry_msgs/msg/PoseStamped'
PATH, CLOCK = 'nav_msgs/msg/Path', 'rosgraph_msgs/msg/Clock'


class Status:
    """One status of ``/diagnostics``."""

    def __init__(self, status: DiagnosticStatus) -> None:
        self.name, self.hardware_id = status.name, status.hardware_id
        self.level = LEVELS[status.level]
        self.message = status.message
        self.values = {item.key: item.value for item in status.values}

    def __str__(self) -> str:
        values = ' '.join(f'{key}={value}' for key, value in self.values.items())
        return f'{self.level} {self.message!r} {values}'


class Graph:
    """
    The test's side of the graph: a node that is spun while a condition is waited for.

    So are the nodes under test that share its context: nothing happens in them meanwhile.
    """

    def __init__(self, domain: int, name: str) -> None:
        self.processes: list[subprocess.Popen] = []  # without which there is nothing to wait for
        self.beside: list[Graph] = []  # spun as well
        self.statuses: dict[str, Status] = {}
        self.stamp_ns = 0
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain)
        self._node = rclpy.create_node(name, context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self._node)
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._diagnosed, 10)
        self._nodes: list[Node] = []
        self._publishers: list[Publisher] = []

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.shutdown(context=self.context)

    def add(self, node: Node) -> None:
        """Spin a node as well; it has the context of the graph."""
        self._executor.add_node(node)
        self._nodes.append(node)

    def remove(self, node: Node) -> None:
        """Spin a node no more, and destroy it."""
        self._executor.remove_node(node)
        self._nodes.remove(node)
        node.destroy_node()

    def wait_until(
        self, condition: Callable[[], Any], what: str, meanwhile: Callable[[], Any] | None = None
    ) -> Any:
        """Spin until the condition holds, and return its value."""
        end_s = time.monotonic() + LIMIT_S
        while not (value := condition()):
            for graph in (self, *self.beside):
                graph._executor.spin_once(timeout_sec=SPIN_S)
            if meanwhile is not None:
                meanwhile()
            assert time.monotonic() < end_s, f'waited for {what}, but\n{self.said()}'
            assert all(process.poll() is None for process in self.processes), 'a process died'
        return value

    def wait_for(
        self,
        name: str,
        level: str,
        *messages: str,
        meanwhile: Callable[[], Any] | None = None,
        **values: object,
    ) -> Status:
        """
        Spin until a status is what is expected, and return it.

        :param level: 'any', or which one.
        :param messages: what its message contains.
        :param meanwhile: what to do again and again, until then.
        :param values: some of its values.
        """

        def is_so() -> bool:
            status = self.statuses.get(name)
            return (
                status is not None
                and level in ('any', status.level)
                and all(message in status.message for message in messages)
                and all(status.values.get(key) == str(value) for key, value in values.items())
            )

        self.wait_until(is_so, f'{name} {level} {messages} {values}', meanwhile)
        return self.statuses[name]

    def wait_for_statuses(self) -> None:
        """Return when diagnostics of what is known from now on have come."""
        self.statuses.clear()
        self.wait_until(lambda: self.statuses, 'diagnostics')

    def wait_for_arrival(self, estimate: int = 400, ground_truth: int = 1000) -> None:
        """Return when so many messages have been received since the start, and evaluated."""
        self.wait_for(
            'streams', 'any', estimate_received=estimate, ground_truth_received=ground_truth
        )

    def said(self) -> str:
        """Return what the diagnostics said last."""
        return '\n'.join(f'{name}: {status}' for name, status in self.statuses.items())

    def publisher(
        self,
        topic: str,
        msgtype: str,
        reliable: bool = True,
        matched: bool = True,
        latched: bool = False,
    ) -> Publisher:
        """Return a publisher, when somebody has subscribed to it."""
        quality = QoSProfile(
            depth=20_000,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        )
        if latched:
            quality.durability = DurabilityPolicy.TRANSIENT_LOCAL
        publisher = self._node.create_publisher(_class(msgtype), topic, quality)
        if matched:
            self.match(publisher)
        return publisher

    def match(self, publisher: Publisher) -> None:
        """Wait until somebody has subscribed to a publisher."""
        self._publishers.append(publisher)
        topic = publisher.topic_name
        self.wait_until(lambda: self._is_matched(publisher), f'a subscription to {topic}')

    def _is_matched(self, publisher: Publisher) -> bool:
        """Return whether nothing that is published now is lost: both sides know each other."""
        topic, graphs = publisher.topic_name, (self, *self.beside)
        known = [
            subscription.get_publisher_count()
            for graph in graphs
            for node in graph._nodes
            for subscription in node.subscriptions
            if subscription.topic_name == topic
        ]
        published = [p for graph in graphs for p in graph._publishers if p.topic_name == topic]
        return publisher.get_subscription_count() > 0 and all(
            count >= len(published) for count in known
        )

    def withdraw(self, publisher: Publisher) -> None:
        """Publish no more."""
        if publisher in self._publishers:
            self._publishers.remove(publisher)
        self._node.destroy_publisher(publisher)

    def both(self) -> tuple[Publisher, Publisher]:
        """Return publishers of an estimate and a ground truth."""
        return self.publisher('/estimate', ESTIMATE), self.publisher('/ground_truth', GROUND_TRUTH)

    def listen(self, topic: str, msgtype: str, latched: bool = False) -> list[Any]:
        """Return a list that the messages of a topic will be appended to."""
        quality = QoSProfile(depth=1000)
        if latched:
            quality.durability = DurabilityPolicy.TRANSIENT_LOCAL
        messages: list[Any] = []
        subscription = self._node.create_subscription(
            _class(msgtype), topic, messages.append, quality
        )
        self.wait_until(subscription.get_publisher_count, f'a publisher of {topic}')
        return messages

    def set_time(self, clock: Publisher, stamp_ns: int) -> None:
        """Publish the time until the evaluator has it."""
        self.wait_until(
            lambda: self.stamp_ns == stamp_ns,
            'the time',
            meanwhile=lambda: clock.publish(clock_message(stamp_ns)),
        )

    def subscribers(self, topic: str) -> int:
        """Return how many subscriptions to a topic there are."""
        return self._node.count_subscribers(topic)

    def topics(self) -> set[str]:
        """Return the names of all topics."""
        return {name for name, _ in self._node.get_topic_names_and_types()}

    def call(self, service: str, node: str = 'vio_evaluator') -> Trigger.Response:
        """Call a service of a node and return its response."""
        client = self._node.create_client(Trigger, f'/{node}/{service}')
        self.wait_until(client.service_is_ready, f'the service {service}')
        future = client.call_async(Trigger.Request())
        self.wait_until(future.done, f'an answer of {service}')
        self._node.destroy_client(client)
        return future.result()

    def parameters(self, request: str, *arguments: Any) -> Any:
        """Return the response to a request of the parameter client, 'get_parameters' say."""
        client = AsyncParameterClient(self._node, 'vio_evaluator')
        self.wait_until(client.services_are_ready, 'the parameter services')
        future = getattr(client, request)(*arguments)
        self.wait_until(future.done, f'an answer of {request}')
        return future.result()

    def _diagnosed(self, array: DiagnosticArray) -> None:
        self.stamp_ns = array.header.stamp.sec * 10**9 + array.header.stamp.nanosec
        for status in array.status:
            self.statuses[status.name.rpartition(': ')[2]] = Status(status)


def send(publisher: Publisher, poses: Poses) -> None:
    """Publish poses as fast as possible."""
    for message in messages(publisher.msg_type, poses):
        publisher.publish(message)


def send_path(publisher: Publisher, poses: Poses) -> None:
    """Publish poses as one Path."""
    publisher.publish(Path(poses=list(messages(PoseStamped, poses))))


def clock_message(stamp_ns: int) -> Clock:
    """Return a message of ``/clock``."""
    return Clock(clock=time_message(stamp_ns))


def messages(kind: type, poses: Poses) -> Iterator[Any]:
    """Yield a PointStamped, PoseStamped or Odometry of each pose."""
    for k, stamp_ns in enumerate(poses.stamps_ns.tolist()):
        message = kind()
        message.header.stamp = time_message(stamp_ns)
        message.header.frame_id = 'map'
        if kind is PointStamped:
            pose, p = None, message.point
        else:
            pose = message.pose.pose if kind is Odometry else message.pose
            p = pose.position
        p.x, p.y, p.z = poses.positions[k].tolist()
        if pose is not None:
            q = pose.orientation
            q.x, q.y, q.z, q.w = poses.rotations[k].tolist()
        if kind is Odometry and poses.covariances is not None:
            covariance = np.zeros((6, 6))
            covariance[:3, :3], covariance[3:, 3:] = poses.covariances[k]
            message.pose.covariance = covariance.ravel()
        yield message


def time_message(stamp_ns: int) -> Time:
    """Return a stamp."""
    return Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)


def _class(msgtype: str) -> type:
    package, _, name = msgtype.split('/')
    return getattr(importlib.import_module(f'{package}.msg'), name)
