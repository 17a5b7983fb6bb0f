"""The messages of every frame as arrays: Cortex, Trajectories, Controls, Landmarks and Mocap_data of a whole fleet.

genpy makes an object of every entry and a Python float of every number. The classes here stand for the same messages:
same type, same MD5 sum, same bytes on the wire, so that a node may use them while others see ordinary messages. They
hold their numbers as arrays, copied from and to the wire by one compiled call for the whole message:

    rospy.Subscriber("/cortex_raw", CortexArrays, callback)   # message.names, message.visible, message.states
    message = ControlsArrays(names); message.controls[:] = ...; publisher.publish(message)

Where the numbers stand between the names (a `Layout`) is worked out once for each set of names, and checked byte for
byte at every message. A topic has one class in a process: rospy takes that of its first subscriber for all.

Between two frames caches go cold: what takes 1 us in a loop takes 10 when it is done once in 5 ms, so it is the number
of different things done that counts. Nodes that see every frame subscribe to `CortexArrays.Raw` (the bytes alone) and
let one CortexArrays of their own `deserialize` them. It overwrites its arrays in place as long as the names stay the
same, and makes new ones otherwise: code that keeps views of them compares `data`.
"""

import functools
import io
import struct
from operator import attrgetter
from typing import NamedTuple

import genpy
import numpy as np
from std_msgs.msg import Header

from risc_lab.compiled import compiled
from risc_msgs.msg import Controls, Cortex, Landmarks, Mocap_data, Trajectories

_HEADER = struct.Struct("<4I")  # seq, secs, nsecs, length of frame_id
_LENGTH = struct.Struct("<I")
_MOST_LAYOUTS = 256  # cached; one flight never has more sets of names


class Layout(NamedTuple):
    """Where the numbers of a message stand on the wire, and where in the message's `data`."""

    names: tuple[str, ...]
    entries: tuple[tuple[str, int], ...]  # name, rows of numbers
    template: np.ndarray  # the body with all numbers zero, bytes
    spans: np.ndarray  # first byte in the body, number of bytes, first in data; the last one ends the body
    end_of_numbers: int  # in data; what stands beside the numbers comes after all of them
    size: int  # of data [bytes]


@compiled
def _unpack(wire, start, template, spans, data):
    """Copy the numbers of the body at `start` to `data`; False when anything else differs from the template."""
    if len(wire) - start != template.size:
        return False
    at = 0
    for k in range(len(spans)):
        begin, count, to = spans[k]
        for i in range(at, begin):
            if wire[start + i] != template[i]:
                return False
        for i in range(count):
            data[to + i] = wire[start + begin + i]
        at = begin + count
    return True


@compiled
def _pack(data, spans, body):
    """Copy the numbers in `data` to their places in a body."""
    for k in range(len(spans)):
        begin, count, to = spans[k]
        for i in range(count):
            body[begin + i] = data[to + i]


class _Raw(genpy.Message):
    """The bytes of a message, in `buff`."""

    __slots__ = ("buff",)

    def deserialize(self, buff):
        """As genpy's."""
        self.buff = buff
        return self


class FleetMessage(genpy.Message):
    """Base class of the messages. Numbers are views of `data`, an array of bytes: write into them, or read."""

    __slots__ = ("header", "layout", "data", "_body", "_numbers", "_rest")
    _has_header = True
    # An entry on the wire: its name, what _beside says (a type of numpy), if _counted how many rows, rows of float64.
    _beside = ""
    _counted = False
    _columns = 4
    _newest = None  # Layout of the newest message: nearly always that of the next one as well

    def __init_subclass__(cls, of, **options):
        super().__init_subclass__(**options)
        kind = {name: getattr(of, name) for name in ("_type", "_md5sum", "_full_text")}
        for name, value in kind.items():
            setattr(cls, name, value)
        cls.Raw = type(cls.__name__ + "Raw", (_Raw,), dict(kind, __slots__=()))
        cls._beside_bytes = np.dtype(cls._beside).itemsize if cls._beside else 0
        wire = io.BytesIO()
        cls(()).serialize(wire)  # loads the compiled code, now
        cls(()).deserialize(wire.getvalue())

    def __init__(self, entries=None):
        """entries: their names (for Mocap_data: (name, number of markers) pairs); None: to be deserialised."""
        self.header = Header()
        self.layout = None
        if entries is not None:
            pairs = entries if self._counted else [(name, 1) for name in entries]
            self._adopt(self._layout_of(tuple([(name.encode("utf-8"), rows) for name, rows in pairs])))
            self.data[:] = 0

    @property
    def names(self):
        """Names of the entries, in their order."""
        return self.layout.names

    def serialize(self, buff):
        """As genpy's."""
        header, layout = self.header, self.layout
        frame_id = header.frame_id.encode("utf-8")
        if self._body is None:
            self._body = layout.template.copy()
        _pack(self.data, layout.spans, self._body)
        buff.write(_HEADER.pack(header.seq, header.stamp.secs, header.stamp.nsecs, len(frame_id)))
        buff.write(frame_id)
        buff.write(self._body.data)

    def deserialize(self, buff):
        """As genpy's; buff: bytes. Raises genpy.DeserializationError when they are not such a message."""
        header = self.header
        try:
            header.seq, header.stamp.secs, header.stamp.nsecs, length = _HEADER.unpack_from(buff)
            begin = _HEADER.size + length
            header.frame_id = buff[_HEADER.size : begin].decode("utf-8", "rosmsg")
            if self.layout is None and self._newest is not None:
                self._adopt(self._newest)
            layout = self.layout
            if layout is None or not _unpack(buff, begin, layout.template, layout.spans, self.data):
                layout = self._layout_of(self._key_of(memoryview(buff)[begin:]))
                self._adopt(layout)
                # genpy ignores what comes after the last entry
                _unpack(buff[: begin + layout.template.size], begin, layout.template, layout.spans, self.data)
                type(self)._newest = layout
        except struct.error as error:
            raise genpy.DeserializationError("%s of %d bytes: %s" % (self._type, len(buff), error)) from error
        return self

    def _adopt(self, layout):
        self.layout, self._body = layout, None
        self.data = np.empty(layout.size, np.uint8)
        self._numbers = self.data[: layout.end_of_numbers].view("<f8").reshape(-1, self._columns)
        self._rest = self.data[layout.end_of_numbers :].view(self._beside or "u1")

    @classmethod
    @functools.lru_cache(_MOST_LAYOUTS)
    def _layout_of(cls, key):
        """Layout of a key: the entries with their names as bytes."""
        body, beside, numbers = _LENGTH.pack(len(key)), [], []  # (place, number of bytes)
        for name, rows in key:
            body += _LENGTH.pack(len(name)) + name
            beside.append((len(body), cls._beside_bytes))
            body += bytes(cls._beside_bytes) + (_LENGTH.pack(rows) if cls._counted else b"")
            numbers.append((len(body), 8 * cls._columns * rows))
            body += bytes(numbers[-1][1])
        spans, size = [(len(body), 0, 0)], 0
        for place, count in numbers + beside:
            spans.append((place, count, size))
            size += count
        # as genpy: a byte that is not UTF-8 is replaced, and logged once
        entries = tuple([(name.decode("utf-8", "rosmsg"), rows) for name, rows in key])
        names, end_of_numbers = tuple([name for name, _ in entries]), sum([count for _, count in numbers])
        template = np.frombuffer(body, np.uint8)
        return Layout(names, entries, template, np.array(sorted(spans), np.intp), end_of_numbers, size)

    @classmethod
    def _key_of(cls, body):
        """Names as bytes and rows of the entries of a body. Raises struct.error for one that is cut short."""
        (count,) = _LENGTH.unpack_from(body)
        key, at, rows = [], _LENGTH.size, 1
        for _ in range(count):
            begin = at + _LENGTH.size
            at = begin + _LENGTH.unpack_from(body, at)[0]
            name = bytes(body[begin:at])
            at += cls._beside_bytes
            if cls._counted:
                (rows,) = _LENGTH.unpack_from(body, at)
                at += _LENGTH.size
            at += 8 * cls._columns * rows
            if at > len(body):
                raise struct.error("an entry is cut short")
            key.append((name, rows))
        return tuple(key)


_numbers, _rest = property(attrgetter("_numbers")), property(attrgetter("_rest"))


class ControlsArrays(FleetMessage, of=Controls):
    """Controls. `controls` (n, 4): phi, theta, psi [-], T [N], as the message says."""

    __slots__ = ()
    controls = _numbers


class TrajectoriesArrays(FleetMessage, of=Trajectories):
    """Trajectories. `derivatives` (n, 3, 4): position, velocity, acceleration of x, y, z [m], psi [rad]."""

    __slots__ = ()
    _columns = 12

    @property
    def derivatives(self):
        return self._numbers.reshape(-1, 3, 4)


class LandmarksArrays(FleetMessage, of=Landmarks):
    """Landmarks. `positions_m` (n, 3) [m] cortex frame."""

    __slots__ = ()
    _columns = 3
    positions_m = _numbers


class CortexArrays(FleetMessage, of=Cortex):
    """Cortex. `visible` (n,) bool; `states` (n, 12) in the units of the message: m, m/s, degrees, degrees/s."""

    __slots__ = ()
    _beside, _columns = "?", 12
    states, visible = _numbers, _rest


class MocapArrays(FleetMessage, of=Mocap_data):
    """Mocap_data. `layout.entries`: (name, number of markers) of each body; `markers_m` (markers of all, 3) [m] cortex
    frame; `residuals` (bodies,), 0 in what our client publishes.
    """

    __slots__ = ()
    _beside, _counted, _columns = "<f8", True, 3
    markers_m, residuals = _numbers, _rest
