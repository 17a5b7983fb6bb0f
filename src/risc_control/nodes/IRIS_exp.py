#!/usr/bin/env python3
"""Experiments with the IRIS+: origin and quadrants I, II, III, IV, I, stepped through by the joystick's bumpers."""

from risc_control.ros.controller_node import main
from risc_control.ros.experiment_node import IrisExperiment
from risc_control.trajectories import origin, quadrant

if __name__ == "__main__":
    main("DF_Demo", lambda: IrisExperiment([origin(1), *(quadrant(number, 1) for number in (1, 2, 3, 4, 1))]))
