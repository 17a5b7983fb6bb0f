"""Navdata: golden packets, sizes of all options, tolerance, and that only NavdataError is ever raised."""

import os
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ardrone_autonomy.protocol import navdata
from ardrone_autonomy.protocol.navdata import Navdata, NavdataError, State, Tag
from risc_simulator.vehicles.ardrone.wire import NavdataEncoder, seconds_to_time

GOLDEN = os.path.join(os.path.dirname(os.path.abspath(__file__)), "golden")

# Sizes of the options in a full packet of a real aircraft (four header bytes included), tags 0..26, and the two forms
# of tag 27; the full packet has 2120 bytes.
SIZES = (148, 8, 52, 46, 16, 12, 88, 16, 24, 76, 56, 16, 44, 92, 108, 364, 328, 8, 40, 65, 12, 18, 75, 56, 72, 32, 8)
ZIMMU_SIZE, GPS_SIZE, FULL_PACKET = 12, 216, 2120


def golden(name):
    with open(os.path.join(GOLDEN, name)) as file:
        return bytes.fromhex("".join(line.split("#")[0] for line in file))


def seal(body):
    """Header and options with their checksum, without the codec."""
    return body + struct.pack("<HHI", 0xFFFF, 8, sum(body))


def tags_of(received):
    return [tag for tag in range(2000) if received.size_of(tag) is not None]


def packet(*options, **header):
    body = struct.pack("<IIII", header.get("magic", 0x55667788), header.get("state", 0), header.get("sequence", 1), 0)
    return seal(body + b"".join(struct.pack("<HH", tag, len(payload) + 4) + payload for tag, payload in options))


# ------------------------------------------------------------------ golden packets


def test_bootstrap_packet_of_a_real_aircraft():
    data = golden("navdata_bootstrap.hex")
    assert len(data) == 24
    received = Navdata(data)
    assert tags_of(received) == []
    state = State(received.state)
    assert state & State.BOOTSTRAP and state & State.COM_WATCHDOG and not state & State.COMMAND_ACK
    assert NavdataEncoder().finish(0x4F800C10, 1) == data
    assert navdata.peek(data) == (0x55667788, 0x4F800C10, 1, 0)


def test_demo_packet():
    received = Navdata(golden("navdata_demo.hex"))
    assert tags_of(received) == [0, 21, 1337]
    demo = received.option(Tag.DEMO)
    assert demo.ctrl_state >> 16 == navdata.ControlState.LANDED
    assert demo[:10] == (131072, 50, 1500.0, -2000.0, 90000.0, 1000, 250.0, -100.0, 0.0, 7)
    assert demo.detection_camera_rot == (1, 0, 0, 0, 1, 0, 0, 0, 1)
    assert demo.detection_camera_trans == (0, 0, 10)
    assert (demo.detection_tag_index, demo.detection_camera_type) == (1, 10)
    assert demo.drone_camera_trans == (0, 0, -1)
    pressure = received.option(Tag.PRESSURE_RAW)
    assert pressure == (41773, 29000, 435, 101586)
    assert received.size_of(Tag.PRESSURE_RAW) == 18
    assert received.size_of(1337) == 6 and received.option(1337) is None
    assert received.option(Tag.PWM) is None and received.size_of(Tag.PWM) is None


def test_demo_packet_is_what_the_encoder_makes():
    data = golden("navdata_demo.hex")
    encoder = NavdataEncoder([Tag.DEMO, Tag.PRESSURE_RAW])
    identity = (1, 0, 0, 0, 1, 0, 0, 0, 1)
    write = encoder.slot(Tag.DEMO, "ctrl_state", "num_frames")
    write(131072, 50, 1500.0, -2000.0, 90000.0, 1000, 250.0, -100.0, 0.0, 7)
    encoder.put(
        Tag.DEMO,
        detection_camera_rot=identity,
        detection_camera_trans=(0, 0, 10),
        detection_tag_index=1,
        detection_camera_type=10,
        drone_camera_rot=identity,
        drone_camera_trans=(0, 0, -1),
    )
    encoder.put(Tag.PRESSURE_RAW, up=41773, ut=29000, Temperature_meas=435, Pression_meas=101586)
    unknown = data.index(b"\x39\x05\x06\x00")
    assert encoder.finish(0x0F8004D0, 42) == seal(data[:unknown] + data[unknown + 6 : -8])


# ------------------------------------------------------------------ layouts


@pytest.mark.parametrize("tag", range(28))
def test_option_sizes_are_those_on_the_wire(tag):
    layout = navdata.LAYOUTS[tag]
    assert layout.size == (SIZES + (ZIMMU_SIZE,))[tag]
    assert Tag[layout.name.upper()] == tag
    assert layout.required_bytes <= layout.size - 4


def test_full_packet_has_the_size_of_a_real_one():
    data = NavdataEncoder(navdata.ALL_TAGS).finish(0, 1)
    assert len(data) == FULL_PACKET
    received = Navdata(data)
    assert [received.size_of(tag) for tag in range(28)] == list(SIZES) + [GPS_SIZE]


def test_tag_27_is_told_apart_by_size():
    zimmu = Navdata(packet((27, struct.pack("<if", -5, 2.5)))).option(27)
    assert type(zimmu).__name__ == "zimmu_3000" and zimmu == (-5, 2.5)
    gps = Navdata(packet((27, struct.pack("<ddd", 41.7, -111.8, 1400.0).ljust(212, b"\0")))).option(27)
    assert type(gps).__name__ == "gps" and gps[:3] == (41.7, -111.8, 1400.0)


@pytest.mark.parametrize(
    "tag, offset, code, field, index",
    [
        # offsets as counted from the field lists of the public documents
        (Tag.DEMO, 20, "i", "altitude", None),
        (Tag.DEMO, 92, "I", "detection_camera_type", None),
        (Tag.RAW_MEASURES, 16, "I", "vbat_raw", None),
        (Tag.PHYS_MEASURES, 14, "f", "phys_accs", 2),
        (Tag.PWM, 3, "B", "motor4", None),
        (Tag.ALTITUDE, 12, "i", "altitude_raw", None),
        (Tag.VISION_DETECT, 4, "I", "type", 0),
        (Tag.VISION_DETECT, 84, "I", "dist", 0),
        (Tag.VISION_DETECT, 100, "f", "orientation_angle", 0),
        (Tag.VISION_DETECT, 260, "f", "translation", 0),
        (Tag.VISION_DETECT, 308, "I", "camera_source", 0),
        (Tag.PRESSURE_RAW, 6, "i", "Temperature_meas", None),
        (Tag.MAGNETO, 42, "f", "heading_unwrapped", None),
        (Tag.MAGNETO, 54, "B", "magneto_calibration_ok", None),
        (Tag.MAGNETO, 55, "I", "magneto_state", None),
        (Tag.VIDEO_STREAM, 1, "I", "frame_size", None),
    ],
)
def test_field_offsets(tag, offset, code, field, index):
    payload = bytearray(navdata.LAYOUTS[tag].size - 4)
    struct.pack_into("<" + code, payload, offset, 77)
    value = getattr(Navdata(packet((tag, bytes(payload)))).option(tag), field)
    assert (value if index is None else value[index]) == 77


# ------------------------------------------------------------------ tolerance


def test_longer_options_are_read_as_far_as_they_are_known():
    payload = struct.pack("<I", 5 << 21 | 250000) + b"new firmware"
    received = Navdata(packet((Tag.TIME, payload)))
    assert navdata.time_to_seconds(received.option(Tag.TIME).time) == 5.25
    assert received.size_of(Tag.TIME) == 20


def test_shorter_options_read_zero_behind_their_required_fields():
    full = struct.pack("<ii", 1000, 0).ljust(48, b"\0")
    raw = Navdata(packet((Tag.RAW_MEASURES, b"\x01" * 46))).option(Tag.RAW_MEASURES)  # without gradient
    assert raw.alt_temp_raw == 0x01010101 and raw.gradient == 0
    part = Navdata(packet((Tag.PWM, b"\x09" * 8))).option(Tag.PWM)
    assert part.sat_motor4 == 9 and part.gaz_feed_forward == 0.0
    for size in (9, 10, 11):  # partial fields are dropped
        part = Navdata(packet((Tag.PWM, b"\x09" * size))).option(Tag.PWM)
        assert part.sat_motor4 == 9 and part.gaz_feed_forward == 0.0
    half = Navdata(packet((Tag.MAGNETO, b"\x09" * 6 + struct.pack("<3f", 1.0, 2.0, 3.0)[:-1]))).option(Tag.MAGNETO)
    assert half.mz == 0x0909 and half.magneto_raw == (0.0, 0.0, 0.0)
    with pytest.raises(NavdataError, match="demo .* 36 .* 40"):
        Navdata(packet((Tag.DEMO, full[:32]))).option(Tag.DEMO)
    assert Navdata(packet((Tag.DEMO, full[:36]))).option(Tag.DEMO).ctrl_state == 1000


def test_newer_magic_is_accepted():
    assert Navdata(packet(magic=0x55667789, state=3)).state == 3


def test_size_zero_ends_the_packet():
    body = struct.pack("<IIIIHHI", 0x55667788, 0, 1, 0, int(Tag.TIME), 8, 5)
    data = body + struct.pack("<HH", 9, 0) + bytes(60)
    with pytest.raises(NavdataError, match="no checksum"):
        Navdata(data)


@pytest.mark.parametrize(
    "data, message",
    [
        (b"", "at least 24"),
        (b"\0" * 23, "at least 24"),
        (b"\0" * 24, "not navdata"),
        (packet()[:-4] + b"\0\0\0\0", "checksum is 0"),
        (packet()[:-8] + struct.pack("<HHI", 5, 12, 0), "claims 12 bytes"),
        (packet()[:-8] + struct.pack("<HHI", 5, 3, 0), "claims 3 bytes"),
        (packet()[:-8] + struct.pack("<HHI", 5, 8, 0), "no checksum"),
        (packet()[:-8] + struct.pack("<HHI", 0xFFFF, 4, 0), "no checksum"),
    ],
)
def test_unsound_packets(data, message):
    with pytest.raises(NavdataError, match=message):
        Navdata(data)


def test_any_damaged_byte_is_noticed():
    data = golden("navdata_demo.hex")
    for i in range(len(data)):
        damaged = bytearray(data)
        damaged[i] ^= 0x10
        with pytest.raises(NavdataError):
            Navdata(bytes(damaged))


def test_wake_up():
    assert all(navdata.is_wake_up(d) for d in (b"\x01", b"\x01\0\0\0", b"\x02\0\0\0", b"\x01".ljust(14, b"\0")))
    assert not any(navdata.is_wake_up(d) for d in (b"", b"\0", b"\x03\0\0\0", b"\x01".ljust(15, b"\0")))
    assert navdata.is_wake_up(navdata.WAKE_UP)


@pytest.mark.parametrize("seconds, raw", [(0.0, 0), (1.0, 1 << 21), (2.5, 2 << 21 | 500000), (2049.0, 1 << 21)])
def test_time(seconds, raw):
    assert seconds_to_time(seconds) == raw
    assert navdata.time_to_seconds(raw) == pytest.approx(seconds % 2048.0, abs=1e-9)


# ------------------------------------------------------------------ encoder


def test_encoder_refuses_what_it_does_not_know():
    for tags in ([99], [Tag.DEMO, 0]):
        with pytest.raises(ValueError):
            NavdataEncoder(tags)
    encoder = NavdataEncoder([Tag.DEMO])
    with pytest.raises(KeyError):
        encoder.slot(Tag.DEMO, "nope")
    with pytest.raises(ValueError, match="comes before"):
        encoder.slot(Tag.DEMO, "vz", "vx")
    with pytest.raises(struct.error):
        encoder.slot(Tag.DEMO, "vbat_flying_percentage")(-1)


def test_encoder_keeps_what_was_written():
    encoder = NavdataEncoder([Tag.TIME, Tag.GAMES])
    encoder.slot(Tag.GAMES, "double_tap_counter", "finish_line_counter")(3, 4)
    first, second = encoder.finish(1, 1), encoder.finish(2, 2)
    assert Navdata(first).option(Tag.GAMES) == Navdata(second).option(Tag.GAMES) == (3, 4)
    assert (navdata.peek(first).sequence, Navdata(second).state) == (1, 2)


_CODES = {
    "I": st.integers(0, 2**32 - 1),
    "i": st.integers(-(2**31), 2**31 - 1),
    "H": st.integers(0, 65535),
    "h": st.integers(-32768, 32767),
    "B": st.integers(0, 255),
    "f": st.floats(width=32, allow_nan=False),
    "d": st.floats(allow_nan=False),
}


@given(st.sampled_from(range(28)), st.booleans(), st.data())
def test_every_option_survives_the_round_trip(tag, gps, data):
    encoder = NavdataEncoder([tag], gps=gps)
    layout = navdata.GPS_LAYOUT if gps and tag == 27 else navdata.LAYOUTS[tag]
    values = {}
    for field in layout.fields:
        drawn = data.draw(st.tuples(*[_CODES[field.code]] * field.count))
        values[field.name] = drawn if field.count > 1 else drawn[0]
    encoder.put(tag, **values)
    assert Navdata(encoder.finish(0, 1)).option(tag)._asdict() == values


# ------------------------------------------------------------------ fuzz


def read_everything(data):
    try:
        received = Navdata(data)
    except NavdataError:
        return
    for tag in tags_of(received):
        try:
            received.option(tag)
        except NavdataError:
            continue


@given(st.binary(max_size=120))
def test_only_navdata_errors_from_noise(noise):
    read_everything(noise)
    read_everything(struct.pack("<I", 0x55667788) + noise)
    read_everything(seal(struct.pack("<IIII", 0x55667788, 0, 1, 0) + noise))


@given(st.lists(st.tuples(st.integers(0, 2111), st.integers(0, 255)), max_size=6), st.integers(16, 2112))
def test_only_navdata_errors_from_a_damaged_full_packet(damage, length):
    data = bytearray(NavdataEncoder(navdata.ALL_TAGS).finish(0, 1))
    for position, value in damage:
        data[position] = value
    read_everything(bytes(data[:length]))
    read_everything(seal(bytes(data[:length])))
