"""
Stands in for an estimator: ``estimator.py SPEC TOPIC`` publishes the poses of a source.

Each is published when an IMU message with its stamp, or a later one, has arrived on /imu0.
"""

import sys

from geometry_msgs.msg import PoseStamped
import rclpy
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import Imu

from vio_eval_ros.recordings.sources import read_sources


def main(spec: str, topic: str) -> None:
    (source,) = read_sources([spec])
    poses = zip(
        source.poses.stamps_ns.tolist(),
        source.poses.positions.tolist(),
        source.poses.rotations.tolist(),
        strict=True,
    )
    waiting = list(poses)[::-1]
    rclpy.init()
    node = rclpy.create_node('estimator')
    publisher = node.create_publisher(PoseStamped, topic, 1000)

    def receive(imu: Imu) -> None:
        now_ns = imu.header.stamp.sec * 10**9 + imu.header.stamp.nanosec
        while waiting and waiting[-1][0] <= now_ns:
            publisher.publish(message(*waiting.pop()))

    node.create_subscription(Imu, '/imu0', receive, 1000)
    try:
        rclpy.spin(node)
    except (ExternalShutdownException, KeyboardInterrupt):
        pass


def message(stamp_ns: int, position: list[float], rotation: list[float]) -> PoseStamped:
    pose = PoseStamped()
    pose.header.stamp.sec, pose.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    p, q = pose.pose.position, pose.pose.orientation
    p.x, p.y, p.z = position
    q.x, q.y, q.z, q.w = rotation
    return pose


if __name__ == '__main__':
    main(*sys.argv[1:])
