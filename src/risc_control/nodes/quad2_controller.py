#!/usr/bin/env python3
"""The vehicle node of quad2: the one program under its legacy name, on the topics /quad2/..."""

from risc_control.ros.vehicle_node import main

if __name__ == "__main__":
    main("quad2")
