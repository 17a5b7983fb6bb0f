"""Nodes that tell rviz what to draw."""
