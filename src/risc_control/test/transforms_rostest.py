#!/usr/bin/env python3
"""The node `transforms`: frames follow the states, cameras are static, what is not seen grows stale."""

import unittest

import numpy as np
import rospy
import rostest
import tf2_ros

from risc_lab.ros.publisher_updates import init_node
from risc_msgs.msg import Cortex, States

PATIENCE_S = 60.0


class TransformsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.buffer = tf2_ros.Buffer()
        cls.listener = tf2_ros.TransformListener(cls.buffer)
        cls.publisher = rospy.Publisher("/cortex_raw", Cortex, queue_size=1)

    def send(self, *states):
        message = Cortex(Obj=states)
        message.header.stamp, message.header.frame_id = rospy.Time.now(), "cortex"
        self.publisher.publish(message)
        return message.header.stamp

    def send_until_seen(self, frame, *states):
        """Publish at 50 Hz until the frame has a transform of one of these messages; returns the transform."""
        deadline_s, first = rospy.get_time() + PATIENCE_S, None
        while rospy.get_time() < deadline_s:
            stamp = self.send(*states)
            first = first or stamp
            rospy.sleep(0.02)
            if self.buffer.can_transform("cortex", frame, rospy.Time(0)):
                found = self.buffer.lookup_transform("cortex", frame, rospy.Time(0))
                if found.header.stamp >= first:
                    return found
        raise AssertionError("no transform of %s" % frame)

    def test_a_visible_vehicle_has_frames_with_the_stamp_of_its_state(self):
        seen = States(name="fluffy_II", visible=True, x=1.0, y=-0.5, z=1.2, psi=90.0)
        found = self.send_until_seen("fluffy_II_body_frame", seen)
        place = found.transform.translation
        self.assertEqual((place.x, place.y, place.z), (1.0, -0.5, 1.2))
        patience = rospy.Duration(PATIENCE_S)
        camera = self.buffer.lookup_transform("cortex", "fluffy_II/camera", found.header.stamp, patience)
        ahead = camera.transform.translation
        np.testing.assert_allclose((ahead.x, ahead.y, ahead.z), (1.0, -0.71, 1.2), atol=1e-6)

    def test_a_lost_vehicle_grows_stale_and_an_attached_body_has_no_frames(self):
        lost = States(name="fluffy_II", visible=False, x=3.0)
        tip, load = (States(name=name, visible=True, z=1.0) for name in ("Pendulum_tip", "Load"))
        other = States(name="Raven", visible=True, z=1.0)
        self.send_until_seen("fluffy_II_body_frame", States(name="fluffy_II", visible=True, x=1.0))
        self.send_until_seen("Raven_body_frame", lost, tip, load, other)
        last = self.buffer.lookup_transform("cortex", "fluffy_II_body_frame", rospy.Time(0))
        self.assertEqual(last.transform.translation.x, 1.0)
        self.assertFalse(self.buffer.can_transform("cortex", "fluffy_II_body_frame", rospy.Time.now()))
        for name in ("Pendulum_tip", "Load"):
            self.assertFalse(self.buffer.can_transform("cortex", name + "_body_frame", rospy.Time(0)))


if __name__ == "__main__":
    init_node("transforms_test")
    rostest.rosrun("risc_control", "transforms_test", TransformsTest)
