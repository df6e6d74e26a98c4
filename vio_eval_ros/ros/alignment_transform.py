"""The alignment as a transform, so that RViz lays an estimate over the ground truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
import importlib
import math

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile

from vio_eval_ros.core.alignment import Alignment
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.recordings.transforms import Edge


class AlignmentTransform:
    """
    Publishes on ``/tf`` where the world of an estimate is in that of the ground truth.

    :param complain: logs why it cannot be published, once.
    :param ignored: of each tree that is read, the transforms that are left out: those of here.
    :raises ConfigError: tf2_msgs is not installed.
    """

    def __init__(
        self, node: Node, complain: Callable[[str], object], ignored: Sequence[set[Edge]]
    ) -> None:
        try:
            self._type = importlib.import_module('tf2_msgs.msg').TFMessage
        except ImportError:
            raise ConfigError(
                'publish_tf: needs the ROS package tf2_msgs; install it, or source the workspace '
                'that has it'
            ) from None
        self._node = node
        self._publisher = node.create_publisher(self._type, '/tf', QoSProfile(depth=100))
        self._complain = complain
        self._complained: set[str] = set()
        self._ignored = ignored

    def publish(self, alignment: Alignment, truth: str, estimate: str) -> None:
        """
        Publish an alignment, stamped with the time of the node.

        :param truth: the frame in which the ground truth is given.
        :param estimate: that of the estimate.
        """
        parent, child = truth.lstrip('/'), estimate.lstrip('/')
        if problem := _problem(alignment, parent, child):
            if problem not in self._complained:
                self._complain(f'publish_tf: {problem}')
            self._complained.add(problem)
            return
        if not (alignment.is_known and alignment.observable):
            return
        for edges in self._ignored:
            edges.add((parent, child))
        message = TransformStamped(child_frame_id=child)
        message.header.frame_id = parent
        message.header.stamp = self._node.get_clock().now().to_msg()
        place, turn = message.transform.translation, message.transform.rotation
        place.x, place.y, place.z = map(float, alignment.translation)
        turn.x, turn.y, turn.z, turn.w = map(float, alignment.rotation)
        self._publisher.publish(self._type(transforms=[message]))


def _problem(alignment: Alignment, parent: str, child: str) -> str:
    """Return why an alignment cannot be a transform."""
    if parent == child:
        return (
            f'estimate and ground truth are both in {parent}: a frame has no transform to itself'
        )
    if alignment.scale != 1 and not math.isnan(alignment.scale):
        return f'alignment {alignment.mode} has a scale, which a transform has not: use se3'
    return ''
