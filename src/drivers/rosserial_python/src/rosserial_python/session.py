"""The thread that serves one port: opens it, reads, drives its `link.Link`, and reopens the port. No ROS."""

import contextlib
import select
import socket
import threading
import time

from rosserial_python.link import Link, State
from rosserial_python.protocol import Id

_RETRY_S = 0.2  # between attempts to open a port
_LOOK_S = 0.25  # how often the port of a silent line is checked
_LAST_S = 0.3  # time to send the last packets when the node ends
_POLL_S = 0.005
_CHIP_BYTES = 64  # bytes that the kernel has passed to the chip, and that closing the port would discard


class Session:
    """One port and its device. `on_packet(packet)` runs in the session's thread and must not block."""

    def __init__(self, port, silence_s, on_packet, on_failure, on_change=lambda: None, once=False):
        """on_change: called after the state, or the reason why the port is not open, has changed.  on_failure: called
        with the exception that ended the thread.  once: do not reopen.
        """
        self.port, self.link, self.error = port, Link(silence_s), None  # error: why the port is not open
        self._on_packet, self._on_failure, self._on_change = on_packet, on_failure, on_change
        self._clock, self._once = time.monotonic, once
        self._wake_end, self._wake_begin = socket.socketpair()
        self._wake_end.setblocking(False)
        self._wake_begin.setblocking(False)
        self._over = threading.Event()
        self._looked_s = 0.0
        self._thread = threading.Thread(target=self._run, name="line %s" % port.name, daemon=True)

    def start(self):
        """Start the thread."""
        self._thread.start()

    def stop(self, patience_s=3.0):
        """Tell the device to stop sending, close the line, end the thread. Returns whether it has ended."""
        self._over.set()
        self._wake()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(patience_s)
        return not self._thread.is_alive()

    @property
    def is_over(self):
        """Whether the thread has ended."""
        return not self._thread.is_alive()

    # --- for other threads ----------------------------------------------------------------------------------------
    def post(self, topic_id, payload, expires_s):
        """See Link.post."""
        if not self.link.post(topic_id, payload, self._clock(), expires_s):
            self._wake()

    def reply(self, topic_id, payload=b""):
        """See Link.reply."""
        if not self.link.reply(topic_id, payload, self._clock()):
            self._wake()

    def confirm(self, topic):
        """See Link.confirm."""
        self.link.confirm(topic, self._clock())
        self._wake()

    def ask_topics(self):
        """See Link.ask_topics."""
        self.link.ask_topics(self._clock())
        self._wake()

    def _wake(self):
        with contextlib.suppress(OSError):  # it is awake already, or over
            self._wake_begin.send(b"\0")

    # --- the thread -----------------------------------------------------------------------------------------------
    def _run(self):
        try:
            while not self._over.is_set():
                line = self._open()
                if line is None:
                    if self._once:
                        break
                    self._wait([self.port] if hasattr(self.port, "fileno") else [], _RETRY_S)
                    continue
                try:
                    self._serve(line)
                except OSError as error:
                    self._told(error)
                finally:
                    self.link.closed(self._clock(), is_gone=self.error is not None)
                    line.close()
                    self._on_change()
                if self.error is not None:
                    self._wait([], _RETRY_S)
        except Exception as error:  # any failure: without this thread nothing serves the line
            self._on_failure(error)
        finally:
            self.port.close()
            self._wake_end.close()
            self._wake_begin.close()

    def _open(self):
        try:
            line = self.port.open()
        except OSError as error:
            self._told(error)
            return None
        self.error = None
        self.link.opened(line, self._clock())
        self._on_change()
        return line

    def _told(self, error):
        before, self.error = self.error, error
        if before is None or before.errno != error.errno:
            self._on_change()

    def _serve(self, line):
        """Serve the line until it is gone (OSError), its port must be reopened, or the session ends."""
        link, state = self.link, State.WAITING
        while not self._over.is_set():
            now_s = self._clock()
            due_s = min(link.due_s(now_s), now_s + _LOOK_S)
            self._wait([line], max(0.0, due_s - now_s))
            now_s = self._clock()  # before reading, so that all bytes until now_s are read, however late this thread is
            for packet in link.received(line.read(), now_s):
                self._on_packet(packet)
            link.tick(now_s)
            if link.failure is not None:
                raise link.failure
            if link.facts.state is not state:
                state = link.facts.state
                self._on_change()
            if state is State.WAITING and now_s >= self._looked_s + _LOOK_S:
                self._looked_s = now_s
                if self.port.should_reopen(line, now_s - max(link.facts.heard_s, link.opened_s)):
                    return
        self._say_goodbye(line)

    def _say_goodbye(self, line):
        """Tell the device to send nothing until it is asked for its topics."""
        link, end_s = self.link, self._clock() + _LAST_S
        link.reply(Id.TX_STOP, b"", self._clock())
        while self._clock() < end_s and link.failure is None and not (link.idle and line.queued() == 0):
            time.sleep(_POLL_S)
            link.flush(self._clock())
        time.sleep(_CHIP_BYTES * line.byte_s)

    def _wait(self, readers, longest_s):
        """Wait until a reader is readable or another thread calls `_wake`, at most longest_s [s]."""
        readable, _, _ = select.select([*readers, self._wake_end], [], [], longest_s)
        if self._wake_end in readable:
            with contextlib.suppress(BlockingIOError):
                self._wake_end.recv(4096)
