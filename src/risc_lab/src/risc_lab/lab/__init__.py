"""The laboratory as data: the fleet, the vehicle types, the mocap templates. Needs no ROS."""

from risc_lab.lab.arena import Arena
from risc_lab.lab.fleet import Fleet, FleetLandmark, FleetVehicle, MocapEndpoint, Start, fleet_from_dict, load_fleet
from risc_lab.lab.generated_fleet import generated_fleet
from risc_lab.lab.templates import Template, load_templates
from risc_lab.lab.vehicle_types import AttitudeLoop, VehicleType, load_vehicle_type

__all__ = [
    "Arena",
    "AttitudeLoop",
    "Fleet",
    "FleetLandmark",
    "FleetVehicle",
    "MocapEndpoint",
    "Start",
    "Template",
    "VehicleType",
    "fleet_from_dict",
    "generated_fleet",
    "load_fleet",
    "load_templates",
    "load_vehicle_type",
]
