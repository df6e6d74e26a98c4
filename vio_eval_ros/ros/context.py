"""How a process joins the ROS graph and notices others, and what is wrong where it cannot."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
import os

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.logging import LoggingSeverity, set_logger_level
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from vio_eval_ros.errors import ConfigError
from vio_eval_ros.recordings.messages import STREAMED
from vio_eval_ros.ros.private import GraphEvents

POLL_S = 0.5  # where changes of the graph are no events
LAST_DOMAIN = 232  # with ports of its own


def join(arguments: Sequence[str]) -> None:
    """
    Join the graph; what SIGINT and SIGTERM do is left to the caller.

    :param arguments: of the process, those of ROS among them.
    :raises ConfigError: an argument that ROS does not understand, or an invalid domain.
    """
    domain = os.environ.get('ROS_DOMAIN_ID') or '0'
    if not (domain.isascii() and domain.isdigit() and int(domain) <= LAST_DOMAIN):
        raise ConfigError(f"ROS_DOMAIN_ID: '{domain}' is not a number from 0 to {LAST_DOMAIN}")
    set_logger_level('rcl', LoggingSeverity.FATAL)  # the error below says it once
    try:
        rclpy.init(args=[*arguments], signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        problem = ' '.join(str(error).split()).removeprefix('failed to initialize rcl: ')
        raise ConfigError(f'--ros-args: not understood: {problem.split(", at /")[0]}') from None
    set_logger_level('rcl', LoggingSeverity.UNSET)


def topics_with_poses(node: Node, besides: Collection[str]) -> list[str]:
    """Return the topics that others publish, with poses that can be scored."""
    own = f'{node.get_fully_qualified_name()}/'
    return sorted(
        name
        for name, types in node.get_topic_names_and_types()
        if name not in besides
        and not name.startswith(own)
        and not set(STREAMED).isdisjoint(types)
        and node.count_publishers(name)
    )


def watch_graph(node: Node, act: Callable[[], object]) -> None:
    """Call a function when somebody joins the graph or leaves it."""
    try:
        node.add_waitable(GraphEvents(node, act))
    except (OSError, AttributeError):
        node.create_timer(POLL_S, act, clock=Clock(clock_type=ClockType.STEADY_TIME))
