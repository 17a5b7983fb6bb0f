"""The video of the virtual lab: when pictures are taken, and the clients of each vehicle's TCP port for video.

A separate process draws and encodes the pictures (camera_process.py), one at a time. It starts with the lab or when the
first client comes. Times are lab time in seconds.
"""

import contextlib
import logging
import math
import pickle
import socket
import subprocess
import sys
import weakref
from collections import deque
from typing import NamedTuple

import numpy as np

from ardrone_autonomy.protocol.video import MIN_HEADER_BYTES, FrameType, parse_header
from risc_lab.lab import load_vehicle_type
from risc_simulator.notices import Notices
from risc_simulator.socket_host import SocketHost, TcpClients

_LOG = logging.getLogger(__name__)
RATES_HZ = (1.0, 30.0)  # of video:codec_fps
BITRATES_KBIT_S = (250.0, 8000.0)
MAX_CLIENTS = 8
LATE_PICTURES = 300  # number of newest pictures whose lateness is reported
LATE_PERCENT = 10.0
MAX_BACKLOG_BYTES = 512 * 1024  # a client that reads slower than this loses pictures up to the next keyframe
STOP_PATIENCE_S = 3.0
START_REST_S = 5.0  # a camera process that has ended is started again after this time, not sooner
BAD_FILES = 3  # its exit code: a file that the fleet names cannot be used
READY = b"\n"  # what it sends before the first order


class Order(NamedTuple):
    """Order of one picture of the world as it is now."""

    index: int  # of the vehicle in the fleet
    channel: int  # place among the cameras of its type
    rate_hz: float
    bitrate_kbit_s: float
    begins_anew: bool  # start the stream anew, with an IDR picture
    timestamp_ms: int
    rows: np.ndarray  # (n, 12) of World.truth()
    light: float  # of the room, 1 = normal
    board_time_s: float | None  # since the motion of a checkerboard before the camera began [s]; None: there is none


class Station(TcpClients):
    """The video of one vehicle: the interface for its host and the lab."""

    def __init__(self, vehicle, channels, listener, stream):
        """vehicle: FleetVehicle. channels: how many cameras it has. listener: bound TCP socket; None without cameras.

        stream: wires.Stream that the pictures pass on their way to each client.
        """
        notices = Notices(_LOG, vehicle.namespace)
        super().__init__(listener, stream, notices, "asks for video", MAX_CLIENTS, self._arrive)
        self._channels, self._latency_s = channels or 1, load_vehicle_type(vehicle.type).video_latency_s
        self.configure(0, RATES_HZ[1], 4000.0, True)
        self.board_s = 0.0, 0.0  # start and end of the motion of a checkerboard
        self.pictures = self.skipped = 0  # sent; left out because the computer was too slow
        self.newest_picture = 0, 0  # bytes of H.264 and frame number of the newest that was made
        self.begins_anew = True  # the next picture begins a stream
        self.next_s = None  # when the next one is to be exposed; None: at once
        self.exposed_s = -math.inf  # when the newest one was
        self._on_the_way = deque()  # (time to send, bytes, is a keyframe)
        # clients that missed data; a new client starts in the middle of the stream, as with the aircraft
        self._waiting_for_keyframe = weakref.WeakSet()
        self._lateness_s = deque(maxlen=LATE_PICTURES)

    def configure(self, channel, rate_hz, bitrate_kbit_s, enabled):
        """Apply the vehicle's configuration; clients may write any numbers there, which are limited here."""
        self.channel, self.enabled = channel % self._channels, enabled
        self.rate_hz = float(min(max(rate_hz, RATES_HZ[0]), RATES_HZ[1]))
        self.bitrate_kbit_s = float(min(max(bitrate_kbit_s, BITRATES_KBIT_S[0]), BITRATES_KBIT_S[1]))

    def statistics(self):
        """What the camera has done, as plain numbers.

        late_ms: nine out of ten of the newest pictures were sent at least this late. A client assumes that the earliest
        pictures were on time: if the computer made all of them late, its stamps are late, too.
        """
        late_s = float(np.percentile(self._lateness_s, LATE_PERCENT)) if self._lateness_s else 0.0
        return {"pictures": self.pictures, "skipped": self.skipped, "late_ms": 1e3 * late_s}

    def accept(self):
        is_first = not self.backlogs
        super().accept()
        if is_first:
            self.begins_anew, self.next_s = True, None
            self._on_the_way.clear()
            self._waiting_for_keyframe.update(self.backlogs)

    def is_due(self, now_s, exposure_s):
        """Whether a picture is to be taken now. exposure_s: time of the state of the world."""
        if not self.enabled:
            self.next_s = None
            return False
        if self.next_s is None:
            self.next_s = now_s
        late = int((now_s - self.next_s) * self.rate_hz)
        if late > 0:  # the computer is too slow: pictures are skipped, the phase is kept
            self.skipped += late
            self.next_s += late / self.rate_hz
        return self.next_s <= now_s and exposure_s > self.exposed_s

    def order(self, index, exposure_s, rows, light):
        """Order of the picture that is due. index: of the vehicle. exposure_s, rows, light: of the world."""
        self.next_s += 1.0 / self.rate_hz
        self.exposed_s = exposure_s
        begins_anew, self.begins_anew = self.begins_anew, False
        since_s, until_s = self.board_s
        board_time_s = max(0.0, exposure_s - since_s) if exposure_s < until_s else None
        settings = self.channel, self.rate_hz, self.bitrate_kbit_s, begins_anew
        return Order(index, *settings, round(1e3 * exposure_s), rows, light, board_time_s)

    def take(self, data, header):
        """Queue the picture that was ordered, to be sent after the video latency."""
        self.newest_picture = header.payload_bytes, header.frame_number
        self._on_the_way.append((self.exposed_s + self._latency_s, data, header.frame_type == FrameType.IDR))

    @property
    def due_s(self):
        """When the next picture is to be sent."""
        return self._on_the_way[0][0] if self._on_the_way else math.inf

    def send(self, now_s):
        """Send the pictures that are due; a client whose stream is blocked loses them."""
        while self.due_s <= now_s:
            due_s, data, is_keyframe = self._on_the_way.popleft()
            self._lateness_s.append(now_s - due_s)
            self.pictures += 1
            self.write((data, is_keyframe), now_s)
        self.flush()

    def overflow(self, sock):
        self._waiting_for_keyframe.add(sock)

    def _arrive(self, picture, sock):
        (data, is_keyframe), backlog = picture, self.backlogs[sock]
        if len(backlog) + len(data) > MAX_BACKLOG_BYTES:
            self._waiting_for_keyframe.add(sock)
        elif is_keyframe or sock not in self._waiting_for_keyframe:
            self._waiting_for_keyframe.discard(sock)
            backlog += data


class VideoServer(SocketHost):
    """The stations of all vehicles, and the process that makes their pictures."""

    def __init__(self, world, fleet, seed, wires, listeners):
        """world: has time_s and truth(). listeners: bound TCP sockets in fleet order, None without cameras."""
        super().__init__("video", wires)
        self._world, self._job = world, (fleet, seed)
        self.light = 1.0  # of the room
        self.stations = {}  # by namespace
        for vehicle, listener in zip(fleet.vehicles, listeners):
            stream = wires.stream("%s/video" % vehicle.namespace) if listener else None
            channels = len(world.vehicles[vehicle.namespace].virtual.cameras)
            self.stations[vehicle.namespace] = Station(vehicle, channels, listener, stream)
        self._all = list(self.stations.values())
        for station in self._all:
            self._waiting.add(station)
        self._has_cameras = any(listeners)
        self._process = self._link = None
        self._received = bytearray()  # bytes of the picture being made
        self._taking = None  # Station whose picture is being made
        self._rest_until_s = -math.inf
        self.ready = False  # the camera process is up: a client is served at once
        self.due_s = math.inf  # before this time send() has nothing to do

    def start(self):
        """Start the camera process if it does not run. If that fails, it is tried again later."""
        if self._process is not None or not self._has_cameras or self._now_s < self._rest_until_s:
            return
        link, theirs = socket.socketpair()
        with link, theirs:
            command = [sys.executable, "-m", "risc_simulator.video.camera_process", str(theirs.fileno())]
            try:
                # Ctrl-C is for the lab, whose end ends this process
                self._process = subprocess.Popen(command, pass_fds=[theirs.fileno()], start_new_session=True)
            except OSError as error:  # no memory, too many processes: the lab goes on
                _LOG.error("the camera process cannot be started (%s), the next try is in %g s", error, START_REST_S)
                self._rest_until_s = self._now_s + START_REST_S
                return
            self._link = link.dup()
        self._waiting.add(self._link)
        self._send_to_process(self._job)

    def on_readable(self, member, now_s):
        self._now_s = now_s
        if member is self._link:
            self._receive_picture()
        else:
            super().on_readable(member, now_s)

    def tick(self, now_s):
        """To be called once per cycle of the lab, after the world has moved."""
        self._now_s = now_s
        for station in self._all:
            if station.backlogs:
                station.flush()
        if self._process is None and any(station.backlogs for station in self._all):
            self.start()
        if self._link is None and self._process is not None and self._process.poll() is not None:
            self._bury()
        self._order_picture()

    def send(self, now_s):
        """Send the pictures that are due by now."""
        if now_s >= self.due_s:
            for station in self._all:
                station.send(now_s)
            self.due_s = min(station.due_s for station in self._all)

    def close(self):
        """Disconnect all clients and end the camera process. May be called twice."""
        self._hang_up()
        if self._process is not None:
            try:
                self._process.wait(STOP_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            self._process = None
        for station in self._all:
            station.close()
        self._waiting.close()

    # --- the camera process -------------------------------------------------------------------------------------------

    def _order_picture(self):
        """Let the camera that has waited longest take its picture if it is due and the camera process is free."""
        if not self.ready or self._taking is not None:
            return
        exposure_s = self._world.time_s
        due = [(s.exposed_s, k, s) for k, s in enumerate(self._all) if s.backlogs and s.is_due(self._now_s, exposure_s)]
        if due:
            _, index, self._taking = min(due)
            self._send_to_process(self._taking.order(index, exposure_s, self._world.truth(), self.light))

    def _send_to_process(self, what):
        with contextlib.suppress(ConnectionError):  # it has ended: its socket will show it
            self._link.sendall(pickle.dumps(what))

    def _receive_picture(self):
        try:
            data = self._link.recv(1 << 18)
        except ConnectionError:
            data = b""
        if not data:
            self._hang_up()
            return
        self._received += data
        if not self.ready:
            del self._received[: len(READY)]
            self.ready = True
            _LOG.info("cameras are ready: video is sent as soon as a client connects")
        elif len(self._received) >= MIN_HEADER_BYTES:
            header = parse_header(self._received)
            if len(self._received) == header.header_bytes + header.payload_bytes:
                self._taking.take(bytes(self._received), header)
                self._received.clear()
                self.due_s = min(self.due_s, self._taking.due_s)
                self._taking = None
                self._order_picture()

    def _hang_up(self):
        if self._link is not None:
            self._waiting.discard(self._link)
            self._link.close()
            self._link = None
        self.ready, self._taking = False, None
        self._received.clear()

    def _bury(self):
        """Log that the camera process has ended, and set the time of its next start."""
        code, self._process = self._process.returncode, None
        rest_s, cure = START_REST_S, "it is started again, in %g s" % START_REST_S
        if code == BAD_FILES:
            rest_s, cure = math.inf, "you mend what they name and start the lab again"
        text = "the camera process has ended (code %s), its last lines say why: vehicles send no video until %s"
        _LOG.error(text, code, cure)
        self._rest_until_s = self._now_s + rest_s
        for station in self._all:
            station.next_s = None
