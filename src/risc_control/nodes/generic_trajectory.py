#!/usr/bin/env python3
"""Any course by its name (~course)."""

import sys

from risc_control.ros.controller_node import main
from risc_control.ros.trajectory_node import TrajectoryNode

if __name__ == "__main__":
    sys.exit(main("generic_trajectory", lambda: TrajectoryNode("circle")))
