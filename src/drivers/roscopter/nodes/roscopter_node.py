#!/usr/bin/env python3
"""MAVLink to ROS, with fewer options: rosrun roscopter roscopter_node.py --device=DEVICE. See the README."""

import sys

from roscopter.options import node_options
from roscopter.ros.node import main

if __name__ == "__main__":
    sys.exit(main(node_options, sys.argv))
