"""One aircraft's video: its cameras, its encoder, and the clients of its TCP port 5555."""

import functools
import socket
from collections import deque

import cv2
import numpy as np

from ardrone_autonomy.protocol.video import FrameType, parse_header
from risc_lab.camera import Camera
from risc_lab.lab.calibration import load_calibration, load_mount
from risc_simulator.socket_host import reset
from risc_simulator.video.camera_pose import camera_pose
from risc_simulator.video.checkerboard_motion import Waving
from risc_simulator.video.encoder import H264Encoder
from risc_simulator.video.renderer import Renderer
from risc_simulator.video.stream_writer import StreamWriter

MAX_CLIENTS = 8
LATE_PICTURES = 300  # the newest ones, of which the lateness is told
LATE_PERCENT = 10.0
MAX_BACKLOG_BYTES = 512 * 1024  # a client that reads slower than this loses pictures up to the next keyframe


class Eye:
    """One camera of one vehicle."""

    def __init__(self, camera, fleet_vehicle, scene, seed):
        """camera: vehicles.VirtualCamera. ValueError for a bad calibration or mount, of the type or the fleet file."""
        calibration, self.mount, self._sensor_px = camera.calibration, camera.mount, camera.sensor_px
        if camera.by_fleet:
            calibration = fleet_vehicle.calibration or calibration
            self.mount = load_mount(fleet_vehicle.camera_mount) if fleet_vehicle.camera_mount else self.mount
        self.camera = Camera(load_calibration(calibration))
        self._make_renderer = functools.partial(Renderer, self.camera, scene, seed)
        self._waving = None  # made when it is needed

    @functools.cached_property
    def _renderer(self):
        """Made when it is needed: 10 MB and 30 ms, and most cameras of a large fleet are never looked through."""
        return self._make_renderer()

    def look(self, row, vehicles, light, waved_s=None):
        """Picture (h, w, 3) uint8 BGR from the vehicle whose state is row (12,), see camera_pose.

        vehicles: VehiclePoses of the others. light: of the room, 1 = normal.
        waved_s: for how long [s] a checkerboard has been waved in front of the camera; None = there is none.
        """
        pose = camera_pose(row, self.mount)
        boards = () if waved_s is None else (self._board(waved_s, pose),)
        picture = self._renderer.render(pose, vehicles, boards, light)
        if self._sensor_px is not None:
            size = picture.shape[1::-1]
            picture = cv2.resize(picture, self._sensor_px, interpolation=cv2.INTER_AREA)
            picture = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
        return picture

    def _board(self, waved_s, pose):
        if self._waving is None:
            self._waving = Waving(self.camera)
        return self._waving.board(waved_s, pose)


class Station:
    """Serves one listener. One thread, non-blocking sockets; nothing that clients do raises."""

    def __init__(self, listener, eyes, latency_s, notices, stream):
        """listener: bound TCP socket. eyes: Eyes by channel. latency_s: from exposure to sending. notices: Notices.

        stream: faults.Stream that the pictures pass on their way to each client.
        """
        self.listener = listener
        listener.setblocking(False)
        self._eyes, self._latency_s, self._notices, self.stream = eyes, latency_s, notices, stream
        self._clients = {}  # socket -> _Client
        self._encoder, self._encoder_settings = None, None
        self._writer = StreamWriter()
        self._on_the_way = deque()  # (time to send, bytes)
        self._timestamp_ms = None  # of the newest picture, on the lab's clock
        self.next_s = None  # monotonic time of the next exposure
        self.pictures = self.skipped = 0
        self.newest_picture = 0, 0  # bytes of H.264 and frame number of the newest picture
        self._lateness_s = deque(maxlen=LATE_PICTURES)
        # How late nine out of ten of the newest pictures were sent, at least. A client takes the pictures that came
        # soonest as on time: when the computer has made all of them late, so are its stamps.
        self._late_s = 0.0  # None: not known since the last picture

    @property
    def late_s(self):
        """See above. Computed when somebody asks, after everything has been sent."""
        if self._late_s is None:
            self._late_s = float(np.percentile(self._lateness_s, LATE_PERCENT))
        return self._late_s

    @property
    def watchers(self):
        """How many clients are connected."""
        return len(self._clients)

    def sockets(self):
        """Sockets to wait on."""
        return [self.listener] + list(self._clients)

    def blocked(self):
        """Sockets of clients that have not taken everything yet: wait until they can be written."""
        return [sock for sock, client in self._clients.items() if client.backlog]

    def on_readable(self, sock):
        """A client comes, or says something (which is of no interest) or goes."""
        if sock is self.listener:
            self._accept()
            return
        try:
            gone = not sock.recv(4096)
        except BlockingIOError:
            return
        except OSError:
            gone = True
        if gone:
            self._hang_up(sock)

    def due_s(self, rate_hz, now_s, is_on=True):
        """When the next picture is to be exposed; None while nobody watches, or the camera is off."""
        if not self._clients:
            self._encoder = None  # the next watcher starts with an IDR frame
            self._on_the_way.clear()
        if not self._clients or not is_on:
            self.next_s = None
            return None
        if self.next_s is None:
            self.next_s = now_s
        period_s = 1.0 / rate_hz
        late = int((now_s - self.next_s) / period_s)
        if late > 0:  # the computer is too slow: pictures are left out, the rhythm is kept
            self.skipped += late
            self.next_s += late * period_s
        return self.next_s

    def expose(self, snapshot, index, channel, rate_hz, bitrate_kbit_s, **view):
        """Take a picture of a Snapshot from the vehicle of this index, and put it on its way. view: of Eye.look.

        While the lab stands still there is nothing new: two pictures of one time would look like a clock set back.
        """
        self.next_s += 1.0 / rate_hz
        timestamp_ms = round(1e3 * snapshot.lab_s)
        if timestamp_ms == self._timestamp_ms:
            self.skipped += 1
            return
        self._timestamp_ms = timestamp_ms
        picture = self._eyes[channel].look(snapshot.rows[index], **view)
        settings = (channel, rate_hz, bitrate_kbit_s)
        if self._encoder is None or settings != self._encoder_settings:
            self._encoder = H264Encoder(picture.shape[1], picture.shape[0], rate_hz, bitrate_kbit_s)
            self._encoder_settings = settings
            self._writer.stream_id = self._writer.stream_id % 0xFFFF + 1
            self._writer.encoded_px = self._encoder.coded_px
            self._writer.display_px = picture.shape[1::-1]
        data = self._writer.picture(self._encoder.encode(picture), timestamp_ms)
        header = parse_header(data)
        self.newest_picture = header.payload_bytes, header.frame_number
        self._on_the_way.append((snapshot.time_s + self._latency_s, data))

    def send_due_s(self):
        """When something is to be sent next; None when nothing is on its way."""
        return self._on_the_way[0][0] if self._on_the_way else None

    def send(self, now_s, lab_s, link_up):
        """Send what has arrived; with the link down it is lost. lab_s: the same as now_s on the lab's clock."""
        while self._on_the_way and self._on_the_way[0][0] <= now_s:
            due_s, data = self._on_the_way.popleft()
            self._lateness_s.append(now_s - due_s)
            self._late_s = None
            is_keyframe = parse_header(data).frame_type == FrameType.IDR
            self.pictures += link_up
            for sock, client in list(self._clients.items()):
                if link_up:
                    self.stream.carry((data, is_keyframe), sock, lab_s, self._offer, self._cut)
                else:
                    client.waits_for_keyframe = True
        if link_up:
            for sock, client in list(self._clients.items()):
                if not client.flush(sock):
                    self._hang_up(sock)

    def _offer(self, picture, sock, _lab_s):
        if sock in self._clients:
            self._clients[sock].offer(*picture)

    def _cut(self, sock):
        if sock in self._clients:
            reset(sock)
            self._hang_up(sock)

    def close(self):
        """Hang up on everybody."""
        for sock in list(self._clients):
            self._hang_up(sock)
        self.listener.close()

    def _accept(self):
        try:
            client, sender = self.listener.accept()
        except OSError:  # gone again
            return
        self._notices.event("asks for video", sender)
        if len(self._clients) >= MAX_CLIENTS:
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients[client] = _Client()

    def _hang_up(self, sock):
        sock.close()
        del self._clients[sock]


class _Client:
    """What one client has still to get."""

    def __init__(self):
        self.backlog = bytearray()
        self.waits_for_keyframe = False  # as the aircraft: a new client gets what comes, from the middle of the stream

    def offer(self, data, is_keyframe):
        if len(self.backlog) + len(data) > MAX_BACKLOG_BYTES:
            self.waits_for_keyframe = True
        elif is_keyframe or not self.waits_for_keyframe:
            self.waits_for_keyframe = False
            self.backlog += data

    def flush(self, sock):
        """False when the client is gone."""
        if self.backlog:
            try:
                del self.backlog[: sock.send(self.backlog)]
            except BlockingIOError:
                pass
            except OSError:
                return False
        return True


def seed_of(seed, index, channel):
    """Seed of the noise of one camera, of the vehicle of this index."""
    return np.random.SeedSequence(seed, spawn_key=(2000000 + 2 * index + channel % 2, *range(channel // 2)))
