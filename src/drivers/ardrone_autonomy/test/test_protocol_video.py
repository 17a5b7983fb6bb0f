import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ardrone_autonomy.protocol import video
from ardrone_autonomy.protocol.video import (
    Control,
    FrameAssembler,
    FrameType,
    Packet,
    PaveError,
    PaveHeader,
    StreamParser,
    pack_header,
    parse_header,
)
from risc_simulator.video.stream_writer import StreamWriter, nal_units

# Written by hand from the protocol's table: (offset, format, value).
FIELDS_BY_HAND = {
    "version": (4, "<B", 2),
    "codec": (5, "<B", 4),
    "header_bytes": (6, "<H", 68),
    "payload_bytes": (8, "<I", 0x01020),
    "encoded_width_px": (12, "<H", 640),
    "encoded_height_px": (14, "<H", 368),
    "display_width_px": (16, "<H", 639),
    "display_height_px": (18, "<H", 360),
    "frame_number": (20, "<I", 0x11223344),
    "timestamp_ms": (24, "<I", 0x55667788),
    "total_chunks": (28, "<B", 3),
    "chunk_index": (29, "<B", 1),
    "frame_type": (30, "<B", 1),
    "control": (31, "<B", 2),
    "stream_position_low": (32, "<I", 0x99AABBCC),
    "stream_position_high": (36, "<I", 0xDD),
    "stream_id": (40, "<H", 0x0506),
    "total_slices": (42, "<B", 5),
    "slice_index": (43, "<B", 4),
    "sps_bytes": (44, "<B", 14),
    "pps_bytes": (45, "<B", 10),
    "reserved": (46, "<H", 0),
    "advertised_bytes": (48, "<I", 0x01021),
}
IDR = b"\0\0\0\1\x67\x42\x80\x1e\xaa\xbb\0\0\0\1\x68\xce\x0f\0\0\1\x65\x11\x22\x33"
P = b"\0\0\0\1\x41\x9a\x00\x7f"


def header_by_hand():
    data = bytearray(68)
    data[:4] = b"PaVE"
    for offset, form, value in FIELDS_BY_HAND.values():
        struct.pack_into(form, data, offset, value)
    return bytes(data)


headers = st.builds(
    PaveHeader,
    version=st.integers(0, 255),
    codec=st.integers(0, 255),
    header_bytes=st.integers(64, video.MAX_HEADER_BYTES),
    payload_bytes=st.integers(0, video.MAX_PAYLOAD_BYTES),
    encoded_width_px=st.integers(0, video.MAX_SIDE_PX),
    encoded_height_px=st.integers(0, video.MAX_SIDE_PX),
    display_width_px=st.integers(0, video.MAX_SIDE_PX),
    display_height_px=st.integers(0, video.MAX_SIDE_PX),
    frame_number=st.integers(0, 2**32 - 1),
    timestamp_ms=st.integers(0, 2**32 - 1),
    total_chunks=st.integers(0, 255),
    chunk_index=st.integers(0, 255),
    frame_type=st.integers(0, 255),
    control=st.integers(0, 255),
    stream_position_low=st.integers(0, 2**32 - 1),
    stream_position_high=st.integers(0, 2**32 - 1),
    stream_id=st.integers(0, 2**16 - 1),
    total_slices=st.integers(0, 255),
    slice_index=st.integers(0, 255),
    sps_bytes=st.integers(0, 255),
    pps_bytes=st.integers(0, 255),
    reserved=st.integers(0, 2**16 - 1),
    advertised_bytes=st.integers(0, 2**32 - 1),
)


# --- headers ---------------------------------------------------------------------------------------------------------
def test_every_field_lies_where_the_protocol_says():
    header = parse_header(header_by_hand())
    assert header._asdict() == {name: value for name, (_, _, value) in FIELDS_BY_HAND.items()}
    assert set(header._fields) == set(FIELDS_BY_HAND)
    assert pack_header(header) == header_by_hand()
    assert (header.encoded_px, header.display_px) == ((640, 368), (639, 360))


@given(headers)
def test_round_trip(header):
    data = pack_header(header)
    assert len(data) == header.header_bytes
    assert parse_header(data) == header
    assert parse_header(b"xyz" + data, 3) == header


@pytest.mark.parametrize("missing", range(1, 65))
def test_a_short_header_is_refused(missing):
    data = header_by_hand()[:64]
    with pytest.raises(PaveError, match=" 64 bytes"):
        parse_header(data[: 64 - missing])
    with pytest.raises(PaveError, match=" 64 bytes"):
        parse_header(data, missing)


@pytest.mark.parametrize(
    ("field", "value", "cause"),
    [
        ("header_bytes", 63, "header of 63 bytes"),
        ("header_bytes", 0, "header of 0 bytes"),
        ("header_bytes", video.MAX_HEADER_BYTES + 1, "header of 257 bytes"),
        ("payload_bytes", video.MAX_PAYLOAD_BYTES + 1, "picture of 1048577 bytes"),
        ("payload_bytes", 2**32 - 1, "picture of 4294967295 bytes"),
        ("encoded_height_px", video.MAX_SIDE_PX + 1, "640 x 4097"),
        ("display_width_px", 65535, "65535 x 360"),
    ],
)
def test_absurd_sizes_are_refused(field, value, cause):
    data = bytearray(header_by_hand())
    offset, form, _ = FIELDS_BY_HAND[field]
    struct.pack_into(form, data, offset, value)
    with pytest.raises(PaveError, match=cause):
        parse_header(data)


@pytest.mark.parametrize("change", [{"frame_number": 2**32}, {"stream_id": -1}])
def test_what_fits_no_field_is_not_packed(change):
    with pytest.raises(struct.error):
        pack_header(parse_header(header_by_hand())._replace(**change))


# --- NAL units and the writer ----------------------------------------------------------------------------------------
def test_nal_units():
    assert nal_units(IDR) == [(7, 0, 10), (8, 10, 17), (5, 17, len(IDR))]
    assert nal_units(P) == [(1, 0, len(P))]
    for nothing in (b"", b"\0\0\1", b"\0\0\0\1", b"abcdefgh"):
        assert nal_units(nothing) == []


@pytest.mark.parametrize("header_bytes", (64, 68))
def test_the_writer_counts_as_the_aircraft_does(header_bytes):
    writer = StreamWriter(header_bytes=header_bytes, stream_id=5)
    data = writer.picture(IDR, 1000) + writer.picture(P, 1033) + writer.picture(IDR[:17], 2**32 + 7)
    parser = StreamParser()
    packets = parser.feed(data)
    assert [p.payload for p in packets] == [IDR, P, IDR[:17]]
    headers = [p.header for p in packets]
    assert [h.header_bytes for h in headers] == [header_bytes] * 3
    assert [h.frame_number for h in headers] == [0, 1, 2]
    assert [h.timestamp_ms for h in headers] == [1000, 1033, 7]
    assert [h.frame_type for h in headers] == [FrameType.IDR, FrameType.P, FrameType.HEADERS]
    assert [(h.sps_bytes, h.pps_bytes) for h in headers] == [(10, 7), (0, 0), (10, 7)]
    assert [h.stream_position_low for h in headers] == [0, len(IDR), len(IDR) + len(P)]
    assert {(h.version, h.codec, h.stream_id, h.control) for h in headers} == {(2, 4, 5, 0)}
    assert {(h.encoded_px, h.display_px) for h in headers} == {((640, 368), (640, 360))}
    assert all(h.advertised_bytes == h.payload_bytes for h in headers)
    assert all(h.is_first_part and h.is_last_part for h in headers)
    assert (parser.packets, parser.skipped_bytes, parser.bad_headers, parser.broken_payloads) == (3, 0, 0, 0)


# --- the parser ------------------------------------------------------------------------------------------------------
def a_stream(count=6, header_bytes=68):
    """(bytes, payloads) of a short stream."""
    writer = StreamWriter(header_bytes=header_bytes)
    payloads = [IDR if i % 3 == 0 else P + bytes([i]) * (7 * i) for i in range(count)]
    return b"".join(writer.picture(payload, 33 * i) for i, payload in enumerate(payloads)), payloads


def feed_in_pieces(data, cuts):
    parser = StreamParser()
    packets = []
    for begin, end in zip([0, *cuts], [*cuts, len(data)]):
        packets += parser.feed(data[begin:end])
    return parser, packets


def counters(parser):
    return parser.packets, parser.bad_headers, parser.broken_payloads, parser.skipped_bytes


@pytest.mark.parametrize("header_bytes", [64, 68, 100])
def test_split_at_every_offset(header_bytes):
    data, payloads = a_stream(3, header_bytes)
    for cut in range(len(data) + 1):
        parser, packets = feed_in_pieces(data, [cut])
        assert [p.payload for p in packets] == payloads
        assert counters(parser) == (3, 0, 0, 0)


def test_byte_by_byte_each_packet_comes_with_its_last_byte():
    data, payloads = a_stream(3)
    parser, ends = StreamParser(), []
    for i in range(len(data)):
        ends += [i + 1] * len(parser.feed(data[i : i + 1]))
    lengths = [68 + len(payload) for payload in payloads]
    assert ends == [sum(lengths[: i + 1]) for i in range(3)]


# Bytes that often trigger the parser's special cases
spice = st.sampled_from([b"P", b"Pa", b"PaV", b"PaVE", b"PaVEPaVE", b"\0", header_by_hand(), header_by_hand()[:64]])
noise = st.lists(st.one_of(spice, st.binary(max_size=80)), max_size=8).map(b"".join)


@given(st.lists(st.one_of(noise, st.just(a_stream(1)[0]), st.just(a_stream(2, 64)[0])), max_size=6), st.data())
def test_how_the_network_splits_the_bytes_does_not_matter(parts, data):
    stream = b"".join(parts)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    whole, packets = feed_in_pieces(stream, [])
    pieces, packets_of_pieces = feed_in_pieces(stream, cuts)
    assert packets_of_pieces == packets
    assert counters(pieces) == counters(whole)


@given(noise)
def test_finds_its_way_back_after_garbage(garbage):
    data, payloads = a_stream(8)
    # The garbage may announce one picture, which swallows no more than the headers inside it allow
    _, packets = feed_in_pieces(garbage + data, [])
    assert [p.payload for p in packets[-7:]] == payloads[-7:]


def test_joining_in_the_middle_of_a_payload():
    data, payloads = a_stream(3)
    parser, packets = feed_in_pieces(data[80:], [])
    assert [p.payload for p in packets] == payloads[1:]
    assert counters(parser) == (2, 0, 0, len(IDR) + 68 - 80)


@pytest.mark.parametrize("surplus", [1, 5, 68, 100, 200, 1000])
def test_a_payload_announced_too_long_costs_one_picture(surplus):
    data, payloads = a_stream(20)
    damaged = bytearray(data)
    struct.pack_into("<I", damaged, 8, len(payloads[0]) + surplus)
    parser, packets = feed_in_pieces(bytes(damaged), [])
    if surplus < 4:  # the next magic is cut: the first picture is delivered with extra bytes, the second is lost
        assert [p.payload for p in packets[1:]] == payloads[2:]
    else:
        assert [p.payload for p in packets] == payloads[1:]
        assert parser.broken_payloads == 1


def test_a_payload_announced_too_short_costs_only_its_end():
    data, payloads = a_stream(6)
    damaged = bytearray(data)
    struct.pack_into("<I", damaged, 8, len(payloads[0]) - 5)
    parser, packets = feed_in_pieces(bytes(damaged), [])
    assert [p.payload for p in packets] == [payloads[0][:-5], *payloads[1:]]
    assert counters(parser) == (6, 0, 0, 5)


def test_the_magic_alone_inside_a_payload_is_part_of_the_picture():
    payload = P + b"PaVE" + bytes(80) + b"PaVE"
    parser, packets = feed_in_pieces(StreamWriter().picture(payload, 0) + a_stream(1)[0], [])
    assert [p.payload for p in packets] == [payload, IDR]
    assert counters(parser) == (2, 0, 0, 0)


def test_absurd_headers_are_counted_and_skipped():
    good, payloads = a_stream(2)
    bad = bytearray(good[:68])
    struct.pack_into("<I", bad, 8, 2**31)
    parser, packets = feed_in_pieces(bytes(bad) + good, [])
    assert [p.payload for p in packets] == payloads
    assert counters(parser) == (2, 1, 0, 68)


def test_memory_stays_small_on_a_stream_that_is_no_video():
    parser = StreamParser()
    for _ in range(200):
        assert not parser.feed(b"no video here Pa" * 500)
    assert len(parser._buffer) < 8
    assert parser.skipped_bytes >= 200 * 8000 - 8


def test_an_advertisement_has_no_payload():
    good, payloads = a_stream(1)
    header = parse_header(good)._replace(control=int(Control.ADVERTISEMENT), payload_bytes=5000)
    parser, packets = feed_in_pieces(pack_header(header) + good, [])
    assert [p.payload for p in packets] == [b"", payloads[0]]
    assert counters(parser) == (2, 0, 0, 0)


def test_reset_forgets_half_a_picture():
    data, payloads = a_stream(2)
    parser = StreamParser()
    parser.feed(data[:80])
    parser.reset()
    assert [p.payload for p in parser.feed(data)] == payloads


class CountingBuffer(bytearray):
    """Counts the bytes that find() examines."""

    looked_at = 0

    def find(self, what, begin=0, end=None):
        place = super().find(what, begin, end)
        stop = place + len(what) if place >= 0 else min(len(self), len(self) if end is None else end)
        self.looked_at += max(0, stop - begin)
        return place


@pytest.mark.parametrize("searches_again", [False, True])
def test_a_payload_in_many_pieces_is_searched_once(searches_again):
    payload = P + bytes(60_000) + b"PaVE" + bytes(40_000)
    data, parser, packets = StreamWriter().picture(payload, 0), StreamParser(), []
    parser._buffer = CountingBuffer()
    for begin in range(0, len(data), 20):
        packets += parser.feed(data[begin : begin + 20])
        if searches_again:  # the control arm
            parser._searched = 0
    assert [p.payload for p in packets] == [payload]
    assert (parser._buffer.looked_at < 3 * len(data)) is not searches_again


# --- the assembler ---------------------------------------------------------------------------------------------------
def part(number=0, chunk=(0, 1), slice_=(0, 1), payload=b"x"):
    header = parse_header(header_by_hand())._replace(
        frame_number=number,
        chunk_index=chunk[0],
        total_chunks=chunk[1],
        slice_index=slice_[0],
        total_slices=slice_[1],
        payload_bytes=len(payload),
    )
    return Packet(header, payload)


def test_whole_pictures_pass():
    assembler = FrameAssembler()
    for packet in (part(1), part(2), part(3, (0, 0), (0, 0))):
        assert assembler.add(packet) is packet
    assert assembler.incomplete == 0


def test_chunks_and_slices_are_joined():
    assembler = FrameAssembler()
    assert assembler.add(part(7, (0, 2), (0, 2), b"a")) is None
    assert assembler.add(part(7, (1, 2), (0, 2), b"b")) is None
    assert assembler.add(part(7, (0, 2), (1, 2), b"c")) is None
    whole = assembler.add(part(7, (1, 2), (1, 2), b"d"))
    assert whole.payload == b"abcd"
    assert (whole.header.frame_number, whole.header.payload_bytes) == (7, 4)
    assert assembler.add(part(8)).header.frame_number == 8
    assert assembler.incomplete == 0


@pytest.mark.parametrize(
    "second", [part(7, (2, 3)), part(8, (1, 3)), part(8, (0, 3)), part(8), part(7, (1, 3), (1, 2))]
)
def test_a_picture_with_a_gap_is_dropped(second):
    assembler = FrameAssembler()
    assert assembler.add(part(7, (0, 3))) is None
    assembler.add(second)
    assert assembler.incomplete == 1
    assert assembler.add(part(9)).header.frame_number == 9


def test_the_end_of_a_picture_alone_is_dropped():
    assert FrameAssembler().add(part(7, (1, 2))) is None


@given(st.lists(st.builds(part, st.integers(0, 3), st.tuples(st.integers(0, 3), st.integers(0, 3)))))
def test_a_joined_picture_is_never_mixed(packets):
    assembler = FrameAssembler()
    for packet in packets:
        whole = assembler.add(packet)
        assert whole is None or whole.header.frame_number == packet.header.frame_number


def test_a_picture_of_many_parts_has_the_size_of_a_picture():
    assembler, bytes_of_a_part = FrameAssembler(), 100_000
    for number in range(255):
        assert assembler.add(part(7, (number, 255), payload=bytes(bytes_of_a_part))) is None
        assert sum(len(packet.payload) for packet in assembler._parts) <= video.MAX_PAYLOAD_BYTES
    assert assembler.incomplete == 1
    assert assembler.add(part(8)).header.frame_number == 8
