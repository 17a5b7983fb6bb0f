"""Code of the nodes of this package that needs ROS: messages <-> arrays, parameters, wiring."""
