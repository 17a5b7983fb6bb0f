"""A launch file with <machine> tags, read with roslaunch's own loader: which computers it needs and what for."""

import os
import posixpath
import re
import shlex
from dataclasses import dataclass

import roslaunch
from roslaunch.arg_dump import get_args
from roslaunch.core import RLException, is_machine_local

from ardrone_autonomy.protocol import DEFAULT_ADDRESS

_VIRTUAL_LAB = (
    "virtual_lab"  # node types that begin like this bring vehicles and Cortex, which exist only while it runs
)
_RECORDERS = ("data_extraction", "recorder"), ("rosbag", "record")
_BAG_OPTIONS = "-O", "--output-name", "-o", "--output-prefix"  # of rosbag record


class ExperimentError(Exception):
    """The experiment cannot be used; the text says why and what to do."""


@dataclass(frozen=True)
class Computer:
    """One <machine> tag, and what the nodes that run there need."""

    name: str
    address: str
    port: int = 22
    user: str = None  # None: the login of the person who launches, or what ~/.ssh/config says
    password: str = None
    env_loader: str = None
    timeout_s: float = 10.0  # that roslaunch waits for it
    local: bool = False  # this computer: roslaunch needs no ssh for it
    unresolved: str = ""  # the address, when it cannot be resolved; else ""
    nodes: int = 0  # how many run there
    joysticks: tuple = ()  # devices of its joy_nodes
    vehicles: tuple = ()  # addresses of the vehicles that its drivers fly
    cortex: tuple = ()  # addresses of the Cortex hosts that its stream_markers asks
    bag_folder: str = ""  # of the bag that is recorded there; "" = none is, or the file's path is not absolute
    fleet: str = ""  # the fleet file, a path of this computer; "" = the launch file names none

    @property
    def login(self):
        """Login as typed for ssh."""
        return self.address if self.user is None else "%s@%s" % (self.user, self.address)

    @property
    def needs_login(self):
        """Whether roslaunch goes there by ssh."""
        return self.nodes > 0 and not self.local and not self.unresolved

    @property
    def loader_file(self):
        """The env-loader's file, without an "env VARIABLE=VALUE" before it."""
        return shlex.split(self.env_loader)[-1]

    @property
    def workspace(self):
        """Folder of the workspace there: the env-loader lies in its devel or install folder."""
        return posixpath.dirname(posixpath.dirname(self.loader_file))


@dataclass(frozen=True)
class Experiment:
    """A launch file with its arguments, and the computers in the order of the file."""

    path: str
    arguments: tuple  # "NAME:=VALUE"
    computers: tuple


def load_experiment(path, arguments=(), only=None):
    """Read a launch file. Raises ExperimentError.

    arguments: texts "NAME:=VALUE".  only: names of the computers that matter, "risc2,risc3"; None = all of them.
    """
    if not os.path.isfile(path):
        raise ExperimentError("there is no launch file %s" % path)
    try:
        known = get_args([path])
        for name in (argument.partition(":=")[0] for argument in arguments):
            if name not in known:  # roslaunch ignores these: a misspelt address would go unnoticed
                raise ExperimentError("%s has no argument %s: it has %s" % (path, name, ", ".join(sorted(known))))
        config = roslaunch.config.ROSLaunchConfig()
        loader = roslaunch.xmlloader.XmlLoader()
        loader.ignore_unset_args = False  # roslaunch has no default for it here
        loader.load(path, config, argv=list(arguments), verbose=False)
        if config.config_errors:
            raise RLException(config.config_errors[0])
    except (RLException, roslaunch.xmlloader.XmlParseException) as problem:
        raise ExperimentError("roslaunch cannot read %s: %s" % (path, " ".join(str(problem).split()))) from None
    machines = {name: machine for name, machine in config.machines.items() if name}
    if not machines:
        raise ExperimentError("%s has no <machine> tags: all of it runs on this computer (./maap doctor)" % path)
    for node in config.nodes:
        if node.machine_name and node.machine_name not in machines:
            raise ExperimentError("%s: node %s is for machine %s, which no <machine> tag declares"
                                  % (path, node.name, node.machine_name))  # fmt: skip
    for name in only.split(",") if only else ():
        if name not in machines:
            raise ExperimentError("%s has no machine %s: it has %s" % (path, name, ", ".join(machines)))
    fleet = loader.root_context.resolve_dict.get("arg", {}).get("fleet", "")
    wanted = [machine for name, machine in machines.items() if not only or name in only.split(",")]
    computers = tuple(_computer(machine, config, fleet) for machine in wanted)
    return Experiment(path, tuple(arguments), computers)


def _computer(machine, config, fleet):
    nodes = [node for node in config.nodes if node.machine_name == machine.name]
    lab = any(node.type.startswith(_VIRTUAL_LAB) for node in config.nodes)
    local, unresolved, joysticks, vehicles, cortex, bags = False, "", [], [], [], []
    try:
        local = is_machine_local(machine)
    except RLException:
        unresolved = machine.address
    for node in nodes:
        own = _parameters(config, node)
        if node.type == "joy_node":
            joysticks.append(own.get("dev"))
        elif node.type == "ardrone_driver" and not lab:
            each = [value for key, value in own.items() if re.fullmatch("(vehicles/.*/)?drone_ip", key)]
            vehicles += each or [DEFAULT_ADDRESS]
        elif node.type == "stream_markers" and not lab:
            cortex.append(own.get("host"))
        elif (node.package, node.type) in _RECORDERS:
            bags.append(_bag_folder(node.args))
    return Computer(
        name=machine.name,
        address=machine.address,
        port=machine.ssh_port,
        user=machine.user,
        password=machine.password,
        env_loader=machine.env_loader and posixpath.normpath(machine.env_loader),
        timeout_s=machine.timeout,
        local=local,
        unresolved=unresolved,
        nodes=len(nodes),
        joysticks=_different(joysticks),
        vehicles=_different(vehicles),
        cortex=_different(cortex),
        bag_folder=next(filter(None, bags), ""),
        fleet=fleet,
    )


def _different(values):
    """Non-empty values as texts, without duplicates."""
    return tuple(dict.fromkeys(str(value) for value in values if value))


def _parameters(config, node):
    """{name: value} of a node's own parameters; those of ~mocap count as its own."""
    prefix = node.namespace + node.name + "/"
    values = {key[len(prefix) :]: param.value for key, param in config.params.items() if key.startswith(prefix)}
    return {**values.get("mocap", {}), **values}


def _bag_folder(arguments):
    """Folder that `rosbag record` with these arguments writes to, "" when they do not say it."""
    try:
        words = shlex.split(arguments)
    except ValueError:  # an open quotation mark: roslaunch will say so
        return ""
    for option, value in zip(words, words[1:]):
        if option in _BAG_OPTIONS and posixpath.isabs(value):
            return posixpath.dirname(posixpath.normpath(value))
    return ""
