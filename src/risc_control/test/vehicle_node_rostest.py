#!/usr/bin/env python3
"""The vehicle node on its topics: names, take-off and landing, command mapping, loss ladder, shutdown."""

import collections
import threading
import time
import unittest

import rosgraph
import rospy
import rostest
from geometry_msgs.msg import Twist, TwistStamped
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Empty, String

from ardrone_autonomy.msg import Navdata
from risc_control.vehicle_node import VehicleNode
from risc_msgs.msg import Control, Controls, Cortex, States

TEMPLATES = {"risc1": "fluffy_II", "risc2": "albatross", "risc3": "condor"}
JOY_TO_WAY, EMERGENCY, SHUT_DOWN, TAKEOFF_LAND = 0, 2, 7, 6
LANDED, FLYING = 2, 3
HOVER_N = 0.45 * 9.80665
TIMEOUT_S = 15.0
PUBLISHED = {
    "cmd_vel": Twist,
    "cmd_vel_stamped": TwistStamped,
    "ardrone/takeoff": Empty,
    "ardrone/land": Empty,
    "ardrone/reset": Empty,
    "controller_status": Bool,
    "safety": String,
}


def wait_for(condition, what):
    deadline = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < deadline, "not within %g s: %s" % (TIMEOUT_S, what)
        time.sleep(0.005)


class World:
    """Everything around the nodes: states and controls at 200 Hz, navdata at 50 Hz; records what the nodes publish."""

    def __init__(self):
        self.flight_state = dict.fromkeys(TEMPLATES, LANDED)
        self.controls = dict.fromkeys(TEMPLATES, (0.0, 0.0, 0.0, HOVER_N))
        self.visible = dict.fromkeys(TEMPLATES, True)
        self.running = True
        self._ended = False
        self.received = collections.defaultdict(list)  # (vehicle, topic): [(monotonic time, message)]
        self._subscribers = []
        for vehicle in TEMPLATES:
            for topic, kind in PUBLISHED.items():
                key = (vehicle, topic)
                self._subscribers.append(
                    rospy.Subscriber(
                        "/%s/%s" % key, kind, lambda m, key=key: self.received[key].append((time.monotonic(), m))
                    )
                )
        self._states = rospy.Publisher("/cortex_raw", Cortex, queue_size=1)
        self._controls = rospy.Publisher("/controls", Controls, queue_size=1)
        self._navdata = {v: rospy.Publisher("/%s/ardrone/navdata" % v, Navdata, queue_size=1) for v in TEMPLATES}
        self._joy = {v: rospy.Publisher("/%s/joy" % v, Joy, queue_size=10) for v in TEMPLATES}
        wait_for(lambda: all(s.get_num_connections() for s in self._subscribers), "all topics of the nodes")
        wait_for(lambda: all(p.get_num_connections() for p in (*self._navdata.values(), *self._joy.values())), "inputs")
        wait_for(lambda: self._states.get_num_connections() == 3 == self._controls.get_num_connections(), "inputs")
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        rate = rospy.Rate(200)
        step = 0
        while not self._ended:
            stamp = rospy.Time.now()
            if self.running:
                states, controls = Cortex(), Controls()
                states.header.stamp = controls.header.stamp = stamp
                for vehicle, template in reversed(list(TEMPLATES.items())):  # by name, not by index (D-27)
                    states.Obj.append(States(name=template, visible=self.visible[vehicle], z=1.0))
                    controls.Obj.append(Control(template, *self.controls[vehicle]))
                self._states.publish(states)
                self._controls.publish(controls)
            if step % 4 == 0:
                for vehicle, publisher in self._navdata.items():
                    publisher.publish(Navdata(state=self.flight_state[vehicle], batteryPercent=80.0))
            step += 1
            rate.sleep()

    def end(self):
        self._ended = True
        self._thread.join()

    def press(self, vehicle, button):
        for down in (button, None):
            self._joy[vehicle].publish(Joy(axes=[0.0] * 8, buttons=[1 if k == down else 0 for k in range(11)]))

    def messages(self, vehicle, topic):
        return [message for _, message in self.received[vehicle, topic]]

    def forget(self):
        for received in self.received.values():
            del received[:]

    def wait(self, vehicle, topic, fits=lambda message: True):
        wait_for(lambda: any(map(fits, self.messages(vehicle, topic))), "%s of %s" % (topic, vehicle))

    def fly(self, autonomous):
        """Be in the air, in this mode."""
        self.running = True
        for vehicle in TEMPLATES:
            self.flight_state[vehicle] = FLYING
        time.sleep(0.3)
        self.forget()
        for vehicle in TEMPLATES:
            wait_for(lambda v=vehicle: self.received[v, "controller_status"], "controller_status")
            if self.messages(vehicle, "controller_status")[-1].data != autonomous:
                self.press(vehicle, JOY_TO_WAY)
                self.wait(vehicle, "controller_status", lambda m: m.data == autonomous)


def same(twist, x, y, z, yaw):
    wanted, found = (x, y, z, yaw), (twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.z)
    return all(abs(a - b) < 0.01 for a, b in zip(wanted, found))


class VehicleNodeTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.world = World()

    @classmethod
    def tearDownClass(cls):
        cls.world.end()

    def tearDown(self):
        for vehicle in TEMPLATES:
            self.world.flight_state[vehicle] = LANDED
        self.world.running = True
        time.sleep(0.2)

    def test_1_names(self):
        published, subscribed, _ = rosgraph.Master("/vehicle_node_test").getSystemState()
        names = {topic for topic, _ in published + subscribed}
        for vehicle in TEMPLATES:
            for topic in (*PUBLISHED, "joy", "ardrone/navdata"):
                self.assertIn("/%s/%s" % (vehicle, topic), names)
        doubled = [name for name in names if name.startswith(("/risc3/risc3", "/cmd_vel", "/ardrone", "/joy"))]
        self.assertEqual(doubled, [])

    def test_2_takeoff_landing_and_emergency(self):
        world = self.world
        world.wait("risc1", "controller_status", lambda m: not m.data)
        time.sleep(0.2)
        for vehicle in TEMPLATES:
            world.forget()
            world.press(vehicle, TAKEOFF_LAND)
            world.wait(vehicle, "ardrone/takeoff")
            self.assertEqual(world.messages(vehicle, "ardrone/land"), [])
            world.flight_state[vehicle] = FLYING
            time.sleep(0.2)
            world.press(vehicle, TAKEOFF_LAND)
            world.wait(vehicle, "ardrone/land")
            world.press(vehicle, EMERGENCY)
            world.wait(vehicle, "ardrone/reset")
            self.assertEqual(len(world.messages(vehicle, "ardrone/takeoff")), 1)
            others = [v for v in TEMPLATES if v != vehicle]
            self.assertEqual([world.messages(v, "ardrone/takeoff") for v in others], [[], []])

    def test_3_each_vehicle_flies_its_own_command(self):
        world = self.world
        world.controls = {
            "risc1": (0.1, 0.2, -0.3, HOVER_N),  # left, forward, clockwise
            "risc2": (-0.4, -0.5, 0.6, HOVER_N + 0.45),  # right, back, counter-clockwise, up by 1 m/s^2
            "risc3": (5.0, 0.0, 0.0, 0.0),
        }
        world.fly(autonomous=True)
        for vehicle, expected in (
            ("risc1", (0.2, 0.1, 0.0, -0.3)),
            ("risc2", (-0.5, -0.4, 0.3, 0.6)),
            ("risc3", (0.0, 1.0, -1.0, 0.0)),
        ):
            # From rest each climb command is 0.3 s x acceleration; later ones contain the predicted climb rate.
            world.wait(vehicle, "cmd_vel", lambda m, e=expected: same(m, *e))
            twist = world.messages(vehicle, "cmd_vel")[-1]
            self.assertTrue(same(twist, expected[0], expected[1], twist.linear.z, expected[3]), twist)
        world.forget()
        time.sleep(3.0)
        now_s = rospy.get_time()
        for vehicle in TEMPLATES:
            stamped = world.messages(vehicle, "cmd_vel_stamped")
            self.assertTrue(84 <= len(stamped) <= 96, "%d commands in 3 s" % len(stamped))
            self.assertTrue(all(now_s - 5.0 < m.header.stamp.to_sec() <= now_s for m in stamped))
            self.assertEqual(len({m.header.stamp for m in stamped}), len(stamped))
            pairs = zip(stamped, world.messages(vehicle, "cmd_vel"))
            self.assertTrue(all(m.twist == twist for m, twist in pairs))
        wait_for(lambda: rospy.get_param("/controller_status", None) is True, "the parameter controller_status")

    def test_4_loss_of_states_holds_then_lands(self):
        world = self.world
        world.controls = dict.fromkeys(TEMPLATES, (0.2, 0.2, 0.2, HOVER_N))
        world.fly(autonomous=True)
        time.sleep(0.3)
        world.forget()
        world.running = False
        lost_s = time.monotonic()
        world.wait("risc1", "safety", lambda m: m.data.startswith("land: "))
        landed_s = time.monotonic()
        self.assertGreater(landed_s - lost_s, 0.45)
        self.assertLess(landed_s - lost_s, 1.5)
        for vehicle in TEMPLATES:
            world.wait(vehicle, "ardrone/land")
            zero_s = next(t for t, m in world.received[vehicle, "cmd_vel"] if same(m, 0, 0, 0, 0))
            self.assertGreater(zero_s - lost_s, 0.08)
            self.assertLess(zero_s - lost_s, 0.45)
            land_s = world.received[vehicle, "ardrone/land"][0][0]
            self.assertGreater(land_s - lost_s, 0.45)
            later = [m for t, m in world.received[vehicle, "cmd_vel"] if t > zero_s]
            self.assertTrue(later)
            self.assertTrue(all(same(m, 0, 0, 0, 0) for m in later))
            texts = [m.data.split(":")[0] for m in world.messages(vehicle, "safety")]
            self.assertEqual(texts, ["hold", "land"])
        time.sleep(1.0)
        self.assertGreaterEqual(len(world.messages("risc1", "ardrone/land")), 4, "ordered again and again")
        world.running = True
        world.flight_state["risc1"] = LANDED
        world.wait("risc1", "safety", lambda m: m.data == "ok")
        world.wait("risc1", "controller_status", lambda m: not m.data)
        world.forget()
        time.sleep(0.5)
        self.assertEqual(world.messages("risc1", "ardrone/land"), [])
        self.assertTrue(world.messages("risc2", "ardrone/land"), "states are back, but risc2 has not landed yet")

    def test_5_only_the_lost_vehicle_holds_and_recovers(self):
        world = self.world
        world.controls = dict.fromkeys(TEMPLATES, (0.2, 0.2, 0.2, HOVER_N))
        world.fly(autonomous=True)
        time.sleep(0.3)
        world.forget()
        world.visible["risc2"] = False
        world.wait("risc2", "safety", lambda m: m.data.startswith("hold: state"))
        world.visible["risc2"] = True
        world.wait("risc2", "safety", lambda m: m.data == "ok")
        world.forget()
        world.wait("risc2", "cmd_vel", lambda m: same(m, 0.2, 0.2, m.linear.z, 0.2))
        for vehicle in ("risc1", "risc3"):
            self.assertEqual(world.messages(vehicle, "safety"), [])

    def test_6_errors_land_and_do_not_stop_the_clock(self):
        """A node in this process whose pilot is broken, as by an error that nobody has thought of."""
        rospy.set_param("~vehicle", "condor")
        node = VehicleNode("risc4")
        landings, statuses = [], []
        rospy.Subscriber("/risc4/ardrone/land", Empty, landings.append)
        rospy.Subscriber("/risc4/controller_status", Bool, statuses.append)
        wait_for(lambda: statuses, "controller_status")
        pilot, good = node._pilot, node._pilot.tick

        def broken(_now_s):
            raise ZeroDivisionError("as if")

        pilot.tick = broken
        time.sleep(0.5)
        self.assertEqual(landings, [], "in manual mode the operator decides")
        self.assertGreater(node._counts["errors"], 10)
        pilot.autonomous = True
        wait_for(lambda: len(landings) >= 3, "landing, again and again")
        pilot.tick = good
        del statuses[:]
        wait_for(lambda: statuses, "the timer goes on")
        time.sleep(0.3)
        del landings[:]
        time.sleep(0.5)
        self.assertEqual(landings, [])
        pilot.on_controls = lambda *_: 1 / 0
        wait_for(lambda: landings, "landing when commands cannot be worked out")
        pilot.autonomous = False

    def test_7_shut_down_button_lands_and_ends_the_node(self):
        world = self.world
        world.controls = dict.fromkeys(TEMPLATES, (0.2, 0.2, 0.2, HOVER_N))
        world.fly(autonomous=True)
        world.forget()
        world.press("risc2", SHUT_DOWN)
        world.wait("risc2", "ardrone/land")
        master = rosgraph.Master("/vehicle_node_test")

        def gone():
            return "/second" not in [node for _, nodes in master.getSystemState()[0] for node in nodes]

        wait_for(gone, "the end of the node")
        self.assertTrue(same(world.messages("risc2", "cmd_vel")[-1], 0, 0, 0, 0))


if __name__ == "__main__":
    rospy.init_node("vehicle_node_test")
    rostest.rosrun("risc_control", "vehicle_node_test", VehicleNodeTest)
