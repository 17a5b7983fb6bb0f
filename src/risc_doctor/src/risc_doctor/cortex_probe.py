"""A short talk with a Cortex host over its own protocol: who are you, what do you show, and does the stream come?"""

import contextlib
import errno
import select
import socket
import struct
import time
from dataclasses import dataclass, field

from cortex_ros import wire
from cortex_ros.wire import Command
from risc_doctor.interfaces import IP_RECVERR, join, source_towards
from risc_doctor.socket_owners import users_of_port

LISTEN_S = 1.0  # to the stream
_STREAM_PATIENCE_S = 0.5  # for its first frame
_HELLO_TRIES, _HELLO_PERIOD_S = 8, 0.2
_POLL_PAUSE_S = 0.1  # between two looks at a host whose stream does not come: twenty frames
_BUFFER_BYTES = 1 << 20
_IP_MULTICAST_ALL = 49  # linux/in.h
_IDENTITY = wire.Identity("maap_doctor", (2, 1, 0, 0))


@dataclass
class CortexReport:
    """What the host said and sent."""

    error: str = ""  # why it does not answer; "" when it does
    refused: bool = False  # the computer is there, but no program listens
    identity: wire.Identity | None = None
    bodies: tuple[wire.BodyDef, ...] | None = None  # None: it does not say
    told_rate_hz: float | None = None
    mm_per_unit: float | None = None
    up_axis: int | None = None  # 0 = x, 1 = y, 2 = z
    stream_error: str = ""  # why the stream could not be listened to
    listeners: tuple[str, ...] = ()  # other programs on the stream's port: what comes to this computer alone is theirs
    frames: list[tuple[float, wire.Frame]] = field(default_factory=list)  # (monotonic time of arrival [s], frame)
    malformed: int = 0
    polled: list[wire.Frame] = field(default_factory=list)  # that it gave when asked, if its stream did not come

    @property
    def live(self):
        """It shows new frames, streamed or asked for."""
        return len(self.frames) > 1 or len({frame.number for frame in self.polled}) > 1

    @property
    def rate_hz(self):
        """Frames a second of the stream as they came; None when fewer than two came."""
        if len(self.frames) < 2:
            return None
        return (len(self.frames) - 1) / max(self.frames[-1][0] - self.frames[0][0], 1e-6)

    @property
    def lost(self):
        """Fraction of the stream's frames that did not come, by their numbers."""
        numbers = sorted({frame.number for _, frame in self.frames})
        if len(numbers) < 2:
            return 0.0
        return 1.0 - len(numbers) / (numbers[-1] - numbers[0] + 1)

    @property
    def metres_per_unit(self):
        return (self.mm_per_unit or 1.0) / 1000.0

    def shown(self):
        """The frames that came, whichever way."""
        return [frame for _, frame in self.frames] or self.polled


class CortexConnection:
    """Sockets to one host. endpoint: risc_lab.lab.MocapEndpoint. To be closed. Raises OSError."""

    def __init__(self, endpoint):
        self._address = (endpoint.host, endpoint.command_port)
        self.stream_error = ""
        self.listeners = tuple(users_of_port(endpoint.stream_port))
        self.malformed = 0
        self._command = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._stream = None
        try:
            self._command.setsockopt(socket.IPPROTO_IP, IP_RECVERR, 1)
            self._command.bind((endpoint.interface, 0))
        except OSError:
            self._command.close()
            raise
        try:
            self._stream = _stream_socket(endpoint, bool(self.listeners))
        except OSError as error:
            self.stream_error = error.strerror or str(error)

    def close(self):
        self._command.close()
        if self._stream is not None:
            self._stream.close()

    def request(self, packet, answer, tries=3, patience_s=0.25):
        """Content of the host's answer, None when none comes or the host does not know the request."""
        for _ in range(tries):
            _drain(self._command)  # what answers an earlier request must not answer this one
            self._command.sendto(packet, self._address)
            deadline = time.monotonic() + patience_s
            while (reply := self._next(self._command, deadline)) is not None:
                if reply.command in (answer, Command.UNRECOGNIZED_REQUEST):
                    return reply.content if reply.command == answer else None
        return None

    def hello(self):
        """Identity of the host. Raises OSError: TimeoutError, ConnectionRefusedError, ..."""
        packet = wire.encode_identity(Command.HELLO_WORLD, _IDENTITY)
        identity = self.request(packet, Command.HERE_I_AM, _HELLO_TRIES, _HELLO_PERIOD_S)
        if identity is None:
            raise TimeoutError("no answer within %g s" % (_HELLO_TRIES * _HELLO_PERIOD_S))
        return identity

    def number(self, text, layout):
        """The number that a text request is answered with, or None. layout: of struct, e.g. "<f"."""
        content = self.request(wire.encode_text(Command.GENERAL_REQUEST, text), Command.GENERAL_REPLY)
        if content is None or len(content) < struct.calcsize(layout):
            return None
        return struct.unpack_from(layout, content)[0]

    def go_live(self):
        """Ask for live mode, as stream_markers does."""
        self.request(wire.encode_text(Command.GENERAL_REQUEST, "LiveMode"), Command.GENERAL_REPLY)

    def bodies(self):
        """Bodies that the host defines, None when it does not say."""
        content = self.request(wire.encode_packet(Command.REQUEST_BODYDEFS), Command.BODYDEFS)
        return None if content is None else tuple(content.bodies)

    def poll(self):
        """The frame that the host shows now, or None."""
        return self.request(wire.encode_packet(Command.REQUEST_FRAME), Command.FRAME_OF_DATA)

    def forget_stream(self):
        """Drop the frames that have come and were not read: they are old."""
        if self._stream is not None:
            _drain(self._stream)

    def stream(self, seconds, patience_s):
        """Yields (time of arrival, frame) of the stream for so long; ends early when none came within the patience."""
        start = time.monotonic()
        end = start + min(seconds, patience_s)
        while self._stream is not None and (packet := self._next(self._stream, end)) is not None:
            if packet.command == Command.FRAME_OF_DATA:
                end = start + seconds
                yield time.monotonic(), packet.content

    def _next(self, sock, deadline):
        """The next sound packet of the host, None when none has come by then."""
        while (left_s := deadline - time.monotonic()) > 0.0 and select.select([sock], [], [], left_s)[0]:
            data, (address, _) = sock.recvfrom(wire.MAX_DATAGRAM_BYTES)
            try:
                if address == self._address[0]:
                    return wire.decode_packet(data)
            except wire.MalformedPacketError:
                self.malformed += 1
        return None


def _drain(sock):
    while select.select([sock], [], [], 0.0)[0]:
        sock.recv(wire.MAX_DATAGRAM_BYTES)


def probe(endpoint, live=False, listen_s=LISTEN_S):
    """CortexReport of the host at an endpoint. live: ask it for live mode first."""
    report = CortexReport()
    try:
        with contextlib.closing(CortexConnection(endpoint)) as connection:
            report.stream_error, report.listeners = connection.stream_error, connection.listeners
            report.identity = connection.hello()
            _interview(connection, report, live, listen_s)
            report.malformed = connection.malformed
    except OSError as error:
        report.refused = isinstance(error, ConnectionRefusedError)
        report.error = _reason(error)
    return report


def _interview(connection, report, live, listen_s):
    report.bodies = connection.bodies()
    report.told_rate_hz = connection.number("GetContextFrameRate", "<f")
    report.mm_per_unit = connection.number("GetConversionToMillimeters", "<f")
    report.up_axis = connection.number("GetUpAxis", "<i")
    if live:
        connection.go_live()
    connection.forget_stream()  # what came meanwhile would come at once now, and spoil the rate
    report.frames = list(connection.stream(listen_s, _STREAM_PATIENCE_S))
    for _ in range(2 if len(report.frames) < 2 else 0):
        frame = connection.poll()
        if frame is not None:
            report.polled.append(frame)
        time.sleep(_POLL_PAUSE_S)


def _stream_socket(endpoint, group_only):
    """As stream_markers listens: any address, the port shared, the group joined on the card that leads to the host.

    group_only: leave what the host sends to this computer alone to others: the newest socket of a port gets all of it.
    """
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        sock.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
        sock.bind((endpoint.stream_group if group_only else "", endpoint.stream_port))
        own = endpoint.interface or source_towards(endpoint.host) or "0.0.0.0"
        join(sock, endpoint.stream_group, own)
    except OSError:
        sock.close()
        raise
    return sock


def _reason(error):
    if isinstance(error, ConnectionRefusedError):
        return "refused, as nothing listens on that port"
    if error.errno == errno.EADDRNOTAVAIL:
        return "this computer does not have the address that the fleet file calls mocap interface"
    return error.strerror or str(error)
