"""Accuracy of visual-inertial odometry and SLAM, while it runs and afterwards."""

__version__ = '0.1.0'
