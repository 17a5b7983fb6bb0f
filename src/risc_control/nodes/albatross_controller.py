#!/usr/bin/env python3
"""The vehicle node of albatross: the one program under its legacy name, on the topics /albatross/..."""

from risc_control.ros.vehicle_node import main

if __name__ == "__main__":
    main("albatross")
