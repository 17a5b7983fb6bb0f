#!/usr/bin/env python3
"""LQR on a double integrator and flatness, as the thesis describes it: for teaching and comparison."""

from risc_control.ros.controller_node import ControllerNode, main

if __name__ == "__main__":
    main("LQR_controller", lambda: ControllerNode("thesis_lqr"))
