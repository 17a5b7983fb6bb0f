"""The environment that ROS nodes live in: where is the master, and under which address do others find us?"""

import socket

from risc_doctor import interfaces as net
from risc_doctor.findings import green, red, yellow
from risc_doctor.ros_master import MasterError, host_and_port, resolve


def check(situation):
    """ROS_MASTER_URI, ROS_IP and ROS_HOSTNAME; dead nodes at the master."""
    return (
        judge_master(situation)
        + judge_own_address(
            situation.environment,
            situation.interfaces(),
            situation.master,
            situation.fleet.own_networks,
            socket.gethostname(),
        )
        + _nodes(situation)
    )


def judge_master(situation):
    """Findings about where the master is."""
    say, environment = "ros", situation.environment
    uri = environment.get("ROS_MASTER_URI", "")
    if not uri:
        return [red(say, "ROS_MASTER_URI is not set", ". %s/devel/setup.bash" % situation.root)]
    try:
        host, _ = host_and_port(uri)
    except ValueError as error:
        return [red(say, "ROS_MASTER_URI: %s" % error, "export ROS_MASTER_URI=http://BASE_STATION:11311")]
    address = resolve(host)
    if address is None:
        return [
            red(
                say,
                "ROS_MASTER_URI is %s, but nobody knows the name '%s'" % (uri, host),
                "use the base station's address instead of its name, or add it to /etc/hosts",
            )
        ]
    findings = []
    own = net.is_own(situation.interfaces(), address)
    if net.is_loopback(address) and situation.fleet.own_networks:
        findings.append(
            yellow(
                say,
                "ROS_MASTER_URI is %s: laptops of other vehicles would look for the master on themselves" % uri,
                "export ROS_MASTER_URI=http://ADDRESS_OF_THE_BASE_STATION:11311 (fine when one computer does it all)",
            )
        )
    if situation.master is not None:
        findings.append(green(say, "the master at %s answers" % uri))
    elif situation.nobody_there and own:
        findings.append(green(say, "no master runs at %s yet; roslaunch starts one" % uri))
    else:
        findings.append(
            yellow(
                say,
                "the master at %s does not answer (%s)" % (uri, situation.master_error),
                "see `ports`: what has its port hangs"
                if own
                else "start the experiment on the base station, or is its address another one?",
            )
        )
    return findings


def judge_own_address(environment, interfaces, master, several, host_name):
    """Findings about the address that this computer's nodes tell to others.

    several: vehicles are flown by computers of their own. host_name: of this computer.
    """
    say, findings = "ros", []
    ip, name = environment.get("ROS_IP", ""), environment.get("ROS_HOSTNAME", "")
    cards = [card for card in interfaces if card.up and card.addresses and not card.is_loopback]
    choice = ", ".join(str(address.ip) for card in cards for address in card.addresses) or "127.0.0.1"
    if ip and name:
        findings.append(
            yellow(
                say,
                "both ROS_HOSTNAME (%s) and ROS_IP (%s) are set: ROS_IP is ignored" % (name, ip),
                "unset ROS_HOSTNAME",
            )
        )
    told, variable = (name, "ROS_HOSTNAME") if name else (ip, "ROS_IP")
    export = ("unset ROS_HOSTNAME; " if name else "") + "export ROS_IP=%s" % choice
    far = master is not None and _is_elsewhere(master, interfaces)
    if not told:
        text = "ROS_IP is not set: nodes here are announced as '%s'" % host_name
        if several or far:
            cure = export + " (the one in the network of the other computers)"
            findings.append(yellow(say, text + ", which the other computers must know", cure))
        elif resolve(host_name) is None:
            cure = "export ROS_IP=127.0.0.1, or add '127.0.1.1 %s' to /etc/hosts" % host_name
            findings.append(red(say, text + ", which nobody knows", cure))
        else:
            findings.append(green(say, text))
        return findings
    address = resolve(told)
    if address is None:
        return findings + [red(say, "%s is '%s', which nobody knows" % (variable, told), export)]
    if not net.is_own(interfaces, address):
        return findings + [
            red(
                say,
                "%s is %s, which is no address of this computer: nobody would reach its nodes" % (variable, told),
                export,
            )
        ]
    # Debian's /etc/hosts has the own name at 127.0.1.1, too: which address it is to others is theirs to know
    only_here = net.is_loopback(address) and told in (address, "localhost")
    if far and only_here:
        text = "%s is %s, but the master is on another computer: nobody there would reach our nodes"
        return findings + [red(say, text % (variable, told), export)]
    if far and net.is_loopback(address):
        text = "%s is '%s', which is %s here; the other computers must know it by another address"
        return findings + [yellow(say, text % (variable, told, address), export)]
    if several and only_here:
        text = "%s is %s: nodes here can be reached from this computer only" % (variable, told)
        cure = export + " (the one in the network of the other computers); fine when one computer does it all"
        return findings + [yellow(say, text, cure)]
    return findings + [green(say, "%s is %s, an address of this computer" % (variable, told))]


def _is_elsewhere(master, interfaces):
    """Whether a master runs on another computer."""
    address = resolve(host_and_port(master.uri)[0])
    return address is not None and not net.is_own(interfaces, address)


def _nodes(situation):
    """Nodes that the master knows but that do not answer."""
    if situation.master is None:
        return []
    try:
        answers = situation.master.ask_nodes(situation.master.nodes())
        simulated_time = situation.master.parameter("/use_sim_time", False)
    except MasterError as error:
        return [yellow("ros", "the master has gone: %s" % error, "look again when it runs")]
    findings = []
    if simulated_time:
        text = "use_sim_time is set: all nodes wait for /clock"
        cure = "rosparam delete /use_sim_time, and start the experiment again (it is for playing bags)"
        findings.append(red("ros", text, cure))
    dead = {name: why for name, why in answers.items() if why}
    unknown = {name: why for name, why in dead.items() if "not known here" in why}
    for name, why in sorted(unknown.items()):
        cure = "set ROS_IP on the computer of that node (devel/coop.sh does), or add its name to /etc/hosts here"
        findings.append(red("ros", "node %s cannot be reached: %s" % (name, why), cure))
    gone = sorted(set(dead) - set(unknown))
    if gone:
        text = "registered at the master, but not answering: %s" % ", ".join(gone)
        cure = "rosnode cleanup, if they have ended; else is their computer's network out?"
        findings.append(yellow("ros", text, cure, nodes=gone))
    alive = len(answers) - len(dead)
    if alive:
        findings.append(green("ros", "%d nodes answer" % alive))
    return findings
