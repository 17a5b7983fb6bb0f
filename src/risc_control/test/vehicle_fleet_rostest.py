#!/usr/bin/env python3
"""One vehicle node for several vehicles: each has its own trouble, its own commands, perhaps its own controller."""

import math
import os
import signal
import unittest
import xmlrpc.client

import rosgraph
import rospy
import rostest
from genpy import DeserializationError
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import Joy
from vehicle_world import (
    EMERGENCY,
    FLYING,
    HOVER_N,
    LANDED,
    SHUT_DOWN,
    World,
    is_flown,
    is_zero,
    same,
    twist_of,
)

from risc_control.safety import SafetyLimits
from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.raw_messages import raw_class
from risc_lab.testing import wait_for
from risc_maap_msgs.msg import Safety
from risc_msgs.msg import Controls
from roscopter.msg import State

TEMPLATES = {"risc1": "fluffy_II", "risc2": "albatross", "risc3": "condor"}
NAME = "/vehicle_fleet_test"
OTHERS = ("risc1", "risc3")  # than the vehicle that is in trouble


def tenth(stamp):
    """Number of the tenth of a second in which a stamp lies."""
    return stamp.to_nsec() // 10**8


class VehicleFleetTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.logs = []
        cls.rosout = rospy.Subscriber("/rosout", Log, lambda message: cls.logs.append(message.msg))
        cls.world = World(TEMPLATES, nodes=2, flown=("risc1", "risc2"))
        cls.sent, cls.torn = {template: set() for template in TEMPLATES.values()}, False
        cls.controls = rospy.Subscriber("/controls", raw_class(Controls), cls.on_controls)
        cls.y_m = dict(cls.world.y_m)

    @classmethod
    def tearDownClass(cls):
        cls.world.end()

    def tearDown(self):
        rospy.set_param("/second_controller/torn", False)
        self.world.controls = dict.fromkeys(TEMPLATES, (0.0, 0.0, 0.0, HOVER_N))
        self.world.visible = dict.fromkeys(TEMPLATES, True)
        self.world.y_m, self.world.strays, self.world.passers = dict(self.y_m), set(), {}
        self.world.flight_state = dict.fromkeys(TEMPLATES, LANDED)

    @classmethod
    def on_controls(cls, message):
        """Record when the controllers send, and whether a truncated message came."""
        try:
            controls = Controls().deserialize(message.raw)
        except DeserializationError:
            cls.torn = True
            return
        for control in controls.Obj:
            cls.sent[control.name].add(tenth(controls.header.stamp))

    def answers_to_both(self, vehicle):
        """Answers from times in which both controllers sent: a controller that stalls is not the node's fault."""
        both = set.intersection(*(self.sent[TEMPLATES[other]] for other in OTHERS))
        return [command for command in self.world.answers(vehicle) if tenth(command.answers) in both]

    def held(self, vehicle):
        """Its safety messages of a hold or landing, except for old states and controls: this computer may stall."""
        rules = Safety.STATE, Safety.CONTROLS
        return [m for m in self.world.messages(vehicle, "safety") if m.level != Safety.OK and m.rule not in rules]

    def check_that_others_fly_on(self, count=30):
        """Both, the quick controller's vehicle and the slow one's, are commanded as often as before."""
        world = self.world
        world.forget()
        wait_for(lambda: all(len(self.answers_to_both(v)) >= count for v in OTHERS), "commands of the others")
        quick, slow = (len(self.answers_to_both(vehicle)) for vehicle in OTHERS)
        self.assertLess(quick, 1.5 * count, "the slow controller's vehicle is commanded as often")
        self.assertLess(slow, 1.5 * count)
        for vehicle in OTHERS:
            self.assertTrue(all(is_flown(twist_of(m)) for m in world.answers(vehicle)), vehicle)
            self.assertEqual(world.messages(vehicle, "ardrone/land"), [])

    def test_1_two_controllers_each_fly_their_own(self):
        world = self.world
        world.fly_by_controls()
        del self.logs[:]
        self.check_that_others_fly_on()
        for vehicle in TEMPLATES:
            stamps = [m.answers for m in world.answers(vehicle)]
            self.assertEqual(stamps, sorted(set(stamps)), "each answer is to a newer command")
        self.assertEqual([text for text in self.logs if "has no" in text and "'IRIS'" not in text], [])

    def test_2_a_vehicle_that_is_not_seen(self):
        world = self.world
        world.fly_by_controls()
        world.visible["risc2"] = False
        world.wait("risc2", "safety", lambda m: (m.level, m.rule) == (Safety.LAND, Safety.STATE))
        self.check_that_others_fly_on()
        self.assertTrue(all(map(is_zero, world.messages("risc2", "cmd_vel"))))

    def test_3_a_vehicle_that_is_fed_garbage(self):
        """Commands, sticks and telemetry that are not numbers."""
        world = self.world
        world.fly_by_controls()
        world.controls["risc2"] = (math.nan, math.inf, -math.inf, math.nan)
        world.flight_state["risc2"] = 4000000000
        for buttons, axes in (([], []), ([1] * 200, [math.nan] * 200), ([-1, 7], [1e30])):
            world.send_joy("risc2", Joy(buttons=buttons, axes=axes))
        self.check_that_others_fly_on()
        self.assertFalse(any(map(is_flown, world.messages("risc2", "cmd_vel"))))

    def test_4_messages_that_are_cut_off(self):
        rospy.set_param("/second_controller/torn", True)
        wait_for(lambda: self.torn, "messages that are cut off")
        self.world.fly_by_controls()
        self.check_that_others_fly_on()

    def test_5_a_vehicle_that_comes_too_near(self):
        """To another one; they hold and land, and the third flies on."""
        world = self.world
        world.fly_by_controls()
        world.y_m["risc2"] = world.y_m["risc1"] + SafetyLimits.separation_m - 0.05
        for vehicle in ("risc1", "risc2"):
            world.wait(vehicle, "safety", lambda m: (m.level, m.rule) == (Safety.LAND, Safety.SEPARATION))
            self.assertTrue(any(m.level == Safety.HOLD for m in world.messages(vehicle, "safety")), vehicle)
            world.wait(vehicle, "ardrone/land")
        world.forget()
        wait_for(lambda: len(world.answers("risc3")) >= 20, "commands of the third")
        self.assertEqual(world.answers("risc1") + world.answers("risc2"), [])
        self.assertEqual(world.messages("risc3", "ardrone/land"), [])

    def test_5_a_wider_vehicle_that_comes_too_near(self):
        """An IRIS+ of the fleet, which another node flies, at a distance that is enough for an AR.Drone."""
        world = self.world
        world.fly_by_controls()
        far_m = SafetyLimits.separation_m + 0.1
        world.y_m["risc2"] = world.y_m["risc1"] + far_m
        self.check_that_others_fly_on()
        self.assertEqual(self.held("risc1"), [])
        world.passers["IRIS"] = world.y_m["risc3"] + far_m
        world.wait("risc3", "safety", lambda m: (m.level, m.rule) == (Safety.LAND, Safety.SEPARATION))
        self.assertEqual(self.held("risc1"), [])

    def test_5_a_wide_vehicle_that_another_node_holds(self):
        """Its neighbour holds as soon as that node lands it; while it flies on or gives way, the distance is enough."""
        world, limits = self.world, SafetyLimits()
        told = rospy.Publisher("/iris1/safety", Safety, queue_size=1, latch=True)
        telemetry = rospy.Publisher("/iris1/apm/state", State, queue_size=1, latch=True)
        world.fly_by_controls()
        world.passers["IRIS"] = world.y_m["risc3"] + 0.5 * (limits.separation_m + limits.separation_stray_m) + 0.2
        for level, rule in ((Safety.OK, Safety.NONE), (Safety.HOLD, Safety.SEPARATION)):
            told.publish(Safety(level=level, rule=rule))
            self.check_that_others_fly_on()
            self.assertEqual(self.held("risc3"), [])
        told.unregister()
        telemetry.publish(State(armed=True, mode="STABILIZE"))  # it flies, and the board of its transmitter is silent
        world.wait("risc3", "safety", lambda m: m.level == Safety.HOLD and "IRIS, which holds" in m.reason)
        self.assertEqual(self.held("risc1"), [])
        telemetry.publish(State(armed=False, mode="STABILIZE"))

    def test_5_a_vehicle_that_leaves_its_course(self):
        """Its neighbour lands, and so does it itself; the third flies on."""
        world = self.world
        limits = SafetyLimits()
        world.y_m["risc2"] = world.y_m["risc1"] + 0.5 * (limits.separation_m + limits.separation_stray_m)
        world.fly_by_controls()
        self.assertEqual(self.held("risc1"), [])
        world.strays = {"risc2"}
        for vehicle in ("risc1", "risc2"):
            world.wait(vehicle, "ardrone/land")
        world.forget()
        wait_for(lambda: len(world.answers("risc3")) >= 20, "commands of the third")

    def test_5_the_shut_down_button_of_one(self):
        """Its vehicle lands and starts over; the node goes on, as it is that of the others as well."""
        world = self.world
        world.fly_by_controls()
        world.forget()
        world.hold("risc2", SHUT_DOWN)
        world.wait("risc2", "ardrone/land")
        world.flight_state["risc2"] = LANDED
        world.let_pass("risc2")  # it has begun again: until then it reports no mode
        world.forget()
        for _ in range(3):  # joy_node repeats as long as the button is down
            world.hold("risc2", SHUT_DOWN)
        world.press("risc2", EMERGENCY)
        world.wait("risc2", "ardrone/reset")
        wait_for(lambda: len(world.messages("risc2", "controller_status")) >= 25, "status of risc2")
        self.assertEqual(world.messages("risc2", "ardrone/land"), [], "the button was pressed once")
        self.check_that_others_fly_on()
        world.fly()
        world.controls["risc2"] = (0.3, 0.1, 0.0, HOVER_N)
        world.wait("risc2", "cmd_vel", lambda m: same(m, 0.1, 0.3, m.linear.z, 0.0))

    def test_6_the_end_of_the_node_lands_all(self):
        world = self.world
        world.fly_by_controls()
        world.forget()
        uri = rosgraph.Master(NAME).lookupNode("/vehicles")
        _, _, pid = xmlrpc.client.ServerProxy(uri).getPid(NAME)
        os.kill(pid, signal.SIGINT)
        for vehicle in TEMPLATES:
            world.wait(vehicle, "ardrone/land")
            wait_for(lambda v=vehicle: any(map(is_zero, world.messages(v, "cmd_vel")[-1:])), "a last command of zero")
        self.assertEqual({world.flight_state[vehicle] for vehicle in TEMPLATES}, {FLYING})


if __name__ == "__main__":
    init_node(NAME[1:])
    rostest.rosrun("risc_control", "vehicle_fleet_test", VehicleFleetTest)
