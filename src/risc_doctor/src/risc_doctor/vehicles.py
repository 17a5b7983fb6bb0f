"""The vehicles: reachable, in which state, and with how much battery left?"""

import concurrent.futures

from ardrone_autonomy.protocol.navdata import State
from risc_control.failsafe import SafetyLimits
from risc_doctor import interfaces as net
from risc_doctor import navdata_probe
from risc_doctor.findings import green, red, yellow
from risc_doctor.ports import driven_addresses
from risc_doctor.situation import START_THE_VIRTUAL_LAB

FULL_ENOUGH_PCT, NEARLY_EMPTY_PCT = 30.0, 20.0
_CHARGE = "charge or change the battery"
_TROUBLE = {
    State.MOTOR_PROBLEM: ("a motor problem", "free its propellers, look at the gears, then switch it off and on"),
    State.CUTOUT: ("cut-out: its motors were stopped", "look for damage, then reset it (emergency button)"),
    State.ANGLES_OUT_OF_RANGE: ("an attitude out of range", "stand it level, then reset it (emergency button)"),
    State.SOFTWARE_FAULT: ("a fault of its software", "switch it off and on"),
    State.EMERGENCY: ("an emergency", "look for damage, then reset it: the emergency button on the ground clears it"),
}


def check(situation):
    """Every vehicle that this computer is to fly, unless a driver does already: then what the driver says."""
    limit_pct, heard = SafetyLimits.battery_min_pct, {}
    if situation.master is not None:
        graph = situation.graph()
        if graph.error and graph.vehicles:  # asking past a driver would take its telemetry
            return [yellow("vehicles", "cannot be told: the graph could not be listened to", "see `graph`")]
        heard = graph.vehicles
    findings = []
    for vehicle in situation.vehicles():
        if vehicle.namespace in heard:
            findings += _by_driver(vehicle, heard[vehicle.namespace], limit_pct)
    silent = [vehicle for vehicle in situation.vehicles() if vehicle.namespace not in heard]
    if situation.fleet.own_networks and not situation.wanted:
        if findings:  # the others are elsewhere, whatever has their address here
            return findings + _without_driver(silent)
        # the factory address of all is one vehicle from here
        silent = list({v.address: v for v in silent if _reachable(situation, v.address)}.values())
        if not silent:
            return [
                yellow(
                    "vehicles",
                    "this computer has joined no vehicle's own network (%s)"
                    % ", ".join(sorted({v.address for v in situation.vehicles()})),
                    "fine for a base station; a vehicle's laptop joins the Wi-Fi of its vehicle, and"
                    " `./maap machines check` looks there",
                )
            ]
    served = driven_addresses()
    with concurrent.futures.ThreadPoolExecutor(max(1, len(silent))) as pool:
        jobs = [pool.submit(_ask, situation, vehicle, served, limit_pct) for vehicle in silent]
        return findings + [finding for job in jobs for finding in job.result()]


def _reachable(situation, address):
    return net.interface_towards(situation.interfaces(), address) is not None


def _by_driver(vehicle, heard, limit_pct):
    """Findings about a vehicle that a driver of the graph listens to. heard: ros_graph.HeardVehicle."""
    name = "%s (%s)" % (vehicle.namespace, vehicle.address)
    if heard.battery_pct is None:
        cure = "is the vehicle on, and the computer of its driver in its Wi-Fi?"
        return [red("vehicles", "%s: its driver runs, but no telemetry comes" % name, cure)]
    return judge(name, "by its driver", State.FLYING if heard.flies else 0, heard.battery_pct, limit_pct)


def _without_driver(vehicles):
    if not vehicles:
        return []
    text = "no driver of the graph listens to %s" % ", ".join(vehicle.namespace for vehicle in vehicles)
    cure = "is its computer on, and did its driver end? rosnode list; ./maap machines check looks there"
    return [yellow("vehicles", text, cure)]


def _ask(situation, vehicle, served, limit_pct):
    """Findings about a vehicle of which the graph says nothing."""
    name = _name(situation, vehicle)
    drivers = [process for process, address in served if address in (vehicle.address, None)]
    if drivers:
        return [
            yellow(
                "vehicles",
                "%s: not asked, as %s may fly it, and would lose its telemetry"
                % (name, ", ".join(process.describe() for process in drivers)),
                "look at its graph: ROS_MASTER_URI=%s ./maap doctor; or end the driver"
                % (drivers[0].environment.get("ROS_MASTER_URI") or "http://ITS_MASTER:11311"),
            )
        ]
    report = navdata_probe.probe(vehicle.address)
    if report.error:
        cure = "switch it on, wait for its green lights, and join its Wi-Fi; is %s its address?" % vehicle.address
        if net.is_loopback(vehicle.address):
            cure = START_THE_VIRTUAL_LAB
        return [red("vehicles", "%s does not answer: %s" % (name, report.error), cure)]
    return judge(name, "asked directly", report.state, report.battery_pct, limit_pct)


def judge(name, way, state, battery_pct, limit_pct):
    """Findings about one vehicle that answers. state: bits of navdata.State; battery_pct: None when not told."""
    say, findings = "vehicles", []
    for bit, (text, cure) in _TROUBLE.items():
        if state & bit:
            findings.append(red(say, "%s reports %s" % (name, text), cure))
    flies = ", flies" if state & State.FLYING else ""
    if battery_pct is None:
        text = "%s answers (%s%s), but does not tell its battery" % (name, way, flies)
        return findings + [yellow(say, text, "its driver will; or switch it off and on")]
    text = "%s answers (%s%s), battery %.0f %%" % (name, way, flies, battery_pct)
    data = {"battery_pct": battery_pct}
    if battery_pct <= limit_pct:
        findings.append(red(say, text + ": it would land at once (limit %g %%)" % limit_pct, _CHARGE, **data))
    elif state & State.BATTERY_LOW:
        findings.append(red(say, text + ": it refuses to take off", _CHARGE, **data))
    elif battery_pct <= NEARLY_EMPTY_PCT:
        findings.append(yellow(say, text + ": it lands within a few minutes", _CHARGE, **data))
    elif battery_pct <= FULL_ENOUGH_PCT:
        findings.append(yellow(say, text + ": not for a long flight", _CHARGE, **data))
    else:
        findings.append(green(say, text, **data))
    return findings


def _name(situation, vehicle):
    """A vehicle for people. One of several with one address has no name of its own from here."""
    same = [v for v in situation.fleet.vehicles if v.address == vehicle.address]
    if len(same) > 1 or not vehicle.namespace:
        return "the vehicle at %s" % vehicle.address
    return "%s (%s)" % (vehicle.namespace, vehicle.address)
