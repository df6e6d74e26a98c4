"""The verbs that need rclpy: what they do is elsewhere, here it meets the ROS graph."""
