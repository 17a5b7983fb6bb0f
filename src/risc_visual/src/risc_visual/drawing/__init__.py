"""What is drawn of the laboratory: vehicles, trails, rays, the room. Needs no ROS."""
