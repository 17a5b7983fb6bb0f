import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scripted_video import COLOURS, PICTURES_PER_IDR, bar_number, drawing, encoded, seen_channel

from ardrone_autonomy.protocol.video import Codec, FrameType, StreamParser
from ardrone_autonomy.video_decoder import PictureDecoder
from risc_simulator.video.stream_writer import StreamWriter, nal_units


def packets_of(units, **writer):
    stream = StreamWriter(**writer)
    return StreamParser().feed(b"".join(stream.picture(unit, 33 * i) for i, unit in enumerate(units)))


def damaged(packet):
    payload = bytearray(packet.payload)
    for i in range(20, len(payload), 3):
        payload[i] ^= 0x5A
    return packet._replace(payload=bytes(payload))


@pytest.fixture
def packets():
    return packets_of(encoded() * 3)


def test_one_picture_in_one_picture_out_with_the_right_colours(packets):
    decoder = PictureDecoder()
    for i, packet in enumerate(packets):
        rgb = decoder.decode(packet)
        assert (rgb.shape, rgb.dtype) == ((360, 640, 3), np.uint8)
        assert bar_number(rgb) == i % PICTURES_PER_IDR  # this picture, not an earlier one
        assert seen_channel(rgb) == 0
        inner = np.abs(rgb.astype(int) - drawing(0, i % PICTURES_PER_IDR)[:360])
        assert np.median(inner) <= 3
    assert (decoder.decoded, decoder.errors, decoder.unusable, decoder.missing) == (len(packets), 0, 0, 0)


class Bits:
    """Reads bits and Exp-Golomb numbers."""

    def __init__(self, data):
        self.text = "".join("{:08b}".format(byte) for byte in data)
        self.position = 0

    def take(self, count):
        self.position += count
        return int(self.text[self.position - count : self.position], 2)

    def golomb(self):
        zeros = self.text.index("1", self.position) - self.position
        self.position += zeros
        return self.take(zeros + 1) - 1


def without_vui(unit):
    """The access unit with an SPS as short as the aircraft's, without VUI (delay and order of pictures)."""
    (kind, _, end), *_ = nal_units(unit)
    assert kind == 7
    bits = Bits(unit[5:end].replace(b"\0\0\3", b"\0\0"))
    assert bits.take(8) == 66  # baseline
    bits.take(16)
    for _ in range(2):  # its id, length of frame numbers
        bits.golomb()
    assert bits.golomb() == 2  # pictures are in order
    bits.golomb()
    bits.take(1)
    assert (bits.golomb(), bits.golomb()) == (39, 22)  # macroblocks
    assert [bits.take(1) for _ in range(3)] == [1, 1, 0]  # no fields, direct 8 x 8, no cropping
    text = bits.text[: bits.position] + "01"
    text += "0" * (-len(text) % 8)
    sps = bytes(int(text[i : i + 8], 2) for i in range(0, len(text), 8))
    return unit[:5] + sps + unit[end:]


def test_the_parameter_sets_of_the_aircraft_do_not_delay_pictures():
    first, *rest = encoded()
    short = without_vui(first)
    assert len(first) - len(short) > 10
    decoder = PictureDecoder()
    assert [bar_number(decoder.decode(packet)) for packet in packets_of([short, *rest])] == list(range(len(rest) + 1))


def test_red_is_the_first_channel(packets):
    rgb = PictureDecoder().decode(packets[0])
    assert np.abs(rgb[170, 300].astype(int) - COLOURS[0][0]).max() < 12


def test_pictures_are_cropped_at_the_bottom_not_scaled(packets):
    rgb = PictureDecoder().decode(packets[0])
    border = np.flatnonzero(np.abs(np.diff(rgb[:, 300].astype(int), axis=0)).max(axis=1) > 60)
    assert 183 in border  # half of 368


@pytest.mark.parametrize("display_px", [(640, 368), (320, 100), (0, 0), (1280, 720)])
def test_the_display_size_never_exceeds_what_was_decoded(display_px):
    packet = packets_of(encoded()[:1], display_px=display_px)[0]
    height, width, _ = PictureDecoder().decode(packet).shape
    wanted = [min(640, display_px[0] or 640), min(368, display_px[1] or 368)]
    assert [width, height] == wanted


def test_joining_in_the_middle_waits_for_an_idr(packets):
    decoder = PictureDecoder()
    shown = [bar_number(rgb) for rgb in map(decoder.decode, packets[4:15]) if rgb is not None]
    assert shown == [0, 1, 2, 3, 4]
    assert (decoder.unusable, decoder.errors) == (6, 0)


def test_a_gap_hides_everything_up_to_the_next_idr(packets):
    decoder = PictureDecoder()
    results = [decoder.decode(packet) for i, packet in enumerate(packets[:13]) if i not in (4, 5)]
    assert [rgb is not None for rgb in results] == [True] * 4 + [False] * 4 + [True] * 3
    assert (decoder.missing, decoder.unusable, decoder.errors) == (2, 4, 0)


@pytest.mark.parametrize("spoil", [damaged, lambda p: p._replace(payload=p.payload[: len(p.payload) // 3])])
@pytest.mark.parametrize("which", [0, 5])
def test_a_damaged_picture_is_counted_and_hidden(packets, spoil, which):
    decoder = PictureDecoder()
    packets[which] = spoil(packets[which])
    results = [decoder.decode(packet) for packet in packets[:20]]
    assert decoder.errors == 1
    assert results[which] is None
    for i, rgb in enumerate(results):
        assert (rgb is None) == (which <= i < PICTURES_PER_IDR)
        assert rgb is None or bar_number(rgb) == i % PICTURES_PER_IDR


def test_a_new_stream_id_starts_anew():
    decoder = PictureDecoder()
    for packet in packets_of(encoded(0)[:5], stream_id=1):
        assert seen_channel(decoder.decode(packet)) == 0
    second = packets_of(encoded(1), stream_id=2)
    assert decoder.decode(second[3]) is None
    assert [seen_channel(decoder.decode(packet)) for packet in second] == [1] * PICTURES_PER_IDR
    assert decoder.errors == 0


def test_another_size_starts_anew():
    decoder = PictureDecoder()
    assert decoder.decode(packets_of(encoded()[:1])[0]).shape == (360, 640, 3)
    small = packets_of(encoded(0, 5, (320, 192)), encoded_px=(320, 192), display_px=(320, 180))
    assert [decoder.decode(packet).shape for packet in small] == [(180, 320, 3)] * 5
    assert decoder.decode(packets_of(encoded()[:1])[0]).shape == (360, 640, 3)


def test_pictures_that_are_not_wanted_are_decoded_all_the_same(packets):
    decoder = PictureDecoder()
    for packet in packets[:4]:
        assert decoder.decode(packet, convert=False) is None
    assert decoder.decoded == 4
    assert bar_number(decoder.decode(packets[4])) == 4


def test_parameter_sets_may_come_by_themselves():
    unit = encoded()[0]
    end = StreamParser().feed(StreamWriter().picture(unit, 0))[0].header
    split = end.sps_bytes + end.pps_bytes
    headers, picture, *rest = packets_of([unit[:split], unit[split:], *encoded()[1:3]])
    decoder = PictureDecoder()
    assert decoder.decode(headers) is None
    assert [bar_number(decoder.decode(packet)) for packet in (picture, *rest)] == [0, 1, 2]
    assert decoder.errors == 0


def test_the_codec_of_a_recording_aircraft(packets):
    def as_mpeg4(packet, number):
        kind = FrameType.I if number == 0 else FrameType.P
        return packet._replace(
            header=packet.header._replace(codec=int(Codec.MPEG4_VISUAL), frame_type=int(kind), stream_id=2)
        )

    recorded = [as_mpeg4(packet, i) for i, packet in enumerate(packets_of(encoded(codec="mpeg4")))]
    decoder = PictureDecoder()
    assert bar_number(decoder.decode(packets[0])) == 0
    assert decoder.decode(recorded[2]) is None
    for i, packet in enumerate(recorded):
        rgb = decoder.decode(packet)
        assert (seen_channel(rgb), bar_number(rgb)) == (0, i)
    assert decoder.decode(packets[1]) is None
    assert bar_number(decoder.decode(packets[10])) == 0
    assert (decoder.errors, decoder.foreign) == (0, 0)


def test_other_codecs_are_counted(packets):
    decoder = PictureDecoder()
    header = packets[0].header._replace(codec=int(Codec.P264))
    assert decoder.decode(packets[0]._replace(header=header)) is None
    assert (decoder.foreign, decoder.errors) == (1, 0)
    assert decoder.decode(packets[0]) is not None


def test_an_empty_payload_is_no_picture_and_no_error(packets):
    decoder = PictureDecoder()
    decoder.decode(packets[0])
    assert decoder.decode(packets[1]._replace(payload=b"")) is None
    assert decoder.errors == 0


def test_a_size_that_would_eat_the_memory_is_refused():
    decoder = PictureDecoder()
    large = packets_of(encoded(0, 1, (2048, 1152)), encoded_px=(2048, 1152), display_px=(2048, 1152))
    assert decoder.decode(large[0]) is None
    assert decoder.errors == 1


@settings(max_examples=60)
@given(st.lists(st.tuples(st.integers(0, 29), st.integers(0, 400), st.binary(max_size=60)), max_size=10))
@example([(0, 23, b"*\x91")])  # parameters that make a decoder hold eight pictures back
@example([(0, 23, b"*$")])
def test_whatever_comes_nothing_raises_and_the_next_idr_is_shown(changes):
    packets = packets_of(encoded() * 3)
    for which, offset, junk in changes:
        payload = packets[which].payload
        packets[which] = packets[which]._replace(payload=payload[:offset] + junk + payload[offset + len(junk) :])
    decoder = PictureDecoder()
    for packet in packets:
        decoder.decode(packet)
    header = packets[-1].header
    for i, packet in enumerate(packets_of(encoded())):
        rgb = decoder.decode(packet._replace(header=packet.header._replace(frame_number=header.frame_number + 1 + i)))
        assert (seen_channel(rgb), bar_number(rgb)) == (0, i)


def test_the_header_alone_decides_what_an_idr_is(packets):
    """A P picture whose header says IDR gives no picture and no crash."""
    decoder = PictureDecoder()
    liar = packets[3]._replace(header=packets[3].header._replace(frame_type=1))
    assert decoder.decode(liar) is None
    assert decoder.errors == 1


def test_the_test_pictures_have_no_cropping_of_their_own():
    """Aircraft announce 640 x 368 in the SPS; so must these pictures, or the cropping tests would test nothing."""
    decoder = PictureDecoder()
    packet = packets_of(encoded()[:1], display_px=(640, 368))[0]
    assert decoder.decode(packet).shape == (368, 640, 3)
    assert struct.unpack_from(">I", packet.payload)[0] == 1
