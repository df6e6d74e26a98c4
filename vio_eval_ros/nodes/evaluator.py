"""Scores a running estimator, live: subscribes to an estimate and a ground truth in ROS 2."""

from __future__ import annotations

import signal
import sys

from vio_eval_ros.cli.shell import Parser, run
from vio_eval_ros.errors import ReadError

EXAMPLE = """
example:
  evaluator --ros-args -r estimate:=/vio/odometry -r ground_truth:=/ground_truth/pose \\
      -p alignment:=se3 -p report_dir:=report

Every option of an evaluation is a parameter; config/evaluator.yaml has them all.
"""
TO_STOP = (signal.SIGINT, signal.SIGTERM)


def main(argv: list[str] | None = None) -> int:
    """Run the node until it is told to stop; return its exit status."""
    told: list[int] = []
    # Only noted: an exception could break an import, the start or a report.
    for number in TO_STOP:
        signal.signal(number, lambda number, _: told.append(number))
    arguments = sys.argv[1:] if argv is None else argv
    ours = arguments[: arguments.index('--ros-args')] if '--ros-args' in arguments else arguments
    Parser(prog='evaluator', description=__doc__, epilog=EXAMPLE).parse_args(ours)
    status = run('evaluator', lambda: _evaluate(['evaluator', *arguments], told))
    for number in TO_STOP:  # the interpreter, as it ends, would take its own handlers back
        signal.signal(number, signal.SIG_IGN)
    return status


def _evaluate(argv: list[str], told: list[int]) -> int:
    try:
        from vio_eval_ros.nodes.evaluator_node import spin
    except ImportError as error:
        raise ReadError(
            'ROS 2',
            f'{error}; source an installation of it, or pip install ros-jazzy-rclpy '
            'ros-jazzy-rmw-fastrtps-cpp ros-jazzy-common-interfaces',
        ) from None
    return spin(argv, told)
