"""The report of a flight: one HTML page that holds everything, made from a bag. Needs no ROS."""
