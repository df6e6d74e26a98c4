"""A live evaluation without ROS: its runs, their health, diagnosis and reports."""
