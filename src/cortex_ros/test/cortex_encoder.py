"""Encodes the values that `cortex_ros.wire` decodes into packets, with every section of the protocol."""

import struct

import numpy as np

from cortex_ros import wire
from cortex_ros.wire import Command


def encode(packet):
    """The datagram of a decoded packet."""
    content = packet.content
    if packet.command in (Command.HELLO_WORLD, Command.HERE_I_AM):
        return wire.encode_identity(packet.command, content)
    if packet.command in (Command.COMMENT, Command.GENERAL_REQUEST):
        return wire.encode_text(packet.command, content)
    if packet.command == Command.BODYDEFS:
        return wire.encode_body_defs(content)
    if packet.command == Command.FRAME_OF_DATA:
        return encode_frame(content)
    return wire.encode_packet(packet.command, content or b"")


def encode_frame(frame):
    parts = [i32(frame.number, len(frame.bodies))]
    for body in frame.bodies:
        segments = np.asarray(body.segments, "<f8").reshape(-1, 7)
        dofs = np.asarray(body.dofs, "<f8").ravel()
        parts += [body.name.encode("utf-8", "surrogateescape") + b"\0", _markers(body.markers_mm)]
        parts += [i32(len(segments)), segments.tobytes(), i32(len(dofs)), dofs.tobytes()]
    parts += [_markers(frame.unidentified_mm), _samples(frame.analog, "<i2"), _samples(frame.forces, "<f4")]
    if frame.delay_s is not None:
        parts.append(struct.pack("<if", 0, frame.delay_s))
    items = []
    if frame.encoders is not None:
        items.append((wire.TAG_ENCODERS, _samples(frame.encoders, "<f8")))
    items.extend(frame.other_tags)
    if frame.recording is not None:
        *numbers, name = frame.recording
        items.append((wire.TAG_RECORDING, i32(*numbers) + name.encode() + b"\0"))
    if frame.lenses is not None:
        items.append((wire.TAG_LENSES, np.asarray(frame.lenses, "<i4").tobytes()))
    for tag, data in items:
        parts += [i32(tag, len(data)), data]
    return wire.encode_packet(Command.FRAME_OF_DATA, b"".join(parts))


def i32(*values):
    return struct.pack("<%di" % len(values), *values)


def _markers(markers_mm):
    """Count and coordinates. If any coordinate of a marker is not finite, all three become the sentinel."""
    markers = np.array(markers_mm, "<f4").reshape(-1, 3)
    markers[~np.isfinite(markers).all(axis=1)] = wire.MISSING_MM
    return i32(len(markers)) + markers.tobytes()


def _samples(block, dtype):
    return i32(block.channels, block.samples) + np.asarray(block.values, dtype).tobytes()
