"""Calls services of the player, one behind the other: ``call.py pause step ...``."""

import sys

import rclpy
from std_srvs.srv import Trigger


def main(names: list[str]) -> None:
    rclpy.init()
    node = rclpy.create_node('caller', start_parameter_services=False)
    for name in names:
        client = node.create_client(Trigger, f'/player/{name}')
        client.wait_for_service()
        future = client.call_async(Trigger.Request())
        rclpy.spin_until_future_complete(node, future)
        print(future.result().success, future.result().message)
    rclpy.shutdown()


if __name__ == '__main__':
    main(sys.argv[1:])
