"""Have numba compile and keep all that runs in every frame of a flight (`risc_lab.compiled`), as `./maap build` does.

Halves of it on a core each, then what only a flight calls. They share no source file: numba keeps what it compiles by
file, and loses some of what two processes add at the same time.
"""

import sys

import numpy as np

from cortex_ros.wire import FrameEncoder
from risc_control.controllers import REGISTRY as CONTROLLERS
from risc_control.controllers import ControlLoop
from risc_control.feasibility import fleet_course
from risc_control.plausibility import Plausibility
from risc_control.safety import fence_of
from risc_control.separation import Separation
from risc_control.trajectories import find_course
from risc_control.trajectory_manager import make_manager
from risc_control.vehicle_pilot import VehicleNodeParams
from risc_estimation.filters import REGISTRY as ESTIMATORS
from risc_estimation.filters import make_filter
from risc_estimation.state_estimator import StatesEstimator
from risc_experiments.offline import Flight, fly, lab_of
from risc_experiments.workers import in_order
from risc_lab.lab import load_templates
from risc_simulator.video.polygons import clip_polygons, coverage
from risc_simulator.world import World


def estimation(fleet, types, vehicle_types):
    """What estimates states."""
    templates = load_templates(fleet=fleet)
    by_name = {vehicle.template: kind for vehicle, kind in zip(fleet.vehicles, vehicle_types)}
    for name in ESTIMATORS.names():
        StatesEstimator(templates, vehicles=list(by_name), velocity_filter=make_filter(name), vehicle_types=by_name)


def all_else(fleet, types, vehicle_types):
    """What flies: references, control, vehicle nodes, and the virtual lab with its wires and pictures."""
    names, params = [vehicle.template for vehicle in fleet.vehicles], VehicleNodeParams(**fence_of(fleet.arena))
    World(fleet, types, load_templates(fleet=fleet), gusts=True)
    for name in CONTROLLERS.names():
        ControlLoop(name, vehicle_types)
    make_manager(fleet.vehicles, fleet_course(find_course("circle"), fleet.vehicles, fleet.arena)[0])
    Separation(names, params)
    Plausibility(dict(zip(names, vehicle_types)), params)
    FrameEncoder((("body", 1),))
    clip_polygons(np.zeros((3, 3)), np.array([3]), np.zeros((1, 4)))
    coverage([np.zeros((3, 2))], (0, 0, 1, 1))


def _compile(half):
    half(*lab_of(Flight(vehicles=2, types=("ardrone", "iris"))))


def main():
    """Entry point."""
    from risc_control.ros.conversions import ControlsMessage, StatesReader  # the nodes', with ROS only
    from risc_estimation.ros.conversions import EstimateMessages

    list(in_order(_compile, [estimation, all_else]))
    fly(Flight(vehicles=2, gusts=True, duration_s=0.5))
    fly(Flight(vehicles=1, gusts=True, duration_s=0.5, types=("iris",)))
    for name in ESTIMATORS.names():
        fly(Flight(vehicles=1, duration_s=0.1, estimator=name))
    StatesReader(())
    ControlsMessage(())
    EstimateMessages()


if __name__ == "__main__":
    sys.exit(main())
