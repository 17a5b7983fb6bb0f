"""MAVLink to ROS and back. `autopilot` and `orders` decide, without sockets, clock or ROS; `ros` ties it to topics."""
