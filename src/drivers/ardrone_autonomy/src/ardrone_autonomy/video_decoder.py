"""Decodes the pictures of the video stream to RGB. One picture in, at most one out, none delayed. No sockets, no ROS.

An AR.Drone 2.0 sends H.264; while it records to its USB key it sends MPEG-4 part 2.

Incomplete pictures are not shown at all: after a gap in the frame numbers or a damaged picture a decoder would go on
with smears where the missing picture had changed something, and measurements in such pictures would be wrong.  So
decoding waits for the next key picture, which decodes by itself, as it does when it joins in the middle.
"""

import contextlib

import av
import numpy as np
from av.codec.context import Flags
from av.video.reformatter import VideoReformatter

from ardrone_autonomy.protocol.video import Codec, FrameType

MAX_PIXELS = 1 << 20  # 720p has 921600; a damaged header must not make the decoder ask for gigabytes
_CHANNELS = 3
_DECODERS = {Codec.MPEG4_AVC: "h264", Codec.MPEG4_VISUAL: "mpeg4"}


def is_key(header):
    """Whether a picture (its PaveHeader) decodes by itself, and the following ones need nothing from before it."""
    return header.frame_type == FrameType.IDR or (
        header.codec == Codec.MPEG4_VISUAL and header.frame_type == FrameType.I
    )


class PictureDecoder:
    """Decodes the Packets of a stream in order; a new stream id, codec or size restarts the decoder."""

    def __init__(self):
        self.decoded = 0  # pictures
        self.errors = 0  # damaged pictures
        self.unusable = 0  # valid pictures of which a reference picture is missing
        self.missing = 0  # pictures that the aircraft or the network has left out
        self.foreign = 0  # pictures of another codec
        self.waiting = True  # for a key picture
        self._context = None
        self._headers = None  # payload of the newest picture headers of this stream
        self._reformatter = None
        self._stream = None
        self._frame_number = None

    def decode(self, packet, convert=True):
        """Return the picture as (height, width, 3) uint8 array, R G B, cropped to the display size; None without one.

        packet: protocol.video.Packet of a whole picture.  convert=False: return None as well; the picture is decoded
        only because the next ones depend on it.
        """
        header = packet.header
        if header.codec not in _DECODERS:
            self.foreign += 1
            return None
        stream = header.stream_id, header.codec, header.encoded_px
        if stream != self._stream:
            self._stream = stream
            self._frame_number = self._headers = None
            self.waiting = True
            self._open()
        elif self._frame_number is not None and header.frame_number != self._frame_number:
            self.missing += max(0, header.frame_number - self._frame_number)
            self.waiting = True
        self._frame_number = header.frame_number + 1
        if not packet.payload:
            return None
        if header.frame_type == FrameType.HEADERS:
            self._feed_headers(packet.payload)
            return None
        if self.waiting and not is_key(header):
            self.unusable += 1
            return None
        frame = self._decode(packet.payload, header)
        self.waiting = frame is None
        if frame is None:
            self.errors += 1
            return None
        self.decoded += 1
        return self._rgb(frame, header) if convert else None

    def pass_over(self, header):
        """Skip the picture of this PaveHeader: it does not count as missing, but decoding waits for a key picture."""
        self.waiting = True
        if self._frame_number is not None:
            self._frame_number = header.frame_number + 1

    def _open(self):
        _, codec, _ = self._stream
        self._context = av.CodecContext.create(_DECODERS[codec], "r")
        self._context.flags |= Flags.low_delay
        self._context.thread_count = 1  # more threads would delay pictures, and the other cores are busy
        self._context.options = {"max_pixels": "%d" % MAX_PIXELS}
        self._reformatter = VideoReformatter()

    def _feed_headers(self, payload):
        self._headers = payload
        with contextlib.suppress(av.FFmpegError):  # "no picture in it", as expected; the decoder keeps the headers
            self._context.decode(av.Packet(payload))

    def _decode(self, payload, header):
        """Return the frame of this picture; None when it is damaged.

        Damaged parameters may make the decoder delay its output permanently, even after valid ones: it would then
        return an older picture each time. Such a decoder is replaced.
        """
        packet = av.Packet(payload)
        packet.pts = packet.dts = header.frame_number
        try:
            frames = self._context.decode(packet)
        except av.FFmpegError:
            return None
        if not frames or frames[-1].pts != header.frame_number:
            self._open()
            if self._headers is not None:
                self._feed_headers(self._headers)
            return None
        return None if frames[-1].is_corrupt else frames[-1]

    def _rgb(self, frame, header):
        rgb = self._reformatter.reformat(frame, format="rgb24", threads=1)
        plane = rgb.planes[0]
        rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
        width_px = min(rgb.width, header.display_width_px or rgb.width)
        height_px = min(rgb.height, header.display_height_px or rgb.height)
        return rows[:height_px, : _CHANNELS * width_px].reshape(height_px, width_px, _CHANNELS)
