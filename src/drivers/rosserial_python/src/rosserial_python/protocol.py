"""Packets of rosserial (protocol of ROS hydro and later) to bytes and back. No ROS, no ports.

Packet: 0xFF 0xFE, length (2), its checksum, topic id (2), payload, checksum of topic id and payload; numbers
little-endian. A checksum is 255 minus the sum of the bytes modulo 256: one damaged packet in 256 passes it, so the
users of a payload check it as well.
"""

import enum
import re
import struct
from typing import NamedTuple

SYNC, VERSION = 0xFF, 0xFE
_HEAD = bytes((SYNC, VERSION))
_HEAD_BYTES, _TAIL_BYTES = 7, 1
OVERHEAD = _HEAD_BYTES + _TAIL_BYTES  # [bytes] of a packet besides its payload
MOST_BYTES = 0xFFFF  # largest payload that the length field can hold
FIRST_TOPIC = 100  # ids below are the protocol's own
GAP_S = 0.03  # after a gap of this length in a packet its rest is lost (a device sends packets without a pause)
PLAUSIBLE_BYTES = 2048  # payload of a device that has announced no larger buffer
_GROOVY_TIME = b"\xff\xff\x0a\x00\x08\x00"  # beginning of the request for the time of a device of ROS groovy
GROOVY_REQUEST = b"\xff\xff\x00\x00\x00\x00\xff"  # such a device answers this request; a newer one ignores it

_TIME = struct.Struct("<II")
_LENGTH = struct.Struct("<I")
_NAME = re.compile(r"[/~]?[A-Za-z]\w*(?:/\w+)*", re.ASCII)
_TYPE = re.compile(r"[A-Za-z]\w*/[A-Za-z]\w*", re.ASCII)
_MD5 = re.compile(r"[0-9a-f]{32}")


class Id(enum.IntEnum):
    """Topic ids of the protocol itself."""

    PUBLISHER = 0  # to the device, empty: announce your topics
    SUBSCRIBER = 1
    SERVER_RESPONSE = 2  # halves of a service that the device answers
    SERVER_REQUEST = 3
    CLIENT_REQUEST = 4  # halves of a service that the device calls
    CLIENT_RESPONSE = 5
    PARAMETER = 6
    LOG = 7
    TIME = 10
    TX_STOP = 11


ANNOUNCEMENTS = frozenset(range(Id.PUBLISHER, Id.CLIENT_RESPONSE + 1))


class PayloadError(ValueError):
    """A payload that does not fit its topic id, although the checksum is correct."""


class Packet(NamedTuple):
    """Contents of a valid packet."""

    topic_id: int
    payload: bytes


class Topic(NamedTuple):
    """A topic, or half of a service, as a device announces it."""

    topic_id: int
    name: str
    type: str  # package/Type
    md5sum: str
    buffer_bytes: int  # longest payload


def encode(topic_id, payload=b""):
    """Encode a packet. Raises ValueError for a payload that is too long."""
    if len(payload) > MOST_BYTES:
        raise ValueError("a packet holds at most %d bytes, got %d" % (MOST_BYTES, len(payload)))
    low, high = len(payload) & 0xFF, len(payload) >> 8
    body = bytes((topic_id & 0xFF, topic_id >> 8)) + payload
    return b"%b%c%c%c%b%c" % (_HEAD, low, high, 255 - (low + high) % 256, body, 255 - sum(body) % 256)


REQUEST_TOPICS = encode(Id.PUBLISHER)


class Decoder:
    """Finds the packets in a stream of bytes that may also contain other data.

    If data looked like a packet but is none, only its first byte is dropped: the rest may contain a whole packet.
    """

    def __init__(self, byte_s=0.0):
        """byte_s: time that the line takes for a byte [s]."""
        self._byte_s = byte_s
        self._bytes = bytearray()  # begins with a possible packet
        self._begun_s = self._last_s = 0.0  # when its first byte, and the newest one, arrived
        self._last_bytes = b""
        self.longest_bytes = PLAUSIBLE_BYTES  # of a payload; a larger one counts as damage
        self.packets = 0  # valid packets
        self.damaged = 0  # packets that began and were not valid
        self.stray_bytes = 0  # bytes outside valid packets
        self.speaks_groovy = False  # a device of ROS groovy or before was heard

    def feed(self, data, now_s):
        """Add bytes that arrived at now_s [s]; return the packets that they complete. Call again by `due_s`."""
        if not data:
            return self._give_up(now_s) if now_s >= self.due_s else []
        if not self._bytes:
            self._begun_s = now_s
        self._last_s = now_s
        self._bytes += data
        recent = self._last_bytes + data
        self.speaks_groovy |= _GROOVY_TIME in recent
        self._last_bytes = recent[1 - len(_GROOVY_TIME) :]
        found = self._take(now_s)
        return found + self._give_up(now_s) if now_s >= self._begun_s + self._most_s() else found

    @property
    def due_s(self):
        """When to call `feed` without bytes, unless some arrive [s]; infinite when no packet has begun."""
        return min(self._last_s + GAP_S, self._begun_s + self._most_s()) if self._bytes else float("inf")

    def _most_s(self):
        """Longest time that the packet that has begun may take [s]."""
        length = self._bytes[2] | self._bytes[3] << 8 if len(self._bytes) > 3 else 0
        return GAP_S + 2.0 * (length + OVERHEAD) * self._byte_s

    def _give_up(self, now_s):
        """Give up an incomplete packet that is overdue; return the packets found in the rest."""
        found = []
        while self._bytes and now_s >= self.due_s:
            self._drop()
            self._begun_s = now_s
            found += self._take(now_s)
        return found

    def _drop(self):
        """Drop the first byte: no packet begins here."""
        self.damaged += self._bytes[:2] == _HEAD
        self.stray_bytes += 1
        del self._bytes[0]

    def _take(self, now_s):
        """Remove and return complete packets; the bytes left begin with a possible packet."""
        found, data = [], self._bytes
        while data:
            if data[0] != SYNC:
                stray = data.find(SYNC)
                stray = len(data) if stray < 0 else stray
                self.stray_bytes += stray
                del data[:stray]
                self._begun_s = now_s
                continue
            if len(data) < 2:
                break
            if data[1] == VERSION:
                if len(data) < 5:
                    break
                length = data[2] | data[3] << 8
                if (data[2] + data[3] + data[4]) % 256 == 255 and length <= self.longest_bytes:
                    end = length + OVERHEAD
                    if len(data) < end:
                        break
                    if sum(memoryview(data)[5:end]) % 256 == 255:
                        found.append(Packet(data[5] | data[6] << 8, bytes(data[7 : end - 1])))
                        self.packets += 1
                        del data[:end]
                        self._begun_s = now_s
                        continue
            self._drop()
            self._begun_s = now_s
        return found


def topic_of(payload):
    """Return the `Topic` that a TopicInfo announces. Raises PayloadError."""
    try:
        (topic_id,) = struct.unpack_from("<H", payload)
        name, at = _text(payload, 2)
        kind, at = _text(payload, at)
        md5sum, at = _text(payload, at)
        (buffer_bytes,) = struct.unpack_from("<i", payload, at)
    except (struct.error, UnicodeDecodeError) as error:
        raise PayloadError("TopicInfo: %s" % error) from None
    topic = Topic(topic_id, name, kind, md5sum, buffer_bytes)
    if at + 4 != len(payload) or topic_id < FIRST_TOPIC or buffer_bytes <= 0:
        raise PayloadError("TopicInfo: invalid: %r" % (topic,))
    if not (_NAME.fullmatch(name) and _TYPE.fullmatch(kind) and _MD5.fullmatch(md5sum)):
        raise PayloadError("TopicInfo: invalid: %r" % (topic,))
    return topic


def log_of(payload):
    """Return (level, text) of a Log. Raises PayloadError."""
    try:
        text, end = _text(payload, 1, "replace")
    except struct.error as error:
        raise PayloadError("Log: %s" % error) from None
    if end != len(payload):
        raise PayloadError("Log: %d bytes too many" % (len(payload) - end))
    return payload[0], text


def name_of(payload):
    """Return the name in a device's request for a parameter. Raises PayloadError."""
    try:
        name, end = _text(payload, 0)
    except (struct.error, UnicodeDecodeError) as error:
        raise PayloadError("RequestParam: %s" % error) from None
    if end != len(payload) or not _NAME.fullmatch(name):
        raise PayloadError("RequestParam: not a valid parameter name: %r" % name)
    return name


def time_payload(seconds, nanoseconds):
    """Encode the answer to a device that asks for the time."""
    return _TIME.pack(seconds, nanoseconds)


def _text(payload, at, errors="strict"):
    """Return (string at an offset, offset after it). Raises struct.error, and UnicodeDecodeError if errors="strict"."""
    (length,) = _LENGTH.unpack_from(payload, at)
    at += _LENGTH.size
    if at + length > len(payload):
        raise struct.error("a string of %d bytes in %d" % (length, len(payload) - at))
    return payload[at : at + length].decode("utf-8", errors), at + length
