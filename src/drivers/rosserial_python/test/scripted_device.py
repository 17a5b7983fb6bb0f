"""A board with a rosserial sketch, as seen on its line: a pseudo-terminal or a TCP connection."""

import contextlib
import io
import os
import select
import socket
import struct
import threading
import time
import tty

from rosserial_python import protocol
from rosserial_python.protocol import Decoder, Id, Topic, encode

BUFFER_BYTES = 512


def serialised(message):
    data = io.BytesIO()
    message.serialize(data)
    return data.getvalue()


def topic_of(topic_id, name, kind, md5sum=None, half=None):
    """Topic of a message class, or of one half of a service class: "_request_class" or "_response_class"."""
    message_class = getattr(kind, half) if half else kind
    return Topic(topic_id, name, kind._type, md5sum or message_class._md5sum, BUFFER_BYTES)


def announcement(kind, topic):
    texts = b"".join(struct.pack("<I", len(t)) + t.encode() for t in (topic.name, topic.type, topic.md5sum))
    return encode(kind, struct.pack("<H", topic.topic_id) + texts + struct.pack("<i", topic.buffer_bytes))


class PseudoTerminal:
    """A port whose path stays the same when it is unplugged and plugged in again."""

    def __init__(self, path):
        self.path = self.url = str(path)
        self._path = path
        self._ends = None

    def plug_in(self):
        """Make a new pseudo-terminal at the path. Returns the board's end."""
        ours, theirs = os.openpty()
        tty.setraw(theirs)
        os.set_blocking(ours, False)
        self._path.unlink(missing_ok=True)
        self._path.symlink_to(os.ttyname(theirs))
        self._ends = ours, theirs
        return ours

    def unplug(self, keep_path=False):
        self.close()
        if not keep_path:
            self._path.unlink()

    def close(self):
        if self._ends is not None:
            for end in self._ends:
                os.close(end)
        self._ends = None


class Board:
    """Runs a sketch in a thread. `plug(fd)`: connect its end of the line (non-blocking); None: unplug it.

    announced: {protocol id, e.g. Id.PUBLISHER: [Topic]}.
    """

    def __init__(self, announced, period_s=0.1, beat=b""):
        """beat: packet that it sends every period_s once its topics were requested, as a sketch that publishes."""
        self.announced, self._period_s, self.beat = announced, period_s, beat
        self.received = []  # (monotonic time, Packet), without topic requests
        self.requests = 0  # topic requests
        self.is_configured = False
        self.is_silent = False  # neither receives nor sends: power off
        self.is_stalled = False  # reads nothing; bytes wait in the line's buffer
        self.on_packet = lambda packet: b""  # bytes that answer a packet
        self.damage = lambda data: data  # changes by the line to what it sends
        self._lock, self._over, self._end = threading.RLock(), threading.Event(), None
        self._decoder = Decoder()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def plug(self, end):
        with self._lock:
            self._end, self._decoder = end, Decoder()

    def reset(self):
        """Press the reset button."""
        with self._lock:
            self.is_configured = False
            self._decoder = Decoder()

    def send(self, data):
        """Write bytes to the line unchanged."""
        with self._lock:
            if self._end is not None and not self.is_silent:
                with contextlib.suppress(OSError):  # the host has closed the line
                    os.write(self._end, data)

    def of_topic(self, topic_id):
        """Payloads received on a topic."""
        return [packet.payload for _, packet in list(self.received) if packet.topic_id == topic_id]

    def stop(self):
        self._over.set()
        self._thread.join(5.0)
        assert not self._thread.is_alive()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()

    def _run(self):
        beat_s = 0.0
        while not self._over.is_set():
            with self._lock:
                end = self._end
                if end is None or self.is_stalled:
                    readable = False
                else:
                    readable = bool(select.select([end], [], [], 0.0)[0])
                if readable:
                    self._read(end)
                if self.is_configured and self.beat and time.monotonic() >= beat_s:
                    beat_s = time.monotonic() + self._period_s
                    self.send(self.damage(self.beat))
            if not readable:
                time.sleep(0.0005)  # a poll of the line, not a wait for anything

    def _read(self, end):
        try:
            data = os.read(end, 4096)
        except OSError:
            return
        if self.is_silent:
            return
        for packet in self._decoder.feed(data, time.monotonic()):
            if packet == (Id.PUBLISHER, b""):
                self.requests += 1
                self.is_configured = True
                topics = [announcement(kind, topic) for kind, topics in self.announced.items() for topic in topics]
                self.send(self.damage(encode(Id.TIME, bytes(8)) + b"".join(topics)))
            else:
                if packet.topic_id == Id.TX_STOP:
                    self.is_configured = False
                self.received.append((time.monotonic(), packet))
                self.send(self.on_packet(packet))


class Listener:
    """A board with a network: listens, and serves the newest connection."""

    def __init__(self, board):
        self._board, self._connection = board, None
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = "socket://127.0.0.1:%d" % self._server.getsockname()[1]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        while True:
            try:
                connection, _ = self._server.accept()
            except OSError:
                return
            connection.setblocking(False)
            self._board.plug(connection.fileno())
            if self._connection is not None:
                self._connection.close()
            self._connection = connection

    def close(self):
        self._board.plug(None)
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self._thread.join(5.0)
        if self._connection is not None:
            self._connection.close()


__all__ = ["BUFFER_BYTES", "Board", "Listener", "PseudoTerminal", "protocol", "serialised", "topic_of"]
