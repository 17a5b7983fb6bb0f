#!/usr/bin/env python3
"""quad_EKF.py behind states_estimation.py: markers, commands, navdata in; states, accelerations, status out."""

import sys
import time
import unittest

import numpy as np
import rospy
import rostest
from geometry_msgs.msg import PointStamped, TwistStamped
from mocap_frames import mocap_message, pack_bodies
from std_msgs.msg import Header

from ardrone_autonomy.msg import Navdata
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.templates import load_templates
from risc_lab.lab.vehicle_types import load_vehicle_type
from risc_lab.ros.fleet_messages import MocapArrays
from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.testing import Listener, publishers_heard
from risc_lab.testing import wait_for
from risc_maap_msgs.msg import BodyStatus, BodyStatuses, CommandSent, CommandsSent
from risc_msgs.msg import Cortex

TEMPLATES = load_templates()
FRAME_S = 0.005
NOISE_M = 0.001
PUBLISH_HZ = 20.0  # as in quad_ekf.test
COMMAND_CLIMB_M_S = 0.2  # of the AR.Drone, all the time: its acceleration is what is left of that
PLACES_M = {"fluffy_II": [0.1, 0.2, 1.0], "IRIS": [-1.0, 0.5, 1.5]}


class QuadEkfTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.rng = np.random.default_rng(1)
        cls.frames = rospy.Publisher("/mocap_data", MocapArrays, queue_size=1000, tcp_nodelay=True)
        cls.commands = rospy.Publisher("/commands_sent", CommandsSent, queue_size=1000, tcp_nodelay=True)
        cls.navdata = rospy.Publisher("/risc1/ardrone/navdata", Navdata, queue_size=1000, tcp_nodelay=True)
        cls.states = Listener("/cortex_ekf", Cortex)
        cls.statuses = Listener("/cortex_ekf_status", BodyStatuses)
        cls.of_raw = Listener("/cortex_raw_status", BodyStatuses)
        cls.first, cls.variances = Listener("/ekf_acc", PointStamped), Listener("/position_cov", TwistStamped)
        cls.own = Listener("/risc1/ekf_acc", PointStamped), Listener("/iris1/position_cov", TwistStamped)
        everyone = [cls.states, cls.statuses, cls.of_raw, cls.first, cls.variances, *cls.own]
        wait_for(lambda: all(publishers_heard(listener.subscriber) for listener in everyone), "both nodes publish")
        wait_for(lambda: cls.frames.get_num_connections() and cls.navdata.get_num_connections(), "both nodes listen")
        wait_for(lambda: cls.commands.get_num_connections(), "the filter listens to commands")

    def send(self, offset_m=(0.0, 0.0, 0.0), without=()):
        """Send a command, a reading and then a frame, all stamped now; return the stamp."""
        now = rospy.Time.now()
        climb = CommandSent(name="fluffy_II", sent=now, climb=COMMAND_CLIMB_M_S)
        self.commands.publish(CommandsSent(commands=[climb, CommandSent(name="IRIS", sent=now)]))
        # real readings are noisy; readings that do not change are ignored
        self.navdata.publish(
            Navdata(header=Header(stamp=now), vx=self.rng.normal(0.0, 1.0), vy=self.rng.normal(0.0, 1.0))
        )
        bodies = {
            name: np.add(PLACES_M[name], offset_m)
            + TEMPLATES[name].markers_m @ rotation_body_to_cortex(0.0, 0.0, 0.0).T
            for name in PLACES_M
            if name not in without
        }
        bodies = {
            name: markers_m + self.rng.normal(0.0, NOISE_M, markers_m.shape) for name, markers_m in bodies.items()
        }
        self.frames.publish(mocap_message(Header(stamp=now, frame_id="cortex"), *pack_bodies(bodies)))
        time.sleep(FRAME_S)
        return now

    def send_until(self, condition, what, **given):
        """Send frames until a condition holds."""

        def sent():
            self.send(**given)
            return condition()

        wait_for(sent, what)

    def is_visible(self, names=tuple(PLACES_M)):
        if not self.states.messages:
            return False
        seen = {entry.name: entry.visible for entry in self.states.messages[-1].Obj}
        return all(seen.get(name, False) for name in names)

    def status_of(self, listener, name):
        bodies = [body for message in listener.messages[-1:] for body in message.bodies if body.name == name]
        return bodies[0] if bodies else BodyStatus()

    def test_states_are_those_of_the_raw_poses_with_their_stamps(self):
        self.send_until(self.is_visible, "both vehicles are seen")
        sent = [self.send() for _ in range(50)]
        wait_for(lambda: self.states.messages[-1].header.stamp >= sent[-1], "the states of the last frame")
        message = self.states.messages[-1]
        self.assertEqual(message.header.frame_id, "cortex")
        self.assertEqual([entry.name for entry in message.Obj], list(PLACES_M))
        for entry in message.Obj:
            np.testing.assert_allclose([entry.x, entry.y, entry.z], PLACES_M[entry.name], atol=0.02)
            np.testing.assert_allclose([entry.phi, entry.theta, entry.psi], 0.0, atol=3.0)
        stamps = [m.header.stamp for m in self.states.messages]
        self.assertEqual(stamps, sorted(stamps))

    def test_acceleration_and_variances_of_each_vehicle_and_of_the_first(self):
        self.send_until(self.is_visible, "both vehicles are seen")
        self.send_until(
            lambda: all(listener.messages for listener in (self.first, self.variances, *self.own)), "all of it"
        )
        (own, iris), first = self.own, self.first.messages
        wait_for(lambda: own.messages[-1].header.stamp == first[-1].header.stamp, "the same of the first vehicle")
        self.assertEqual(own.messages[-1].point, first[-1].point)
        self.assertEqual(first[-1].header.frame_id, "cortex")
        self.send_until(lambda: len(first) >= 10, "ten of them")
        steps_s = np.diff([message.header.stamp.to_sec() for message in first])
        self.assertGreater(steps_s.min(), 0.99 / PUBLISH_HZ, "of frames that come faster only some are told")
        # the climb loop at rest: command over time constant, less what the filter has learnt
        limit_m_s2 = 1.5 * COMMAND_CLIMB_M_S / load_vehicle_type("ardrone").climb_time_constant_s
        points = np.array([(m.point.x, m.point.y, m.point.z) for m in first])
        self.assertTrue(
            (np.abs(points) < limit_m_s2 + 1.0).all(), "gravity is no acceleration of a hover: %s" % points[-1]
        )
        twist = iris.messages[-1].twist
        np.testing.assert_allclose([twist.linear.x, twist.linear.y, twist.linear.z], PLACES_M["IRIS"], atol=0.02)
        variances = np.array([twist.angular.x, twist.angular.y, twist.angular.z])
        self.assertTrue((variances > 0.0).all() and (variances < 0.01**2).all(), variances)

    def test_a_false_place_is_suspect_and_counted_and_not_shown(self):
        self.send_until(self.is_visible, "both vehicles are seen")
        self.send_until(lambda: self.status_of(self.statuses, "IRIS").status == BodyStatus.TRACKED, "it is tracked")
        before = self.status_of(self.statuses, "IRIS").positions_refused
        for _ in range(20):
            self.send(offset_m=(0.5, 0.0, 0.0))
        last = self.send()
        wait_for(lambda: self.states.messages[-1].header.stamp >= last, "the states of the last frame")
        places = [entry.x for m in self.states.messages for entry in m.Obj if entry.name == "IRIS" and entry.visible]
        self.assertLess(max(places), PLACES_M["IRIS"][0] + 0.1)
        told = [
            b for m in self.statuses.messages for b in m.bodies if b.name == "IRIS" and b.status == BodyStatus.SUSPECT
        ]
        self.assertTrue(told, "the change is told when it happens")
        self.send_until(
            lambda: self.status_of(self.statuses, "IRIS").positions_refused >= before + 20, "they are counted"
        )
        self.assertTrue(self.status_of(self.statuses, "IRIS").counted)
        self.assertFalse(self.status_of(self.of_raw, "IRIS").counted, "least squares counts nothing")

    def test_who_is_lost_is_predicted_then_invisible_and_comes_back(self):
        self.send_until(self.is_visible, "both vehicles are seen")
        begin = len(self.statuses.messages)
        self.send_until(lambda: not self.is_visible(["IRIS"]), "it is not seen any more", without=("IRIS",))
        self.assertTrue(self.is_visible(["fluffy_II"]))
        told = [body.status for m in self.statuses.messages[begin:] for body in m.bodies if body.name == "IRIS"]
        self.assertIn(BodyStatus.PREDICTED, told)
        self.send_until(self.is_visible, "and is again")

    def test_silence_makes_everybody_invisible_with_the_old_stamp(self):
        self.send_until(self.is_visible, "both vehicles are seen")
        wait_for(lambda: not any(entry.visible for entry in self.states.messages[-1].Obj), "no vehicle is visible")
        self.assertLess(self.states.messages[-1].header.stamp, rospy.Time.now() - rospy.Duration(0.5))
        wait_for(lambda: {b.status for b in self.statuses.messages[-1].bodies} == {BodyStatus.LOST}, "all are lost")


if __name__ == "__main__":
    init_node("quad_ekf_test")
    rostest.rosrun("risc_estimation", "quad_ekf", QuadEkfTest, sys.argv)
