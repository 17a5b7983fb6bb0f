"""Bearings of a vehicle that flies about the arena and looks at its four landmarks in turn, for tests of mounts."""

import numpy as np

from risc_estimation.expected_bearings import Observer
from risc_estimation.mount_samples import BearingWindow
from risc_estimation.synthetic_bearings import SyntheticBearings, SyntheticParams
from risc_lab.camera import Camera, bearings_of_rays, rays_of_bearings
from risc_lab.lab.calibration import CameraCalibration
from risc_lab.lab.landmark_catalogue import Disc

LANDMARKS = {
    "Green_pink": (2.3, 0.8, 1.5),
    "Pink_blue": (2.3, -0.8, 1.5),
    "Orange_blue": (-2.3, 0.8, 1.5),
    "Blue_green": (-2.3, -0.8, 1.5),
}
NAME = "fluffy_II"
CAMERA = Camera(CameraCalibration.from_intrinsics("wide", (640, 360), (580.0, 580.0), (320.0, 180.0)))
POSE_HZ, PICTURE_HZ = 50.0, 15.0
T0_S = 1.7e9  # as large as real stamps
_TURN_S = 7.5  # time for which each landmark is looked at


def flying(t_s):
    """(position (3,) [m], roll pitch yaw (3,) [rad]) of the flight at time t, which starts at 0."""
    position = np.array(
        (1.2 * np.sin(2 * np.pi * t_s / 11.0), 1.0 * np.cos(2 * np.pi * t_s / 7.0), 1.25 + 0.4 * np.sin(t_s))
    )
    targets = np.array(list(LANDMARKS.values()))
    ahead = targets[int(t_s / _TURN_S) % len(targets)] - position
    yaw = np.arctan2(-ahead[1], ahead[0]) + 0.25 * np.sin(2.3 * t_s)
    return position, (0.12 * np.sin(1.7 * t_s), 0.1 * np.cos(1.3 * t_s), yaw)


def hovering(t_s):
    """As `flying`, for a vehicle that hovers in one place, with small motions."""
    position = np.array((0.0, 0.8, 1.4)) + 0.02 * np.sin((1.1 * t_s, 1.9 * t_s, 0.7 * t_s))
    return position, (0.01 * np.sin(t_s), 0.01 * np.cos(1.4 * t_s), 0.02 * np.sin(0.6 * t_s))


def fly(mount, duration_s=30.0, flight=flying, landmarks=LANDMARKS, camera=CAMERA):
    """BearingWindow of a flight with a camera at this mount: what is in its field of view, without noise."""
    synthetic = SyntheticBearings({NAME: Observer(camera, mount)}, SyntheticParams(rate_hz=PICTURE_HZ))
    synthetic.see_landmarks([Disc(name, place) for name, place in landmarks.items()])
    window = BearingWindow()
    window.see_landmarks(landmarks)
    for k in range(int(duration_s * POSE_HZ)):
        stamp_s, pose = T0_S + k / POSE_HZ, flight(k / POSE_HZ)
        window.see_pose(stamp_s, *pose)
        for picture_s, pictures in synthetic.update(stamp_s, {NAME: pose}):
            seen = {b.name: (b.azimuth_rad, b.elevation_rad) for b in pictures[0].landmarks if b.visible}
            window.see_bearings(picture_s, seen)
    return window


def everything(window):
    """Samples of the whole window, of both of its parts."""
    return window.latest(1e6)


def noisy(samples, seed, noise_deg=0.3):
    """The samples with noise on azimuth and elevation."""
    azimuth_rad, elevation_rad = bearings_of_rays(samples.rays)
    noise_rad = np.radians(noise_deg) * np.random.default_rng(seed).standard_normal((2, len(azimuth_rad)))
    return samples._replace(rays=rays_of_bearings(azimuth_rad + noise_rad[0], elevation_rad + noise_rad[1]))


def with_wrong_ones(samples, share, seed, camera=CAMERA):
    """The samples, a share of them false.

    Half of these point anywhere in the picture, half at another landmark than named: the next one, 30 degrees aside.
    """
    random = np.random.default_rng(seed)
    rays = samples.rays.copy()
    wrong = random.permutation(len(rays))[: int(share * len(rays))]
    anything, mistaken = np.array_split(wrong, 2)
    size_px = (camera.width_px - 1, camera.height_px - 1)
    rays[anything] = camera.rays(random.uniform((0.0, 0.0), size_px, (len(anything), 2)))
    azimuth_rad, elevation_rad = bearings_of_rays(rays[mistaken])
    aside_rad = np.radians(random.normal(30.0, 3.0, len(mistaken))) * random.choice((-1.0, 1.0), len(mistaken))
    rays[mistaken] = rays_of_bearings(azimuth_rad + aside_rad, elevation_rad)
    return samples._replace(rays=rays)
