"""The ROS side of risc_visual: parameters, conversions, markers, health."""
