#!/usr/bin/env python3
"""Holds the IRIS+ 1 m above the origin."""

from risc_control.ros.controller_node import main
from risc_control.ros.experiment_node import IrisExperiment
from risc_control.trajectories import origin

if __name__ == "__main__":
    main("IRIS_Origin_Hold", lambda: IrisExperiment([origin(1)]))
