"""Vehicle types: what controllers and the virtual lab know of an airframe (nominal values)."""

import pathlib
from dataclasses import dataclass

from risc_lab.lab.yaml_reader import Section, load_yaml, package_file


@dataclass(frozen=True)
class AttitudeLoop:
    """On-board attitude loop of one axis: angle'' = wn^2 (gain * command - angle) - 2 zeta wn angle'."""

    natural_frequency_rad_s: float
    damping_ratio: float
    gain: float  # [rad/rad] angle that is reached per commanded angle


@dataclass(frozen=True)
class VehicleType:
    """Nominal model of one type of vehicle."""

    name: str
    mass_kg: float
    inertia_kg_m2: tuple[float, float, float]  # Jx, Jy, Jz; body axes
    roll: AttitudeLoop
    pitch: AttitudeLoop
    yaw_rate_time_constant_s: float  # r' = (command - r) / tau
    climb_time_constant_s: float  # zdot' = (command - zdot) / tau
    tilt_max_rad: float  # full scale of the roll and pitch commands
    yaw_rate_max_rad_s: float  # full scale of the yaw command
    climb_max_m_s: float  # full scale of the vertical command
    command_delay_s: float  # from sending a command to its effect on the vehicle
    command_rate_hz: float  # how often the vehicle takes a command
    drag_n_s_m: float  # linear drag: force = -drag * airspeed
    battery_life_s: float  # full to empty in flight
    video_latency_s: float = 0.0  # from the exposure of a picture to its arrival; 0 = unknown, or no camera


def load_vehicle_type(name):
    """Vehicle type by name (a file in risc_lab/config/vehicle_types) or by the path of a YAML file.

    Raises ValueError that names the file and the key, or the known types when there is no such type.
    """
    path = pathlib.Path(name)
    if path.suffix != ".yaml":
        folder = package_file("risc_lab", "config/vehicle_types")
        path = folder / (name + ".yaml")
        if not path.exists():
            known = ", ".join(sorted(p.stem for p in folder.glob("*.yaml")))
            raise ValueError("unknown vehicle type '%s'; known are: %s" % (name, known))
    return vehicle_type_from_dict(load_yaml(path), str(path))


def vehicle_type_from_dict(content, where="vehicle type"):
    """VehicleType from the content of its YAML file. Raises ValueError."""
    root = Section(content, where)
    vehicle_type = VehicleType(
        name=root.text("name"),
        mass_kg=root.number("mass_kg", minimum=1e-3),
        inertia_kg_m2=root.vector("inertia_kg_m2", 3),
        roll=_attitude_loop(root.section("roll")),
        pitch=_attitude_loop(root.section("pitch")),
        yaw_rate_time_constant_s=root.number("yaw_rate_time_constant_s", minimum=1e-3),
        climb_time_constant_s=root.number("climb_time_constant_s", minimum=1e-3),
        tilt_max_rad=root.number("tilt_max_rad", minimum=0.01, maximum=1.5),
        yaw_rate_max_rad_s=root.number("yaw_rate_max_rad_s", minimum=0.01),
        climb_max_m_s=root.number("climb_max_m_s", minimum=0.01),
        command_delay_s=root.number("command_delay_s", minimum=0.0, maximum=2.0),
        command_rate_hz=root.number("command_rate_hz", minimum=1.0, maximum=1000.0),
        drag_n_s_m=root.number("drag_n_s_m", minimum=0.0),
        battery_life_s=root.number("battery_life_s", minimum=1.0),
        video_latency_s=root.number("video_latency_s", 0.0, 0.0, 2.0),
    )
    root.done()
    if min(vehicle_type.inertia_kg_m2) <= 0.0:
        raise ValueError("%s: 'inertia_kg_m2' must be positive, found %r" % (where, vehicle_type.inertia_kg_m2))
    return vehicle_type


def _attitude_loop(section):
    loop = AttitudeLoop(
        natural_frequency_rad_s=section.number("natural_frequency_rad_s", minimum=0.1, maximum=1000.0),
        damping_ratio=section.number("damping_ratio", minimum=0.05, maximum=5.0),
        gain=section.number("gain", minimum=0.1, maximum=10.0),
    )
    section.done()
    return loop
