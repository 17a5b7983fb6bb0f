"""The TCP connection to the vehicle's video and the thread that owns it: bytes in, pictures out.

Connects only while pictures are wanted.  Reconnects by itself when the vehicle closes the connection, is not
reachable, or sends nothing that can be shown.
"""

import contextlib
import os
import socket
import struct
import threading
import time
from collections import namedtuple

from ardrone_autonomy.protocol import VIDEO_PORT
from ardrone_autonomy.protocol.video import FrameAssembler, StreamParser
from ardrone_autonomy.video_clock import ExposureClock
from ardrone_autonomy.video_decoder import PictureDecoder, is_key

RETRY_S = 1.0  # between two attempts to connect
CONNECT_TIMEOUT_S = 3.0
SILENCE_S = 3.0  # a connection on which nothing arrives for this long is given up
UNUSABLE_S = 10.0  # so is one whose pictures cannot be decoded; the next key picture may take some seconds
MAX_BACKLOG = 4  # pictures that may wait; if there are more, only the newest ones are shown
_READ_BYTES = 1 << 20  # read at once, before decoding
# Linux stamps data on arrival, not when a busy computer reads it; Python has no names for these constants.
_SO_TIMESTAMPNS = _SCM_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("@qq")
_STAMP_AGE_MAX_S = 1.0  # older: the clock was set in between

Picture = namedtuple(
    "Picture",
    (
        "rgb",  # (height, width, 3) uint8 array
        "header",  # protocol.video.PaveHeader
        "is_key",  # decodes by itself
        "received_s",  # time of reception
        "exposure_s",  # estimated time of exposure, see video_clock
        "connection",  # number of the TCP connection
    ),
)


class VideoStream:
    """Pictures of one vehicle.

    address: IPv4 address of the vehicle.
    on_picture: called in the thread with every Picture; must be short.
    report: function (level, text), level "info", "warn" or "error".
    latency_s: see video_clock.ExposureClock.
    """

    def __init__(self, address, on_picture, report, latency_s=0.0, port=VIDEO_PORT, clock=time.monotonic):
        self.connections = 0
        self.connected = False
        self.wanted = False  # pictures are wanted
        self.shown = 0  # pictures handed out
        self.skipped = 0  # valid pictures that were not shown because too many arrived at once
        self.last_s = None  # when the last picture was received
        self.clock = ExposureClock(latency_s)
        self.parser = StreamParser()
        self.assembler = FrameAssembler()
        self.decoder = PictureDecoder()
        self._target = (address, port)
        self._on_picture = on_picture
        self._report = report
        self._now_s = clock
        self._said = None  # the last warning: it is not repeated with every attempt
        self._socket = None
        self._heard_s = 0.0  # when the connection was made or the last packet arrived
        self._decoded_s = 0.0  # when the connection was made or the last picture was decoded
        self._stopping = False
        self._changed = threading.Event()  # wanted or _stopping
        self._thread = threading.Thread(target=self._run, name="ardrone_video", daemon=True)

    def start(self):
        """Start the thread; it connects as soon as pictures are wanted."""
        self._thread.start()

    def want(self, wanted):
        """Set whether pictures are wanted; may be called from any thread, repeatedly."""
        if wanted != self.wanted:
            self._change(wanted)

    def stop(self):
        """End the thread and close the socket."""
        self._stopping = True
        self._change(False)
        if self._thread.is_alive():
            self._thread.join()

    def _change(self, wanted):
        self.wanted = wanted
        self._changed.set()
        connection = self._socket
        if not wanted and connection is not None:
            self.connected = False
            with contextlib.suppress(OSError):  # not connected yet, or no longer
                connection.shutdown(socket.SHUT_RDWR)  # wakes the thread that waits for it

    # --- the thread -------------------------------------------------------------------------------------------------
    def _run(self):
        while True:
            self._changed.clear()
            if self._stopping:
                return
            try:
                problem = self._stream() if self.wanted else ""
            except Exception as error:  # any failure: the vehicle flies without pictures, and they may come back
                problem = ""
                self._say("error", "the video failed and is restarting: %r" % error)
            if problem and self.wanted:
                where = (*self._target, problem, RETRY_S)
                self._say("warn", "no video from %s:%d: %s; retrying every %g s" % where)
            self._changed.wait(RETRY_S if self.wanted else None)

    def _say(self, level, text):
        if text != self._said:
            self._said = text
            self._report(level, text)

    def _stream(self):
        """Receive until pictures are no longer wanted or a problem occurs; return the problem ("" = none)."""
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as sock:
            self._socket = sock
            try:
                sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
                sock.settimeout(CONNECT_TIMEOUT_S)
                sock.connect(self._target)
                self.connections += 1
                self.connected = True
                self._heard_s = self._decoded_s = self._now_s()
                self.parser.reset()
                self.assembler = FrameAssembler()
                self.decoder.waiting = True
                return self._receive(sock, self.decoder.foreign)
            except TimeoutError:
                return "nothing arrives" if self.connected else "it does not answer"
            except OSError as error:
                return os.strerror(error.errno)
            finally:
                self.connected = False
                self._socket = None

    def _receive(self, sock, foreign_before):
        """Receive and show pictures, see _stream. foreign_before: count of `decoder.foreign` before this connection."""
        while self.wanted and not self._stopping:
            sock.settimeout(max(self._heard_s + SILENCE_S - self._now_s(), 1e-3))
            data, extras, _, _ = sock.recvmsg(_READ_BYTES, socket.CMSG_SPACE(_TIMESPEC.size))
            if not data:
                return "the vehicle has closed the connection"
            received_s = max(self._heard_s, self._now_s() - _age_s(extras))
            packets = self.parser.feed(data)
            if packets:
                self._heard_s = received_s
            self._show([whole for whole in map(self.assembler.add, packets) if whole is not None], received_s)
            if self._now_s() - self._decoded_s >= UNUSABLE_S:
                if self.decoder.foreign > foreign_before:
                    return "its pictures are neither H.264 nor MPEG-4 (set ~video_codec to 129)"
                return "no picture can be decoded"
        return ""

    def _show(self, pictures, received_s):
        first_shown = len(pictures) - MAX_BACKLOG
        begin = 0
        if first_shown > 0:
            begin = max((i for i, packet in enumerate(pictures) if is_key(packet.header)), default=0)
        for i, packet in enumerate(pictures):
            exposure_s = self.clock.exposure_s(packet.header.timestamp_ms, received_s)
            if i < begin:
                self.decoder.pass_over(packet.header)
                self.skipped += 1
                continue
            decoded = self.decoder.decoded
            rgb = self.decoder.decode(packet, convert=i >= first_shown)
            if self.decoder.decoded == decoded:
                continue
            self._decoded_s = self.last_s = received_s
            if rgb is None:
                self.skipped += 1
                continue
            if self._said is not None or self.shown == 0:
                self._report("info", "video from %s:%d" % self._target)
                self._said = None
            self.shown += 1
            self._on_picture(
                Picture(rgb, packet.header, is_key(packet.header), received_s, exposure_s, self.connections)
            )


def _age_s(extras):
    """Time [s] since the last byte of a read arrived; 0 if unknown. extras: ancillary data of socket.recvmsg."""
    for level, kind, data in extras:
        if (level, kind) == (socket.SOL_SOCKET, _SCM_TIMESTAMPNS) and len(data) >= _TIMESPEC.size:
            whole_s, rest_ns = _TIMESPEC.unpack_from(data)
            age_s = time.time() - whole_s - 1e-9 * rest_ns
            return age_s if 0.0 <= age_s <= _STAMP_AGE_MAX_S else 0.0
    return 0.0
