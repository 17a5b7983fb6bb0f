"""ROS parts of the nodes that draw in rviz."""
