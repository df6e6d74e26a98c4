"""What RViz and Foxglove show: paths, and errors as colours."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Path
import numpy as np
from rclpy.publisher import Publisher
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from vio_eval_ros.core.alignment import Alignment
from vio_eval_ros.core.metrics import position_errors
from vio_eval_ros.core.trajectory import Pairs, Trajectory

MOST_POSES = 2000
WIDTH_M = 0.03


class Display:
    """
    Publishes paths and errors.

    :param publisher: makes a publisher of a type and a name, whose last message is latched.
    """

    def __init__(self, publisher: Callable[[Any, str], Publisher]) -> None:
        self._aligned = publisher(Path, 'estimate_aligned')
        self._truth = publisher(Path, 'ground_truth_path')
        self._markers = publisher(MarkerArray, 'error_markers')

    def is_watched(self) -> bool:
        """Return whether anybody has subscribed."""
        publishers = (self._aligned, self._truth, self._markers)
        return any(publisher.get_subscription_count() for publisher in publishers)

    def show(self, pairs: Pairs, alignment: Alignment, frame: str) -> None:
        """Publish at most 2000 of the pairs."""
        pairs = pairs[every_kth(len(pairs))]
        self._truth.publish(path_message(pairs.ground_truth, frame))
        aligned = pairs if alignment.is_known else pairs[:0]
        self._aligned.publish(path_message(alignment.apply(aligned.estimate), frame))
        self._markers.publish(error_markers(aligned, alignment, frame))


def path_message(trajectory: Trajectory, frame: str) -> Path:
    """Return a trajectory as a Path."""
    message = Path()
    message.header.frame_id = frame
    rotations = trajectory.rotations
    for k, (stamp_ns, position) in enumerate(
        zip(trajectory.stamps_ns.tolist(), trajectory.positions.tolist(), strict=True)
    ):
        pose = PoseStamped()
        pose.header.frame_id = frame
        pose.header.stamp = Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        p, q = pose.pose.position, pose.pose.orientation
        p.x, p.y, p.z = position
        if rotations is not None:
            q.x, q.y, q.z, q.w = rotations[k].tolist()
        message.poses.append(pose)
    if message.poses:
        message.header.stamp = message.poses[-1].header.stamp
    return message


def error_markers(pairs: Pairs, alignment: Alignment, frame: str) -> MarkerArray:
    """Return the aligned estimate as a line from green (no error) to red (the 95th percentile)."""
    errors = position_errors(pairs, alignment)
    worst = max(float(np.percentile(errors, 95)), 1e-9) if len(errors) else 1.0
    marker = Marker(ns='error', type=Marker.LINE_STRIP, action=Marker.ADD)
    marker.header.frame_id = frame
    marker.scale.x = WIDTH_M
    marker.pose.orientation.w = 1.0
    for (x, y, z), share in zip(
        alignment.positions(pairs.estimate.positions).tolist(),
        np.clip(errors / worst, 0, 1).tolist(),
        strict=True,
    ):
        marker.points.append(Point(x=x, y=y, z=z))
        marker.colors.append(ColorRGBA(r=share, g=1 - share, b=0.1, a=1.0))
    return MarkerArray(markers=[marker])


def every_kth(count: int) -> slice:
    """Return every k-th row, at most 2000 of them, the last included."""
    step = -(-count // MOST_POSES) or 1
    return slice((count - 1) % step if count else 0, None, step)
