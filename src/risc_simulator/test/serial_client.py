"""The host computer's end of a Due's serial line, for tests: rosserial's packets, and Controls of one vehicle."""

import struct

CONTROLS_TOPIC, STATUS_TOPIC = 100, 125
ASK_FOR_TOPICS = bytes.fromhex("fffe0000ff0000ff")


def packet(topic, payload=b""):
    length, body = struct.pack("<H", len(payload)), struct.pack("<H", topic) + payload
    return b"\xff\xfe" + length + bytes([255 - sum(length) % 256]) + body + bytes([255 - sum(body) % 256])


def controls(phi=0.0, theta=0.0, psi=0.0, throttle=-1.0, name=b"fluffy_II", frame=b"cortex"):
    """Packet of a risc_msgs/Controls."""
    header = struct.pack("<IIII", 0, 0, 0, len(frame)) + frame
    one = struct.pack("<II", 1, len(name)) + name + struct.pack("<4d", phi, theta, psi, throttle)
    return packet(CONTROLS_TOPIC, header + one)


def packets(data):
    """[(topic, payload)] of the complete packets in the bytes that a board sent."""
    found, at = [], data.find(b"\xff\xfe")
    while 0 <= at <= len(data) - 8:
        length, topic = struct.unpack_from("<H", data, at + 2)[0], struct.unpack_from("<H", data, at + 5)[0]
        if at + length + 8 <= len(data):
            found.append((topic, data[at + 7 : at + 7 + length]))
        at = data.find(b"\xff\xfe", at + length + 8)
    return found


def channels_of(status):
    """(state, channels_us) of the payload of a PpmStatus."""
    state, count = struct.unpack_from("<BI", status, 16)
    return state, struct.unpack_from("<%dH" % count, status, 21)
