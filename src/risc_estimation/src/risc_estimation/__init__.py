"""State estimation for the motion-capture arena: rigid fits, least-squares velocities (thesis 4.2, 4.3)."""
