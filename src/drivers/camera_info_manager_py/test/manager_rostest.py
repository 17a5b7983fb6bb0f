#!/usr/bin/env python3
"""CameraInfoManager with a ROS master: loading, the service, two cameras in one node."""

import os
import shutil
import tempfile
import unittest

import rospy
import rostest
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import CameraInfo
from sensor_msgs.srv import SetCameraInfo

from camera_info_manager import CameraInfoError, CameraInfoManager, CameraInfoMissingError
from risc_lab.lab.calibration import read_calibration
from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.testing import publishers_heard

LIMIT_S = 60.0


def some_info(focal_px):
    return CameraInfo(
        width=640,
        height=360,
        distortion_model="plumb_bob",
        D=[0.1, 0.2, 0.3, 0.4, 0.5],
        K=[focal_px, 0, 320, 0, focal_px, 180, 0, 0, 1],
        R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=[focal_px, 0, 320, 0, 0, focal_px, 180, 0, 0, 0, 1, 0],
    )


def call(namespace, info):
    name = namespace + "/set_camera_info"
    rospy.wait_for_service(name, LIMIT_S)
    return rospy.ServiceProxy(name, SetCameraInfo)(info)


class ManagerTest(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.mkdtemp()
        self.addCleanup(shutil.rmtree, self.folder)
        self._home = os.environ.get("ROS_HOME")
        os.environ["ROS_HOME"] = self.folder
        self.addCleanup(self._restore)

    def _restore(self):
        if self._home is None:
            del os.environ["ROS_HOME"]
        else:
            os.environ["ROS_HOME"] = self._home

    def test_without_a_file_the_camera_is_not_calibrated(self):
        manager = CameraInfoManager("fresh", namespace="fresh")
        for call_too_early in (manager.getCameraInfo, manager.isCalibrated):
            with self.assertRaises(CameraInfoMissingError):
                call_too_early()
        manager.loadCameraInfo()
        self.assertFalse(manager.isCalibrated())
        self.assertEqual(manager.getCameraInfo(), CameraInfo())

    def test_the_service_uses_and_saves_and_another_manager_loads(self):
        left = CameraInfoManager("left", namespace="stereo/left")
        right = CameraInfoManager("right", url="file://%s/deep/folder/r.yaml" % self.folder, namespace="stereo/right/")
        for manager in (left, right):
            manager.loadCameraInfo()
        answer = call("stereo/left", some_info(500.0))
        self.assertTrue(answer.success, answer.status_message)
        self.assertEqual(left.getCameraInfo(), some_info(500.0))
        self.assertTrue(left.isCalibrated())
        self.assertFalse(right.isCalibrated())
        self.assertTrue(call("stereo/right", some_info(700.0)).success)
        self.assertEqual(right.getCameraInfo().K[0], 700.0)
        self.assertEqual(read_calibration(self.folder + "/camera_info/left.yaml").name, "left")
        self.assertEqual(read_calibration(self.folder + "/deep/folder/r.yaml").K[0], 700.0)
        again = CameraInfoManager("left", namespace="again")
        again.loadCameraInfo()
        self.assertEqual(again.getCameraInfo(), some_info(500.0))

    def test_changing_the_answer_does_not_change_the_calibration(self):
        manager = CameraInfoManager("copy", namespace="copy")
        call("copy", some_info(500.0))
        info = manager.getCameraInfo()
        info.width = 1
        info.header.frame_id = "elsewhere"
        self.assertEqual(manager.getCameraInfo(), some_info(500.0))

    def test_what_cannot_be_saved_is_used_and_said(self):
        manager = CameraInfoManager("stuck", url="file:///proc/no_such_folder/x.yaml", namespace="stuck")
        answer = call("stuck", some_info(400.0))
        self.assertFalse(answer.success)
        self.assertIn("/proc/no_such_folder/x.yaml", answer.status_message)
        self.assertEqual(manager.getCameraInfo().K[0], 400.0)

    def test_name_and_url_can_change(self):
        manager = CameraInfoManager("one", namespace="change")
        call("change", some_info(500.0))
        self.assertFalse(manager.setCameraName("not allowed"))
        self.assertFalse(manager.setURL("x.yaml"))
        self.assertEqual((manager.getCameraName(), manager.getURL()), ("one", ""))
        self.assertTrue(manager.isCalibrated())
        self.assertTrue(manager.setCameraName("two"))
        with self.assertRaises(CameraInfoMissingError):
            manager.getCameraInfo()
        manager.loadCameraInfo()
        self.assertFalse(manager.isCalibrated())
        self.assertTrue(manager.setURL("file://${ROS_HOME}/camera_info/one.yaml"))
        manager.loadCameraInfo()  # the name in the file differs: a warning, no more
        self.assertTrue(manager.isCalibrated())
        self.assertIn("two", str(manager))

    def test_a_malformed_file_is_one_error_and_no_calibration(self):
        path = self.folder + "/bad.yaml"
        with open(path, "w") as file:
            file.write("image_width: 640\nimage_height: 360\n")
        errors = []
        subscriber = rospy.Subscriber(
            "/rosout", Log, lambda m: errors.append(m.msg) if m.level == Log.ERROR and path in m.msg else None
        )
        self.addCleanup(subscriber.unregister)
        deadline = rospy.Time.now() + rospy.Duration(LIMIT_S)
        while not publishers_heard(subscriber) and rospy.Time.now() < deadline:
            rospy.sleep(0.02)
        manager = CameraInfoManager("bad", url="file://" + path, namespace="bad")
        manager.loadCameraInfo()
        self.assertFalse(manager.isCalibrated())
        self.assertEqual(manager.getCameraInfo(), CameraInfo())
        while not errors and rospy.Time.now() < deadline:
            rospy.sleep(0.02)
        self.assertEqual(len(errors), 1)
        self.assertIn("'camera_matrix' is missing", errors[0])

    def test_a_url_that_names_no_file(self):
        manager = CameraInfoManager("lost", url="risc1.yaml", namespace="lost")
        manager.loadCameraInfo()
        self.assertFalse(manager.isCalibrated())
        self.assertFalse(call("lost", some_info(400.0)).success)

    def test_a_name_that_is_not_allowed(self):
        with self.assertRaises(CameraInfoError):
            CameraInfoManager("front camera", namespace="bad_name")


if __name__ == "__main__":
    init_node("camera_info_manager_test")
    rostest.rosrun("camera_info_manager_py", "camera_info_manager", ManagerTest)
