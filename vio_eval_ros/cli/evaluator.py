"""Scores a running estimator, live: subscribes to an estimate and a ground truth in ROS 2."""

from __future__ import annotations

from dataclasses import fields
import signal
import sys

from vio_eval_ros.cli.shell import Parser, run
from vio_eval_ros.core.config import EvaluationConfig
from vio_eval_ros.live.options import NodeConfig
from vio_eval_ros.ros import without_ros

HELP = """
example:
  evaluator --ros-args -r estimate:=/vio/odometry -r ground_truth:=/ground_truth/pose \\
      -p alignment:=se3 -p report_dir:=report

topics in:   estimate, ground_truth (remap them), /clock where use_sim_time is true
topics out:  /diagnostics, ~/metrics/NAME, ~/window/NAME, ~/result, ~/estimate_aligned,
             ~/ground_truth_path, ~/error_markers
services:    ~/write_report, ~/reset (std_srvs/Trigger)

parameters (those of the evaluation are also in config/evaluator.yaml):
{parameters}

exit status: 0 ended by SIGINT, SIGTERM or SIGHUP, 1 a gate of any run failed and
exit_code_from_gates is true, 2 a parameter was wrong or a report could not be written
"""
TO_STOP = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def main(argv: list[str] | None = None) -> int:
    """Run the node until it is told to stop; return its exit status."""
    signals: list[int] = []
    # only noted: an exception could break an import, the start or a report
    for number in TO_STOP:
        signal.signal(number, lambda number, _: signals.append(number))
    arguments = sys.argv[1:] if argv is None else argv
    ours = arguments[: arguments.index('--ros-args')] if '--ros-args' in arguments else arguments
    Parser(prog='evaluator', description=__doc__, epilog=_help()).parse_args(ours)
    status = run('evaluator', lambda: _evaluate(['evaluator', *arguments], signals))
    for number in TO_STOP:  # at its end the interpreter would restore its own handlers
        signal.signal(number, signal.SIG_IGN)
    return status


def _help() -> str:
    """Return the help after the usage, with every parameter and its default."""
    lines = []
    for options in (NodeConfig(), EvaluationConfig()):
        for item in fields(options):
            value = getattr(options, item.name)
            words = value if isinstance(value, tuple) else (value,)
            shown = ' '.join(f'{w:g}' if isinstance(w, float) else str(w).lower() for w in words)
            lines.append(f'  {item.name:<21} {item.metadata["description"]} [{shown or "none"}]')
    return HELP.format(parameters='\n'.join(lines))


def _evaluate(argv: list[str], signals: list[int]) -> int:
    try:
        from vio_eval_ros.ros.evaluator_node import spin
    except ImportError as error:
        raise without_ros(error) from None
    return spin(argv, signals)
