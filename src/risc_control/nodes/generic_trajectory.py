#!/usr/bin/env python3
"""Any course by its name (~course); under a name of the original release the one that it flew there."""

import pathlib
import sys

from risc_control.ros.trajectory_node import main

ORIGINAL = {  # program: (name of the node, course, its numbers)
    "circle_traj.py": ("circular_trajectory", "circle", {"radius_m": 0.7, "period_s": 5.0}),
    "circles3_traj.py": ("circles_traj", "circles3", {}),
    "coop_traj1.py": ("topology_trajectory", "spin", {}),
    "toroid_knot.py": ("toroid_knot_trajectory", "knot", {}),
}

if __name__ == "__main__":
    name, course, numbers = ORIGINAL.get(pathlib.Path(sys.argv[0]).name, ("generic_trajectory", "circle", {}))
    sys.exit(main(name, course, **numbers))
