"""Origin of a bag: the files that the flight's program wrote beside it, and the parameters of the flight."""

import contextlib
import hashlib
import json
import pathlib
from dataclasses import dataclass, field

import yaml

from data_extraction.command_line import fleet_of
from risc_control.fence import Fence
from risc_control.safety import SafetyLimits, fence_of
from risc_lab.lab import Fleet
from risc_lab.lab.fleet import fleet_from_dict
from risc_lab.settings import settings_from

FLIGHT, PARAMETERS = "flight.yaml", "parameters.yaml"
SUMMARY, LAB, PROCESSORS = "summary.json", "virtual_lab.json", "processors.json"
# Parameters that differ from run to run though the flight is the same: identities, addresses, and live switches.
RUN_KEYS = frozenset(
    (
        "run_id", "roslaunch", "joystick_buttons", "controller_status", "RESET", "host", "address", "drone_ip",
        "interface", "local_address", "command_port", "stream_port", "stream_group",
    )
)  # fmt: skip


@dataclass
class Origin:
    """What is known of a flight beside its bag; None or {} = nothing."""

    flight: dict = field(default_factory=dict)  # flight.yaml: arguments, seed, versions ...
    parameters: dict | None = None  # of the parameter server
    fleet: Fleet | None = None
    summary: dict = field(default_factory=dict)
    lab: dict = field(default_factory=dict)  # what the virtual lab counted
    processors: dict = field(default_factory=dict)  # processor time and memory of the programs

    @property
    def hash(self):
        """Hash of the parameters, None when they are unknown."""
        return None if self.parameters is None else parameter_hash(self.parameters)

    def command_delays_s(self):
        """{template: delay [s] of the vehicle's link}, as requested for the flight, else of the vehicle's type."""
        asked_s = self.flight.get("arguments", {}).get("delay")
        return {
            vehicle.template: vehicle.vehicle_type.command_delay_s if asked_s is None else asked_s
            for vehicle in (self.fleet.vehicles if self.fleet else ())
        }

    def fences(self):
        """{template: Fence} that the vehicles' nodes used; unknown ones are left out."""
        result = {}
        for vehicle in self.fleet.vehicles if self.fleet else ():
            for node in self._nodes_of(vehicle.namespace):
                names = {item: node[item] for item in node if item in SafetyLimits.__dataclass_fields__}
                if names:  # a vehicle node: launch files set at least its joystick_timeout, the others are defaults
                    limits = settings_from(SafetyLimits, {**fence_of(self.fleet.arena), **names})
                    result[vehicle.template] = Fence(limits, vehicle.vehicle_type)
        return result

    def _nodes_of(self, namespace):
        """Parameters of the nodes of a vehicle: those in its group, and those for several vehicles."""
        parameters = self.parameters or {}
        group = parameters.get(namespace)
        for node in group.values() if isinstance(group, dict) else ():
            if isinstance(node, dict):
                yield node
        for node in parameters.values():
            names = node.get("vehicles") if isinstance(node, dict) else None
            names = names.split() if isinstance(names, str) else names
            if isinstance(names, (list, dict)) and namespace in names:  # that of the virtual lab is a number
                yield node


def read_beside(bag_path, fleet_path=None):
    """Origin of a bag: the files in its folder. fleet_path: a fleet file instead of the one there.

    Without a fleet file, the fleet is that of the parameters.

    Raises ValueError that names a file that cannot be read.
    """
    bag_path = pathlib.Path(bag_path)
    folder = bag_path.parent
    flight = _mapping(folder / FLIGHT, ("arguments", "versions"))
    parameters = _mapping(folder / PARAMETERS) if (folder / PARAMETERS).exists() else None
    fleet = fleet_of(bag_path, fleet_path)
    if fleet is None and parameters and "fleet" in parameters:
        with contextlib.suppress(ValueError):  # of another revision: the report has no fleet then
            fleet = fleet_from_dict(parameters["fleet"])
    return Origin(
        flight={key: value for key, value in flight.items() if value is not None},
        parameters=parameters,
        fleet=fleet,
        summary=_mapping(folder / SUMMARY),
        lab=_mapping(folder / LAB),
        processors=_mapping(folder / PROCESSORS),
    )


def parameter_hash(parameters):
    """SHA-256, as hexadecimal text, of parameters (nested dicts) without those that differ from run to run.

    Of paths only the last part counts: another folder does not change the hash.
    """
    text = yaml.safe_dump(_canonical(parameters), sort_keys=True, default_flow_style=False, allow_unicode=True)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _canonical(value):
    if isinstance(value, dict):
        return {str(key): _canonical(item) for key, item in value.items() if key not in RUN_KEYS}
    if isinstance(value, (list, tuple)):
        return [_canonical(item) for item in value]
    if isinstance(value, str) and (value.startswith("/") or "://" in value):
        return value.rpartition("/")[2]
    return value


def _mapping(path, mappings=()):
    """Content of a YAML or JSON file that holds a mapping; {} when there is no such file.

    mappings: keys whose values must be mappings too, or be empty.
    """
    if not path.exists():
        return {}
    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
    except (OSError, UnicodeDecodeError, yaml.YAMLError, json.JSONDecodeError) as error:
        reason = "cannot be read (%s)" % " ".join(str(error).split())  # a parser's message has several lines
        raise ValueError("%s %s: fix it or move it away from the bag" % (path, reason)) from error
    if not isinstance(content, dict):
        raise ValueError("%s is not a YAML mapping: fix it or move it away from the bag" % path)
    for key in mappings:
        if not isinstance(content.get(key), (dict, type(None))):
            words = "%s: %s must be a mapping: fix it or move it away from the bag"
            raise ValueError(words % (path, key))
    return content
