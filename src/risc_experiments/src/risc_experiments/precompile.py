"""Compile and cache with numba what runs in every frame of a flight (risc_lab.compiled): part of `./maap build`."""

import os
import sys

import numpy as np

from cortex_ros.wire import FrameEncoder
from risc_control.controllers import REGISTRY as CONTROLLERS
from risc_control.controllers import ControlLoop
from risc_control.vehicles import REGISTRY as VEHICLE_TYPES
from risc_estimation.filters import REGISTRY as ESTIMATORS
from risc_experiments.offline import Flight, fly
from risc_lab.lab import load_vehicle_type
from risc_lab.lab.vehicle_types import DEFAULT_TYPE
from risc_lab.registry import VARIABLE
from risc_simulator.video.polygons import clip_polygons, coverage


def main():
    """Entry point."""
    from risc_control.ros.conversions import ControlsMessage, StatesReader  # of the nodes: need ROS
    from risc_estimation.ros.conversions import EstimateMessages

    os.environ.pop(VARIABLE, None)  # external members are compiled when they fly: their errors must not fail a build
    kinds = VEHICLE_TYPES.names()
    for kind in kinds:
        fly(Flight(vehicles=2, gusts=True, duration_s=0.5, types=(kind, kind)))
    for name in ESTIMATORS.names():
        fly(Flight(vehicles=1, duration_s=0.1, estimator=name))
    for name in CONTROLLERS.names():
        ControlLoop(name, [load_vehicle_type(DEFAULT_TYPE)])
    FrameEncoder((("body", 1),))  # the virtual lab's
    clip_polygons(np.zeros((3, 3)), np.array([3]), np.zeros((1, 4)))  # its cameras'
    coverage([np.zeros((3, 2))], (0, 0, 1, 1))
    StatesReader(())
    ControlsMessage(())
    EstimateMessages()


if __name__ == "__main__":
    sys.exit(main())
