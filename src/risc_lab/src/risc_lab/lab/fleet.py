"""The fleet file: which vehicles fly, where they stand, and at which addresses everything is reached.

Two sections may be left out: `arena` (the net, where it is not that of the laboratory) and `templates` (of objects that
templates.yaml does not know, in its syntax).
"""

import ipaddress
import math
import re
from dataclasses import dataclass, field, replace

from risc_lab.lab.arena import Arena
from risc_lab.lab.ranges import check_different
from risc_lab.lab.templates import Template, templates_from_dict, templates_to_dict
from risc_lab.lab.vehicle_types import OVERRIDABLE, load_vehicle_type
from risc_lab.lab.yaml_reader import Section, errors_of, load_yaml

LEGACY_VEHICLES = {"risc1": "fluffy_II", "risc2": "albatross", "risc3": "Raven"}  # of the lab, when no fleet is loaded


@dataclass(frozen=True)
class MocapEndpoint:
    """Where the motion capture host is, and what it is set to."""

    host: str  # address of the Cortex host
    command_port: int = 1510
    stream_group: str = "225.1.1.1"  # multicast group of the live stream
    stream_port: int = 1001
    interface: str = ""  # address of the local interface that receives the stream; "" lets the kernel choose
    rate_hz: float = 200.0
    reported_delay_s: float = 0.003  # virtual lab only: exposure to sending


@dataclass(frozen=True)
class AttachedBody:
    """What a vehicle carries that moves by itself, e.g. a pendulum (virtual lab only)."""

    body: str  # name among the bodies, see risc_simulator.bodies
    template: str  # mocap template of its markers


@dataclass(frozen=True)
class FleetVehicle:
    """One vehicle of the fleet."""

    namespace: str  # ROS namespace, e.g. risc1
    template: str  # mocap template and hence the vehicle's name on every topic, e.g. fluffy_II
    type: str  # file name in config/vehicle_types
    address: str
    calibration: str  # of the front camera, see lab.calibration.resolve_url; "" = none
    start_position_m: tuple[float, float, float]  # where it stands before take-off; cortex frame
    start_yaw_rad: float  # + clockwise from above, as States.psi
    camera_mount: str = ""  # where the front camera sits, see lab.calibration; "" = the type's nominal place
    overrides: tuple[tuple[str, float], ...] = ()  # (field, value) that it has otherwise than its type
    attached: AttachedBody | None = None

    @property
    def vehicle_type(self):
        """Its VehicleType. Raises ValueError when there is no such type."""
        return load_vehicle_type(self.type, self.overrides)

    def with_overrides(self, **overrides):
        """The same vehicle with other numbers of its type; None = as they are."""
        given = {field: value for field, value in overrides.items() if value is not None}
        return replace(self, overrides=tuple({**dict(self.overrides), **given}.items()))


def unplaced_vehicle(namespace, template, kind="ardrone"):
    """FleetVehicle of which no fleet file says where it is."""
    return FleetVehicle(namespace, template, kind, "0.0.0.0", "", (0.0, 0.0, 0.0), 0.0)


def laboratory_vehicles():
    """Those of the original laboratory, for when no fleet is loaded."""
    return tuple(unplaced_vehicle(*names) for names in LEGACY_VEHICLES.items())


@dataclass(frozen=True)
class FleetLandmark:
    """One landmark and where it is mounted (virtual lab only; in the lab mocap measures it)."""

    name: str
    position_m: tuple[float, float, float]  # cortex frame
    facing_rad: float = 0.0  # where its painted side looks: 0 = along cortex x, + clockwise from above, as States.psi


@dataclass(frozen=True)
class Fleet:
    """Everything that differs between one experiment's hardware and another's."""

    name: str
    mocap: MocapEndpoint
    vehicles: tuple[FleetVehicle, ...]
    landmarks: tuple[FleetLandmark, ...] = ()
    own_networks: bool = False  # every vehicle is an access point of its own, joined by the computer that flies it
    arena: Arena = Arena()
    templates: dict[str, Template] = field(default_factory=dict)  # by name, beside those of templates.yaml

    def with_vehicles(self, count):
        """The same fleet with its first `count` vehicles. Raises ValueError when there are not so many."""
        if not 1 <= count <= len(self.vehicles):
            raise ValueError(
                "fleet '%s' has %d vehicles, %d were asked for: use another fleet file"
                % (self.name, len(self.vehicles), count)
            )
        return replace(self, vehicles=self.vehicles[:count])

    def with_overrides(self, **overrides):
        """The same fleet, all its vehicles with other numbers of their types, e.g. command_delay_s=0.3; None = none."""
        return replace(self, vehicles=tuple(vehicle.with_overrides(**overrides) for vehicle in self.vehicles))

    def in_subnet(self, subnet):
        """The same fleet with the host at <subnet>.0.1 and vehicle k at <subnet>.1.k, e.g. subnet '127.77'.

        Several virtual labs fit on one computer this way. Raises ValueError for anything but two address bytes.
        """
        if not re.fullmatch(r"\d{1,3}\.\d{1,3}", subnet):
            raise ValueError("subnet must be the first two bytes of an address, e.g. 127.77, found %r" % (subnet,))
        vehicles = tuple(
            replace(vehicle, address=_address("%s.1.%d" % (subnet, k), "subnet"))
            for k, vehicle in enumerate(self.vehicles, start=1)
        )
        return replace(self, mocap=replace(self.mocap, host=_address(subnet + ".0.1", "subnet")), vehicles=vehicles)

    def to_dict(self):
        """The fleet as the plain dict that its YAML file would hold."""
        content = {
            "name": self.name,
            "own_networks": self.own_networks,
            "arena": dict(vars(self.arena)),
            "mocap": dict(vars(self.mocap)),
            "vehicles": [
                {
                    "namespace": v.namespace,
                    "template": v.template,
                    "type": v.type,
                    "address": v.address,
                    "calibration": v.calibration,
                    "camera_mount": v.camera_mount,
                    "start": {"position_m": list(v.start_position_m), "yaw_deg": math.degrees(v.start_yaw_rad)},
                    "overrides": dict(v.overrides),
                    **({"attached": dict(vars(v.attached))} if v.attached else {}),
                }
                for v in self.vehicles
            ],
            "landmarks": [
                {"name": m.name, "position_m": list(m.position_m), "facing_deg": math.degrees(m.facing_rad)}
                for m in self.landmarks
            ],
        }
        if self.templates:
            content["templates"] = templates_to_dict(self.templates)
        return content


def load_fleet(path):
    """Read a fleet file. Raises ValueError that names the file, the key and what is wrong with it."""
    return fleet_from_dict(load_yaml(path), str(path))


def fleet_from_dict(content, where="fleet"):
    """Fleet from the content of a fleet file (also: of the parameter /fleet). Raises ValueError."""
    root = Section(content, where)
    fleet = Fleet(
        name=root.text("name"),
        mocap=_mocap(root.section("mocap")),
        vehicles=tuple(_vehicle(section) for section in root.sections("vehicles")),
        landmarks=tuple(_landmark(section) for section in root.sections("landmarks", ())),
        own_networks=root.flag("own_networks", False),
        arena=root.section("arena", {}).settings(Arena),
        templates=_templates(root.content("templates", {}), "%s, templates" % where),
    )
    root.done()
    if not fleet.vehicles:
        raise ValueError("%s: a fleet needs at least one vehicle" % where)
    with errors_of(where):
        # one driver too many at an address would fly somebody else's vehicle
        for key in ("namespace", "template") + (() if fleet.own_networks else ("address",)):
            check_different(fleet.vehicles, key, "vehicles")
        attached = [vehicle.attached for vehicle in fleet.vehicles if vehicle.attached]
        check_different([*fleet.vehicles, *attached], "template", "vehicles or attached bodies")
        check_different(fleet.landmarks, "name", "landmarks")
    return fleet


def _templates(content, where):
    return templates_from_dict(content, where) if content else {}


def _mocap(section):
    endpoint = MocapEndpoint(
        host=_named_address(section, "host", "the Cortex computer"),
        command_port=section.port("command_port", 1510),
        stream_group=_address(section.text("stream_group", "225.1.1.1"), "mocap stream_group"),
        stream_port=section.port("stream_port", 1001),
        interface=section.text("interface", ""),
        rate_hz=section.number("rate_hz", 200.0, 1.0, 2000.0),
        reported_delay_s=section.number("reported_delay_s", 0.003, 0.0, 0.1),
    )
    section.done()
    if endpoint.interface:
        _address(endpoint.interface, "mocap interface")
    if not ipaddress.ip_address(endpoint.stream_group).is_multicast:
        raise ValueError("mocap stream_group %s is no multicast address (224.0.0.0/4)" % endpoint.stream_group)
    return endpoint


def _vehicle(section):
    start = section.section("start")
    vehicle = FleetVehicle(
        namespace=section.text("namespace"),
        template=section.text("template"),
        type=section.text("type"),
        address=_named_address(section, "address", "this vehicle"),
        calibration=section.text("calibration", ""),
        camera_mount=section.text("camera_mount", ""),
        start_position_m=start.vector("position_m", 3),
        start_yaw_rad=math.radians(start.number("yaw_deg", 0.0)),
        overrides=_overrides(section.section("overrides", {})),
        attached=_attached(section.section("attached")) if "attached" in section.keys() else None,
    )
    start.done()
    section.done()
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", vehicle.namespace):
        raise ValueError("vehicle namespace %r is no ROS name (letter, then letters, digits, _)" % vehicle.namespace)
    return vehicle


def _overrides(section):
    found = tuple((name, section.number(name, minimum=0.0)) for name in OVERRIDABLE if name in section.keys())
    section.done()
    return found


def _attached(section):
    attached = AttachedBody(section.text("body"), section.text("template"))
    section.done()
    return attached


def _landmark(section):
    landmark = FleetLandmark(
        name=section.text("name"),
        position_m=section.vector("position_m", 3),
        facing_rad=math.radians(section.number("facing_deg", 0.0)),
    )
    section.done()
    return landmark


def _named_address(section, key, whose):
    """The address under the key, which the files for a real laboratory leave to whoever copies them."""
    if section.content(key) in (None, ""):
        raise ValueError("%s: '%s' is not written yet: write the address of %s there" % (section.where, key, whose))
    return _address(section.text(key), "%s, %s" % (section.where, key))


def _address(text, what):
    try:
        return str(ipaddress.IPv4Address(text))
    except ValueError as error:
        raise ValueError("%s must be an IPv4 address, found %r" % (what, text)) from error
