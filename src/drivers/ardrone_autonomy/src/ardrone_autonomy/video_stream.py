"""The TCP connection to the vehicle's video and the thread that owns it: bytes in, pictures out.

Connects only while somebody wants pictures.  Comes back by itself when the vehicle closes the connection, is not
reachable, or sends nothing that can be shown.
"""

import errno
import os
import select
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
SILENCE_S = 3.0  # a connection on which nothing comes for so long is given up
UNUSABLE_S = 10.0  # so is one whose pictures cannot be decoded; the next key picture may take some seconds
MAX_BACKLOG = 4  # pictures that may wait; of more only the newest are shown
_READ_BYTES = 1 << 16
_MAX_ROUND_BYTES = 1 << 20  # read at once, before decoding
# Linux stamps what arrives when it arrives, not when a busy computer reads it; Python has no names for these.
_SO_TIMESTAMPNS = _SCM_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("@qq")
_STAMP_AGE_MAX_S = 1.0  # older: the clock was set in between
_CONNECTING = (0, errno.EINPROGRESS, errno.EWOULDBLOCK)

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
        self.address = address
        self.connections = 0
        self.connected = False
        self.shown = 0  # pictures handed out
        self.skipped = 0  # pictures that were sound, but too many at once
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
        self._heard_s = 0.0  # when the connection was made, or its last packet came
        self._decoded_s = 0.0  # when the connection was made, or its last picture could be decoded
        self._foreign_before = 0  # pictures of other codecs before this connection
        self._wanted = False
        self._stopping = False
        self._bell_in, self._bell_out = socket.socketpair()
        self._bell_in.setblocking(False)
        self._bell_out.setblocking(False)
        self._thread = threading.Thread(target=self._run, name="ardrone_video", daemon=True)

    @property
    def wanted(self):
        """Somebody wants pictures."""
        return self._wanted

    def start(self):
        """Start the thread; it connects as soon as pictures are wanted."""
        self._thread.start()

    def want(self, wanted):
        """Whether pictures are wanted from now on; may be called from any thread, as often as one likes."""
        if wanted != self._wanted:
            self._wanted = wanted
            self._ring()

    def stop(self):
        """End the thread and close the sockets."""
        self._stopping = True
        self._ring()
        if self._thread.is_alive():
            self._thread.join()
        self._close()
        self._bell_in.close()
        self._bell_out.close()

    def _ring(self):
        try:
            self._bell_in.send(b"\0")
        except BlockingIOError:
            pass  # the bell already rings
        except OSError:
            return  # closed: stopped before

    # --- the thread -------------------------------------------------------------------------------------------------
    def _run(self):
        while not self._stopping:
            if not self._wanted:
                self._close()
                self._wait(None)
            elif not self._step():
                self._close()
                self._pause(RETRY_S)

    def _step(self):
        """One attempt to connect, or one round of reception. False when it did not succeed."""
        try:
            return self._connect() if self._socket is None else self._receive()
        except Exception as error:  # whatever it is: the vehicle flies without pictures, and they may come back
            self._say("error", "the video has failed and starts again: %r" % error)
            return False

    def _wait(self, timeout_s, readable=None, writable=None):
        """Wait for a socket, the bell, or until the time is over (None: for ever). True when the socket is ready."""
        read = [self._bell_out] + ([readable] if readable is not None else [])
        write = [writable] if writable is not None else []
        ready, ready_to_write, _ = select.select(read, write, (), timeout_s)
        if self._bell_out in ready:
            self._bell_out.recv(4096)
        return readable in ready or bool(ready_to_write)

    def _pause(self, duration_s):
        """Wait in any case, unless pictures are no longer wanted."""
        end_s = self._now_s() + duration_s
        while self._active() and self._now_s() < end_s:
            self._wait(max(0.0, end_s - self._now_s()))

    def _active(self):
        return self._wanted and not self._stopping

    def _say(self, level, text):
        if text != self._said:
            self._said = text
            self._report(level, text)

    def _complain(self, text):
        self._say("warn", "no video from %s:%d: %s; trying on every %g s" % (*self._target, text, RETRY_S))

    # --- connection ---------------------------------------------------------------------------------------------------
    def _connect(self):
        """True when the connection stands, or is no longer wanted."""
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        number = self._socket.connect_ex(self._target)
        if number not in _CONNECTING:
            self._complain(os.strerror(number))
            return False
        end_s = self._now_s() + CONNECT_TIMEOUT_S
        while not self._wait(max(0.0, end_s - self._now_s()), writable=self._socket):
            if not self._active():
                return True
            if self._now_s() >= end_s:
                self._complain("it does not answer")
                return False
        number = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if number:
            self._complain(os.strerror(number))
            return False
        self.connections += 1
        self.connected = True
        self._heard_s = self._decoded_s = self._now_s()
        self._foreign_before = self.decoder.foreign
        self.parser.reset()
        self.assembler = FrameAssembler()
        self.decoder.waiting = True
        return True

    def _close(self):
        self.connected = False
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    # --- reception ----------------------------------------------------------------------------------------------------
    def _receive(self):
        """One round: whatever has arrived. False when the connection is of no use any more."""
        remaining_s = self._heard_s + SILENCE_S - self._now_s()
        ready = self._wait(max(0.0, remaining_s), readable=self._socket)
        if not self._active():
            return True
        if ready:
            pictures, is_open = self._read()
            self._show(pictures)
            if not is_open:
                self._complain("the vehicle has closed the connection")
                return False
        now_s = self._now_s()
        if now_s - self._heard_s >= SILENCE_S:
            self._complain("nothing comes")
            return False
        if now_s - self._decoded_s >= UNUSABLE_S:
            is_foreign = self.decoder.foreign > self._foreign_before
            self._complain(
                "its pictures are neither H.264 nor MPEG-4 (set ~video_codec to 129)"
                if is_foreign
                else "no picture can be decoded"
            )
            return False
        return True

    def _read(self):
        """([(Packet, time of reception)], whether the connection is still open)."""
        pictures = []
        budget = _MAX_ROUND_BYTES
        while budget > 0:
            try:
                data, extras, _, _ = self._socket.recvmsg(_READ_BYTES, socket.CMSG_SPACE(_TIMESPEC.size))
            except BlockingIOError:
                return pictures, True
            except OSError:
                return pictures, False
            if not data:
                return pictures, False
            budget -= len(data)
            received_s = max(self._heard_s, self._now_s() - _age_s(extras))
            for packet in self.parser.feed(data):
                self._heard_s = received_s
                whole = self.assembler.add(packet)
                if whole is not None:
                    pictures.append((whole, received_s))
        return pictures, True

    def _show(self, pictures):
        first_shown = len(pictures) - MAX_BACKLOG
        begin = 0
        if first_shown > 0:
            keys = [i for i, (packet, _) in enumerate(pictures) if is_key(packet.header)]
            begin = keys[-1] if keys else 0
        for i, (packet, received_s) in enumerate(pictures):
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
            self._greet()
            self.shown += 1
            self._on_picture(
                Picture(rgb, packet.header, is_key(packet.header), received_s, exposure_s, self.connections)
            )

    def _greet(self):
        if self._said is not None or self.shown == 0:
            self._report("info", "video from %s:%d" % self._target)
            self._said = None


def _age_s(extras):
    """For how long [s] the last byte of a read had been there; 0 when nothing tells. extras: of socket.recvmsg."""
    for level, kind, data in extras:
        if (level, kind) == (socket.SOL_SOCKET, _SCM_TIMESTAMPNS) and len(data) >= _TIMESPEC.size:
            whole_s, rest_ns = _TIMESPEC.unpack_from(data)
            age_s = time.time() - whole_s - 1e-9 * rest_ns
            return age_s if 0.0 <= age_s <= _STAMP_AGE_MAX_S else 0.0
    return 0.0
