#!/usr/bin/env python3
"""The vehicle node of risc3: the one program under the name that Appendix C gives it, on the topics /risc3/..."""

from risc_control.ros.vehicle_node import main

if __name__ == "__main__":
    main("risc3")
