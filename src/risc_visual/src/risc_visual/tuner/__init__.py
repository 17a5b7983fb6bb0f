"""Tuning where a camera sits on its vehicle (thesis 4.4.4). Needs no ROS."""
