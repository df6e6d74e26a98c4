"""What the node publishes of an estimate: values, results, and what viewers show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64, String

from vio_eval_ros.core.evaluation import Evaluation
from vio_eval_ros.evaluation.result import Result
from vio_eval_ros.live.health import Level, Status
from vio_eval_ros.reports import REPORTS
from vio_eval_ros.ros.markers import Display
from vio_eval_ros.ros.stamped_metrics import StampedMetrics
from vio_eval_ros.ros.status import status_message

#: of the queue for /diagnostics: many seconds may become certain at once
DIAGNOSTICS_DEPTH = 1000
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Outputs:
    """
    The topics of an estimate.

    :param label: of an estimate among several; it goes into the names of its topics.
    :param metrics: names of those with topics of their own.
    :param running: names of those that have running values.
    """

    def __init__(
        self, node: Node, label: str, metrics: Sequence[str], running: Iterable[str]
    ) -> None:
        self._node = node
        self._prefix = f'~/{label}/' if label else '~/'
        #: whose health the statuses tell
        self.source = '/'.join(filter(None, (node.get_fully_qualified_name(), label)))
        known = set(running)
        self._windows = self._values('window', metrics)
        self._metrics = self._values('metrics', [name for name in metrics if name in known])
        self._stamped: StampedMetrics | None = None
        with suppress(ImportError):  # a part of ROS 2 that not every installation has
            self._stamped = StampedMetrics(self.source, self._publisher)
        self._diagnostics = node.create_publisher(
            DiagnosticArray, '/diagnostics', DIAGNOSTICS_DEPTH
        )
        self._result = self._publisher(String, 'result')
        self._display = Display(self._publisher)

    def publish_second(self, stamp_ns: int, values: Mapping[str, float], began_ns: int) -> None:
        """
        Publish the running values of a second that is over.

        :param stamp_ns: of the data, by which viewers plot them.
        :param began_ns: the stamp at which the run began.
        """
        _publish(self._metrics, values)
        stamp = _time(stamp_ns)
        status = Status('metrics', Level.OK, 'running values at the stamp of the data', values)
        self._publish_diagnostics(stamp, [status])
        if self._stamped is not None:
            self._stamped.publish(self._metrics, values, _time(began_ns), stamp)

    def publish_window(self, values: Mapping[str, float]) -> None:
        """Publish the metrics of the window."""
        _publish(self._windows, values)

    def publish_health(self, statuses: Sequence[Status]) -> None:
        """Publish how the evaluation is, by the clock of the node."""
        self._publish_diagnostics(self._node.get_clock().now().to_msg(), statuses)

    def publish_result(self, result: Result) -> None:
        """Publish the result as JSON."""
        self._result.publish(String(data=REPORTS['json'](result)))

    def show(self, evaluation: Evaluation, frame: str) -> None:
        """Publish paths and errors, where anybody looks."""
        if self._display.is_watched():
            self._display.show(*evaluation.aligned(), frame)

    def _publish_diagnostics(self, stamp: Time, statuses: Sequence[Status]) -> None:
        array = DiagnosticArray(status=[status_message(one, self.source) for one in statuses])
        array.header.stamp = stamp
        self._diagnostics.publish(array)

    def _values(self, kind: str, names: Iterable[str]) -> dict[str, Publisher]:
        # a delta such as 0.5s has a dot, which the name of a topic must not have
        return {
            name: self._publisher(Float64, f'{kind}/{name.replace(".", "_")}') for name in names
        }

    def _publisher(self, message_type: Any, name: str) -> Publisher:
        """Return a publisher whose last message reaches those that come late."""
        return self._node.create_publisher(message_type, f'{self._prefix}{name}', LATCHED)


def _publish(publishers: Mapping[str, Publisher], values: Mapping[str, float]) -> None:
    for name, publisher in publishers.items():
        publisher.publish(Float64(data=float(values[name])))


def _time(stamp_ns: int) -> Time:
    return Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
