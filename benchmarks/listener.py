"""Notes when EuRoC's messages arrive until SIGTERM; then prints topic, stamp [ns] and time [s]."""

from __future__ import annotations

from functools import partial
import signal
import struct
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, Imu

TOPICS = {'/imu0': Imu, '/cam0/image_raw': Image, '/cam1/image_raw': Image}
IDLE_S = 0.2  # nothing more comes after such a silence


def main() -> None:
    """Listen, and tell afterwards, so that telling delays nothing."""
    told: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: told.append(number))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('listener')
    arrivals: list[tuple[str, bytes, float]] = []

    def note(topic: str, message: bytes) -> None:
        arrivals.append((topic, message[4:12], time.monotonic()))

    for topic, message_type in TOPICS.items():
        node.create_subscription(
            message_type, topic, partial(note, topic), QoSProfile(depth=1000), raw=True
        )
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    count = -1
    while not told or len(arrivals) > count:
        count = len(arrivals)
        executor.spin_once(timeout_sec=IDLE_S)
    for topic, stamp, at_s in arrivals:
        seconds, nanoseconds = struct.unpack('<iI', stamp)
        print(topic, seconds * 10**9 + nanoseconds, repr(at_s))


if __name__ == '__main__':
    main()
