"""Labelled pictures: boxes lie on the objects, COCO is complete, and the errors of unusable bags give the reason."""

import json
import pathlib
import subprocess
import sys

import cv2
import numpy as np
import pytest
import rosbag
import rospy
from cv_bridge import CvBridge
from sensor_msgs.msg import CameraInfo, Image

from data_extraction.bags import BagError
from data_extraction.labels import LabelParams, label
from risc_lab.settings import settings_from
from risc_msgs.msg import Cortex, Landmark, Landmarks, States

T0_S = 500.0
K = np.array([[600.0, 0, 330.0], [0, 610.0, 170.0], [0, 0, 1]])
D = np.array([-0.35, 0.12, 0.002, -0.001, 0.0])
PLACES = {"Green_pink": (2.2, 0.25, 1.1), "Blue_green": (2.2, -0.35, 0.9), "Pink_blue": (-2.2, 0.0, 1.0)}
YAW_RATE_DEG = 6.0
DELAY_S = 0.05
BRIDGE = CvBridge()


def yaw_deg(t_s):
    return YAW_RATE_DEG * (t_s - T0_S - 1.0)


def pixels(points_cortex, exposure_s):
    """Pixels (n, 2) of points seen from a level vehicle at (0, 0, 1): OpenCV's model, from first principles."""
    yaw = np.radians(yaw_deg(exposure_s))
    nose, right = np.array([np.cos(yaw), -np.sin(yaw), 0.0]), np.array([-np.sin(yaw), -np.cos(yaw), 0.0])
    lines = np.asarray(points_cortex, dtype=float) - (0.0, 0.0, 1.0) - 0.21 * nose
    optical = np.column_stack((lines @ right, -lines[:, 2], lines @ nose))
    return cv2.projectPoints(optical, np.zeros(3), np.zeros(3), K, D)[0][:, 0]


def rim(name, diameter_m=0.30):
    """Points on the edge of a landmark's disc, which faces along x."""
    angles = np.linspace(0.0, 2 * np.pi, 200)
    return np.array(PLACES[name]) + 0.5 * diameter_m * np.column_stack((0 * angles, np.cos(angles), np.sin(angles)))


def photograph(exposure_s):
    """A dark picture with the two landmarks in front, one blue, one red (BGR)."""
    picture = np.full((360, 640, 3), 20, np.uint8)
    for name, bgr in (("Green_pink", (255, 20, 20)), ("Blue_green", (20, 20, 255))):
        outline = np.rint(16 * pixels(rim(name), exposure_s)).astype(np.int32)
        cv2.fillPoly(picture, [outline], bgr, cv2.LINE_8, 4)
    return picture


def stamped(message, t_s, frame_id="ardrone_base_frontcam"):
    message.header.stamp, message.header.frame_id = rospy.Time.from_sec(t_s), frame_id
    return message


def camera_info():
    return CameraInfo(
        width=640, height=360, distortion_model="plumb_bob", D=D.tolist(), K=K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(), P=np.column_stack((K, np.zeros(3))).ravel().tolist(),
    )  # fmt: skip


def write_bag(path, leave_out=(), change=lambda topic, message: message):
    """2 s of a vehicle that turns; pictures 50 ms late, raw, compressed, and rectified."""
    with rosbag.Bag(str(path), "w") as bag:

        def write(topic, message, t_s):
            if topic not in leave_out:
                bag.write(topic, change(topic, message), rospy.Time.from_sec(t_s))

        for k in range(401):
            t_s = T0_S + 0.005 * k
            fluffy = States(name="fluffy_II", visible=True, x=0.0, y=0.0, z=1.0, psi=yaw_deg(t_s))
            raven = States(name="Raven", visible=True, x=1.8, y=0.0, z=1.3)
            write("/cortex_raw", stamped(Cortex(Obj=[fluffy, raven]), t_s, "cortex"), t_s)
            if k % 10 == 0:
                landmarks = [Landmark(name, *place) for name, place in PLACES.items()]
                write("/states3", stamped(Landmarks(Obj=landmarks), t_s, "cortex"), t_s)
        for k in range(1, 10):
            t_s = T0_S + 0.2 * k
            picture = photograph(t_s - DELAY_S)
            write("/risc1/ardrone/camera_info", stamped(camera_info(), t_s), t_s)
            raw = BRIDGE.cv2_to_imgmsg(picture, "bgr8")
            write("/risc1/ardrone/image_raw", stamped(raw, t_s), t_s)
            packed = BRIDGE.cv2_to_compressed_imgmsg(picture, "png")
            write("/risc1/ardrone/image_raw/compressed", stamped(packed, t_s), t_s)
            flat = BRIDGE.cv2_to_imgmsg(cv2.undistort(picture, K, D)[:, :, ::-1], "rgb8")
            write("/risc1/ardrone/image_rect_color", stamped(flat, t_s), t_s)


@pytest.fixture(scope="module")
def bag_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("labels") / "flight.bag"
    write_bag(path)
    return path


@pytest.fixture(scope="module")
def data_set(bag_file, tmp_path_factory):
    folder = tmp_path_factory.mktemp("data_set")
    path, *counts = label(bag_file, folder, params=LabelParams(delay_s=DELAY_S, format="png", overlay=True))
    return counts, folder, json.loads(path.read_text())


def labels_of(content, name):
    number = {item["name"]: item["id"] for item in content["categories"]}[name]
    return [item for item in content["annotations"] if item["category_id"] == number]


@pytest.mark.parametrize(("name", "channel"), [("Green_pink", 0), ("Blue_green", 2)])
def test_boxes_and_centres_lie_on_what_is_in_the_picture(data_set, name, channel):
    _, folder, content = data_set
    files = {item["id"]: item for item in content["images"]}
    labels = labels_of(content, name)
    assert len(labels) == 27
    for item in labels:
        picture = cv2.imread(str(folder / files[item["image_id"]]["file_name"]))[:, :, channel]
        y, x = np.nonzero(picture > 137)
        found = np.array([x.min(), y.min(), x.max() + 1, y.max() + 1])
        x0, y0, width, height = item["bbox"]
        np.testing.assert_allclose([x0, y0, x0 + width, y0 + height], found, atol=1.5)
        np.testing.assert_allclose(item["center"], [x.mean() + 0.5, y.mean() + 0.5], atol=1.0)
        assert item["area"] == pytest.approx(len(x), rel=0.05)
        mask = np.zeros_like(picture)
        outline = np.array(item["segmentation"][0]).reshape(-1, 2) - 0.5
        cv2.fillPoly(mask, [np.rint(16 * outline).astype(np.int32)], 255, cv2.LINE_8, 4)
        assert (mask[y, x] == 255).mean() > 0.97


def test_the_data_set_is_complete(data_set):
    counts, folder, content = data_set
    assert counts == [27, len(content["annotations"]), 0]
    assert {item["supercategory"] for item in content["categories"]} == {"landmark", "vehicle"}
    for image in content["images"]:
        picture = cv2.imread(str(folder / image["file_name"]))
        assert picture.shape == (image["height"], image["width"], 3) == (360, 640, 3)
        assert image["stamp"] - image["exposure"] == pytest.approx(DELAY_S)
    images = {image["id"] for image in content["images"]}
    assert len({item["id"] for item in content["annotations"]}) == len(content["annotations"])
    assert {item["image_id"] for item in content["annotations"]} <= images
    assert labels_of(content, "Pink_blue") == [], "it is behind the camera"
    assert len(list((folder / "overlays").iterdir())) == 27


def test_another_vehicle_is_labelled_with_its_distance(data_set):
    labels = labels_of(data_set[2], "Raven")
    assert len(labels) == 27
    assert min(item["distance"] for item in labels) == pytest.approx(np.hypot(1.8 - 0.21, 0.3), abs=0.02)
    assert all(item["elevation_deg"] > 10.0 for item in labels)


def test_a_wrong_delay_misses(bag_file, tmp_path):
    label(bag_file, tmp_path / "right", params=LabelParams(delay_s=DELAY_S))
    path, *_ = label(bag_file, tmp_path / "wrong", params=LabelParams(delay_s=0.0))
    right = labels_of(json.loads((tmp_path / "right/labels.json").read_text()), "Green_pink")
    wrong = labels_of(json.loads(path.read_text()), "Green_pink")
    shift_px = 600.0 * np.radians(YAW_RATE_DEG * DELAY_S)
    moved = [a["center"][0] - b["center"][0] for a, b in zip(right, wrong)]
    assert np.median(moved) == pytest.approx(shift_px, rel=0.3)


def test_every_nth_picture_of_chosen_topics(bag_file, tmp_path):
    topics = ["/risc1/ardrone/image_raw"]
    path, pictures, *_ = label(bag_file, tmp_path, params=LabelParams(every=4, delay_s=DELAY_S), topics=topics)
    content = json.loads(path.read_text())
    assert pictures == 3 and {image["topic"] for image in content["images"]} == set(topics)
    assert not (tmp_path / "overlays").exists()


def test_pictures_without_a_pose_are_counted_and_left_out(tmp_path):
    def early(topic, message):
        if topic == "/cortex_raw" and message.header.stamp.to_sec() > T0_S + 1.0:
            message.Obj[0].visible = False
        return message

    write_bag(tmp_path / "lost.bag", change=early)
    _, pictures, _, without_pose = label(tmp_path / "lost.bag", tmp_path / "out", params=LabelParams(delay_s=DELAY_S))
    assert (pictures, without_pose) == (15, 12)


def refused(tmp_path, topics=None, params=None, **bag):
    write_bag(tmp_path / "bad.bag", **bag)
    with pytest.raises(BagError) as error:
        label(tmp_path / "bad.bag", tmp_path / "out", params=params, topics=topics)
    assert not (tmp_path / "out" / "labels.json").exists()
    return str(error.value)


PICTURES = tuple("/risc1/ardrone/" + name for name in ("image_raw", "image_rect_color", "image_raw/compressed"))


def test_what_a_bag_lacks_is_said(tmp_path):
    assert "--topics" in refused(tmp_path, leave_out=PICTURES)
    assert "/cortex_raw" in refused(tmp_path, leave_out=("/cortex_raw",))
    assert "`calibration`" in refused(tmp_path, leave_out=("/risc1/ardrone/camera_info",))
    assert "/risc9/image" in refused(tmp_path, topics=["/risc9/image"])
    assert "risc_msgs/msg/Cortex" in refused(tmp_path, topics=["/cortex_raw"])
    assert "100 s" in refused(tmp_path, params=LabelParams(delay_s=100.0))


def test_a_camera_of_a_vehicle_that_nobody_knows_is_said(tmp_path):
    path = tmp_path / "strange.bag"
    write_bag(path, leave_out=PICTURES)
    with rosbag.Bag(str(path), "a") as bag:
        picture = stamped(BRIDGE.cv2_to_imgmsg(photograph(T0_S + 1), "bgr8"), T0_S + 1)
        bag.write("/quad1/ardrone/image_raw", picture, rospy.Time.from_sec(T0_S + 2))
    with pytest.raises(BagError, match="quad1.*risc1"):
        label(path, tmp_path / "out")


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        ({"encoding": "32FC1"}, "32FC1"),
        ({"data": b"123"}, "3 bytes in all"),
        ({"step": 3}, "rows of 3"),
        ({"width": 320, "step": 960, "data": bytes(960 * 360)}, "320x360"),
    ],
)
def test_pictures_that_cannot_be_used_are_named(tmp_path, damage, reason):
    def change(_topic, message):
        if isinstance(message, Image):
            for key, value in damage.items():
                setattr(message, key, value)
        return message

    assert reason in refused(tmp_path, topics=PICTURES[:1], change=change)


@pytest.mark.parametrize("bad", [{"every": 0}, {"min_fraction": 0.0}, {"format": "gif"}, {"delay_s": float("nan")}])
def test_bad_settings_are_refused(bad):
    with pytest.raises(ValueError):
        settings_from(LabelParams, bad)


def test_the_command_line(bag_file, tmp_path):
    script = str(pathlib.Path(__file__).resolve().parents[1] / "nodes" / "label_images.py")
    command = [sys.executable, script, str(bag_file), "--delay", str(DELAY_S), "-o", str(tmp_path / "set")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0 and "27 pictures" in done.stdout, done.stderr
    done = subprocess.run([sys.executable, script, "none.bag"], capture_output=True, text=True)
    assert done.returncode == 1 and "none.bag" in done.stderr and done.stderr.count("\n") == 1
