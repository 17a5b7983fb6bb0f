"""The Cortex ethernet protocol (SDK2 family): datagrams to values and back. No sockets, no ROS.

One UDP datagram is one packet: u16 command, u16 payload length, payload. Everything is little-endian and packed.
Coordinates are as on the wire: millimetres in the mocap frame, Euler angles in degrees. A missing marker is NaN in the
values and 9999999.0 on the wire. Decodes every packet; encodes those that the virtual lab or a client sends.

Decoding is strict: every length and count is checked against the available bytes, and a datagram whose declared length
differs from its real one is refused with a MalformedPacketError. Names are opaque bytes on the wire; they become str as
UTF-8 with surrogate escapes, so that any name survives decoding and encoding.
"""

import math
import struct
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from risc_lab.compiled import compiled

MISSING_MM = 9999999.0  # exact in single precision; the SDK tests x only, hosts fill all three
MAX_DATAGRAM_BYTES = 65507  # what UDP over IPv4 can carry
MAX_PAYLOAD_BYTES = MAX_DATAGRAM_BYTES - 4
MAX_BODIES = 100  # size of the clients' tables
MAX_NAME_BYTES = 127  # clients keep names in 128 bytes, terminator included
MAX_FILE_NAME_BYTES = 255  # clients keep the capture file name in 256 bytes
MAX_DELAY_S = 10.0  # a larger delay is not plausible: counted as a fault, taken as 0

TAG_ENCODERS, TAG_RECORDING, TAG_LENSES = 11, 12, 13


class Command(IntEnum):
    """Command codes of the packet header."""

    HELLO_WORLD = 0
    ARE_YOU_THERE = 1
    HERE_I_AM = 2
    COMMENT = 3
    REQUEST_BODYDEFS = 10
    BODYDEFS = 11
    REQUEST_FRAME = 12
    FRAME_OF_DATA = 13
    GENERAL_REQUEST = 14
    GENERAL_REPLY = 15
    UNRECOGNIZED_REQUEST = 16
    PUSH_BASEPOSITION = 17
    UNRECOGNIZED_COMMAND = 0x5678


class MalformedPacketError(ValueError):
    """A datagram that breaks the protocol; the text says where."""


class PacketTooLargeError(ValueError):
    """Content that does not fit one datagram."""


class Identity(NamedTuple):
    """Identity of a program: name (at most 127 bytes) and (program id, major, minor, bugfix); id 1 is Cortex."""

    name: str
    version: tuple[int, int, int, int]


class BodyDef(NamedTuple):
    """Definition of one body: names in the order in which frames list the values; a root segment has parent -1."""

    name: str
    marker_names: Sequence[str]
    segments: Sequence[tuple[str, int]] = ()
    dof_names: Sequence[str] = ()


class BodyDefs(NamedTuple):
    """Answer to REQUEST_BODYDEFS."""

    bodies: Sequence[BodyDef]
    analog_channels: Sequence[str] = ()
    force_plates: int = 0


class BodyFrame(NamedTuple):
    """One body in a frame.

    markers_mm: (m, 3) float32, NaN rows are missing.   segments: (s, 7) float64 x, y, z [mm], ax, ay, az [deg], length
    [mm], relative to the parent.   dofs: (d,) float64, usually degrees.
    """

    name: str
    markers_mm: np.ndarray
    segments: np.ndarray
    dofs: np.ndarray


class Samples(NamedTuple):
    """A block of samples in the order of the wire, which the protocol does not document.

    values: analog (channels * samples,) int16; forces (plates * samples, 7) float32 x, y, z, fx, fy, fz, mz; encoders
    (encoders * samples,) float64.
    """

    channels: int
    samples: int
    values: np.ndarray


class Recording(NamedTuple):
    """Recording status: last_frame is 0 while the recording runs."""

    active: int
    first_frame: int
    last_frame: int
    file_name: str


class Frame(NamedTuple):
    """One frame of data. delay_s, encoders, recording and lenses are None when the packet lacks them.

    unidentified_mm: (u, 3) float32.   lenses: (bodies, 2) int32 zoom, focus.   other_tags: (tag, bytes) of unknown
    tags, in order.   faults: error texts of the optional items that were dropped while decoding.
    """

    number: int
    bodies: Sequence[BodyFrame]
    unidentified_mm: np.ndarray
    analog: Samples
    forces: Samples
    delay_s: float | None = None
    encoders: Samples | None = None
    recording: Recording | None = None
    lenses: np.ndarray | None = None
    other_tags: Sequence[tuple[int, bytes]] = ()
    faults: Sequence[str] = ()


class Packet(NamedTuple):
    """A decoded datagram. Type of content by command: Identity, BodyDefs, Frame, str (texts), else bytes."""

    command: int
    content: Identity | BodyDefs | Frame | str | bytes


_FRAME_OF_DATA = int(Command.FRAME_OF_DATA)  # struct is slow with enumerations
_HEADER = struct.Struct("<HH")
_FRAME_HEAD = struct.Struct("<HHii")
_I32, _F32 = struct.Struct("<i"), struct.Struct("<f")
_IDENTITY = struct.Struct("<128s4B")
_NO_SEGMENTS_NO_DOFS = bytes(8)


# --- encoding -----------------------------------------------------------------------------------------------------


def encode_packet(command, payload=b""):
    """Return header plus payload. Raises PacketTooLargeError when the payload does not fit one datagram."""
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise PacketTooLargeError(
            "packet %d has %d payload bytes, one datagram holds %d: send fewer bodies or markers"
            % (command, len(payload), MAX_PAYLOAD_BYTES)
        )
    return _HEADER.pack(command, len(payload)) + payload


def encode_identity(command, identity):
    """Encode HELLO_WORLD or HERE_I_AM."""
    return encode_packet(command, _IDENTITY.pack(_text(identity.name), *identity.version))


def encode_text(command, text):
    """Encode GENERAL_REQUEST or COMMENT."""
    return encode_packet(command, _text(text, MAX_PAYLOAD_BYTES - 1))


def encode_body_defs(body_defs):
    """Encode BODYDEFS. Raises ValueError if clients cannot hold it, PacketTooLargeError if it does not fit UDP."""
    _check_body_count(len(body_defs.bodies))
    parts = [_i32(len(body_defs.bodies))]
    for body in body_defs.bodies:
        parts += [_text(body.name), _names(body.marker_names), _i32(len(body.segments))]
        parts += [_text(name) + _i32(parent) for name, parent in body.segments]
        parts.append(_names(body.dof_names))
    parts += [_names(body_defs.analog_channels), _i32(body_defs.force_plates)]
    return encode_packet(Command.BODYDEFS, b"".join(parts))


class FrameEncoder:
    """Fast encoder for frames of one layout: names and counts are written once, each frame only adds numbers.

    layout: sequence of (body name, number of markers). mm_per_unit: unit of the coordinates given to encode().
    Raises ValueError (too many bodies, bad name), and PacketTooLargeError if even a frame without unidentified markers
    does not fit.
    """

    def __init__(self, layout, mm_per_unit=1.0):
        _check_body_count(len(layout))
        self._body_count = len(layout)
        self._mm_per_unit = mm_per_unit
        parts, starts, size = [_FRAME_HEAD.pack(Command.FRAME_OF_DATA, 0, 0, len(layout))], [], _FRAME_HEAD.size
        for name, count in layout:
            head = _text(name) + _i32(count)
            starts += range(size + len(head), size + len(head) + 12 * count, 12)
            parts += [head, bytes(12 * count), _NO_SEGMENTS_NO_DOFS]
            size += len(head) + 12 * count + len(_NO_SEGMENTS_NO_DOFS)
        self.marker_count = len(starts)
        self._starts = np.array(starts, dtype=np.int64)  # offset of each marker in the packet
        self._wire_mm = np.empty((len(starts), 3), "<f4")  # the markers as they go into the packet,
        self._wire_bytes = self._wire_mm.view(np.uint8)  # and their bytes
        self._bodies_end = size
        self._frame = bytearray(b"".join(parts) + self._end())
        self._packet = np.frombuffer(self._frame, np.uint8)
        _put_markers(np.empty((0, 3)), 1.0, self._starts, self._wire_mm, self._wire_bytes, self._packet)  # loads it

    def encode(self, number, markers, unidentified=None, delay_s=0.0, recording=None):
        """Encode one FRAME_OF_DATA packet.

        markers: (marker_count, 3) floats, bodies in layout order; a row that is not finite is a missing marker.
        unidentified: (u, 3) or None.   recording: Recording or None.
        Returns (bytearray packet, offset of its delay), so that set_delay() can enter the delay on sending.
        Raises PacketTooLargeError.
        """
        if markers.shape != self._wire_mm.shape:
            raise ValueError("the layout has %d markers, got %d" % (self.marker_count, len(markers)))
        _put_markers(markers, self._mm_per_unit, self._starts, self._wire_mm, self._wire_bytes, self._packet)
        packet, loose, item = self._frame[:], b"", b""
        if unidentified is not None and len(unidentified):
            loose = (unidentified * self._mm_per_unit).astype("<f4").tobytes()
        if recording is not None:
            *numbers, name = recording
            data = _i32(*numbers) + _text(name, MAX_FILE_NAME_BYTES)
            item = _i32(TAG_RECORDING, len(data)) + data
        if loose or item:
            packet[self._bodies_end :] = self._end(loose, item)
        _FRAME_HEAD.pack_into(packet, 0, _FRAME_OF_DATA, len(packet) - 4, number, self._body_count)
        delay_offset = len(packet) - len(item) - 4
        _F32.pack_into(packet, delay_offset, delay_s)
        return packet, delay_offset

    def _end(self, loose=b"", recording=b""):
        """Bytes after the bodies: unidentified markers, no analog samples or forces, a delay of 0, a recording item."""
        end, loose_count = _i32(len(loose) // 12) + loose + bytes(24) + recording, len(loose) // 12
        payload_bytes = self._bodies_end + len(end) - 4
        if payload_bytes > MAX_PAYLOAD_BYTES:
            raise PacketTooLargeError(
                "a frame of %d bodies, %d markers and %d unidentified markers needs %d payload bytes, one datagram"
                " holds %d: use fewer"
                % (self._body_count, self.marker_count, loose_count, payload_bytes, MAX_PAYLOAD_BYTES)
            )
        return end


@compiled
def _put_markers(markers, mm_per_unit, starts, wire_mm, wire_bytes, packet):
    """Write markers into a packet at starts, missing ones with the sentinel in every coordinate.

    wire_mm (m, 3) single precision and wire_bytes (m, 12) are the same memory.
    """
    for k in range(len(markers)):
        for axis in range(3):
            wire_mm[k, axis] = mm_per_unit * markers[k, axis]
        if not (math.isfinite(wire_mm[k, 0]) and math.isfinite(wire_mm[k, 1]) and math.isfinite(wire_mm[k, 2])):
            wire_mm[k, 0] = wire_mm[k, 1] = wire_mm[k, 2] = MISSING_MM
        for byte in range(12):
            packet[starts[k] + byte] = wire_bytes[k, byte]


def set_delay(packet, offset, delay_s):
    """Write delay_s [s] at `offset` of a packet made by FrameEncoder.encode."""
    _F32.pack_into(packet, offset, delay_s)


def _check_body_count(count):
    if count > MAX_BODIES:
        raise ValueError("%d bodies: the protocol's clients hold %d, use fewer" % (count, MAX_BODIES))


def _text(text, limit=MAX_NAME_BYTES):
    data = text.encode("utf-8", "surrogateescape")
    if len(data) > limit or b"\0" in data:
        raise ValueError("%r cannot be a name on the wire: at most %d bytes and no NUL" % (text, limit))
    return data + b"\0"


def _names(names):
    return _i32(len(names)) + b"".join(map(_text, names))


def _i32(*values):
    return struct.pack("<%di" % len(values), *values)


# --- decoding -----------------------------------------------------------------------------------------------------


def split_packet(datagram):
    """Return (command, payload bytes). Raises MalformedPacketError if declared and real lengths differ."""
    if len(datagram) < 4:
        raise MalformedPacketError("%d bytes are less than a header" % len(datagram))
    command, length = _HEADER.unpack_from(datagram)
    came = len(datagram) - 4
    if length != came:
        raise MalformedPacketError("command %d declares %d payload bytes, %d came" % (command, length, came))
    return command, bytes(datagram[4:])


def decode_packet(datagram):
    """Decode a packet of any command. Raises MalformedPacketError."""
    command, payload = split_packet(datagram)
    decoder = _DECODERS.get(command)
    return Packet(command, payload if decoder is None else decoder(payload))


def decode_identity(payload):
    """Decode Identity; bytes after the first 132 are ignored (later versions), a name without end is cut at 127."""
    name, *version = _IDENTITY.unpack(_Reader(payload).take(_IDENTITY.size, "identity"))
    return Identity(_str(name[:MAX_NAME_BYTES].split(b"\0", 1)[0]), tuple(version))


def decode_text(payload):
    """Decode the text of a GENERAL_REQUEST or COMMENT; bytes after the terminator are ignored."""
    return _Reader(payload).text("text", len(payload))


def decode_body_defs(payload):
    """Decode BodyDefs; bytes after the number of force plates belong to later versions and are ignored."""
    reader = _Reader(payload)
    bodies = [
        BodyDef(
            reader.text("body name"),
            reader.names("marker"),
            [(reader.text("segment name"), reader.i32("segment parent")) for _ in range(reader.count("segments", 5))],
            reader.names("dof"),
        )
        for _ in range(reader.count("bodies", 13, MAX_BODIES))
    ]
    return BodyDefs(bodies, reader.names("analog channel"), reader.count("force plates", 0))


def decode_frame(payload):
    """Decode Frame. The sections up to the forces must be valid; faulty optional items are dropped, see `faults`."""
    reader = _Reader(payload)
    number = reader.i32("frame number")
    bodies = [
        BodyFrame(
            reader.text("body name"), reader.markers("markers"), reader.rows("segments"), reader.rows("dofs", 1).ravel()
        )
        for _ in range(reader.count("bodies", 13, MAX_BODIES))
    ]
    unidentified = reader.markers("unidentified markers")
    analog = reader.samples("analog", "<i2", 1)
    forces = reader.samples("force", "<f4", 7)

    delay_s, items, other_tags, faults = None, {}, [], []
    while reader.left > 4:
        try:
            if delay_s is None:
                reader.i32("word before the delay")
                delay_s = reader.f32("delay")
                if not 0.0 <= delay_s <= MAX_DELAY_S:  # also false for NaN
                    bad, delay_s = delay_s, 0.0
                    raise MalformedPacketError("a delay of %g s" % bad)
                continue
            tag, length = reader.i32("tag"), reader.i32("tag length")
            if length < 0:
                reader.take(reader.left)  # the items after it cannot be found
                raise MalformedPacketError("tag %d of %d bytes" % (tag, length))
            window = reader.take(length)
            if tag in _TAG_DECODERS:
                items[tag] = _TAG_DECODERS[tag](_Reader(window), len(bodies))
            else:
                other_tags.append((tag, window))
        except MalformedPacketError as error:
            faults.append(str(error))
    found = (items.get(tag) for tag in (TAG_ENCODERS, TAG_RECORDING, TAG_LENSES))
    return Frame(number, bodies, unidentified, analog, forces, delay_s, *found, other_tags, faults)


def _str(data):
    return data.decode("utf-8", "surrogateescape")


class _Reader:
    """Reads values from the front of `data`; raises MalformedPacketError when the bytes run out."""

    def __init__(self, data):
        self._data = data
        self._at = 0

    @property
    def left(self):
        return len(self._data) - self._at

    def take(self, size, what="block"):
        at = self._at
        if size > self.left:
            left, self._at = self.left, len(self._data)  # nothing more can be read
            raise MalformedPacketError("%s at payload byte %d: %d bytes needed, %d left" % (what, at, size, left))
        self._at = at + size
        return self._data[at : self._at]

    def i32(self, what):
        return _I32.unpack(self.take(4, what))[0]

    def f32(self, what):
        return _F32.unpack(self.take(4, what))[0]

    def text(self, what, limit=MAX_NAME_BYTES):
        end = self._data.find(b"\0", self._at)
        if end < 0 or end - self._at > limit:
            raise MalformedPacketError("%s at payload byte %d has no end within %d bytes" % (what, self._at, limit))
        return _str(self.take(end + 1 - self._at)[:-1])

    def count(self, what, smallest_bytes, limit=None):
        """Read a count of items of at least smallest_bytes each; refuse it if the bytes left cannot hold them."""
        count = self.i32("number of " + what)
        if count < 0 or count * smallest_bytes > self.left or (limit is not None and count > limit):
            raise MalformedPacketError("%d %s in the %d bytes left" % (count, what, self.left))
        return count

    def names(self, what):
        return [self.text(what + " name") for _ in range(self.count(what + " names", 1))]

    def numbers(self, dtype, count):
        return np.frombuffer(self.take(count * np.dtype(dtype).itemsize, "numbers"), dtype)

    def rows(self, what, width=7, dtype="<f8"):
        """Read a count and that number of rows."""
        count = self.count(what, width * np.dtype(dtype).itemsize)
        return self.numbers(dtype, width * count).reshape(-1, width)

    def markers(self, what):
        markers = self.rows(what, 3, "<f4").copy()
        # The sentinel is tested in x only, as in the SDK; NaN and infinities count as missing, too
        markers[~(np.isfinite(markers).all(axis=1) & (markers[:, 0] != MISSING_MM))] = np.nan
        return markers

    def samples(self, what, dtype, width):
        channels, samples = self.count(what + " channels", 0), self.count(what + " samples", 0)
        values = self.numbers(dtype, width * channels * samples)
        return Samples(channels, samples, values.reshape(-1, width) if width > 1 else values)


def _decode_encoders(reader, _body_count):
    encoders = reader.samples("encoder", "<f8", 1)
    if reader.left:
        raise MalformedPacketError("%d bytes behind the encoders" % reader.left)
    return encoders


def _decode_recording(reader, _body_count):
    numbers = [reader.i32(what) for what in ("recording", "first frame", "last frame")]
    return Recording(*numbers, _str(reader.take(reader.left).split(b"\0", 1)[0]))


_TAG_DECODERS = {
    TAG_ENCODERS: _decode_encoders,
    TAG_RECORDING: _decode_recording,
    TAG_LENSES: lambda reader, body_count: reader.numbers("<i4", 2 * body_count).reshape(-1, 2),
}
_DECODERS = {
    Command.HELLO_WORLD: decode_identity,
    Command.HERE_I_AM: decode_identity,
    Command.COMMENT: decode_text,
    Command.BODYDEFS: decode_body_defs,
    Command.FRAME_OF_DATA: decode_frame,
    Command.GENERAL_REQUEST: decode_text,
}
