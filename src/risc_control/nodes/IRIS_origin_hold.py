#!/usr/bin/env python3
"""Holds the IRIS+ above the origin: 1 m, or ~height_m."""

from risc_control.ros.controller_node import main
from risc_control.ros.experiment_node import IrisHold

if __name__ == "__main__":
    main("IRIS_Origin_Hold", IrisHold)
