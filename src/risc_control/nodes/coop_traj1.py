#!/usr/bin/env python3
"""Above the origin, turning: every camera sees every landmark once in 30 s."""

from risc_control.ros.trajectory_node import main

if __name__ == "__main__":
    main("topology_trajectory", "spin")
