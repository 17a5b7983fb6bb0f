"""One aircraft's video: its cameras, its encoder, and the clients of its TCP port 5555."""

import functools
import weakref
from collections import deque

import cv2
import numpy as np

from ardrone_autonomy.protocol.video import FrameType, parse_header
from risc_lab.camera import Camera
from risc_lab.lab.calibration import load_calibration, load_mount
from risc_simulator.socket_host import TcpClients
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
        self._eyes, self._latency_s, self.stream = eyes, latency_s, stream
        self._clients = TcpClients(listener, stream, notices, "asks for video", MAX_CLIENTS, self._arrive)
        # who has missed something; a new client gets what comes, as from the aircraft: from the middle of the stream
        self._waiting_for_keyframe = weakref.WeakSet()
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
        return len(self._clients.backlogs)

    def sockets(self):
        """Sockets to wait on."""
        return [self.listener, *self._clients.backlogs]

    def blocked(self):
        """Sockets of clients that have not taken everything yet: wait until they can be written."""
        return [sock for sock, backlog in self._clients.backlogs.items() if backlog]

    def on_readable(self, sock):
        """A client comes, or says something, or goes."""
        if sock is self.listener:
            self._clients.accept()
        else:
            self._clients.drain(sock)

    def due_s(self, rate_hz, now_s, is_on=True):
        """When the next picture is to be exposed; None while nobody watches, or the camera is off."""
        if not self.watchers:
            self._encoder = None  # the next watcher starts with an IDR frame
            self._on_the_way.clear()
        if not self.watchers or not is_on:
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
            if link_up:
                self._clients.write((data, is_keyframe), lab_s)
            else:
                self._waiting_for_keyframe.update(self._clients.backlogs)
        if link_up:
            self._clients.flush()

    def close(self):
        """Hang up on everybody."""
        self._clients.close()
        self.listener.close()

    def _arrive(self, picture, sock):
        (data, is_keyframe), backlog = picture, self._clients.backlogs[sock]
        if len(backlog) + len(data) > MAX_BACKLOG_BYTES:
            self._waiting_for_keyframe.add(sock)
        elif is_keyframe or sock not in self._waiting_for_keyframe:
            self._waiting_for_keyframe.discard(sock)
            backlog += data


def seed_of(seed, index, channel):
    """Seed of the noise of one camera, of the vehicle of this index."""
    return np.random.SeedSequence(seed, spawn_key=(2000000 + 2 * index + channel % 2, *range(channel // 2)))
