#!/usr/bin/env python3
"""A torus knot for all vehicles."""

import sys

from risc_control.ros.controller_node import main
from risc_control.ros.trajectory_node import TrajectoryNode

if __name__ == "__main__":
    sys.exit(main("toroid_knot_trajectory", lambda: TrajectoryNode("knot")))
