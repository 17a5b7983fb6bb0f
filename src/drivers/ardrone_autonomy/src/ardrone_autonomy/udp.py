"""The sockets of the link to one vehicle and the one thread that owns them.

Other threads never touch the sockets or the DroneLink: they `post` orders into a mailbox and wake the thread.
"""

import contextlib
import functools
import math
import select
import socket
import threading
import time
from collections import deque, namedtuple

from ardrone_autonomy.link import TICK_S, DroneLink
from ardrone_autonomy.protocol import AT_PORT, NAVDATA_PORT
from risc_lab.strangers import OneSender, Strangers

MAX_DATAGRAM_BYTES = 8192  # the largest packet known has 2.4 kB
LANDING_CONFIRMATION_S = 2.0  # how long stop() waits for a flying vehicle to confirm that it lands
CLOSING_S = 0.1  # how long the last orders are repeated to a vehicle on the ground
LAST_ORDERS = 5  # datagrams with hover and land when the thread fails

Packet = namedtuple("Packet", "data received_s")  # bytes of one navdata packet; monotonic time of its reception


def resolve(host):
    """Return the IPv4 address of a host name or address. Raises ValueError that says how to fix it."""
    try:
        return socket.gethostbyname(host)
    except OSError as error:
        raise ValueError(
            "%r is not the address of a vehicle (%s): pass -ip A.B.C.D or set ~drone_ip" % (host, error)
        ) from None


class UdpThread:
    """Runs a DroneLink on real sockets.

    address: IPv4 address of the vehicle, which has the standard ports.
    report: function (level, text).
    on_packet: called in the thread with each Packet that is the newest so far; must be short.
    on_failure: called in the thread with the exception that ended it, after the last orders (hover and land).
    note: called in the thread with (time, DroneLink) after every iteration of its loop; must be short.
    link_options: further arguments of DroneLink.
    """

    def __init__(self, address, report, on_packet, on_failure, note=lambda now_s, link: None, **link_options):
        self.address = address
        self.send_errors = 0
        self.strangers = Strangers(report, "navdata")  # senders other than the vehicle's navdata port
        self._report = report
        self._on_packet = on_packet
        self._on_failure = on_failure
        self._note = note
        self._last_send_error = None
        self._mailbox = deque()
        self._navdata, self._command = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._bell_in, self._bell_out = socket.socketpair()
        self._sockets = self._navdata, self._command, self._bell_in, self._bell_out
        for sock in self._sockets:
            sock.setblocking(False)
        self._closing_since_s = math.inf
        self._door = OneSender(self._navdata, self.strangers)
        self._door.hear(address, NAVDATA_PORT)
        self.link = DroneLink(
            functools.partial(self._send, self._command, (address, AT_PORT)),
            functools.partial(self._send, self._navdata, (address, NAVDATA_PORT)),
            report=report,
            **link_options,
        )
        self._thread = threading.Thread(target=self._run, name="ardrone_udp", daemon=True)

    @property
    def foreign(self):
        """Number of datagrams that did not come from the vehicle's navdata port."""
        return self._door.refused

    def start(self):
        """Start looking for the vehicle."""
        self._thread.start()

    def post(self, order, *arguments):
        """Hand an order (a method of `link`) to the thread, which calls it with the arguments and the time."""
        self._mailbox.append((order, arguments))
        with contextlib.suppress(OSError):  # the bell already rings, or is closed: the node is shutting down
            self._bell_in.send(b"\0")

    def begin_to_stop(self):
        """Hover, land if flying; ignore all orders from now on."""
        if self._thread.is_alive():
            self.post(self._close)

    def stop(self):
        """`begin_to_stop`, wait up to LANDING_CONFIRMATION_S for the vehicle to confirm, close the sockets."""
        self.begin_to_stop()
        if self._thread.is_alive():
            self._thread.join(LANDING_CONFIRMATION_S + 1.0)
        for sock in self._sockets:
            sock.close()

    def _close(self, now_s):
        self._closing_since_s = min(self._closing_since_s, now_s)
        self.link.close(now_s)

    def _send(self, sock, destination, data):
        try:
            sock.sendto(data, destination)
            self._last_send_error = None
        except OSError as error:
            self.send_errors += 1
            if str(error) != self._last_send_error:
                self._last_send_error = str(error)
                self._report(
                    "warn",
                    "cannot send to %s:%d: %s (is this computer in the vehicle's network?)" % (*destination, error),
                )

    def _run(self):
        try:
            self._loop()
        except Exception as error:  # any failure: nothing pilots without this thread, the node must end
            self._give_last_orders()
            self._on_failure(error)

    def _give_last_orders(self):
        """Try to send hover and land; several times, because the radio loses datagrams."""
        try:
            for _ in range(LAST_ORDERS):
                self.link.send_last_orders()
                time.sleep(TICK_S)
        except Exception as error:  # report it; the failure that led here is passed to on_failure
            self._report("error", "the last orders could not be given: %r" % error)

    def _loop(self):
        link, clock, navdata, bell = self.link, time.monotonic, self._navdata, self._bell_out
        waitables = (navdata, bell)
        mailbox = self._mailbox
        now_s = noted_s = clock()
        while now_s - self._closing_since_s < (LANDING_CONFIRMATION_S if link.in_flight else CLOSING_S):
            readable, _, _ = select.select(waitables, (), (), max(0.0, min(link.due_s - now_s, 1.0)))
            now_s = clock()
            link.stood_still(now_s - noted_s, now_s)
            if navdata in readable:
                self._receive(now_s)
            if bell in readable:
                bell.recv(4096)
            while mailbox:
                order, arguments = mailbox.popleft()
                order(*arguments, now_s)
            if now_s >= link.due_s:
                link.poll(now_s)
                now_s = clock()
            self._note(now_s, link)
            noted_s = now_s

    def _receive(self, now_s):
        try:
            data, source = self._navdata.recvfrom(MAX_DATAGRAM_BYTES)
        except OSError:
            return  # spurious wake-up, or an ICMP error of an earlier datagram
        if self._door.is_from(source) and self.link.on_navdata(data, now_s):
            self._on_packet(Packet(data, now_s))
