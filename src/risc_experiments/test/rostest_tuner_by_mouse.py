#!/usr/bin/env python3
"""The transform tuner as a person uses it: rviz on a virtual screen, a mouse on the handles and on the menu."""

import math
import pathlib
import subprocess
import tempfile
import threading
import time
import unittest

import cv2
import numpy as np
import rosgraph
import rospy
import rostest
import tf2_ros
import yaml
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import MarkerArray

from risc_control.trajectories import make_course
from risc_lab.camera import rotation_camera_to_body
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.calibration import FRONT_MOUNT, load_mount
from risc_lab.lab.yaml_reader import package_file
from risc_lab.ros.publisher_updates import init_node
from risc_msgs.msg import Cortex, Landmark, Landmarks, Observed_angles, States
from risc_visual.drawing.palette import ray_colours
from risc_visual.pictures.captions import DARK
from risc_visual.pictures.orbit_view import load_config, marker_topics, orbit_view_from_dict, picture_config, saved_view
from risc_visual.pictures.virtual_screen import VirtualScreen, missing_programs, save_picture
from risc_visual.tuner.ros.mount_marker import VIEW_M
from risc_visual.vision.landmark_config import load_landmarks

PACKAGE = "risc_experiments"
NAME = "tuner_by_mouse"
PATIENCE_S = 60.0
RATE_HZ = 50.0
FLIGHT_S = 24.0
HOVER_M = (-0.8, 0.0, 1.0)
LANDMARKS = {
    "Green_pink": (2.3, 0.8, 1.5),
    "Pink_blue": (2.3, -0.8, 1.5),
    "Orange_blue": (-3.5, 0.8, 1.5),
    "Blue_green": (-3.5, -0.8, 1.5),
}
AHEAD = ("Green_pink", "Pink_blue")  # what is seen while it hovers
SIZE = (1280, 900)
KEPT = slice(150, 700)  # rows of the pictures for the documentation
# Nearer than the configuration's view, and from where no vehicle is in front of its camera.
VIEW = {"Distance": 5.5, "Focal Point": {"X": 0.6, "Y": 0.0, "Z": 1.0}, "Yaw": 4.4}
RVIZ_HZ = 10
HANDLE_M = 0.31  # from the camera to the middle of an arrow
RING_M = 0.26  # radius of a ring
MENU = ("Solve", "Check", "Save", "Reset", "Record")
CLOSE_M, CLOSE_DEG = 0.01, 0.2
DRAWN = {"/angles": Observed_angles, "/angle_lines": MarkerArray}  # bearings, and their markers
MENU_S = 5.0  # how long it may take to open: rviz draws in software


def stamp_s_of(message):
    """Stamp [s] of a message; of an array, that of its first element."""
    return (message.header if hasattr(message, "header") else message.markers[0].header).stamp.to_sec()


class TunerByMouseTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        missing = missing_programs("rviz", "xdotool")
        if missing:
            raise unittest.SkipTest("not installed: " + ", ".join(missing))
        init_node(NAME)
        cls.frames = tf2_ros.Buffer()
        cls.listener = tf2_ros.TransformListener(cls.frames)
        cls.states = rospy.Publisher("/cortex_raw", Cortex, queue_size=10, tcp_nodelay=True)
        cls.landmarks = rospy.Publisher("/states3", Landmarks, queue_size=10)
        cls.hovering, cls.over = threading.Event(), threading.Event()
        cls.pilot = threading.Thread(target=cls.fly)
        cls.pilot.start()
        cls.addClassCleanup(cls.end_flight)
        config = load_config(package_file("risc_visual", "config/Trans_tuner.rviz"))
        current = dict(saved_view(config), **VIEW)
        cls.view = orbit_view_from_dict(current)
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        path = pathlib.Path(cls.folder.name) / "tuner.rviz"
        path.write_text(yaml.safe_dump(picture_config(config, current, SIZE, RVIZ_HZ, DARK)), encoding="utf-8")
        cls.screen = VirtualScreen(*SIZE)
        cls.addClassCleanup(cls.screen.close)
        cls.screen.start(["rviz", "--splash-screen", "", "--fullscreen", "--display-config", str(path), "__name:=rviz"])
        wanted = {*marker_topics(config), "/transform_tuner/update"}
        cls.until(lambda: wanted <= cls.heard_by_rviz(), "rviz with its displays")
        cls.until(cls.hovering.is_set, "the end of the flight")

    @classmethod
    def end_flight(cls):
        cls.over.set()
        cls.pilot.join()

    @classmethod
    def heard_by_rviz(cls):
        _, subscribers, _ = rosgraph.Master(NAME).getSystemState()
        return {topic for topic, nodes in subscribers if "/rviz" in nodes}

    @classmethod
    def fly(cls):
        """Fly a course on which the camera sees all landmarks, then hover."""
        course = make_course("slanted8", 1)
        marks = Landmarks(Obj=[Landmark(name, *place) for name, place in LANDMARKS.items()])
        start_s, k = rospy.get_time(), 0  # stamps keep their schedule, even on a slow computer
        while not cls.over.wait(max(0.0, start_s + k / RATE_HZ - rospy.get_time())):
            t_s = k / RATE_HZ
            if t_s < FLIGHT_S:
                place = course.at(t_s)[0, 0]
                state = States(name="fluffy_II", visible=True, x=place[0], y=place[1], z=place[2] + 0.2)
                state.psi = 90.0 * (1.0 - math.cos(2.0 * math.pi * t_s / FLIGHT_S)) + 15.0 * math.sin(t_s)
            else:
                state = States(name="fluffy_II", visible=True, x=HOVER_M[0], y=HOVER_M[1], z=HOVER_M[2])
                cls.hovering.set()
            message = Cortex(Obj=[state])
            message.header.stamp = marks.header.stamp = rospy.Time.from_sec(start_s + t_s)
            cls.states.publish(message)
            if k % 10 == 0:
                cls.landmarks.publish(marks)
            k += 1

    @classmethod
    def until(cls, condition, what):
        deadline_s = time.monotonic() + PATIENCE_S
        while True:
            start_s = time.thread_time()
            if condition():
                return
            cls.screen.check_programs()
            if time.monotonic() > deadline_s:
                raise AssertionError("never came: %s\n%s" % (what, cls.situation()))
            # Evaluating the picture takes time: leave more of this computer to rviz than to this loop.
            time.sleep(0.1 + 2.0 * (time.thread_time() - start_s))

    @classmethod
    def situation(cls):
        """Publishers and newest messages of what rviz draws, for the report of a time-out."""
        publishers, _, _ = rosgraph.Master(NAME).getSystemState()
        lines = ["%s: %s" % (topic, ", ".join(nodes)) for topic, nodes in publishers if topic in DRAWN]
        return "\n".join(lines + [cls.latest(*item) for item in DRAWN.items()])

    @staticmethod
    def latest(topic, kind):
        """The next message of a topic, as text."""
        try:
            message = rospy.wait_for_message(topic, kind, 5.0)
        except rospy.ROSException as error:
            return "%s: %s" % (topic, error)
        return "%s, %.3f s ago:\n%s" % (topic, rospy.get_time() - stamp_s_of(message), message)

    # -------- what tf, the text and the picture show

    @staticmethod
    def text():
        return rospy.wait_for_message("/transform_tuner/text", MarkerArray, PATIENCE_S).markers[0].text

    def mount(self):
        """(position (3,) [m], R_camera_to_body) that tf shows."""
        found = self.frames.lookup_transform(
            "fluffy_II_body_frame", "fluffy_II/camera", rospy.Time(0), rospy.Duration(PATIENCE_S)
        )
        place, turn = found.transform.translation, found.transform.rotation
        R = Rotation.from_quat((turn.x, turn.y, turn.z, turn.w)).as_matrix()
        return np.array((place.x, place.y, place.z)), R

    def is_at(self, wanted):
        """Whether tf shows this CameraMount, within CLOSE_M and CLOSE_DEG."""
        position_m, R = self.mount()
        turn = Rotation.from_matrix(R.T @ rotation_camera_to_body(wanted)).magnitude()
        return np.linalg.norm(position_m - wanted.position_m) < CLOSE_M and math.degrees(turn) < CLOSE_DEG

    def pixel_of(self, point_camera):
        """Pixel at which the view shows a point (3,) [m] in camera axes, while the vehicle hovers."""
        position_m, R = self.mount()
        point = np.add(HOVER_M, rotation_body_to_cortex(0.0, 0.0, 0.0) @ (position_m + R @ point_camera))
        return self.view.project(point, *SIZE)

    def coloured(self):
        """{landmark ahead: (height, width) bool: pixels that have the colour of its ray}."""
        picture, colours = self.screen.picture().astype(float), ray_colours(load_landmarks())
        length = np.maximum(np.linalg.norm(picture, axis=2), 1e-9)
        found = {}
        for name in AHEAD:
            rgb = np.array(colours[name]) / np.linalg.norm(colours[name])
            found[name] = (picture @ rgb > math.cos(math.radians(8.0)) * length) & (length > 60.0)
        return found

    def sees_rays(self):
        return all(mask.sum() > 300 for mask in self.coloured().values())

    def ray_shares(self):
        """{landmark: fraction of the line from the true camera position to the landmark that has its ray's colour}."""
        eye_m = np.add(HOVER_M, rotation_body_to_cortex(0.0, 0.0, 0.0) @ load_mount("risc1_mount.yaml").position_m)
        part = np.linspace(0.75, 0.9, 40)[:, None]  # its last part, where rays that miss are off the line
        shares = {}
        for name, mask in self.coloured().items():
            near = cv2.dilate(mask.astype(np.uint8), np.ones((3, 3)))
            line_m = eye_m + part * (np.array(LANDMARKS[name]) - eye_m)
            x, y = np.round(self.view.project(line_m, *SIZE)).astype(int).T
            shares[name] = near[y, x].mean()
        return shares

    def keep(self, name):
        """Save the picture of the screen if the parameter /pictures names a folder."""
        if rospy.get_param("/pictures"):
            save_picture(pathlib.Path(rospy.get_param("/pictures")) / name, self.screen.picture()[KEPT])

    # -------- the mouse

    def mouse(self, *arguments):
        command = ["xdotool", *(str(item) for item in arguments)]
        done = subprocess.run(command, env=self.screen.environment(), stdout=subprocess.PIPE, text=True, timeout=30)
        return done.stdout

    def move_to(self, pixel):
        """Move to a pixel by small moves around it: rviz looks what is under a moving mouse once a picture."""
        for aside in (3, -3, 2, 0):
            self.mouse("mousemove", *np.round(np.add(pixel, aside)).astype(int))
            time.sleep(0.3)

    def drag(self, start, way):
        """Press the left button at a pixel, move by `way` [pixels], release."""
        self.move_to(start)
        self.mouse("mousedown", 1)
        for part in np.linspace(0.1, 1.0, 10):
            self.mouse("mousemove", *np.round(start + part * way).astype(int))
            time.sleep(0.1)
        self.mouse("mouseup", 1)

    def choose(self, title, on=(VIEW_M[0], 0.0, 0.0)):
        """Right click on a part of the marker, then click on an entry of the menu that opens. on: camera axes [m]."""
        without = self.windows()
        self.until(lambda: self.opens_menu(without, on), "the menu")
        (menu,) = self.windows() - without
        lines = self.mouse("getwindowgeometry", "--shell", menu).split()
        at = {key: int(value) for key, value in (line.split("=") for line in lines)}
        entry_px = at["HEIGHT"] / len(MENU)
        self.move_to((at["X"] + 0.3 * at["WIDTH"], at["Y"] + entry_px * (MENU.index(title) + 0.5)))
        self.mouse("click", 1)
        self.until(lambda: self.windows() == without, "the end of the menu")

    def opens_menu(self, without, on):
        """Right click. Returns whether a window opens that is not in `without`."""
        if self.windows() - without:
            return True  # late
        self.move_to(self.pixel_of(on))
        self.mouse("click", 3)
        deadline_s = time.monotonic() + MENU_S
        while not self.windows() - without and time.monotonic() < deadline_s:
            time.sleep(0.1)
        return bool(self.windows() - without)

    def windows(self):
        return set(self.mouse("search", "--onlyvisible", "--name", ".*").split())

    def test_handles_and_menu(self):
        self.until(lambda: self.is_at(FRONT_MOUNT), "the nominal mount")
        self.until(self.sees_rays, "rays")
        self.assertLess(max(self.ray_shares().values()), 0.3, "the rays should miss the spheres")
        self.keep("tuner_before.png")
        middle, right = self.pixel_of((0.0, 0.0, 0.0)), self.pixel_of((0.0, HANDLE_M, 0.0))
        way = 40.0 * (right - middle) / np.linalg.norm(right - middle)
        self.drag(right, way)
        self.until(lambda: self.mount()[0][1] > 0.05, "a camera that the mouse has moved to the right")
        position_m, R = self.mount()
        np.testing.assert_allclose(position_m[[0, 2]], (0.21, 0.0), atol=1e-3)
        np.testing.assert_allclose(R, np.eye(3), atol=1e-3)
        self.choose("Reset")
        self.until(lambda: self.is_at(FRONT_MOUNT), "the nominal mount again, by the menu")
        # the ring's lower part: the vehicle's name stands before the upper one, and takes the mouse
        upper, lower = (self.pixel_of((RING_M * 0.7, 0.0, sign * RING_M * 0.7)) for sign in (-1.0, 1.0))
        self.drag(lower, 0.2 * (upper - lower))
        self.until(lambda: abs(self.mount()[1][0, 2]) > 0.05, "a camera that the mouse has turned")
        position_m, R = self.mount()
        np.testing.assert_allclose(position_m, FRONT_MOUNT.position_m, atol=1e-3)
        np.testing.assert_allclose(R[1], (0.0, 1.0, 0.0), atol=1e-3)  # about the y axis
        self.choose("Reset")
        self.until(lambda: self.is_at(FRONT_MOUNT), "the nominal mount again, by the menu")
        self.choose("Solve")
        self.until(lambda: self.is_at(load_mount("risc1_mount.yaml")), "the true mount, by the menu")
        self.until(lambda: min(self.ray_shares().values()) > 0.8, "rays that hit the spheres")
        time.sleep(1.0)  # the text follows
        self.keep("tuner_after.png")
        # the camera is inside the vehicle now: any handle has the menu, too
        self.choose("Check", on=(0.0, HANDLE_M, 0.0))
        self.until(lambda: "risc1: good: 0." in self.text(), "the answer to a check beside the camera")


if __name__ == "__main__":
    rostest.rosrun(PACKAGE, NAME, TunerByMouseTest)
