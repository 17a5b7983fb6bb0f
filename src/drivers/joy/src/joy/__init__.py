"""Linux joystick to sensor_msgs/Joy. `events` is pure; `device` talks to the kernel; the node ties them to ROS."""
