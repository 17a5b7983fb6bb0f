"""What is drawn of the laboratory: vehicles, trails, rays, the arena. Needs no ROS."""
