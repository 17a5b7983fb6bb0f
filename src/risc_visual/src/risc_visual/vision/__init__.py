"""Landmarks and vehicles in pictures, masks by colour, calibration by a checkerboard. Needs no ROS."""
