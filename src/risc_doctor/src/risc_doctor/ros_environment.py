"""The environment that ROS nodes live in: where is the master, and under which address do others find us?"""

import socket

from risc_doctor import interfaces as net
from risc_doctor.findings import Findings
from risc_doctor.ros_master import MasterError, UnknownHostError, host_and_port, resolve


def check(situation):
    """ROS_MASTER_URI, ROS_IP and ROS_HOSTNAME; dead nodes at the master."""
    own = situation.interfaces(), situation.master, situation.fleet.own_networks, socket.gethostname()
    return judge_master(situation) + judge_own_address(situation.environment, *own) + _nodes(situation)


def judge_master(situation):
    """Findings about where the master is."""
    found, uri = Findings("ros"), situation.environment.get("ROS_MASTER_URI", "")
    if not uri:
        return found.say("no_uri", root=situation.root)
    try:
        host, _ = host_and_port(uri)
    except ValueError as error:
        return found.say("bad_uri", error=error)
    address = resolve(host)
    if address is None:
        return found.say("unknown_host", uri=uri, host=host)
    if net.is_loopback(address) and situation.fleet.own_networks:
        found.say("local_master", uri=uri)
    code = "master_silent"
    if situation.master is not None:
        code = "master"
    elif net.is_own(situation.interfaces(), address):
        code = "no_master" if situation.nobody_there else "master_hangs"
    return found.say(code, uri=uri, error=situation.master_error)


def judge_own_address(environment, interfaces, master, several, host_name):
    """Findings about the address that this computer's nodes tell to others.

    several: each vehicle is flown by a computer of its own. host_name: of this computer.
    """
    found = Findings("ros")
    ip, name = environment.get("ROS_IP", ""), environment.get("ROS_HOSTNAME", "")
    cards = net.leading_out(interfaces)
    choice = ", ".join(str(address.ip) for card in cards for address in card.addresses) or "127.0.0.1"
    if ip and name:
        found.say("both", name=name, ip=ip)
    told, variable = (name, "ROS_HOSTNAME") if name else (ip, "ROS_IP")
    export = ("unset ROS_HOSTNAME; " if name else "") + "export ROS_IP=%s" % choice
    host = resolve(host_and_port(master.uri)[0]) if master is not None else None
    far = host is not None and not net.is_own(interfaces, host)
    if not told:
        code = "no_ip_several" if several or far else "no_ip" if resolve(host_name) else "no_ip_unknown"
        return found.say(code, host=host_name, export=export)
    address = resolve(told)
    # Debian's /etc/hosts maps the own name to 127.0.1.1, too: others may resolve it to another address
    only_here = address is not None and net.is_loopback(address) and told in (address, "localhost")
    if address is None:
        code = "name_unknown"
    elif not net.is_own(interfaces, address):
        code = "not_own"
    elif far and only_here:
        code = "only_here"
    elif far and net.is_loopback(address):
        code = "loopback_name"
    else:
        code = "only_here_several" if several and only_here else "own"
    return found.say(code, variable=variable, told=told, export=export, address=address)


def _nodes(situation):
    """Nodes that the master knows but that do not answer."""
    found = Findings("ros")
    if situation.master is None:
        return found
    try:
        answers = situation.master.ask_nodes()
        simulated_time = situation.master.parameter("/use_sim_time", False)
    except MasterError as error:
        return found.say("master_gone", error=error)
    if simulated_time:
        found.say("simulated_time")
    unknown = [name for name, why in answers.items() if isinstance(why, UnknownHostError)]
    gone = [name for name, why in answers.items() if why and name not in unknown]
    for name in unknown:
        found.say("node_unreachable", node=name, why=answers[name])
    if gone:
        found.say("dead_nodes", nodes=gone, names=", ".join(gone))
    if len(answers) > len(gone) + len(unknown):
        found.say("alive", count=len(answers) - len(gone) - len(unknown))
    return found
