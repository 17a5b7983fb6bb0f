"""MAVLink frames, of versions 1 and 2: bytes to messages and back. No ROS, no sockets.

Messages and checksums are pymavlink's. Frames are cut out here: after a damaged length byte pymavlink's parser discards
up to 280 bytes of valid frames, and on a slow link waits until these bytes have arrived.
"""

from pymavlink.dialects.v10 import ardupilotmega as version_1
from pymavlink.dialects.v20 import ardupilotmega as version_2

MAVError, known_messages = version_2.MAVError, version_2.mavlink_map

_MAGIC_1, _MAGIC_2 = 0xFE, 0xFD
_OVERHEAD = {_MAGIC_1: 8, _MAGIC_2: 12}  # bytes of a frame besides its payload
_ID_AT = {_MAGIC_1: 5, _MAGIC_2: 7}
_SIGNED, _SIGNATURE_BYTES = 0x01, 13
PATIENCE_S = 0.5  # the rest of a frame must arrive within this time; it takes 0.05 s at 57600 baud


def version_of(message):
    """MAVLink version (1 or 2) of the frame of a received message."""
    return 1 if message.get_msgbuf()[0] == _MAGIC_1 else 2


class FrameReader:
    """Cuts a stream of bytes into messages. Skips damaged data byte by byte, so that no valid frame is lost with it."""

    def __init__(self):
        self.frames = 0  # decoded messages
        self.skipped_bytes = 0  # bytes of no valid frame, or of an unknown message
        self._rest = bytearray()
        self._since_s = 0.0  # when the first byte of the rest arrived
        self._decoder = version_2.MAVLink(None)

    def feed(self, data, now_s):
        """Add bytes; return the list of complete messages. now_s: monotonic clock."""
        rest, messages, start = self._rest, [], 0
        if rest and now_s - self._since_s > PATIENCE_S:
            start = 1  # the rest was not the beginning of a frame
            self.skipped_bytes += 1
        elif not rest:
            self._since_s = now_s
        rest += data
        while start < len(rest):
            length = self._length(rest, start)
            if length > len(rest) - start:
                break
            message = self._decode(rest[start : start + length]) if length else None
            if message is None:
                start += 1
                self.skipped_bytes += 1
            else:
                start += length
                messages.append(message)
                self.frames += 1
        if start:
            del rest[:start]
            self._since_s = now_s
        return messages

    @staticmethod
    def _length(rest, start):
        """Length of the frame that begins here, more than the available bytes if its header is incomplete; 0: none."""
        magic, there = rest[start], len(rest) - start
        overhead = _OVERHEAD.get(magic)
        if overhead is None:
            return 0
        if there <= _ID_AT[magic] + 2:
            return overhead
        number = rest[start + _ID_AT[magic]]
        flags = 0
        if magic == _MAGIC_2:
            number |= rest[start + 8] << 8 | rest[start + 9] << 16
            flags = rest[start + 2]
        if number not in known_messages or flags & ~_SIGNED:
            return 0
        return rest[start + 1] + overhead + (_SIGNATURE_BYTES if flags else 0)

    def _decode(self, frame):
        try:
            return self._decoder.decode(frame)
        except MAVError:
            return None


class Encoder:
    """Encodes frames with consecutive sequence numbers."""

    def __init__(self, system, component):
        self._packers = {
            1: (version_1, version_1.MAVLink(None, system, component)),
            2: (version_2, version_2.MAVLink(None, system, component)),
        }
        self._sequence = 0

    def encode(self, version, name, **fields):
        """Encode a message, e.g. encode(2, "heartbeat", type=6, ...), without the extension fields of version 2."""
        dialect, packer = self._packers[version]
        message = getattr(dialect, "MAVLink_%s_message" % name)(**fields)
        packer.seq = self._sequence
        self._sequence = (self._sequence + 1) % 256
        return message.pack(packer)
