"""Which process has a socket, and which vehicle drivers run on this computer: read from /proc."""

import contextlib
import os
import pathlib
import re
import socket
import struct
from dataclasses import dataclass, field

_PROC = pathlib.Path("/proc")
_TCP_LISTEN = "0A"
_DRIVER = "ardrone_driver"  # name of the driver's executable


@dataclass(frozen=True)
class PortHolder:
    """A socket that is bound to a port."""

    address: str  # that it is bound to; 0.0.0.0 = all
    inode: int


@dataclass(frozen=True)
class Process:
    """A process of this computer."""

    pid: int
    words: tuple  # its command line
    environment: dict = field(default_factory=dict)  # empty when it belongs to somebody else

    def describe(self):
        """E.g. "rosmaster (pid 812)"."""
        return "%s (pid %d)" % (_program(self.words), self.pid)


def holders_of_port(port, kind="udp"):
    """Sockets bound to a port. kind: "udp", or "tcp" for those that listen."""
    found = []
    for table in (kind, kind + "6"):
        try:
            lines = (_PROC / "net" / table).read_text().splitlines()[1:]
        except OSError:
            continue  # a kernel without IPv6
        for line in lines:
            words = line.split()
            address, _, number = words[1].partition(":")
            if int(number, 16) != port or (kind == "tcp" and words[3] != _TCP_LISTEN):
                continue
            found.append(PortHolder(_address(address), int(words[9])))
    return found


def owners(inodes):
    """{inode: Process} of sockets. Those of other users are missing unless we are root."""
    wanted = {"socket:[%d]" % inode: inode for inode in inodes}
    found = {}
    if not wanted:
        return found
    for folder in _PROC.glob("[0-9]*"):
        for inode in _sockets(folder).intersection(wanted):
            with contextlib.suppress(OSError):  # it ended meanwhile
                found[wanted[inode]] = _process(folder)
    return found


def users_of_port(port, kind="udp", matters=lambda holder: True):
    """Programs other than this one that hold a port, for people; [] when nobody does. matters: of a PortHolder."""
    holders = [holder for holder in holders_of_port(port, kind) if matters(holder)]
    known = owners([holder.inode for holder in holders])
    still = {holder.inode for holder in holders_of_port(port, kind)}  # another check of ours may just have closed one
    names = {process.describe() for process in known.values() if process.pid != os.getpid()}
    if any(holder.inode in still and holder.inode not in known for holder in holders):
        names.add("a program of another user (sudo ss -lnptu tells which)")
    return sorted(names)


def drivers():
    """Processes of vehicle drivers on this computer. Those in containers have other networks, and other vehicles."""
    found, network = [], _network(_PROC / "self")
    for folder in _PROC.glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it ended while we looked
            process = _process(folder)
            names = [pathlib.PurePath(word).name for word in process.words[:2]]
            if _DRIVER in names and _network(folder) in (network, ""):
                found.append(process)
    return found


def argument(words, name):
    """Value of a remapping argument NAME:=VALUE on a command line, or ""."""
    for word in words:
        if word.startswith(name + ":="):
            return word[len(name) + 2 :]
    return ""


def _sockets(folder):
    """Links of a process' sockets; none when it is not ours to look at, or ends."""
    links = set()
    with contextlib.suppress(OSError):
        for link in (folder / "fd").iterdir():
            with contextlib.suppress(OSError):  # closed meanwhile, as that of our own listing is
                links.add(os.readlink(str(link)))
    return links


def _network(folder):
    """The network namespace of a process; "" when it is not ours to know."""
    try:
        return os.readlink(str(folder / "ns" / "net"))
    except PermissionError:
        return ""


def _process(folder):
    """Process of a /proc folder. Raises OSError when it has ended."""
    words = tuple(_split(folder / "cmdline"))
    try:
        environment = dict(item.partition("=")[::2] for item in _split(folder / "environ"))
    except PermissionError:
        environment = {}
    if not words:  # a thread of the kernel, or one that is ending
        words = ((folder / "comm").read_text().strip(),)
    return Process(int(folder.name), words, environment)


def _split(path):
    return [part for part in path.read_bytes().decode("utf-8", "replace").split("\0") if part]


def _program(words):
    """What a person calls a command line: the script or the module rather than its interpreter."""
    names = [pathlib.PurePath(word).name for word in words]
    if len(names) > 1 and re.fullmatch(r"python[0-9.]*|bash|sh|nice|env", names[0]):
        if names[1] == "-m" and len(words) > 2:
            return words[2]
        if not names[1].startswith("-"):
            return names[1]
    return names[0] if names else "?"


def _address(text):
    """Address of /proc/net: hexadecimal words in the order of this computer's bytes."""
    if len(text) == 8:
        return socket.inet_ntoa(struct.pack("=I", int(text, 16)))
    words = struct.pack("=4I", *(int(text[k : k + 8], 16) for k in range(0, 32, 8)))
    plain = socket.inet_ntop(socket.AF_INET6, words)
    return plain[len("::ffff:") :] if plain.startswith("::ffff:") else "0.0.0.0" if plain == "::" else plain
