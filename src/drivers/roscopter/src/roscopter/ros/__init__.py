"""ROS side of the bridge."""
