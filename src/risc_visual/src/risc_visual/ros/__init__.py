"""The ROS side of risc_visual: paced subscriptions, parameters, conversions, health."""
