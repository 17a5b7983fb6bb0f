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

import io
import struct

import genpy
import numpy as np
from std_msgs.msg import Header

from risc_lab.compiled import compiled
from risc_msgs.msg import Controls, Cortex, Landmarks, Mocap_data, Trajectories

_HEADER = struct.Struct("<4I")  # seq, secs, nsecs, length of frame_id
_LENGTH = struct.Struct("<I")
_MOST_LAYOUTS = 64  # remembered for each kind of message; more sets of names than that are not of one flight


class Layout:
    """Where the numbers of a message stand on the wire, and where in the message's `data`."""

    def __init__(self, entries, template, places):
        """entries: names, or (name, number of markers) pairs.  template: the body with all numbers zero.

        places: {place in the body: (number of bytes, 0 for the numbers or 1 for what stands after all of them)}.
        """
        self.entries = entries
        self.template = np.frombuffer(template, np.uint8)
        spans, self.size = [], 0  # [bytes] of data
        for part in (0, 1):
            self.end_of_numbers = self.size
            for place in (place for place, (_, its_part) in places.items() if its_part == part):
                spans.append((place, places[place][0], self.size))
                self.size += places[place][0]
        # first byte in the body, number of bytes, first in data; the last one ends the body
        self.spans = np.array([*sorted(spans), (len(template), 0, 0)], np.intp)


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
    """What the kinds have in common. Numbers are views of `data`, an array of bytes: write into them, or read."""

    __slots__ = ("header", "layout", "data", "_body", "_views")
    _has_header = True
    _layouts = {}  # {key: Layout}; a key is the entries with their names as bytes. Each kind has its own
    _newest = None  # Layout of the newest message: nearly always that of the next one as well
    _flags = 0  # 1: a bool stands before the numbers of an entry
    _columns = 4  # float64 in a row
    _rest_type = bool  # of what stands after the numbers

    def __init_subclass__(cls, of, **options):
        super().__init_subclass__(**options)
        kind = {name: getattr(of, name) for name in ("_type", "_md5sum", "_full_text")}
        for name, value in kind.items():
            setattr(cls, name, value)
        cls.Raw = type(cls.__name__ + "Raw", (_Raw,), dict(kind, __slots__=()))
        cls._layouts = {}
        cls(()).deserialize(_serialised(cls(())))  # loads what is compiled, now

    def __init__(self, entries=None):
        """entries: their names (of Mocap_data (name, number of markers) pairs); None for one to deserialise."""
        self.header = Header()
        self.layout = self._body = self._views = None
        if entries is not None:
            self._adopt(self._layout_of(self._coded(entries, _encoded)))
            self.data[:] = 0

    @property
    def names(self):
        """Names of the entries, in their order."""
        return self.layout.entries

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
        """As genpy's; buff: bytes. Raises genpy.DeserializationError when they are no such message."""
        header = self.header
        try:
            header.seq, header.stamp.secs, header.stamp.nsecs, length = _HEADER.unpack_from(buff)
            begin = _HEADER.size + length
            header.frame_id = buff[_HEADER.size : begin].decode("utf-8", "rosmsg")
            if self.layout is None and self._newest is not None:
                self._adopt(self._newest)
            layout = self.layout
            if layout is None or not _unpack(buff, begin, layout.template, layout.spans, self.data):
                self._deserialize_anew(buff, begin)
        except struct.error as error:
            raise genpy.DeserializationError("%s of %d bytes: %s" % (self._type, len(buff), error)) from error
        return self

    def _deserialize_anew(self, buff, begin):
        layout = self._layout_of(self._key_of(memoryview(buff)[begin:]))
        self._adopt(layout)
        if not _unpack(buff[: begin + layout.template.size], begin, layout.template, layout.spans, self.data):
            raise struct.error("the entries are not whole")
        type(self)._newest = layout

    def _adopt(self, layout):
        self.layout, self._body, self._views = layout, None, None
        self.data = np.empty(layout.size, np.uint8)

    @classmethod
    def _layout_of(cls, key):
        layout = cls._layouts.get(key)
        if layout is None:
            while len(cls._layouts) >= _MOST_LAYOUTS:
                del cls._layouts[next(iter(cls._layouts))]
            body, places = _LENGTH.pack(len(key)), {}
            for entry in key:
                for constant, size, part in cls._parts(entry):
                    body += constant
                    places[len(body)] = size, part
                    body += bytes(size)
            layout = cls._layouts[key] = Layout(cls._coded(key, _decoded), body, places)
        return layout

    @classmethod
    def _key_of(cls, body):
        (count,) = _LENGTH.unpack_from(body)
        key, at = [], _LENGTH.size
        for _ in range(count):
            entry, at = cls._read(body, at)
            key.append(entry)
        if at > len(body):
            raise struct.error("an entry is cut short")
        return tuple(key)

    @staticmethod
    def _coded(entries, code):
        """The entries, or their key, with each name encoded or decoded."""
        return tuple([code(name) for name in entries])

    @classmethod
    def _parts(cls, entry):
        """(bytes before it, number of bytes, part of `Layout`) of what an entry of a key holds."""
        flag = [(_text(entry), 1, 1)] if cls._flags else []
        return [*flag, (b"" if flag else _text(entry), 8 * cls._columns, 0)]

    @classmethod
    def _read(cls, body, at):
        """(entry of a key, next place) at a place of a body."""
        name, at = _read_text(body, at)
        return name, at + cls._flags + 8 * cls._columns

    def _numbers(self):
        """(rows, columns) float64."""
        return self._both()[0]

    def _rest(self):
        """What stands after the numbers: (entries,)."""
        return self._both()[1]

    def _both(self):
        if self._views is None:
            end = self.layout.end_of_numbers
            numbers, rest = self.data[:end].view("<f8"), self.data[end:].view(self._rest_type)
            self._views = numbers.reshape(-1, self._columns), rest
        return self._views


def _serialised(message):
    buff = io.BytesIO()
    message.serialize(buff)
    return buff.getvalue()


def _encoded(name):
    return name.encode("utf-8")


def _decoded(name):
    # as genpy: a byte that is not UTF-8 is replaced, and logged once
    return name.decode("utf-8", "rosmsg")


def _text(name):
    return _LENGTH.pack(len(name)) + name


def _read_text(body, at):
    """(bytes of a text, next place) at a place of a body. Raises struct.error when it is cut short."""
    (length,) = _LENGTH.unpack_from(body, at)
    end = at + _LENGTH.size + length
    if end > len(body):
        raise struct.error("a name is cut short")
    return bytes(body[at + _LENGTH.size : end]), end


class ControlsArrays(FleetMessage, of=Controls):
    """Controls. `controls` (n, 4): phi, theta, psi [-], T [N], as the message says."""

    __slots__ = ()
    controls = property(FleetMessage._numbers)


class TrajectoriesArrays(FleetMessage, of=Trajectories):
    """Trajectories. `derivatives` (n, 3, 4): position, velocity, acceleration of x, y, z [m], psi [rad]."""

    __slots__ = ()
    _columns = 12

    @property
    def derivatives(self):
        return self._numbers().reshape(-1, 3, 4)


class LandmarksArrays(FleetMessage, of=Landmarks):
    """Landmarks. `positions_m` (n, 3) [m] cortex frame."""

    __slots__ = ()
    _columns = 3
    positions_m = property(FleetMessage._numbers)


class CortexArrays(FleetMessage, of=Cortex):
    """Cortex. `visible` (n,) bool; `states` (n, 12) in the units of the message: m, m/s, degrees, degrees/s."""

    __slots__ = ()
    _flags, _columns = 1, 12
    states = property(FleetMessage._numbers)
    visible = property(FleetMessage._rest)


class MocapArrays(FleetMessage, of=Mocap_data):
    """Mocap_data. `layout.entries`: (name, number of markers) of each body; `markers_m` (markers of all, 3) [m] cortex
    frame; `residuals` (bodies,), 0 in what our client publishes.
    """

    __slots__ = ()
    _columns, _rest_type = 3, "<f8"
    markers_m = property(FleetMessage._numbers)
    residuals = property(FleetMessage._rest)

    @property
    def names(self):
        return tuple(name for name, _ in self.layout.entries)

    @staticmethod
    def _coded(entries, code):
        return tuple([(code(name), count) for name, count in entries])

    @classmethod
    def _parts(cls, entry):
        name, count = entry
        return (_text(name), 8, 1), (_LENGTH.pack(count), 24 * count, 0)

    @classmethod
    def _read(cls, body, at):
        name, at = _read_text(body, at)
        (count,) = _LENGTH.unpack_from(body, at + 8)
        return (name, count), at + 8 + _LENGTH.size + 24 * count
