"""All data that virtual hosts receive and send passes a `Wire`, where seeded faults act on it."""

import fnmatch
import heapq
import math
import weakref
from collections import Counter, deque
from zlib import crc32

import numpy as np

MAX_HELD_BYTES = 256 * 1024  # per connection; the buffers of its socket would not take more either


class Wires:
    """The wires of all hosts of a lab, and the faults on them."""

    def __init__(self, seed=0):
        self._seed = seed
        self._wires = {}  # by channel
        self._late, self._late_count = [], 0
        self.due_s = math.inf  # release() has nothing to do before this time

    def wire(self, channel):
        """Wire of a channel: what one host sends or receives, e.g. risc1/navdata."""
        return self._wires.setdefault(channel, Wire(self, channel))

    def frames(self, channel):
        """Wire of a channel that carries Observations of motion capture."""
        return self._wires.setdefault(channel, Wire(self, channel, "frames"))

    def stream(self, channel, is_cable=False):
        """Stream of a channel: what one host writes to its TCP clients, e.g. risc1/control.  is_cable: no radio."""
        return self._wires.setdefault(channel, Stream(self, channel, is_cable))

    def add(self, event, bodies=None):
        """Let a FaultEvent act on the wires that match its channel, else its fault's; its start is a lab time.

        bodies: faults.Bodies, for faults that act on frames.  Raises ValueError like `fit`.
        """
        name, settings = event.fault, event.settings
        fit, make = self.fit(event, event.channel or settings.channel), event.module.make
        context, act = (bodies,) if "frames" in settings.acts_on else (), None
        for wire in fit:
            key = crc32(wire.channel.encode()), crc32(name.encode()), wire.added[name]
            wire.added[name] += 1
            if act is None or not settings.shared:
                rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=key))
                act = make(event.severity, rng, *context)
            wire.acting = (*wire.acting, (event.start_s, event.start_s + event.duration_s, act))

    def fit(self, event, channel):
        """Wires of a channel that a FaultEvent can act on.

        Raises ValueError if no wire matches, or none of a kind that the fault can act on.
        """
        name, acts_on, on_cables = event.fault, event.settings.acts_on, event.settings.cables
        if not channel:
            raise ValueError("fault %s acts on %s: name their channel" % (name, " and ".join(acts_on)))
        meant = self._meant(channel)
        fit = [wire for wire in meant if wire.kind in acts_on and (on_cables or not wire.is_cable)]
        if not fit:
            text = "fault %s acts on %s; %s: %s"
            raise ValueError(text % (name, " and ".join(acts_on), channel, meant[0].kind))
        if not hasattr(event.module, "make"):
            raise ValueError("fault %s: its module has no make(severity, rng)" % name)
        return fit

    def clear(self, channel="*"):
        """End the faults on the wires that match a channel; delayed data still arrives."""
        for wire in self._meant(channel):
            wire.acting = ()
            if wire.held:
                self.call_at(-math.inf, wire.flow)

    def release(self, now_s):
        """Deliver the delayed data that is due at lab time now_s."""
        while self._late and self._late[0][0] <= now_s:
            heapq.heappop(self._late)[2](now_s)
        self.due_s = self._late[0][0] if self._late else math.inf

    def call_at(self, due_s, function):
        """Let release() call function(time) once due_s is reached; calls with equal due_s keep their order."""
        self._late_count += 1
        heapq.heappush(self._late, (due_s, self._late_count, function))
        self.due_s = self._late[0][0]

    def statistics(self):
        """{channel: {"sent", "delivered", "later"}}: data that met acting faults; for streams also "cut"."""
        return {channel: dict(wire.counts) for channel, wire in self._wires.items() if wire.counts}

    def _meant(self, channel):
        wires = [wire for name, wire in self._wires.items() if fnmatch.fnmatchcase(name, channel)]
        if not wires:
            raise ValueError("no channel '%s'; known are: %s" % (channel, ", ".join(self._wires)))
        return wires


def _size(data):
    return len(data[0] if isinstance(data, tuple) else data)


class Wire:
    """One channel of datagrams, or of other self-contained items."""

    held = ()
    is_cable = False

    def __init__(self, wires, channel, kind="datagrams"):
        self._wires, self.channel, self.kind = wires, channel, kind
        self.acting = ()  # of (start, end, act)
        self.added = Counter()  # faults added so far, by name
        self.counts = Counter()

    def carry(self, datagram, address, now_s, deliver):
        """Pass a datagram on at lab time now_s. deliver: called with (datagram, address, time) when it arrives.

        Returns what deliver returned; True if it arrives later, False if it is lost.
        """
        in_force = self._in_force(now_s) if self.acting else ()
        if not in_force:
            return deliver(datagram, address, now_s)
        arriving = [(0.0, bytes(datagram) if isinstance(datagram, bytearray) else datagram)]
        for _, act in in_force:
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
        """[(end, act)] of the faults that act now; faults that are over are dropped."""
        self.acting = tuple([fault for fault in self.acting if now_s < fault[1]])
        return [(end_s, act) for start_s, end_s, act in self.acting if start_s <= now_s]

    def _deliver(self, due_s, now_s, deliver, data, address):
        if due_s <= now_s:
            return deliver(data, address, now_s)
        self._wires.call_at(due_s, lambda at_s: deliver(data, address, at_s))
        return True

    def _count(self, **counts):
        self.counts["sent"] += 1
        for name, count in counts.items():
            self.counts[name] += count


class Stream(Wire):
    """One channel of TCP connections."""

    def __init__(self, wires, channel, is_cable=False):
        super().__init__(wires, channel, "streams")
        self.is_cable = is_cable
        self.held = deque()  # data that a fault holds back, and the data behind it
        self._held_bytes = weakref.WeakKeyDictionary()  # bytes held, by connection
        self._newest_s = weakref.WeakKeyDictionary()  # connection -> when its newest data arrives

    def carry(self, data, connection, now_s, deliver, cut):
        """Pass on data that was written to a connection at lab time now_s, behind earlier data.

        data: bytes, or a tuple that begins with them.  deliver: called with (data, connection, time) when it arrives.
        cut: called with the connection if it is cut. Both may be called after the connection was closed.
        """
        if self._wires.due_s <= now_s:
            self._wires.release(now_s)
        self.held.append((data, connection, deliver, cut))
        self._held_bytes[connection] = self._held_bytes.get(connection, 0) + _size(data)
        if len(self.held) == 1:
            self.flow(now_s)

    def is_full(self, connection):
        """Whether so much of its data is held that a writer has to wait, as at a socket whose buffer is full."""
        return self._held_bytes.get(connection, 0) >= MAX_HELD_BYTES

    def forget(self, connection):
        """Drop the held data of a closed connection: a fault without end would keep it forever."""
        self.held = deque(item for item in self.held if item[1] is not connection)
        self._held_bytes.pop(connection, None)

    def flow(self, now_s):
        """Pass on the held data that no fault holds back any longer."""
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
                self.held.popleft()
                self._held_bytes[connection] -= _size(data)
                due_s = max(now_s + later_s, self._newest_s.get(connection, -math.inf))
                if faults:
                    self._newest_s[connection] = due_s
                    self._count(delivered=1, later=int(due_s > now_s))
                self._deliver(due_s, now_s, deliver, passing, connection)
