"""Frames of MAVLink 1 and 2 by pymavlink are read, whatever bytes are between them."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v10 import ardupilotmega as version_1
from pymavlink.dialects.v20 import ardupilotmega as version_2

from roscopter.wire import PATIENCE_S, Encoder, FrameReader, version_of

DIALECTS = {1: version_1, 2: version_2}


def frames(version, count, seed=0):
    """Frames of a vehicle, as pymavlink makes them."""
    dialect, numbers = DIALECTS[version], random.Random(seed)
    packer, made = dialect.MAVLink(None, 1, 1), []
    for k in range(count):
        angles = [numbers.uniform(-3.0, 3.0) for _ in range(6)]
        messages = (
            dialect.MAVLink_attitude_message(k, *angles),
            dialect.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3),
            dialect.MAVLink_statustext_message(6, b"0123456789" * 5),
        )
        packer.seq = k % 256
        made.append(messages[k % 3].pack(packer))
    return made


def read(reader, data, chunk=64, now_s=0.0):
    found = []
    for start in range(0, len(data), chunk):
        found += reader.feed(data[start : start + chunk], now_s)
    return found


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("chunk", [1, 7, 64, 10_000])
def test_what_is_sent_comes_out_in_pieces_of_any_size(version, chunk):
    sent = frames(version, 60)
    found = read(FrameReader(), b"".join(sent), chunk)
    assert [bytes(message.get_msgbuf()) for message in found] == sent
    assert {version_of(message) for message in found} == {version}


@pytest.mark.parametrize("version", [1, 2])
def test_values_are_those_of_the_message(version):
    dialect = DIALECTS[version]
    sent = dialect.MAVLink_attitude_message(5, 0.5, -0.25, 3.0, 1.0, 2.0, -4.0).pack(dialect.MAVLink(None, 7, 1))
    (message,) = FrameReader().feed(sent, 0.0)
    assert (message.get_srcSystem(), message.get_srcComponent(), message.get_type()) == (7, 1, "ATTITUDE")
    assert (message.roll, message.pitch, message.yaw, message.yawspeed) == (0.5, -0.25, 3.0, -4.0)


@pytest.mark.parametrize("version", [1, 2])
def test_no_sound_frame_is_lost_with_a_damaged_one(version):
    """Each byte of one frame in turn is damaged: all others are read, once its claimed length has come or timed out."""
    sent = frames(version, 30)
    whole = len(sent[10])
    for place in range(whole):
        damaged = bytearray(sent[10])
        damaged[place] ^= 0xFF
        stream = b"".join(sent[:10]) + bytes(damaged) + b"".join(sent[11:])
        found = [bytes(message.get_msgbuf()) for message in read(FrameReader(), stream)]
        assert found == sent[:10] + sent[11:], "byte %d" % place


def test_pymavlinks_own_parser_loses_sound_frames_with_a_damaged_length():
    """The reason for FrameReader: if this test fails, it is no longer needed."""
    sent = frames(2, 30)
    damaged = bytearray(sent[10])
    damaged[1] ^= 0xFF
    parser = version_2.MAVLink(None)
    parser.robust_parsing = True
    found = parser.parse_buffer(b"".join(sent[:10]) + bytes(damaged) + b"".join(sent[11:]))
    assert len([message for message in found if message.get_type() != "BAD_DATA"]) < 28


def test_a_slow_link_goes_on_soon_after_a_false_beginning():
    """A false start of a long frame must not hold up 1 Hz heartbeats until 280 bytes have come."""
    (beat,) = frames(1, 2)[1:]
    reader = FrameReader()
    assert reader.feed(bytes([0xFD, 255, 0, 0, 0, 1, 1, 30, 0, 0]), 0.0) == []
    assert [len(reader.feed(beat, float(k))) for k in (1, 2)] == [1, 1]
    impatient = FrameReader()
    impatient.feed(bytes([0xFD, 255, 0, 0, 0, 1, 1, 30, 0, 0]), 0.0)
    assert impatient.feed(beat, PATIENCE_S / 2) == []  # the control arm: nothing before PATIENCE_S


def test_unknown_messages_and_flags_are_passed_over():
    sent = frames(2, 3)
    unknown, flagged = bytearray(sent[0]), bytearray(sent[0])
    unknown[7:10] = b"\xff\xff\x7f"
    flagged[2] = 0x40
    reader = FrameReader()
    found = reader.feed(bytes(unknown) + sent[1] + bytes(flagged) + sent[2], 0.0)
    assert [bytes(message.get_msgbuf()) for message in found] == sent[1:]
    assert reader.skipped_bytes == len(unknown) + len(flagged)


def test_a_signed_frame_is_read():
    packer = version_2.MAVLink(None, 1, 1)
    packer.signing.secret_key, packer.signing.sign_outgoing = b"k" * 32, True
    sent = version_2.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3).pack(packer)
    reader = FrameReader()
    (message,) = reader.feed(sent, 0.0)
    assert message.base_mode == 81 and reader.skipped_bytes == 0


@given(st.lists(st.binary(max_size=80), max_size=12), st.integers(0, 10_000), st.sampled_from([1, 2]))
def test_no_garbage_stops_it(pieces, seed, version):
    """Whatever bytes come between, all frames are found, in order."""
    sent = frames(version, 24, seed)
    reader, found = FrameReader(), []
    for k, frame in enumerate(sent):
        found += reader.feed((pieces[k] if k < len(pieces) else b"") + frame, float(k))
    found += reader.feed(b"", 100.0)
    for k in range(300):  # frames that a false start has delayed
        found += reader.feed(b"", 101.0 + k)
    assert [bytes(message.get_msgbuf()) for message in found if bytes(message.get_msgbuf()) in sent] == sent


@pytest.mark.parametrize("version", [1, 2])
def test_what_we_send_is_what_pymavlink_reads(version):
    encoder = Encoder(255, 190)
    sent = [
        encoder.encode(version, "command_long", target_system=1, target_component=1, command=400, confirmation=2,
                       **{"param%d" % k: float(k) for k in range(1, 8)}),
        encoder.encode(version, "rc_channels_override", target_system=1, target_component=1,
                       **{"chan%d_raw" % k: 1000 + k for k in range(1, 9)}),
        encoder.encode(version, "mission_count", target_system=1, target_component=1, count=4),
    ]  # fmt: skip
    parser = DIALECTS[version].MAVLink(None)
    found = parser.parse_buffer(b"".join(sent))
    assert [message.get_type() for message in found] == ["COMMAND_LONG", "RC_CHANNELS_OVERRIDE", "MISSION_COUNT"]
    assert [message.get_seq() for message in found] == [0, 1, 2]
    assert {message.get_srcSystem() for message in found} == {255}
    assert (found[0].param7, found[1].chan8_raw, found[2].count) == (7.0, 1008, 4)
    assert all(frame[0] == (0xFE if version == 1 else 0xFD) for frame in sent)


def test_version_1_frames_have_the_length_of_version_1():
    """An old autopilot does not know the extension fields."""
    frame = Encoder(255, 190).encode(
        1, "rc_channels_override", target_system=1, target_component=1, **{"chan%d_raw" % k: 1 for k in range(1, 9)}
    )
    assert frame[1] == 18
