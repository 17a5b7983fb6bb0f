"""Faults on the wire: all that virtual hosts hear and say passes a `Wire`, where seeded faults act on it.

A fault is a module here with
    make    (severity, rng) -> act; act(data, now_s) -> the (later_s, data) pairs that arrive in place of a datagram:
            none when it is lost. rng: numpy Generator that belongs to this fault on this wire.
            Of a stream (TCP) data is what was written at once, and its order is kept. What is lost comes when the fault
            is over, as TCP sends it again; None: the connection is cut.
and its YAML file (config/faults/NAME.yaml) holds the fields of `FaultSettings`. One from elsewhere is faults/NAME.py
and faults/NAME.yaml in a folder of RISC_MAAP_MEMBERS (see risc_lab.registry).
"""

import fnmatch
import heapq
import math
import weakref
from collections import Counter
from dataclasses import dataclass
from typing import Literal
from zlib import crc32

import numpy as np

from risc_lab.lab.yaml_reader import load_yaml
from risc_lab.registry import Registry
from risc_lab.settings import NotNegative, Settings, settings_from

REGISTRY = Registry("faults", __name__)


@dataclass(frozen=True)
class FaultSettings(Settings):
    """What a member's YAML file says."""

    severity: tuple[float, float]  # least and greatest
    acts_on: tuple[Literal["datagrams", "streams"], ...] = ("datagrams",)


@dataclass(frozen=True)
class WireFault(Settings):
    """A fault that acts for a time on some channels. Raises ValueError for what cannot be."""

    fault: str  # name of the member
    channel: str  # of `Wires.wire`, e.g. risc1/navdata; with * and ? it means several, e.g. risc1/*, */commands
    severity: float = 1.0
    start_s: float = 0.0  # lab time
    duration_s: NotNegative = math.inf

    def __post_init__(self):
        super().__post_init__()
        low, high = self.settings.severity
        if not low <= self.severity <= high:
            raise ValueError("%s: severity must be in [%g, %g], found %r" % (self.fault, low, high, self.severity))
        if not math.isfinite(self.start_s):
            raise ValueError("%s: 'start_s' must be finite, found %r" % (self.fault, self.start_s))

    @property
    def settings(self):
        """FaultSettings of its member."""
        return REGISTRY.settings(self.fault, FaultSettings)


@dataclass(frozen=True)
class _FaultFile(Settings):
    faults: tuple[WireFault, ...]


def load_wire_faults(path):
    """WireFaults of a YAML file: its list `faults`, with the fields of WireFault. Raises ValueError."""
    return settings_from(_FaultFile, load_yaml(path), str(path)).faults


class Wires:
    """The wires of all hosts of a lab, and what acts on them."""

    def __init__(self, seed=0):
        self._seed = seed
        self._wires = {}  # by channel
        self._late, self._late_count = [], 0
        self.due_s = math.inf  # release() has nothing to do before this time

    def wire(self, channel):
        """Wire of a channel: one direction of what one host says or hears, e.g. risc1/navdata."""
        return self._wires.setdefault(channel, Wire(self, channel))

    def stream(self, channel):
        """Stream of a channel: what one host writes to its TCP clients, e.g. risc1/control."""
        return self._wires.setdefault(channel, Stream(self, channel))

    def add(self, fault):
        """Let a WireFault act on the wires that its channel means.

        Raises ValueError when there are none, or none of a kind that the fault can act on.
        """
        meant = self._meant(fault.channel)
        fit = [wire for wire in meant if wire.kind in fault.settings.acts_on]
        if not fit:
            raise ValueError(
                "fault %s acts on %s; %s: %s"
                % (fault.fault, " and ".join(fault.settings.acts_on), fault.channel, meant[0].kind)
            )
        make = getattr(REGISTRY.module(fault.fault), "make", None)
        if make is None:
            raise ValueError("fault %s: its module has no make(severity, rng)" % fault.fault)
        for wire in fit:
            key = crc32(wire.channel.encode()), crc32(fault.fault.encode()), wire.added[fault.fault]
            wire.added[fault.fault] += 1
            act = make(fault.severity, np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=key)))
            wire.acting = (*wire.acting, (fault.start_s, fault.start_s + fault.duration_s, act))

    def clear(self, channel="*"):
        """End the faults of the wires that this means; what is late still arrives."""
        for wire in self._meant(channel):
            wire.acting = ()
            if wire.held:
                self.call_at(-math.inf, wire.flow)

    def release(self, now_s):
        """Deliver what was late and is due at lab time now_s."""
        while self._late and self._late[0][0] <= now_s:
            heapq.heappop(self._late)[2](now_s)
        self.due_s = self._late[0][0] if self._late else math.inf

    def call_at(self, due_s, function):
        """Let release() call a function with the time, once it is that late; those of equal times keep their order."""
        self._late_count += 1
        heapq.heappush(self._late, (due_s, self._late_count, function))
        self.due_s = self._late[0][0]

    def statistics(self):
        """{channel: {"sent", "delivered", "later"}}: what faults saw and what became of it; of streams also "cut"."""
        return {channel: dict(wire.counts) for channel, wire in self._wires.items() if wire.counts}

    def _meant(self, channel):
        wires = [wire for name, wire in self._wires.items() if fnmatch.fnmatchcase(name, channel)]
        if not wires:
            raise ValueError("no channel '%s'; known are: %s" % (channel, ", ".join(self._wires)))
        return wires


class Wire:
    """One channel of datagrams."""

    kind = "datagrams"
    held = ()

    def __init__(self, wires, channel):
        self._wires, self.channel = wires, channel
        self.acting = ()  # of (start, end, act)
        self.added = Counter()  # faults so far
        self.counts = Counter()

    def carry(self, datagram, address, now_s, deliver):
        """Let a datagram pass at lab time now_s. deliver: called with (datagram, address, time) when it arrives.

        Returns what deliver said, True for what arrives later, False for what is lost.
        """
        if not self.acting:
            return deliver(datagram, address, now_s)
        arriving = [(0.0, bytes(datagram) if isinstance(datagram, bytearray) else datagram)]
        for _, act in self._in_force(now_s):
            arriving = [
                (before_s + later_s, data)
                for before_s, passing in arriving
                for later_s, data in act(passing, now_s + before_s)
            ]
        result = False
        for later_s, data in arriving:
            result = self._deliver(now_s + later_s, now_s, deliver, data, address)
        self._count(delivered=len(arriving), later=sum(later_s > 0.0 for later_s, _ in arriving))
        return result

    def _in_force(self, now_s):
        """[(end, act)] of the faults that act now; those that are over are forgotten."""
        self.acting = tuple(fault for fault in self.acting if now_s < fault[1])
        return [(end_s, act) for start_s, end_s, act in self.acting if start_s <= now_s]

    def _deliver(self, due_s, now_s, deliver, data, address):
        if due_s <= now_s:
            return deliver(data, address, now_s)
        self._wires.call_at(due_s, lambda at_s: deliver(data, address, at_s))
        return True

    def _count(self, **counts):
        self.counts.update(sent=1, **counts)


class Stream(Wire):
    """One channel of TCP connections."""

    kind = "streams"

    def __init__(self, wires, channel):
        super().__init__(wires, channel)
        self.held = []  # what a fault keeps from passing, and what comes behind it
        self._newest_s = weakref.WeakKeyDictionary()  # connection -> when what was written last arrives

    def carry(self, data, connection, now_s, deliver, cut):
        """Let what was written to a connection pass at lab time now_s, behind what was written before.

        deliver: called with (data, connection, time) when it arrives.  cut: called with the connection if it is cut.
        Both may be called when the connection has been closed.
        """
        if self._wires.due_s <= now_s:
            self._wires.release(now_s)
        self.held.append((data, connection, deliver, cut))
        if len(self.held) == 1:
            self.flow(now_s)

    def forget(self, connection):
        """Drop what is held of a connection that has been closed: a fault without end would keep it for ever."""
        self.held = [item for item in self.held if item[1] is not connection]

    def flow(self, now_s):
        """Let pass what is held, as far as it may now."""
        while self.held:
            data, connection, deliver, cut = self.held[0]
            faults, later_s, passing = self._in_force(now_s), 0.0, data
            for end_s, act in faults:
                arriving = act(passing, now_s + later_s)
                if arriving is None:
                    self.forget(connection)
                    self._count(cut=1)
                    cut(connection)
                    break
                if not arriving:
                    self._wires.call_at(end_s, self.flow)
                    return
                later_s, passing = later_s + arriving[0][0], arriving[0][1]
            else:
                del self.held[0]
                due_s = max(now_s + later_s, self._newest_s.get(connection, -math.inf))
                if faults:
                    self._newest_s[connection] = due_s
                    self._count(delivered=1, later=int(due_s > now_s))
                self._deliver(due_s, now_s, deliver, passing, connection)
