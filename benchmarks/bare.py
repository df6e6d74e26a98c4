"""
The least that a node can do with the evaluator's two topics: ``bare.py KIND COUNT_FILE``.

KIND is how it comes by the messages: one of rclpy's executors, or ``polled``, which takes what
there is 20 times a second. COUNT_FILE has the number of messages so far, as 8 bytes, which another
process may read at any time without waking this one up.
"""

from __future__ import annotations

import mmap
from pathlib import Path
import sys

from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry
import rclpy
from rclpy.executors import (
    ExternalShutdownException,
    MultiThreadedExecutor,
    SingleThreadedExecutor,
)
from rclpy.experimental import EventsExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy

from vio_eval_ros.ros.evaluator_node import DRAIN_S
from vio_eval_ros.ros.pose_topic import DEPTH, Polled

EXECUTORS = {
    'single': SingleThreadedExecutor,
    'multi': MultiThreadedExecutor,
    'events': EventsExecutor,
    'polled': SingleThreadedExecutor,
}


def main(kind: str, count_file: Path) -> None:
    """Receive until Ctrl-C."""
    with count_file.open('r+b') as file:
        counted = memoryview(mmap.mmap(file.fileno(), 8)).cast('Q')

    def count(message: object) -> None:
        counted[0] += 1

    def take_all() -> None:
        for subscription, message_type in subscriptions:
            with subscription.handle:
                take = subscription.handle.take_message
                while (taken := take(message_type, False)) is not None:
                    count(taken[0])

    rclpy.init()
    node = rclpy.create_node('bare')
    qos = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)
    group = Polled() if kind == 'polled' else None
    subscriptions = [
        (
            node.create_subscription(message_type, topic, count, qos, callback_group=group),
            message_type,
        )
        for message_type, topic in ((Odometry, 'estimate'), (TransformStamped, 'ground_truth'))
    ]
    if kind == 'polled':
        node.create_timer(DRAIN_S, take_all)
    executor = EXECUTORS[kind]()
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == '__main__':
    main(sys.argv[1], Path(sys.argv[2]))
