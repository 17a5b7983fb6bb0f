#!/usr/bin/env python3
"""MAVLink to ROS: rosrun roscopter driver.py --device=DEVICE [options]. See the README of the package."""

import sys

from roscopter.options import driver_options
from roscopter.ros.node import main

if __name__ == "__main__":
    sys.exit(main(driver_options, sys.argv))
