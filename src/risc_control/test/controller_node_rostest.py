#!/usr/bin/env python3
"""The controller nodes on their topics: stamps, names, signs, silence, weights in flight."""

import contextlib
import itertools
import math
import threading
import time
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from dynamic_reconfigure.client import Client
from std_msgs.msg import Bool
from unlearnt import UNLEARNT

from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import LIMIT_S, wait_for
from risc_maap_msgs.msg import ControllerReport
from risc_msgs.msg import Controls, Cortex, States, Trajectories, Trajectory

NAMES = ("fluffy_II", "albatross")


class Lab:
    """States and references at 200 Hz, and the answers of the controllers."""

    def __init__(self):
        self.offset_m = dict.fromkeys(NAMES, (0.0, 0.0, 0.0))  # reference - actual
        self.psi_deg = 0.0
        self.visible = dict.fromkeys(NAMES, True)
        self.referenced = NAMES
        self.age_s = 0.0
        self.received = {"/controls": [], "/thesis_controls": []}
        self.sent = set()  # stamps of states
        # Long queues: in a stall of this computer only the node drops messages, as it wants the newest only.
        self._states = rospy.Publisher("/cortex_raw", Cortex, queue_size=100)
        self._references = rospy.Publisher("/trajectory", Trajectories, queue_size=100)
        self._status = [rospy.Publisher("/risc%d/controller_status" % k, Bool, queue_size=1) for k in (1, 2)]
        for topic, messages in self.received.items():
            rospy.Subscriber(topic, Controls, messages.append, queue_size=100)
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self):
        rate = rospy.Rate(200)
        try:
            while not rospy.is_shutdown():
                stamp = rospy.Time.now()
                references = Trajectories()
                references.header.stamp = stamp
                states = Cortex()
                states.header.stamp = stamp - rospy.Duration(self.age_s)
                # the order differs from the fleet's, and there is an unknown vehicle
                for name in (*reversed(NAMES), "ghost"):
                    x, y, z = self.offset_m.get(name, (0.0, 0.0, 0.0))
                    states.Obj.append(States(name=name, visible=self.visible.get(name, True), z=1.0, psi=self.psi_deg))
                    if name in self.referenced:
                        psi = self.psi_deg * 3.141592653589793 / 180.0
                        references.Obj.append(Trajectory(name=name, x=x, y=y, z=1.0 + z, psi=psi))
                self.sent.add(states.header.stamp)
                self._references.publish(references)
                self._states.publish(states)
                for publisher in self._status:
                    publisher.publish(True)
                rate.sleep()
        except rospy.ROSException:
            pass  # the end of the test


class ControllerNodeTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.lab = Lab()
        wait_for(lambda: all(cls.lab.received.values()), "both controllers answer")

    def setUp(self):
        self.lab.__dict__.update(
            offset_m=dict.fromkeys(NAMES, (0.0, 0.0, 0.0)),
            psi_deg=0.0,
            visible=dict.fromkeys(NAMES, True),
            referenced=NAMES,
            age_s=0.0,
        )
        time.sleep(0.3)

    def later(self, topic, since_s):
        """Messages of a topic stamped after a time, newest first."""
        newest_first = reversed(self.lab.received[topic])
        return list(itertools.takewhile(lambda m: m.header.stamp.to_sec() > since_s, newest_first))

    def newest(self, topic, names=NAMES, after_s=0.25):
        """{name: Control} of the newest message that commands all of these; no other vehicle may be commanded.

        Only messages stamped `after_s` from now or later count, so that changes have had their effect. A vehicle may
        miss a command while this computer stalls.
        """
        since_s = rospy.get_time() + after_s
        wait_for(lambda: len(self.later(topic, since_s)) >= 20, "20 messages on " + topic)
        wait_for(lambda: any(len(m.Obj) == len(names) for m in self.later(topic, since_s)), "all of %s" % (names,))
        found = [{control.name: control for control in m.Obj} for m in self.later(topic, since_s)]
        self.assertEqual(set(itertools.chain(*found)) - set(names), set())
        return next(controls for controls in found if len(controls) == len(names))

    @contextlib.contextmanager
    def other_states(self):
        """(answers of the node that uses /cortex_ekf, function that sends it states of all vehicles)."""
        answers, states = [], rospy.Publisher("/cortex_ekf", Cortex, queue_size=100)
        subscriber = rospy.Subscriber("/ekf_controls", Controls, answers.append, queue_size=100)

        def tell(**place_m):
            message = Cortex(Obj=[States(name=name, visible=True, z=1.0, **place_m) for name in NAMES])
            message.header.stamp = rospy.Time.now()
            states.publish(message)

        try:
            wait_for(lambda: states.get_num_connections() and subscriber.get_num_connections(), "the node is there")
            yield answers, tell
        finally:
            subscriber.unregister()

    def test_answers_states_with_their_stamps(self):
        for topic in self.lab.received:
            self.newest(topic)
            messages = list(self.lab.received[topic])
            stamps = [message.header.stamp for message in messages]
            self.assertEqual([stamp for stamp in stamps if stamp not in self.lab.sent], [], "stamps of no state")
            self.assertEqual(stamps, sorted(set(stamps)), "each answer is to a newer state")
            self.assertEqual({message.header.frame_id for message in messages}, {"cortex"})
            orders = {tuple(control.name for control in message.Obj) for message in messages}
            self.assertIn(NAMES, orders)
            self.assertLessEqual(orders, {NAMES, NAMES[:1], NAMES[1:], ()})

    def test_states_of_a_clock_that_is_set_back_are_answered(self):
        """Set back by less than the age limit. Without the rule no answer would come until the old time is reached."""
        self.newest("/controls")
        self.lab.age_s = 0.15
        received, before = self.lab.received["/controls"], len(self.lab.received["/controls"])

        def falls_back():
            stamps = [message.header.stamp for message in received[before - 1 :]]
            return any(later < earlier for earlier, later in itertools.pairwise(stamps))

        wait_for(falls_back, "an answer to a state of the new clock")

    def test_it_flies_by_the_states_that_it_is_told_and_by_no_others(self):
        """The node that uses /cortex_ekf does not answer the states on /cortex_raw, but those on its own topic."""
        with self.other_states() as (answers, tell):
            before = len(self.lab.received["/controls"])
            wait_for(lambda: len(self.lab.received["/controls"]) > before + 50, "the others answer /cortex_raw")
            self.assertEqual(answers, [])

            def answered():
                tell(x=-0.1)
                return answers and len(answers[-1].Obj) == len(NAMES) and answers[-1].Obj[0].theta > 0.02

            wait_for(answered, "forward, to where the reference is")

    def test_signs_by_name(self):
        for topic in self.lab.received:
            self.lab.psi_deg = 0.0
            self.lab.offset_m = {"fluffy_II": (0.1, 0.0, 0.0), "albatross": (0.0, 0.1, 0.0)}
            controls = self.newest(topic)
            self.assertGreater(controls["fluffy_II"].theta, 0.02, "forward")
            self.assertAlmostEqual(controls["fluffy_II"].phi, 0.0, delta=0.01)
            self.assertGreater(controls["albatross"].phi, 0.02, "left")
            # nose to the right: what was left is behind
            self.lab.psi_deg = 90.0
            controls = self.newest(topic)
            self.assertGreater(controls["fluffy_II"].phi, 0.02)
            self.assertLess(controls["albatross"].theta, -0.02)

    def test_a_vehicle_has_weights_of_its_own_and_keeps_them(self):
        self.lab.offset_m = dict.fromkeys(NAMES, (0.05, 0.0, 0.0))
        controls = self.newest("/controls")
        self.assertAlmostEqual(controls["albatross"].theta, controls["fluffy_II"].theta, delta=1e-6)
        client = Client("/thesis", timeout=LIMIT_S)
        before = client.get_configuration()["q_position"]
        for q_position, ratio in ((2.0, 2.0), (0.5, 4.0)):  # the common weight; the gain is the square root of a weight
            client.update_configuration({"q_position": q_position})
            controls = self.newest("/thesis_controls")
            self.assertAlmostEqual(controls["albatross"].theta / controls["fluffy_II"].theta, ratio, delta=0.05)
        client.update_configuration({"q_position": before})

    def test_who_is_not_seen_gets_no_command_and_the_others_fly_on(self):
        self.lab.offset_m = dict.fromkeys(NAMES, (0.1, 0.1, 0.1))
        self.lab.visible = {"fluffy_II": False, "albatross": True}
        for topic in self.lab.received:
            controls = self.newest(topic, ("albatross",))
            self.assertGreater(controls["albatross"].theta, 0.02)

    def test_who_has_no_reference_gets_no_command(self):
        """As when the trajectory node dies: silence is what the vehicle node's safety ladder acts on. A node with a
        long `reference_timeout` flies on.
        """
        self.lab.offset_m = dict.fromkeys(NAMES, (0.1, 0.1, 0.1))
        self.lab.referenced = ("albatross",)
        for topic in self.lab.received:
            controls = self.newest(topic, ("albatross",), after_s=0.6)
            self.assertGreater(controls["albatross"].theta, 0.02)
        with self.other_states() as (answers, tell):

            def answered():
                tell()
                return answers and len(answers[-1].Obj) == len(NAMES)

            wait_for(answered, "a command for one without a reference, whose age is not checked")

    def test_old_states_are_not_flown_on(self):
        self.lab.offset_m = dict.fromkeys(NAMES, (0.1, 0.1, 0.1))
        self.lab.age_s = 0.5
        for topic in self.lab.received:
            self.assertEqual(self.newest(topic, (), after_s=0.8), {})

    def test_weights_change_in_flight_and_wrong_ones_do_not(self):
        self.lab.offset_m = dict.fromkeys(NAMES, (0.05, 0.0, 0.0))
        client = Client("/full", timeout=LIMIT_S)
        before = client.get_configuration()
        self.assertEqual(before["q_position"], 200.0, "from the YAML file")
        client.update_configuration(UNLEARNT)
        strong = self.newest("/controls")["fluffy_II"].theta
        client.update_configuration({"q_position": 5.0, "q_integral": 0.0, "q_velocity": 5.0})
        weak = self.newest("/controls")["fluffy_II"].theta
        self.assertLess(weak, 0.5 * strong)
        refused = client.update_configuration({"q_position": 0.0, "q_velocity": 0.0})
        self.assertEqual(refused["q_position"], 5.0)
        client.update_configuration(
            {name: before[name] for name in ("q_position", "q_integral", "q_velocity", *UNLEARNT)}
        )

    def test_diagnostics(self):
        good = []

        def collect(message):
            good.extend(s for s in message.status if (s.name, s.message) == ("full: controller", "controlling"))

        rospy.Subscriber("/diagnostics", DiagnosticArray, collect)
        wait_for(lambda: good, "a good summary")
        values = {value.key: value.value for value in good[0].values}
        self.assertGreater(float(values["states (Hz)"]), 0.0)
        self.assertEqual(values["autonomous"], "fluffy_II, albatross")

    def test_the_report_tells_how_far_vehicles_are_from_their_references(self):
        self.lab.offset_m = {NAMES[0]: (0.3, 0.4, 0.0)}
        self.lab.referenced = NAMES[:1]
        reports = []
        rospy.Subscriber("/controller_report", ControllerReport, reports.append)

        def errors_m():
            return {item.name: item.position_error_m for report in reports[-2:] for item in report.vehicles}

        wait_for(lambda: abs(errors_m().get(NAMES[0], 0.0) - 0.5) < 1e-6, "the error of the first vehicle")
        wait_for(lambda: math.isnan(errors_m()[NAMES[1]]), "no error of one without a reference")
        wait_for(lambda: 0.0 < reports[-1].oldest_state_s < 1.0, "an age of states")


if __name__ == "__main__":
    init_node("controller_node_test")
    rostest.rosrun("risc_control", "controller_node_test", ControllerNodeTest)
