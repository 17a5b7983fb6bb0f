"""USB cameras, video files and folders of pictures as sensor_msgs/Image. `sources` and `settings` need no ROS."""
