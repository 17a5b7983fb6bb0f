#!/usr/bin/env python3
"""Differential flatness controller of the IRIS+: references in on /trajectory, stick fractions out on /controls."""

from risc_control.ros.controller_node import main
from risc_control.ros.experiment_node import IrisController

if __name__ == "__main__":
    main("IRIS_DF_Controller", IrisController)
