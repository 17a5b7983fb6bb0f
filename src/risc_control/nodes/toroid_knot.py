#!/usr/bin/env python3
"""A torus knot for all vehicles."""

from risc_control.ros.trajectory_node import main

if __name__ == "__main__":
    main("toroid_knot_trajectory", "knot")
