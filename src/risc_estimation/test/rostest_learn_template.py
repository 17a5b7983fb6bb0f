#!/usr/bin/env python3
"""learn_template.py beside a motion capture that shows an object at rest, one that moves, and others.

It runs once as a program; otherwise its main is called in this process, a node of the same name.
"""

import contextlib
import importlib.util
import io
import math
import pathlib
import subprocess
import sys
import tempfile
import threading
import unittest

import numpy as np
import roslib.packages
import rospy
import rostest
from mocap_frames import mocap_message, pack_bodies
from std_msgs.msg import Header

from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.templates import load_templates
from risc_lab.ros.fleet_messages import MocapArrays
from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import LIMIT_S

FRAME_S = 0.005
PSI_DEG, CENTRE_M = 30.0, (0.5, -0.25, 0.05)
HULL = load_templates()["fluffy_II"]
STANDING_M = CENTRE_M + HULL.markers_m @ rotation_body_to_cortex(0.0, 0.0, math.radians(PSI_DEG)).T


PROGRAM = pathlib.Path(__file__).resolve().parents[1] / "nodes/learn_template.py"


def run(*arguments):
    """(exit code, stdout, stderr) of the program."""
    program = roslib.packages.find_node("risc_estimation", PROGRAM.name)[0]
    done = subprocess.run([program, *arguments], capture_output=True, text=True, timeout=2.0 * LIMIT_S, check=False)
    return done.returncode, done.stdout, done.stderr


def call(*arguments):
    """As `run`, by calling its main in this process."""
    spec = importlib.util.spec_from_file_location(PROGRAM.stem, PROGRAM)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as said:
        code = module.main([PROGRAM.name, *arguments])
    return code, out.getvalue(), said.getvalue()


class LearnTemplateTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.publisher = rospy.Publisher("/mocap_data", MocapArrays, queue_size=100, tcp_nodelay=True)
        cls.folder = pathlib.Path(tempfile.mkdtemp())
        threading.Thread(target=cls.show, daemon=True).start()

    @classmethod
    def show(cls):
        rng, k, rate = np.random.default_rng(1), 0, rospy.Rate(1.0 / FRAME_S)
        while not rospy.is_shutdown():
            k += 1  # stamps advance evenly, however slow this computer is
            moving_m = STANDING_M + [0.002 * k, 0.0, 0.0]
            bodies = {"other": STANDING_M[:2] + 1.0, "Heron": STANDING_M, "walker": moving_m}
            bodies = {name: markers_m + rng.normal(0.0, 0.001, markers_m.shape) for name, markers_m in bodies.items()}
            stamp = rospy.Time.from_sec(100.0 + FRAME_S * k)
            try:
                cls.publisher.publish(mocap_message(Header(stamp=stamp, frame_id="cortex"), *pack_bodies(bodies)))
                rate.sleep()
            except rospy.ROSException:
                return  # the end of the test

    def test_a_vehicle_that_stands_is_learnt_with_its_origin_and_axes(self):
        path = self.folder / "heron.yaml"
        where = ["--origin", *map(str, CENTRE_M), "--nose", str(PSI_DEG)]
        code, _, said = run("Heron", "--seconds", "1", "--out", str(path), *where)
        self.assertEqual(code, 0, said)
        learnt = load_templates(path)["Heron"]
        self.assertEqual((learnt.kind, len(learnt.marker_names)), ("vehicle", 4))
        np.testing.assert_allclose(learnt.markers_m, HULL.markers_m, atol=1e-3)
        self.assertIn("like fluffy_II", said)
        self.assertIn("while marker_4 is hidden", said)
        code, _, said = call("Heron", "--seconds", "1", "--out", str(path))
        self.assertEqual(code, 1, "a file is not overwritten")

    def test_a_landmark_goes_to_stdout_about_its_middle(self):
        code, text, said = call("Heron", "--seconds", "1", "--kind", "landmark")
        self.assertEqual(code, 0, said)
        path = self.folder / "landmark.yaml"
        path.write_text(text)
        learnt = load_templates(path)["Heron"]
        self.assertEqual(learnt.kind, "landmark")
        np.testing.assert_allclose(learnt.markers_m, STANDING_M - STANDING_M.mean(axis=0), atol=1e-3)

    def test_what_moves_or_is_not_there_is_not_learnt(self):
        for name, cause in (("walker", "moved"), ("Herron", "Heron"), ("other", "off one line")):
            code, text, said = call(name, "--seconds", "1")
            self.assertEqual((code, text), (1, ""), said)
            self.assertIn(cause, said)


if __name__ == "__main__":
    init_node("learn_template", anonymous=True)  # same arguments as in the program, whose main calls it again
    rostest.rosrun("risc_estimation", "learn_template", LearnTemplateTest, sys.argv)
