"""Ports that our programs need: taken by whom, or not allowed?"""

import errno
import pathlib
import socket

from ardrone_autonomy.protocol import AT_PORT, NAVDATA_PORT
from risc_doctor import interfaces as net
from risc_doctor import socket_owners
from risc_doctor.findings import green, red, yellow
from risc_doctor.ros_master import DEFAULT_URI, MasterError, call, host_and_port, resolve

_UNPRIVILEGED = pathlib.Path("/proc/sys/net/ipv4/ip_unprivileged_port_start")


def check(situation):
    """The stream's port, the master's port, and programs that talk to the same vehicles."""
    return [
        _stream_port(situation.fleet.mocap.stream_port),
        *_master_port(situation),
        *_vehicle_clients(situation),
    ]


def bind_error(port):
    """errno of taking the port as stream_markers does (shared with others who share it); 0 when it works."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            sock.bind(("", port))
        except OSError as error:
            return error.errno
    return 0


def _stream_port(port):
    say, error = "ports", bind_error(port)
    users = ", ".join(socket_owners.users_of_port(port))
    if error == errno.EACCES:
        return yellow(
            say,
            "the stream's port %d may not be taken: ports below %s are for root. Frames are polled instead"
            % (port, _first_free_port()),
            "sudo sysctl net.ipv4.ip_unprivileged_port_start=%d, or a port above 1023 in Cortex and in the fleet file"
            % port,
        )
    if error == errno.EADDRINUSE:
        return red(
            say,
            "the stream's port udp %d is taken by %s, which does not share it"
            % (port, users or "a program that is gone now"),
            "end that program, or set another port in Cortex and in the fleet file",
        )
    if error:
        text = "the stream's port udp %d cannot be taken: %s" % (port, errno.errorcode.get(error, error))
        return red(say, text, "look at the port in the fleet file")
    if users:
        return green(say, "the stream's port udp %d is shared with %s" % (port, users))
    return green(say, "the stream's port udp %d is free" % port)


def _first_free_port():
    try:
        return _UNPRIVILEGED.read_text().strip()
    except OSError:
        return "1024"


def _master_port(situation):
    uri = situation.environment.get("ROS_MASTER_URI") or DEFAULT_URI
    try:
        host, port = host_and_port(uri)
    except ValueError:
        return []  # `ros` says what is wrong with it
    address = resolve(host)
    if situation.master is not None or address is None or not net.is_own(situation.interfaces(), address):
        return []
    users = socket_owners.users_of_port(port, "tcp")
    if not users:
        return [green("ports", "the port of the ROS master, tcp %d, is free" % port)]
    return [
        red(
            "ports",
            "tcp %d, the port of the ROS master, is taken by %s, which does not answer as one"
            % (port, ", ".join(users)),
            "end that program, or choose another port: export ROS_MASTER_URI=http://%s:11312" % host,
        )
    ]


def _vehicle_clients(situation):
    """Other programs that steer or listen to one of the vehicles from this computer."""
    findings = []
    served = driven_addresses()
    for vehicle in {vehicle.address: vehicle for vehicle in situation.vehicles()}.values():
        here = [process for process, address in served if address == vehicle.address]
        if len(here) > 1:
            findings.append(
                red(
                    "ports",
                    "%d drivers talk to %s: %s" % (len(here), vehicle.address, _names(here)),
                    "end all but one (a launch that did not end left it behind): kill %s"
                    % " ".join(str(process.pid) for process in here),
                )
            )
    for port in (NAVDATA_PORT, AT_PORT):
        # other clients of this vehicle take these ports on their own side, too; our driver takes any
        users = socket_owners.users_of_port(port, matters=lambda holder: not net.is_loopback(holder.address))
        if users:
            findings.append(
                yellow(
                    "ports",
                    "udp %d, a port of AR.Drone clients, is taken by %s: it may talk to the vehicle, too"
                    % (port, ", ".join(users)),
                    "end that program: a vehicle sends its telemetry to one client only",
                )
            )
    return findings


def driven_addresses():
    """[(process, address)] of the drivers on this computer, one for each vehicle; address None when it is not known."""
    return [(process, address) for process in socket_owners.drivers() for address in _driven_addresses(process)]


def _driven_addresses(process):
    """From its command line, or from the master that it belongs to."""
    if "-ip" in process.words[:-1]:
        return [process.words[process.words.index("-ip") + 1]]
    uri = process.environment.get("ROS_MASTER_URI")
    name = socket_owners.argument(process.words, "__name") or "ardrone_driver"
    space = socket_owners.argument(process.words, "__ns") or process.environment.get("ROS_NAMESPACE", "")
    if not uri:
        return [None]
    place = "/".join(part for part in (space.strip("/"), name) if part)
    try:
        own = call(uri, "getParam", "/" + place)
    except MasterError:
        return [None]
    addresses = [own.get("drone_ip", values.get("drone_ip")) for values in own.get("vehicles", {"": {}}).values()]
    return [address and str(address) for address in addresses]


def _names(found):
    return ", ".join(process.describe() for process in found)
