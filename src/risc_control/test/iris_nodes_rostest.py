#!/usr/bin/env python3
"""The IRIS+ nodes of the original release on their topics: names, signs, throttle by the battery, modes, gains."""

import collections
import math
import threading
import time
import unittest

import rospy
import rostest
from dynamic_reconfigure.client import Client
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool
from unlearnt import UNLEARNT

from risc_control.vehicles.iris import hover_throttle
from risc_lab.lab import load_vehicle_type
from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import LIMIT_S, wait_for
from risc_maap_msgs.msg import TrajectoryPhases, VehiclePhase, VehicleStatus
from risc_msgs.msg import Controls, Cortex, States, Trajectories, Trajectory
from roscopter.msg import Status

NODES = ("flatness", "demo", "exp", "hold", "tuner")
EXPERIMENTS = NODES[1:]
COURSES = {
    "demo": ["origin", "slanted8", "origin", "flat8", "origin", "circle", "origin", "knot"],
    "exp": ["origin", "quadrant 1", "quadrant 2", "quadrant 3", "quadrant 4", "quadrant 1"],
}
PLACE_M = (0.1, -0.2, 1.0)  # where the vehicle stands still
BATTERY_PCT, TELEMETRY_PCT = 50.0, 90
IRIS = load_vehicle_type("iris")


class Lab:
    """An IRIS+ that stands in the air beside an AR.Drone, a reference for it, its battery; what the nodes publish."""

    def __init__(self):
        self.autonomous = False
        self.place_m, self.offset_m, self.turn_rad = PLACE_M, (0.0, 0.0, 0.0), 0.0  # reference - actual
        self.controls = collections.defaultdict(lambda: collections.deque(maxlen=4000))
        self.references, self.phases, self.courses = {}, {}, collections.defaultdict(list)
        self._states = rospy.Publisher("/cortex_raw", Cortex, queue_size=1)
        self._references = rospy.Publisher("/trajectory", Trajectories, queue_size=1)
        self._mode = rospy.Publisher("/iris1/controller_status", Bool, queue_size=1)
        self._status = rospy.Publisher("/iris1/vehicle_status", VehicleStatus, queue_size=1)
        self._telemetry = rospy.Publisher("/iris1/apm/status", Status, queue_size=1)
        self.joy = {node: rospy.Publisher("/%s/joy" % node, Joy, queue_size=10) for node in COURSES}
        for node in NODES:
            rospy.Subscriber("/%s/controls" % node, Controls, self.controls[node].append, queue_size=100)
        for node in EXPERIMENTS:
            rospy.Subscriber("/%s/trajectory" % node, Trajectories, self._on_reference, node, queue_size=100)
            rospy.Subscriber("/%s/trajectory_phase" % node, TrajectoryPhases, self._on_phases, node)
        threading.Thread(target=self._run, daemon=True).start()

    def _on_reference(self, message, node):
        self.references[node] = message

    def _on_phases(self, message, node):
        self.phases[node] = [(vehicle.name, vehicle.phase) for vehicle in message.vehicles]
        if self.courses[node][-1:] != [message.course]:
            self.courses[node].append(message.course)

    def _run(self):
        rate = rospy.Rate(100)
        try:
            while not rospy.is_shutdown():
                stamp, (x, y, z), (dx, dy, dz) = rospy.Time.now(), self.place_m, self.offset_m
                states = Cortex(Obj=[States(name="fluffy_II", visible=True, z=0.5),
                                     States(name="IRIS", visible=True, x=x, y=y, z=z)])  # fmt: skip
                reference = Trajectory(name="IRIS", x=x + dx, y=y + dy, z=z + dz, psi=self.turn_rad)
                references = Trajectories(Obj=[reference])
                states.header.stamp = references.header.stamp = stamp
                self._references.publish(references)
                self._states.publish(states)
                self._mode.publish(self.autonomous)
                self._status.publish(VehicleStatus(name="IRIS", battery_pct=BATTERY_PCT))
                self._telemetry.publish(Status(battery_remaining=TELEMETRY_PCT))
                rate.sleep()
        except rospy.ROSException:
            pass  # the end of the test

    def command(self, node, after_s=0.4):
        """The newest Control of the IRIS+ that answers a state from `after_s` from now on; no other vehicle has one."""
        since = rospy.Time.now() + rospy.Duration(after_s)
        messages = self.controls[node]
        wait_for(lambda: messages and messages[-1].header.stamp > since and messages[-1].Obj, "%s commands" % node)
        newest = next(m for m in reversed(list(messages)) if m.Obj)
        assert [control.name for control in newest.Obj] == ["IRIS"], newest
        return newest.Obj[0]

    def press(self, node, button):
        for value in (0, 1, 0):
            self.joy[node].publish(Joy(buttons=[value if k == button else 0 for k in range(11)]))
            time.sleep(0.05)


class IrisNodesTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.lab = Lab()
        wait_for(lambda: all(cls.lab.controls[node] for node in NODES), "every node commands")
        wait_for(lambda: all(joy.get_num_connections() for joy in cls.lab.joy.values()), "nodes listen to joysticks")

    def setUp(self):
        self.lab.offset_m, self.lab.turn_rad = (0.0, 0.0, 0.0), 0.0

    def test_1_on_its_reference_it_is_level_with_the_throttle_of_its_battery(self):
        hover = hover_throttle(IRIS, BATTERY_PCT)
        self.assertGreater(abs(hover - hover_throttle(IRIS, TELEMETRY_PCT)), 0.1)
        for node, pct in (("flatness", BATTERY_PCT), ("demo", BATTERY_PCT), ("hold", TELEMETRY_PCT)):
            expected = hover_throttle(IRIS, pct)
            wait_for(lambda n=node, e=expected: abs(self.lab.command(n).T - e) < 0.01, "%s: throttle" % node)
            command = self.lab.command(node)
            for fraction in (command.phi, command.theta, command.psi):
                self.assertAlmostEqual(fraction, 0.0, delta=0.01)

    def test_2_signs_are_those_of_the_sticks(self):
        def moved(field, **to):
            before = getattr(self.lab.command("flatness"), field)
            self.lab.__dict__.update(to)
            return getattr(self.lab.command("flatness"), field) - before

        self.assertLess(moved("theta", offset_m=(0.1, 0.0, 0.0)), -0.02, "forward: nose down")
        self.setUp()
        self.assertLess(moved("phi", offset_m=(0.0, 0.1, 0.0)), -0.02, "y is left")
        self.setUp()
        self.assertGreater(moved("T", offset_m=(0.0, 0.0, 0.1)), 0.02, "up")
        self.setUp()
        self.assertGreater(moved("psi", turn_rad=0.3), 0.02, "clockwise")

    def test_3_bumpers_step_through_the_modes_round_and_round(self):
        for node, courses in COURSES.items():
            told = self.lab.courses[node]
            wait_for(lambda t=told: t, "%s: a course" % node)
            for count in range(len(courses)):
                self.lab.press(node, 5)
                wait_for(lambda t=told, k=count: len(t) >= k + 2, "%s: mode %d" % (node, count + 2))
            self.assertEqual(told, [*courses, courses[0]])
            self.lab.press(node, 4)
            wait_for(lambda t=told, n=len(courses): len(t) == n + 2, "%s: back" % node)
            self.assertEqual(told[-1], courses[-1])

    def test_4_holds_where_it_is_then_above_the_origin(self):
        def reference(node):
            (entry,) = self.lab.references[node].Obj
            self.assertEqual(entry.name, "IRIS")
            return entry.x, entry.y, entry.z

        for node in EXPERIMENTS:
            wait_for(lambda n=node: n in self.lab.references, "%s has a reference" % node)
            wait_for(lambda n=node: math.dist(reference(n), PLACE_M) < 1e-6, "%s: where it is" % node)
        self.lab.autonomous = True
        for node, height_m in (("hold", 0.5), ("tuner", 1.0)):
            place_m = (0.0, 0.0, height_m)
            wait_for(lambda n=node: self.lab.phases[n] == [("IRIS", VehiclePhase.COURSE)], "%s: on its course" % node)
            wait_for(lambda n=node, p=place_m: math.dist(reference(n), p) < 1e-6, "%s: the origin" % node)

    def test_5_gains_are_tuned_in_flight(self):
        self.lab.autonomous = True
        wait_for(lambda: self.lab.phases["tuner"] == [("IRIS", VehiclePhase.COURSE)], "on its course")
        client = Client("/tuner/node", timeout=LIMIT_S)
        client.update_configuration(UNLEARNT)
        before = self.lab.command("tuner")
        self.assertGreater(before.theta, 0.01, "the origin is behind it")
        client.update_configuration({"q_position": 10.0, "q_velocity": 10.0})
        self.assertLess(self.lab.command("tuner").theta, 0.5 * before.theta)


if __name__ == "__main__":
    init_node("iris_nodes_test")
    rostest.rosrun("risc_control", "iris_nodes_test", IrisNodesTest)
