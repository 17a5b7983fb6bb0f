#!/usr/bin/env python3
"""Differential flatness controller of several vehicles (thesis 6; Appendix C); ~controller: another one by its name.

As LQR_DF_controller.py: LQR on a double integrator and flatness, as the thesis describes it.
"""

import pathlib
import sys

from risc_control.ros.controller_node import ControllerNode, main

if __name__ == "__main__":
    node, controller = "Differential_Flatness", "differential_flatness"
    if pathlib.Path(sys.argv[0]).name == "LQR_DF_controller.py":
        node, controller = "LQR_controller", "thesis_lqr"
    sys.exit(main(node, lambda: ControllerNode(controller)))
