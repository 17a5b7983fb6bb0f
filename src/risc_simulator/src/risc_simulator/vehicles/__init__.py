"""Vehicle types, virtual side: each is a module (or a package) here, with the name that the type has in fleet files.

A type is a module with
    Firmware    its on-board logic, a models.flight.Firmware: actions in, commands of the loops out
    Host        its network side, a socket_host.VehicleHost: commands in; sensors, status and pictures out
and, compiled (risc_lab.compiled), where it differs from a plain quadrotor (defaults: models/integrator.py)
    FIELDS      (name, type) of record fields that its equations need beside models.quadrotor.QUADROTOR_FIELDS
    slope       (x, inputs, vehicle, x_dot) -> thrust: equations of motion with its attitude loops
    before_step (x, inputs, vehicle), after_step (inputs, climb_m_s, vehicle, step_s): what runs on board in every step
and, if it has cameras whose video the lab serves (socket_host.VehicleHost.video_listener),
    CAMERAS     a `VirtualCamera` for each, in the order of the channels that its host chooses from
and, if filters are to get its sensor readings in offline flights, too,
    Telemetry   (vehicle, seed, noise), constructed while the vehicle stands: channel (name of its wire), period_s;
                packet(time_s) -> bytes; message(packet, header) -> message of its driver (see risc_estimation.sensors),
                None for a damaged packet
and, if its driver in offline flights is not that of models/offline_link.py (sticks by radio),
    OfflineLink (vehicle, phase), with the same names as there
and, if a fault is to freeze its reports (navdata_freeze),
    repeated    (told, datagram) -> datagram with the content of the first one of its kind, which told, a dict, keeps,
                its own sequence number, and a valid checksum. Other data is returned unchanged
The numbers of its airframe are in the YAML file of the type (risc_lab/config/vehicle_types), and so are those that no
other type has (`own_numbers` of risc_lab.lab.vehicle_types). A type from outside this package is
virtual_vehicles/NAME.py and vehicle_types/NAME.yaml in a folder of RISC_MAAP_MEMBERS (see risc_lab.registry).
"""

import functools
from collections.abc import Callable
from typing import NamedTuple

from risc_lab.lab.calibration import CameraMount
from risc_lab.registry import Registry
from risc_simulator.models import integrator, offline_link
from risc_simulator.models.quadrotor import QUADROTOR_FIELDS

REGISTRY = Registry("virtual_vehicles", __name__)
_EQUATIONS = ("slope", "before_step", "after_step")


class VirtualCamera(NamedTuple):
    """A camera of a vehicle type. The size of its pictures is that of its calibration."""

    name: str
    calibration: str  # see lab.calibration.resolve_url
    mount: CameraMount
    sensor_px: tuple[int, int] | None = None  # of a coarser sensor, whose pictures the firmware scales up
    by_fleet: bool = False  # a fleet file may replace calibration and mount; at most one camera of a type


class VirtualType(NamedTuple):
    """Definition of a type, as the world and the lab use it."""

    Firmware: type
    Host: type
    fields: tuple  # of its record, see risc_lab.compiled
    equations: dict  # {name in integrator.py: function}
    cameras: tuple[VirtualCamera, ...]
    Telemetry: type | None
    OfflineLink: type
    repeated: Callable | None


@functools.cache
def virtual_type(name):
    """VirtualType of this name. Raises ValueError for an unknown one, or when something is missing in its module."""
    module = REGISTRY.module(name)
    try:
        return VirtualType(
            module.Firmware,
            module.Host,
            (*QUADROTOR_FIELDS, *getattr(module, "FIELDS", ())),
            {name: getattr(module, name, getattr(integrator, name)) for name in _EQUATIONS},
            tuple(getattr(module, "CAMERAS", ())),
            getattr(module, "Telemetry", None),
            getattr(module, "OfflineLink", offline_link.OfflineLink),
            getattr(module, "repeated", None),
        )
    except AttributeError as error:
        raise ValueError("virtual vehicle %r (%s): %s" % (name, module.__file__, error)) from error
