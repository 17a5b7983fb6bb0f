"""Which fleet flies when none is named: one of launch/fleets, or a generated one where they hold too few vehicles."""

import os
import pathlib
from dataclasses import replace

from risc_control.trajectories import FEW_VEHICLES, course_for_fleet
from risc_lab.lab import generated_fleet, load_fleet
from risc_lab.lab.yaml_reader import package_file

_FILES = ((3, "ardrones3.yaml"), (FEW_VEHICLES, "ardrones5.yaml"))
_OF_EXPERIMENT = {"iris": "iris1.yaml"}
_ROOMS_M = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0)  # outermost start to a generated net; the first that works
_ONE_LAYER_M = 2.0  # net height for the check of a course: no vehicle has to fly above another


def default_fleet(vehicles, trajectory, experiment=""):
    """Fleet of this many vehicles with room for a course. Raises ValueError."""
    root = os.environ.get("RISC_MAAP_ROOT")  # set by ./maap; else use the workspace of this package's sources
    folder = pathlib.Path(root, "launch/fleets") if root else package_file("..", "launch/fleets")
    if experiment in _OF_EXPERIMENT:
        return load_fleet(folder / _OF_EXPERIMENT[experiment]).with_vehicles(vehicles)
    for most, name in _FILES:
        if vehicles <= most:
            return load_fleet(folder / name).with_vehicles(vehicles)
    problem = None
    for room_m in _ROOMS_M:
        fleet = generated_fleet(vehicles, room_m)
        try:
            course_for_fleet(trajectory, vehicles, replace(fleet.arena, height_m=_ONE_LAYER_M))
        except ValueError as error:
            problem = error
        else:
            return fleet
    raise problem
