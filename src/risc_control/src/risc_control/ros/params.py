"""Parameter server -> values. Every problem is one ValueError that names the parameter."""

import math
from dataclasses import fields

import rospy

from risc_control.lab.fleet import FleetVehicle, fleet_from_dict
from risc_control.vehicle_pilot import LEGACY_VEHICLES


def number(name, default):
    """A finite number; texts that hold one count, since launch files may pass texts."""
    value = rospy.get_param(name, default)
    try:
        if isinstance(value, bool):
            raise ValueError
        result = float(value)
        if not math.isfinite(result):
            raise ValueError
    except (TypeError, ValueError):
        raise ValueError("parameter %s must be a number, found %r" % (rospy.resolve_name(name), value)) from None
    return result


def dataclass_from_params(kind, aliases=None, defaults=None, **given):
    """An instance of a dataclass of numbers: private parameters by the names of its fields, its defaults else.

    aliases: dict field -> name of the parameter, where that differs.  defaults: another instance to take them from.
    given: values of fields that are no parameters.
    """
    aliases = aliases or {}
    values = {
        field.name: number(
            "~" + aliases.get(field.name, field.name), getattr(defaults, field.name) if defaults else field.default
        )
        for field in fields(kind)
        if field.name not in given
    }
    return kind(**values, **given)


def limit(name, scale=1.0):
    """A limit under its legacy name: private, then global; -1 when it is not set (meaning: the vehicle type's)."""
    for where in ("~" + name, "/" + name):
        if rospy.has_param(where):
            return scale * number(where, None)
    return -1.0


def vehicles(only_one=False):
    """FleetVehicles that a node is for: ~vehicles (templates or namespaces), else the whole /fleet.

    Without a fleet the original laboratory's names are known. only_one: ~vehicle, else the first.
    """
    fleet = rospy.get_param("/fleet", None)
    if fleet is not None:
        known = fleet_from_dict(fleet, "parameter /fleet").vehicles
    else:
        known = tuple(
            FleetVehicle(namespace, template, "ardrone", "0.0.0.0", "", (0.0, 0.0, 0.0), 0.0)
            for namespace, template in LEGACY_VEHICLES.items()
        )
    wanted = rospy.get_param("~vehicle", "") if only_one else rospy.get_param("~vehicles", "")
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
