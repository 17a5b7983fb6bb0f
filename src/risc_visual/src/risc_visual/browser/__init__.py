"""The laboratory in a web browser. Needs no ROS."""
