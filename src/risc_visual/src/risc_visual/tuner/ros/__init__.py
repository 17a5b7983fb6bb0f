"""ROS parts of the transform tuner."""
