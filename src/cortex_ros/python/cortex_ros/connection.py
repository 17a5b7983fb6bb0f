"""Connection to a Cortex host over its own protocol: one request at a time, and its stream. Needs no ROS.

The node `stream_markers` has its own client (C++), which reconnects and never blocks.
"""

import contextlib
import select
import socket
import struct
import time

import psutil

from cortex_ros import wire
from cortex_ros.wire import Command

BROADCAST = "broadcast"  # as host: take the first host that answers on any network of this computer
_HELLO_TRIES, _HELLO_PERIOD_S = 8, 0.2
_BUFFER_BYTES = 1 << 20
_IP_RECVERR, _IP_MULTICAST_ALL = 11, 49  # linux/in.h; the first also reports refusals by the other computer
_MOST_DRAINED = 4096  # more small datagrams than a buffer holds
_MOST_MALFORMED = 1000  # entries kept in `malformed`
_ANY_PORT = 9  # connecting a UDP socket sends nothing


class CortexConnection:
    """Sockets to one host. Must be closed. Raises OSError."""

    def __init__(self, identity, host, command_port, interface=""):
        """identity: wire.Identity sent in the hello.   host: address, name or BROADCAST.   interface: local address;
        "" = any.
        """
        self._identity, self._interface = identity, interface
        self._searching = host == BROADCAST
        addresses = broadcast_addresses(interface) if self._searching else [socket.gethostbyname(host)]
        self._destinations = [(address, command_port) for address in addresses]
        self.malformed = []  # error texts of malformed packets from the host
        self.on_comment = lambda text: None  # called with each comment from the host
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
        """Open the stream socket, see `stream_socket`. Raises OSError."""
        self._stream = stream_socket(self.address[0], group, port, self._interface, group_only)

    def hello(self):
        """Say hello; return the identity of the host. Raises OSError: TimeoutError, ConnectionRefusedError, ..."""
        packet = wire.encode_identity(Command.HELLO_WORLD, self._identity)
        identity = self.request(packet, Command.HERE_I_AM, _HELLO_TRIES, _HELLO_PERIOD_S)
        if identity is None:
            raise TimeoutError("no answer within %g s" % (_HELLO_TRIES * _HELLO_PERIOD_S))
        return identity

    def request(self, packet, answer, tries=3, patience_s=0.25):
        """Return the content of the host's answer; None without an answer or if the host does not know the request."""
        for _ in range(tries):
            self._drain(self._command)  # so that a late answer is not taken for the answer to this request
            self._send(packet)
            deadline = time.monotonic() + patience_s
            while (reply := self._next(self._command, deadline)) is not None:
                if reply.command in (answer, Command.UNRECOGNIZED_REQUEST):
                    return reply.content if reply.command == answer else None
        return None

    def number(self, text, layout):
        """Return the number in the answer to a text request, or None. layout: struct format, e.g. "<f"."""
        content = self.request(wire.encode_text(Command.GENERAL_REQUEST, text), Command.GENERAL_REPLY)
        if content is None or len(content) < struct.calcsize(layout):
            return None
        return struct.unpack_from(layout, content)[0]

    def go_live(self):
        """Ask for live mode, as stream_markers does."""
        self.request(wire.encode_text(Command.GENERAL_REQUEST, "LiveMode"), Command.GENERAL_REPLY)

    def body_defs(self):
        """Return the wire.BodyDefs of the host, None without an answer."""
        return self.request(wire.encode_packet(Command.REQUEST_BODYDEFS), Command.BODYDEFS)

    def poll(self):
        """Return the current frame of the host, or None."""
        return self.request(wire.encode_packet(Command.REQUEST_FRAME), Command.FRAME_OF_DATA)

    def forget_stream(self):
        """Drop frames that have arrived and were not read: they are old."""
        if self._stream is not None:
            self._drain(self._stream)

    def stream(self, seconds, patience_s):
        """Yield (time of arrival, frame) of the stream for `seconds`; end early if none arrives within patience_s."""
        start = time.monotonic()
        end = start + min(seconds, patience_s)
        while self._stream is not None and (packet := self._next(self._stream, end)) is not None:
            if packet.command == Command.FRAME_OF_DATA:
                end = start + seconds
                yield time.monotonic(), packet.content

    def _send(self, packet):
        """Send to the host, or while searching to every reachable network. Raises OSError if none can be reached."""
        errors = []
        for destination in self._destinations:
            try:
                self._command.sendto(packet, destination)
            except OSError as error:
                errors.append(error)
        if len(errors) == len(self._destinations):
            raise errors[0]

    def _drain(self, sock):
        for _ in range(_MOST_DRAINED):  # bounded, so that a flood cannot keep us here
            if not select.select([sock], [], [], 0.0)[0]:
                break
            self._receive(sock)

    def _next(self, sock, deadline):
        """Return the next valid packet of the host, None when none has arrived by the deadline."""
        while (left_s := deadline - time.monotonic()) > 0.0 and select.select([sock], [], [], left_s)[0]:
            packet = self._receive(sock)
            if packet is not None:
                return packet
        return None

    def _receive(self, sock):
        """Return the waiting packet; None if it is malformed or not from the host."""
        try:
            data, sender = sock.recvfrom(wire.MAX_DATAGRAM_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:  # only the record of a refusal is waiting, which has already been raised
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
            if packet.command != Command.HERE_I_AM or packet.content.version[0] != 1:  # other programs use it, too
                return None
            self._searching, self._destinations = False, [sender]
        if packet.command == Command.COMMENT:
            self.on_comment(packet.content)
        return packet


def broadcast_addresses(interface=""):
    """Return the broadcast addresses of all networks of this computer, or only of the card with address `interface`.

    A packet to the limited broadcast address leaves by one card only: that of the default route.
    """
    cards = [entry for entries in psutil.net_if_addrs().values() for entry in entries if entry.broadcast]
    directed = {
        entry.broadcast
        for entry in cards
        if entry.family == socket.AF_INET and interface in ("", "0.0.0.0", entry.address)
    }
    if interface.startswith("127."):
        directed.add("127.255.255.255")  # the kernel supports it, although the card does not list it
    return ["255.255.255.255", *sorted(directed)]


def stream_socket(host, group, port, interface="", group_only=False):
    """Stream socket as in stream_markers: any address, port shared, group joined on the card that leads to the host.

    group_only: receive the multicast group only. Unicast datagrams are left to other sockets, because the newest socket
    of a port would get all of them.
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
    """Local address from which the kernel would send to a host; 0.0.0.0 when there is no route."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe, contextlib.suppress(OSError):
        probe.connect((host, _ANY_PORT))
        return probe.getsockname()[0]
    return "0.0.0.0"
