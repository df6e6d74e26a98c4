"""Metrics with the stamp of the data, in the standard message of ROS 2, where it is installed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
import importlib
from types import ModuleType
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.publisher import Publisher

from vio_eval_ros.comparison.direction import unit_of

NAME = 'metrics/stamped'


class StampedMetrics:
    """
    Publishes a ``statistics_msgs/MetricsMessage`` of each metric.

    :param source: whose metrics they are.
    :param publisher: makes a publisher of a type and a name.
    :raises ImportError: ``statistics_msgs`` is not installed.
    """

    def __init__(self, source: str, publisher: Callable[[Any, str], Publisher]) -> None:
        self._source = source
        self._messages: ModuleType = importlib.import_module('statistics_msgs.msg')
        self._publisher = publisher(self._messages.MetricsMessage, NAME)

    def publish(
        self, names: Iterable[str], values: Mapping[str, float], began: Time, stamp: Time
    ) -> None:
        """Publish the running values of these metrics, from the begin of the run to a stamp."""
        kinds = self._messages.StatisticDataType
        for name in names:
            point = self._messages.StatisticDataPoint(
                data_type=kinds.STATISTICS_DATA_TYPE_AVERAGE, data=float(values[name])
            )
            self._publisher.publish(
                self._messages.MetricsMessage(
                    measurement_source_name=self._source,
                    metrics_source=name,
                    unit=unit_of(name),
                    window_start=began,
                    window_stop=stamp,
                    statistics=[point],
                )
            )
