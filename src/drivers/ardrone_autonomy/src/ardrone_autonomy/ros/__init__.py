"""ROS side of the driver: parameters, messages, the node."""
