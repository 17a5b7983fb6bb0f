"""Serial lines: what the nodes that serve them say is wrong, who else has the device open, and devices of the fleet."""

import os

from risc_doctor.findings import Findings
from risc_doctor.socket_owners import users_of_device
from risc_lab.ros.launching import argument_of
from rosserial_python.diagnosis import Cause
from rosserial_python.link import State

CODES = {cause: cause.name.lower() for cause in Cause if cause} | {Cause.PORT_FAILED: "failed"}
_UNHARMED = frozenset((Cause.TYPES, Cause.SIZE))  # another reader of the port does not cause these


def check(situation):
    """The lines of the graph, then the devices of the fleet that no node of the graph serves."""
    found, graph = Findings("serial"), situation.graph()
    for node, line in sorted(graph.lines.items()):
        if line is None:
            found.say("mute", node=node)
        else:
            found += judge(node, line, [process.describe() for process in users_of_device(line.port)])
    served = {line.port for line in graph.lines.values() if line is not None}
    for vehicle in situation.vehicles():
        for device, place in vehicle.devices.items():
            if place.startswith("/") and place not in served:
                found += look("%s of %s" % (device, vehicle.namespace), place)
    return found or found.say("none")


def judge(node, line, others):
    """Findings about one line. line: SerialLink; others: programs that have the device open, the node among them."""
    found, cause = Findings("serial"), Cause(line.cause)
    values = {"node": node, "port": line.port, "baud": line.baud, "others": ", ".join(others)}
    counters = {counter.name: counter.count for counter in line.counters}
    if len(others) > 1 and cause not in _UNHARMED:  # the node is one of them
        return found.say("shared", **values)
    if cause is Cause.NONE:
        return found.say("up" if line.state == State.UP else "begins", packets=counters.get("packets", 0), **values)
    values |= {"refused": ", ".join(line.refused_topics), "oversized": ", ".join(line.oversized_topics)}
    values |= {"lost": counters.get("lost", 0), "damaged": counters.get("damaged", 0), "age_s": line.age_s}
    return found.say(CODES[cause], **values)


def look(what, path):
    """Findings about a device that no serial_node serves. what: its name. Not opened, as that would reset a board."""
    found, users = Findings("serial"), users_of_device(path)
    # one node may have it open: the driver of the telemetry, which roslaunch has started
    others = [process for process in users if not argument_of(process.words, "__name")] or users[1:]
    values = {"node": what, "port": path, "others": ", ".join(process.describe() for process in others or users)}
    if not os.path.exists(path):
        return found.say("missing", **values)
    if not os.access(path, os.R_OK | os.W_OK):
        return found.say("forbidden", **values)
    return found.say("in_use" if others else "driven" if users else "there", **values)
