"""A small camera on loopback for the tests: real H.264 in PaVE on TCP 5555, with easily distinguished pictures."""

import contextlib
import functools
import select
import socket
import threading
import time
from fractions import Fraction

import av
import numpy as np

from ardrone_autonomy.protocol import VIDEO_PORT
from risc_simulator.video.stream_writer import StreamWriter

CODED_PX = (640, 368)
RATE_HZ = 30.0
PICTURES_PER_IDR = 10
# Quadrants of a picture by channel: top left, top right, bottom left, bottom right (R, G, B)
COLOURS = (
    ((200, 40, 40), (40, 200, 40), (40, 40, 200), (200, 200, 40)),
    ((40, 200, 200), (200, 40, 200), (220, 220, 220), (30, 30, 30)),
)
BAR_PX = 16  # width of the bar that moves from picture to picture


def drawing(channel, number, size_px=CODED_PX):
    """(height, width, 3) uint8 picture of four quadrants, with a white bar in column `number`."""
    width, height = size_px
    picture = np.empty((height, width, 3), np.uint8)
    half_x, half_y = width // 2, height // 2
    for colour, rows, columns in zip(
        COLOURS[channel],
        (slice(0, half_y), slice(0, half_y), slice(half_y, height), slice(half_y, height)),
        (slice(0, half_x), slice(half_x, width), slice(0, half_x), slice(half_x, width)),
    ):
        picture[rows, columns] = colour
    picture[:, BAR_PX * number : BAR_PX * (number + 1)] = 255
    return picture


@functools.cache
def encoded(channel=0, count=PICTURES_PER_IDR, size_px=CODED_PX, codec="libx264"):
    """Tuple of the `count` coded drawings; the first decodes by itself, the others depend on it.

    codec: "libx264" gives H.264 baseline, Annex B; "mpeg4" MPEG-4 part 2.
    """
    encoder = av.CodecContext.create(codec, "w")
    encoder.width, encoder.height = size_px
    encoder.pix_fmt = "yuv420p"
    encoder.time_base = Fraction(1, int(RATE_HZ))
    encoder.thread_count = 1
    encoder.gop_size = count
    encoder.max_b_frames = 0
    if codec == "libx264":
        encoder.options = {"preset": "ultrafast", "tune": "zerolatency", "profile": "baseline", "qp": "18"}
    else:
        encoder.bit_rate = 8000000
    units = []
    for number in range(count):
        frame = av.VideoFrame.from_ndarray(drawing(channel, number, size_px), format="rgb24")
        frame.pts = number
        units += [bytes(packet) for packet in encoder.encode(frame)]
    assert len(units) == count
    return tuple(units)


def seen_channel(rgb):
    """Channel whose drawing a picture shows, or None."""
    height, width, _ = rgb.shape
    centres = [rgb[height * y // 4, width * x // 4].astype(int) for y, x in ((1, 1), (1, 3), (3, 1), (3, 3))]
    for channel, colours in enumerate(COLOURS):
        if np.abs(np.array(centres) - colours).max() < 12:
            return channel
    return None


def bar_number(rgb):
    """Number of the drawing, from the position of the white bar."""
    white = rgb[rgb.shape[0] // 8].min(axis=1) > 230
    return int(np.flatnonzero(white)[BAR_PX // 2] // BAR_PX)


class ScriptedVideo:
    """A context manager. Films all the time, with or without a connection; attributes may be changed meanwhile.

    channel: function that returns 0 (front) or 1 (bottom), the camera that films.
    alter: function from a picture with its header (bytes) to the bytes that are sent instead.
    """

    def __init__(self, address, channel=lambda: 0, header_bytes=68, alter=lambda data: data):
        self.address = address
        self.channel = channel
        self.header_bytes = header_bytes
        self.clients = 0  # connections so far
        self.silent = False  # True: films, but sends nothing
        self.noise = b""  # sent before the next picture
        self.alter = alter
        self.started_s = time.monotonic()  # when the clock of the headers read 0
        self._stop = threading.Event()
        self._alive = threading.Event()  # cleared: the port is closed
        self._client = None
        for channel_number in range(2):  # encode before the clock starts
            encoded(channel_number)

    def __enter__(self):
        self._listener = self._listen()
        self._alive.set()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()
        self._drop()
        self._listener.close()

    def _listen(self):
        listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind((self.address, VIDEO_PORT))
        listener.listen()
        return listener

    @property
    def has_client(self):
        """A client is connected."""
        return self._client is not None

    @contextlib.contextmanager
    def dead(self):
        """Inside, the connection is cut and the port is closed."""
        self._alive.clear()
        while self._listener.fileno() >= 0 or self.has_client:
            time.sleep(0.001)
        yield
        self._alive.set()

    def hang_up(self):
        """Cut the connection; the port stays open."""
        client = self._client
        if client is not None:
            client.shutdown(socket.SHUT_RDWR)

    def _drop(self):
        client, self._client = self._client, None
        if client is not None:
            client.close()

    def _run(self):
        writer, channel, number, stream_id = None, None, 0, 1
        next_s = time.monotonic()
        while not self._stop.is_set():
            self._serve(max(0.0, next_s - time.monotonic()))
            if time.monotonic() < next_s:
                continue
            if writer is None or writer.header_bytes != self.header_bytes:
                writer = StreamWriter(header_bytes=self.header_bytes, stream_id=stream_id)
            if channel != self.channel():
                channel, number = self.channel(), 0
                stream_id += 1
                writer.stream_id = stream_id
            units = encoded(channel)
            # exposed on schedule, however late this thread runs
            data = writer.picture(units[number % len(units)], 1e3 * (next_s - self.started_s))
            next_s += 1.0 / RATE_HZ
            number += 1
            if not self.silent:
                noise, self.noise = self.noise, b""
                self._send(noise + self.alter(data))

    def _serve(self, timeout_s):
        if not self._alive.is_set():
            self._listener.close()  # before the client notices, and comes back
            self._drop()
            if not self._alive.wait(timeout_s):
                return
        if self._listener.fileno() < 0:
            self._listener = self._listen()
        sockets = [self._listener] + ([self._client] if self._client is not None else [])
        readable, _, _ = select.select(sockets, (), (), timeout_s)
        if self._client in readable:  # clients send nothing: this one has disconnected
            self._drop()
        if self._listener in readable:
            self._drop()
            self._client, _ = self._listener.accept()
            self.clients += 1

    def _send(self, data):
        if self._client is not None:
            try:
                self._client.sendall(data)
            except OSError:
                self._drop()
