"""Phases of references and of the operator of a flight: the numbers of VehiclePhase, OperatorState and VehicleOut of
risc_maap_msgs.
"""

import enum


class TrajectoryPhase(enum.IntEnum):
    """What a vehicle's reference is doing."""

    HOLD = 0  # it is where the vehicle is, or where it became autonomous
    APPROACH = 1
    COURSE = 2
    HOME = 3
    HOMED = 4


class OperatorPhase(enum.IntEnum):
    """What the operator is doing, in the order of a flight."""

    WAITING = 0
    TAKEOFF = 1
    SETTLE = 2
    FLY = 3
    HOME = 4
    LAND = 5
    DONE = 6
    ABORTED = 7


class OperatorResult(enum.IntEnum):
    """How a flight ended."""

    RUNNING = 0  # not yet
    OK = 1
    FAILED = 2


class OutCause(enum.IntEnum):
    """Why a vehicle dropped out of a flight."""

    LADDER = 1  # its safety ladder landed it
    LANDED = 2  # it landed by itself
    SILENT = 3
    NODE = 4  # its vehicle node is silent
    MANUAL = 5
    OVERDUE = 6  # it did not land in time


def phase_words(vehicles):
    """dict name -> word of the phase, e.g. "course". vehicles: VehiclePhase[], of rospy or of rosbags."""
    return {vehicle.name: TrajectoryPhase(vehicle.phase).name.lower() for vehicle in vehicles}
