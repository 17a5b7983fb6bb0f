"""Finds the programs of a running flight by their role, and kills, stops and continues them.

They are found among the processes, not by the ROS master: it may itself be dead, and a program that hangs does not
answer. A program that was started again is another process: look it up again.
"""

import contextlib
import signal
import time
from dataclasses import dataclass

import psutil

from risc_control.vehicles import driver_nodes
from risc_lab.ros.launching import argument_of, marked_processes, program_of

_ROLES = {  # beside those of the drivers
    "mocap_client": ("stream_markers",),
    "states_estimation": ("states_estimation",),
    "controller": ("controller",),
    "trajectory": ("trajectory_node", "trajectory"),
    "vehicle_node": ("joystick_controller",),
    "joystick": ("joy_node", "operator"),
    "recorder": ("bagger",),
    "master": ("rosmaster",),
}


def roles():
    """{role: names, without a namespace, of the nodes that may have it; the first that runs counts}."""
    return {**_ROLES, **driver_nodes()}


@dataclass
class Program:
    """One process of a flight. Signals to one that has ended have no effect."""

    role: str  # one of roles(), or the node's name
    node: str  # with its namespace, e.g. /risc1/apm/roscopter; of the master /rosmaster
    process: psutil.Process
    killed: bool = False

    def kill(self):
        """End it at once (SIGKILL)."""
        self.killed = True
        self._signal(signal.SIGKILL)

    def stop(self):
        """Make it hang (SIGSTOP)."""
        self._signal(signal.SIGSTOP)

    def resume(self):
        """Let it continue (SIGCONT)."""
        self._signal(signal.SIGCONT)

    def _signal(self, number):
        with contextlib.suppress(psutil.NoSuchProcess):
            self.process.send_signal(number)

    @property
    def age_s(self):
        """How long ago it was started [s]."""
        return time.clock_gettime(time.CLOCK_BOOTTIME) - (self.process.create_time() - psutil.boot_time())


def programs(identity):
    """[Program] of the flight with an identity (`launching.Launch`), by their nodes' names."""
    role_of = {node: role for role, nodes in roles().items() for node in nodes}
    found = []
    for pid in marked_processes(identity):
        with contextlib.suppress(psutil.Error):  # it has ended meanwhile
            process = psutil.Process(pid)
            words, space = process.cmdline(), process.environ().get("ROS_NAMESPACE", "").strip("/")
            name = argument_of(words, "__name") or (program_of(words) if program_of(words) in role_of else "")
            if name:
                node = "/".join(["", *filter(None, (space, name))])
                found.append(Program(role_of.get(name, name), node, process))
    return sorted(found, key=lambda program: program.node)


def successor(identity, program):
    """The Program that replaces one that has ended, as the same node; None when none was started yet."""
    same = (other for other in programs(identity) if other.node == program.node)
    return next((other for other in same if other.process != program.process), None)


def find(identity, name, vehicle=""):
    """Find a Program of a flight. Raises LookupError, which lists the programs that run.

    name: one of roles(), or a node's name.  vehicle: namespace; of several programs that vehicle's is chosen, or else
    the one that is for all.
    """
    running = programs(identity)
    fitting = [program for program in running if name in (program.role, program.node, program.node.rpartition("/")[2])]
    known = roles()
    if name in known:
        order = {node: k for k, node in enumerate(known[name])}
        fitting.sort(key=lambda program: order[program.node.rpartition("/")[2]])
    its = [program for program in fitting if vehicle and program.node.startswith("/%s/" % vehicle)]
    shared = [program for program in fitting if program.node.count("/") == 1]
    for program in its or shared or ([] if vehicle else fitting):
        return program
    played = {program.role for program in running}
    there = [role for role in known if role in played] + sorted(played - set(known))
    text = "no program '%s' is part of this flight; there are %s"
    raise LookupError(text % (name, ", ".join(there) or "none"))
