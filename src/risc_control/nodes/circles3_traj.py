#!/usr/bin/env python3
"""A circle for each vehicle, around centres that keep them apart."""

import sys

from risc_control.ros.controller_node import main
from risc_control.ros.trajectory_node import TrajectoryNode

if __name__ == "__main__":
    sys.exit(main("circles_traj", lambda: TrajectoryNode("circles3")))
