"""The laboratory as data: the fleet, the vehicle types, the mocap templates. Needs no ROS."""

from risc_control.lab.arena import Arena
from risc_control.lab.fleet import Fleet, FleetLandmark, FleetVehicle, MocapEndpoint, fleet_from_dict, load_fleet
from risc_control.lab.generated import generated_fleet
from risc_control.lab.templates import Template, load_templates
from risc_control.lab.vehicle_types import AttitudeLoop, VehicleType, load_vehicle_type

__all__ = [
    "Arena",
    "AttitudeLoop",
    "Fleet",
    "FleetLandmark",
    "FleetVehicle",
    "MocapEndpoint",
    "Template",
    "VehicleType",
    "fleet_from_dict",
    "generated_fleet",
    "load_fleet",
    "load_templates",
    "load_vehicle_type",
]
