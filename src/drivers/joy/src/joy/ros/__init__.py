"""ROS side of the joystick node."""
