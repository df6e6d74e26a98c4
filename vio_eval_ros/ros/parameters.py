"""The parameters of the evaluator node: the options of an evaluation, and those of the node."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import Field, fields, replace
import math
from typing import Any
import warnings

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile

from vio_eval_ros.core.config import EvaluationConfig, nearest_name, Options
from vio_eval_ros.errors import ConfigError
from vio_eval_ros.live.options import NodeConfig, SETTABLE
from vio_eval_ros.ros.private import declare_quality, parameter_overrides

LARGEST_INTEGER = (1 << 63) - 1
DEEPEST = 1_000_000


def declare(node: Node) -> tuple[EvaluationConfig, NodeConfig]:
    """
    Declare the options as parameters of the node and return their values.

    Those that change what a score means are read-only: it keeps the options with which it began.

    :raises ConfigError: a value that is not allowed.
    """
    # all are checked before any is declared, so that errors are in the words of all shells
    evaluation, settings = _given(EvaluationConfig, node), _given(NodeConfig, node)
    for options in (evaluation, settings):
        for item in fields(options):
            _declare(node, item, getattr(options, item.name))
    return evaluation, settings


def changed(settings: NodeConfig, parameters: Iterable[Parameter]) -> NodeConfig:
    """
    Return the settings with those of the parameters that may be set while the node runs.

    :raises ConfigError: a value that is not allowed.
    """
    return replace(settings, **{p.name: p.value for p in parameters if p.name in SETTABLE})


def override_quality(node: Node, topic: str, quality: QoSProfile) -> None:
    """
    Change the quality of service of a subscription to what ``qos_overrides.TOPIC`` asks for.

    :raises ConfigError: a value that is not allowed.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # what is wrong with the depth is said below
            declare_quality(node, topic, quality)
    except (ParameterException, RuntimeError, AssertionError, ValueError) as error:
        raise ConfigError(f'qos_overrides.{topic}: {error}') from None
    if quality.history not in (HistoryPolicy.KEEP_LAST, HistoryPolicy.KEEP_ALL):
        raise ConfigError(f'qos_overrides.{topic}: history must be keep_last or keep_all')
    if not 1 <= quality.depth <= DEEPEST:
        raise ConfigError(f'qos_overrides.{topic}: depth must be from 1 to {DEEPEST}')


def refuse_unknown(node: Node) -> None:
    """
    Raise where a parameter was given that has not been declared.

    :raises ConfigError: which one, and perhaps what was meant.
    """
    known = node.list_parameters([], 0).names
    for name in parameter_overrides(node):
        if name not in known:
            raise ConfigError(f"there is no parameter '{name}'{nearest_name(name, known)}")


def _given(config: type[Options], node: Node) -> Any:
    values, overrides = {}, parameter_overrides(node)
    for item in fields(config):  # type: ignore[arg-type]
        if item.name in overrides:
            value = overrides[item.name].value
            # None is what an empty list in a parameter file arrives as
            listed = value is None or isinstance(value, array)
            values[item.name] = list(value or ()) if listed else value
    return config.from_mapping(values)


def _declare(node: Node, item: Field[Any], value: Any) -> None:
    choices, minimum = item.metadata['choices'], item.metadata['minimum']
    descriptor = ParameterDescriptor(
        description=item.metadata['description'],
        additional_constraints=f'one of {", ".join(choices)}' if choices else '',
        read_only=item.name not in SETTABLE,
        # so that 1 will do for 1.0
        dynamic_typing=item.name in SETTABLE,
    )
    if minimum is not None and isinstance(value, int):
        descriptor.integer_range = [IntegerRange(from_value=minimum, to_value=LARGEST_INTEGER)]
    elif minimum is not None:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=minimum, to_value=math.inf)
        ]
    value = list(value) if isinstance(value, tuple) else value
    node.declare_parameter(item.name, value, descriptor, ignore_override=True)
