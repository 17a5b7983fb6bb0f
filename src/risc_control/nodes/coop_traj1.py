#!/usr/bin/env python3
"""Above the origin, turning: every camera sees every landmark once in 30 s."""

import sys

from risc_control.ros.controller_node import main
from risc_control.ros.trajectory_node import TrajectoryNode

if __name__ == "__main__":
    sys.exit(main("topology_trajectory", lambda: TrajectoryNode("spin")))
