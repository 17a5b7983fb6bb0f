"""Parameters of the drawing nodes: from the parameter server into frozen dataclasses, strictly."""

from dataclasses import dataclass, fields
from typing import Tuple

import rospy

from risc_control.lab.fleet import fleet_from_dict

_IGNORED = ("diagnostic_period",)  # read by diagnostic_updater


@dataclass(frozen=True)
class ArenaParams:
    """Settings of draw_risc_maap; config/draw_risc_maap.yaml explains and holds the same values."""

    arena_file: str = ""
    refresh_hz: float = 1.0

    def __post_init__(self):
        _check_positive(self, "refresh_hz")


@dataclass(frozen=True)
class CortexParams:
    """Settings of draw_cortex; config/draw_cortex.yaml explains and holds the same values."""

    rate_hz: float = 25.0
    status_hz: float = 2.0
    lifetime_s: float = 1.0
    label_alpha: float = 0.8
    templates_file: str = ""
    vehicles: Tuple[str, ...] = ()

    def __post_init__(self):
        _check_positive(self, "rate_hz", "status_hz", "lifetime_s", "label_alpha")


@dataclass(frozen=True)
class TrajectoryParams:
    """Settings of draw_trajectories; config/draw_trajectories.yaml explains and holds the same values."""

    rate_hz: float = 25.0
    actual_s: float = 10.0
    desired_s: float = 40.0
    step_m: float = 0.02
    jump_m: float = 0.5
    gap_s: float = 0.5
    away_m: float = 0.4
    title: str = ""
    vehicles: Tuple[str, ...] = ()

    def __post_init__(self):
        _check_positive(self, "rate_hz", "away_m")


def params_from_dict(params_class, values):
    """Fill a dataclass from a dict: returns (instance, sorted names of unknown keys).

    A key that is absent leaves the default. Raises ValueError naming the key for a value of the wrong type, or
    what the dataclass itself raises for one out of range.
    """
    known = {item.name: item.default for item in fields(params_class)}
    chosen = {key: _converted(key, values[key], known[key]) for key in values if key in known}
    return params_class(**chosen), sorted(set(values) - set(known) - set(_IGNORED))


def load_params(params_class):
    """Private parameters of this node as an instance of the dataclass. Unknown keys are logged as warnings."""
    params, unknown = params_from_dict(params_class, rospy.get_param("~", {}))
    for key in unknown:
        rospy.logwarn("unknown parameter %s is ignored: is it misspelt?", rospy.resolve_name("~" + key))
    return params


def load_fleet_vehicles():
    """Vehicles of the parameter /fleet (`risc_control.lab.FleetVehicle`), () if there is none. Raises ValueError."""
    content = rospy.get_param("/fleet", None)
    return () if content is None else fleet_from_dict(content, "parameter /fleet").vehicles


def _check_positive(params, *keys):
    for key in keys:
        if not getattr(params, key) > 0.0:
            raise ValueError("parameter '%s' must be positive, got %r" % (key, getattr(params, key)))


def _converted(key, value, default):
    if isinstance(default, tuple):
        if isinstance(value, (list, tuple)) and all(isinstance(item, str) for item in value):
            return tuple(value)
        wanted = "a list of names"
    elif isinstance(default, str):
        if isinstance(value, str):
            return value
        wanted = "a text"
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    else:
        wanted = "a number"
    raise ValueError("parameter '%s' must be %s, got %r" % (key, wanted, value))
