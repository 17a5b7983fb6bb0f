"""Which process has a socket or a device, and which vehicle drivers run on this computer."""

import contextlib
import glob
import os
import stat
from dataclasses import dataclass, field

import psutil

from risc_lab.ros.launching import program_of

_DRIVER = "ardrone_driver"  # name of the driver's executable


@dataclass(frozen=True)
class Process:
    """A process of this computer."""

    pid: int
    words: tuple  # its command line
    environment: dict = field(default_factory=dict)  # empty when it belongs to another user

    def describe(self):
        """E.g. "rosmaster (pid 812)"."""
        return "%s (pid %d)" % (program_of(self.words) or "?", self.pid)


def users_of_port(port, kind="udp", from_elsewhere=False):
    """Texts for the programs other than this one that hold a port; [] when there are none.

    kind: "udp", or "tcp" for those that listen.  from_elsewhere: only those that other computers can reach.
    """
    pids = _holders(port, kind, from_elsewhere)
    if None in pids:  # perhaps another check of ours opened it while we looked
        pids = _holders(port, kind, from_elsewhere)
    names = {"a program of another user (sudo ss -lnptu shows which)"} if None in pids else set()
    for pid in pids - {None, os.getpid()}:
        with contextlib.suppress(psutil.NoSuchProcess):  # it ended meanwhile
            names.add(_process(psutil.Process(pid)).describe())
    return sorted(names)


def _holders(port, kind, from_elsewhere):
    """Process ids; None for a process of another user, or one that has ended."""
    return {
        item.pid
        for item in psutil.net_connections(kind)
        if item.laddr and item.laddr.port == port and (kind == "udp" or item.status == psutil.CONN_LISTEN)
        if not (from_elsewhere and item.laddr.ip.removeprefix("::ffff:").startswith(("127.", "::1")))
    }


def users_of_device(path):
    """Every `Process`, except those of other users, that has a device file open; [] for other files."""

    def device_of(name):
        with contextlib.suppress(OSError):  # it is not there, not ours to see, or closed meanwhile
            status = os.stat(name)
            return status.st_rdev if stat.S_ISCHR(status.st_mode) else None

    device = device_of(path)
    if device is None:
        return []
    pids = {int(name.split("/")[2]) for name in glob.glob("/proc/[0-9]*/fd/*") if device_of(name) == device}
    found = []
    for pid in sorted(pids):
        with contextlib.suppress(psutil.NoSuchProcess):  # it ended meanwhile
            found.append(_process(psutil.Process(pid)))
    return found


def drivers():
    """`Process`es of vehicle drivers on this computer, without those in containers that have networks of their own."""
    found, network = [], os.readlink("/proc/self/ns/net")
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):  # it ended while we looked
            if _DRIVER in map(os.path.basename, process.cmdline()[:2]):
                place = network
                with contextlib.suppress(OSError):  # not readable for another user's process
                    place = os.readlink("/proc/%d/ns/net" % process.pid)
                found += [_process(process)] if place == network else []
    return found


def _process(process):
    """`Process` of a psutil.Process. Raises psutil.NoSuchProcess when it has ended."""
    try:
        environment = process.environ()
    except psutil.AccessDenied:
        environment = {}
    return Process(process.pid, tuple(process.cmdline()) or (process.name(),), environment)
