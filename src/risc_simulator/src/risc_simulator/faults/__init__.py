"""Faults on the wire: every datagram of every virtual host passes a `Wire`, where seeded faults act on it.

A fault is a module here with
    make    (severity, rng) -> act; act(datagram, now_s) -> the (later_s, datagram) pairs that arrive in its place:
            none when it is lost. rng: numpy Generator that belongs to this fault on this wire.
and its YAML file (config/faults/NAME.yaml) says what its severity may be. One from elsewhere is faults/NAME.py and
faults/NAME.yaml in a folder of RISC_MAAP_MEMBERS (see risc_lab.registry).
"""

import fnmatch
import heapq
import math
from collections import Counter
from dataclasses import dataclass
from zlib import crc32

import numpy as np

from risc_lab.lab.yaml_reader import Section, load_yaml
from risc_lab.registry import Registry

REGISTRY = Registry("faults", __name__)


@dataclass(frozen=True)
class WireFault:
    """A fault that acts for a time on some channels. Raises ValueError for what cannot be."""

    fault: str  # name of the member
    channel: str  # of `Wires.wire`, e.g. risc1/navdata; with * and ? it means several, e.g. risc1/*, */commands
    severity: float = 1.0
    start_s: float = 0.0  # lab time
    duration_s: float = math.inf

    def __post_init__(self):
        low, high = Section(REGISTRY.settings(self.fault), "fault %s" % self.fault).vector("severity", 2)
        if not low <= self.severity <= high:
            raise ValueError("%s: severity must be in [%g, %g], found %r" % (self.fault, low, high, self.severity))
        if not (math.isfinite(self.start_s) and self.duration_s >= 0.0):
            raise ValueError(
                "%s: a finite start and a duration that is not negative are needed, found %r" % (self.fault, self)
            )


def load_wire_faults(path):
    """WireFaults of a YAML file: its list `faults`, with the fields of WireFault. Raises ValueError."""
    root = Section(load_yaml(path), str(path))
    faults = [_wire_fault(section) for section in root.sections("faults")]
    root.done()
    return faults


def _wire_fault(section):
    values = {key: section.number(key) for key in ("severity", "start_s", "duration_s") if key in section.keys()}
    fault = WireFault(section.text("fault"), section.text("channel"), **values)
    section.done()
    return fault


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

    def add(self, fault):
        """Let a WireFault act on the wires that its channel means. Raises ValueError when there are none."""
        wires = self._meant(fault.channel)
        make = getattr(REGISTRY.module(fault.fault), "make", None)
        if make is None:
            raise ValueError("fault %s: its module has no make(severity, rng)" % fault.fault)
        for wire in wires:
            key = crc32(wire.channel.encode()), crc32(fault.fault.encode()), wire.added[fault.fault]
            wire.added[fault.fault] += 1
            rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=key))
            act = make(fault.severity, rng)
            wire.acting = (*wire.acting, (fault.start_s, fault.start_s + fault.duration_s, act))

    def clear(self, channel="*"):
        """End the faults of the wires that this means; what is late still arrives."""
        for wire in self._meant(channel):
            wire.acting = ()

    def release(self, now_s):
        """Deliver what was late and is due at lab time now_s."""
        while self._late and self._late[0][0] <= now_s:
            _, _, deliver, datagram, address = heapq.heappop(self._late)
            deliver(datagram, address, now_s)
        self.due_s = self._late[0][0] if self._late else math.inf

    def statistics(self):
        """{channel: {"sent", "delivered", "later"}}: datagrams that faults saw, what became of them, for JSON."""
        return {channel: dict(wire.counts) for channel, wire in self._wires.items() if wire.counts}

    def _meant(self, channel):
        wires = [wire for name, wire in self._wires.items() if fnmatch.fnmatchcase(name, channel)]
        if not wires:
            raise ValueError("no channel '%s'; known are: %s" % (channel, ", ".join(self._wires)))
        return wires

    def _delay(self, due_s, deliver, datagram, address):
        self._late_count += 1  # equal times keep their order
        heapq.heappush(self._late, (due_s, self._late_count, deliver, datagram, address))
        self.due_s = self._late[0][0]


class Wire:
    """One channel."""

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
        self.acting = tuple(fault for fault in self.acting if now_s < fault[1])
        arriving = [(0.0, bytes(datagram) if isinstance(datagram, bytearray) else datagram)]
        for start_s, _, act in self.acting:
            if start_s <= now_s:
                arriving = [
                    (before_s + later_s, data)
                    for before_s, passing in arriving
                    for later_s, data in act(passing, now_s + before_s)
                ]
        result = False
        for later_s, data in arriving:
            if later_s > 0.0:
                self._wires._delay(now_s + later_s, deliver, data, address)
                result = True
            else:
                result = deliver(data, address, now_s)
        self.counts["sent"] += 1
        self.counts["delivered"] += len(arriving)
        self.counts["later"] += sum(later_s > 0.0 for later_s, _ in arriving)
        return result
