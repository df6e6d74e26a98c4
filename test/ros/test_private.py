"""What is private in rclpy and used here is there, and is used in one place."""

import ast
import inspect
from pathlib import Path

from rclpy import qos_overriding_options
from rclpy.executors import Executor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

ROS = Path(__file__).resolve().parents[2] / 'vio_eval_ros' / 'ros'
PRIVATE = {
    '_declare_qos_parameters', '_parameter_overrides', 'EventHandle', 'pointer', 'take_message',
    'rcl_node_get_graph_guard_condition', 'rcl_wait_set_add_guard_condition',
}  # fmt: skip


def names_in(file: Path) -> set[str]:
    """Return the names that a module takes from elsewhere or looks up in objects."""
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Attribute) and getattr(node.value, 'id', '') != 'self':
            names.add(node.attr)
        elif isinstance(node, ast.ImportFrom):
            names |= {alias.name for alias in node.names} | set((node.module or '').split('.'))
    return names


def test_rclpy_still_has_what_is_private_in_it():
    parameters = inspect.signature(qos_overriding_options._declare_qos_parameters).parameters
    assert list(parameters) == ['entity_type', 'node', 'topic_name', 'qos', 'options']
    assert '_parameter_overrides' in inspect.getsource(Node)
    assert hasattr(rclpy_implementation, 'EventHandle')
    assert hasattr(rclpy_implementation.Subscription, 'take_message')
    assert hasattr(rclpy_implementation.Node, 'pointer')
    assert hasattr(rclpy_implementation.WaitSet, 'pointer')
    assert 'waitable.add_to_wait_set(wait_set)' in inspect.getsource(Executor)


def test_what_is_private_in_rclpy_is_used_in_one_file():
    for file in ROS.glob('*.py'):
        found = names_in(file) & {*PRIVATE, 'impl', 'implementation_singleton'}
        assert bool(found) == (file.name == 'private.py'), file
    assert names_in(ROS / 'private.py') >= PRIVATE
    used = {name for file in ROS.glob('*.py') for name in names_in(file)}
    assert {n for n in used if n.startswith('_') and not n.startswith('__')} == {
        n for n in PRIVATE if n.startswith('_')
    }
