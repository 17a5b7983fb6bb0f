"""Driver of the Parrot AR.Drone 2.0: `ardrone_autonomy.protocol` is its wire codec (no ROS, no sockets)."""
