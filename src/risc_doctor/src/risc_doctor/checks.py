"""All checks by name, run in parallel, because most of them wait for answers."""

import concurrent.futures

from risc_doctor import (
    clock_agreement,
    cortex,
    disk,
    load,
    network,
    operator_joystick,
    ros_environment,
    ros_graph,
    serial_lines,
    sourced_workspace,
    taken_ports,
    vehicles,
)
from risc_doctor.findings import finding, guarded
from risc_doctor.ros_master import MasterError

# name -> (what it looks at, function of a Situation that returns findings); in the order of the report
CHECKS = {
    "workspace": ("revision and content of the workspace, and whether it is the sourced one", sourced_workspace.check),
    "network": ("network cards, subnets, the way to Cortex and to the vehicles", network.check),
    "subnets": ("whether each network card is in a network of its own", network.check_subnets),
    "multicast": ("the group of the mocap stream", network.check_multicast),
    "ports": ("ports that are in use or not allowed, other drivers", taken_ports.check),
    "cortex": ("motion capture: there, live, rate, loss, units", cortex.check),
    "templates": ("bodies of Cortex against the fleet and templates.yaml", cortex.check_templates),
    "axes": ("the mocap frame: size, handedness, up, place", cortex.check_axes),
    "load": ("whether this computer is too busy for a flight", load.check),
    "clock": ("what synchronises the clock; age of the stamps", clock_agreement.check),
    "vehicles": ("vehicles: reachable, state, battery", vehicles.check),
    "joystick": ("joysticks: there, readable, buttons and axes", operator_joystick.check),
    "serial": ("serial lines to boards: there, answered, and why not", serial_lines.check),
    "disk": ("room and write speed for the bag", disk.check),
    "ros": ("ROS_MASTER_URI, ROS_IP, dead nodes", ros_environment.check),
    "graph": ("rates and /diagnostics of a running graph", ros_graph.check),
}


def run(situation, names, checks=None):
    """Findings of the named checks, in their order. A check with an exception is a red finding; the others go on."""
    checks = CHECKS if checks is None else checks
    with concurrent.futures.ThreadPoolExecutor(len(checks)) as pool:
        jobs = [pool.submit(guarded, name, _look, name, checks[name][1], situation) for name in names]
        return [found for job in jobs for found in job.result()]


def _look(name, function, situation):
    try:
        return function(situation)
    except MasterError as error:
        return [finding(name, "master_gone", error=error)]
