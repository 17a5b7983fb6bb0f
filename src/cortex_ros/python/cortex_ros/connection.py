"""A talk with a Cortex host over its own protocol: one question at a time, and what it streams. Needs no ROS.

The node `stream_markers` has a client of its own (C++), which looks for the host again and never waits.
"""

import contextlib
import select
import socket
import struct
import time

import psutil

from cortex_ros import wire
from cortex_ros.wire import Command

BROADCAST = "broadcast"  # host: the first that answers on any network of this computer
_HELLO_TRIES, _HELLO_PERIOD_S = 8, 0.2
_BUFFER_BYTES = 1 << 20
_IP_RECVERR, _IP_MULTICAST_ALL = 11, 49  # linux/in.h; with the first a refusal by the other computer is told, too
_MOST_DRAINED = 4096  # more small datagrams than a buffer holds
_MOST_MALFORMED = 1000  # remembered
_ANY_PORT = 9  # connecting a UDP socket sends nothing


class CortexConnection:
    """Sockets to one host. To be closed. Raises OSError."""

    def __init__(self, identity, host, command_port, interface=""):
        """identity: wire.Identity to say hello with.   host: or BROADCAST.   interface: own address; "" = any."""
        self._identity, self._interface = identity, interface
        self._searching = host == BROADCAST
        addresses = broadcast_addresses(interface) if self._searching else [socket.gethostbyname(host)]
        self._destinations = [(address, command_port) for address in addresses]
        self.malformed = []  # what was wrong with packets of the host
        self.on_comment = lambda text: None  # what the host says unasked
        self._stream = None
        self._command = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._command.setsockopt(socket.IPPROTO_IP, _IP_RECVERR, 1)
            self._command.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            self._command.bind((interface, 0))
        except OSError:
            self._command.close()
            raise

    @property
    def address(self):
        """(address, port) of the host."""
        return self._destinations[0]

    def close(self):
        self._command.close()
        if self._stream is not None:
            self._stream.close()

    def open_stream(self, group, port, group_only=False):
        """Listen to the stream, see `stream_socket`. Raises OSError."""
        self._stream = stream_socket(self.address[0], group, port, self._interface, group_only)

    def hello(self):
        """Identity of the host. Raises OSError: TimeoutError, ConnectionRefusedError, ..."""
        packet = wire.encode_identity(Command.HELLO_WORLD, self._identity)
        identity = self.request(packet, Command.HERE_I_AM, _HELLO_TRIES, _HELLO_PERIOD_S)
        if identity is None:
            raise TimeoutError("no answer within %g s" % (_HELLO_TRIES * _HELLO_PERIOD_S))
        return identity

    def request(self, packet, answer, tries=3, patience_s=0.25):
        """Content of the host's answer, None when none comes or the host does not know the request."""
        for _ in range(tries):
            self._drain(self._command)  # what answers an earlier request must not answer this one
            self._send(packet)
            deadline = time.monotonic() + patience_s
            while (reply := self._next(self._command, deadline)) is not None:
                if reply.command in (answer, Command.UNRECOGNIZED_REQUEST):
                    return reply.content if reply.command == answer else None
        return None

    def number(self, text, layout):
        """The number that a text request is answered with, or None. layout: of struct, e.g. "<f"."""
        content = self.request(wire.encode_text(Command.GENERAL_REQUEST, text), Command.GENERAL_REPLY)
        if content is None or len(content) < struct.calcsize(layout):
            return None
        return struct.unpack_from(layout, content)[0]

    def go_live(self):
        """Ask for live mode, as stream_markers does."""
        self.request(wire.encode_text(Command.GENERAL_REQUEST, "LiveMode"), Command.GENERAL_REPLY)

    def body_defs(self):
        """wire.BodyDefs of the host, None when it does not say."""
        return self.request(wire.encode_packet(Command.REQUEST_BODYDEFS), Command.BODYDEFS)

    def poll(self):
        """The frame that the host shows now, or None."""
        return self.request(wire.encode_packet(Command.REQUEST_FRAME), Command.FRAME_OF_DATA)

    def forget_stream(self):
        """Drop the frames that have come and were not read: they are old."""
        if self._stream is not None:
            self._drain(self._stream)

    def stream(self, seconds, patience_s):
        """Yields (time of arrival, frame) of the stream for so long; ends early when none came within the patience."""
        start = time.monotonic()
        end = start + min(seconds, patience_s)
        while self._stream is not None and (packet := self._next(self._stream, end)) is not None:
            if packet.command == Command.FRAME_OF_DATA:
                end = start + seconds
                yield time.monotonic(), packet.content

    def _send(self, packet):
        """To the host, or while it is searched to every network that can be reached. Raises OSError if none can."""
        errors = []
        for destination in self._destinations:
            try:
                self._command.sendto(packet, destination)
            except OSError as error:
                errors.append(error)
        if len(errors) == len(self._destinations):
            raise errors[0]

    def _drain(self, sock):
        for _ in range(_MOST_DRAINED):  # who floods us does not stop us
            if not select.select([sock], [], [], 0.0)[0]:
                break
            self._receive(sock)

    def _next(self, sock, deadline):
        """The next sound packet of the host, None when none has come by then."""
        while (left_s := deadline - time.monotonic()) > 0.0 and select.select([sock], [], [], left_s)[0]:
            packet = self._receive(sock)
            if packet is not None:
                return packet
        return None

    def _receive(self, sock):
        """The packet that waits; None if it is not the host's, or malformed."""
        try:
            data, sender = sock.recvfrom(wire.MAX_DATAGRAM_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:  # what waits is only the record of a refusal that has been raised already
            sock.recvmsg(0, _BUFFER_BYTES, socket.MSG_ERRQUEUE | socket.MSG_DONTWAIT)
            return None
        if not self._searching and sender[0] != self.address[0]:
            return None
        try:
            packet = wire.decode_packet(data)
        except wire.MalformedPacketError as error:
            if len(self.malformed) < _MOST_MALFORMED:
                self.malformed.append(str(error))
            return None
        if self._searching:
            if packet.command != Command.HERE_I_AM or packet.content.version[0] != 1:  # other programs speak it, too
                return None
            self._searching, self._destinations = False, [sender]
        if packet.command == Command.COMMENT:
            self.on_comment(packet.content)
        return packet


def broadcast_addresses(interface=""):
    """Where all networks of this computer hear a packet, or only that of the card with the address `interface`.

    The limited broadcast address leaves by one card only: that of the default route.
    """
    cards = [entry for entries in psutil.net_if_addrs().values() for entry in entries if entry.broadcast]
    directed = {
        entry.broadcast
        for entry in cards
        if entry.family == socket.AF_INET and interface in ("", "0.0.0.0", entry.address)
    }
    if interface.startswith("127."):
        directed.add("127.255.255.255")  # the kernel has it, although the card does not list it
    return ["255.255.255.255", *sorted(directed)]


def stream_socket(host, group, port, interface="", group_only=False):
    """As stream_markers listens: any address, the port shared, the group joined on the card that leads to the host.

    group_only: leave what the host sends to this computer alone to others: the newest socket of a port gets all of it.
    """
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        sock.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
        sock.bind((group if group_only else "", port))
        if group:
            membership = socket.inet_aton(group) + socket.inet_aton(interface or _source_towards(host))
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    except OSError:
        sock.close()
        raise
    return sock


def _source_towards(host):
    """Own address from which the kernel would send to a host; 0.0.0.0 when there is no route."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        probe.connect((host, _ANY_PORT))
        return probe.getsockname()[0]
    return "0.0.0.0"
