"""Accuracy of visual-inertial odometry and SLAM, while it runs and afterwards."""

from vio_eval_ros.version import __version__

__all__ = ['__version__']
