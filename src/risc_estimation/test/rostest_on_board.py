#!/usr/bin/env python3
"""states_estimation.py with a filter (on_board_members) that uses velocities from navdata and the commands sent."""

import sys
import time
import unittest

import numpy as np
import rospy
import rostest
from mocap_frames import mocap_message, pack_bodies
from std_msgs.msg import Header

from ardrone_autonomy.msg import Navdata
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.templates import load_templates
from risc_lab.ros.fleet_messages import MocapArrays
from risc_lab.ros.publisher_updates import init_node
from risc_maap_msgs.msg import CommandSent, CommandsSent, StateCovariances
from risc_msgs.msg import Cortex

PATIENCE_S = 60.0
MARKERS_M = load_templates()["fluffy_II"].markers_m


class OnBoardTest(unittest.TestCase):
    def test_what_is_measured_and_sent_reaches_the_filter_and_its_covariances_go_out(self):
        states, covariances = [], []
        subscribers = [
            rospy.Subscriber("/cortex_raw", Cortex, states.append),
            rospy.Subscriber("/state_covariances", StateCovariances, covariances.append),
        ]
        frames = rospy.Publisher("/mocap_data", MocapArrays, queue_size=10)
        navdata = rospy.Publisher("/risc1/ardrone/navdata", Navdata, queue_size=10)
        commands = rospy.Publisher("/commands_sent", CommandsSent, queue_size=10)
        markers = [0.1, 0.2, 1.0] + MARKERS_M @ rotation_body_to_cortex(0.0, 0.0, 0.0).T
        deadline = time.monotonic() + PATIENCE_S
        while not (covariances and states and states[-1].Obj and states[-1].Obj[0].u and states[-1].Obj[0].r):
            self.assertLess(time.monotonic(), deadline, "on-board data or covariances do not come")
            now = rospy.Time.now()
            navdata.publish(Navdata(header=Header(stamp=now), vx=500.0, vy=-250.0))
            command = CommandSent(name="fluffy_II", sent=now, roll_rad=0.1, pitch_rad=-0.2, yaw_rate_rad_s=0.3)
            commands.publish(CommandsSent(commands=[command]))
            frames.publish(mocap_message(Header(stamp=now, frame_id="cortex"), *pack_bodies({"fluffy_II": markers})))
            time.sleep(0.02)
        state = states[-1].Obj[0]
        np.testing.assert_allclose((state.x, state.u, state.v), (0.1, 0.5, 0.25), atol=1e-6)
        np.testing.assert_allclose(np.radians((state.p, state.q, state.r)), (0.1, -0.2, 0.3), atol=1e-6)
        (body,) = covariances[-1].bodies
        self.assertEqual(body.name, "fluffy_II")
        np.testing.assert_array_equal(np.reshape(body.covariance, (12, 12)), 0.25 * np.eye(12))
        for subscriber in subscribers:
            subscriber.unregister()


if __name__ == "__main__":
    init_node("on_board_test")
    rostest.rosrun("risc_estimation", "on_board", OnBoardTest, sys.argv)
