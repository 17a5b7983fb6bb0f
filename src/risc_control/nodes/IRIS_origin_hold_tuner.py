#!/usr/bin/env python3
"""IRIS_origin_hold.py under its other name: every controller can be tuned in flight, by dynamic_reconfigure."""

from risc_control.ros.controller_node import main
from risc_control.ros.experiment_node import IrisHold

if __name__ == "__main__":
    main("IRIS_Origin_Hold", IrisHold)
