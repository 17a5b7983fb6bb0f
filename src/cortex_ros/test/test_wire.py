"""Cortex packets: the golden ones both ways, the fast encoder against the general one, and hostile input."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from cortex_encoder import encode, encode_frame, i32
from hypothesis import given
from hypothesis import strategies as st

from cortex_ros import wire
from cortex_ros.wire import Command

GOLDEN = Path(__file__).parent / "golden"
NAMES = sorted(path.stem for path in GOLDEN.glob("*.bin"))
# without the packet whose bytes do not follow from its values: it has trailing bytes of a later version
REENCODE = [name for name in NAMES if name != "bodydefs_2_trailing"]


def golden(name):
    return (GOLDEN / (name + ".bin")).read_bytes(), json.loads((GOLDEN / (name + ".json")).read_text())


# --- golden packets -----------------------------------------------------------------------------------------------


def test_all_golden_packets_are_here():
    assert len(NAMES) == 15


@pytest.mark.parametrize("name", NAMES)
def test_golden_header(name):
    datagram, expected = golden(name)
    command, payload = wire.split_packet(datagram)
    assert (len(datagram), command, len(payload)) == (
        expected["datagram_bytes"],
        expected["command"],
        expected["payload_bytes"],
    )


@pytest.mark.parametrize("name", REENCODE)
def test_golden_encodes_to_the_same_bytes(name):
    datagram, _ = golden(name)
    assert encode(wire.decode_packet(datagram)) == datagram


@pytest.mark.parametrize("name", ["hello_world_client", "here_i_am_host"])
def test_golden_identity(name):
    datagram, expected = golden(name)
    assert wire.decode_packet(datagram).content == (expected["name"], tuple(expected["version"]))


@pytest.mark.parametrize("name", ["comment", "general_request_framerate", "general_request_livemode"])
def test_golden_text(name):
    datagram, expected = golden(name)
    assert wire.decode_packet(datagram).content == expected["string"]


def test_golden_reply():
    datagram, expected = golden("general_reply_framerate")
    assert struct.unpack("<f", wire.decode_packet(datagram).content) == (expected["as_float"],)
    assert wire.decode_packet(golden("general_reply_empty")[0]).content == b""


@pytest.mark.parametrize("name", ["bodydefs_2", "bodydefs_2_trailing"])
def test_golden_body_definitions(name):
    datagram, expected = golden(name)
    definitions, expected = wire.decode_packet(datagram).content, expected["bodydefs"]
    assert len(definitions.bodies) == expected["nBodyDefs"]
    for body, wanted in zip(definitions.bodies, expected["bodies"]):
        assert body == (wanted["name"], wanted["markers"], [tuple(s) for s in wanted["segments"]], wanted["dofs"])
    assert definitions.analog_channels == expected["analogChannels"]
    assert definitions.force_plates == expected["nForcePlates"]
    assert wire.encode_body_defs(definitions) == golden("bodydefs_2")[0]


@pytest.mark.parametrize("name", ["frame_2bodies", "frame_2bodies_base_layout", "frame_all_sections"])
def test_golden_frame(name):
    datagram, expected = golden(name)
    frame, expected = wire.decode_packet(datagram).content, expected["frame_of_data"]
    assert frame.number == expected["frame"]
    assert (frame.delay_s or 0.0) == expected["delay"]
    assert (frame.delay_s is None) == (name == "frame_2bodies_base_layout")
    assert len(frame.bodies) == expected["nBodies"]
    for index, (body, wanted) in enumerate(zip(frame.bodies, expected["bodies"])):
        assert body.name == wanted["name"]
        assert body.name.encode() == bytes.fromhex(wanted["name_hex"])
        missing = np.isnan(body.markers_mm)
        assert np.flatnonzero(missing.all(axis=1)).tolist() == wanted["missing_markers"]
        assert np.array_equal(missing.any(axis=1), missing.all(axis=1))
        assert np.where(missing, wire.MISSING_MM, body.markers_mm).tolist() == wanted["markers"]
        assert body.segments.tolist() == wanted["segments"]
        assert body.dofs.tolist() == wanted["dofs"]
        if frame.lenses is not None:
            assert frame.lenses[index].tolist() == [wanted["zoom"], wanted["focus"]]
    assert frame.unidentified_mm.tolist() == expected["unidentified"]
    analog, forces = expected["analog"], expected["forces"]
    assert (frame.analog.channels, frame.analog.samples) == (analog["nChannels"], analog["nSamples"])
    assert frame.analog.values.tolist() == analog["samples"]
    assert (frame.forces.channels, frame.forces.samples) == (forces["nPlates"], forces["nSamples"])
    assert frame.forces.values.tolist() == forces["data"]
    if name == "frame_all_sections":
        encoders, recording = expected["encoders"], expected["recording"]
        assert (frame.encoders.channels, frame.encoders.samples) == (encoders["nEncoders"], encoders["nSamples"])
        assert frame.encoders.values.tolist() == encoders["data"]
        assert frame.recording == (recording["active"], recording["first"], recording["last"], recording["filename"])
        assert frame.other_tags == [(777, bytes([1, 2, 3, 4, 5]))]
    else:
        assert (frame.encoders, frame.recording, frame.lenses) == (None, None, None)
    assert not frame.faults


# --- the fast encoder ---------------------------------------------------------------------------------------------

coordinate = st.one_of(st.floats(-1e6, 1e6, width=32), st.just(float("nan")), st.just(float("inf")))
markers_st = st.lists(st.tuples(coordinate, coordinate, coordinate), max_size=6).map(
    lambda rows: np.array(rows, float).reshape(-1, 3)
)
name_st = st.text(st.characters(blacklist_categories=("Cs",), blacklist_characters="\0"), max_size=30)


@given(
    bodies=st.lists(st.tuples(name_st, markers_st), max_size=6),
    number=st.integers(0, 2**31 - 1),
    loose=st.lists(st.tuples(*[st.floats(-1e4, 1e4, width=32)] * 3), max_size=4),
    delay_s=st.floats(0.0, 1.0, width=32),
    recording=st.one_of(
        st.none(), st.builds(wire.Recording, st.integers(0, 1), st.integers(0, 99), st.integers(0, 99), name_st)
    ),
)
def test_fast_encoder_equals_the_general_one(bodies, number, loose, delay_s, recording):
    encoder = wire.FrameEncoder([(name, len(markers)) for name, markers in bodies])
    all_markers = np.concatenate([markers for _, markers in bodies]) if bodies else np.empty((0, 3))
    packet, offset = encoder.encode(number, all_markers, np.array(loose).reshape(-1, 3), 0.0, recording)
    wire.set_delay(packet, offset, delay_s)
    general = encode_frame(
        wire.Frame(
            number,
            [wire.BodyFrame(name, markers, [], []) for name, markers in bodies],
            np.array(loose).reshape(-1, 3),
            wire.Samples(0, 0, []),
            wire.Samples(0, 0, []),
            delay_s,
            recording=recording,
        )
    )
    assert bytes(packet) == general
    frame = wire.decode_packet(packet).content
    assert [body.name for body in frame.bodies] == [name for name, _ in bodies]
    for body, (_, markers) in zip(frame.bodies, bodies):
        gone = ~np.isfinite(markers).all(axis=1)
        assert np.isnan(body.markers_mm[gone]).all() and np.array_equal(body.markers_mm[~gone], markers[~gone])


def test_missing_markers_are_the_sentinel_in_all_coordinates():
    packet, _ = wire.FrameEncoder([("a", 2)]).encode(1, np.array([[1.0, np.nan, 3.0], [4.0, 5.0, 6.0]]))
    assert packet[18:42] == bytes.fromhex("7f96184b" * 3) + struct.pack("<3f", 4.0, 5.0, 6.0)


def test_fast_encoder_converts_units():
    encoder = wire.FrameEncoder([("a", 2)], mm_per_unit=1000.0)
    packet, _ = encoder.encode(1, np.array([[0.001, 0.002, 0.003], [np.inf, 5.0, 6.0]]), np.array([[0.25, 0.5, 1.0]]))
    frame = wire.decode_packet(packet).content
    assert frame.bodies[0].markers_mm[0].tolist() == [1.0, 2.0, 3.0] and np.isnan(frame.bodies[0].markers_mm[1]).all()
    assert frame.unidentified_mm.tolist() == [[250.0, 500.0, 1000.0]]


def test_fast_encoder_refuses_what_does_not_fit():
    with pytest.raises(wire.PacketTooLargeError, match="5500 markers.*65503"):
        wire.FrameEncoder([("body%d" % k, 55) for k in range(100)])
    encoder = wire.FrameEncoder([("body", 5000)])
    room = (wire.MAX_PAYLOAD_BYTES - 8 - 5 - 4 - 60000 - 8 - 4 - 16 - 8) // 12
    packet, _ = encoder.encode(1, np.zeros((5000, 3)), np.zeros((room, 3)))
    assert len(packet) <= wire.MAX_DATAGRAM_BYTES < len(packet) + 12
    assert len(wire.decode_packet(packet).content.unidentified_mm) == room
    with pytest.raises(wire.PacketTooLargeError, match="unidentified"):
        encoder.encode(1, np.zeros((5000, 3)), np.zeros((room + 1, 3)))
    with pytest.raises(ValueError, match="101 bodies"):
        wire.FrameEncoder([("b", 0)] * 101)
    with pytest.raises(ValueError, match="5000 .* 1"):
        encoder.encode(1, np.zeros((1, 3)))


def test_fifty_bodies_fit():
    layout = [("vehicle_%02d" % k, 5) for k in range(50)]
    packet, _ = wire.FrameEncoder(layout).encode(1, np.arange(750.0).reshape(250, 3))
    assert len(packet) < 5000
    bodies = wire.decode_packet(packet).content.bodies
    assert [body.name for body in bodies] == [name for name, _ in layout]
    assert np.concatenate([body.markers_mm for body in bodies]).ravel().tolist() == list(range(750))


# --- what an encoder must refuse ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["x" * 128, "a\0b", "\u00e9" * 64])
def test_bad_names_are_refused(name):
    with pytest.raises(ValueError, match="at most 127 bytes"):
        wire.FrameEncoder([(name, 1)])
    with pytest.raises(ValueError, match="at most 127 bytes"):
        wire.encode_identity(Command.HELLO_WORLD, wire.Identity(name, (1, 0, 0, 0)))


def test_encoders_refuse_contradictions():
    with pytest.raises(wire.PacketTooLargeError, match="65504 payload"):
        wire.encode_packet(Command.GENERAL_REPLY, bytes(65504))
    with pytest.raises(ValueError, match="101 bodies"):
        wire.encode_body_defs(wire.BodyDefs([wire.BodyDef("b", [])] * 101))


def test_names_with_any_bytes_survive():
    raw = bytes(range(1, 128))
    payload = struct.pack("<ii", 5, 1) + bytes([255, 254, 200]) + b"\0" + bytes(12) + bytes(20)
    datagram = wire.encode_packet(Command.FRAME_OF_DATA, payload)
    assert encode_frame(wire.decode_packet(datagram).content) == datagram
    assert wire.decode_text(raw + b"\0").encode() == raw


# --- hostile input ------------------------------------------------------------------------------------------------


NO_BODIES = i32(7, 0, 0, 0, 0, 0, 0)  # frame number, bodies, unidentified, analog, forces

MALFORMED = {
    "empty": b"",
    "three bytes": b"\x0d\0\0",
    "declared longer than the datagram": struct.pack("<HH", 12, 1),
    "declared shorter than the datagram": struct.pack("<HH", 12, 0) + b"x",
    "identity too short": struct.pack("<HH", 0, 131) + bytes(131),
    "text without end": wire.encode_packet(14, b"LiveMode"),
    "text of nothing": wire.encode_packet(14, b""),
    "comment without end": wire.encode_packet(3, b"hello"),
}
MALFORMED_FRAMES = {
    "nothing": b"",
    "fixed fields cut": NO_BODIES[:-1],
    "101 bodies": i32(7, 101) + (b"\0" + bytes(12)) * 101 + bytes(20),
    "negative bodies": i32(7, -1) + bytes(100),
    "more bodies than data": i32(7, 3) + (b"\0" + bytes(12)) * 2 + bytes(12),
    "body name of 128 bytes": i32(7, 1) + b"n" * 128 + b"\0" + bytes(32),
    "body name without end": i32(7, 1) + b"n" * 40,
    "a million markers": i32(7, 1) + b"n\0" + i32(1000000) + bytes(60),
    "-1 markers": i32(7, 1) + b"n\0" + i32(-1) + bytes(60),
    "markers that wrap 32 bits": i32(7, 1) + b"n\0" + i32(357913942) + bytes(60),
    "segments that wrap 32 bits": i32(7, 1) + b"n\0" + i32(0, 76695845) + bytes(60),
    "-1 segments": i32(7, 1) + b"n\0" + i32(0, -1) + bytes(60),
    "-5 dofs": i32(7, 1) + b"n\0" + i32(0, 0, -5) + bytes(60),
    "too many dofs": i32(7, 1) + b"n\0" + i32(0, 0, 10) + bytes(60),
    "too many unidentified": i32(7, 0, 6) + bytes(60),
    "-1 unidentified": i32(7, 0, -1) + bytes(60),
    "analog that wraps 32 bits": i32(7, 0, 0, 65536, 65536, 0, 0),
    "negative analog": i32(7, 0, 0, -1, -1, 0, 0),
    "too many forces": i32(7, 0, 0, 0, 0, 1, 3) + bytes(60),
    "negative forces": i32(7, 0, 0, 0, 0, 1, -1) + bytes(60),
}
MALFORMED_BODY_DEFS = {
    "nothing": b"",
    "101 bodies": i32(101) + (b"\0" + bytes(12)) * 101 + bytes(8),
    "negative bodies": i32(-2) + bytes(60),
    "more bodies than data": i32(9) + bytes(60),
    "marker names that are not there": i32(1) + b"b\0" + i32(500) + bytes(60),
    "segment name without end": i32(1) + b"b\0" + i32(0, 1) + b"segment",
    "negative dofs": i32(1) + b"b\0" + i32(0, 0, -1, 0, 0),
    "no force plates": i32(0, 0),
    "negative force plates": i32(0, 0, -1),
}


@pytest.mark.parametrize("name", MALFORMED)
def test_malformed_datagrams(name):
    with pytest.raises(wire.MalformedPacketError):
        wire.decode_packet(MALFORMED[name])


@pytest.mark.parametrize(
    "command, payload",
    [
        pytest.param(command, payload, id="%s: %s" % (command.name, name))
        for command, cases in (
            (Command.FRAME_OF_DATA, MALFORMED_FRAMES),
            (Command.BODYDEFS, MALFORMED_BODY_DEFS),
        )
        for name, payload in cases.items()
    ],
)
def test_malformed_payloads(command, payload):
    with pytest.raises(wire.MalformedPacketError):
        wire.decode_packet(wire.encode_packet(command, payload))


def decode_frame_payload(payload):
    return wire.decode_packet(wire.encode_packet(Command.FRAME_OF_DATA, payload)).content


def test_zero_channels_with_many_samples_is_an_empty_block():
    frame = decode_frame_payload(i32(7, 0, 0, 0, 2**31 - 1, 2**31 - 1, 0))
    assert frame.analog.values.size == 0 and frame.forces.values.size == 0 and not frame.faults


@pytest.mark.parametrize("spare", range(5))
def test_up_to_four_spare_bytes_are_no_delay(spare):
    frame = decode_frame_payload(NO_BODIES + b"\xff" * spare)
    assert (frame.delay_s, frame.faults) == (None, [])


@pytest.mark.parametrize(
    "tail, delay_s",
    [
        (bytes(5), None),
        (bytes(7), None),
        (i32(0) + struct.pack("<f", float("nan")), 0.0),
        (i32(0) + struct.pack("<f", -0.1), 0.0),
        (i32(0) + struct.pack("<f", float("inf")), 0.0),
        (i32(0) + struct.pack("<f", 11.0), 0.0),
    ],
)
def test_a_faulty_delay_is_counted_and_keeps_the_frame(tail, delay_s):
    frame = decode_frame_payload(NO_BODIES + tail)
    assert (frame.number, frame.delay_s, len(frame.faults)) == (7, delay_s, 1)


RECORDING = wire.Recording(1, 5, 0, "take.cap")
GOOD_TAG = i32(12, 21) + i32(1, 5, 0) + b"take.cap\0"


@pytest.mark.parametrize(
    "item, faults, found",
    [
        (b"", 0, True),
        (i32(11, -8), 1, False),  # a careless decoder loops forever on this item
        (i32(777, 1000), 1, False),
        (i32(11, 8) + i32(-1, -1), 1, True),
        (i32(11, 16) + i32(1, 2) + bytes(8), 1, True),
        (i32(11, 24) + i32(1, 1) + bytes(16), 1, True),
        (i32(11, 4) + bytes(4), 1, True),
        (i32(12, 11) + bytes(11), 1, True),
        (i32(13, 7) + bytes(7), 1, True),  # shorter than 8 bytes a body
        (i32(777, 0), 0, True),
    ],
)
def test_a_faulty_tag_costs_only_itself(item, faults, found):
    body = i32(7, 1) + b"b\0" + bytes(12) + bytes(20)
    frame = decode_frame_payload(body + i32(0) + struct.pack("<f", 0.5) + item + GOOD_TAG)
    assert (frame.delay_s, len(frame.faults)) == (0.5, faults)
    assert frame.recording == (RECORDING if found else None)
    assert (frame.encoders, frame.lenses) == (None, None)


def test_a_tag_cut_in_its_header_is_counted():
    frame = decode_frame_payload(NO_BODIES + bytes(8) + i32(12) + b"\x01")
    assert (frame.delay_s, len(frame.faults)) == (0.0, 1)


def test_a_capture_name_of_any_length_stays_inside_its_item():
    item = i32(12, 12 + 300) + i32(1, 2, 3) + b"n" * 300
    frame = decode_frame_payload(NO_BODIES + bytes(8) + item + i32(777, 1) + b"\x05")
    assert frame.recording.file_name == "n" * 300
    assert frame.other_tags == [(777, b"\x05")]


@pytest.mark.parametrize(
    "marker",
    [(wire.MISSING_MM, 1.0, 2.0), (float("nan"), 1.0, 2.0), (1.0, float("inf"), 2.0), (1.0, 2.0, float("-inf"))],
)
def test_x_alone_or_anything_not_finite_means_missing(marker):
    body = i32(7, 1) + b"b\0" + i32(1) + struct.pack("<3f", *marker) + bytes(28)
    assert np.isnan(decode_frame_payload(body).bodies[0].markers_mm).all()


def test_identity_name_without_end_is_cut_and_later_versions_may_be_longer():
    packet = wire.decode_packet(wire.encode_packet(Command.HERE_I_AM, b"n" * 128 + bytes([1, 2, 3, 4]) + b"more"))
    assert packet.content == ("n" * 127, (1, 2, 3, 4))


def test_unknown_command_keeps_its_payload():
    assert wire.decode_packet(wire.encode_packet(0x0180, b"abc")) == (0x0180, b"abc")


def decode_or_refuse(datagram):
    try:
        return wire.decode_packet(datagram)
    except wire.MalformedPacketError:
        return None


@given(command=st.sampled_from([int(c) for c in Command] + [99]), payload=st.binary(max_size=300))
def test_random_payloads_decode_or_are_refused(command, payload):
    decode_or_refuse(wire.encode_packet(command, payload))


@given(name=st.sampled_from(NAMES), data=st.data())
def test_damaged_golden_packets_decode_or_are_refused(name, data):
    datagram = bytearray(golden(name)[0])
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(datagram) - 1))
        datagram[at] = data.draw(st.integers(0, 255))
    cut = datagram[: data.draw(st.integers(0, len(datagram)))]
    decode_or_refuse(datagram)
    if len(cut) >= 4:  # with a correct header too, so that the cut reaches the decoders
        decode_or_refuse(wire.encode_packet(struct.unpack_from("<H", cut)[0], bytes(cut[4:])))


@pytest.mark.parametrize("name", ["frame_all_sections", "bodydefs_2", "here_i_am_host", "general_request_livemode"])
def test_every_truncation_is_survived(name):
    datagram, _ = golden(name)
    whole = wire.decode_packet(datagram)
    for size in range(4, len(datagram)):
        assert decode_or_refuse(datagram[:size]) is None
        cut = decode_or_refuse(wire.encode_packet(whole.command, datagram[4:size]))
        if cut is not None:  # only optional parts of a frame may be lacking
            assert whole.command == Command.FRAME_OF_DATA
            assert [body.name for body in cut.content.bodies] == ["Quad1", "Prop"]


def test_decoded_values_outlive_the_receive_buffer():
    buffer = bytearray(golden("frame_all_sections")[0])
    frame = wire.decode_packet(buffer).content
    before = [body.markers_mm.copy() for body in frame.bodies], frame.forces.values.copy()
    buffer[4:] = bytes(len(buffer) - 4)
    assert all(np.array_equal(a, b.markers_mm, equal_nan=True) for a, b in zip(before[0], frame.bodies))
    assert np.array_equal(before[1], frame.forces.values)
