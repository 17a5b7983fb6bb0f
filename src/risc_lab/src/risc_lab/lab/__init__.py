"""The laboratory as data: the fleet, the vehicle types, the mocap templates. Needs no ROS."""

from risc_lab.lab.arena import Arena as Arena
from risc_lab.lab.fleet import Fleet as Fleet
from risc_lab.lab.fleet import FleetLandmark as FleetLandmark
from risc_lab.lab.fleet import FleetVehicle as FleetVehicle
from risc_lab.lab.fleet import MocapEndpoint as MocapEndpoint
from risc_lab.lab.fleet import Start as Start
from risc_lab.lab.fleet import fleet_from_dict as fleet_from_dict
from risc_lab.lab.fleet import load_fleet as load_fleet
from risc_lab.lab.generated_fleet import generated_fleet as generated_fleet
from risc_lab.lab.templates import Template as Template
from risc_lab.lab.templates import load_templates as load_templates
from risc_lab.lab.vehicle_types import AttitudeLoop as AttitudeLoop
from risc_lab.lab.vehicle_types import VehicleType as VehicleType
from risc_lab.lab.vehicle_types import load_vehicle_type as load_vehicle_type
