"""Vision, drawing in rviz, browser view, transform tuner and pictures of flights; ROS parts are in folders `ros`."""
