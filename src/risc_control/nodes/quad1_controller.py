#!/usr/bin/env python3
"""The vehicle node of quad1: the one program under its legacy name, on the topics /quad1/..."""

from risc_control.ros.vehicle_node import main

if __name__ == "__main__":
    main("quad1")
