#!/usr/bin/env python3
"""One circle of 0.7 m in 5 s for all vehicles, evenly spread."""

import sys

from risc_control.ros.controller_node import main
from risc_control.ros.trajectory_node import TrajectoryNode

if __name__ == "__main__":
    sys.exit(main("circular_trajectory", lambda: TrajectoryNode("circle", radius_m=0.7, period_s=5.0)))
