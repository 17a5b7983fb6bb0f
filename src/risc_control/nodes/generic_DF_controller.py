#!/usr/bin/env python3
"""Differential flatness controller of several AR.Drones (thesis 6; the controller of Appendix C)."""

import sys

from risc_control.cfg import TrackingWeightsConfig
from risc_control.ros.controller_node import ControllerNode, main
from risc_control.tracking import FlatnessController

if __name__ == "__main__":
    sys.exit(main("Differential_Flatness", lambda: ControllerNode(FlatnessController, TrackingWeightsConfig)))
