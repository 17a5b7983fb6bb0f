"""Ports that our programs need: taken by whom, or not allowed?"""

import errno
import pathlib
import socket

from ardrone_autonomy.protocol import AT_PORT, NAVDATA_PORT
from risc_doctor import interfaces as net
from risc_doctor import socket_owners
from risc_doctor.findings import Findings, finding
from risc_doctor.ros_master import DEFAULT_URI, MasterError, call, host_and_port, resolve
from risc_lab.ros.launching import argument_of

_UNPRIVILEGED = pathlib.Path("/proc/sys/net/ipv4/ip_unprivileged_port_start")


def check(situation):
    """The stream's port, the master's port, and programs that talk to the same vehicles."""
    found = Findings("ports")
    found.append(_stream_port(situation.fleet.mocap.stream_port))
    _master_port(situation, found)
    _vehicle_clients(situation, found)
    return found


def _stream_port(port):
    """The Finding of binding the port as stream_markers does, shared with others who share it."""
    users = ", ".join(socket_owners.users_of_port(port))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            sock.bind(("", port))
        except OSError as error:
            codes = {errno.EACCES: "stream_for_root", errno.EADDRINUSE: "stream_taken"}
            values = {"first": _UNPRIVILEGED.read_text().strip(), "users": users or "a program that is gone now"}
            return finding("ports", codes.get(error.errno, "stream_refused"), port=port, error=error.strerror, **values)
    return finding("ports", "stream_shared" if users else "stream_free", port=port, users=users)


def _master_port(situation, found):
    uri = situation.environment.get("ROS_MASTER_URI") or DEFAULT_URI
    try:
        host, port = host_and_port(uri)
    except ValueError:
        return  # `ros` says what is wrong with it
    address = resolve(host)
    if situation.master is not None or address is None or not net.is_own(situation.interfaces(), address):
        return
    users = ", ".join(socket_owners.users_of_port(port, "tcp"))
    found.say("master_taken" if users else "master_free", port=port, users=users, host=host)


def _vehicle_clients(situation, found):
    """Find other programs that steer or listen to one of the vehicles from this computer."""
    served = driven_addresses()
    for address in {vehicle.address for vehicle in situation.vehicles() if vehicle.address}:
        here = [process for process, driven in served if driven == address]
        if len(here) > 1:
            names, pids = ", ".join(p.describe() for p in here), " ".join(str(p.pid) for p in here)
            found.say("many_drivers", count=len(here), address=address, drivers=names, pids=pids)
    for port in (NAVDATA_PORT, AT_PORT):
        # other clients of this vehicle take these ports on their own side, too; our driver takes any
        users = socket_owners.users_of_port(port, from_elsewhere=True)
        if users:
            found.say("other_client", port=port, users=", ".join(users))


def driven_addresses():
    """[(process, address)] of the drivers on this computer, one for each vehicle; address None when it is not known."""
    return [(process, address) for process in socket_owners.drivers() for address in _driven_addresses(process)]


def _driven_addresses(process):
    """Addresses that a driver flies, from its command line or its master; [None] when not known."""
    if "-ip" in process.words[:-1]:
        return [process.words[process.words.index("-ip") + 1]]
    uri = process.environment.get("ROS_MASTER_URI")
    name = argument_of(process.words, "__name") or "ardrone_driver"
    space = argument_of(process.words, "__ns") or process.environment.get("ROS_NAMESPACE", "")
    if not uri:
        return [None]
    place = "/".join(part for part in (space.strip("/"), name) if part)
    try:
        own = call(uri, "getParam", "/" + place)
    except MasterError:
        return [None]
    addresses = [own.get("drone_ip", values.get("drone_ip")) for values in own.get("vehicles", {"": {}}).values()]
    return [address and str(address) for address in addresses]
