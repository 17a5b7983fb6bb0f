"""Models of physics, cameras and radio: pure functions and small classes, no sockets, no ROS."""
