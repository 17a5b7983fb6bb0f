#!/usr/bin/env python3
"""Differential flatness controller of several vehicles (thesis 6; Appendix C); ~controller selects another one."""

from risc_control.ros.controller_node import ControllerNode, main

if __name__ == "__main__":
    main("Differential_Flatness", lambda: ControllerNode("differential_flatness"))
