"""A run that goes on, without ROS: which run a pose belongs to, and what is reported of it."""
