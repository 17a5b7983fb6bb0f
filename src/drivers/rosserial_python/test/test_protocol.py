"""Packets against golden bytes, and with every kind of damage."""

import contextlib
import random

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from rosserial_python import protocol
from rosserial_python.protocol import GAP_S, Decoder, Id, Packet, PayloadError, encode

GOLDEN = [  # topic id, payload, bytes on the wire
    (Id.PUBLISHER, "", "ff fe 00 00 ff 00 00 ff"),
    (Id.TX_STOP, "", "ff fe 00 00 ff 0b 00 f4"),
    (Id.TIME, "00 00 00 00 00 00 00 00", "ff fe 08 00 f7 0a 00 00 00 00 00 00 00 00 00 f5"),
    (Id.LOG, "01 02 00 00 00 68 69", "ff fe 07 00 f8 07 00 01 02 00 00 00 68 69 24"),
]
CHATTER = bytes.fromhex(  # TopicInfo: id 125, chatter, std_msgs/String, its md5, 512 bytes
    "7d00 07000000 63686174746572 0f000000 7374645f6d7367732f537472696e67 20000000"
    "3939326365386131363837636563386338626438383365633733636134316431 00020000"
)
packets = st.builds(Packet, st.integers(0, 0xFFFF), st.binary(max_size=200))


@pytest.mark.parametrize(("topic_id", "payload", "wire"), GOLDEN)
def test_golden_packets(topic_id, payload, wire):
    payload, wire = bytes.fromhex(payload), bytes.fromhex(wire)
    assert encode(topic_id, payload) == wire
    decoder = Decoder()
    assert decoder.feed(wire, 0.0) == [(topic_id, payload)]
    assert (decoder.packets, decoder.damaged, decoder.stray_bytes) == (1, 0, 0)


def test_golden_topic():
    topic = protocol.topic_of(CHATTER)
    assert len(CHATTER) == 72
    assert topic == (125, "chatter", "std_msgs/String", "992ce8a1687cec8c8bd883ec73ca41d1", 512)


def test_golden_log():
    assert protocol.log_of(bytes.fromhex(GOLDEN[3][1])) == (1, "hi")
    assert protocol.log_of(b"\x02\x01\0\0\0\xff") == (2, "\ufffd"), "a sketch may write another alphabet"


def test_the_time_and_the_name_of_a_parameter():
    assert protocol.time_payload(1, 2) == bytes.fromhex("01000000 02000000")
    assert protocol.name_of(b"\x05\0\0\0~rate") == "~rate"


@pytest.mark.parametrize("function", [protocol.topic_of, protocol.log_of, protocol.name_of])
@given(payload=st.binary(max_size=120))
def test_a_payload_that_is_something_else_is_refused(function, payload):
    with contextlib.suppress(PayloadError):
        function(payload)


@pytest.mark.parametrize("at", range(len(CHATTER)))
def test_no_topic_with_one_damaged_byte_has_another_shape(at):
    """What passes is well-formed; the definition's checksum is checked later."""
    damaged = bytearray(CHATTER)
    damaged[at] ^= 0x80
    try:
        topic = protocol.topic_of(bytes(damaged))
    except PayloadError:
        return
    assert topic.topic_id >= protocol.FIRST_TOPIC and topic.buffer_bytes > 0
    assert topic[1:4] == protocol.topic_of(CHATTER)[1:4]


@pytest.mark.parametrize("payload", [CHATTER[:-1], CHATTER + b"\0", b"", CHATTER[:20], b"\x05" + CHATTER[1:]])
def test_a_topic_that_is_cut_or_too_long_or_no_users_is_refused(payload):
    with pytest.raises(PayloadError):
        protocol.topic_of(payload)


def test_a_payload_that_no_packet_holds():
    assert len(encode(100, bytes(0xFFFF))) == 0xFFFF + protocol.OVERHEAD
    with pytest.raises(ValueError, match="65535"):
        encode(100, bytes(0x10000))


@given(st.lists(packets, max_size=8), st.lists(st.integers(1, 40), min_size=1, max_size=20))
def test_any_packets_in_any_pieces(sent, sizes):
    byte_s = 1e-3  # each piece has at least one byte, so the line is never slower
    wire, found, decoder = b"".join(encode(*packet) for packet in sent), [], Decoder(byte_s)
    at = k = 0
    while at < len(wire):
        size = sizes[k % len(sizes)]
        found += decoder.feed(wire[at : at + size], byte_s * k)
        at, k = at + size, k + 1
    assert found == sent
    assert decoder.stray_bytes == 0


@given(st.binary(max_size=60), st.lists(packets, min_size=1, max_size=4), st.binary(max_size=60))
def test_packets_in_noise_are_all_found(before, sent, after):
    """Noise may look like the start of a packet: then they are found once its rest fails to come."""
    decoder = Decoder()
    found = decoder.feed(before + b"".join(encode(*packet) for packet in sent) + after, 0.0)
    found += decoder.feed(b"", GAP_S)
    position = 0
    for packet in sent:  # the noise may contain packets of its own
        assert packet in found[position:]
        position = found.index(packet, position) + 1


@given(packets, st.data())
def test_a_packet_with_one_damaged_byte_is_never_passed_on(packet, data):
    wire = bytearray(encode(*packet))
    at = data.draw(st.integers(0, len(wire) - 1))
    wire[at] ^= data.draw(st.integers(1, 255))
    decoder = Decoder()
    found = decoder.feed(bytes(wire), 0.0) + decoder.feed(b"", GAP_S)
    assert packet not in found
    assert decoder.stray_bytes


@given(packets, packets, st.data())
def test_lost_bytes_take_no_other_packet_with_them(first, second, data):
    wire = encode(*first)
    begin = data.draw(st.integers(0, len(wire) - 1))
    end = data.draw(st.integers(begin + 1, len(wire)))
    decoder, damaged = Decoder(), wire[:begin] + wire[end:] + encode(*second)
    assume(not damaged.startswith(wire))  # otherwise the second packet's bytes replace the lost ones exactly
    found = decoder.feed(damaged, 0.0) + decoder.feed(b"", GAP_S)
    assume(set(found) <= {first, second})  # otherwise an 8-bit sum was right by chance
    assert found[-1:] == [second]


def test_a_rest_that_does_not_come_is_given_up_after_a_gap():
    decoder, wire = Decoder(), encode(125, b"0123456789")
    assert decoder.feed(wire[:9], 5.0) == []
    assert decoder.due_s == 5.0 + GAP_S
    assert decoder.feed(b"", 5.0 + 0.9 * GAP_S) == [] and decoder.damaged == 0, "it may still come"
    assert decoder.feed(b"", 5.0 + GAP_S) == [] and decoder.damaged == 1
    assert decoder.due_s == float("inf")
    assert decoder.feed(wire, 6.0) == [(125, b"0123456789")]


def test_a_length_that_is_not_true_holds_nothing_up_for_long():
    """Its checksum may be right by chance: packets within the claimed length are delivered once it is given up."""
    byte_s = 10 / 57600
    decoder, wire = Decoder(byte_s), encode(125, bytes(20))
    false_head = b"\xff\xfe\xd0\x07" + bytes([255 - (0xD0 + 0x07)])  # 2000 bytes to come
    decoder.feed(false_head, 0.0)
    at_s, found = 0.0, []
    while not found:
        at_s += 0.02  # never quiet for GAP_S
        found = decoder.feed(wire, at_s)
    assert len(found) > 1, "those before come with it"
    assert at_s < 1.0


def test_a_length_beyond_any_buffer_is_damage_at_once():
    decoder = Decoder()
    head = b"\xff\xfe\xff\xff" + bytes([255 - 0x1FE % 256])
    assert decoder.feed(head + encode(125, b"x"), 0.0) == [(125, b"x")]
    decoder = Decoder()
    decoder.longest_bytes = 0xFFFF
    assert decoder.feed(encode(125, bytes(0xFFFF)), 0.0) == [(125, bytes(0xFFFF))]


def test_a_device_of_groovy_is_recognised():
    decoder, question = Decoder(), bytes.fromhex("ffff 0a00 0800 0000000000000000 ed")
    for number in question:
        assert decoder.feed(bytes([number]), 0.0) == []
    assert decoder.speaks_groovy
    fresh = Decoder()
    fresh.feed(b"\xff" + encode(Id.TIME, bytes(8)), 0.0)
    assert not fresh.speaks_groovy


def test_a_megabyte_of_noise_passes_few_packets(inputs):
    """One in 2**24 positions passes by chance (see the module); packets passed on are checked again by their type."""
    noise, decoder, passed = random.Random(3), Decoder(10 / 57600), 0
    size = inputs(2**20, 2**25)
    for k in range(size // 4096):
        passed += len(decoder.feed(noise.randbytes(4096), 0.1 * k))
    assert passed <= max(4, size // 2**21)
    assert decoder.stray_bytes > 0.99 * size - 4096
    decoder.feed(b"", 1e6)
    assert decoder.feed(encode(125, b"x"), 1e6) == [(125, b"x")]
