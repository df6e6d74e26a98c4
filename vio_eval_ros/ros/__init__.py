"""Nodes in ROS 2: the only modules that import rclpy."""

from vio_eval_ros.errors import VioEvalError


def without_ros(error: ImportError) -> VioEvalError:
    """Return the error where ROS 2 cannot be imported."""
    return VioEvalError(
        f'ROS 2 is missing ({error}); source an installation of it, or pip install '
        "'vio_eval_ros[ros]'"
    )
