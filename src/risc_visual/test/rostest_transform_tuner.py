#!/usr/bin/env python3
"""The tuner on the wire: a flight is seen by cameras that sit elsewhere; handles, sliders, services, file, frames."""

import math
import pathlib
import shutil
import subprocess
import threading
import time
import unittest
from dataclasses import replace
from unittest import mock

import numpy as np
import rospy
import rostest
import tf2_ros
import yaml
from dynamic_reconfigure.client import Client
from geometry_msgs.msg import Pose
from scipy.spatial.transform import Rotation
from std_srvs.srv import Trigger
from visualization_msgs.msg import (
    InteractiveMarkerFeedback,
    InteractiveMarkerInit,
    InteractiveMarkerUpdate,
    MarkerArray,
)

from risc_lab.camera import rotation_camera_to_body
from risc_lab.lab.calibration import FRONT_MOUNT, CameraMount, load_mount
from risc_lab.lab.fleet import FleetVehicle, Start
from risc_lab.ros.publisher_updates import init_node
from risc_msgs.msg import Cortex, Landmark, Landmarks, States
from risc_visual.tuner.mount_tuner import NUMBERS, MountTuner, numbers_of
from risc_visual.tuner.ros.mount_marker import numbers_from_pose, pose_of
from risc_visual.tuner.ros.transform_tuner import Sliders

PACKAGE = "risc_visual"
NAME = "transform_tuner_test"
PATIENCE_S = 100.0
RATE_HZ = 50.0
LANDMARKS = [
    Landmark("Green_pink", 2.3, 0.8, 1.5),
    Landmark("Pink_blue", 2.3, -0.8, 1.5),
    Landmark("Orange_blue", -2.3, 0.8, 1.5),
    Landmark("Blue_green", -2.3, -0.8, 1.5),
]


def flying(t_s):
    """States of a vehicle that flies about and looks at one landmark after the other."""
    x, y, z = 1.2 * math.sin(0.57 * t_s), math.cos(0.9 * t_s), 1.25 + 0.4 * math.sin(t_s)
    target = LANDMARKS[int(t_s / 5.0) % len(LANDMARKS)]
    yaw = math.degrees(math.atan2(y - target.y, target.x - x) + 0.2 * math.sin(2.3 * t_s))
    angles = {"phi": 6.0 * math.sin(1.7 * t_s), "theta": 5.0 * math.cos(1.3 * t_s), "psi": yaw}
    return States(name="fluffy_II", visible=True, x=x, y=y, z=z, **angles)


class TransformTunerTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        init_node(NAME)
        cls.folder = pathlib.Path(rospy.get_param("/files"))
        cls.folder.mkdir()
        cls.path = cls.folder / "mount.yaml"
        cls.frames = tf2_ros.Buffer()
        cls.listener = tf2_ros.TransformListener(cls.frames)
        cls.marker, cls.texts = {}, {}
        rospy.Subscriber("/transform_tuner/update", InteractiveMarkerUpdate, cls.keep_poses)
        rospy.Subscriber("/transform_tuner/text", MarkerArray, cls.keep_texts)
        cls.feedback = rospy.Publisher("/transform_tuner/feedback", InteractiveMarkerFeedback, queue_size=10)
        cls.states = rospy.Publisher("/cortex_raw", Cortex, queue_size=1000, tcp_nodelay=True)  # none is lost
        cls.landmarks = rospy.Publisher("/states3", Landmarks, queue_size=10)
        cls.sliders = Client("/transform_tuner/risc1", timeout=PATIENCE_S)
        cls.over = threading.Event()
        cls.pilot = threading.Thread(target=cls.fly)
        cls.pilot.start()

    @classmethod
    def tearDownClass(cls):
        cls.over.set()
        cls.pilot.join()
        shutil.rmtree(str(cls.folder))

    @classmethod
    def fly(cls):
        start_s, k = rospy.get_time(), 0  # stamps keep their schedule, even on a slow computer
        while not cls.over.wait(max(0.0, start_s + k / RATE_HZ - rospy.get_time())):
            message = Cortex(Obj=[flying(k / RATE_HZ), States(name="albatross", visible=True, z=1.0)])
            message.header.stamp = rospy.Time.from_sec(start_s + k / RATE_HZ)
            cls.states.publish(message)
            if k % 10 == 0:
                cls.landmarks.publish(Landmarks(Obj=LANDMARKS))
            k += 1

    @classmethod
    def keep_poses(cls, message):
        cls.marker.update({item.name: item.pose for item in message.poses})

    @classmethod
    def keep_texts(cls, message):
        cls.texts = {marker.ns: (marker.header.frame_id, marker.text) for marker in message.markers}

    def call(self, service):
        name = "/transform_tuner/" + service
        rospy.wait_for_service(name, PATIENCE_S)
        return rospy.ServiceProxy(name, Trigger)()

    def until(self, condition, what):
        deadline_s = time.monotonic() + PATIENCE_S
        while not condition():
            if time.monotonic() > deadline_s:
                self.fail("never came: %s" % (what() if callable(what) else what))
            time.sleep(0.05)

    def tf_numbers(self):
        """The mount that tf shows, as six numbers."""
        found = self.frames.lookup_transform(
            "fluffy_II_body_frame", "fluffy_II/camera", rospy.Time(0), rospy.Duration(PATIENCE_S)
        )
        place, turn = found.transform.translation, found.transform.rotation
        pose = Pose()
        pose.position.x, pose.position.y, pose.position.z = place.x, place.y, place.z
        pose.orientation = turn
        numbers = numbers_from_pose(pose)
        return [numbers[key] for key in NUMBERS]

    def shown(self):
        """The mount that frames, handles and sliders show, as six numbers each."""
        config = self.sliders.get_configuration(timeout=PATIENCE_S)
        pose = self.marker.get("risc1")
        handles = numbers_from_pose(pose) if pose else dict.fromkeys(NUMBERS, math.nan)
        return self.tf_numbers(), [handles[key] for key in NUMBERS], [config[key] for key in NUMBERS]

    def everywhere(self, mount):
        """Whether frames, handles and sliders all show a mount."""
        return all(np.allclose(numbers, numbers_of(mount), atol=1e-6) for numbers in self.shown())

    def until_everywhere(self, mount):
        self.until(
            lambda: self.everywhere(mount), lambda: "%s everywhere; it is %s" % (numbers_of(mount), self.shown())
        )

    def drag(self, mount):
        """Drag the handles to a mount, as a person does: hold them beside it until the frames follow, since the tuner
        ignores the first second of handles; then move them there. All earlier messages have arrived by then.
        """
        x_m, *rest = mount.position_m
        beside = self.handles(replace(mount, position_m=(x_m + 0.05, *rest)))
        self.until(lambda: self.follows(beside), lambda: "%s by handle; it is %s" % (beside.pose, self.tf_numbers()))
        there = self.handles(mount)
        self.feedback.publish(there)
        self.until(
            lambda: np.allclose(self.tf_numbers(), numbers_of(mount), atol=1e-6),
            lambda: "%s by handle; it is %s" % (numbers_of(mount), self.tf_numbers()),
        )

    @staticmethod
    def handles(mount):
        """Message of rviz about handles that are held at a mount."""
        message = InteractiveMarkerFeedback(client_id="a person", marker_name="risc1", pose=pose_of(mount))
        message.event_type = InteractiveMarkerFeedback.POSE_UPDATE
        return message

    def follows(self, message):
        """Send the position of the handles again. Returns whether the frames are there."""
        self.feedback.publish(message)
        wanted = numbers_from_pose(message.pose)
        return np.allclose(self.tf_numbers(), [wanted[key] for key in NUMBERS], atol=1e-6)

    def test_1_it_begins_with_the_nominal_mount_and_sends_the_frames(self):
        np.testing.assert_allclose(self.tf_numbers(), numbers_of(FRONT_MOUNT), atol=1e-9)
        self.frames.lookup_transform("cortex", "fluffy_II/camera", rospy.Time(0), rospy.Duration(PATIENCE_S))
        init = rospy.wait_for_message("/transform_tuner/update_full", InteractiveMarkerInit, PATIENCE_S)
        self.assertEqual([marker.name for marker in init.markers], ["risc1", "risc2"])
        self.assertEqual(
            [entry.title for entry in init.markers[0].menu_entries], ["Solve", "Check", "Save", "Reset", "Record"]
        )

    def test_2_handles_and_sliders_stay_in_step(self):
        self.until(self.feedback.get_num_connections, "the tuner's ear for handles")
        dragged = CameraMount((0.1, -0.05, 0.02), 0.1, -0.2, 0.3)
        self.drag(dragged)
        self.until_everywhere(dragged)
        self.sliders.update_configuration({"pitch": 20.0})
        slid = CameraMount(dragged.position_m, 0.1, math.radians(20.0), 0.3)
        self.until_everywhere(slid)
        self.sliders.update_configuration({"x": math.nan})
        self.until_everywhere(slid)
        # a late subscriber, in a process of its own: within a process, rospy shares the first subscriber's connection
        echo = ["rostopic", "echo", "-n", "1", "/tf_static"]
        late = subprocess.run(echo, capture_output=True, text=True, timeout=PATIENCE_S, check=True).stdout
        frames = {item["child_frame_id"]: item["transform"] for item in next(yaml.safe_load_all(late))["transforms"]}
        self.assertEqual(set(frames), {"fluffy_II/camera", "albatross/camera"})
        for template, mount in (("fluffy_II", slid), ("albatross", FRONT_MOUNT)):
            place = frames[template + "/camera"]["translation"]
            np.testing.assert_allclose([place[axis] for axis in "xyz"], mount.position_m, atol=1e-6)
        answer = self.call("risc1/reset")
        self.assertTrue(answer.success, answer.message)
        self.until_everywhere(FRONT_MOUNT)

    def test_3_the_menu_works(self):
        message = InteractiveMarkerFeedback(client_id="a person", marker_name="risc1", menu_entry_id=5)
        message.event_type = InteractiveMarkerFeedback.MENU_SELECT
        self.feedback.publish(message)
        self.until(lambda: "recording" in self.texts.get("risc1", ("", ""))[1], lambda: "the answer: %s" % self.texts)
        self.assertEqual(self.texts["risc1"][0], "fluffy_II_body_frame")
        self.until(lambda: "px) RMS of" in self.texts["risc1"][1], lambda: "the error: %s" % self.texts)

    def test_4_solve_finds_the_camera_and_save_writes_it(self):
        def enough():
            lines = self.texts.get("risc1", ("", ""))[1].splitlines()
            return any(
                line.startswith("window:") and int(line.split()[1]) >= 200 and int(line.split()[6]) >= 60
                for line in lines
            )

        self.until(enough, lambda: "enough bearings: %s" % (self.texts,))
        answer = self.call("risc1/check")
        self.assertFalse(answer.success, answer.message)
        before = self.tf_numbers()
        answer = self.call("risc1/solve")
        self.assertTrue(answer.success, answer.message)
        self.until(lambda: not np.allclose(self.tf_numbers(), before), "the solution on tf")
        true = load_mount("risc3_mount.yaml")
        place, angles = np.split(np.array(self.tf_numbers()), 2)
        R = rotation_camera_to_body(CameraMount(tuple(place), *np.radians(angles)))
        turn = Rotation.from_matrix(R.T @ rotation_camera_to_body(true)).magnitude()
        # three of the standard deviations that the answer gives for this short flight
        self.assertLess(math.degrees(turn), 0.5, answer.message)
        self.assertLess(np.linalg.norm(place - true.position_m), 0.025, answer.message)
        answer = self.call("risc1/check")
        self.assertTrue(answer.success, answer.message)
        self.assertIn(" px) RMS of ", answer.message)
        self.assertFalse(self.path.exists())
        answer = self.call("risc1/save")
        self.assertTrue(answer.success, answer.message)
        np.testing.assert_allclose(numbers_of(load_mount(str(self.path))), self.tf_numbers(), atol=1e-6)
        answer = self.call("risc2/save")
        self.assertFalse(answer.success)
        self.assertIn("camera_mount for risc2", answer.message)

    def test_5_the_saved_file_is_what_transforms_uses(self):
        saved = numbers_of(load_mount(str(self.path)))
        self.drag(FRONT_MOUNT)
        self.assertTrue(self.call("risc1/reset").success)
        self.until(lambda: np.allclose(self.tf_numbers(), saved, atol=1e-6), "what was saved")
        self.drag(FRONT_MOUNT)  # the tuner shows another mount again
        # it has the tuner's name, so it replaces the tuner
        with subprocess.Popen(["rosrun", "risc_control", "transforms"]) as transforms:
            try:
                self.until(
                    lambda: np.allclose(self.tf_numbers(), saved, atol=1e-6),
                    lambda: "the saved mount of `transforms`, whose exit code is %s" % transforms.poll(),
                )
            finally:
                transforms.terminate()

    def test_6_sliders_follow_later_when_the_master_does_not_answer(self):
        tuner = MountTuner(FleetVehicle("risc9", "fluffy_II", "ardrone", "127.0.0.9", Start((0.0, 0.0, 0.0))))
        moved = []
        sliders = Sliders("/sliders_of_the_test", tuner, moved.append)
        client = Client("/sliders_of_the_test", timeout=PATIENCE_S)
        tuner.change({"x": 0.5})
        with mock.patch("rospy.set_param", side_effect=ConnectionRefusedError):
            self.assertRaises(OSError, sliders.follow)
        sliders.follow()
        self.until(lambda: client.get_configuration(timeout=PATIENCE_S)["x"] == 0.5, "the slider")
        self.assertEqual(rospy.get_param("/sliders_of_the_test/x"), 0.5)
        self.assertEqual(moved, [])
        client.update_configuration({"pitch": 20.0})
        self.assertEqual(moved, [{"pitch": 20.0}])


if __name__ == "__main__":
    rostest.rosrun(PACKAGE, NAME, TransformTunerTest)
