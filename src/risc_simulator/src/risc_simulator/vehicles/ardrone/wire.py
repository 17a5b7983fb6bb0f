"""The aircraft's side of the wire: reads commands, writes navdata.

The client's side, and what both share, is ardrone_autonomy.protocol.
"""

import functools
import re
import struct
from collections import namedtuple

from ardrone_autonomy.protocol.at import MAX_COMMAND_CHARS, OPTIONAL_TAIL, SIGNATURES, int_to_float
from ardrone_autonomy.protocol.navdata import (
    CHECKSUM_OPTION,
    CHECKSUM_TAG,
    GPS_LAYOUT,
    HEADER,
    LAYOUTS,
    MAGIC,
    OPTION_HEADER,
    Tag,
)

MAX_DATAGRAM_BYTES = 4096  # of commands; real clients send a few hundred

_NAME = re.compile(r"[A-Z][A-Z0-9_]*\Z")


# --- commands --------------------------------------------------------------------------------------------------------
# One received command; arguments converted as the signature says (int, float, str). For a name outside of SIGNATURES
# (legacy or unknown) they are ints and strings as they stand.
AtCommand = namedtuple("AtCommand", "name sequence arguments")
ParsedDatagram = namedtuple("ParsedDatagram", "commands malformed")


def parse_datagram(data):
    """All commands of one datagram, in order.

    data: bytes.  Accepts CR, LF, CRLF, zero bytes or nothing between and after commands, spaces around them,
    a comma too many at the end, surplus arguments, and unsigned float patterns.
    Returns ParsedDatagram(commands: list of AtCommand, malformed: number of lines that were refused). Never raises.
    """
    if len(data) > MAX_DATAGRAM_BYTES:  # thousands of lines: no client that wants to fly sends them
        return ParsedDatagram([], 1)
    lines = [line.strip(" \t") for line in re.split("[\r\n\0]", data.decode("latin-1"))]
    commands = [_parse_line(line) for line in lines if line]
    understood = [command for command in commands if command is not None]
    return ParsedDatagram(understood, len(commands) - len(understood))


def _parse_line(line):
    if len(line) >= MAX_COMMAND_CHARS or not line.startswith("AT*"):
        return None
    name, equals, rest = line[3:].partition("=")
    if not equals or not _NAME.match(name):
        return None
    raw = _split_arguments(rest)
    if raw is None or not raw or not isinstance(raw[0], int) or not 0 <= raw[0] < 2**32:
        return None
    sequence, raw = raw[0], raw[1:]
    kinds = SIGNATURES.get(name)
    if kinds is None:
        return AtCommand(name, sequence, tuple(raw))
    if len(raw) < len(kinds) - OPTIONAL_TAIL.get(name, 0):
        return None
    raw = raw[: len(kinds)] + [0] * (len(kinds) - len(raw))
    arguments = []
    for kind, value in zip(kinds, raw):
        if isinstance(value, str) != (kind == "s"):
            return None
        if kind == "f":
            try:
                value = int_to_float(value)
            except ValueError:
                return None
        elif kind == "i" and not -(2**31) <= value < 2**32:
            return None
        arguments.append(value)
    return AtCommand(name, sequence, tuple(arguments))


_ARGUMENT = re.compile(r'\s*(?:"([^"]*)"|([+-]?[0-9]{1,11}))\s*(,|\Z)', re.ASCII)


def _split_arguments(text):
    """List of int and str, or None when the text is not a comma-separated list of them."""
    values, position = [], 0
    while position < len(text):
        match = _ARGUMENT.match(text, position)
        if match is None:
            return None
        string, number, _ = match.groups()
        values.append(string if number is None else int(number))
        position = match.end()
    return values


class SequenceGate:
    """Aircraft side: which sequence numbers are accepted.

    A number that is not larger than the last accepted one is refused; 1 always resets and is accepted, and so is 0
    (some clients start there).  reset() after the link was lost.
    """

    def __init__(self):
        self._last = -1

    def accept(self, sequence):
        """True when a command with this number is to be obeyed."""
        if sequence > self._last or sequence in (0, 1):
            self._last = sequence
            return True
        return False

    def reset(self):
        """Forget: the next command is accepted, whatever its number."""
        self._last = -1


# --- navdata ---------------------------------------------------------------------------------------------------------
def seconds_to_time(seconds):
    """The inverse of time_to_seconds, wrapping; seconds >= 0."""
    whole = int(seconds)
    return (whole & 0x7FF) << 21 | min(999999, int((seconds - whole) * 1e6))


class NavdataEncoder:
    """A packet with a fixed set of options, prebuilt; only what changes is written.

    tags: option tags in wire order; none gives a bootstrap packet of 24 bytes.
    gps: tag 27 in its long form (firmware 2.4) instead of zimmu_3000.
    """

    def __init__(self, tags=(), gps=True):
        self._layouts = {}
        offset = HEADER.size
        for tag in tags:
            layout = GPS_LAYOUT if gps and tag == Tag.ZIMMU_3000 else LAYOUTS.get(tag)
            if layout is None:
                raise ValueError("unknown navdata tag %r, known are 0..27" % (tag,))
            if tag in self._layouts:
                raise ValueError("navdata tag %d twice" % tag)
            self._layouts[tag] = (layout, offset + OPTION_HEADER.size)
            offset += layout.size
        self._checksum_offset = offset
        self._buffer = bytearray(offset + CHECKSUM_OPTION.size)
        for tag, (layout, payload_offset) in self._layouts.items():
            OPTION_HEADER.pack_into(self._buffer, payload_offset - OPTION_HEADER.size, tag, layout.size)
        self._body = memoryview(self._buffer)[:offset]

    def slot(self, tag, first, last=None):
        """Function that writes the fields from `first` to `last` (default: only first) of one option.

        It takes one positional number per element (arrays spread out).  struct.error when a number does not fit.
        """
        layout, offset = self._layouts[tag]
        start = layout.index[first]
        stop = layout.index[last or first] + 1
        run = layout.fields[start:stop]
        if not run:
            raise ValueError("%s comes before %s in option %s" % (last, first, layout.name))
        packer = struct.Struct("<" + "".join("%d%s" % (f.count, f.code) for f in run))
        return functools.partial(packer.pack_into, self._buffer, offset + run[0].offset)

    def put(self, tag, **fields):
        """Write named fields of one option (for tests and for what is set once)."""
        for name, value in fields.items():
            self.slot(tag, name)(*(value if isinstance(value, (tuple, list)) else (value,)))

    def finish(self, state, sequence, vision_defined=0):
        """The packet as bytes: header and checksum for what has been written so far."""
        buffer = self._buffer
        HEADER.pack_into(buffer, 0, MAGIC, state, sequence, vision_defined)
        CHECKSUM_OPTION.pack_into(
            buffer, self._checksum_offset, CHECKSUM_TAG, CHECKSUM_OPTION.size, sum(self._body) & 0xFFFFFFFF
        )
        return bytes(buffer)
