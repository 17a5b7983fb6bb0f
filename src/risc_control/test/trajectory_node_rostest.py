#!/usr/bin/env python3
"""The trajectory nodes on their topics: from hold over the course to home, bumpers, the nodes with the old names."""

import collections
import itertools
import math
import subprocess
import threading
import time
import unittest

import rospy
import rostest
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from risc_control.trajectory_manager import Phase
from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import wait_for
from risc_maap_msgs.msg import TrajectoryPhases
from risc_msgs.msg import Controls, Cortex, States, Trajectories

NODES = ("generic", "quadrants", "demo", "circle", "target", "knot", "eight")
NAMES = ("fluffy_II", "albatross")
HOVER = {"fluffy_II": (0.8, 0.1, 0.9), "albatross": (-0.9, 0.0, 1.0)}
RATE_HZ = 200.0


class Lab:
    """Two vehicles that hover where they are, and everything that the nodes publish.

    States come 50 times a second: no node here needs more, and all of them run on one computer.
    """

    def __init__(self):
        self.autonomous = False
        self.references = collections.defaultdict(lambda: collections.deque(maxlen=8000))
        self.phases = collections.defaultdict(list)
        self.courses = collections.defaultdict(list)
        self.controls = []
        self._states = rospy.Publisher("/cortex_raw", Cortex, queue_size=1)
        self._status = [rospy.Publisher("/risc%d/controller_status" % k, Bool, queue_size=1) for k in (1, 2)]
        listening = ("quadrants", "demo", "target")
        self.joy = {node: rospy.Publisher("/%s/joy" % node, Joy, queue_size=10) for node in listening}
        for node in NODES:
            rospy.Subscriber("/%s/trajectory" % node, Trajectories, self.references[node].append, queue_size=100)
            rospy.Subscriber("/%s/trajectory_phase" % node, TrajectoryPhases, self._on_phases, callback_args=node)
        rospy.Subscriber("/demo/controls", Controls, self.controls.append)
        threading.Thread(target=self._run, daemon=True).start()

    def _on_phases(self, message, node):
        self.phases[node].append({vehicle.name: Phase(vehicle.phase).name.lower() for vehicle in message.vehicles})
        if self.courses[node][-1:] != [message.course]:
            self.courses[node].append(message.course)

    def _run(self):
        rate = rospy.Rate(50)
        try:
            while not rospy.is_shutdown():
                states = Cortex()
                states.header.stamp = rospy.Time.now()
                for name, (x, y, z) in HOVER.items():
                    states.Obj.append(States(name=name, visible=True, x=x, y=y, z=z, psi=10.0))
                self._states.publish(states)
                for publisher in self._status:
                    publisher.publish(self.autonomous)
                rate.sleep()
        except rospy.ROSException:
            pass  # the end of the test

    def phase(self, node, name="fluffy_II"):
        return self.phases[node][-1].get(name) if self.phases[node] else None

    def wait_for_phase(self, node, phase, name="fluffy_II", since=None):
        """Wait until the vehicle is in the phase; with `since`, until it was in it after that many announcements."""
        if since is None:
            wait_for(lambda: self.phase(node, name) == phase, "%s: %s is in phase %s" % (node, name, phase))
        else:
            wait_for(
                lambda: any(entry.get(name) == phase for entry in self.phases[node][since:]),
                "%s: %s enters phase %s" % (node, name, phase),
            )

    def newest(self, node):
        """{name: Trajectory} of a reference made after this call: it includes all phases announced so far."""
        now, references = rospy.Time.now(), self.references[node]
        wait_for(lambda: references[-1].header.stamp > now, "%s publishes" % node)
        return {entry.name: entry for entry in references[-1].Obj}

    def press(self, node, button, age_s=None):
        """Press and release. age_s: how long ago the messages were sent, by their stamps; None: they have none."""
        for value in (0, 1, 0):
            joy = Joy(buttons=[value if k == button else 0 for k in range(11)])
            if age_s is not None:
                joy.header.stamp = rospy.Time.now() - rospy.Duration(age_s)
            self.joy[node].publish(joy)
            time.sleep(0.05)


class TrajectoryNodeTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.lab = Lab()
        wait_for(lambda: all(cls.lab.references[node] for node in NODES), "every node publishes")
        wait_for(lambda: all(joy.get_num_connections() for joy in cls.lab.joy.values()), "nodes listen to joysticks")

    def test_1_holds_where_the_vehicles_are(self):
        def holds(node):
            return all(
                math.dist((entry.x, entry.y, entry.z), HOVER[name]) < 1e-6 and entry.xdot == 0.0
                for name, entry in self.lab.newest(node).items()
            )

        for node in ("generic", "quadrants", "demo", "circle"):
            wait_for(lambda node=node: holds(node), "%s: reference where the vehicles are" % node)
            self.lab.wait_for_phase(node, "hold", "albatross")
        names = [entry.name for entry in self.lab.references["generic"][-1].Obj]
        self.assertEqual(names, list(NAMES))
        self.assertEqual([entry.name for entry in self.lab.references["demo"][-1].Obj], ["albatross"])
        self.assertEqual(self.lab.references["generic"][-1].header.frame_id, "cortex")
        self.assertAlmostEqual(self.lab.newest("generic")["fluffy_II"].psi, math.radians(10.0), places=6)

    def test_2_without_waiting_it_is_on_its_course_at_once(self):
        self.lab.wait_for_phase("knot", "course")
        self.assertGreater(abs(self.lab.newest("knot")["fluffy_II"].xdot), 0.0)

    def test_3_nobody_flies_who_could_go_home(self):
        answer = rospy.ServiceProxy("/generic/trajectory_node/go_home", Trigger)()
        self.assertFalse(answer.success)
        self.assertTrue(answer.message)

    def test_4_to_the_course_and_home(self):
        begin = rospy.get_time()
        self.lab.autonomous = True
        for name in NAMES:
            self.lab.wait_for_phase("generic", "course", name)
        on_course = rospy.get_time()
        wait_for(lambda: len(self.references_since("generic", on_course)) >= 150, "references on the course")
        messages = self.references_since("generic", begin)
        # A busy computer sends fewer; beyond the schedule there are only the few ticks that a timer catches up.
        span_s = (messages[-1].header.stamp - messages[0].header.stamp).to_sec()
        self.assertLessEqual(len(messages) - 1, RATE_HZ * span_s + 5.0, "references too often")
        for before, after in zip(messages[:-1], messages[1:]):
            step_s = (after.header.stamp - before.header.stamp).to_sec()
            self.assertGreater(step_s, 0.0)
            for first, second in zip(before.Obj, after.Obj):
                # positions and velocities match: the change of position is the velocity
                mean = 0.5 * (first.xdot + second.xdot)
                self.assertAlmostEqual(second.x - first.x, mean * step_s, delta=1e-4 + 5.0 * step_s**3)
        course = self.lab.newest("generic")
        self.assertAlmostEqual(course["fluffy_II"].psi % (2.0 * math.pi), math.radians(30.0), places=6)
        # 12 s of period instead of 10: the eight is slower
        flown = self.references_since("generic", on_course)
        speed = max(math.hypot(m.Obj[0].xdot, m.Obj[0].ydot) for m in flown)
        self.assertLess(speed, 0.62)

        answer = rospy.ServiceProxy("/generic/trajectory_node/go_home", Trigger)()
        self.assertTrue(answer.success)
        self.assertEqual(answer.message, "going home: fluffy_II, albatross")
        wait_for(lambda: set(self.lab.phases["generic"][-1].values()) == {"homed"}, "home")
        home = self.lab.newest("generic")["albatross"]
        self.assertLess(math.dist((home.x, home.y, home.z), (-0.9, 0.0, 1.0)), 1e-6)
        seen = [entry["fluffy_II"] for entry in self.lab.phases["generic"]]
        order = [phase for i, phase in enumerate(seen) if i == 0 or phase != seen[i - 1]]
        self.assertEqual(order, ["hold", "approach", "course", "home", "homed"])
        since = len(self.lab.phases["generic"])
        self.assertTrue(rospy.ServiceProxy("/generic/trajectory_node/start", Trigger)().success)
        self.lab.wait_for_phase("generic", "approach", since=since)

    def references_since(self, node, since_s):
        newest_first = reversed(list(self.lab.references[node]))
        return list(itertools.takewhile(lambda m: m.header.stamp.to_sec() > since_s, newest_first))[::-1]

    def test_5_bumpers_step_through_the_quadrants(self):
        self.lab.autonomous = True
        self.lab.wait_for_phase("quadrants", "course")
        since = len(self.lab.phases["quadrants"])
        self.lab.press("quadrants", 5)
        self.lab.wait_for_phase("quadrants", "approach", since=since)
        self.lab.wait_for_phase("quadrants", "course")
        places = [(round(e.x, 6), round(e.y, 6)) for e in self.lab.newest("quadrants").values()]
        self.assertIn((0.75, 0.75), places)
        self.assertEqual(len(set(places)), 2, "the other vehicle stands in another quadrant")
        for button, name in ((5, "quadrant 2"), (4, "quadrant 1")):
            self.lab.press("quadrants", button)
            wait_for(lambda name=name: self.lab.courses["quadrants"][-1] == name, "on to " + name)
        self.lab.press("quadrants", 5, age_s=2.0)  # delayed by a network: not obeyed, or the next leads elsewhere
        self.lab.press("quadrants", 4)
        names = ["origin", "quadrant 1", "quadrant 2", "quadrant 1", "origin"]
        wait_for(lambda: self.lab.courses["quadrants"][-1] == names[-1], "the press that is in time counts")
        self.assertEqual(self.lab.courses["quadrants"], names)

    def test_6_demo_is_controller_and_trajectory_in_one(self):
        self.lab.autonomous = True
        self.lab.wait_for_phase("demo", "course", "albatross")
        since, begin = len(self.lab.phases["demo"]), len(self.lab.controls)
        self.lab.press("demo", 5)
        self.lab.wait_for_phase("demo", "approach", "albatross", since)  # to the slanted eight
        wait_for(lambda: self.lab.courses["demo"] == ["origin", "slanted8"], "the names of the courses")
        # the vehicle of this test does not move: the reference is ahead of it, and the command follows
        wait_for(
            lambda: any(abs(c.theta) > 0.05 for m in self.lab.controls[begin:] for c in m.Obj), "a command to follow"
        )
        names = {tuple(control.name for control in message.Obj) for message in self.lab.controls}
        self.assertLessEqual(names, {("albatross",), ()})  # none while a stall makes the states too old

    def test_7_an_old_name_flies_its_course(self):
        self.lab.autonomous = True
        self.lab.wait_for_phase("circle", "course")
        entry = self.lab.newest("circle")["fluffy_II"]
        self.assertAlmostEqual(math.hypot(entry.x, entry.y), 0.7, places=6)
        self.assertAlmostEqual(math.hypot(entry.xdot, entry.ydot), 0.7 * 2.0 * math.pi / 5.0, places=6)

    def test_8_a_button_lets_the_target_go(self):
        self.lab.autonomous = True
        self.lab.wait_for_phase("target", "course")
        self.lab.press("target", 1, age_s=2.0)  # delayed by a network
        stamp = rospy.Time.now()
        wait_for(lambda: self.lab.references["target"][-1].header.stamp > stamp + rospy.Duration(0.5), "references")
        self.assertEqual(self.lab.courses["target"], ["WP"])
        self.lab.press("target", 1)
        wait_for(lambda: self.lab.courses["target"] == ["WP", "NGC"], "the target is let go")
        wait_for(lambda: math.hypot(*self.target_velocity()) > 0.1, "the target runs")
        self.assertAlmostEqual(math.hypot(*self.target_velocity()), 0.2, places=3)

    def test_9_through_waypoints_at_a_speed(self):
        self.lab.wait_for_phase("eight", "course")
        self.assertEqual(self.lab.courses["eight"], ["through points"])
        wait_for(lambda: len(self.lab.references["eight"]) > 400, "a round of references")  # in 7 s, 50 a second
        flown = [entry for message in list(self.lab.references["eight"]) for entry in message.Obj]
        speeds = [math.hypot(entry.xdot, entry.ydot) for entry in flown]
        self.assertAlmostEqual(max(speeds), 0.9, places=3)
        self.assertGreater(max(entry.psi for entry in flown), math.radians(19.0))

    def test_a_course_that_cannot_be_flown_ends_its_node_with_one_line(self):
        command = ["rosrun", "risc_control", "generic_trajectory.py", "_course:=flat8", "_course_speed:=4.0"]
        done = subprocess.run([*command, "__name:=too_fast"], capture_output=True, text=True, timeout=120)
        self.assertNotEqual(done.returncode, 0)
        told = [line for line in (done.stdout + done.stderr).splitlines() if "'flat8'" in line]
        self.assertEqual(["--speed" in line for line in told], [True], told)
        self.assertNotIn("Traceback", done.stdout + done.stderr)

    def target_velocity(self):
        entry = self.lab.newest("target")["fluffy_II"]
        return entry.xdot, entry.ydot


if __name__ == "__main__":
    init_node("trajectory_node_test")
    rostest.rosrun("risc_control", "trajectory_node_test", TrajectoryNodeTest)
