"""ROS side: the topics, services and parameters of a device, and the node."""
