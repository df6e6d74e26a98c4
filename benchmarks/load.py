"""
The load of the live benchmarks: an estimate and its ground truth, published at any pace.

Messages are made in blocks beforehand, as bytes: stamp, position and orientation are patched into
a serialised template. To publish one then costs little more than the call.
"""

from __future__ import annotations

import struct
import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from inputs import estimate, FIRST_STAMP_NS, fly
from nav_msgs.msg import Odometry
import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.serialization import serialize_message

from vio_eval_ros.core.trajectory import Trajectory
from vio_eval_ros.ros.pose_topic import DEPTH

ESTIMATE_PERIOD_NS, TRUTH_PERIOD_NS = 1_000_000, 2_500_000
DISCOVERY_S = 30.0
STAMP_AT = 4  # behind the preamble
POSE = (1.0, 2.0, 3.0, 0.5, -0.5, 0.5, -0.5)  # of the templates


class Due(NamedTuple):
    """A message, its publisher, and when to publish it."""

    at_s: float
    publisher: Any
    message: bytes


class Load:
    """The node that publishes ``/estimate`` and ``/ground_truth``, reliably."""

    def __init__(self) -> None:
        rclpy.init()
        self._node = rclpy.create_node('load', start_parameter_services=False)
        qos = QoSProfile(depth=DEPTH)
        self._estimate = self._node.create_publisher(Odometry, '/estimate', qos)
        self._truth = self._node.create_publisher(TransformStamped, '/ground_truth', qos)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._odometry, self._transform = _odometry(), _transform()
        self._source = np.random.default_rng(1)
        self._next_ns = FIRST_STAMP_NS
        self.sent = 0

    def __enter__(self) -> Load:
        """Return the node, which is there at once."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the graph."""
        rclpy.try_shutdown()

    def diagnostics(self, topic: str) -> dict[str, str]:
        """Return what will hold the newest values of an evaluator's diagnostics."""
        values: dict[str, str] = {}

        def note(array: DiagnosticArray) -> None:
            values.update((item.key, item.value) for s in array.status for item in s.values)

        self._node.create_subscription(DiagnosticArray, topic, note, 1)
        return values

    def wait_for(self, listeners: int) -> None:
        """
        Wait until there are as many listeners to both topics, no more and no fewer.

        :raises TimeoutError: one is not coming, or not going.
        """
        end_s = time.monotonic() + DISCOVERY_S
        publishers = self._estimate, self._truth
        while any(p.get_subscription_count() != listeners for p in publishers):
            if time.monotonic() > end_s:
                raise TimeoutError(f'there are not {listeners} listeners after {DISCOVERY_S} s')
            self.listen(0.05)

    def listen(self, seconds: float) -> None:
        """Publish nothing for some seconds; what others say is heard."""
        end_s = time.monotonic() + seconds
        while (left_s := end_s - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left_s)

    def paced(
        self, seconds: float, times: float = 1.0, truth_period_ns: int = TRUTH_PERIOD_NS
    ) -> list[Due]:
        """
        Return the next messages, seconds long as they will be published.

        :param times: how much faster than 1,000 and 400 Hz; the stamps stay as far apart.
        """
        begin_ns, length_ns = self._next_ns, round(seconds * times * 1e9)
        estimates_ns = begin_ns + np.arange(0, length_ns, ESTIMATE_PERIOD_NS)
        truths_ns = begin_ns + np.arange(0, length_ns, truth_period_ns)
        self._next_ns += length_ns
        messages = [
            Due((stamp_ns - begin_ns) / 1e9 / times, publisher, message)
            for publisher, stamps_ns, messages in (
                (self._estimate, estimates_ns, self._estimates(estimates_ns)),
                (self._truth, truths_ns, self._truths(truths_ns)),
            )
            for stamp_ns, message in zip(stamps_ns.tolist(), messages, strict=True)
        ]
        return sorted(messages, key=lambda message: message.at_s)

    def publish(self, messages: list[Due]) -> float:
        """Publish messages when they are due; return the seconds that it took."""
        begin_s = time.monotonic()
        for at_s, publisher, message in messages:
            while (early_s := begin_s + at_s - time.monotonic()) > 0:
                time.sleep(early_s)
            publisher.publish(message)
        self.sent += len(messages)
        return time.monotonic() - begin_s

    def _estimates(self, stamps_ns: np.ndarray) -> list[bytes]:
        return _filled(self._odometry, estimate(fly(stamps_ns), self._source))

    def _truths(self, stamps_ns: np.ndarray) -> list[bytes]:
        return _filled(self._transform, fly(stamps_ns))


def _filled(template: bytes, poses: Trajectory) -> list[bytes]:
    """Return a message for each pose."""
    pose_at = template.index(struct.pack('<7d', *POSE))
    rows = np.tile(np.frombuffer(template, np.uint8), (len(poses), 1))
    stamps = np.column_stack(np.divmod(poses.stamps_ns, 10**9)).astype('<u4')
    rows[:, STAMP_AT : STAMP_AT + 8] = stamps.view(np.uint8)
    numbers = np.column_stack([poses.positions, poses.rotations]).astype('<f8')
    rows[:, pose_at : pose_at + 56] = numbers.view(np.uint8)
    return [row.tobytes() for row in rows]


def _odometry() -> bytes:
    message = Odometry()
    message.header.frame_id, message.child_frame_id = 'odom', 'body'
    _place(message.pose.pose.position, message.pose.pose.orientation)
    message.pose.covariance = (1e-4 * np.eye(6)).ravel()
    return serialize_message(message)


def _transform() -> bytes:
    message = TransformStamped()
    message.header.frame_id, message.child_frame_id = 'world', 'body'
    _place(message.transform.translation, message.transform.rotation)
    return serialize_message(message)


def _place(position: Any, orientation: Any) -> None:
    position.x, position.y, position.z = POSE[:3]
    orientation.x, orientation.y, orientation.z, orientation.w = POSE[3:]
