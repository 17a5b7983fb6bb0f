"""The report of a flight: one self-contained HTML page, made from a bag. Needs no ROS."""
