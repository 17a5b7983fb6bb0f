#!/usr/bin/env python3
"""The figures of chapter 6 with one vehicle: trajectory and controller in one node, figures chosen by the bumpers."""

from risc_control.ros.controller_node import main
from risc_control.ros.experiment_node import ExperimentNode
from risc_control.trajectories import make_course

FIGURES = ("origin", "slanted8", "origin", "flat8", "origin", "circle")

if __name__ == "__main__":
    main("LQR_controller", lambda: ExperimentNode([make_course(name, 1) for name in FIGURES]))
