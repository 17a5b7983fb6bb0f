"""Turns bags into data: CSV files, flight metrics, plots and summaries. Needs no ROS."""
