"""A virtual camera is calibrated from pictures of the moving checkerboard, by calibrate.py and camera_calibration."""

import functools
import pathlib
import runpy
import subprocess
import sys

import camera_calibration_parsers
import cv2
import numpy as np
import pytest
import rosbag
import rospy
from camera_calibration.calibrator import ChessboardInfo, MonoCalibrator
from cv_bridge import CvBridge
from labelled_pictures import calibration_pictures

from risc_lab.camera import Camera
from risc_lab.lab.calibration import load_calibration
from risc_visual.vision.checkerboard import Checkerboard, View
from risc_visual.vision.checkerboard import calibrate as calibration_of_views

CALIBRATE = pathlib.Path(__file__).resolve().parents[1] / "src/risc_visual/nodes/calibrate.py"
# the first is an ordinary camera, the second distorts strongly
CAMERAS = ["risc2", pytest.param("risc3", marks=pytest.mark.release)]
CAMERAS += [
    pytest.param(name, marks=pytest.mark.release)
    for name in ("risc1", "albatross_ardrone_front", "ardrone_front", "ardrone_bottom")
]
PICTURES = 60
SEED = 11

INTRINSICS_LIMIT = 0.01  # relative
POINT_LIMIT_PX = 0.5
STRONG_LENSES = ("risc1", "risc3")
STEEP = 3.0  # by how much undistortion may magnify an error; only corners of risc3's picture are beyond, up to 18


@pytest.fixture(scope="module")
def show(tmp_path_factory):
    """show(name): the true Camera, a folder with pictures of the board, and the pictures (BGR)."""

    @functools.cache
    def of(name):
        camera = Camera(load_calibration("%s.yaml" % name))
        folder = tmp_path_factory.mktemp(name)
        images = []
        for k, picture in enumerate(calibration_pictures(camera, SEED, PICTURES)):
            cv2.imwrite(str(folder / ("%03d.png" % k)), picture.image)
            images.append(picture.image)
        return camera, folder, images

    return of


def arguments_of(source, out, *others):
    return [str(CALIBRATE), str(source), "--size", "8x6", "--square", "0.025", "--out", str(out), *others]


@pytest.fixture(scope="module")
def found(show, tmp_path_factory):
    """found(name): what calibrate.py, started as a user does, makes of the folder, its file, and what it said."""

    @functools.cache
    def of(name):
        out = tmp_path_factory.mktemp("found") / "found.yaml"
        command = [sys.executable, *arguments_of(show(name)[1], out, "--name", "ardrone_front")]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300)
        assert done.returncode == 0, done.stderr
        return load_calibration(str(out)), out, done.stdout

    return of


def intrinsics_error(K, camera):
    """Greatest relative error of fx, fy, cx, cy."""
    true = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]]
    return float(np.max(np.abs(np.asarray(K).reshape(3, 3)[[0, 1, 0, 1], [0, 1, 2, 2]] - true) / true))


def point_errors_px(calibration, camera):
    """Errors of undistorted points all over the picture [true focal lengths], without those beyond STEEP.

    That is the error of the direction in space: an error of the principal point counts in full.
    """
    pixels = np.stack(np.meshgrid(np.linspace(0.0, 639.0, 33), np.linspace(0.0, 359.0, 19)), axis=-1).reshape(-1, 2)
    focal_px = camera.K[[0, 1], [0, 1]]
    slopes = [camera.undistort(pixels + step) - camera.undistort(pixels - step) for step in ((0.5, 0.0), (0.0, 0.5))]
    steepness = np.linalg.norm(np.stack(slopes, axis=-1) * focal_px[:, None], ord=2, axis=(1, 2))
    usable = steepness < STEEP
    assert usable.mean() > 0.97
    off = (Camera(calibration).undistort(pixels) - camera.undistort(pixels)) * focal_px
    return np.linalg.norm(off[usable], axis=1)


@pytest.mark.parametrize("lens", CAMERAS)
def test_calibrate_recovers_the_camera(show, found, lens):
    camera, _, _ = show(lens)
    calibration, file, text = found(lens)
    assert "reprojection error" in text and "warning" not in text, text
    assert (calibration.name, calibration.width_px, calibration.height_px) == ("ardrone_front", 640, 360)
    assert intrinsics_error(calibration.K, camera) < INTRINSICS_LIMIT
    assert point_errors_px(calibration, camera).max() < POINT_LIMIT_PX
    name, info = camera_calibration_parsers.readCalibration(str(file))  # as the driver reads it
    assert (name, tuple(info.K), tuple(info.D), tuple(info.P)) == (
        (calibration.name, calibration.K, calibration.D, calibration.P)
    )


@pytest.mark.parametrize("lens", CAMERAS)
def test_camera_calibration_agrees(show, lens):
    """Debian's calibrator on the same pictures as messages, as its node gets them from a camera; without its window."""
    camera, _, images = show(lens)
    bridge = CvBridge()
    debian = MonoCalibrator([ChessboardInfo("chessboard", 8, 6, 0.025)], flags=cv2.CALIB_FIX_K3, name="ardrone_front")
    for image in images:
        debian.handle_msg(bridge.cv2_to_imgmsg(image, "bgr8"))
    assert debian.goodenough, "the motion covers all that camera_calibration asks for: its CALIBRATE button lights up"
    debian.do_calibration()
    if lens not in STRONG_LENSES:
        assert intrinsics_error(debian.as_message().K, camera) < INTRINSICS_LIMIT
    # It has one initial guess for OpenCV: with strong distortion that can end in a local minimum. Its corners are good:
    views = [
        View(str(k), corners.reshape(-1, 2).astype(float)) for k, (corners, _, _) in enumerate(debian.good_corners)
    ]
    ours = calibration_of_views(views, Checkerboard(), (640, 360))
    assert intrinsics_error(ours.calibration.K, camera) < INTRINSICS_LIMIT


def test_a_bag_gives_the_same_as_the_folder(show, tmp_path, monkeypatch):
    """Of half of the pictures, the same ones of either."""
    camera, folder, images = show("risc2")
    bridge = CvBridge()
    path = tmp_path / "pictures.bag"
    with rosbag.Bag(str(path), "w") as bag:
        for k, image in enumerate(images):
            message = bridge.cv2_to_imgmsg(image[..., ::-1], "rgb8")
            message.header.stamp = rospy.Time(100 + k)
            bag.write("/risc2/ardrone/front/image_raw", message, message.header.stamp)
    calibrations = []
    for source, more in ((path, ["--topic", "/risc2/ardrone/front/image_raw"]), (folder, [])):
        out = tmp_path / (source.name + ".yaml")
        monkeypatch.setattr(sys, "argv", arguments_of(source, out, "--max-pictures", str(PICTURES // 2), *more))
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(CALIBRATE), run_name="__main__")
        assert ended.value.code == 0
        calibrations.append(load_calibration(str(out)))
    from_bag, from_folder = calibrations
    assert intrinsics_error(from_bag.K, camera) < INTRINSICS_LIMIT
    assert np.allclose(from_bag.K, from_folder.K, rtol=1e-4)
