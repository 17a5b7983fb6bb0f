"""The device and the one thread that owns it. No ROS.

Other threads never touch the device or the Autopilot: they `post` orders into a mailbox and wake the thread, which
otherwise sleeps until bytes arrive or TICK_S has passed.
"""

import contextlib
import errno
import select
import socket
import threading
import time
from collections import deque

from risc_lab.strangers import Strangers
from roscopter import transport
from roscopter.autopilot import LAST_WORDS, TICK_S, Autopilot

RETRY_S = 1.0  # between attempts to open the device
LAST_SPACING_S = 0.02  # between the last packets
JOIN_S = 3.0


class Link:
    """Runs an Autopilot on a real device.

    options: Options.  report: function (level, text).  on_message: called in the thread with each message of the
    vehicle; must be short.  on_failure: called in the thread with the exception that ended it.
    """

    def __init__(self, options, report, on_message, on_failure):
        self._options, self._report = options, report
        self._on_message, self._on_failure = on_message, on_failure
        self.autopilot = Autopilot(options, self._write, report)
        self.strangers = Strangers(report, options.device)
        self.counts = {"received bytes": 0, "sent bytes": 0, "not sent": 0, "times opened": 0}
        self._device, self._reopen_s = None, 0.0
        self._has_complained = False  # about a missing device; not logged again until something was received
        self._is_mute = False  # nothing has been received since the device was opened
        self._mailbox, self._is_over = deque(), False
        self._bell_in, self._bell_out = socket.socketpair()
        for bell in (self._bell_in, self._bell_out):
            bell.setblocking(False)
        self._thread = threading.Thread(target=self._run, name="mavlink", daemon=True)

    def start(self):
        """Start to open the device and look for the vehicle."""
        self._thread.start()

    def post(self, order, *arguments):
        """Hand an order (a method of `autopilot`) to the thread, which calls it with the arguments and the time."""
        self._mailbox.append((order, arguments))
        with contextlib.suppress(OSError):  # the bell already rings, or the node is shutting down
            self._bell_in.send(b"\0")

    def stop(self):
        """Return overridden channels to the pilot's radio, and close the device."""
        self._is_over = True
        self.post(lambda _now_s: None)
        if self._thread.is_alive():
            self._thread.join(JOIN_S)

    def _run(self):
        try:
            self._loop()
        except Exception as error:  # any failure: without this thread nothing receives the vehicle's messages
            self._on_failure(error)
        finally:
            with contextlib.suppress(Exception):  # the device may be gone, or the same failure may occur again
                self._send_last_words()
            self._close()

    def _send_last_words(self):
        for _ in range(LAST_WORDS):
            self.autopilot.send_last_words()
            time.sleep(LAST_SPACING_S)

    def _loop(self):
        autopilot, clock, mailbox = self.autopilot, time.monotonic, self._mailbox
        next_tick_s = 0.0
        while not self._is_over:
            now_s = clock()
            if self._device is None and now_s >= self._reopen_s:
                self._open()
                now_s = clock()
            waitables = [self._bell_out] if self._device is None else [self._bell_out, self._device]
            ready, _, _ = select.select(waitables, (), (), max(0.0, next_tick_s - now_s))
            now_s = clock()
            if self._bell_out in ready:
                self._bell_out.recv(4096)
            while mailbox:
                order, arguments = mailbox.popleft()
                order(*arguments, now_s)
            if self._device in ready:
                self._receive(now_s)
            if now_s >= next_tick_s:
                next_tick_s = now_s + TICK_S
                autopilot.poll(now_s)

    def _open(self):
        device = self._options.device
        try:
            self._device = transport.open_device(device, self._options.baudrate, self.strangers)
        except (OSError, ValueError) as error:
            self._complain("cannot open %s (%s); trying again every second" % (device, _reason(error)))
            self._reopen_s = time.monotonic() + RETRY_S
            return
        if not self._is_mute:  # else it is opened and lost again and again
            self._report("info", "opened %s" % device)
            self._has_complained = False
        self._is_mute = True
        self.counts["times opened"] += 1
        self.autopilot.opened(time.monotonic())

    def _complain(self, text):
        if not self._has_complained:
            self._report("error", text)
        self._has_complained = True

    def _receive(self, now_s):
        try:
            data, source = self._device.read()
        except OSError as error:
            self._lose(error)
            return
        if data:
            self._is_mute = self._has_complained = False
        self.counts["received bytes"] += len(data)
        messages = self.autopilot.receive(data, now_s)
        if messages:
            self._device.answer_to(source)
        for message in messages:
            self._on_message(message)

    def _lose(self, error):
        self._complain("lost %s (%s); waiting for it" % (self._options.device, _reason(error)))
        self._close()
        self._reopen_s = time.monotonic() + RETRY_S
        self.autopilot.closed(time.monotonic())

    def _write(self, data):
        if self._device is None:
            return
        try:
            is_sent = self._device.write(data)
        except OSError:
            is_sent = False  # reading will detect that the device is gone
        self.counts["sent bytes" if is_sent else "not sent"] += len(data) if is_sent else 1

    def _close(self):
        device, self._device = self._device, None
        if device is not None:
            device.close()


def _reason(error):
    text = getattr(error, "strerror", None) or str(error)
    is_forbidden = getattr(error, "errno", None) == errno.EACCES
    return text + (": add yourself to the group dialout, and log in again" if is_forbidden else "")
