#!/usr/bin/env python3
"""A circle for each vehicle, around centres that keep them apart."""

from risc_control.ros.trajectory_node import main

if __name__ == "__main__":
    main("circles_traj", "circles3")
