"""Input of the checks: the fleet, this computer, and results that are read once and shared by several checks."""

import contextlib
import functools
import os
import pathlib
import threading
from dataclasses import dataclass, replace

from risc_doctor import cortex_probe, interfaces, ros_graph
from risc_doctor.ros_master import DEFAULT_URI, Master, MasterError, NobodyThereError
from risc_lab.lab import Fleet, fleet_from_dict, load_fleet, load_templates

# of the virtual lab: nothing is sent to computers that the user did not name
DEFAULT_FLEET = "launch/fleets/ardrones3.yaml"


def once(function):
    """Make a function without arguments run only at its first call; other threads wait, and all get its result."""
    lock, work = threading.Lock(), functools.cache(function)

    def result():
        with lock:
            return work()

    return result


@dataclass
class Situation:
    """Where and for what the doctor was called. templates, interfaces, cortex, graph: functions, see `once`."""

    fleet: Fleet
    fleet_source: str  # where the fleet was read, for people
    root: pathlib.Path  # of the workspace
    environment: dict
    master: object = None  # ros_master.Master, None when none answers
    master_error: str = ""  # why not
    nobody_there: bool = False  # True: no program has its port; False: a master may run
    bag_folder: pathlib.Path = None  # None = where flights go
    joysticks: tuple[str, ...] = ()  # devices; () = all that are there
    wanted: tuple[str, ...] = ()  # namespaces or addresses of vehicles; () = all of the fleet
    live: bool = False  # ask Cortex for its live mode

    def __post_init__(self):
        self.templates = once(lambda: load_templates(None, self.fleet))
        self.interfaces = once(interfaces.read_interfaces)
        self.cortex = once(lambda: cortex_probe.probe(self.fleet.mocap, self.live))
        self.graph = once(lambda: ros_graph.listen(self.master, self.fleet))

    @property
    def simulated(self):
        """True when everything of the fleet is on this computer: the virtual lab."""
        if any(vehicle.devices for vehicle in self.fleet.vehicles):
            return False
        return all(map(interfaces.is_loopback, [self.fleet.mocap.host] + [v.address for v in self.fleet.vehicles]))

    def vehicles(self):
        """The vehicles to be checked. Raises ValueError for one that the fleet does not have."""
        return tuple(map(self._vehicle, self.wanted)) or self.fleet.vehicles

    def _vehicle(self, word):
        """The fleet's vehicle of this name or address; an address that several share gives a vehicle, too."""
        at_address = [vehicle for vehicle in self.fleet.vehicles if vehicle.address == word]
        for vehicle in self.fleet.vehicles:
            if word in (vehicle.namespace, vehicle.template) or [vehicle] == at_address:
                return vehicle
        try:
            return replace(self.fleet.vehicles[0], namespace="", template=word, address=word, devices={})
        except ValueError:
            known = ", ".join("%s (%s)" % (v.namespace, v.place) for v in self.fleet.vehicles)
            raise ValueError("--vehicle: the fleet has no '%s', it has %s" % (word, known)) from None


def workspace_root(environment):
    """The workspace's folder: that of the `maap` that runs, else the sourced one."""
    spaces = environment.get("CMAKE_PREFIX_PATH", "").split(os.pathsep)
    for folder in filter(None, [environment.get("RISC_MAAP_ROOT"), *map(os.path.dirname, spaces)]):
        if os.path.isdir(os.path.join(folder, "launch", "fleets")):
            return pathlib.Path(folder).resolve()
    return pathlib.Path.cwd()


def look_around(fleet_path, environment, **options):
    """The Situation. fleet_path: None = the fleet of the running graph, else the virtual lab's. Raises ValueError."""
    root, content = workspace_root(environment), None
    try:
        options["master"] = master = Master(environment.get("ROS_MASTER_URI") or DEFAULT_URI)
        if fleet_path is None:
            with contextlib.suppress(MasterError):  # it has just ended
                content = master.parameter("/fleet")
    except MasterError as problem:
        options |= {"master_error": str(problem), "nobody_there": isinstance(problem, NobodyThereError)}
    if content is not None:
        fleet, source = fleet_from_dict(content, "parameter /fleet"), "/fleet of the running graph (%s)" % master.uri
    else:
        fleet, source = load_fleet(fleet_path or root / DEFAULT_FLEET), str(fleet_path or DEFAULT_FLEET)
    return Situation(fleet, source, root, environment, **options)
