"""Linux joystick to sensor_msgs/Joy. `device_records` is pure; `device` uses the kernel; the node ties them to ROS."""
