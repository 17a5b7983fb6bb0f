"""Encodes pictures as an AR.Drone 2.0 does: H.264 baseline, coded 640 x 368, one slice group a frame, no B frames."""

from fractions import Fraction

import av
import cv2
from av.video.reformatter import Interpolation, VideoReformatter

MACROBLOCK_PX = 16
KEYFRAME_PERIOD_S = 1.0


class H264Encoder:
    """One elementary stream. A new one starts with an IDR frame that carries SPS and PPS."""

    def __init__(self, width_px, height_px, rate_hz, bitrate_kbit_s):
        self.coded_px = tuple(-(-side_px // MACROBLOCK_PX) * MACROBLOCK_PX for side_px in (width_px, height_px))
        self._padding = (self.coded_px[1] - height_px, self.coded_px[0] - width_px)
        self._frames = 0
        self._reformatter = VideoReformatter()
        context = self._context = av.CodecContext.create("libx264", "w")
        context.width, context.height = self.coded_px
        context.pix_fmt = "yuv420p"
        context.time_base = Fraction(1, 90000)
        context.framerate = Fraction(rate_hz).limit_denominator(1000)
        context.bit_rate = int(1000 * bitrate_kbit_s)
        context.gop_size = max(1, int(round(rate_hz * KEYFRAME_PERIOD_S)))
        context.max_b_frames = 0
        context.thread_count = 1
        context.profile = "Baseline"
        context.options = {
            "preset": "ultrafast",
            "tune": "zerolatency",
            "level": "3.0",
            "x264-params": "repeat-headers=1:annexb=1:scenecut=0:sliced-threads=0",
            "maxrate": str(int(1000 * bitrate_kbit_s)),
            "bufsize": str(int(1000 * bitrate_kbit_s / 4)),
        }

    def encode(self, picture_bgr):
        """One access unit (Annex B bytes) of one picture (h, w, 3) uint8, BGR."""
        if self._padding != (0, 0):
            picture_bgr = cv2.copyMakeBorder(
                picture_bgr, 0, self._padding[0], 0, self._padding[1], cv2.BORDER_REPLICATE
            )
        # Not OpenCV's conversion: it takes the colour of each 2 x 2 block from one corner, and moves it half a pixel.
        frame = self._reformatter.reformat(
            av.VideoFrame.from_ndarray(picture_bgr, format="bgr24"),
            format="yuv420p",
            interpolation=Interpolation.BILINEAR,
            threads=1,
        )
        frame.pts = self._frames
        frame.time_base = self._context.time_base
        self._frames += int(self._context.time_base.denominator / self._context.framerate)
        return b"".join(map(bytes, self._context.encode(frame)))
