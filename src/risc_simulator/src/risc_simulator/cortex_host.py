"""A Motion Analysis Cortex host on the wire: what a client of the laboratory's mocap system talks to. No ROS.

The host shows a world through a camera model. It runs in a single-threaded loop: wait on its fileno(), call
serve() when it is readable, and tick() after each step of the world. One frame is exposed for every period of the
frame rate that the world's time enters, and sent at once, so the caller's schedule is the schedule of the stream.

Units: seconds of lab time (the clock of `now_s`; the world's time runs behind it by the reported delay) and metres in
the mocap frame, z up; on the wire millimetres.
"""

import errno
import logging
import math
import socket
import struct
from collections import Counter, deque
from typing import NamedTuple

import numpy as np

from cortex_ros import wire
from cortex_ros.wire import Command
from risc_simulator.models.mocap_cameras import Observation
from risc_simulator.notices import Notices
from risc_simulator.socket_host import SocketHost, open_socket

IDENTITY = wire.Identity("Cortex", (1, 5, 3, 1))  # program id 1 means Cortex
MM_PER_M = 1000.0
MULTICAST_TTL = 2  # as the SDK's own sockets
COMMAND_RECEIVE_BUFFER_BYTES = 1 << 20  # as the SDK's own sockets
TAKE_FRAMES = 12000  # a recording keeps its last minute at 200 Hz for playback
NUMBERS = {  # answers to text requests
    "GetConversionToMillimeters": ("<f", 1.0),
    "GetUpAxis": ("<i", 2),  # z
    "GetContextAnalogSampleRate": ("<f", 0.0),  # no analog board
    "GetContextAnalogBitDepth": ("<i", 16),
}
CLIENTS_REMEMBERED = 64
RESTART_PERIOD_S = 1.0  # between two attempts, while another program uses its addresses
FRAME_NUMBER_MASK = 0x7FFFFFFF  # the wire's frame number is signed

_LOG = logging.getLogger(__name__)


class _EncodedFrame(NamedTuple):
    """A frame ready to be sent; the delay between exposure and sending is entered when it goes out."""

    exposure_s: float
    packet: bytearray
    delay_offset: int

    def dated(self, now_s, packet=None):
        """Enter the delay of sending at now_s into the packet, or a given copy of it, and return it."""
        packet = self.packet if packet is None else packet
        wire.set_delay(packet, self.delay_offset, max(now_s - self.exposure_s, 0.0))
        return packet


class CortexHost(SocketHost):
    """The host.

    world: has time_s [s], layout ((body name, number of markers), ...) and markers_m() -> (m, 3) exact markers [m] of
        all bodies in this order.
    endpoint: has host, command_port, stream_group, stream_port, rate_hz, reported_delay_s. Command port 0 takes a free
        one (see `address`); an empty stream_group sends no multicast. Its interface is the client's, not used here.
    cameras: MocapCameras.
    clock: callable giving lab time [s] now, to report the delay at the moment of sending; None = the caller's now_s.
    templates: body name -> object with marker_names, for the body definitions; others get M1, M2, ...
    live_on_start: stream without waiting for a client's LiveMode.
    interface: address of the network card that the multicast stream goes out by; "" = the card that owns the host.
    wires: wires.Wires, of which it uses cortex/requests, cortex/replies, cortex/stream, and cortex/frames for what the
        cameras see; None = wires of its own.

    Raises ValueError when the bodies cannot be shown (too many, frame larger than a datagram) and OSError when an
    address cannot be used. Afterwards, bad input from the network never raises: it is counted, see statistics().
    """

    def __init__(
        self, world, endpoint, cameras, clock=None, templates=None, live_on_start=False, interface="", wires=None
    ):
        super().__init__("cortex", wires)
        self._world, self._endpoint, self._cameras, self._clock = world, endpoint, cameras, clock
        self._now_s = world.time_s

        self._live_on_start, self._interface = live_on_start, interface
        self._take = deque(maxlen=TAKE_FRAMES)
        self._forget()
        self._restart_s = None  # when to open the sockets (again); None: they are open, or the host is stopped
        self._requests, self._replies, self._stream = map(self.wire, ("requests", "replies", "stream"))
        self._frames = self.wires.frames("cortex/frames")

        self._request_counts = Counter()
        self._notices = Notices(_LOG, "Cortex host")

        layout, markers_m = world.layout, world.markers_m()
        self._encoder = wire.FrameEncoder(layout, MM_PER_M)
        self._body_names = [name for name, _ in layout]
        self._body_defs = self._encode_body_defs(layout, templates or {})
        exact = Observation(world.time_s, layout, markers_m, np.empty((0, 3)))
        self._base_positions = self._encode(0, exact)
        # the operator's screen before the first live frame
        self._shown = self._encode(0, self._cameras.observe(world.time_s, layout, markers_m))
        self._shown.dated(world.time_s + endpoint.reported_delay_s)

        self._stream_socket = self.address = None
        self._broadcast_addresses = []
        try:
            self._open_sockets(endpoint.command_port)
        except OSError:
            self.close()
            raise
        self._announce()

    def _forget(self):
        """Reset the state to that of a freshly started host."""
        self._number = 0  # of the newest frame
        self.live = self._live_on_start  # live mode is on
        self._last_exposure = None  # index of the last period of the frame rate that was served
        self._output_name = "capture"
        self._recording = None  # wire.Recording
        self._take.clear()
        self._take_at = 0
        self._play_mode = 0  # -1 backwards, 0 paused, 1 forwards
        self._clients = {}  # (address, port) of those that sent a request: an ordered set

    # --- the host interface of the virtual lab --------------------------------------------------------------------

    def tick(self, now_s):
        """Expose and send the frame that is due, if any. To be called after each step of the world."""
        self._now_s = now_s
        if self._stream_socket is None:
            self._try_to_start()
            return
        periods = self._periods_entered()
        if periods and self.live:
            self._counts["exposures_skipped"] += periods - 1
            self._expose_and_send()
        elif periods and self._play_mode:
            self._step_playback(periods)
        if now_s >= self.wires.due_s:
            self.wires.release(now_s)

    def stop(self):
        """Act as a killed program: close the sockets and forget everything."""
        self._restart_s = None
        self._close_sockets()
        self._forget()
        self._counts["stops"] += 1

    def start(self):
        """Start again, at the same addresses."""
        self._restart_s = -math.inf

    def _try_to_start(self):
        if self._restart_s is not None and self._now_s >= self._restart_s:
            try:
                self._open_sockets(self.address[1])
            except OSError as error:
                _LOG.error("%s", error)
                self._close_sockets()
                self._restart_s = self._now_s + RESTART_PERIOD_S
            else:
                self._restart_s = None
                self._announce()

    def close(self):
        """Close the sockets. May be called twice."""
        self._close_sockets()
        self._waiting.close()

    def _close_sockets(self):
        for sock in self._waiting:
            self._waiting.discard(sock)
            sock.close()
        self._heard.clear()
        self._broadcast_addresses.clear()
        if self._stream_socket is not None:
            self._stream_socket.close()
            self._stream_socket = None

    def describe(self):
        """Lines for people: what listens where."""
        host, port = self.address
        version = "%d.%d.%d" % IDENTITY.version[1:]
        lines = ["%s %s host: commands on udp %s:%d" % (IDENTITY.name, version, host, port)]
        if self._broadcast_addresses:
            lines.append("  hears broadcast hellos to %s" % ", ".join(self._broadcast_addresses))
        target = "%s:%d" % self._stream_target if self._stream_target else "nowhere"
        live = "live" if self.live else "paused until a client asks for LiveMode"
        lines.append("  stream at %g Hz to udp %s from %s, %s" % (self._endpoint.rate_hz, target, host, live))
        lines.append("  bodies: %s" % ", ".join(self._body_names))
        return "\n".join(lines)

    def set_live(self, live):
        """Switch live mode on or off, as the operator can at the screen."""
        if live and not self.live:
            self._play_mode, self._last_exposure = 0, None
        self.live = live

    def statistics(self):
        """Counts since the start (0 for a missing key), and requests by kind."""
        result = self._counts.copy()
        result["requests"] = dict(sorted(self._request_counts.items()))
        result["notices"] = self._notices.statistics()
        result["clients"] = len(self._clients)
        return result

    # --- sockets --------------------------------------------------------------------------------------------------

    def _open_sockets(self, command_port):
        endpoint, interface = self._endpoint, self._interface
        self._command_socket = open_socket(socket.SOCK_DGRAM, endpoint.host, command_port, "Cortex host, commands")
        self.hear(self._command_socket, self._requests, self._on_datagram)
        self.address = self._command_socket.getsockname()  # (address, port) for commands
        self._command_socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, COMMAND_RECEIVE_BUFFER_BYTES)
        # clients drop a stream that comes from another address than the replies do
        self._stream_socket = open_socket(socket.SOCK_DGRAM, endpoint.host, 0, "Cortex host, stream")
        self._stream_target = None
        wildcard = endpoint.host in ("", "0.0.0.0")
        if endpoint.stream_group:
            # any address of 127/8 selects lo: clients that joined on 127.0.0.1 receive the stream
            interface = interface or ("0.0.0.0" if wildcard else endpoint.host)
            try:
                for option, value in (
                    (socket.IP_MULTICAST_IF, socket.inet_aton(interface)),
                    (socket.IP_MULTICAST_LOOP, 1),
                    (socket.IP_MULTICAST_TTL, MULTICAST_TTL),
                ):
                    self._stream_socket.setsockopt(socket.IPPROTO_IP, option, value)
            except OSError as error:
                raise OSError(
                    error.errno or errno.EADDRNOTAVAIL,  # without a number when it is not an address at all
                    "cannot multicast through interface %s (%s): give the address of a network card of this "
                    "computer as the interface, or none for the host's own" % (interface, error.strerror or error),
                ) from error
            self._stream_target = endpoint.stream_group, endpoint.stream_port
        if wildcard:
            return
        # a socket bound to one address receives no broadcasts; these do, and all hosts of a computer share them
        for address in ("255.255.255.255", "127.255.255.255"):
            try:
                sock = open_socket(socket.SOCK_DGRAM, address, self.address[1], "Cortex host, broadcasts", share=True)
            except OSError as error:
                _LOG.warning("%s: clients that broadcast their hello will not find this host", error)
                continue
            self.hear(sock, self._requests, self._on_datagram)
            self._broadcast_addresses.append("%s:%d" % (address, self.address[1]))

    def _announce(self):
        """Tell clients that are already there that the host is back; they watch the stream for it."""
        if self._stream_target:
            self._send_stream(wire.encode_identity(Command.HERE_I_AM, IDENTITY), self._stream_target, self._now_s)

    def _send(self, datagram, address, sock):
        """Send a datagram. Returns whether it went out."""
        try:
            sock.sendto(datagram, address)
        except OSError as error:  # also: no room in the buffer, no route, a bad address
            if not self._counts["send_errors"]:
                _LOG.warning("cannot send to %s:%d: %s (further ones are only counted)", address[0], address[1], error)
            self._counts["send_errors"] += 1
            return False
        return True

    def _send_stream(self, datagram, address, _now_s):
        return self._stream_socket is not None and self._send(datagram, address, self._stream_socket)

    def _send_reply(self, datagram, address, _now_s):
        if self._stream_socket is not None:
            self._counts["replies"] += self._send(datagram, address, self._command_socket)

    def _reply_to(self, address, datagram):
        self._replies.carry(datagram, address, self._now_s, self._send_reply)

    def _clock_s(self):
        return self._now_s if self._clock is None else self._clock()

    # --- frames ---------------------------------------------------------------------------------------------------

    def _encode_body_defs(self, layout, templates):
        definitions = []
        for name, count in layout:
            template = templates.get(name)
            names = ["M%d" % (k + 1) for k in range(count)] if template is None else list(template.marker_names)
            if len(names) != count:
                raise ValueError("body %r has %d markers, its template names %d" % (name, count, len(names)))
            definitions.append(wire.BodyDef(name, names))
        return wire.encode_body_defs(wire.BodyDefs(definitions))

    def _encode(self, number, observation):
        packet, delay_offset = self._encoder.encode(
            number, observation.markers_m, observation.unidentified_m, recording=self._recording
        )
        return _EncodedFrame(observation.time_s, packet, delay_offset)

    def _periods_entered(self):
        """Periods of the frame rate that the world has entered since the last one served; 0 = still in that one."""
        # the tolerance lets a world that counts its own steps in floating point hit the edge of a period
        index = math.floor(self._world.time_s * self._endpoint.rate_hz + 1e-3)
        last, self._last_exposure = self._last_exposure, index
        if last is None or index < last:  # just went live, or the world was set back
            return 1
        return index - last

    def _expose_and_send(self):
        observation = self._cameras.observe(self._world.time_s, self._world.layout, self._world.markers_m())
        self._number = (self._number + 1) & FRAME_NUMBER_MASK
        self._counts["frames_exposed"] += 1
        self._frames.carry(observation, self._number, self._now_s, self._show_and_send)

    def _show_and_send(self, observation, number, _now_s):
        if self._stream_socket is None:  # the host was stopped while the frame was delayed
            return
        try:
            frame = self._encode(number, observation)
        except wire.PacketTooLargeError as error:
            if not self._counts["oversize_frames"]:
                _LOG.error("frame %d not sent: %s (further ones are only counted)", number, error)
            self._counts["oversize_frames"] += 1
            return
        self._shown = frame
        now_s = self._clock_s()
        packet = frame.dated(now_s)
        if self._recording is not None and self._recording.active:
            self._take.append(frame)
        if self._stream_target:
            self._counts["frames_sent"] += self._stream.carry(packet, self._stream_target, now_s, self._send_stream)

    def _step_playback(self, periods):
        """Show the next frame of the take; stop at its end."""
        wanted = self._take_at + self._play_mode * periods
        self._take_at = min(max(wanted, 0), len(self._take) - 1)
        if wanted != self._take_at:
            self._play_mode = 0
        self._shown = self._take[self._take_at]

    # --- requests -------------------------------------------------------------------------------------------------

    def _on_datagram(self, datagram, sender, _now_s):
        try:
            command, payload = wire.split_packet(datagram)
            if command in (Command.HELLO_WORLD, Command.ARE_YOU_THERE):
                if command == Command.HELLO_WORLD:
                    client = wire.decode_identity(payload)
                    version = ".".join(map(str, client.version[1:]))
                    self._notices.event("says hello", sender, "%s %s" % (client.name, version))
                self._answer(sender, Command(command).name, wire.encode_identity(Command.HERE_I_AM, IDENTITY))
            elif command == Command.REQUEST_BODYDEFS:
                self._answer(sender, "REQUEST_BODYDEFS", self._body_defs)
            elif command == Command.REQUEST_FRAME:
                self._answer(sender, "REQUEST_FRAME", self._frame_shown())
            elif command == Command.GENERAL_REQUEST:
                self._on_text_request(wire.decode_text(payload), sender)
            elif command == Command.PUSH_BASEPOSITION:
                self._count_request("PUSH_BASEPOSITION", sender)  # the protocol has no answer to it
            elif command in _HOST_COMMANDS:
                # what only a host sends; answering could start an endless exchange between two hosts
                self._counts["unexpected"] += 1
                self._notices.complaint("speaks as a host", sender, "command %d" % command)
            else:
                self._counts["unknown_commands"] += 1
                self._notices.complaint("sends unknown commands", sender, "%d" % command)
                self._reply_to(sender, wire.encode_packet(Command.UNRECOGNIZED_COMMAND))
        except wire.MalformedPacketError as error:
            self._counts["malformed"] += 1
            self._notices.complaint("sends malformed packets", sender, "%s" % error)

    def _answer(self, sender, kind, reply):
        self._count_request(kind, sender)
        self._reply_to(sender, reply)

    def _count_request(self, kind, sender):
        self._request_counts[kind] += 1
        if sender not in self._clients:
            self._clients[sender] = None
            self._notices.event("is a client", sender, "its first request: %s" % kind)
            if len(self._clients) > CLIENTS_REMEMBERED:
                del self._clients[next(iter(self._clients))]

    def _on_text_request(self, text, sender):
        name, equals, argument = text.partition("=")
        reply = self._reply_to_text(name, argument if equals else None, sender)
        if reply is None:
            self._counts["unrecognized_requests"] += 1
            self._notices.complaint("sends an unknown request", sender, repr(text[:60]))
            self._reply_to(sender, wire.encode_packet(Command.UNRECOGNIZED_REQUEST))
        else:
            self._answer(sender, name, reply)

    def _frame_shown(self):
        """The newest live frame with its age; when paused, the frame on the screen as it was sent."""
        return self._shown.dated(self._clock_s(), self._shown.packet[:]) if self.live else self._shown.packet

    def _reply_to_text(self, name, argument, sender):
        """Answer a request. argument: the text after "=", None without one. Returns None if it is not understood."""
        if argument is not None and name not in ("GetFrameOfData", "SetOutputName", "ResetIDs"):
            return None
        match name:
            case "LiveMode":
                if not self.live:
                    self._notices.event("starts the stream", sender)
                self.set_live(True)
            case "Pause":
                if self.live:
                    self._notices.complaint("pauses the stream of all clients", sender)
                self.set_live(False)
            case "GetContextFrameRate":
                return _reply(struct.pack("<f", self._endpoint.rate_hz))
            case _ if name in NUMBERS:
                return _reply(struct.pack(*NUMBERS[name]))
            case "GetFrameOfData" if argument is None:
                return self._frame_shown()
            case "GetFrameOfData":
                return self._base_positions.packet if argument == "BasePositions" else None
            case "SetOutputName":
                longest = wire.MAX_FILE_NAME_BYTES - len(".cap")
                if not argument or len(argument.encode("utf-8", "surrogateescape")) > longest:
                    return None
                self._output_name = argument
            case "StartRecording" if self._recording is None or not self._recording.active:  # clients repeat requests
                next_number = (self._number + 1) & FRAME_NUMBER_MASK
                self._recording = wire.Recording(1, next_number, 0, self._output_name + ".cap")
                self._take.clear()
                self._play_mode = 0
            case "StopRecording" if self._recording is not None and self._recording.active:
                # one that was ended before its first frame does not count: it has no last frame
                stopped = self._recording._replace(active=0, last_frame=self._number)
                self._recording = stopped if self._take else None
                self._take_at = max(len(self._take) - 1, 0)
            case "StartRecording" | "StopRecording":
                pass
            case "ResetIDs":  # nothing to do: the camera model never mistakes one marker for another
                if argument is not None and argument not in self._body_names:
                    return None
            case "PostForward" | "PostBackward" | "PostPause":
                self._play({"PostForward": 1, "PostBackward": -1, "PostPause": 0}[name])
            case "PostGetPlayMode":
                return _reply(struct.pack("<i", self._play_mode))
            case _:
                return None
        return _reply()

    def _play(self, mode):
        """Playback shows the recorded take to clients that poll; it needs live mode to be off and a take."""
        if not self.live and self._take:
            last = len(self._take) - 1
            if mode and not self._play_mode:
                self._last_exposure = None  # the first step comes with the next tick
                if mode > 0 and self._take_at >= last:
                    self._take_at = -1  # from the end forwards: once more from the start
                elif mode < 0 and self._take_at <= 0:
                    self._take_at = last + 1
            self._play_mode = mode


_HOST_COMMANDS = {
    Command.HERE_I_AM,
    Command.COMMENT,
    Command.BODYDEFS,
    Command.FRAME_OF_DATA,
    Command.GENERAL_REPLY,
    Command.UNRECOGNIZED_REQUEST,
    Command.UNRECOGNIZED_COMMAND,
}


def _reply(payload=b""):
    return wire.encode_packet(Command.GENERAL_REPLY, payload)
