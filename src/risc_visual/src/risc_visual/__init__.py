"""The laboratory in pictures: what is drawn (pure), how rviz is told (markers), and the ROS side (ros)."""
