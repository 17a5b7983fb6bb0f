"""What the nodes of this package share that needs ROS: messages <-> arrays, parameters, wiring."""
