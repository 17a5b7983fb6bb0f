"""Vehicle types, virtual side: each is a module (or a package) here, under the name that fleet files call the type.

A type is a module with
    Firmware    its on-board logic, a models.flight.Firmware: actions in, commands of the loops out
    Host        what it is on the wire, a socket_host.VehicleHost: commands in; sensors, status and pictures out
and, compiled (risc_lab.compiled), where it differs from a plain quadrotor (models/integrator.py has these names, too)
    FIELDS      (name, type) of what its equations read from a record beside models.quadrotor.QUADROTOR_FIELDS
    slope       (x, inputs, vehicle, x_dot) -> thrust: equations of motion with its attitude loops
    before_step (x, inputs, vehicle), after_step (inputs, climb_m_s, vehicle, step_s): what runs on board in every step
and, if it has cameras whose video the lab serves (socket_host.VehicleHost.video_listener),
    CAMERAS     a `VirtualCamera` for each, in the order of the channels that its host chooses from
and, if filters are to have its sensors' readings in offline flights, too
    Telemetry   (vehicle, seed, noise), made while the vehicle stands: channel (name of its wire), period_s;
                packet(time_s) -> bytes; message(packet, header) -> that of its driver, see risc_estimation.sensors;
                None of a damaged packet
and, if in offline flights its driver is another one than that of models/offline_link.py (sticks by radio),
    OfflineLink (vehicle, phase), with the names that are there
and, if a fault is to freeze what it says of itself (navdata_freeze),
    repeated    (told, datagram) -> datagram with the content of the first one of its kind, which told, a dict, keeps;
                fresh sequence number, check sum that fits. Anything else is returned as it is
The numbers of its airframe are in the YAML file of the type (risc_lab/config/vehicle_types), and so are those that no
other type has (`own_numbers` of risc_lab.lab.vehicle_types). One from elsewhere is virtual_vehicles/NAME.py and
vehicle_types/NAME.yaml in a folder of RISC_MAAP_MEMBERS (see risc_lab.registry).
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
    """A camera of a type of vehicle. Its pictures have the size that its calibration says."""

    name: str
    calibration: str  # see lab.calibration.resolve_url
    mount: CameraMount
    sensor_px: tuple[int, int] | None = None  # of a sensor that is coarser, whose pictures firmware scales up
    by_fleet: bool = False  # a fleet file may give a vehicle another calibration and mount: its one camera of this kind


class VirtualType(NamedTuple):
    """What the world and the lab know of a type."""

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
