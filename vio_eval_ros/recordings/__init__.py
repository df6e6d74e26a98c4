"""Where poses come from: text files and ROS recordings, all read as columns."""
