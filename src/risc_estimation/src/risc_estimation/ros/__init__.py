"""The ROS side of risc_estimation: message conversions and parameter loading."""
