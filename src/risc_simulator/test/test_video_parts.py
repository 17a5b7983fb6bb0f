"""Encoder and camera poses of the virtual cameras, each by itself."""

import av
import cv2
import numpy as np
import pytest

from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.calibration import CameraMount
from risc_simulator.video.camera_process import camera_pose
from risc_simulator.video.encoder import H264Encoder


@pytest.mark.parametrize("size_px", [(640, 360), (320, 180), (64, 48)])
def test_encoded_pictures_decode_one_by_one(size_px):
    rng = np.random.default_rng(3)
    scene = cv2.GaussianBlur(rng.integers(0, 255, (size_px[1] + 40, size_px[0] + 40, 3), np.uint8), (0, 0), 5)
    scene = cv2.normalize(scene, None, 30, 220, cv2.NORM_MINMAX)
    encoder, decoder = H264Encoder(*size_px, 30.0, 4000.0), av.CodecContext.create("h264", "r")
    for k in range(35):
        picture = scene[k : k + size_px[1], k : k + size_px[0]]
        frames = decoder.decode(av.Packet(encoder.encode(picture)))
        assert len(frames) == 1, "one picture in, one out: nothing waits"
        assert (frames[0].width, frames[0].height) == encoder.coded_px
        decoded = frames[0].to_ndarray(format="bgr24")[: size_px[1], : size_px[0]]
        assert abs(decoded.astype(int) - picture).mean() < 6.0
    assert all(side % 16 == 0 for side in encoder.coded_px)


def test_coding_moves_no_colour():
    """A disc that differs from its background more in colour than in brightness does not move."""
    ground, paint = np.array([140.0, 150.0, 150.0]), np.array([110.0, 140.0, 215.0])
    cover = np.zeros((360 * 4, 640 * 4), np.uint8)
    cv2.circle(cover, (320 * 4, 180 * 4), 40 * 4, 255, -1)
    cover = cv2.resize(cover, (640, 360), interpolation=cv2.INTER_AREA)[..., None] / 255.0
    picture = np.rint(ground * (1.0 - cover) + paint * cover).astype(np.uint8)

    def centre(image):
        weight = image[..., 2].astype(float) - image[..., 0]
        weight = np.where(weight > 40.0, weight, 0.0)
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()

    encoder, decoder = H264Encoder(640, 360, 30.0, 4000.0), av.CodecContext.create("h264", "r")
    (frame,) = decoder.decode(av.Packet(encoder.encode(picture)))
    decoded = frame.to_ndarray(format="bgr24")[:360]
    np.testing.assert_allclose(centre(decoded), centre(picture), atol=0.1)


def test_camera_pose_is_that_of_the_mount_and_moves_with_the_vehicle():
    """The pose a moment later agrees with the velocity and the rotation rate."""
    mount = CameraMount(position_m=(0.2, -0.03, 0.05), roll_rad=0.1, pitch_rad=0.3, yaw_rad=-0.2)
    row = np.array([0.5, -1.0, 1.2, 0.4, -0.3, 0.2, 0.1, -0.2, 1.9, 0.5, -0.4, 0.8])
    dt = 1e-5
    later = row.copy()
    later[:3] += dt * row[3:6]
    later[6:9] += dt * row[9:12]
    now, then = camera_pose(row, mount), camera_pose(later, mount)
    np.testing.assert_allclose((then.position_m - now.position_m) / dt, now.velocity_m_s, atol=1e-4)
    turn = now.R_camera_to_cortex.T @ then.R_camera_to_cortex
    rate = np.array([turn[2, 1], turn[0, 2], turn[1, 0]]) / dt
    np.testing.assert_allclose(rate, now.rate_rad_s, atol=1e-4)
    R = rotation_body_to_cortex(*row[6:9])
    np.testing.assert_allclose(now.position_m, row[:3] + R @ mount.position_m, atol=1e-12)
