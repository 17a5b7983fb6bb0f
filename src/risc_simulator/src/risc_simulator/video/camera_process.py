"""The camera process of the virtual lab: draws and encodes the pictures that the lab orders (see server.py).

It is a separate process so that the lab keeps its 5 ms schedule: flight takes precedence over pictures. Orders come
one by one, pickled, by a socket; pictures go back in PaVE. Without orders it sleeps; it ends with the socket, so it
never outlives the lab.
"""

import contextlib
import functools
import logging
import pickle
import socket
import sys

import cv2
import numpy as np

from risc_lab.camera import Camera, rotation_camera_to_body
from risc_lab.frames import body_rates_from_euler_rates, rotation_body_to_cortex
from risc_lab.lab.calibration import load_calibration, load_mount
from risc_lab.priority import set_priority
from risc_simulator.vehicles import virtual_type
from risc_simulator.video.checkerboard_motion import CheckerboardMotion
from risc_simulator.video.encoder import H264Encoder
from risc_simulator.video.renderer import Renderer
from risc_simulator.video.scene import CameraPose, VehiclePose, load_scene
from risc_simulator.video.server import BAD_FILES, READY
from risc_simulator.video.stream_writer import StreamWriter

_LOG = logging.getLogger(__name__)
_NICENESS = 5


def camera_pose(row, mount):
    """CameraPose of a camera on a vehicle.

    row: (12,) of World.truth(): position [m], velocity [m/s] (cortex axes); roll, pitch, yaw [rad], their rates.
    mount: lab.calibration.CameraMount.
    """
    R_body_to_cortex = rotation_body_to_cortex(*row[6:9])
    R_camera_to_body = rotation_camera_to_body(mount)
    rate_body = np.array(body_rates_from_euler_rates(row[6], row[7], *row[9:12]))
    arm_m = np.asarray(mount.position_m)
    return CameraPose(
        position_m=row[:3] + R_body_to_cortex @ arm_m,
        R_camera_to_cortex=R_body_to_cortex @ R_camera_to_body,
        velocity_m_s=row[3:6] + R_body_to_cortex @ np.cross(rate_body, arm_m),
        rate_rad_s=rate_body @ R_camera_to_body,
    )


class Eye:
    """One camera of one vehicle."""

    def __init__(self, camera, fleet_vehicle, scene, seed):
        """camera: vehicles.VirtualCamera. ValueError for a bad calibration or mount, of the type or the fleet file."""
        calibration, self.mount, self._sensor_px = camera.calibration, camera.mount, camera.sensor_px
        if camera.by_fleet:
            calibration = fleet_vehicle.calibration or calibration
            self.mount = load_mount(fleet_vehicle.camera_mount) if fleet_vehicle.camera_mount else self.mount
        if not calibration:
            raise ValueError("the camera %s of type %s names no calibration file" % (camera.name, fleet_vehicle.type))
        self.camera = Camera(load_calibration(calibration))
        self._scene, self._seed = scene, seed

    @functools.cached_property
    def _renderer(self):
        """Made on first use: it takes 10 MB and 30 ms, and most cameras of a large fleet are never used."""
        return Renderer(self.camera, self._scene, self._seed)

    @functools.cached_property
    def _board_motion(self):
        return CheckerboardMotion(self.camera)

    def look(self, row, vehicles, light, board_time_s):
        """Picture (h, w, 3) uint8 BGR from the vehicle whose state is row (12,), see camera_pose.

        vehicles: VehiclePoses of the others. light, board_time_s: see server.Order.
        """
        pose = camera_pose(row, self.mount)
        boards = () if board_time_s is None else (self._board_motion.board(board_time_s, pose),)
        picture = self._renderer.render(pose, vehicles, boards, light)
        if self._sensor_px is not None:
            size = picture.shape[1::-1]
            picture = cv2.resize(picture, self._sensor_px, interpolation=cv2.INTER_AREA)
            picture = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
        return picture


class Cameras:
    """The cameras of one vehicle, and the encoder of the one in use."""

    def __init__(self, index, fleet_vehicle, scene, seed):
        self._eyes = [
            Eye(camera, fleet_vehicle, scene, _seed_of(seed, index, channel))
            for channel, camera in enumerate(virtual_type(fleet_vehicle.type).cameras)
        ]
        self._encoder, self._settings, self._writer = None, None, StreamWriter()

    def take(self, order, vehicles):
        """The picture of a server.Order in PaVE, bytes. vehicles: VehiclePoses of the others."""
        picture = self._eyes[order.channel].look(order.rows[order.index], vehicles, order.light, order.board_time_s)
        settings = order.channel, order.rate_hz, order.bitrate_kbit_s
        if order.begins_anew or settings != self._settings:
            self._settings, display_px = settings, picture.shape[1::-1]
            self._encoder = H264Encoder(*display_px, order.rate_hz, order.bitrate_kbit_s)
            self._writer.stream_id = self._writer.stream_id % 0xFFFF + 1
            self._writer.encoded_px, self._writer.display_px = self._encoder.coded_px, display_px
        return self._writer.picture(self._encoder.encode(picture), order.timestamp_ms)


def _seed_of(seed, index, channel):
    """Seed of the noise of one camera, of the vehicle of this index."""
    return np.random.SeedSequence(seed, spawn_key=(2000000 + 2 * index + channel % 2, *range(channel // 2)))


def main():
    """Started by server.py, argument: descriptor of the socket. Returns the exit code."""
    logging.basicConfig(format="virtual cameras: %(message)s", level=logging.INFO)
    link = socket.socket(fileno=int(sys.argv[1]))
    orders = link.makefile("rb")
    set_priority(_NICENESS)
    cv2.setNumThreads(1)
    with contextlib.suppress(EOFError, ConnectionError):  # the lab has ended
        fleet, seed = pickle.load(orders)
        try:
            scene = load_scene(fleet)
            cameras = [Cameras(index, vehicle, scene, seed) for index, vehicle in enumerate(fleet.vehicles)]
        except ValueError as error:
            _LOG.error("%s", error)
            return BAD_FILES
        link.sendall(READY)
        while True:
            order = pickle.load(orders)
            vehicles = [
                VehiclePose(vehicle.namespace, row[:3], rotation_body_to_cortex(*row[6:9]))
                for index, (vehicle, row) in enumerate(zip(fleet.vehicles, order.rows))
                if index != order.index
            ]
            link.sendall(cameras[order.index].take(order, vehicles))
    return 0


if __name__ == "__main__":
    sys.exit(main())
