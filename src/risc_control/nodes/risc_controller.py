#!/usr/bin/env python3
"""The vehicle node: with relative names, for its vehicle's group; as risc1_controller.py on the topics /risc1/..."""

import pathlib
import sys

from risc_control.ros.vehicle_node import main

if __name__ == "__main__":
    vehicle = pathlib.Path(sys.argv[0]).name.removesuffix("_controller.py")
    sys.exit(main("" if vehicle == "risc" else vehicle))
