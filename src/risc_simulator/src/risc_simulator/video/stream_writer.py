"""Frames pictures in PaVE, as an AR.Drone 2.0 does; ardrone_autonomy.protocol.video reads it."""

import re

from ardrone_autonomy.protocol.video import VERSION, Codec, FrameType, PaveHeader, pack_header

_UINT32 = 0xFFFFFFFF
_NAL_IDR, _NAL_SPS, _NAL_PPS = 5, 7, 8
_START = re.compile(b"\0?\0\0\1(?=.)", re.DOTALL)


def nal_units(payload):
    """(type, first byte, end) of every NAL unit of an Annex B payload; its start code (3 or 4 bytes) is included."""
    starts = [(payload[found.end()] & 0x1F, found.start()) for found in _START.finditer(payload)]
    ends = [begin for _, begin in starts[1:]] + [len(payload)]
    return [(kind, begin, end) for (kind, begin), end in zip(starts, ends)]


class StreamWriter:
    """Puts the pictures of one encoder into PaVE; frame number and stream position count on from picture to picture.

    encoded_px, display_px: (width, height).  header_bytes: 64 (firmware 2.0 and 2.1) or 68.
    stream_id: one for each codec and camera; may be changed between pictures, if the next picture is an IDR.
    """

    def __init__(self, encoded_px=(640, 368), display_px=(640, 360), header_bytes=68, stream_id=1):
        self.encoded_px = tuple(encoded_px)
        self.display_px = tuple(display_px)
        self.header_bytes = header_bytes
        self.stream_id = stream_id
        self._frame_number = 0
        self._position = 0
        self._last = None  # PaveHeader of the newest picture

    def picture(self, payload, timestamp_ms):
        """Header and payload of one picture, in one bytes object.

        payload: one access unit, Annex B.  timestamp_ms: the aircraft's clock at exposure, any integer; it wraps at
        2**32.  The type is found in the payload: IDR, headers only, else P.
        """
        units = nal_units(payload)
        kinds = {kind for kind, _, _ in units}
        if _NAL_IDR in kinds:
            frame_type = FrameType.IDR
        elif kinds and kinds <= {_NAL_SPS, _NAL_PPS}:
            frame_type = FrameType.HEADERS
        else:
            frame_type = FrameType.P
        header = PaveHeader(
            version=VERSION,
            codec=int(Codec.MPEG4_AVC),
            header_bytes=self.header_bytes,
            payload_bytes=len(payload),
            encoded_width_px=self.encoded_px[0],
            encoded_height_px=self.encoded_px[1],
            display_width_px=self.display_px[0],
            display_height_px=self.display_px[1],
            frame_number=self._frame_number,
            timestamp_ms=int(timestamp_ms) & _UINT32,
            total_chunks=1,
            chunk_index=0,
            frame_type=int(frame_type),
            control=0,
            stream_position_low=self._position & _UINT32,
            stream_position_high=self._position >> 32,
            stream_id=self.stream_id,
            total_slices=1,
            slice_index=0,
            sps_bytes=_bytes_of(units, _NAL_SPS),
            pps_bytes=_bytes_of(units, _NAL_PPS),
            reserved=0,
            advertised_bytes=len(payload),
        )
        data = pack_header(header) + payload
        self._frame_number = self._frame_number + 1 & _UINT32
        self._position += len(payload)
        return data


def _bytes_of(units, wanted):
    return min(255, sum(end - begin for kind, begin, end in units if kind == wanted))  # the field has one byte
