"""Parameters of a node: from the parameter server into frozen dataclasses, strictly."""

from dataclasses import dataclass, fields
from typing import Tuple

import rospy

from risc_control.lab.fleet import fleet_from_dict

_IGNORED = ("diagnostic_period",)  # read by diagnostic_updater


@dataclass(frozen=True)
class NodeParams:
    """Settings of the node around the estimator; config/states_estimation.yaml explains and holds the same values."""

    vehicles: Tuple[str, ...] = ()  # vehicles that are listed before they are seen; empty = those of /fleet
    templates_file: str = ""  # marker templates; empty = config/templates.yaml of this package
    silence_s: float = 0.1  # [s] without frames before everything is declared invisible; 0 = never
    queue_frames: int = 400  # frames that may wait while the node is held up: 2 s at 200 Hz

    def __post_init__(self):
        if self.silence_s < 0.0:
            raise ValueError("silence_s must be 0 (off) or positive, got %r" % (self.silence_s,))
        if self.queue_frames < 1:
            raise ValueError("queue_frames must be at least 1, got %r" % (self.queue_frames,))


def params_from_dict(classes, values):
    """Fill dataclasses from one flat dict: returns (list of instances, sorted names of unknown keys).

    A key that is absent leaves the default. Raises ValueError naming the key for a value of the wrong type, or
    what the dataclass itself raises for one out of range.
    """
    known = set()
    instances = []
    for params_class in classes:
        chosen = {}
        for item in fields(params_class):
            known.add(item.name)
            if item.name in values:
                chosen[item.name] = _converted(item.name, values[item.name], item.default)
        instances.append(params_class(**chosen))
    return instances, sorted(set(values) - known - set(_IGNORED))


def load_params(*classes):
    """Private parameters of this node as instances of the dataclasses. Unknown keys are logged as warnings."""
    instances, unknown = params_from_dict(classes, rospy.get_param("~", {}))
    for key in unknown:
        rospy.logwarn(
            "unknown parameter %s is ignored: check its spelling against the package's config folder",
            rospy.resolve_name("~" + key),
        )
    for params in instances:
        rospy.loginfo("%s", params)
    return instances


def fleet_vehicles():
    """Template names of the vehicles of the parameter /fleet, () if there is none. Raises ValueError if malformed."""
    content = rospy.get_param("/fleet", None)
    if content is None:
        return ()
    return tuple(vehicle.template for vehicle in fleet_from_dict(content, "parameter /fleet").vehicles)


def _converted(key, value, default):
    if isinstance(default, tuple):
        if isinstance(value, (list, tuple)) and all(isinstance(item, str) for item in value):
            return tuple(value)
        wanted = "a list of names"
    elif isinstance(default, (bool, str)):
        if isinstance(value, type(default)):
            return value
        wanted = "true or false" if isinstance(default, bool) else "a text"
    elif isinstance(value, bool) or not isinstance(value, (int, float)):
        wanted = "a number"
    elif isinstance(default, float):
        return float(value)
    elif value == int(value):
        return int(value)
    else:
        wanted = "a whole number"
    raise ValueError("parameter '%s' must be %s, got %r" % (key, wanted, value))
