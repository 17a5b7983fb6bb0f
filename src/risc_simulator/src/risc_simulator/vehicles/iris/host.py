"""An IRIS+ on the wire: the telemetry of its autopilot, and the Arduino Due that flies it through its radio.

UDP 14550 speaks MAVLink with any station (mavlink.py). TCP 11411 is the serial line of the vehicle's own Due:
the bytes go into its real firmware, whose PPM signal goes over the radio to the autopilot (transmitter.py).

Opening the line resets the board, as opening the programming port does. The line is a cable: a loss of the link takes
away the radio and the telemetry, not the line.
"""

import ipaddress
import logging
import math
import socket
from collections import namedtuple
from functools import partial
from zlib import crc32

import numpy as np

from risc_simulator.notices import Notices
from risc_simulator.socket_host import SocketSet, VehicleHost, open_socket, reset
from risc_simulator.vehicles.iris.firmware import RcFrame
from risc_simulator.vehicles.iris.mavlink import Mavlink
from risc_simulator.vehicles.iris.sensors import IrisSensors
from risc_simulator.vehicles.iris.transmitter import TICKS_PER_US, Board, PpmReceiver, radio_delay_s, telemetry_delay_s

MAX_BACKLOG_BYTES = 4096  # a client that does not read loses the rest, as at a serial port
DEAD_CLIENT_MS = 1000  # a client that does not acknowledge data for this long is gone

Ports = namedtuple("Ports", "telemetry arduino")
STANDARD_PORTS = Ports(14550, 11411)

_LOG = logging.getLogger(__name__)
_TICKS_PER_S = 1e6 * TICKS_PER_US


class IrisHost(VehicleHost):
    """One IRIS+.

    vehicle: world.Vehicle.
    address: IPv4 address of this computer to listen on.
    ports: Ports; a 0 takes a free one, see `ports`.
    seed: of sensor noise and radio, combined with the namespace.   sensor_noise: factor, 0 = exact sensors.
    radio_loss: probability that a frame of the radio, or a datagram of telemetry, is lost.
    wires: wires.Wires, of which it uses mavlink (both directions) and radio, and the stream arduino; None = wires of
        its own.

    All now_s are lab time in seconds, the clock of vehicle.schedule.  Raises OSError naming the cause and the
    cure if an address or port cannot be used, or the board's firmware is not built; input that arrives later never
    raises.
    """

    def __init__(self, vehicle, address, ports=STANDARD_PORTS, seed=0, sensor_noise=1.0, radio_loss=0.0, wires=None):
        super().__init__(vehicle, wires)
        self.address = address
        self._mavlink_wire, self._radio_wire = self.wire("mavlink"), self.wire("radio")
        self._told_s = -math.inf  # when the newest telemetry arrives
        self._radio_loss, self._radio_delay_s = radio_loss, radio_delay_s(vehicle.plant)
        name = crc32(vehicle.namespace.encode("utf-8"))
        self._losses = np.random.default_rng([seed, name, 1])
        self.notices = Notices(_LOG, vehicle.namespace)
        autopilot = vehicle.firmware
        autopilot.vehicle = vehicle
        autopilot.sensors = IrisSensors(vehicle, np.random.default_rng([seed, name]), sensor_noise)
        self.mavlink = Mavlink(autopilot, system_id(address), self._send_telemetry)
        self.receiver = PpmReceiver()
        self._sockets, self._line, self._board = [], None, None
        try:
            self._board = Board()
            telemetry = open_socket(socket.SOCK_DGRAM, address, ports.telemetry, vehicle.namespace)
            self._sockets.append(telemetry)
            listener = open_socket(socket.SOCK_STREAM, address, ports.arduino, vehicle.namespace)
            self._sockets.append(listener)
        except OSError:
            self.close()
            raise
        stream = self.stream("arduino", is_cable=True)
        self._line = SerialLine(listener, stream, self.notices, self._board.reset, self._on_bytes)
        self._waiting.add(self._line)
        self.hear(telemetry, self._mavlink_wire, self.mavlink.on_datagram)
        self.ports = Ports(*(sock.getsockname()[1] for sock in self._sockets))

    # --- the host interface of the virtual lab ------------------------------------------------------------------

    def tick(self, now_s):
        """To be called once per cycle of the lab, after the world has moved."""
        self._now_s = now_s
        if now_s >= self.wires.due_s:
            self.wires.release(now_s)
        board = self._board
        board.advance(now_s)
        accepted_s = board.accepted_s()
        if accepted_s > 0.0:
            self.note_inputs(accepted_s, accepted_s)
        for begin_ticks, channels_us in self.receiver.feed(board.edges(), now_s * _TICKS_PER_S):
            self._radio_frame(begin_ticks / _TICKS_PER_S, channels_us)
        data = board.sent()
        if data:
            self._line.write(data, now_s)
        self._line.flush()
        self.mavlink.tick(now_s)

    def power_cycle(self, now_s):
        """Restart MAVLink only: the board is not part of the vehicle."""
        self.mavlink.power_cycle()

    def close(self):
        """Close all sockets. May be called twice."""
        if self._line is not None:
            self._line.close()
        for sock in self._sockets:
            sock.close()
        if self._board is not None:
            self._board.close()
        self._waiting.close()
        self._sockets = []

    def describe(self):
        """One line for people: what listens where."""
        return "%s (%s) IRIS+: MAVLink udp://%s:%d and its Arduino's serial line socket://%s:%d" % (
            *(self._vehicle.namespace, self._vehicle.name),
            *(self.address, self.ports.telemetry, self.address, self.ports.arduino),
        )

    def statistics(self):
        """Counts since the start; a missing key counts 0."""
        result = {**self._counts, **self.mavlink.counts}
        result["ppm"] = dict(self.receiver.counts)
        ours, theirs = self.notices.statistics(), self.mavlink.notices.statistics()
        result["notices"] = {kind: {**ours[kind], **theirs[kind]} for kind in ours}
        return result

    # --- telemetry ------------------------------------------------------------------------------------------------

    def receive(self, sock):
        for item in super().receive(sock):
            if not self._is_lost("telemetry_lost_in"):
                yield item

    def _send_telemetry(self, data, address):
        """Send by a radio that sends in turns: delayed, and in order."""
        if not self._is_lost("telemetry_lost_out"):
            late_s = telemetry_delay_s(self._vehicle.firmware, self._losses)
            self._told_s = max(self._told_s, self._now_s + late_s)
            self.wires.call_at(self._told_s, partial(self._carry_telemetry, data, address))

    def _carry_telemetry(self, data, address, now_s):
        self._mavlink_wire.carry(data, address, now_s, self._send)

    def _send(self, data, address, _now_s):
        try:
            self._sockets[0].sendto(data, address)
        except OSError:
            self._counts["send_errors"] += 1

    def _is_lost(self, count):
        lost = self._radio_loss > 0.0 and self._losses.random() < self._radio_loss
        if lost:
            self._counts[count] += 1
        return lost

    # --- the board and its radio ----------------------------------------------------------------------------------

    def _on_bytes(self, data, now_s):
        self._board.advance(now_s)  # up to the arrival of the bytes
        self._board.receive(data)

    def _radio_frame(self, begin_s, channels_us):
        if not self._is_lost("radio_frames_lost"):
            late_s = begin_s + self._radio_delay_s - self._now_s
            self._radio_wire.carry(RcFrame(channels_us), None, self._now_s, partial(self._obey, late_s))

    def _obey(self, late_s, frame, _address, arrival_s):
        self._vehicle.schedule(arrival_s + late_s, frame)


class SerialLine:
    """The serial port of a board, as a TCP port: one client at a time. A member of its host's SocketSet."""

    def __init__(self, listener, stream, notices, on_open, on_bytes):
        """stream: wires.Stream that the data of both directions passes.  on_open(); on_bytes(data, now_s)."""
        self._listener, self._stream, self._notices = listener, stream, notices
        self._on_open, self._on_bytes = on_open, on_bytes
        self._waiting = SocketSet()
        self._waiting.add(listener)
        self.fileno = self._waiting.fileno
        self._client, self._backlog = None, bytearray()

    def serve(self, now_s):
        """Accept a new client, read what it sends, notice a hang-up."""
        for sock in sorted(self._waiting.readable(), key=lambda sock: sock is self._listener):  # hang-ups first
            if sock is self._listener:
                self._accept()
            else:
                self._read(sock, now_s)

    def _accept(self):
        try:
            client, sender = self._listener.accept()
        except OSError:  # gone again
            return
        if self._client is not None:
            self._notices.complaint("is turned away: the serial line is open already", sender)
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, DEAD_CLIENT_MS)
        self._notices.event("opens the serial line", sender)
        self._client = client
        self._waiting.add(client)
        self._on_open()

    def _read(self, sock, now_s):
        if self._stream.is_full(sock):  # the client waits, as at a line whose buffer is full
            self._waiting.discard(sock)
            return
        try:
            data = sock.recv(65536)
            # a client that keeps small writes back until the last one is acknowledged must not wait for that
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._stream.carry(data, sock, now_s, self._come_in, self._cut)
        else:
            self._hang_up(sock)

    def write(self, data, now_s):
        """Send bytes from the board; they are lost without a client, or if the line's buffer is full."""
        if self._client is not None and not self._stream.is_full(self._client):
            self._stream.carry(data, self._client, now_s, self._come_out, self._cut)

    def flush(self):
        """Send what can be sent now, and resume reading if that had to wait."""
        if self._client is not None and not self._stream.is_full(self._client):
            self._waiting.add(self._client)
        if self._backlog:
            try:
                del self._backlog[: self._client.send(self._backlog)]
            except BlockingIOError:
                pass
            except OSError:
                self._hang_up(self._client)

    def close(self):
        """May be called twice."""
        if self._client is not None:
            self._hang_up(self._client)
        self._waiting.close()

    def _come_in(self, data, sock, now_s):
        if sock is self._client:
            self._on_bytes(data, now_s)

    def _come_out(self, data, sock, _now_s):
        if sock is self._client:
            self._backlog += data[: MAX_BACKLOG_BYTES - len(self._backlog)]

    def _cut(self, sock):
        if sock is self._client:
            reset(sock)
            self._hang_up(sock)

    def _hang_up(self, sock):
        if sock is self._client:
            self._client, self._backlog = None, bytearray()
            self._waiting.discard(sock)
            self._stream.forget(sock)
            sock.close()


def system_id(address):
    """MAVLink system id, 1 to 250, of a vehicle at an IPv4 address: the last number of the address."""
    return (ipaddress.IPv4Address(address).packed[-1] - 1) % 250 + 1
