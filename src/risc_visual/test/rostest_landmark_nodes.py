#!/usr/bin/env python3
"""Landmark nodes on the wire: pictures in, regions out per picture, overlays for listeners, bad pictures refused."""

import pathlib
import sys
import threading
import time
import unittest

import cv2
import dynamic_reconfigure.client
import numpy as np
import rosgraph_msgs.msg
import rospy
import rostest
from cv_bridge import CvBridge
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo, Image
from std_srvs.srv import Trigger

from risc_lab.ros.publisher_updates import init_node

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
from disc_pictures import camera, exposed, paint_disc, wall

from risc_maap_msgs.msg import Detections
from risc_msgs.msg import Observed_rois
from risc_visual.vision.colours import HsvRange
from risc_visual.vision.landmark_config import load_landmarks

PACKAGE = "risc_visual"
NAME = "landmark_nodes"
PATIENCE_S = 60.0
LANDMARKS = ["green", "pink", "Orange", "blue"]
HULL_BGR = [
    cv2.cvtColor(np.uint8([[hsv]]), cv2.COLOR_HSV2BGR)[0, 0].tolist() for hsv in ((132, 170, 160), (44, 200, 180))
]


def scene():
    """(picture of Green_pink and Blue_green, and of the hull of risc2; {ROI name: place})."""
    eye, picture = camera(), wall()
    truth = {
        "green": paint_disc(picture, eye, "green", (150.0, 120.0), 1.6, 40.0, 20.0),
        "blue": paint_disc(picture, eye, "blue", (450.0, 230.0), 2.0),
    }
    for k, bgr in enumerate(HULL_BGR):
        picture[70:95, 400 + 72 * k : 470 + 72 * k] = bgr
    return exposed(picture), truth


class LandmarkNodesTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        init_node(NAME)
        cls.bridge = CvBridge()
        cls.lock = threading.Lock()
        cls.rois, cls.exact, cls.quads, cls.logged, cls.health = [], [], [], [], {}
        cls.publishers = {
            name: rospy.Publisher("/%s/ardrone/image_rect_color" % name, Image, queue_size=1)
            for name in ("risc1", "risc2", "risc3")
        }
        cls.raw = rospy.Publisher("/risc3/ardrone/image_raw", Image, queue_size=1)
        cls.info = rospy.Publisher("/risc3/ardrone/camera_info", CameraInfo, queue_size=1, latch=True)
        rospy.Subscriber("/land_rois", Observed_rois, cls.keep, cls.rois, queue_size=100)
        rospy.Subscriber("/detections", Detections, cls.keep, cls.exact, queue_size=100)
        rospy.Subscriber("/quad_rois", Observed_rois, cls.keep, cls.quads, queue_size=100)
        rospy.Subscriber("/rosout", rosgraph_msgs.msg.Log, cls.keep, cls.logged, queue_size=100)
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.note, queue_size=100)
        cls.picture, cls.truth = scene()
        cls.number = 0
        # landmark_finder listens to all three, quad_finder to two of them
        wanted = {"risc1": 2, "risc2": 1, "risc3": 2}
        cls.wait(
            lambda: all(cls.publishers[name].get_num_connections() >= count for name, count in wanted.items()),
            "connections",
        )

    @classmethod
    def keep(cls, message, kept):
        with cls.lock:
            kept.append(message)

    @classmethod
    def note(cls, message):
        with cls.lock:
            cls.health.update({status.name: status for status in message.status})

    @staticmethod
    def wait(condition, what):
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > deadline_s:
                raise AssertionError("never came: " + what)
            time.sleep(0.02)

    def message(self, picture, encoding="bgr8"):
        """Image with a stamp of its own."""
        type(self).number += 1
        message = self.bridge.cv2_to_imgmsg(picture, encoding)
        message.header.stamp = rospy.Time(1000 + self.number, 5000)
        message.header.frame_id = "risc1/camera"
        return message

    def answer(self, name, message, kept=None):
        """The Observed_rois that has the message's stamp; the picture is sent until it comes."""
        kept = self.rois if kept is None else kept
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            self.publishers[name].publish(message)
            for _ in range(10):
                time.sleep(0.03)
                with self.lock:
                    found = [m for m in kept if m.header.stamp == message.header.stamp]
                if found:
                    return found[0]
        raise AssertionError("no regions for a picture of " + name)

    def check(self, answer, name, tolerance_px=1.0):
        self.assertEqual([entry.name for entry in answer.Obj], [name])
        self.assertEqual([roi.name for roi in answer.Obj[0].landmarks], LANDMARKS)
        for roi in answer.Obj[0].landmarks:
            self.assertEqual(roi.visible, roi.name in self.truth, roi.name)
            if roi.visible:
                self.assertLessEqual(abs(roi.x - self.truth[roi.name][0]), tolerance_px)
                self.assertLessEqual(abs(roi.y - self.truth[roi.name][1]), tolerance_px)
                self.assertGreater(min(roi.width, roi.height), 30.0)
            else:
                self.assertEqual((roi.x, roi.y, roi.width, roi.height, roi.angle), (0, 0, 0.0, 0.0, 0.0))

    def test_1_every_picture_is_answered_with_its_stamp_for_each_camera(self):
        for name in ("risc1", "risc2", "risc3", "risc1"):
            message = self.message(self.picture)
            answer = self.answer(name, message)
            self.check(answer, name)
            self.assertEqual(answer.header.stamp, message.header.stamp)
            self.assertEqual(answer.header.frame_id, "cortex")

    def test_2_other_vehicles_in_the_same_pass_and_by_quad_tracker(self):
        message = self.message(self.picture)
        entry = self.answer("risc1", message).Obj[0]
        self.assertEqual([(roi.name, roi.visible) for roi in entry.quads], [("risc2", True), ("risc3", False)])
        self.assertLess(abs(entry.quads[0].x - 471), 4)
        answer = self.answer("risc1", message, self.quads)
        self.assertEqual([entry.name for entry in answer.Obj], ["risc1"])
        self.assertEqual(list(answer.Obj[0].landmarks), [])
        self.assertEqual([(roi.name, roi.visible) for roi in answer.Obj[0].quads], [("risc2", True), ("risc3", False)])

    def test_3_encodings_and_sizes(self):
        rgb = self.picture[:, :, ::-1].copy()
        for picture, encoding in (
            (rgb, "rgb8"),
            (cv2.cvtColor(self.picture, cv2.COLOR_BGR2BGRA), "bgra8"),
            (self.picture.astype(np.uint16) * 257, "bgr16"),
        ):
            self.check(self.answer("risc1", self.message(picture, encoding)), "risc1")
        padded = self.message(self.picture)
        wide = np.zeros((360, 2000), np.uint8)
        wide[:, :1920] = self.picture.reshape(360, 1920)
        padded.step, padded.data = 2000, wide.tobytes()
        self.check(self.answer("risc1", padded), "risc1")
        nothing = self.answer("risc1", self.message(self.picture[:, :, 0].copy(), "mono8")).Obj[0]
        self.assertEqual([roi.visible for roi in nothing.landmarks], [False] * 4)
        tiny = self.answer("risc1", self.message(self.picture[:4, :4].copy())).Obj[0]
        self.assertEqual([roi.visible for roi in tiny.landmarks], [False] * 4)
        small = self.message(cv2.resize(self.picture, (320, 180), interpolation=cv2.INTER_AREA))
        seen = {roi.name: roi for roi in self.answer("risc2", small).Obj[0].landmarks}  # calibrated for 640x360
        self.assertLess(abs(seen["green"].x - 75), 2)

    def test_4_bad_pictures_are_refused_once_and_the_next_is_looked_at(self):
        unknown = self.message(self.picture)
        unknown.encoding = "x-ray"
        short = self.message(self.picture)
        short.data = short.data[:1000]
        for bad, told in ((unknown, "x-ray"), (short, "1000 bytes")):
            with self.lock:
                self.logged.clear()
            for _ in range(10):
                self.publishers["risc3"].publish(bad)
                time.sleep(0.03)

            def complaints(told=told):
                with self.lock:
                    return [
                        log.msg
                        for log in self.logged
                        if log.name == "/landmark_finder" and log.level >= log.ERROR and told in log.msg
                    ]

            self.wait(complaints, "the complaint about " + told)
            self.assertEqual(len(complaints()), 1)
            self.assertIn("/risc3/ardrone/image_rect_color", complaints()[0])
        self.check(self.answer("risc3", self.message(self.picture)), "risc3")
        self.wait(
            lambda: {value.key: value.value for value in self.status("risc3").values}.get("refused", "0") != "0",
            "the refusal in the diagnostics",
        )

    def status(self, namespace):
        self.wait(lambda: self.health.get("landmark_finder: landmark_finder: " + namespace), "diagnostics")
        return self.health["landmark_finder: landmark_finder: " + namespace]

    def test_5_the_overlay_is_drawn_for_listeners_only(self):
        message = self.message(self.picture)
        self.answer("risc2", message)  # without a subscriber there is only this answer
        drawn = []
        listener = rospy.Subscriber("/risc2/ardrone/image_modi", Image, self.keep, drawn, queue_size=5)
        deadline_s = time.monotonic() + PATIENCE_S
        while not drawn and time.monotonic() < deadline_s:
            message = self.message(self.picture)
            self.answer("risc2", message)
        self.assertTrue(drawn, "no overlay came")
        overlay = self.bridge.imgmsg_to_cv2(drawn[-1], "bgr8")
        self.assertEqual(overlay.shape, self.picture.shape)
        changed = (overlay != self.picture).any(axis=2)
        x, y = self.truth["green"].astype(int)
        self.assertTrue(changed[y - 10 : y + 10, x - 10 : x + 10].any(), "the landmark is marked")
        self.assertLess(changed.mean(), 0.2)
        self.assertEqual(drawn[-1].header.frame_id, "risc1/camera")
        listener.unregister()
        publishers = rospy.get_published_topics()
        self.assertIn(["/risc2/ardrone/image_modi", "sensor_msgs/Image"], publishers)

    def test_6_diagnostics_tell_rate_age_work_and_camera(self):
        self.info.publish(
            CameraInfo(
                width=640,
                height=360,
                distortion_model="plumb_bob",
                K=[600, 0, 319.5, 0, 600, 179.5, 0, 0, 1],
                R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
                P=[600, 0, 319.5, 0, 0, 600, 179.5, 0, 0, 0, 1, 0],
            )
        )

        def told(namespace):
            return {value.key: value.value for value in self.status(namespace).values}

        def calibrated():
            self.answer("risc3", self.message(self.picture))
            return told("risc3")["camera"] == "risc3"

        self.wait(calibrated, "the camera of camera_info")
        self.check(self.answer("risc3", self.message(self.picture)), "risc3")
        self.assertEqual(told("risc1")["camera"], "not calibrated")
        self.assertNotEqual(told("risc2")["camera"], "not calibrated")
        self.wait(lambda: float(told("risc3")["rate [Hz]"]) > 0.0 or calibrated() is None, "a rate")
        for key in ("age of last picture [s]", "work on a picture [ms]", "longest work on a picture [ms]"):
            self.assertGreaterEqual(float(told("risc3")[key]), 0.0)

    def test_7_exact_centres_stand_beside_with_ellipse_and_covariance(self):
        calibration = camera()  # of the scene: pictures without distortion
        info = CameraInfo(
            width=calibration.width_px, height=calibration.height_px, distortion_model="plumb_bob", D=[0.0] * 5,
            K=calibration.K.ravel(), R=np.eye(3).ravel(), P=np.column_stack((calibration.K, np.zeros(3))).ravel(),
        )  # fmt: skip
        publisher = rospy.Publisher("/risc1/ardrone/camera_info", CameraInfo, queue_size=1, latch=True)
        publisher.publish(info)
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            message = self.message(self.picture)
            entry = self.answer("risc1", message).Obj[0]
            with self.lock:
                exact = [m for m in self.exact if m.header.stamp == message.header.stamp][0]
            if exact.landmarks[LANDMARKS.index("green")].covariance[0] > 0.0:
                break
        self.assertEqual((exact.name, exact.header.frame_id), ("risc1", "risc1/camera"))
        self.assertEqual([item.name for item in exact.landmarks], LANDMARKS)
        for item, region in zip(exact.landmarks, entry.landmarks):
            self.assertEqual((item.visible, round(item.x), round(item.y)), (region.visible, region.x, region.y))
            if item.visible:
                self.assertLess(np.hypot(*(self.truth[item.name] - (item.x, item.y))), 0.15)
                covariance = np.reshape(item.covariance, (2, 2))
                self.assertTrue((covariance == covariance.T).all() and (np.linalg.eigvalsh(covariance) > 0.0).all())
                self.assertLess(np.sqrt(covariance.max()), 0.2)
                longer = max(region.width, region.height)
                self.assertAlmostEqual(2.0 * item.semi_major, longer, places=3)
                self.assertFalse(item.partial)

    def test_7_old_pictures_are_dropped(self):
        """A burst that is faster than the detector: the last picture is answered, but not all before it."""
        large = cv2.resize(self.picture, (2560, 1440), interpolation=cv2.INTER_LINEAR)
        burst = rospy.Publisher("/risc1/ardrone/image_rect_color", Image, queue_size=60)
        self.wait(lambda: burst.get_num_connections() >= 2, "connections of the burst")
        messages = [self.message(large) for _ in range(40)]
        for message in messages:
            burst.publish(message)
        last = messages[-1].header.stamp
        self.wait(lambda: any(m.header.stamp == last for m in list(self.rois)), "the answer to the newest")
        stamps = {message.header.stamp for message in messages}
        with self.lock:
            answered = [m for m in self.rois if m.header.stamp in stamps]
        self.assertLess(len(answered), len(messages))
        self.assertEqual([m.header.stamp for m in answered], sorted(m.header.stamp for m in answered))
        burst.unregister()

    def test_8_no_more_pictures_than_wanted_are_looked_at(self):
        """quad_tracker has 5 Hz; the other node takes every picture."""
        self.answer("risc3", self.message(self.picture), self.quads)
        begin_s, stamps = time.monotonic(), set()
        while time.monotonic() - begin_s < 3.0:
            message = self.message(self.picture)
            stamps.add(message.header.stamp)
            self.publishers["risc3"].publish(message)
            time.sleep(0.04)
        elapsed_s = time.monotonic() - begin_s
        with self.lock:
            few = [m for m in self.quads if m.header.stamp in stamps]
        self.assertLessEqual(len(few), 5.0 * elapsed_s + 2.0)
        self.assertGreaterEqual(len(few), 2)
        self.wait(lambda: len([m for m in list(self.rois) if m.header.stamp in stamps]) > len(few) + 5, "every picture")

    def test_9_mask_tuner_shows_and_saves(self):
        masks, file = [], pathlib.Path(rospy.get_param("/tuned_file"))
        self.assertFalse(file.exists())
        listener = rospy.Subscriber("/risc3/camera/tuned_mask", Image, self.keep, masks, queue_size=1)
        self.wait(lambda: self.raw.get_num_connections() >= 1, "mask_tuner listens when its mask has a subscriber")
        tuner = dynamic_reconfigure.client.Client("/risc3/blob_finder", timeout=PATIENCE_S)
        low, high = 140, 179
        tuner.update_configuration({"hue_low": low, "hue_high": high, "saturation_high": 255, "kernel": 0, "blur": 0})

        def pink():
            """The mask holds the pink ring of the green landmark, not its centre."""
            self.raw.publish(self.message(self.picture))
            time.sleep(0.1)
            if not masks:
                return False
            mask = self.bridge.imgmsg_to_cv2(masks[-1], "mono8")
            x, y = self.truth["green"].astype(int)
            return mask[y, x] == 0 and mask[y, :x].any() and not mask[200:260, 420:480].any()

        self.wait(pink, "the mask of the new thresholds")
        listener.unregister()
        save = rospy.ServiceProxy("/risc3/blob_finder/save", Trigger)
        self.addCleanup(lambda: file.exists() and file.unlink())
        answer = save()
        self.assertTrue(answer.success, answer.message)
        self.assertEqual(load_landmarks(file).colours["orange"], HsvRange((low, high), (26, 255), (84, 255)))
        self.assertEqual(load_landmarks(file).landmarks, load_landmarks().landmarks)


if __name__ == "__main__":
    rostest.rosrun(PACKAGE, NAME, LandmarkNodesTest)
