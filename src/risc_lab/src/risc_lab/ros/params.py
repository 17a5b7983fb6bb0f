"""Parameter server -> dataclasses of settings. Every problem is one ValueError that names the parameter."""

from dataclasses import fields

import rospy

from risc_lab.lab.arena import Arena
from risc_lab.lab.fleet import fleet_from_dict, laboratory_vehicles
from risc_lab.lab.vehicle_types import FULL_SCALES, LEGACY_PARAMETERS, legacy_overrides, load_vehicle_type
from risc_lab.settings import settings_from

_ELSEWHERE = frozenset(("diagnostic_period", "full_scales"))  # of diagnostic_updater; of controllers, for other nodes
VEHICLE_KEYS = ("vehicle", "vehicles")  # what `vehicles` reads


def load_params(*kinds, known=(), lenient=False):
    """Private parameters of this node as instances of dataclasses. Unknown ones are logged as warnings.

    kinds, lenient: see `params_from_dict`.  known: names of others, which are read elsewhere; None: no warnings.
    """
    instances, unknown = params_from_dict(kinds, rospy.get_param("~", {}), lenient)
    for name in () if known is None else sorted(set(unknown).difference(known)):
        rospy.logwarn(
            "unknown parameter %s is ignored: check its spelling against the package's README and config folder",
            rospy.resolve_name("~" + name),
        )
    for params in instances:
        rospy.loginfo("%s", params)
    return instances


def params_from_dict(kinds, values, lenient=False):
    """Fill dataclasses from one flat dict: returns (list of instances, sorted names of unknown keys).

    kinds: dataclasses, or instances of some whose values are the defaults.  lenient: accept, as old launch files
    have them, strings that hold a number or a truth value, and 0 and 1 for false and true.  Raises ValueError naming
    the key, see `risc_lab.settings`.
    """
    instances, known = [], _ELSEWHERE
    for kind in kinds:
        names = {item.name for item in fields(kind)}
        told = {name: values[name] for name in names if name in values}
        if not isinstance(kind, type):
            kind, told = type(kind), {**vars(kind), **told}
        instances.append(settings_from(kind, told, "parameters", lenient))
        known = known | names
    return instances, sorted(set(values) - known)


def tf_frame(name):
    """Name of a tf frame with the parameter tf_prefix before it, as tf 1 did: found upwards from the node's namespace.

    A name that begins with a slash gets no prefix. The result has no slash at the beginning.
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


def told_vehicle_type(vehicle, private):
    """VehicleType of a FleetVehicle for this node: its type, overridden by the fleet file, then by the original
    release's parameters (`LEGACY_PARAMETERS`): global ones (full scales only), then private ones.

    private: the private parameters.  Raises ValueError.
    """
    everywhere = {
        name: rospy.get_param("/" + name)
        for name, (field, _) in LEGACY_PARAMETERS.items()
        if field in FULL_SCALES and rospy.has_param("/" + name)
    }
    overrides = {**dict(vehicle.overrides), **legacy_overrides(everywhere), **legacy_overrides(private)}
    return load_vehicle_type(vehicle.type, overrides)


def vehicles(only_one=False, kind=""):
    """FleetVehicles that a node is for: ~vehicles (templates or namespaces), else the whole /fleet.

    Without a fleet the original laboratory's names are known. only_one: ~vehicle, else the first.  kind: only those of
    this type or with its driver; "" = of any.  Raises ValueError when there is none.
    """
    known = fleet_vehicles() or laboratory_vehicles(kind)
    if kind:
        known = tuple(vehicle for vehicle in known if kind in (vehicle.type, vehicle.vehicle_type.driver))
        if not known:
            raise ValueError("no vehicle of the fleet is of type '%s': load another fleet file into /fleet" % kind)
    wanted = rospy.get_param("~vehicle" if only_one else "~vehicles", "")
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
