#!/usr/bin/env python3
"""The driver's camera topics against a scripted aircraft that films: real H.264, PaVE and TCP."""

import contextlib
import os
import shutil
import subprocess
import tempfile
import time
import unittest
from dataclasses import replace

import cv2
import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from driver_process import Driver
from scripted_drone import ScriptedDrone
from scripted_video import PICTURES_PER_IDR, ScriptedVideo, bar_number, seen_channel
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo
from std_msgs.msg import Empty
from std_srvs.srv import Empty as EmptySrv

from ardrone_autonomy.protocol.navdata import ControlState
from ardrone_autonomy.srv import CamSelect, RecordEnable
from risc_lab.lab.calibration import CameraCalibration, read_calibration, save_calibration
from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import LIMIT_S, wait_for

FRONT_FRAME, BOTTOM_FRAME = "lab/ardrone_base_frontcam", "lab/ardrone_base_bottomcam"
CHANNEL_OF_FRAME = {FRONT_FRAME: 0, BOTTOM_FRAME: 1}
IMAGES = ("ardrone/image_raw", "ardrone/front/image_raw", "ardrone/bottom/image_raw")
INFOS = ("ardrone/camera_info", "ardrone/front/camera_info", "ardrone/bottom/camera_info")
CALIBRATION = CameraCalibration(
    name="ardrone_front",
    width_px=640,
    height_px=360,
    distortion_model="plumb_bob",
    D=(-0.526629, 0.274357, 0.021143, -0.006394, 0.0),
    K=(569.883, 0.0, 331.403, 0.0, 568.007, 135.879, 0.0, 0.0, 1.0),
    R=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
    P=(569.883, 0.0, 331.403, 0.0, 0.0, 568.007, 135.879, 0.0, 0.0, 0.0, 1.0, 0.0),
)


def pixels(image):
    return np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, -1)


class VideoTest(unittest.TestCase):
    def setUp(self):
        self.home = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.home)

    @contextlib.contextmanager
    def lab(self, header_bytes=68, group=None, **params):
        """(Aircraft, its camera, driver that is ready); messages are in driver.received."""
        with ScriptedDrone() as drone:
            with ScriptedVideo(
                drone.address, lambda: int(drone.configuration.get("video:video_channel")), header_bytes
            ) as camera:
                driver = Driver(drone, params, environment={"ROS_HOME": self.home}, group=group)
                try:
                    wait_for(lambda: drone.configuration.get("general:navdata_options") == 2**28 - 1, "configuration")
                    yield drone, camera, driver
                finally:
                    driver.end()

    def calibrate(self, path=None, focal_px=None, **changes):
        """Write a calibration; return its URL."""
        path = path or self.home + "/front.yaml"
        calibration = replace(CALIBRATION, **changes)
        if focal_px is not None:
            calibration = replace(calibration, K=(focal_px, *calibration.K[1:]))
        save_calibration(calibration, path)
        return "file://" + path

    def watch(self, driver, *topics):
        for topic in topics:
            driver.listen(topic, Image if topic.endswith("image_raw") else CameraInfo)

    def more(self, driver, topic, count=5):
        """Wait for the next messages of a topic; return them."""
        begin = len(driver.received[topic])
        wait_for(lambda: len(driver.received[topic]) >= begin + count, "%d messages on %s" % (count, topic))
        return driver.received[topic][begin:]

    def assert_camera(self, driver, topic, channel):
        """Wait until the topic carries pictures of this camera."""
        wait_for(
            lambda: driver.received[topic] and seen_channel(pixels(driver.newest(topic))) == channel,
            "channel %d on %s" % (channel, topic),
        )

    def assert_frames_tell_the_truth(self, driver):
        for topic in IMAGES:
            for image in driver.received.get(topic, ()):
                self.assertEqual(seen_channel(pixels(image)), CHANNEL_OF_FRAME[image.header.frame_id])

    def test_pictures_and_calibration(self):
        for header_bytes in (64, 68):
            with self.lab(header_bytes, camera_info_url=self.calibrate()) as (_, _, driver):
                self.watch(driver, *IMAGES, *INFOS)
                images = self.more(driver, "ardrone/front/image_raw", 20)
                for image in images:
                    self.assertEqual(
                        (image.width, image.height, image.encoding, image.step, image.is_bigendian, len(image.data)),
                        (640, 360, "rgb8", 1920, 0, 1920 * 360),
                    )
                    self.assertEqual(image.header.frame_id, FRONT_FRAME)
                    self.assertEqual(seen_channel(pixels(image)), 0)
                stamps = [image.header.stamp for image in images]
                self.assertTrue(all(a < b for a, b in zip(stamps, stamps[1:])))
                self.assertLess(abs((rospy.Time.now() - stamps[-1]).to_sec()), LIMIT_S)
                late = max(stamps)
                for topic in (*IMAGES[:2], *INFOS[:2]):
                    wait_for(lambda t=topic, s=late: driver.newest(t) and driver.newest(t).header.stamp >= s, topic)
                for pair in zip(IMAGES[:2], INFOS[:2]):
                    image_stamps, info_stamps = (
                        {message.header.stamp for message in list(driver.received[topic])} for topic in pair
                    )
                    self.assertGreater(len(image_stamps & info_stamps), 10)
                    begin = max(min(image_stamps), min(info_stamps))  # one subscription began before the other
                    only_one = {s for s in image_stamps ^ info_stamps if begin < s < late}
                    self.assertLessEqual(len(only_one), 4)  # lost by a queue of the driver
                info = driver.newest("ardrone/camera_info")
                self.assertEqual((info.width, info.height, info.distortion_model), (640, 360, "plumb_bob"))
                self.assertEqual(
                    (tuple(info.D), info.K, info.R, info.P),
                    (CALIBRATION.D, CALIBRATION.K, CALIBRATION.R, CALIBRATION.P),
                )
                self.assertEqual(info.header.frame_id, FRONT_FRAME)
                self.assertFalse(driver.received["ardrone/bottom/image_raw"])
                self.assertFalse(driver.received["ardrone/bottom/camera_info"])

    def test_the_stream_is_open_only_while_somebody_listens(self):
        with self.lab() as (_, camera, driver):
            time.sleep(0.5)
            self.assertEqual(camera.clients, 0)
            for topic in ("ardrone/bottom/image_raw", "ardrone/camera_info"):
                self.watch(driver, topic)
                wait_for(lambda: camera.has_client, "a connection because of " + topic)
                driver.unsubscribe(topic)
                wait_for(lambda: not camera.has_client, "the connection to be closed")

    def test_frames_follow_the_camera_that_films(self):
        bottom = self.calibrate(self.home + "/bottom.yaml", focal_px=700.0, name="ardrone_bottom")
        with self.lab(camera_info_url=self.calibrate(), bottom_camera_info_url=bottom) as (drone, camera, driver):
            self.watch(driver, *IMAGES, *INFOS)
            self.assert_camera(driver, "ardrone/image_raw", 0)
            driver.call("togglecam", EmptySrv)
            self.assert_camera(driver, "ardrone/image_raw", 1)
            self.assert_camera(driver, "ardrone/bottom/image_raw", 1)
            infos = self.more(driver, "ardrone/camera_info")
            self.assertEqual({(info.header.frame_id, info.K[0]) for info in infos}, {(BOTTOM_FRAME, 700.0)})
            count = len(driver.received["ardrone/front/image_raw"])
            self.more(driver, "ardrone/bottom/camera_info", 10)
            self.assertEqual(len(driver.received["ardrone/front/image_raw"]), count)
            driver.call("setrecord", RecordEnable, True)
            driver.call("setcamchannel", CamSelect, 0)
            driver.call("setcamchannel", CamSelect, 1)
            driver.call("setcamchannel", CamSelect, 0)
            self.assert_camera(driver, "ardrone/front/image_raw", 0)
            driver.call("togglecam", EmptySrv)
            self.assert_camera(driver, "ardrone/image_raw", 1)
            with camera.dead():
                drone.reboot()  # comes back with the front camera
                wait_for(lambda: drone.configuration.get("general:navdata_options") == 2**28 - 1, "configuration")
            self.assert_camera(driver, "ardrone/image_raw", 0)
            self.more(driver, "ardrone/front/image_raw", 5)
            self.assert_frames_tell_the_truth(driver)

    def test_comes_back_when_the_video_does(self):
        with self.lab() as (drone, camera, driver):
            self.watch(driver, "ardrone/image_raw")
            diagnostics = driver.subscribe("/diagnostics", DiagnosticArray)
            self.more(driver, "ardrone/image_raw")
            with camera.dead():
                self.wait_for_diagnosis(driver, diagnostics, lambda status: "no connection" in status.message)
                driver.publish("ardrone/takeoff", Empty())  # the flight does not depend on it
                wait_for(lambda: drone.phase is ControlState.HOVERING, "hovering")
            self.more(driver, "ardrone/image_raw")
            self.assert_frames_tell_the_truth(driver)
            self.wait_for_diagnosis(driver, diagnostics, lambda status: status.message == "pictures")

    def wait_for_diagnosis(self, driver, diagnostics, fits):
        begin = len(diagnostics)
        wait_for(
            lambda: any(
                fits(status)
                for message in diagnostics[begin:]
                for status in message.status
                if status.name.startswith(driver.namespace[1:]) and status.name.endswith("video")
            ),
            "the video on /diagnostics",
        )

    def test_diagnostics(self):
        with self.lab() as (_, camera, driver):
            self.watch(driver, "ardrone/image_raw")
            diagnostics = driver.subscribe("/diagnostics", DiagnosticArray)
            self.more(driver, "ardrone/image_raw")

            def spoil(data):
                camera.alter = lambda data: data
                return data[:100] + bytes(b ^ 0x5A for b in data[100:])

            camera.alter = spoil
            camera.noise = b"PaVE" + bytes(100)

            def complete(status):
                values = {pair.key: pair.value for pair in status.values}
                return (
                    values["camera"] == "front"
                    and values["front calibrated"] == "False"
                    and float(values["rate [Hz]"]) > 1.0
                    and float(values["age [s]"]) < 1.0
                    and int(values["decode errors"]) >= 1
                    and int(values["damaged headers"]) == 1
                    and int(values["bytes skipped"]) == 104
                )

            self.wait_for_diagnosis(driver, diagnostics, complete)

    def test_a_malformed_calibration_does_not_keep_the_vehicle_on_the_ground(self):
        path = self.home + "/front.yaml"
        with open(path, "w") as file:
            file.write("camera_matrix: {rows: 3, cols: 3, data: [1, 2]}\n")
        with self.lab(camera_info_url="file://" + path) as (drone, _, driver):
            self.watch(driver, "ardrone/camera_info")
            info = self.more(driver, "ardrone/camera_info")[0]
            self.assertEqual((info.width, info.height, info.K), (640, 360, (0.0,) * 9))
            driver.publish("ardrone/takeoff", Empty())
            wait_for(lambda: drone.phase is ControlState.HOVERING, "hovering")
            new = CameraInfo(
                width=640,
                height=360,
                distortion_model="plumb_bob",
                D=CALIBRATION.D,
                K=CALIBRATION.K,
                R=CALIBRATION.R,
                P=CALIBRATION.P,
            )
            answer = driver.call("front/set_camera_info", SetCameraInfo, new)
            self.assertTrue(answer.success, answer.status_message)
            wait_for(lambda: driver.newest("ardrone/camera_info").K[0] == CALIBRATION.K[0], "the new calibration")
            self.assertEqual(read_calibration(path), CALIBRATION)

    def test_calibrations_are_found_in_the_home_of_ros(self):
        for name, focal_px in (("ardrone_front", 501.0), ("ardrone_bottom", 502.0)):
            self.calibrate("%s/camera_info/%s.yaml" % (self.home, name), focal_px=focal_px, name=name)
        with self.lab() as (_, _, driver):
            self.watch(driver, "ardrone/camera_info")
            self.assertEqual(self.more(driver, "ardrone/camera_info")[0].K[0], 501.0)
            driver.call("togglecam", EmptySrv)
            wait_for(lambda: driver.newest("ardrone/camera_info").K[0] == 502.0, "the bottom camera's calibration")

    def test_a_calibration_named_for_the_group_of_the_camera(self):
        url = self.calibrate(focal_px=503.0)
        with self.lab(group={"camera_info_url": url}) as (_, _, driver):
            self.watch(driver, "ardrone/camera_info")
            self.assertEqual(self.more(driver, "ardrone/camera_info")[0].K[0], 503.0)

    def test_realtime_video_publishes_every_picture_at_once(self):
        with self.lab(realtime_video=True, looprate=5, video_latency=0.5) as (_, _, driver):
            self.watch(driver, "ardrone/image_raw")
            images = self.more(driver, "ardrone/image_raw", 40)
            bars = [bar_number(pixels(image)) for image in images]
            following = [(b - a) % PICTURES_PER_IDR == 1 for a, b in zip(bars, bars[1:])]
            self.assertGreater(np.mean(following), 0.9)  # a loop of 5 Hz would show every sixth
            gaps_s = np.diff([image.header.stamp.to_sec() for image in images])
            self.assertAlmostEqual(np.median(gaps_s), 1.0 / 30.0, delta=0.002)
            self.assertGreaterEqual((rospy.Time.now() - images[-1].header.stamp).to_sec(), 0.5)

    def test_otherwise_the_loop_sets_the_rate(self):
        with self.lab(looprate=5) as (_, _, driver):
            self.watch(driver, "ardrone/image_raw")
            self.more(driver, "ardrone/image_raw", 2)
            begin_s = time.monotonic()
            self.more(driver, "ardrone/image_raw", 10)
            self.assertGreater(time.monotonic() - begin_s, 1.0)  # 30 Hz would take 0.3 s

    def test_image_proc_rectifies(self):
        with self.lab(camera_info_url=self.calibrate()) as (_, _, driver):
            self.watch(driver, "ardrone/image_raw")
            rectified = driver.subscribe("ardrone/image_rect_color", Image)
            process = subprocess.Popen(
                ["rosrun", "image_proc", "image_proc"],
                env=dict(os.environ, ROS_NAMESPACE=driver.namespace + "/ardrone"),
            )
            try:
                wait_for(lambda: len(rectified) >= 5, "image_rect_color")
            finally:
                process.terminate()
                process.wait(LIMIT_S)
            raw = {image.header.stamp: image for image in list(driver.received["ardrone/image_raw"])}
            pairs = [(raw[image.header.stamp], image) for image in rectified if image.header.stamp in raw]
            self.assertTrue(pairs)
            source, result = map(pixels, pairs[-1])
            self.assertEqual(pairs[-1][1].header.frame_id, FRONT_FRAME)
            K, D = np.reshape(CALIBRATION.K, (3, 3)), np.array(CALIBRATION.D)
            colours = result if pairs[-1][1].encoding == "rgb8" else result[:, :, ::-1]
            error = np.abs(cv2.undistort(source, K, D).astype(int) - colours)
            self.assertLess(np.percentile(error, 99), 8)
            moved = np.abs(source.astype(int) - colours).max(axis=2) > 40
            self.assertGreater(np.mean(moved), 0.01)  # it was distorted


if __name__ == "__main__":
    init_node("ardrone_video_test")
    rostest.rosrun("ardrone_autonomy", "ardrone_video", VideoTest)
