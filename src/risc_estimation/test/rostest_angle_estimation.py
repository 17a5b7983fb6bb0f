#!/usr/bin/env python3
"""The node on the wire: regions in, angles of the right camera out; without a camera nothing visible."""

import math
import threading
import time
import unittest

import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header

from risc_lab.camera import Camera
from risc_lab.lab.calibration import load_calibration
from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.testing import publishers_heard
from risc_maap_msgs.msg import Detection, Detections
from risc_msgs.msg import Observed_angles, Observed_rois, Risc_roi, Risc_rois

PACKAGE = "risc_estimation"
NAME = "angle_estimation_node"
PATIENCE_S = 60.0


def roi(name, x, y):
    return Risc_roi(name=name, visible=True, x=x, y=y, width=30.0, height=20.0)


class AngleEstimationNodeTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        init_node(NAME)
        cls.angles, cls.raw, cls.diagnostics = [], [], []
        cls.arrived = threading.Condition()
        cls.subscribers = [
            rospy.Subscriber("/angles", Observed_angles, cls.keep, cls.angles),
            rospy.Subscriber("/angles_raw", Observed_angles, cls.keep, cls.raw),
            rospy.Subscriber("/diagnostics", DiagnosticArray, cls.keep, cls.diagnostics),
        ]
        cls.pub = rospy.Publisher("/land_rois", Observed_rois, queue_size=100)
        cls.exact = rospy.Publisher("/detections", Detections, queue_size=100)
        cls.info = rospy.Publisher("/risc2/ardrone/camera_info", CameraInfo, queue_size=10)
        cls.stamp_s = 1000.0 + math.floor(rospy.get_time())
        deadline_s = time.monotonic() + PATIENCE_S

        def connected():
            both = all(publisher.get_num_connections() >= 2 for publisher in (cls.pub, cls.exact))
            return both and all(map(publishers_heard, cls.subscribers))

        while not connected():
            if time.monotonic() > deadline_s:
                raise AssertionError("the nodes did not connect within %g s" % PATIENCE_S)
            time.sleep(0.02)
        # A publisher counts a subscriber only after its handshake reply: an answer in between is lost.
        while not (cls.angles and cls.raw):
            if time.monotonic() > deadline_s:
                raise AssertionError("no answers within %g s" % PATIENCE_S)
            cls.stamp_s += 0.033
            cls.pub.publish(Observed_rois(Header(stamp=rospy.Time.from_sec(cls.stamp_s)), []))
            time.sleep(0.1)

    @classmethod
    def keep(cls, msg, kept):
        with cls.arrived:
            kept.append(msg)
            cls.arrived.notify_all()

    @staticmethod
    def answered(header):
        """Whether an image with this header is among the messages kept."""
        return lambda kept: any(msg.header.stamp == header.stamp for msg in kept)

    def ask(self, *entries):
        """Send regions; return the answers of both nodes, rectified and raw."""
        type(self).stamp_s += 0.033
        stamp = rospy.Time.from_sec(self.stamp_s)
        self.pub.publish(Observed_rois(Header(stamp=stamp, frame_id="/cortex"), list(entries)))

        def answers():
            return [[msg for msg in kept if msg.header.stamp == stamp] for kept in (self.angles, self.raw)]

        with self.arrived:
            self.assertTrue(self.arrived.wait_for(lambda: all(answers()), PATIENCE_S), "no answer")
            return [found[0] for found in answers()]

    def test_regions_become_angles_of_their_camera(self):
        landmarks = [roi("green", 500, 90), Risc_roi(name="Orange"), roi("blue", 150, 300)]
        rectified, raw = self.ask(Risc_rois("risc1", landmarks, [roi("Raven", 357, 160)]))
        self.assertEqual(rectified.header.frame_id, "cortex")
        vehicle = rectified.Obj[0]
        self.assertEqual(vehicle.name, "risc1")
        self.assertEqual([a.name for a in vehicle.landmarks + vehicle.quads], ["green", "Orange", "blue", "Raven"])
        self.assertEqual([a.visible for a in vehicle.landmarks + vehicle.quads], [True, False, True, True])
        self.assertTrue(math.isnan(vehicle.landmarks[1].azim) and math.isnan(vehicle.landmarks[1].elev))
        # the rectified picture's camera is P of risc1.yaml: numbers of the original release
        right, down = (500 - 356.921090) / 792.300659, (90 - 160.038265) / 921.526917
        self.assertAlmostEqual(vehicle.landmarks[0].azim, math.degrees(math.atan(right)), places=6)
        self.assertAlmostEqual(vehicle.landmarks[0].elev, math.degrees(math.atan2(-down, math.hypot(1, right))), 6)
        self.assertTrue(vehicle.landmarks[2].azim < 0.0 and vehicle.landmarks[2].elev < 0.0)
        camera = Camera(load_calibration("risc1.yaml"))
        for angle, pixel in ((raw.Obj[0].landmarks[0], (500, 90)), (raw.Obj[0].landmarks[2], (150, 300))):
            again = camera.pixels_of_bearings(math.radians(angle.azim), math.radians(angle.elev))
            np.testing.assert_allclose(again, pixel, atol=0.01)

    def test_camera_info_is_used_while_it_is_published(self):
        calibration = load_calibration("risc3.yaml")
        info = CameraInfo(
            width=640, height=360, distortion_model="plumb_bob", D=calibration.D, K=calibration.K, R=calibration.R,
            P=calibration.P,
        )  # fmt: skip
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            self.info.publish(info)
            rectified, raw = self.ask(Risc_rois("risc2", [roi("pink", 500, 100)], []))
            if rectified.Obj[0].landmarks[0].visible and raw.Obj[0].landmarks[0].visible:
                break
            time.sleep(0.1)
        else:
            self.fail("camera_info of risc2 was not used")
        right = (500 - calibration.P[2]) / calibration.P[0]
        self.assertAlmostEqual(rectified.Obj[0].landmarks[0].azim, math.degrees(math.atan(right)), places=6)

    def test_vehicles_do_not_share_their_angles(self):
        entries = [Risc_rois("risc1", [roi("green", 100 + 50 * k, 100)], []) for k in range(2)]
        entries[1].name = "fluffy_II"  # by its template: the same camera
        rectified, _ = self.ask(*entries)
        self.assertEqual([entry.name for entry in rectified.Obj], ["risc1", "fluffy_II"])
        first, second = (entry.landmarks[0].azim for entry in rectified.Obj)
        self.assertGreater(second - first, 1.0)

    def test_exact_detections_are_not_rounded_and_every_image_has_one_answer(self):
        type(self).stamp_s += 10.0
        pixels = [(300.37 + 0.013 * k, 120.61) for k in range(20)]

        def detections(header, x, y):
            return Detections(header, "risc1", [Detection(name="green", visible=True, x=x, y=y)], [])

        before = Header(stamp=rospy.Time.from_sec(self.stamp_s - 1.0), frame_id="risc1/camera")
        self.exact.publish(detections(before, 100.0, 100.0))
        with self.arrived:  # from now on the nodes know that there are exact detections
            both = self.arrived.wait_for(lambda: all(map(self.answered(before), (self.angles, self.raw))), PATIENCE_S)
            self.assertTrue(both, "no answer")
        for k, (x, y) in enumerate(pixels):
            header = Header(stamp=rospy.Time.from_sec(self.stamp_s + 0.033 * k), frame_id="risc1/camera")
            exact = detections(header, x, y)
            rounded = Observed_rois(header, [Risc_rois("risc1", [roi("green", round(x), round(y))], [])])
            messages = [(self.exact, exact), (self.pub, rounded)]
            for publisher, message in reversed(messages) if k % 2 else messages:
                publisher.publish(message)
            time.sleep(0.03)

        def answers():
            return [m for m in self.raw if abs(m.header.stamp.to_sec() - self.stamp_s - 0.33) < 0.5]

        with self.arrived:
            self.assertTrue(self.arrived.wait_for(lambda: len(answers()) >= len(pixels), PATIENCE_S), "no answer")
        time.sleep(0.3)
        with self.arrived:
            found = answers()
        type(self).stamp_s += 10.0
        self.assertEqual(len({message.header.stamp for message in found}), len(found), "an image was answered twice")
        camera = Camera(load_calibration("risc1.yaml"))
        again = [
            camera.pixels_of_bearings(*np.radians((a.azim, a.elev))) for a in (m.Obj[0].landmarks[0] for m in found)
        ]
        np.testing.assert_allclose(again, pixels, atol=0.005)

    def test_without_a_calibration_nothing_is_visible_and_it_is_said(self):
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            rectified, raw = self.ask(
                Risc_rois("risc3", [roi("green", 300, 100)], [roi("Kahn", 10, 10)]), Risc_rois("stranger", [], [])
            )
            for message in (rectified, raw):
                angles = message.Obj[0].landmarks + message.Obj[0].quads
                self.assertEqual([angle.visible for angle in angles], [False, False])
                self.assertTrue(all(math.isnan(angle.azim) and math.isnan(angle.elev) for angle in angles))
            status = self.status()
            if status is not None and "risc3" in status.message:
                break
            time.sleep(0.2)
        else:
            self.fail("the diagnostics do not name risc3: %r" % status)
        self.assertEqual(status.level, DiagnosticStatus.WARN)
        values = {item.key: item.value for item in status.values}
        self.assertEqual(values["camera of risc1"], "fleet")
        self.assertIn("/risc3/ardrone/camera_info", values["camera of risc3"])

    def status(self):
        with self.arrived:
            for message in reversed(self.diagnostics):
                for status in message.status:
                    if status.name == "angle_estimation: angle estimation":
                        return status
        return None


if __name__ == "__main__":
    rostest.rosrun(PACKAGE, NAME, AngleEstimationNodeTest)
