#!/usr/bin/env python3
"""The browser view on the wire: markers in, scene out; statuses in, panel out; buttons to land services.

A client that speaks the page's protocol takes the place of a browser; tests/test_live_view.py has a real one.
"""

import pathlib
import socket
import subprocess
import sys
import threading
import time
import unittest

import rosgraph
import rospy
import rostest
import tf2_ros
from geometry_msgs.msg import TransformStamped
from page_client import PageClient
from std_msgs.msg import Bool
from std_srvs.srv import Trigger, TriggerResponse
from visualization_msgs.msg import MarkerArray

from risc_lab.ros.launching import free_tcp_port
from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import wait_for
from risc_maap_msgs.msg import (
    ControllerReport,
    EstimatorStatus,
    FaultKind,
    FaultKinds,
    FaultRecord,
    Faults,
    OperatorState,
    Safety,
    TakeoffRefusals,
    TrackingError,
    TrajectoryPhases,
    VehiclePhase,
    VehicleStatus,
)
from risc_maap_msgs.srv import InjectFault, InjectFaultResponse
from risc_msgs.msg import Trajectories
from risc_visual.drawing.ros import markers
from risc_visual.drawing.scenery import load_scenery

NODE = pathlib.Path(__file__).resolve().parents[1] / "nodes" / "live_view"
RED = (1.0, 0.0, 0.0, 1.0)
NO_COLOUR = (1e30, 0.0, 0.0, 1.0)  # valid in a message, but too large for the number format of a picture
LIFE_S = 2.0
OUTPUTS = {
    "net": MarkerArray,
    "Quad_Markers": MarkerArray,
    "angle_lines": MarkerArray,
    "/risc1/controller_status": Bool,
    "/risc1/vehicle_status": VehicleStatus,
    "/risc1/takeoff_refusals": TakeoffRefusals,
    "/risc1/safety": Safety,
    "/trajectory": Trajectories,
    "/trajectory_phase": TrajectoryPhases,
    "/operator/phase": OperatorState,
    "/controller_report": ControllerReport,
    "/estimator_status": EstimatorStatus,
}
LATCHED = ("net", "/risc1/safety", "/trajectory_phase")


def start(port, *arguments):
    """The node as a process; its output is read on demand."""
    command = [sys.executable, str(NODE), "_port:=%d" % port, "__name:=live_view", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def ball(head, ns, marker_id, position_m):
    return markers.Pen(LIFE_S, head).ball(ns, marker_id, position_m, 0.1, RED)


class LiveViewTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.port = free_tcp_port()
        cls.node = start(cls.port)
        cls.topics = {
            topic: rospy.Publisher(topic, kind, queue_size=10, latch=topic in LATCHED)
            for topic, kind in OUTPUTS.items()
        }
        cls.topics["net"].publish(markers.net_markers(markers.Pen(0.0), load_scenery().net))
        phases = VehiclePhase("fluffy_II", VehiclePhase.COURSE), VehiclePhase("Raven", VehiclePhase.HOLD)
        cls.topics["/risc1/safety"].publish(Safety(level=Safety.HOLD, rule=Safety.STATE, reason="state 120 ms old"))
        cls.topics["/trajectory_phase"].publish(TrajectoryPhases(vehicles=phases))
        cls.asked = []
        rospy.Service("/risc1/land", Trigger, cls.on_land)
        wait_for(cls.port_is_open, "the page")

    @classmethod
    def tearDownClass(cls):
        cls.node.terminate()
        cls.node.wait()

    @classmethod
    def on_land(cls, _request):
        cls.asked.append("risc1")
        return TriggerResponse(True, "landing (landing was requested)")

    @classmethod
    def port_is_open(cls):
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", cls.port)) == 0

    def listens_to(self):
        _, subscribed, _ = rosgraph.Master("/live_view_test").getSystemState()
        return {topic for topic, nodes in subscribed if "/live_view" in nodes}

    def open_page(self):
        page = PageClient(self.port)
        self.addCleanup(page.close)
        wait_for(lambda: "/Quad_Markers" in self.listens_to(), "subscriptions")
        wait_for(lambda: self.topics["Quad_Markers"].get_num_connections() == 1, "a connection")
        return page

    def draw(self, page, *parts):
        """Publish markers repeatedly, as drawing nodes do, until the page has received them; they expire afterwards."""
        wanted = {"/Quad_Markers/%s/%d" % (part.ns, part.id) for part in parts if part.ns != "bad"}

        def drawn():
            self.topics["Quad_Markers"].publish(list(parts))
            time.sleep(0.1)
            return wanted <= set(page.made)

        wait_for(drawn, page.nodes.copy)

    def test_1_nobody_looks(self):
        self.assertEqual(self.listens_to(), set())

    def test_2_a_page_shows_what_is_drawn_until_it_expires(self):
        page = self.open_page()
        wait_for(lambda: "/net/Net/4" in page.nodes, "what was drawn before: %s" % page.nodes)
        self.assertEqual(page.nodes["/net/Net/4"], "LineSegmentsMessage")
        parts = [ball(markers.header(), "fluffy_II", k, (0.1 * k, 0.0, 1.0)) for k in (1, 2)]
        self.draw(page, *parts)
        self.assertEqual(page.made["/Quad_Markers/fluffy_II/1"], "IcosphereMessage")
        wait_for(lambda: not any(path.startswith("/Quad_Markers/") for path in page.nodes), "the end of their lives")
        self.assertIn("/net/Net/4", page.nodes)

    def test_2_what_cannot_be_drawn_stops_neither_the_rest_nor_the_panel(self):
        page = self.open_page()
        bad = markers.Pen(LIFE_S).line("bad", 1, ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), 0.1, NO_COLOUR)
        self.draw(page, bad, ball(markers.header(), "good", 1, (0.0, 0.0, 1.0)))
        self.assertNotIn("/Quad_Markers/bad/1", page.made)
        before = page.text()
        wait_for(lambda: page.text() != before, "a panel with a later time of day")
        wait_for(lambda: "/Quad_Markers/good/1" not in page.nodes, "the end of its life, in a later turn")

    def test_3_rays_are_placed_by_tf(self):
        page = self.open_page()
        frames = tf2_ros.TransformBroadcaster()
        over = threading.Event()

        def move():
            while not over.wait(0.05):
                pose = TransformStamped(header=markers.header(rospy.Time.now()), child_frame_id="fluffy_II/camera")
                pose.transform.translation.x, pose.transform.rotation.w = 1.0, 1.0
                frames.sendTransform(pose)
                head = markers.header(rospy.Time.now() - rospy.Duration(0.1), "fluffy_II/camera")
                lost = markers.header(rospy.Time.now(), "nowhere/camera")
                found = [ball(head, "risc1", 1, (0.0, 0.0, 1.0)), ball(lost, "risc2", 1, (0.0, 0.0, 1.0))]
                self.topics["angle_lines"].publish(found)

        thread = threading.Thread(target=move)
        thread.start()
        try:
            wait_for(lambda: "/angle_lines/risc1/1" in page.nodes, page.nodes.copy)
        finally:
            over.set()
            thread.join()
        self.assertNotIn("/angle_lines/risc2/1", page.nodes, "its place is unknown")

    def test_4_the_panel_says_what_the_vehicles_say_and_what_is_silent(self):
        page = self.open_page()
        reports = {
            "/controller_report": ControllerReport(vehicles=[TrackingError("fluffy_II", 0.0234)]),
            "/estimator_status": EstimatorStatus(rate_hz=200.0, visible=2, vehicles=2),
            "/operator/phase": OperatorState(phase=OperatorState.FLY, text="on course"),
            "/risc1/takeoff_refusals": TakeoffRefusals(reasons=["carry it inside"]),
        }
        wanted = {
            "autonomous</span>",
            "safety: hold: state 120 ms old",
            "take-off refused: carry it inside",
            "flying, battery 60 %",
            "course, 23 mm from its reference",
            "motion capture 200 Hz, 2 of 2 seen",
            "operator: fly: on course",
        }

        def all_is_there():
            self.topics["/risc1/controller_status"].publish(True)
            self.topics["/risc1/vehicle_status"].publish(VehicleStatus(state=3, battery_pct=60.0))
            self.topics["/trajectory"].publish(Trajectories())
            for topic, report in reports.items():
                self.topics[topic].publish(report)
            return all(text in page.text() for text in wanted)

        wait_for(all_is_there, page.text)
        self.assertIn("vehicle node: nothing heard", page.text(), "risc2 has none")
        wait_for(lambda: "vehicle node silent for" in page.text(), page.text)
        wait_for(lambda: '<span class="old"><span class="good">autonomous' in page.text(), page.text)

    def test_5_buttons_ask_the_safety_of_the_vehicles(self):
        page = self.open_page()
        wait_for(lambda: page.labels() == {"LAND ALL", "land risc1", "land risc2"}, "buttons")
        page.press("LAND ALL")
        wait_for(lambda: "risc1: landing (landing was requested)" in page.text(), page.text)
        self.assertEqual(self.asked, ["risc1"])
        wait_for(lambda: 'class="bad">risc2: the vehicle node does not answer' in page.text(), page.text)
        self.assertNotIn("virtual operator", page.text(), "there is none")
        page.press("land risc1")
        wait_for(lambda: self.asked == ["risc1", "risc1"], "the second call")
        wait_for(lambda: "risc2: the vehicle node" not in page.text(), page.text)

        def on_operator_land(_request):
            self.asked.append("operator")
            return TriggerResponse(True, "landing all vehicles")

        operator = rospy.Service("/operator/land", Trigger, on_operator_land)
        self.addCleanup(operator.shutdown)
        page.press("LAND ALL")
        wait_for(lambda: "virtual operator: landing all vehicles" in page.text(), page.text)
        wait_for(lambda: sorted(self.asked) == ["operator", "risc1", "risc1", "risc1"], lambda: str(self.asked))
        page.press("land risc1")
        wait_for(lambda: len(self.asked) == 5, lambda: str(self.asked))
        self.assertEqual(self.asked[-1], "risc1", "the operator lands all or none")

    def test_5_faults_are_offered_where_there_is_a_virtual_lab(self):
        page = self.open_page()
        wait_for(lambda: "LAND ALL" in page.labels(), "buttons")
        self.assertNotIn("inject", page.labels(), "no lab offers faults")
        asked = []

        def on_inject(request):
            asked.append((request.fault, request.vehicle, [*request.severity], [*request.duration_s]))
            return InjectFaultResponse([*request.severity] != [9.0], "<answer> to " + request.fault)

        lab = rospy.Service("/virtual_lab/inject", InjectFault, on_inject)
        self.addCleanup(lab.shutdown)
        kinds = [
            FaultKind("jump", "it is <seen> elsewhere", "severity", "m", 0.0, 5.0, 0.3, ["mild"], [0.1], True),
            FaultKind("wind", "it blows", "severity", "m/s", 0.0, 10.0, 1.0, ["breeze"], [0.5], True),
        ]
        offer = rospy.Publisher("/virtual_lab/fault_kinds", FaultKinds, queue_size=1, latch=True)
        self.addCleanup(offer.unregister)
        offer.publish(FaultKinds(kinds=kinds))
        wait_for(lambda: {"inject", "end all faults"} <= page.labels(), page.labels)
        wait_for(lambda: "it is &lt;seen&gt; elsewhere" in page.text() and "mild 0.1" in page.text(), page.text)
        page.press("inject")
        wait_for(lambda: asked == [("jump", "", [], [])], lambda: "%s, page: %s" % (asked, page.text()))
        wait_for(lambda: 'class="good">&lt;answer&gt; to jump' in page.text(), page.text)
        page.enter("fault", "wind")
        wait_for(lambda: "it blows" in page.text(), page.text)
        page.enter("argument", "9")
        offer.publish(FaultKinds(kinds=kinds))  # a repeated message changes nothing
        page.press("inject")
        wait_for(lambda: 'class="bad">&lt;answer&gt; to wind' in page.text(), page.text)
        page.enter("argument", "gale")
        page.press("inject")
        wait_for(lambda: "is not a number or breeze" in page.text(), page.text)
        page.enter("argument", "breeze")
        page.press("inject")
        wait_for(lambda: asked[-1] == ("wind", "", [0.5], []), lambda: str(asked))
        page.enter("argument", " 2 ")
        page.enter("vehicle", "risc2")
        page.press("inject")
        wait_for(lambda: asked[-1] == ("wind", "risc2", [2.0], []), lambda: str(asked))
        page.press("end all faults")
        wait_for(lambda: asked[-1] == ("", "", [], []), lambda: str(asked))
        told = rospy.Publisher("/virtual_lab/faults", Faults, queue_size=1, latch=True)
        self.addCleanup(told.unregister)
        for active, words in ((False, "jump:0.3 waits"), (True, "jump:0.3 acts"), (False, "jump:0.3 has ended")):
            told.publish(Faults(faults=[FaultRecord(id=1, name="jump", args="0.3", active=active)]))
            wait_for(lambda words=words: words in page.text(), page.text)
        page.close()
        lab.shutdown()
        again = self.open_page()
        wait_for(lambda: "inject" in again.labels(), again.labels)
        again.press("inject")
        wait_for(lambda: "the virtual lab does not answer" in again.text(), again.text)

    def test_6_when_the_last_page_is_closed_it_listens_no_more(self):
        first, second = self.open_page(), self.open_page()
        first.close()
        self.draw(second, ball(markers.header(), "fluffy_II", 1, (0.0, 0.0, 1.0)))
        second.close()
        wait_for(lambda: self.listens_to() == set(), lambda: str(self.listens_to()))
        again = self.open_page()
        wait_for(lambda: "/net/Net/4" in again.nodes, "a page that is opened later")

    def test_7_a_port_that_is_taken_is_one_clear_line(self):
        other = start(self.port, "__name:=other_view")
        output = other.communicate(timeout=120.0)[0]
        self.assertEqual(other.returncode, 1)
        self.assertIn("live_view: port %d of 127.0.0.1" % self.port, output)
        self.assertNotIn("Traceback", output)
        self.assertIsNone(self.node.poll())


if __name__ == "__main__":
    init_node("live_view_test")
    rostest.rosrun("risc_visual", "live_view_test", LiveViewTest)
