"""Parameter server -> values. Every problem is one ValueError that names the parameter.

A node either loads dataclasses that hold all its settings (`load_params`), or asks for one parameter after the other
(`private`, `number`, ...) and then calls `warn_of_unknown`. Either way a misspelt parameter is told.
"""

import math
from dataclasses import fields

import rospy

from risc_lab.lab.arena import Arena
from risc_lab.lab.fleet import fleet_from_dict, laboratory_vehicles
from risc_lab.lab.vehicle_types import FULL_SCALES, LEGACY_PARAMETERS, legacy_overrides, load_vehicle_type
from risc_lab.settings import settings_from

_ELSEWHERE = frozenset(("diagnostic_period", "full_scales"))  # for diagnostic_updater, and from controllers to others
_asked = set()  # private parameters that this process has asked for


def private(name, default):
    """Value of the private parameter."""
    _asked.add(name)
    return rospy.get_param("~" + name, default)


def has_private(name):
    """Whether the private parameter is set."""
    _asked.add(name)
    return rospy.has_param("~" + name)


def warn_of_unknown():
    """Log every private parameter that nothing in this process has asked for."""
    _warn(sorted(set(rospy.get_param("~", {})) - _asked - _ELSEWHERE))


def load_params(*classes, known=(), lenient=False):
    """Private parameters of this node as instances of the dataclasses. Unknown ones are logged as warnings.

    known: names of others, which are read elsewhere.  lenient: see `params_from_dict`.
    """
    instances, unknown = params_from_dict(classes, rospy.get_param("~", {}), lenient)
    _warn([name for name in unknown if name not in known])
    for params in instances:
        rospy.loginfo("%s", params)
    return instances


def params_from_dict(classes, values, lenient=False):
    """Fill dataclasses from one flat dict: returns (list of instances, sorted names of unknown keys).

    A key that is absent leaves the default. lenient: as launch files of old have it, texts that hold a number or a
    truth value, and 0 and 1 for false and true. Raises ValueError naming the key, see `risc_lab.settings`.
    """
    names = [{item.name for item in fields(kind)} for kind in classes]
    instances = [
        settings_from(kind, {key: values[key] for key in known if key in values}, "parameters", lenient)
        for kind, known in zip(classes, names, strict=True)
    ]
    return instances, sorted(set(values) - _ELSEWHERE.union(*names))


def tf_frame(name):
    """Name of a tf frame with the parameter tf_prefix before it, as tf 1 did: found upwards from the node's namespace.

    A name that begins with a slash has none. No slash comes out at the beginning.
    """
    key = None if name.startswith("/") else rospy.search_param("tf_prefix")
    prefix = str(rospy.get_param(key)) if key else ""
    return "/".join(part for part in (prefix.strip("/"), name.lstrip("/")) if part)


def known_fleet():
    """Fleet of the parameter /fleet, None if there is none. Raises ValueError if it is malformed."""
    content = rospy.get_param("/fleet", None)
    return None if content is None else fleet_from_dict(content, "parameter /fleet")


def fleet_vehicles():
    """FleetVehicles of the parameter /fleet, () if there is none. Raises ValueError if it is malformed."""
    fleet = known_fleet()
    return () if fleet is None else fleet.vehicles


def known_arena():
    """Arena of the parameter /fleet, the laboratory's if there is none. Raises ValueError if it is malformed."""
    fleet = known_fleet()
    return Arena() if fleet is None else fleet.arena


def _warn(unknown):
    for name in unknown:
        rospy.logwarn(
            "unknown parameter %s is ignored: check its spelling against the package's README and config folder",
            rospy.resolve_name("~" + name),
        )


def number(name, default):
    """A finite number; texts that hold one count, since launch files may pass texts. "~name" is private."""
    value = private(name[1:], default) if name.startswith("~") else rospy.get_param(name, default)
    try:
        if isinstance(value, bool):
            raise ValueError
        result = float(value)
        if not math.isfinite(result):
            raise ValueError
    except (TypeError, ValueError):
        raise ValueError("parameter %s must be a number, found %r" % (rospy.resolve_name(name), value)) from None
    return result


def dataclass_from_params(kind, defaults=None):
    """An instance of a dataclass of numbers: private parameters by the names of its fields.

    defaults: another instance to take the others from.
    """
    values = {item.name: getattr(defaults, item.name) if defaults else item.default for item in fields(kind)}
    return kind(**{name: number("~" + name, value) for name, value in values.items()})


def told_vehicle_type(vehicle, private_values=None):
    """VehicleType of a FleetVehicle as this node is told: of its type, then fleet file, then the original release's
    parameters (`LEGACY_PARAMETERS`), the full scales also as global ones, then private ones.

    private_values: the private parameters if they are read already.  Raises ValueError.
    """
    if private_values is None:
        private_values = {name: private(name, -1.0) for name in LEGACY_PARAMETERS}
    everywhere = {
        name: rospy.get_param("/" + name)
        for name, (field, _) in LEGACY_PARAMETERS.items()
        if field in FULL_SCALES and rospy.has_param("/" + name)
    }
    overrides = {**dict(vehicle.overrides), **legacy_overrides(everywhere), **legacy_overrides(private_values)}
    return load_vehicle_type(vehicle.type, overrides)


def vehicles(only_one=False):
    """FleetVehicles that a node is for: ~vehicles (templates or namespaces), else the whole /fleet.

    Without a fleet the original laboratory's names are known. only_one: ~vehicle, else the first.
    """
    known = fleet_vehicles() or laboratory_vehicles()
    wanted = private("vehicle" if only_one else "vehicles", "")
    wanted = wanted.split() if isinstance(wanted, str) else wanted
    if not isinstance(wanted, list) or not all(isinstance(name, str) for name in wanted):
        raise ValueError("parameter %s must be a list of names, found %r" % (rospy.resolve_name("~vehicles"), wanted))
    if not wanted:
        return known[:1] if only_one else known
    by_name = {vehicle.namespace: vehicle for vehicle in known}
    by_name.update({vehicle.template: vehicle for vehicle in known})
    unknown = [name for name in wanted if name not in by_name]
    if unknown:
        raise ValueError(
            "no vehicle %s; known are %s: load a fleet file into /fleet, or correct the name"
            % (", ".join(unknown), ", ".join("%s (%s)" % (v.template, v.namespace) for v in known))
        )
    return tuple(by_name[name] for name in wanted)
