"""The vehicles: reachable, in which state, and with how much battery left?"""

import concurrent.futures

from ardrone_autonomy.protocol.navdata import State
from risc_control.safety import SafetyLimits
from risc_control.vehicles import NO_EVIDENCE, ON_GROUND
from risc_doctor import interfaces as net
from risc_doctor import navdata_probe
from risc_doctor.findings import YELLOW, Findings
from risc_doctor.taken_ports import driven_addresses

FULL_ENOUGH_PCT, NEARLY_EMPTY_PCT = 30.0, 20.0
_TROUBLE = {
    State.MOTOR_PROBLEM: "motors",
    State.CUTOUT: "cut_out",
    State.ANGLES_OUT_OF_RANGE: "angles",
    State.SOFTWARE_FAULT: "software",
    State.EMERGENCY: "emergency",
}


def check(situation):
    """Ask every vehicle that this computer is to fly; if a driver already flies it, take what the driver says."""
    found, silent, graph = Findings("vehicles"), [], situation.graph()
    if graph.error and graph.vehicles:  # asking past a driver would take its telemetry
        return found.say("unheard")
    for vehicle in situation.vehicles():
        name = "%s (%s)" % (vehicle.namespace, vehicle.place)
        if vehicle.namespace not in graph.vehicles:
            silent.append(vehicle)
        elif (heard := graph.vehicles[vehicle.namespace]) is None:
            found.say("no_telemetry", name=name)
        else:
            flies = heard.state not in ON_GROUND | NO_EVIDENCE
            found += judge(name, "by its driver", State.FLYING if flies else 0, heard.battery_pct)
    if situation.fleet.own_networks and not situation.wanted:
        if found:  # the others are elsewhere, even if something has their address here
            return found.say("no_driver", names=", ".join(v.namespace for v in silent)) if silent else found
        # vehicles that share the factory address look like one vehicle from here
        cards = situation.interfaces()
        silent = list({v.place: v for v in silent if not v.address or net.interface_towards(cards, v.address)}.values())
        if not silent:
            return found.say("not_joined", addresses=", ".join(sorted({v.place for v in situation.vehicles()})))
    served = driven_addresses()
    with concurrent.futures.ThreadPoolExecutor(max(1, len(silent))) as pool:
        for some in pool.map(lambda vehicle: _ask(situation, vehicle, served), silent):
            found += some
    return found


def _ask(situation, vehicle, served):
    """Findings about a vehicle that has no driver in the graph."""
    found, name = Findings("vehicles"), "%s (%s)" % (vehicle.namespace, vehicle.place)
    if sum(other.place == vehicle.place for other in situation.fleet.vehicles) > 1 or not vehicle.namespace:
        name = "the vehicle at %s" % vehicle.place  # which of several with this address it is, is not known
    kind = vehicle.vehicle_type
    if (kind.driver or kind.name) != "ardrone":
        return found.say("other_wire", name=name, type=kind.name)
    drivers = [process for process, address in served if address in (vehicle.address, None)]
    if drivers:
        uri = drivers[0].environment.get("ROS_MASTER_URI") or "http://ITS_MASTER:11311"
        return found.say("not_asked", name=name, drivers=", ".join(p.describe() for p in drivers), uri=uri)
    report = navdata_probe.probe(vehicle.address)
    if report.error:
        code = "no_lab" if net.is_loopback(vehicle.address) else "silent"
        return found.say(code, name=name, error=report.error, address=vehicle.address)
    return judge(name, "asked directly", report.state, report.battery_pct)


def judge(name, way, state, battery_pct, limit_pct=SafetyLimits.battery_min_pct):
    """Findings about one vehicle that answers. state: bits of navdata.State; battery_pct: None when not told."""
    found = Findings("vehicles")
    for bit, code in _TROUBLE.items():
        if state & bit:
            found.say(code, name=name)
    values = {"name": name, "way": way + (", flying" if state & State.FLYING else ""), "battery_pct": battery_pct}
    if battery_pct is None:
        return found.say("no_battery", **values)
    if battery_pct <= limit_pct:
        return found.say("battery_low", what="it would land at once (limit %g %%)" % limit_pct, **values)
    if state & State.BATTERY_LOW:
        return found.say("battery_low", what="it refuses to take off", **values)
    if battery_pct <= NEARLY_EMPTY_PCT:
        return found.say("battery_low", YELLOW, what="it lands within a few minutes", **values)
    if battery_pct <= FULL_ENOUGH_PCT:
        return found.say("battery_low", YELLOW, what="not for a long flight", **values)
    return found.say("battery", **values)
