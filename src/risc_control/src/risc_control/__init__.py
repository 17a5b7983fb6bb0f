"""Control of the laboratory's vehicles: frames, trajectories, flatness, LQR, vehicle mappings. Needs no ROS."""
