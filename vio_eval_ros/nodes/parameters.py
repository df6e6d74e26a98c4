"""The parameters of the evaluator node: the options of an evaluation, and those of the node."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, Field, fields
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor
from rclpy.node import Node

from vio_eval_ros.core.config import EvaluationConfig, nearest_name, option, Options
from vio_eval_ros.errors import ConfigError

# parameters that every node understands, whatever it declares
OF_ROS = ('use_sim_time', 'qos_overrides.', 'start_type_description_service')


@dataclass(frozen=True)
class NodeConfig(Options):
    """What the node does beside evaluating."""

    estimate_type: str = option('', 'message type of the estimate; empty: found out')
    ground_truth_type: str = option('', 'message type of the ground truth; empty: found out')
    ground_truth_file: str = option(
        '', 'file or folder with the ground truth (TUM, EuRoC), instead of the topic'
    )
    gates_file: str = option('', 'YAML file of gates: {metric: {max: number, min: number}}')
    report_dir: str = option('', 'folder for the report of each run; empty: none is written')
    publish_metrics: tuple[str, ...] = option(
        ('ate_trans_rmse_m', 'ate_rot_rmse_deg', 'rpe_1s_trans_rmse_m', 'rpe_1s_rot_rmse_deg'),
        'metrics with topics of their own, ~/metrics/NAME and ~/window/NAME',
    )
    window_s: float = option(10.0, 'length of the window of ~/window/NAME', minimum=0.0)
    stale_after_s: float = option(
        2.0, 'a stream that says nothing for longer is stale', minimum=0.0
    )
    max_pairs: int = option(
        1_000_000,
        'how many pairs are kept; of more, rmse stay exact and the rest is of a part',
        minimum=1000,
    )
    exit_code_from_gates: bool = option(
        False, 'exit with status 1 where a gate of the last run failed'
    )


def declare(node: Node) -> tuple[EvaluationConfig, NodeConfig]:
    """
    Declare all parameters of the node and return their values.

    They are read-only: a score keeps the options with which it began.

    :raises ConfigError: a parameter that does not exist, or a value that is not allowed.
    """
    known = [item.name for config in (EvaluationConfig, NodeConfig) for item in fields(config)]
    for name in node._parameter_overrides:
        if name not in known and not name.startswith(OF_ROS):
            raise ConfigError(f"there is no parameter '{name}'{nearest_name(name, known)}")
    return (
        EvaluationConfig.from_mapping(_values(node, EvaluationConfig)),
        NodeConfig.from_mapping(_values(node, NodeConfig)),
    )


def _values(node: Node, config: type[Options]) -> dict[str, Any]:
    return {
        item.name: _declare(node, item, getattr(config(), item.name)) for item in fields(config)
    }


def _declare(node: Node, item: Field[Any], default: Any) -> Any:
    choices = item.metadata['choices']
    descriptor = ParameterDescriptor(
        description=item.metadata['description'],
        additional_constraints=f'one of {", ".join(choices)}' if choices else '',
        read_only=True,
        # so that 1 will do for 1.0; what is not allowed is rejected in the words of all shells
        dynamic_typing=True,
    )
    default = list(default) if isinstance(default, tuple) else default
    value = node.declare_parameter(item.name, default, descriptor).value
    if value is None:  # what an empty list in a parameter file arrives as
        return default
    return list(value) if isinstance(value, (tuple, array)) else value
