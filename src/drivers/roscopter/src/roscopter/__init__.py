"""MAVLink to ROS and back. `autopilot` and `orders` hold the logic, without sockets, clock or ROS; `ros` the topics."""
