"""The ROS side of risc_experiments."""
