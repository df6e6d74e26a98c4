"""Arithmetic on columns of numbers: no ROS, no files, no clock, no printing."""
