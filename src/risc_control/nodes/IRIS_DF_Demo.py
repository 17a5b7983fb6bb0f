#!/usr/bin/env python3
"""Eight modes of the IRIS+, stepped through by the joystick's bumpers: trajectory and controller in one node."""

from risc_control.ros.controller_node import main
from risc_control.ros.experiment_node import IrisExperiment
from risc_control.trajectories import circle, flat8, knot, origin, slanted8


def courses():
    """Sizes and periods of the original's IRIS+."""
    home = origin(1)
    slanted = slanted8(1, length_m=1.0, width_m=0.5, period_s=12.0)
    flat = flat8(1, length_m=1.0, width_m=0.5, height_m=1.0)
    return [home, slanted, home, flat, home, circle(1, period_s=10.0), home, knot(1, period_s=15.0)]


if __name__ == "__main__":
    main("DF_Demo", lambda: IrisExperiment(courses()))
