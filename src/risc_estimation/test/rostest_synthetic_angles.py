#!/usr/bin/env python3
"""The node on the wire: states in, bearings out as a camera would have them, 50 ms late as its launch file says."""

import math
import threading
import time
import unittest

import rospy
import rostest

from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.testing import publishers_heard
from risc_msgs.msg import Cortex, Landmark, Landmarks, Observed_angles, States

PACKAGE = "risc_estimation"
NAME = "synthetic_angles_node"
PATIENCE_S = 60.0
DELAY_S = 0.05
RATE_HZ = 30.0  # of the pictures, as its launch file says
YAW_RATE_DEG = 4.0


class SyntheticAnglesNodeTest(unittest.TestCase):
    def setUp(self):
        init_node(NAME)
        self.kept = []
        self.arrived = threading.Condition()
        self.subscriber = rospy.Subscriber("/angles_synthetic", Observed_angles, self.keep)
        self.states = rospy.Publisher("/cortex_raw", Cortex, queue_size=1000, tcp_nodelay=True)
        self.landmarks = rospy.Publisher("/states3", Landmarks, queue_size=10)
        deadline_s = time.monotonic() + PATIENCE_S
        inputs = self.states, self.landmarks
        while not (publishers_heard(self.subscriber) and all(item.get_num_connections() for item in inputs)):
            self.assertLess(time.monotonic(), deadline_s, "the node did not connect")
            time.sleep(0.02)

    def keep(self, msg):
        with self.arrived:
            self.kept.append(msg)
            self.arrived.notify_all()

    def wait_for(self, count):
        """Wait until the bearings of `count` pictures have come."""
        with self.arrived:
            self.assertTrue(self.arrived.wait_for(lambda: len(self.kept) >= count, PATIENCE_S), len(self.kept))

    def test_bearings_are_those_of_the_moment_of_exposure(self):
        start_s = 1000.0 + math.floor(rospy.get_time())
        self.landmarks.publish(Landmarks(Obj=[Landmark("Green_pink", 2.5, 0.0, 1.0), Landmark("Pink_blue", -2, 0, 1)]))
        time.sleep(0.5)  # sent on a separate connection: it must arrive first
        for k in range(400):
            stamp_s = start_s + 0.005 * k
            fluffy = States(name="fluffy_II", visible=True, z=1.0, psi=YAW_RATE_DEG * (stamp_s - start_s))
            albatross = States(name="albatross", visible=True, x=2.0, y=0.5, z=1.0)
            message = Cortex(Obj=[fluffy, albatross])
            message.header.stamp = rospy.Time.from_sec(stamp_s)
            self.states.publish(message)
            self.wait_for(0.005 * k * RATE_HZ - 5.0)  # so that the node never falls behind and a queue drops one
        self.wait_for(59)
        messages = self.kept[5:59]
        for message in messages:
            stamp_s = message.header.stamp.to_sec()
            risc1, risc2 = message.Obj
            self.assertEqual((risc1.name, risc2.name, message.header.frame_id), ("risc1", "risc2", "cortex"))
            self.assertEqual([(a.name, a.visible) for a in risc1.landmarks], [("green", True), ("pink", False)])
            self.assertEqual([a.name for a in risc1.quads], ["risc2"])
            yaw = math.radians(YAW_RATE_DEG * (stamp_s - DELAY_S - start_s))
            # the camera is 0.21 m in front of the centre, along the nose
            right, ahead = 2.5 * -math.sin(yaw), 2.5 * math.cos(yaw) - 0.21
            self.assertAlmostEqual(risc1.landmarks[0].azim, math.degrees(math.atan2(right, ahead)), places=4)
            self.assertAlmostEqual(risc1.landmarks[0].elev, 0.0, places=6)
            self.assertFalse(any(a.visible for a in risc2.landmarks + risc2.quads), "it has no calibration")
        self.assertTrue(messages[0].Obj[0].quads[0].visible)
        self.assertLess(messages[0].Obj[0].quads[0].azim, 0.0, "it is to the left")


if __name__ == "__main__":
    rostest.rosrun(PACKAGE, NAME, SyntheticAnglesNodeTest)
