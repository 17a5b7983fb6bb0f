#!/usr/bin/env python3
"""The vehicle node on its topics: names, take-off and landing, command mapping, safety ladder, shutdown.

Thresholds and pacing are checked exactly by test_failsafe.py and test_vehicle_node_pilot.py, on a clock that the test
advances. Here things must happen at all, in the right order, with the right content: the computer may be slow or stall.
"""

import itertools
import os
import signal
import socket
import time
import unittest

import rosgraph
import rospy
import rostest
from std_msgs.msg import Bool, Empty
from std_srvs.srv import Trigger
from vehicle_world import (
    EMERGENCY,
    FLYING,
    HOVER_N,
    JOY_TO_WAY,
    LANDED,
    MOST_HZ,
    PUBLISHED,
    SHUT_DOWN,
    TAKEOFF_LAND,
    World,
    equal,
    is_flown,
    is_zero,
    same,
    twist_of,
)

from risc_control.ros.vehicle_node import SILENCE_S, VehicleNode
from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import wait_for
from risc_maap_msgs.msg import (
    EstimatorStatus,
    MarkerCount,
    Safety,
    TakeoffRefusals,
    VehicleNodeStatus,
    VehicleStatus,
)

TEMPLATES = {"risc1": "fluffy_II", "risc2": "albatross", "risc3": "condor"}
LIMIT_S = {"hold": 0.5, "land": 2.0}  # of states and controls, as in vehicle_node.test
TURN_DEG_S = 18.0  # an AR.Drone does 20 (yaw_rate_max_rad_s)
RECEIPT_JITTER_S = 1.0  # a stall of this computer between sending and noting the time of receipt


class VehicleNodeTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.world = World(TEMPLATES, nodes=3)

    @classmethod
    def tearDownClass(cls):
        cls.world.end()

    def tearDown(self):
        self.world.flight_state = dict.fromkeys(TEMPLATES, LANDED)
        self.world.visible = dict.fromkeys(TEMPLATES, True)
        self.world.psi_deg = dict.fromkeys(TEMPLATES, 0.0)
        self.world.turn_deg_s = dict.fromkeys(TEMPLATES, 0.0)
        self.world.running = True

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
        for vehicle in TEMPLATES:
            world.wait(vehicle, "controller_status", lambda m: not m.data)
            world.wait_for_state(vehicle, LANDED)
        for vehicle in TEMPLATES:
            world.forget()
            for _ in range(5):
                world.press(vehicle, TAKEOFF_LAND, late_s=1.0)  # to land a vehicle that has landed meanwhile
            world.let_pass(vehicle)
            self.assertEqual(world.messages(vehicle, "ardrone/takeoff"), [])
            world.press(vehicle, TAKEOFF_LAND)
            world.wait(vehicle, "ardrone/takeoff")
            self.assertEqual(world.messages(vehicle, "ardrone/land"), [])
            world.flight_state[vehicle] = FLYING
            world.wait(vehicle, "cmd_vel")  # the node knows that its vehicle flies
            world.press(vehicle, TAKEOFF_LAND)
            world.wait(vehicle, "ardrone/land")
            world.press(vehicle, EMERGENCY)
            world.wait(vehicle, "ardrone/reset")
            self.assertEqual(len(world.messages(vehicle, "ardrone/takeoff")), 1)
            others = [v for v in TEMPLATES if v != vehicle]
            self.assertEqual([world.messages(v, "ardrone/takeoff") for v in others], [[], []])

    def test_2_takeoff_while_a_marker_is_hidden(self):
        """The node of risc3 refuses it; that of risc1, which makes no checks, does not."""
        world, told = self.world, []
        rospy.Subscriber("/risc3/takeoff_refusals", TakeoffRefusals, told.append)
        estimator = rospy.Publisher("/estimator_status", EstimatorStatus, queue_size=1)
        wait_for(lambda: estimator.get_num_connections() == len(TEMPLATES), "the nodes")

        def press(vehicle, used):
            """With this number of markers used of 4."""
            world.wait_for_state(vehicle, LANDED)
            estimator.publish(markers=[MarkerCount(TEMPLATES[vehicle], used, 4)])
            world.let_pass(vehicle)  # the count has arrived
            world.press(vehicle, TAKEOFF_LAND)

        press("risc3", 3)
        wait_for(lambda: told and told[-1].reasons, "the refusal")  # the answer before is latched
        (refusal,) = told[-1].reasons
        self.assertIn("3 of its markers", refusal)
        self.assertEqual(world.messages("risc3", "ardrone/takeoff"), [])
        press("risc3", 4)
        world.wait("risc3", "ardrone/takeoff")
        wait_for(lambda: told[-1].reasons == [], "that there is no reason")
        press("risc1", 3)
        world.wait("risc1", "ardrone/takeoff")

    def test_3_each_vehicle_flies_its_own_command(self):
        world = self.world
        world.controls = {
            "risc1": (0.1, 0.2, -0.3, HOVER_N),  # left, forward, clockwise
            "risc2": (-0.4, -0.5, 0.6, HOVER_N + 0.45),  # right, back, counter-clockwise, up by 1 m/s^2
            "risc3": (5.0, 0.0, 0.0, 0.0),
        }
        world.fly()
        for vehicle, (x, y, z, yaw) in (
            ("risc1", (0.2, 0.1, 0.0, -0.3)),
            ("risc2", (-0.5, -0.4, 0.3, 0.6)),
            ("risc3", (0.0, 1.0, -1.0, 0.0)),
        ):
            # From rest each climb command is 0.3 s x acceleration; later ones contain the predicted climb rate.
            world.wait(vehicle, "cmd_vel", lambda m, wanted=(x, y, z, yaw): same(m, *wanted))
            wait_for(lambda v=vehicle: len(world.answers(v)) >= 90, "answers of %s" % vehicle)
            answers = world.answers(vehicle)
            self.assertTrue(all(same(t, x, y, t.linear.z, yaw) for t in map(twist_of, answers)))
            stamps = [m.answers for m in answers]
            self.assertEqual([stamp for stamp in stamps if stamp not in world.sent], [], "stamps of no command")
            self.assertEqual(stamps, sorted(set(stamps)), "each answer is to a newer command")
            times = [t for t, _ in world.received[vehicle, "cmd_vel"]]
            self.assertLess(len(times) - 1, MOST_HZ * (times[-1] - times[0] + RECEIPT_JITTER_S), "commands too often")
            # What is reported is what was sent. Manual commands, all zero here, may have come before recording began on
            # one of the topics.
            twists = [m for m in world.messages(vehicle, "cmd_vel") if not is_zero(m)]
            told = [m for m in world.told[TEMPLATES[vehicle]] if not is_zero(twist_of(m))]
            self.assertTrue(all(equal(one, twist_of(other)) for one, other in zip(twists, told)))
            sent = [m.sent for m in told]
            self.assertEqual(sent, sorted(set(sent)), "in the order of sending")
            self.assertLess(max((m.sent - m.answers).to_sec() for m in answers), LIMIT_S["hold"])
        wait_for(lambda: rospy.get_param("/controller_status", None) is True, "the parameter controller_status")

    def test_3_a_controller_with_other_full_scales_is_not_obeyed(self):
        """Its vehicle refuses autonomous mode, the others fly; it is compared again after a silence, and obeyed."""
        world, parameter = self.world, rospy.get_name() + "/full_scales"
        controllers = rospy.get_param(parameter, {})
        try:
            rospy.set_param(parameter, {"fluffy_II": {"climb_max_m_s": 0.2}, "albatross": {"climb_max_m_s": 1.0}})
            self.be_silent()
            for vehicle in TEMPLATES:
                world.flight_state[vehicle] = FLYING
                world.wait_for_state(vehicle, FLYING)
            world.forget()
            for _ in range(3):
                world.press("risc1", JOY_TO_WAY)
                world.let_pass("risc1")
            self.assertFalse(any(m.data for m in world.messages("risc1", "controller_status")))
            world.press("risc2", JOY_TO_WAY)
            world.wait("risc2", "controller_status", lambda m: m.data)
            self.assertEqual(world.answers("risc1"), [])
        finally:
            rospy.set_param(parameter, controllers)
        self.be_silent()
        world.fly_by_controls()

    def be_silent(self):
        """Be silent so long that a controller that is heard afterwards may be another one."""
        self.world.running = False
        wait_for(lambda: time.monotonic() - self.world.sent_s > 2.0 * SILENCE_S, "silence")
        self.world.running = True
        since_s = time.monotonic()
        wait_for(lambda: self.world.sent_s > since_s, "states and controls again")

    def test_4_loss_of_states_holds_then_lands(self):
        world = self.world
        world.fly_by_controls()
        world.running = False
        for vehicle in TEMPLATES:
            self.check_loss(vehicle)
        wait_for(lambda: len(world.messages("risc1", "ardrone/land")) >= 4, "landing ordered again and again")
        world.forget()
        world.running = True
        world.flight_state["risc1"] = LANDED
        world.wait("risc1", "safety", lambda m: m.level == Safety.OK)
        world.wait("risc1", "controller_status", lambda m: not m.data)
        world.let_pass("risc1")  # what was ordered before has arrived
        world.let_pass("risc1")
        self.assertEqual(world.messages("risc1", "ardrone/land"), [])
        # states are back, but risc2 has not landed yet
        wait_for(lambda: len(world.messages("risc2", "ardrone/land")) >= 2, "landing of risc2, ordered on and on")

    def check_loss(self, vehicle):
        """Check for zero commands, then the order to land, not too early, and for the safety messages."""
        world = self.world
        commands, landings = world.received[vehicle, "cmd_vel"], world.received[vehicle, "ardrone/land"]
        world.wait(vehicle, "safety", lambda m: m.level == Safety.LAND)
        world.wait(vehicle, "ardrone/land")
        land_s = landings[0][0]
        self.assertGreater(land_s - world.sent_s, LIMIT_S["land"] - 1.0 / MOST_HZ)
        wait_for(lambda: commands[-1][0] > land_s, "a command after the order to land")
        said = [(t, m) for t, m in world.received[vehicle, "safety"] if m.rule in (Safety.STATE, Safety.CONTROLS)]
        losses = [m for _, m in said]
        levels = [level for level, _ in itertools.groupby(m.level for m in losses)]
        self.assertEqual(levels[-2:], [Safety.HOLD, Safety.LAND])
        # After a stall the order to land comes soon after the last flown command. The first command after the message
        # that it holds may have been sent before it: each topic has a thread of its own here.
        hold_s = max(t for t, m in said if m.level == Safety.HOLD)
        held = [m for t, m in commands if hold_s < t < land_s][1:][-3:] + [m for t, m in commands if t > land_s]
        self.assertTrue(all(map(is_zero, held)), held)
        limit_s = {Safety.HOLD: LIMIT_S["hold"], Safety.LAND: LIMIT_S["land"]}
        self.assertTrue(all(m.age_s >= m.limit_s == limit_s[m.level] for m in losses), losses)

    def test_5_only_the_lost_vehicle_holds_and_recovers(self):
        world = self.world
        world.fly_by_controls()
        world.visible["risc2"] = False
        world.wait("risc2", "safety", lambda m: (m.level, m.rule) == (Safety.HOLD, Safety.STATE))
        world.forget()
        for vehicle, fits in (("risc1", is_flown), ("risc2", is_zero), ("risc3", is_flown)):
            wait_for(lambda v=vehicle, f=fits: sum(map(f, world.messages(v, "cmd_vel"))) >= 6, "commands: " + vehicle)
        world.visible["risc2"] = True
        world.wait("risc2", "safety", lambda m: m.level == Safety.OK)
        world.forget()
        world.wait("risc2", "cmd_vel", is_flown)

    def test_5_a_state_that_cannot_be_true(self):
        """The vehicle is seen turned by 180 degrees; the others fly on."""
        world = self.world
        world.fly_by_controls()
        world.psi_deg["risc2"] = 180.0
        world.wait("risc2", "safety", lambda m: (m.level, m.rule) == (Safety.HOLD, Safety.SUSPECT))
        world.wait("risc2", "safety", lambda m: (m.level, m.rule) == (Safety.LAND, Safety.SUSPECT))
        world.wait("risc2", "ardrone/land")
        (said, *_) = [m for m in world.messages("risc2", "safety") if m.rule == Safety.SUSPECT]
        self.assertTrue("yaw" in said.reason and said.age_s > said.limit_s == LIMIT_S["hold"], said)
        world.forget()
        world.wait("risc1", "cmd_vel", is_flown)
        world.wait("risc3", "cmd_vel", is_flown)
        self.assertEqual(world.answers("risc2"), [])

    def test_5_a_vehicle_that_turns_is_believed(self):
        """As fast as it can, in degrees: with the wrong unit this is a jump, or the turn in the test above is none."""
        world = self.world
        world.fly()
        world.forget()
        world.turn_deg_s["risc2"] = TURN_DEG_S
        wait_for(lambda: world.psi_deg["risc2"] > 60.0, "a turn")
        world.turn_deg_s["risc2"] = -TURN_DEG_S  # the other tests begin at 0
        wait_for(lambda: world.psi_deg["risc2"] < 1.0, "the turn back")
        self.assertEqual([m for m in world.messages("risc2", "safety") if m.rule == Safety.SUSPECT], [])

    def test_6_errors_land_and_do_not_stop_the_clock(self):
        """A node in this process whose pilot is broken, as by an unexpected error."""
        rospy.set_param("~vehicle", "condor")
        node = VehicleNode("risc4")
        landings, statuses = [], []
        rospy.Subscriber("/risc4/ardrone/land", Empty, landings.append)
        rospy.Subscriber("/risc4/controller_status", Bool, statuses.append)
        wait_for(lambda: statuses, "controller_status")
        (vehicle,) = node._vehicles
        pilot, good = vehicle.pilot, vehicle.pilot.tick
        node.controllers_s["/other"] = time.monotonic()
        vehicle.compare({"climb_max_m_s": 0.2}, "/other")
        self.assertIn("climb_max_m_s", pilot.disagreement)
        node.controllers_s["/other"] -= 10.0
        wait_for(lambda: not pilot.disagreement, "a controller that has gone is forgotten")

        def broken(_now_s):
            raise ZeroDivisionError("as if")

        pilot.tick = broken
        wait_for(lambda: vehicle._counts["errors"] > 10, "the errors of every tick")
        time.sleep(0.2)  # a landing would have arrived
        self.assertEqual(landings, [], "in manual mode the operator decides")
        pilot.autonomous = True
        wait_for(lambda: len(landings) >= 3, "landing, again and again")
        pilot.tick = good
        del statuses[:]
        wait_for(lambda: len(statuses) >= 15, "the timer goes on")  # what was ordered before has arrived
        errors = vehicle._counts["errors"]
        del landings[:]
        wait_for(lambda: len(statuses) >= 35, "the timer goes on")
        self.assertEqual((landings, vehicle._counts["errors"]), ([], errors))
        pilot.on_controls = pilot.hear_controls = lambda *_: 1 / 0
        wait_for(lambda: landings, "landing when commands cannot be worked out")
        pilot.autonomous = False

    def test_7_a_requested_landing(self):
        """The service under all three kinds of names; it lands what flies, and says when nothing does."""
        world = self.world
        for vehicle in TEMPLATES:
            world.wait_for_state(vehicle, LANDED)
            answer = rospy.ServiceProxy("/%s/land" % vehicle, Trigger)()
            self.assertTrue(answer.success, answer.message)
        world.fly_by_controls()
        world.forget()
        answer = rospy.ServiceProxy("/risc1/land", Trigger)()
        self.assertTrue(answer.success, answer.message)
        world.wait("risc1", "safety", lambda m: (m.level, m.rule) == (Safety.LAND, Safety.REQUEST))
        wait_for(lambda: len(world.messages("risc1", "ardrone/land")) >= 3, "landing, ordered again and again")
        world.wait("risc1", "cmd_vel", is_zero)
        world.wait("risc2", "cmd_vel", is_flown)
        self.assertEqual(world.messages("risc2", "ardrone/land"), [], "the others fly on")
        world.flight_state["risc1"] = LANDED
        world.wait("risc1", "safety", lambda m: m.level == Safety.OK)

    def test_7_the_status_of_the_node(self):
        world, told = self.world, []
        world.fly_by_controls()
        rospy.Subscriber("/risc2/node_status", VehicleNodeStatus, told.append)
        wait_for(lambda: told and 0.0 < told[-1].oldest_state_s < 5.0, "the age of a state that was answered")
        self.assertEqual((told[-1].name, told[-1].computer), (TEMPLATES["risc2"], socket.gethostname()))

    def test_7_what_a_vehicle_says_of_itself(self):
        """In the terms common to all types; at once when its state changes, otherwise five times a second."""
        world = self.world
        world.forget()
        world.flight_state["risc2"] = FLYING
        world.wait("risc2", "vehicle_status", lambda m: m.state == VehicleStatus.FLYING)
        wait_for(lambda: len(world.messages("risc1", "vehicle_status")) >= 10, "ten of risc1")
        told = world.messages("risc1", "vehicle_status")
        self.assertEqual({(m.name, m.state, m.battery_pct) for m in told}, {("fluffy_II", VehicleStatus.LANDED, 80.0)})
        stamps_s = [m.header.stamp.to_sec() for m in told]
        self.assertGreater((stamps_s[-1] - stamps_s[0]) / (len(told) - 1), 0.19)

    def test_8_without_a_master_that_answers_the_ladder_goes_on(self):
        """A base station behind an unplugged cable: connections stay, answers do not come."""
        world = self.world
        world.fly_by_controls()
        master = rosgraph.Master("/vehicle_node_test").getPid()
        os.kill(master, signal.SIGSTOP)
        try:
            world.running = False
            for vehicle in TEMPLATES:
                self.check_loss(vehicle)
        finally:
            os.kill(master, signal.SIGCONT)

    def test_9_shut_down_button_lands_and_ends_the_node(self):
        world = self.world
        world.fly_by_controls()
        world.forget()
        world.press("risc2", SHUT_DOWN)
        world.wait("risc2", "ardrone/land")
        master = rosgraph.Master("/vehicle_node_test")

        def gone():
            return "/second" not in [node for _, nodes in master.getSystemState()[0] for node in nodes]

        wait_for(gone, "the end of the node")
        wait_for(lambda: any(map(is_zero, world.messages("risc2", "cmd_vel")[-1:])), "a last command that is zero")


if __name__ == "__main__":
    init_node("vehicle_node_test")
    rostest.rosrun("risc_control", "vehicle_node_test", VehicleNodeTest)
