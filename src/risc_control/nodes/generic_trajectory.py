#!/usr/bin/env python3
"""Any course by its name (~course)."""

from risc_control.ros.trajectory_node import main

if __name__ == "__main__":
    main("generic_trajectory", "circle")
