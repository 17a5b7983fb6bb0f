#!/usr/bin/env python3
"""Lag_compensator.py on its topics: current states and commands in, predicted states out."""

import sys
import unittest

import numpy as np
import rospy
import rostest

from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.sender import sender
from risc_lab.ros.testing import Listener, publishers_heard
from risc_lab.testing import wait_for
from risc_maap_msgs.msg import CommandSent, CommandsSent
from risc_msgs.msg import Cortex, States

NAMES = ("fluffy_II", "albatross")


class LagCompensatorTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.states = rospy.Publisher("/cortex_raw", Cortex, queue_size=100, tcp_nodelay=True)
        cls.commands = rospy.Publisher("/commands_sent", CommandsSent, queue_size=100, tcp_nodelay=True)
        cls.estimates = Listener("/cortex_estimate", Cortex)
        wait_for(lambda: publishers_heard(cls.estimates.subscriber), "the node publishes")
        wait_for(lambda: cls.states.get_num_connections() and cls.commands.get_num_connections(), "it listens")

    def answer(self, fits, what, age_s=0.0):
        """The first answer that fits, to states of two vehicles of which the first is told to climb."""
        begin, found = len(self.estimates.messages), []

        def answered():
            now = rospy.Time.now()
            self.commands.publish(CommandsSent(commands=[CommandSent(name=NAMES[0], sent=now, climb=0.5)]))
            moving = {"visible": True, "x": 0.5, "y": -0.5, "z": 1.0, "v": 1.0, "psi": 120.0}
            message = Cortex(Obj=[States(name=name, **moving) for name in reversed(NAMES)])
            message.header.stamp, message.header.frame_id = now - rospy.Duration(age_s), "cortex"
            self.states.publish(message)
            found[:] = [message for message in self.estimates.messages[begin:] if fits(message)]
            return found

        wait_for(answered, what)
        return found[0]

    def test_a_vehicle_is_ahead_along_its_way_and_by_its_commands(self):
        answer = self.answer(lambda m: m.Obj[0].w > 0.1, "it climbs, in what is to come")
        self.assertEqual([entry.name for entry in answer.Obj], list(NAMES))
        self.assertEqual((answer.header.frame_id, answer.Obj[0].visible), ("cortex", True))
        ahead = answer.Obj[0]
        self.assertGreater(ahead.z, 1.0)
        self.assertTrue(0.05 < ahead.y + 0.5 < 0.4, "0.13 s and more at 1 m/s, found %r" % ahead.y)
        self.assertAlmostEqual(ahead.psi, 120.0, delta=1.0)
        other = answer.Obj[1]
        np.testing.assert_allclose((other.x, other.y, other.z, other.v, other.psi), (0.5, -0.5, 1.0, 1.0, 120.0))

    def test_states_that_are_too_old_show_nobody(self):
        answer = self.answer(lambda m: not m.Obj[0].visible, "no vehicle is visible", age_s=1.0)
        self.assertFalse(answer.Obj[1].visible)

    def test_a_message_says_which_node_sent_it(self):
        """`sender` works for any node; it may fail when rospy moves where it keeps the name."""
        self.assertEqual(sender(self.answer(lambda m: True, "an answer")), "/Compensator")


if __name__ == "__main__":
    init_node("lag_compensator_test")
    rostest.rosrun("risc_control", "lag_compensator", LagCompensatorTest, sys.argv)
