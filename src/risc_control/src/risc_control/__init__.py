"""Control of vehicles: trajectories, flatness, LQR, controllers, vehicle adapters, failsafe levels. Needs no ROS."""
