"""Which process has a socket, and which vehicle drivers run on this computer."""

import contextlib
import os
import pathlib
import re
from dataclasses import dataclass, field

import psutil

_DRIVER = "ardrone_driver"  # name of the driver's executable
_ANY = {"::": "0.0.0.0"}


@dataclass(frozen=True)
class PortHolder:
    """A socket that is bound to a port."""

    address: str  # that it is bound to; 0.0.0.0 = all
    pid: int | None  # None: it belongs to another user, or its process is gone


@dataclass(frozen=True)
class Process:
    """A process of this computer."""

    pid: int
    words: tuple  # its command line
    environment: dict = field(default_factory=dict)  # empty when it belongs to another user

    def describe(self):
        """E.g. "rosmaster (pid 812)"."""
        return "%s (pid %d)" % (_program(self.words), self.pid)


def holders_of_port(port, kind="udp"):
    """Sockets bound to a port. kind: "udp", or "tcp" for those that listen."""
    return [
        PortHolder(_ANY.get(item.laddr.ip, item.laddr.ip.removeprefix("::ffff:")), item.pid)
        for item in psutil.net_connections(kind)
        if item.laddr and item.laddr.port == port and (kind == "udp" or item.status == psutil.CONN_LISTEN)
    ]


def users_of_port(port, kind="udp", matters=lambda holder: True):
    """Programs other than this one that hold a port, for people; [] when there are none. matters: of a PortHolder."""
    names, holders = set(), list(filter(matters, holders_of_port(port, kind)))
    if any(holder.pid is None for holder in holders):  # perhaps another check of ours opened it while we looked
        holders = filter(matters, holders_of_port(port, kind))
    for holder in holders:
        if holder.pid is None:
            names.add("a program of another user (sudo ss -lnptu tells which)")
        elif holder.pid != os.getpid():
            with contextlib.suppress(psutil.NoSuchProcess):  # it ended meanwhile
                names.add(_process(psutil.Process(holder.pid)).describe())
    return sorted(names)


def drivers():
    """Processes of vehicle drivers on this computer. Those in containers have other networks, and other vehicles."""
    found, network = [], _network(os.getpid())
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):  # it ended while we looked
            names = [pathlib.PurePath(word).name for word in process.cmdline()[:2]]
            if _DRIVER in names and _network(process.pid) in (network, ""):
                found.append(_process(process))
    return found


def argument(words, name):
    """Value of a remapping argument NAME:=VALUE on a command line, or ""."""
    for word in words:
        if word.startswith(name + ":="):
            return word[len(name) + 2 :]
    return ""


def _network(pid):
    """The network namespace of a process; "" when it is not ours to know."""
    try:
        return os.readlink("/proc/%d/ns/net" % pid)
    except OSError:
        return ""


def _process(process):
    """`Process` of a psutil.Process. Raises psutil.NoSuchProcess when it has ended."""
    try:
        environment = process.environ()
    except psutil.AccessDenied:
        environment = {}
    return Process(process.pid, tuple(process.cmdline()) or (process.name(),), environment)


def _program(words):
    """What a person calls a command line: the script or the module rather than its interpreter."""
    names = [pathlib.PurePath(word).name for word in words]
    if len(names) > 1 and re.fullmatch(r"python[0-9.]*|bash|sh|nice|env", names[0]):
        if names[1] == "-m" and len(words) > 2:
            return words[2]
        if not names[1].startswith("-"):
            return names[1]
    return names[0] if names else "?"
