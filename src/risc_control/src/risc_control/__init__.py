"""Control of vehicles: trajectories, flatness, LQR, vehicle mappings, failsafe levels. Needs no ROS."""
