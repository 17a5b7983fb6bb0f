"""The fleet file: which vehicles fly, where they stand, and at which addresses everything is reached.

Two sections may be left out: `arena` (the net, where it is not that of the laboratory) and `templates` (of objects that
templates.yaml does not know, in its syntax).
"""

import ipaddress
import math
import re
from dataclasses import dataclass, field, replace

import msgspec

from risc_lab.lab.arena import Arena
from risc_lab.lab.templates import TemplateSet
from risc_lab.lab.vehicle_types import DEFAULT_TYPE, OVERRIDABLE, load_vehicle_type
from risc_lab.lab.yaml_reader import load_yaml
from risc_lab.settings import Name, NotNegative, Port, Settings, Vector, between, check_different, settings_from


@dataclass(frozen=True)
class MocapEndpoint(Settings):
    """Address and settings of the motion capture host."""

    host: str | None  # address of the Cortex host
    command_port: Port = 1510
    stream_group: Name = "225.1.1.1"  # multicast group of the live stream
    stream_port: Port = 1001
    interface: str = ""  # address of the local interface that receives the stream; "" lets the kernel choose
    rate_hz: between(1.0, 2000.0) = 200.0
    reported_delay_s: between(0.0, 0.1) = 0.003  # virtual lab only: exposure to sending

    def __post_init__(self):
        super().__post_init__()
        _check_address(self, "host", "the Cortex computer")
        _check_address(self, "stream_group")
        if self.interface:
            _check_address(self, "interface")
        if not ipaddress.ip_address(self.stream_group).is_multicast:
            raise ValueError("stream_group %s is no multicast address (224.0.0.0/4)" % self.stream_group)


@dataclass(frozen=True)
class AttachedBody(Settings):
    """What a vehicle carries that moves by itself, e.g. a pendulum."""

    body: Name  # name among the bodies, see risc_simulator.bodies (virtual lab only)
    template: Name  # mocap template of its markers; controllers get its state


@dataclass(frozen=True)
class Start(Settings):
    """Where a vehicle stands before take-off; cortex frame."""

    position_m: Vector
    yaw_deg: float = 0.0  # + clockwise from above, as States.psi

    @property
    def yaw_rad(self):
        return math.radians(self.yaw_deg)


@dataclass(frozen=True)
class FleetVehicle(Settings):
    """One vehicle of the fleet."""

    namespace: str  # ROS namespace, e.g. risc1
    template: Name  # mocap template and hence the vehicle's name on every topic, e.g. fluffy_II
    type: Name  # file name in config/vehicle_types
    address: str | None  # "" = it is in no network, and all its links are `devices`
    start: Start
    calibration: str = ""  # of the front camera, see lab.calibration.resolve_url; "" = none
    camera_mount: str = ""  # where the front camera sits, see lab.calibration; "" = the type's nominal place
    overrides: dict[str, NotNegative] = field(default_factory=dict)  # values in place of those of its type: OVERRIDABLE
    controllers: dict[str, dict[str, float]] = field(default_factory=dict)  # settings of its own, by controller
    attached: AttachedBody | None = None
    devices: dict[str, Name] = field(default_factory=dict)  # of links that are not at its address, see `links`

    def __post_init__(self):
        super().__post_init__()
        if self.address or not self.devices:
            _check_address(self, "address", "this vehicle")
        unknown = sorted(set(self.overrides) - set(OVERRIDABLE))
        if unknown:
            raise ValueError(
                "overrides: unknown key(s) %s; known are %s" % (", ".join(unknown), ", ".join(OVERRIDABLE))
            )

    @property
    def carries(self):
        """Mocap template of what is attached to it, None when nothing is."""
        return self.attached.template if self.attached else None

    @property
    def vehicle_type(self):
        """Its VehicleType. Raises ValueError when there is no such type."""
        return load_vehicle_type(self.type, self.overrides)

    @property
    def links(self):
        """{device of its type: what its driver opens}: those of `devices`, the others at its address.

        Raises ValueError for a device that its type does not have, and for one without an address.
        """
        known = self.vehicle_type.devices
        unknown = sorted(set(self.devices) - set(known))
        if unknown:
            text = "vehicle '%s': type '%s' has no device %s; %s"
            has = "it has %s" % ", ".join(known) if known else "it is reached by its address alone: leave `devices` out"
            raise ValueError(text % (self.namespace, self.type, ", ".join(unknown), has))
        missing = [name for name in known if name not in self.devices]
        if missing and not self.address:
            text = "vehicle '%s' has no address, and no %s in its `devices`: write one of the two into the fleet file"
            raise ValueError(text % (self.namespace, ", ".join(missing)))
        return {name: self.devices.get(name) or at.format(address=self.address) for name, at in known.items()}

    @property
    def place(self):
        """Its address or devices, for people."""
        return self.address or ", ".join(self.devices.values())

    def with_overrides(self, **overrides):
        """The same vehicle with values in place of those of its type; None = unchanged."""
        given = {field: value for field, value in overrides.items() if value is not None}
        return replace(self, overrides={**self.overrides, **given})


def unplaced_vehicle(namespace, template, kind=DEFAULT_TYPE):
    """FleetVehicle without a place, for a vehicle that no fleet file lists."""
    return FleetVehicle(namespace, template, kind, "0.0.0.0", Start((0.0, 0.0, 0.0)))


def laboratory_vehicles(kind=""):
    """Vehicles of a type ("" = DEFAULT_TYPE) in the original laboratory, for when no fleet is loaded."""
    kind = kind or DEFAULT_TYPE
    return tuple(unplaced_vehicle(*names, kind) for names in load_vehicle_type(kind).laboratory.items())


def wider_m(vehicles):
    """{template: how much farther it reaches than an AR.Drone [m]} of FleetVehicles. Raises ValueError."""
    of_type = {kind: load_vehicle_type(kind).wider_m for kind in {vehicle.type for vehicle in vehicles}}
    return {vehicle.template: of_type[vehicle.type] for vehicle in vehicles}


def widest_pair_m(vehicles):
    """Sum of `wider_m` of the two widest of the vehicles [m]."""
    return sum(sorted(wider_m(vehicles).values())[-2:])


@dataclass(frozen=True)
class FleetLandmark(Settings):
    """One landmark and where it is mounted (virtual lab only; in the lab mocap measures it)."""

    name: Name
    position_m: Vector  # cortex frame
    facing_deg: float = 0.0  # where its painted side looks: 0 = along cortex x, + clockwise from above, as States.psi

    @property
    def facing_rad(self):
        return math.radians(self.facing_deg)


@dataclass(frozen=True)
class Fleet(Settings):
    """Everything that differs between one experiment's hardware and another's: the content of a fleet file."""

    name: Name
    mocap: MocapEndpoint
    vehicles: tuple[FleetVehicle, ...]
    landmarks: tuple[FleetLandmark, ...] = ()
    own_networks: bool = False  # every vehicle is an access point of its own, joined by the computer that flies it
    arena: Arena = Arena()
    templates: TemplateSet = field(default_factory=TemplateSet)  # beside those of templates.yaml

    def __post_init__(self):
        super().__post_init__()
        if not self.vehicles:
            raise ValueError("a fleet needs at least one vehicle")
        for vehicle in self.vehicles:
            if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", vehicle.namespace):
                raise ValueError("namespace %r is no ROS name (letter, then letters, digits, _)" % vehicle.namespace)
        for key in ("namespace", "template"):
            check_different(self.vehicles, key, "vehicles")
        if not self.own_networks:  # a second driver at an address, or a device, would fly another driver's vehicle
            check_different([vehicle for vehicle in self.vehicles if vehicle.address], "address", "vehicles")
            devices = [device for vehicle in self.vehicles for device in vehicle.devices.values()]
            twice = sorted({device for device in devices if devices.count(device) > 1})
            if twice:
                raise ValueError("the same device twice: %s" % ", ".join(twice))
        attached = [vehicle.attached for vehicle in self.vehicles if vehicle.attached]
        check_different([*self.vehicles, *attached], "template", "vehicles or attached bodies")
        check_different(self.landmarks, "name", "landmarks")

    def with_vehicles(self, count):
        """The same fleet with its first `count` vehicles. Raises ValueError when it has fewer."""
        if not 1 <= count <= len(self.vehicles):
            raise ValueError(
                "fleet '%s' has %d vehicles, %d were requested: use another fleet file"
                % (self.name, len(self.vehicles), count)
            )
        return replace(self, vehicles=self.vehicles[:count])

    def with_overrides(self, **overrides):
        """The same fleet with values in place of those of all types, e.g. command_delay_s=0.3; None = unchanged."""
        return replace(self, vehicles=tuple(vehicle.with_overrides(**overrides) for vehicle in self.vehicles))

    def in_subnet(self, subnet):
        """The same fleet with the host at <subnet>.0.1 and vehicle k at <subnet>.1.k, e.g. subnet '127.77'.

        Several virtual labs fit on one computer this way. Devices belong to a real laboratory: they are removed.
        Raises ValueError for anything but two address bytes.
        """
        if not re.fullmatch(r"\d{1,3}\.\d{1,3}", subnet):
            raise ValueError("subnet must be the first two bytes of an address, e.g. 127.77, found %r" % (subnet,))
        vehicles = [
            replace(vehicle, address="%s.1.%d" % (subnet, k), devices={}) for k, vehicle in enumerate(self.vehicles, 1)
        ]
        return replace(self, mocap=replace(self.mocap, host=subnet + ".0.1"), vehicles=tuple(vehicles))

    def to_dict(self):
        """The fleet as the plain dict that its YAML file would hold; without empty entries, as ROS has no null."""
        content = msgspec.to_builtins(self)
        for vehicle in content["vehicles"]:
            if vehicle["attached"] is None:
                del vehicle["attached"]
        if not self.templates.templates:
            del content["templates"]
        return content


def load_fleet(path):
    """Read a fleet file. Raises ValueError that names the file, the key and what is wrong with it."""
    return fleet_from_dict(load_yaml(path), str(path))


def fleet_from_dict(content, where="fleet"):
    """Fleet from the content of a fleet file (also: of the parameter /fleet). Raises ValueError."""
    return settings_from(Fleet, content, where)


def _check_address(settings, key, whose=None):
    """Raises ValueError. whose: owner of an address that files for a real laboratory leave for the user to fill in."""
    value = getattr(settings, key)
    if whose and not value:
        raise ValueError("'%s' is not written yet: write the address of %s there" % (key, whose))
    try:
        ipaddress.IPv4Address(value)
    except ValueError as error:
        raise ValueError("'%s' must be an IPv4 address, found %r" % (key, value)) from error
