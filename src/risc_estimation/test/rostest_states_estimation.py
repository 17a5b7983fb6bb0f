#!/usr/bin/env python3
"""The node on the wire: frames in, states and landmarks out; doubtful frames in, nothing unsafe out."""

import math
import os
import signal
import threading
import time
import unittest
import xmlrpc.client

import numpy as np
import rosgraph
import rospy
import rostest
from mocap_frames import mocap_message, pack_bodies
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header

from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.templates import load_templates
from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.testing import publishers_heard
from risc_maap_msgs.msg import BodyPoses, EstimatorStatus, UnidentifiedMarkers
from risc_msgs.msg import Cortex, Landmarks, Mocap_data

PACKAGE = "risc_estimation"
NAME = "states_estimation_node"
FRAME_S = 0.005
SILENCE_S = 1.5  # as in states_estimation.test: longer than a stall of this computer
PATIENCE_S = 60.0


class StatesEstimationNodeTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        init_node(NAME)
        cls.templates = load_templates()
        cls.states, cls.landmarks, cls.statuses = [], [], []
        cls.arrived = threading.Condition()
        cls.subscribers = [
            rospy.Subscriber("/cortex_raw", Cortex, cls.keep, cls.states),
            rospy.Subscriber("/states3", Landmarks, cls.keep, cls.landmarks),
            rospy.Subscriber("/estimator_status", EstimatorStatus, cls.keep, cls.statuses),
        ]
        cls.pub = rospy.Publisher("/mocap_data", Mocap_data, queue_size=1000, tcp_nodelay=True)
        cls.loose_pub = rospy.Publisher("/mocap_unidentified", UnidentifiedMarkers, queue_size=1000, tcp_nodelay=True)
        cls.sent_to_s = 100.0 + math.floor(rospy.get_time())
        cls.newest = None  # stamp
        deadline_s = time.monotonic() + PATIENCE_S
        pubs = cls.pub, cls.loose_pub
        while not (all(pub.get_num_connections() for pub in pubs) and all(map(publishers_heard, cls.subscribers))):
            if time.monotonic() > deadline_s:
                raise AssertionError("the node did not connect within %g s" % PATIENCE_S)
            time.sleep(0.02)
        while not (cls.states and cls.landmarks):  # a publisher may count a subscriber later than the subscriber does
            if time.monotonic() > deadline_s:
                raise AssertionError("nothing was estimated within %g s" % PATIENCE_S)
            cls.sent_to_s += FRAME_S
            cls.newest = rospy.Time.from_sec(cls.sent_to_s)
            bodies = {"fluffy_II": cls.templates["fluffy_II"].markers_m + [0.0, 0.0, 1.0]}
            cls.pub.publish(mocap_message(Header(stamp=cls.newest, frame_id="cortex"), *pack_bodies(bodies)))
            time.sleep(0.02)

    @classmethod
    def keep(cls, msg, kept):
        with cls.arrived:
            kept.append(msg)
            cls.arrived.notify_all()

    def setUp(self):
        """Start each test half a second of stamps later, with empty windows and no kept messages."""
        type(self).sent_to_s += 0.5
        with self.arrived:
            if self.newest is not None:  # the silence after the previous test is announced with its last stamp
                self.arrived.wait_for(
                    lambda: [msg.header.stamp for msg in self.states[-2:]] == [self.newest] * 2, PATIENCE_S
                )
            for kept in (self.states, self.landmarks, self.statuses):
                del kept[:]

    def wait_for(self, count, kept):
        with self.arrived:
            self.arrived.wait_for(lambda: len(kept) >= count, PATIENCE_S)
            return list(kept)

    def frame(self, k, **absent):
        """Bodies of frame k: one vehicle moves at 0.4 m/s and heads for 120 degrees, one rolls, a landmark stands."""
        bodies = {
            "Green_pink": self.templates["Green_pink"].markers_m + [2.0, 1.0, 1.5],
            "Raven": self.place("Raven", (0, 1, 1), math.radians(10), 0, 0),
            "fluffy_II": self.place("fluffy_II", (-1 + 0.4 * k * FRAME_S, 0, 1), 0, 0, math.radians(120)),
            "stranger": np.ones((3, 3)),
        }
        return {name: markers for name, markers in bodies.items() if not absent.get(name)}

    def place(self, name, position, phi, theta, psi):
        return self.templates[name].markers_m @ rotation_body_to_cortex(phi, theta, psi).T + position

    def send(self, stamp_s, bodies, frame_id="cortex"):
        stamp = rospy.Time.from_sec(stamp_s)
        type(self).newest = stamp if self.newest is None else max(stamp, self.newest)
        self.pub.publish(mocap_message(Header(stamp=stamp, frame_id=frame_id), *pack_bodies(bodies)))

    def send_run(self, frames, **absent):
        """Send frames at 200 Hz; return their stamps. No burst follows a stall: the node would skip frames."""
        stamps = []
        due_s = time.monotonic()
        for k in range(frames):
            stamps.append(rospy.Time.from_sec(self.sent_to_s))
            self.send(self.sent_to_s, self.frame(k, **absent))
            type(self).sent_to_s += FRAME_S
            now_s = time.monotonic()
            due_s = max(due_s + FRAME_S, now_s)
            time.sleep(due_s - now_s)
        return stamps

    def test_every_frame_is_estimated_and_keeps_its_stamp(self):
        stamps = self.send_run(400)
        states = self.wait_for(401, self.states)[:400]  # the 401st says that frames have stopped
        landmarks = self.wait_for(400, self.landmarks)
        self.assertEqual([msg.header.stamp for msg in states], stamps)
        self.assertEqual([msg.header.stamp for msg in landmarks], stamps)
        self.assertEqual({msg.header.frame_id for msg in states + landmarks}, {"cortex"})
        last = {entry.name: entry for entry in states[-1].Obj}
        self.assertEqual([entry.name for entry in states[-1].Obj], ["fluffy_II", "albatross", "Raven"])
        self.assertEqual([last[name].visible for name in ("fluffy_II", "albatross", "Raven")], [True, False, True])
        fluffy, raven = last["fluffy_II"], last["Raven"]
        np.testing.assert_allclose([fluffy.x, fluffy.y, fluffy.z], [-1 + 0.4 * 399 * FRAME_S, 0, 1], atol=1e-4)
        np.testing.assert_allclose([fluffy.u, fluffy.v, fluffy.w], [0.4, 0, 0], atol=2e-3)
        np.testing.assert_allclose([fluffy.phi, fluffy.theta, fluffy.psi, raven.phi], [0, 0, 120, 10], atol=1e-3)
        np.testing.assert_allclose([fluffy.p, fluffy.q, fluffy.r], [0, 0, 0], atol=0.05)
        self.assertEqual([entry.name for entry in landmarks[-1].Obj], ["Green_pink"])
        np.testing.assert_allclose([landmarks[-1].Obj[0].x, landmarks[-1].Obj[0].z], [2.0, 1.5], atol=1e-9)

    def test_raw_poses_are_for_whoever_listens(self):
        heard = []
        subscriber = rospy.Subscriber("/mocap_poses", BodyPoses, self.keep, heard)
        try:
            deadline_s = time.monotonic() + PATIENCE_S
            while (
                not heard and time.monotonic() < deadline_s
            ):  # the node may know of the listener later than it of the node
                self.send_run(5)
        finally:
            subscriber.unregister()
        fluffy, albatross, raven = heard[0].bodies
        self.assertEqual((heard[0].header.frame_id, fluffy.name, albatross.name), ("cortex", "fluffy_II", "albatross"))
        self.assertEqual([body.present for body in heard[0].bodies], [True, False, True])
        self.assertEqual((fluffy.stamp, albatross.stamp), (heard[0].header.stamp, rospy.Time()))
        turn = raven.pose.pose.orientation
        np.testing.assert_allclose(
            Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix(),
            rotation_body_to_cortex(math.radians(10), 0, 0),
            atol=1e-9,
        )
        covariance = np.reshape(raven.pose.covariance, (6, 6))
        self.assertGreater(np.linalg.eigvalsh(covariance).min(), 0.0)
        self.assertTrue(np.isnan(albatross.pose.covariance).all())

    def send_while_the_node_is_held_up(self, frames):
        """Stop the node's process, send frames, let it go on; return their stamps."""
        uri = rosgraph.Master(NAME).lookupNode("/Mocap_State_Estimator")
        _, _, pid = xmlrpc.client.ServerProxy(uri).getPid(NAME)
        os.kill(pid, signal.SIGSTOP)
        try:
            return self.send_run(frames)
        finally:
            os.kill(pid, signal.SIGCONT)

    def test_a_hiccup_costs_no_frame(self):
        stamps = self.send_run(40) + self.send_while_the_node_is_held_up(20)
        states = self.wait_for(60, self.states)
        self.assertEqual([msg.header.stamp for msg in states[:60]], stamps)
        self.assertAlmostEqual(states[59].Obj[0].z, 1.0, delta=1e-3)

    def test_of_a_backlog_the_newest_frames_are_estimated(self):
        """A computer that is too slow for all frames uses the newest ones."""
        stamps = self.send_while_the_node_is_held_up(150)
        with self.arrived:
            self.arrived.wait_for(lambda: self.states and self.states[-1].header.stamp == stamps[-1], PATIENCE_S)
            found = [msg.header.stamp for msg in self.states]
            last = self.states[-1].Obj[0]
        self.assertEqual(found, sorted(set(found)))
        self.assertEqual(found[-40:], stamps[-40:])
        self.assertLess(len(found), 100)
        self.assertTrue(last.visible)
        self.assertAlmostEqual(last.u, 0.4, delta=5e-3)
        self.assertGreaterEqual(self.wait_for(2, self.statuses)[-1].passed_over, 150 - len(found))

    def test_lost_vehicle_is_invisible_and_keeps_its_numbers(self):
        self.send_run(60)
        seen = self.wait_for(60, self.states)[59].Obj[0]
        self.send_run(20, fluffy_II=True)
        for msg in self.wait_for(80, self.states)[60:80]:
            gone = msg.Obj[0]
            self.assertEqual((gone.name, gone.visible), ("fluffy_II", False))
            self.assertEqual((gone.x, gone.u, gone.psi), (seen.x, seen.u, seen.psi))

    def test_stamps_that_do_not_advance_are_refused_and_reported(self):
        self.send_run(30)
        last_s = self.sent_to_s - FRAME_S
        for stamp_s in (last_s, last_s - 0.1, last_s):
            self.send(stamp_s, self.frame(0))
        self.send(self.sent_to_s, self.frame(30))
        type(self).sent_to_s += FRAME_S
        states = self.wait_for(31, self.states)
        stamps_s = [msg.header.stamp.to_sec() for msg in states[:31]]
        self.assertTrue(all(b > a for a, b in zip(stamps_s, stamps_s[1:])), stamps_s)
        deadline_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline_s:
            status = self.wait_for(1, self.statuses)[-1]
            refused = {counter.name: counter.count for counter in status.counters}
            if refused["duplicate_stamps"] >= 2 and refused["backward_stamps"] >= 1:
                break
            time.sleep(0.1)
        else:
            self.fail("the refused frames are not counted: %r" % refused)
        self.assertEqual(status.unknown_bodies, ["stranger"])
        self.assertTrue(status.markers)
        self.assertTrue(all(3 <= counted.used <= counted.known for counted in status.markers), status.markers)

    def test_markers_without_a_label_are_used(self):
        """All labels of a vehicle are lost; it is still seen, except in frames that come before their markers."""
        stamps_s = [self.sent_to_s + k * FRAME_S for k in range(80)]
        for k in range(60, 80):  # long before their frames: they come on a separate connection
            header = Header(stamp=rospy.Time.from_sec(stamps_s[k]), frame_id="cortex")
            self.loose_pub.publish(UnidentifiedMarkers(header, self.frame(k)["fluffy_II"].ravel().tolist()))
        self.send_run(60)
        for k in range(60, 80):
            self.send(stamps_s[k], self.frame(k) | {"fluffy_II": np.full((4, 3), np.nan)})
            type(self).sent_to_s = stamps_s[k] + FRAME_S
            time.sleep(FRAME_S)
        seen = [msg.Obj[0] for msg in self.wait_for(80, self.states)[60:80]]
        self.assertGreater(sum(entry.visible for entry in seen), 15)
        for k, entry in enumerate(seen, start=60):
            self.assertTrue(not entry.visible or abs(entry.x + 1 - 0.4 * k * FRAME_S) < 1e-3)

    def test_exchanged_names_are_told_apart_and_counted(self):
        self.send_run(60)
        before = {counter.name: counter.count for counter in self.wait_for(1, self.statuses)[-1].counters}
        for k in range(60, 80):
            bodies = self.frame(k)
            bodies["fluffy_II"], bodies["Raven"] = bodies["Raven"], bodies["fluffy_II"]
            self.send(self.sent_to_s, bodies)
            type(self).sent_to_s += FRAME_S
            time.sleep(FRAME_S)
        for k, msg in enumerate(self.wait_for(80, self.states)[60:80], start=60):
            last = {entry.name: entry for entry in msg.Obj}
            self.assertTrue(last["fluffy_II"].visible and last["Raven"].visible)
            self.assertAlmostEqual(last["fluffy_II"].x, -1 + 0.4 * k * FRAME_S, delta=1e-3)
        with self.arrived:
            told = self.arrived.wait_for(lambda: self.exchanges() > before["exchanges"], PATIENCE_S)
        self.assertTrue(told, "the exchange is not counted")

    def exchanges(self):
        """Number of exchanges in the newest status."""
        return max(
            (c.count for status in self.statuses[-1:] for c in status.counters if c.name == "exchanges"), default=0
        )

    def test_silence_is_announced_once_with_the_old_stamp(self):
        stamps = self.send_run(60)
        self.wait_for(61, self.states)
        time.sleep(2.0 * SILENCE_S)
        states = list(self.states)
        self.assertEqual(len(states), 61)
        self.assertEqual(states[60].header.stamp, stamps[-1])
        self.assertEqual([entry.visible for entry in states[60].Obj], [False] * len(states[60].Obj))
        self.assertEqual(states[60].Obj[0].x, states[59].Obj[0].x)

    def test_leading_slash_of_old_bags_is_not_passed_on(self):
        self.send(self.sent_to_s, self.frame(0), "/cortex")
        type(self).sent_to_s += FRAME_S
        self.assertEqual(self.wait_for(1, self.states)[0].header.frame_id, "cortex")


if __name__ == "__main__":
    rostest.rosrun(PACKAGE, NAME, StatesEstimationNodeTest)
