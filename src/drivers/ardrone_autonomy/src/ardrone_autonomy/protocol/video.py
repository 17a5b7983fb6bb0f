"""Video framing of the aircraft: PaVE headers around the pictures of the TCP stream, port 5555.

Every picture is a header ("PaVE", little-endian, 64 bytes in early firmware, 68 later; its length is in its own size
field) and a payload: one access unit of H.264 Annex B.  The aircraft sends as soon as a client connects and drops
pictures for a slow client; a client that joins in the middle waits for a picture of type IDR, which carries SPS and
PPS.

Reading: `parse_header` reads one header; `StreamParser` cuts a byte stream into `Packet`s and resynchronises after
anything that is not PaVE; `FrameAssembler` joins pictures that come in several packets.
Writing: `pack_header`.

No received data raises an exception, except in parse_header: the parser drops and counts what it cannot use.
"""

import contextlib
import struct
from collections import namedtuple
from enum import IntEnum, IntFlag

MAGIC = b"PaVE"
VERSION = 2
MIN_HEADER_BYTES = 64
MAX_HEADER_BYTES = 256  # a header with a larger size field is refused
MAX_PAYLOAD_BYTES = 1 << 20  # the largest pictures seen have 19 kB, 720p about ten times that
MAX_SIDE_PX = 4096

_FIELDS = struct.Struct("<4sBBHI4H2I4B2IH4BHI")


class PaveError(ValueError):
    """Bytes that are not a valid PaVE header."""


# Codec of the payload; MPEG4_AVC is H.264, which an AR.Drone 2.0 sends.
Codec = IntEnum("Codec", "UNKNOWN VLIB P264 MPEG4_VISUAL MPEG4_AVC", start=0)
# Type of a picture: IDR decodes by itself, with SPS and PPS in front; HEADERS is SPS and PPS only.
FrameType = IntEnum("FrameType", "UNKNOWN IDR I P HEADERS", start=0)


class Control(IntFlag):
    """Bits of the control field."""

    ADVERTISEMENT = 1  # announces a picture that is not sent: no payload follows
    LAST_FRAME = 2  # the stream ends here


class PaveHeader(
    namedtuple(
        "PaveHeader",
        "version codec header_bytes payload_bytes encoded_width_px encoded_height_px display_width_px "
        "display_height_px frame_number timestamp_ms total_chunks chunk_index frame_type control stream_position_low "
        "stream_position_high stream_id total_slices slice_index sps_bytes pps_bytes reserved advertised_bytes",
    )
):
    """All fields of a header, in the order of the wire, as plain ints (timestamp_ms: the aircraft's clock)."""

    __slots__ = ()

    @property
    def encoded_px(self):
        """(width, height) of the decoded picture; H.264 works in blocks of 16."""
        return self.encoded_width_px, self.encoded_height_px

    @property
    def display_px(self):
        """(width, height) of the part to be shown, the top left of the decoded picture."""
        return self.display_width_px, self.display_height_px

    @property
    def following_bytes(self):
        """Number of payload bytes that follow the header."""
        return 0 if self.control & Control.ADVERTISEMENT else self.payload_bytes

    @property
    def is_first_part(self):
        """Whether this is the first (or only) packet of its picture."""
        return self.chunk_index == 0 and self.slice_index == 0

    @property
    def is_last_part(self):
        """Whether this is the last (or only) packet of its picture."""
        return self.chunk_index + 1 >= self.total_chunks and self.slice_index + 1 >= self.total_slices


Packet = namedtuple("Packet", "header payload")  # PaveHeader, bytes


# --- headers ---------------------------------------------------------------------------------------------------------
def parse_header(data, offset=0):
    """Return the PaveHeader at an offset of a bytes-like object.

    Needs MIN_HEADER_BYTES there, although header_bytes may be more.  PaveError when there is no valid header.
    """
    if len(data) - offset < MIN_HEADER_BYTES:
        raise PaveError("a PaVE header has at least %d bytes, got %d" % (MIN_HEADER_BYTES, max(0, len(data) - offset)))
    magic, *fields = _FIELDS.unpack_from(data, offset)
    if magic != MAGIC:
        raise PaveError("not a PaVE header: it begins with %r" % magic)
    header = PaveHeader._make(fields)
    if not MIN_HEADER_BYTES <= header.header_bytes <= MAX_HEADER_BYTES:
        raise PaveError("a PaVE header of %d bytes" % header.header_bytes)
    if header.payload_bytes > MAX_PAYLOAD_BYTES:
        raise PaveError("a picture of %d bytes, at most %d are accepted" % (header.payload_bytes, MAX_PAYLOAD_BYTES))
    if max(header.encoded_px + header.display_px) > MAX_SIDE_PX:
        raise PaveError("a picture of %d x %d px, shown as %d x %d" % (header.encoded_px + header.display_px))
    return header


def pack_header(header):
    """Encode a header to header_bytes bytes, padded with zeros. struct.error when a field is out of range."""
    return _FIELDS.pack(MAGIC, *header).ljust(header.header_bytes, b"\0")


# --- client side -----------------------------------------------------------------------------------------------------
class StreamParser:
    """Cuts the bytes of a TCP stream into Packets, regardless of how the network has split them.

    A packet is returned as soon as its last byte arrives: it does not wait for the next header.  Anything that is not
    PaVE is skipped up to the next valid header.  If a payload contains a valid header of the same stream, its announced
    length was too large: the packet is dropped and parsing goes on at the inner header, so that a damaged length costs
    only one picture.
    """

    def __init__(self):
        self.packets = 0  # returned packets
        self.bad_headers = 0  # "PaVE" without a valid header
        self.broken_payloads = 0  # payloads that were announced too long
        self.skipped_bytes = 0  # bytes that belong to no packet
        self._buffer = bytearray()
        self._searched = 0  # no valid header lies between the one at the beginning and here

    def reset(self):
        """Forget the bytes of a connection that has ended."""
        self._buffer.clear()
        self._searched = 0

    def feed(self, data):
        """Add bytes; return the list of Packets that they complete, in order."""
        self._buffer += data
        packets = []
        while (header := self._find_header()) is not None:
            begin, end = header.header_bytes, header.header_bytes + header.following_bytes
            inner = self._find_inner_header(header, end)
            if inner is None or (inner == 0 and len(self._buffer) < end):
                break
            if inner:
                self.broken_payloads += 1
                self._skip(inner)
                continue
            packets.append(Packet(header, bytes(self._buffer[begin:end])))
            self.packets += 1
            self._remove(end)
        return packets

    def _find_header(self):
        """Return the next valid header and discard all bytes before it; None: more bytes are needed."""
        buffer = self._buffer
        while (begin := buffer.find(MAGIC)) >= 0:
            self._skip(begin)
            if len(buffer) < MIN_HEADER_BYTES:
                return None
            try:
                return parse_header(buffer)
            except PaveError:
                self.bad_headers += 1
                self._skip(len(MAGIC))
        # The buffer may end with the beginning of the magic
        self._skip(len(buffer) - next((n for n in (3, 2, 1) if buffer.endswith(MAGIC[:n])), 0))
        return None

    def _find_inner_header(self, header, end):
        """Return the position of another valid header inside the payload; 0: none, None: more bytes are needed.

        Bytes that have been searched are not searched again: a payload may arrive in as many pieces as it has bytes.
        """
        buffer = self._buffer
        begin = buffer.find(MAGIC, max(self._searched, header.header_bytes), end)
        while begin >= 0:
            self._searched = begin
            if len(buffer) < begin + MIN_HEADER_BYTES:
                return None
            with contextlib.suppress(PaveError):
                inner = parse_header(buffer, begin)
                if (inner.version, inner.codec) == (header.version, header.codec):
                    return begin
            begin = buffer.find(MAGIC, begin + len(MAGIC), end)
        self._searched = max(self._searched, min(len(buffer), end) - len(MAGIC) + 1)  # a magic may be cut off here
        return 0

    def _skip(self, count):
        self.skipped_bytes += count
        if count:
            self._remove(count)

    def _remove(self, count):
        del self._buffer[:count]
        self._searched = 0


class FrameAssembler:
    """Joins the packets of one picture: with some settings the aircraft sends pictures in chunks or slices."""

    def __init__(self):
        self.incomplete = 0  # pictures with a missing part, or too large
        self._parts, self._bytes = [], 0  # Packets of one picture, from its first part on, and their payload size

    def add(self, packet):
        """Add a Packet; return the Packet of the whole picture (header of its first part), None until complete."""
        header = packet.header
        if not (self._parts and self._continues(header)):
            self.incomplete += bool(self._parts)
            self._parts, self._bytes = [], 0
            if not header.is_first_part:
                return None
        self._parts.append(packet)
        self._bytes += len(packet.payload)
        if self._bytes > MAX_PAYLOAD_BYTES:  # 65536 parts of this size would be 64 GB
            self.incomplete += 1
            self._parts = []
            return None
        if not header.is_last_part:
            return None
        parts, self._parts = self._parts, []
        if len(parts) == 1:
            return packet
        payload = b"".join(part.payload for part in parts)
        return Packet(parts[0].header._replace(payload_bytes=len(payload)), payload)

    def _continues(self, header):
        last = self._parts[-1].header
        return (header.frame_number, header.stream_id) == (last.frame_number, last.stream_id) and (
            (header.slice_index, header.chunk_index)
            in ((last.slice_index, last.chunk_index + 1), (last.slice_index + 1, 0))
        )
