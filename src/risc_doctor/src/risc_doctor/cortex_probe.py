"""A short talk with a Cortex host over its own protocol: who are you, what do you show, and does the stream come?"""

import errno
import select
import socket
import struct
import time
from dataclasses import dataclass, field

from cortex_ros import wire
from cortex_ros.wire import Command
from risc_doctor.interfaces import IP_RECVERR, source_towards
from risc_doctor.socket_owners import users_of_port

LISTEN_S = 1.0  # to the stream
_STREAM_PATIENCE_S = 0.5  # for its first frame
_HELLO_PATIENCE_S = 1.5
_HELLO_PERIOD_S = 0.2
_REQUEST_PATIENCE_S = 0.25
_REQUEST_TRIES = 3
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
    polled: tuple[int, ...] = ()  # numbers of frames that it gave when asked, if its stream did not come
    polled_frames: list[wire.Frame] = field(default_factory=list)

    @property
    def live(self):
        """It shows new frames, streamed or asked for."""
        return len(self.frames) > 1 or len(set(self.polled)) > 1

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
        return [frame for _, frame in self.frames] or self.polled_frames


class CortexConnection:
    """Sockets to one host. endpoint: risc_lab.lab.MocapEndpoint. To be closed. Raises OSError."""

    def __init__(self, endpoint):
        self._host = endpoint.host
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

    def hello(self):
        """Identity of the host. Raises OSError: TimeoutError, ConnectionRefusedError, ..."""
        packet = wire.encode_identity(Command.HELLO_WORLD, _IDENTITY)
        deadline = time.monotonic() + _HELLO_PATIENCE_S
        while time.monotonic() < deadline:
            self._command.sendto(packet, self._address)
            answer = self._answer({Command.HERE_I_AM}, min(_HELLO_PERIOD_S, deadline - time.monotonic()))
            if answer is not None:
                return answer.content
        raise TimeoutError("no answer within %g s" % _HELLO_PATIENCE_S)

    def request(self, packet, answers):
        """Packet that answers, None when none comes or the host does not know the request."""
        for _ in range(_REQUEST_TRIES):
            self._drain()  # what answers an earlier request must not answer this one
            self._command.sendto(packet, self._address)
            answer = self._answer(set(answers) | {Command.UNRECOGNIZED_REQUEST}, _REQUEST_PATIENCE_S)
            if answer is not None:
                return None if answer.command == Command.UNRECOGNIZED_REQUEST else answer
        return None

    def number(self, text, layout):
        """The number that a text request is answered with, or None. layout: of struct, e.g. "<f"."""
        answer = self.request(wire.encode_text(Command.GENERAL_REQUEST, text), {Command.GENERAL_REPLY})
        if answer is None or len(answer.content) < struct.calcsize(layout):
            return None
        return struct.unpack_from(layout, answer.content)[0]

    def go_live(self):
        """Ask for live mode, as stream_markers does."""
        self.request(wire.encode_text(Command.GENERAL_REQUEST, "LiveMode"), {Command.GENERAL_REPLY})

    def bodies(self):
        """Bodies that the host defines, None when it does not say."""
        answer = self.request(wire.encode_packet(Command.REQUEST_BODYDEFS), {Command.BODYDEFS})
        return None if answer is None else tuple(answer.content.bodies)

    def poll(self):
        """The frame that the host shows now, or None."""
        answer = self.request(wire.encode_packet(Command.REQUEST_FRAME), {Command.FRAME_OF_DATA})
        return None if answer is None else answer.content

    def forget_stream(self):
        """Drop the frames that have come and were not read: they are old."""
        while self._stream is not None and select.select([self._stream], [], [], 0.0)[0]:
            self._stream.recv(wire.MAX_DATAGRAM_BYTES)

    def stream(self, seconds, patience_s):
        """Yields (time of arrival, frame) of the stream for so long; ends early when none came within the patience."""
        if self._stream is None:
            return
        start = time.monotonic()
        heard = False
        while True:
            now = time.monotonic()
            end = start + (seconds if heard else min(seconds, patience_s))
            if now >= end or not select.select([self._stream], [], [], end - now)[0]:
                return
            data, (address, _) = self._stream.recvfrom(wire.MAX_DATAGRAM_BYTES)
            packet = self._decode(data) if address == self._host else None
            if packet is not None and packet.command == Command.FRAME_OF_DATA:
                heard = True
                yield time.monotonic(), packet.content

    def _answer(self, commands, patience_s):
        deadline = time.monotonic() + patience_s
        while True:
            left_s = deadline - time.monotonic()
            if left_s <= 0.0 or not select.select([self._command], [], [], left_s)[0]:
                return None
            data, (address, _) = self._command.recvfrom(wire.MAX_DATAGRAM_BYTES)
            packet = self._decode(data) if address == self._host else None
            if packet is not None and packet.command in commands:
                return packet

    def _drain(self):
        while select.select([self._command], [], [], 0.0)[0]:
            self._command.recvfrom(wire.MAX_DATAGRAM_BYTES)

    def _decode(self, data):
        try:
            return wire.decode_packet(data)
        except wire.MalformedPacketError:
            self.malformed += 1
            return None


def probe(endpoint, live=False, listen_s=LISTEN_S):
    """CortexReport of the host at an endpoint. live: ask it for live mode first."""
    report = CortexReport()
    connection = None
    try:
        connection = CortexConnection(endpoint)
        report.stream_error, report.listeners = connection.stream_error, connection.listeners
        report.identity = connection.hello()
        _interview(connection, report, live, listen_s)
        report.malformed = connection.malformed
    except OSError as error:
        report.refused = isinstance(error, ConnectionRefusedError)
        report.error = _reason(error)
    finally:
        if connection is not None:
            connection.close()
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
    if len(report.frames) > 1:
        return
    for _ in range(2):
        frame = connection.poll()
        if frame is not None:
            report.polled_frames.append(frame)
        time.sleep(_POLL_PAUSE_S)
    report.polled = tuple(frame.number for frame in report.polled_frames)


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
        sock.setsockopt(
            socket.IPPROTO_IP,
            socket.IP_ADD_MEMBERSHIP,
            socket.inet_aton(endpoint.stream_group) + socket.inet_aton(own),
        )
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
