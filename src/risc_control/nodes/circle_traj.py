#!/usr/bin/env python3
"""One circle of 0.7 m in 5 s for all vehicles, evenly spread."""

from risc_control.ros.trajectory_node import main

if __name__ == "__main__":
    main("circular_trajectory", "circle", radius_m=0.7, period_s=5.0)
