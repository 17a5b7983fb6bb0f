#!/usr/bin/env python3
"""The vehicle node with relative names: start it inside the vehicle's group."""

from risc_control.ros.vehicle_node import main

if __name__ == "__main__":
    main()
