"""
Writes down what arrives on topics until SIGTERM: ``listen.py FILE N TOPIC=TYPE[,latched] ...``.

FILE becomes a pickle of (topic, monotonic seconds, bytes), in order of arrival; ``/clock`` is
always among them. When N others have arrived it prints ``arrived``.
"""

from functools import partial
import importlib
import os
from pathlib import Path
import pickle
import signal
import sys
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions

IDLE_S = 0.2  # nothing more comes after such a silence


def main(file: Path, enough: int, topics: list[str]) -> None:
    stopping = []
    signal.signal(signal.SIGTERM, lambda *_: stopping.append(True))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('listener', start_parameter_services=False)
    received, others = [], 0

    def receive(name: str, message: bytes) -> None:
        nonlocal others
        received.append((name, time.monotonic(), message))
        others += name != '/clock'
        if others == enough and name != '/clock':
            print('arrived', flush=True)

    for item in ['/clock=rosgraph_msgs/msg/Clock', *topics]:
        name, _, kind = item.partition('=')
        msgtype, _, latched = kind.partition(',')
        package, _, cls = msgtype.split('/')
        qos = QoSProfile(depth=10_000)
        if latched:
            qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
        node.create_subscription(
            getattr(importlib.import_module(f'{package}.msg'), cls),
            name,
            partial(receive, name),
            qos,
            raw=True,
        )
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    count = -1
    while not stopping or len(received) > count:
        count = len(received)
        executor.spin_once(timeout_sec=IDLE_S)
    temporary = file.with_suffix('.part')
    temporary.write_bytes(pickle.dumps(received))
    os.replace(temporary, file)
    executor.shutdown()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
