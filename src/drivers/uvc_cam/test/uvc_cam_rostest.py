#!/usr/bin/env python3
"""uvc_cam_node end to end: sources that appear, vanish and change, calibrations that fit or not."""

import os
import pathlib
import shutil
import time
import unittest

import cv2
import numpy as np
import rospy
import rostest
from cv_bridge import CvBridge
from diagnostic_msgs.msg import DiagnosticArray
from dynamic_reconfigure.client import Client
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import CameraInfo, Image
from sensor_msgs.srv import SetCameraInfo

from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.testing import LIMIT_S, Listener

COLOURS = [(200, 30, 30), (30, 200, 30), (30, 30, 200)]  # blue green red


def write_pictures(folder):
    """Make a folder of three pictures; it appears at once, complete."""
    made = folder.with_name(folder.name + ".part")
    made.mkdir(parents=True)
    for k, bgr in enumerate(COLOURS):
        cv2.imwrite(str(made / ("%d.png" % k)), np.full((48, 64, 3), bgr, np.uint8))
    made.rename(folder)


def write_video(path):
    made = path.with_name("part." + path.name)
    writer = cv2.VideoWriter(str(made), cv2.VideoWriter_fourcc(*"MJPG"), 15.0, (80, 60))
    for bgr in COLOURS:
        writer.write(np.full((60, 80, 3), bgr, np.uint8))
    writer.release()
    made.rename(path)


def calibration(width, height, focal_px):
    return CameraInfo(
        width=width,
        height=height,
        distortion_model="plumb_bob",
        D=[0.1, 0.0, 0.0, 0.0, 0.0],
        K=[focal_px, 0.0, 32.0, 0.0, focal_px, 24.0, 0.0, 0.0, 1.0],
        R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        P=[focal_px, 0.0, 32.0, 0.0, 0.0, focal_px, 24.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


class UvcCamTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.files = pathlib.Path(rospy.get_param("/files"))
        cls.files.mkdir(parents=True)
        cls.log = Listener("/rosout", Log)
        cls.diagnostics = Listener("/diagnostics", DiagnosticArray)

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(str(cls.files))

    def complaints(self, text):
        return [entry for entry in self.log.messages if entry.level >= Log.WARN and text in entry.msg]

    def wait_for_status(self, node, level, text):
        def fits(array):
            return any(node in s.name and s.level == level and text in s.message for s in array.status)

        self.diagnostics.wait_for(fits, "status %d '%s' of %s" % (level, text, node), len(self.diagnostics.messages))

    def test_1_a_folder_that_comes_late(self):
        images = Listener("/folder/camera/image_raw", Image)
        infos = Listener("/folder/camera/camera_info", CameraInfo)
        self.wait_for_status("folder/", 2, "/pictures")
        time.sleep(2.5)  # two more tries
        self.assertEqual(len(self.complaints("/pictures (")), 1, "one error, however often it is tried")
        self.assertEqual(len(images.messages), 0)

        write_pictures(self.files / "pictures")
        seen = set()
        for bgr in COLOURS:
            image = images.wait_for(lambda m, bgr=bgr: tuple(m.data[:3]) == bgr, "the picture %r" % (bgr,))
            seen.add(tuple(CvBridge().imgmsg_to_cv2(image, "bgr8")[40, 50].tolist()))
            self.assertEqual((image.width, image.height, image.step, image.encoding), (64, 48, 192, "bgr8"))
            self.assertEqual(image.header.frame_id, "risc1/camera")
            self.assertLess(abs((rospy.Time.now() - image.header.stamp).to_sec()), LIMIT_S)
            info = infos.wait_for(lambda m, s=image.header.stamp: m.header.stamp == s, "camera_info of the same stamp")
            self.assertEqual((info.width, info.height, info.K[0]), (64, 48, 0.0), "not calibrated")
            self.assertEqual(info.header.frame_id, "risc1/camera")
        self.assertEqual(seen, set(COLOURS))
        self.wait_for_status("folder/", 0, "OK")

    def test_2_a_calibration_is_taken_and_kept(self):
        infos = Listener("/folder/camera/camera_info", CameraInfo)
        set_camera_info = rospy.ServiceProxy("/folder/camera/set_camera_info", SetCameraInfo)
        set_camera_info.wait_for_service(LIMIT_S)
        answer = set_camera_info(calibration(64, 48, 55.0))
        self.assertTrue(answer.success, answer.status_message)
        infos.wait_for(lambda m: m.K[0] == 55.0 and m.D[0] == 0.1, "the new calibration", len(infos.messages))
        self.assertIn("folder_camera", (self.files / "calibrations" / "folder_camera.yaml").read_text())

    def test_3_a_calibration_of_another_size_is_told_once_and_not_used(self):
        write_video(self.files / "clip.avi")
        images = Listener("/video/camera/image_raw", Image)
        image = images.wait_for(lambda m: abs(m.data[0] - 200) < 15, "a blue picture of the video")
        self.assertEqual((image.width, image.height, image.header.frame_id), (80, 60, "camera"))

        answer = rospy.ServiceProxy("/video/camera/set_camera_info", SetCameraInfo)(calibration(640, 480, 600.0))
        self.assertTrue(answer.success, answer.status_message)
        infos = Listener("/video/camera/camera_info", CameraInfo)
        self.log.wait_for(lambda entry: "is not for the pictures' size" in entry.msg, "the warning")
        info = infos.wait_for(lambda m: True, "camera_info", len(infos.messages) + 20)
        self.assertEqual((info.width, info.height, info.K[0], len(info.D)), (80, 60, 0.0, 0))
        self.assertEqual(len(self.complaints("is not for the pictures' size")), 1)

    def test_4_settings_change_while_it_runs(self):
        images = Listener("/folder/camera/image_raw", Image)
        images.wait_for(lambda m: m.width == 64, "pictures of the folder")
        client = Client("/folder/uvc_cam_node", timeout=LIMIT_S)
        client.update_configuration({"frame_id": "/eye"})
        images.wait_for(lambda m: m.header.frame_id == "eye", "the new frame")
        client.update_configuration({"device": str(self.files / "clip.avi")})
        images.wait_for(lambda m: m.width == 80, "pictures of the video")
        client.update_configuration({"camera_name": "not allowed"})
        self.log.wait_for(lambda entry: "camera_name" in entry.msg and entry.level == Log.ERROR, "the refusal")
        self.assertEqual(client.get_configuration(LIMIT_S).camera_name, "folder_camera")
        images.wait_for(lambda m: True, "more pictures", len(images.messages))
        client.update_configuration({"loop": False})
        self.wait_for_status("folder/", 0, "clip.avi")
        client.update_configuration({"loop": True})
        self.wait_for_status("folder/", 0, "OK")

    def test_5_a_source_that_vanishes_is_told_and_taken_up_again(self):
        path = self.files / "clip.avi"
        os.rename(str(path), str(path) + ".away")
        self.wait_for_status("video/", 2, "clip.avi")
        os.rename(str(path) + ".away", str(path))
        self.wait_for_status("video/", 0, "OK")


if __name__ == "__main__":
    init_node("uvc_cam_test")
    rostest.rosrun("uvc_cam", "uvc_cam_test", UvcCamTest)
