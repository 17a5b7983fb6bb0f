"""ROS side of the virtual lab: parameters, topics, diagnostics."""
