"""Vehicle types: the one source of each physical parameter of an airframe (nominal values).

Controllers, the vehicle node, the driver's launch file and the virtual lab read them here. A fleet file may override
some of them for a vehicle (`OVERRIDABLE`).
"""

import functools
import math
import pathlib
import typing
from dataclasses import dataclass, field

from risc_lab.lab.yaml_reader import config_files, load_yaml
from risc_lab.settings import Name, NotNegative, Positive, Settings, between, settings_from

DEFAULT_TYPE = "ardrone"  # that of the original: used where no type is named; distances are set for it
# Parameters of a type that a fleet file may override for a single vehicle.
OVERRIDABLE = (
    "mass_kg",
    "tilt_max_rad",
    "yaw_rate_max_rad_s",
    "climb_max_m_s",
    "climb_time_constant_s",
    "command_delay_s",
    "command_rate_hz",
    "battery_life_s",
)
FULL_SCALES = ("tilt_max_rad", "yaw_rate_max_rad_s", "climb_max_m_s")  # all that command a vehicle must agree on these
# Parameters of the original release -> (field, factor to its unit).
LEGACY_PARAMETERS = {
    "euler_angle_max": ("tilt_max_rad", 1.0),
    "control_yaw": ("yaw_rate_max_rad_s", 1.0),
    "control_vz_max": ("climb_max_m_s", 1e-3),
    "delay": ("climb_time_constant_s", 1.0),
    "command_delay": ("command_delay_s", 1.0),
}


@dataclass(frozen=True)
class AttitudeLoop(Settings):
    """On-board attitude loop of one axis: angle'' = wn^2 (gain * command - angle) - 2 zeta wn angle'."""

    natural_frequency_rad_s: between(0.1, 1000.0)
    damping_ratio: between(0.05, 5.0)
    gain: between(0.1, 10.0)  # [rad/rad] angle that is reached per commanded angle


@dataclass(frozen=True)
class Airframe(Settings):
    """A quadrotor in x configuration, as it is drawn."""

    arm_m: Positive  # from its centre to the axis of a rotor
    rotor_m: Positive  # diameter
    hull_m: tuple[Positive, Positive, Positive]  # length, width, height


@dataclass(frozen=True)
class VehicleType(Settings):
    """Nominal model of one type of vehicle."""

    name: Name
    mass_kg: Positive
    inertia_kg_m2: tuple[Positive, Positive, Positive]  # Jx, Jy, Jz; body axes
    radius_m: Positive  # how far hull and propellers reach from its centre: two vehicles touch at the sum of theirs
    roll: AttitudeLoop
    pitch: AttitudeLoop
    yaw_rate_time_constant_s: Positive  # r' = (command - r) / tau
    climb_time_constant_s: Positive  # zdot' = (command - zdot) / tau
    tilt_max_rad: between(0.01, 1.5)  # full scale of the roll and pitch commands
    yaw_rate_max_rad_s: Positive  # full scale of the yaw command
    climb_max_m_s: Positive  # full scale of the vertical command
    command_delay_s: between(0.0, 2.0)  # from sending a command to its effect on the vehicle
    command_rate_hz: between(1.0, 1000.0)  # how often the vehicle takes a command
    drag_n_s_m: NotNegative  # linear drag: force = -drag * airspeed
    battery_life_s: Positive  # full to empty in flight
    # limits of courses: this part of the full scales (the rest is for the controller), and this speed
    course_share: between(0.1, 1.0) = 0.8
    speed_max_m_s: Positive = 3.0
    report_delay_s: between(0.0, 2.0) = 0.0  # from its measurement to the subscribers of its driver
    video_latency_s: between(0.0, 2.0) = 0.0  # from the exposure of a picture to its arrival; 0 = unknown, or no camera
    # {link of its driver: what the driver opens at the vehicle's {address}}, unless the fleet file names another device
    devices: dict[str, Name] = field(default_factory=dict, hash=False)
    takes_thrust: bool = False  # its vertical command is a thrust (we control its height); else a climb rate
    own: dict[str, typing.Any] = field(default_factory=dict, hash=False)  # of this type alone, see `own_numbers`
    airframe: Airframe | None = None  # what it is drawn as; None: as an AR.Drone
    driver: str = ""  # type with the same driver, see launch/driver.launch; "" = it has its own
    # {controller: {key: value}} in place of values of the controller's YAML file
    controllers: dict[str, dict[str, float]] = field(default_factory=dict, hash=False)
    # {namespace: template} of those in the original laboratory, which are known without a fleet file
    laboratory: dict[str, Name] = field(default_factory=dict, hash=False)

    @property
    def wider_m(self):
        """How much farther it reaches than an AR.Drone, for which distances are set; 0 for one that reaches less."""
        return max(0.0, self.radius_m - _default_radius_m())


@functools.cache
def _default_radius_m():
    return load_vehicle_type(DEFAULT_TYPE).radius_m


def load_vehicle_type(name, overrides=()):
    """Vehicle type by name (see `risc_lab.registry`; the tree's are in risc_lab/config/vehicle_types), or by path.

    overrides: values in place of the type's, {field: value} or pairs.  Raises ValueError that names the file and the
    key, or the known types when there is no such type.
    """
    path = vehicle_type_file(name)
    return settings_from(VehicleType, {**load_yaml(path), **dict(overrides)}, str(path))


@functools.cache
def own_numbers(vehicle_type, kind):
    """`own` of a VehicleType as an instance of a dataclass of settings. Raises ValueError that names file and key."""
    return settings_from(kind, vehicle_type.own, "%s: own" % vehicle_type_file(vehicle_type.name))


def vehicle_type_file(name):
    """Path of a type's YAML file. Raises ValueError as `load_vehicle_type`."""
    if pathlib.Path(name).suffix == ".yaml":
        return pathlib.Path(name)
    known = config_files("vehicle_types", "risc_lab")
    if name not in known:
        raise ValueError("unknown vehicle type '%s'; known are: %s" % (name, ", ".join(sorted(known))))
    return known[name]


def disagreement(name, mine, theirs, whose):
    """Sentence on a difference between two sets of full scales of a vehicle; "" when there is none.

    mine, theirs: {field: value}, compared where both have one.  whose: holder of the second set.
    """
    for scale in FULL_SCALES:
        if scale in mine and scale in theirs and abs(theirs[scale] / mine[scale] - 1.0) > 0.01:
            return (
                "%s: %s is %.4g in the vehicle node, but %.4g in %s, so each command would be %.2f times the wanted "
                "one: set it once, in the vehicle's type or in the fleet file"
                % (name, scale, mine[scale], theirs[scale], whose, theirs[scale] / mine[scale])
            )
    return ""


def legacy_overrides(values):
    """{field: value} from the parameters of the original release in a dict; a negative one counts as not set.

    Raises ValueError for what is not a number.
    """
    found = {}
    for name, (key, factor) in LEGACY_PARAMETERS.items():
        try:
            value = factor * float(values.get(name, -1.0))
        except (TypeError, ValueError):
            value = math.nan
        if not math.isfinite(value) or isinstance(values.get(name), bool) or (value == 0.0 and name != "command_delay"):
            raise ValueError(
                "parameter %s must be a number > 0 (negative: the vehicle type's), found %r" % (name, values[name])
            )
        if value >= 0.0:
            found[key] = value
    return found
