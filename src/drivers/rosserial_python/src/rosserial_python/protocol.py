"""Packets of rosserial (protocol of ROS hydro and later) to bytes and back. No ROS, no ports.

Packet: 0xFF 0xFE, length (2), its checksum, topic id (2), payload, checksum of topic id and payload; numbers
little-endian. A checksum is 255 less the sum of the bytes modulo 256: one damaged packet in 256 passes it, so whoever
takes a payload over checks it as well.
"""

import enum
import re
import struct
from typing import NamedTuple

SYNC, VERSION = 0xFF, 0xFE
_HEAD = bytes((SYNC, VERSION))
_HEAD_BYTES, _TAIL_BYTES = 7, 1
OVERHEAD = _HEAD_BYTES + _TAIL_BYTES  # [bytes] of a packet beside its payload
MOST_BYTES = 0xFFFF  # payload that the length can say
FIRST_TOPIC = 100  # ids below are the protocol's own
GAP_S = 0.03  # no byte for so long within a packet: its rest was lost (a device sends packets in one go)
PLAUSIBLE_BYTES = 2048  # payload of a device that has announced no larger buffer
_GROOVY_TIME = b"\xff\xff\x0a\x00\x08\x00"  # how a device of ROS groovy begins to ask for the time
GROOVY_REQUEST = b"\xff\xff\x00\x00\x00\x00\xff"  # what such a device answers; a newer one ignores it

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
    """A payload that is not what its topic id says, although the checksum is right."""


class Packet(NamedTuple):
    """What a sound packet holds."""

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
    """Bytes of a packet. Raises ValueError for a payload that no packet can hold."""
    if len(payload) > MOST_BYTES:
        raise ValueError("a packet holds at most %d bytes, got %d" % (MOST_BYTES, len(payload)))
    low, high = len(payload) & 0xFF, len(payload) >> 8
    body = bytes((topic_id & 0xFF, topic_id >> 8)) + payload
    return b"%b%c%c%c%b%c" % (_HEAD, low, high, 255 - (low + high) % 256, body, 255 - sum(body) % 256)


REQUEST_TOPICS = encode(Id.PUBLISHER)


class Decoder:
    """Finds the packets in a stream of bytes, whatever else is in it.

    What looked like a packet and is none loses its first byte only: a whole packet may stand in what follows.
    """

    def __init__(self, byte_s=0.0):
        """byte_s: how long the line takes for a byte [s]."""
        self._byte_s = byte_s
        self._bytes = bytearray()  # begins with what may be a packet
        self._begun_s = self._last_s = 0.0  # when its first byte, and the newest one, came
        self._last_bytes = b""
        self.longest_bytes = PLAUSIBLE_BYTES  # of a payload; a larger one is damage
        self.packets = 0  # sound ones
        self.damaged = 0  # begun and not sound
        self.stray_bytes = 0  # bytes in no sound packet
        self.speaks_groovy = False  # a device of ROS groovy or before was heard

    def feed(self, data, now_s):
        """Packets that are complete with these bytes, which came now [s]; by `due_s` call it again."""
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
        """When `feed` is to be called without bytes, unless some come [s]; infinite when no packet has begun."""
        return min(self._last_s + GAP_S, self._begun_s + self._most_s()) if self._bytes else float("inf")

    def _most_s(self):
        """How long the packet that has begun may take [s]."""
        length = self._bytes[2] | self._bytes[3] << 8 if len(self._bytes) > 3 else 0
        return GAP_S + 2.0 * (length + OVERHEAD) * self._byte_s

    def _give_up(self, now_s):
        """Packets in what has come, without the one that has begun and does not end."""
        found = []
        while self._bytes and now_s >= self.due_s:
            self._drop()
            self._begun_s = now_s
            found += self._take(now_s)
        return found

    def _drop(self):
        """What begins here is no packet."""
        self.damaged += self._bytes[:2] == _HEAD
        self.stray_bytes += 1
        del self._bytes[0]

    def _take(self, now_s):
        """Packets that are complete; what is left begins with one that may become so."""
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
    """The `Topic` that a TopicInfo announces. Raises PayloadError."""
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
    """(level, text) of a Log. Raises PayloadError."""
    try:
        text, end = _text(payload, 1, "replace")
    except struct.error as error:
        raise PayloadError("Log: %s" % error) from None
    if end != len(payload):
        raise PayloadError("Log: %d bytes too many" % (len(payload) - end))
    return payload[0], text


def name_of(payload):
    """Name in a device's question for a parameter. Raises PayloadError."""
    try:
        name, end = _text(payload, 0)
    except (struct.error, UnicodeDecodeError) as error:
        raise PayloadError("RequestParam: %s" % error) from None
    if end != len(payload) or not _NAME.fullmatch(name):
        raise PayloadError("RequestParam: not a valid parameter name: %r" % name)
    return name


def time_payload(seconds, nanoseconds):
    """Answer to a device that asks for the time."""
    return _TIME.pack(seconds, nanoseconds)


def _text(payload, at, errors="strict"):
    """(string at an offset, offset behind it). Raises struct.error, and UnicodeDecodeError when errors are strict."""
    (length,) = _LENGTH.unpack_from(payload, at)
    at += _LENGTH.size
    if at + length > len(payload):
        raise struct.error("a string of %d bytes in %d" % (length, len(payload) - at))
    return payload[at : at + length].decode("utf-8", errors), at + length
