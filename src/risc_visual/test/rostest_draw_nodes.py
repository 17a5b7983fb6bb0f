#!/usr/bin/env python3
"""Drawing nodes on the wire: 200 Hz in, markers at the drawing rate out, of everything the rviz configuration shows."""

import math
import pathlib
import threading
import time
import unittest

import rospy
import rostest
import tf2_ros
import yaml
from std_msgs.msg import Bool, Header, String
from visualization_msgs.msg import Marker, MarkerArray

from ardrone_autonomy.msg import Navdata
from risc_msgs.msg import (
    Cortex,
    Landmark,
    Landmarks,
    Mocap_data,
    Mocap_marker,
    Mocap_markers,
    States,
    Trajectories,
    Trajectory,
)

PACKAGE = "risc_visual"
NAME = "draw_nodes"
CONFIG = pathlib.Path(__file__).resolve().parents[1] / "config"
INPUTS = {
    "/cortex_raw": Cortex,
    "/mocap_data": Mocap_data,
    "/states3": Landmarks,
    "/trajectory": Trajectories,
    "/risc2/controller_status": Bool,
    "/risc2/safety": String,
    "/risc2/ardrone/navdata": Navdata,
}


def displays():
    """(class, topic) of every marker display of the rviz configuration."""
    content = yaml.safe_load((CONFIG / "Diff_flat.rviz").read_text())["Visualization Manager"]
    return [(d["Class"], d["Marker Topic"]) for d in content["Displays"] if "Marker Topic" in d]


class DrawNodesTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node(NAME)
        cls.lock = threading.Lock()
        cls.received = {}
        cls.publishers = {topic: rospy.Publisher(topic, kind, queue_size=10) for topic, kind in INPUTS.items()}
        for kind, topic in displays() + [("rviz/MarkerArray", "/Cameras")]:
            message = MarkerArray if kind == "rviz/MarkerArray" else Marker
            rospy.Subscriber(topic, message, cls.keep, topic, queue_size=100)
        deadline_s = time.monotonic() + 20.0
        while not all(publisher.get_num_connections() for publisher in cls.publishers.values()):
            if time.monotonic() > deadline_s:
                raise AssertionError("the drawing nodes did not connect within 20 s")
            time.sleep(0.02)

    @classmethod
    def keep(cls, message, topic):
        with cls.lock:
            found = message.markers if isinstance(message, MarkerArray) else [message]
            cls.received.setdefault(topic, []).append(found)

    def taken(self, topic):
        with self.lock:
            return list(self.received.get(topic, ()))

    def clear(self):
        with self.lock:
            self.received.clear()

    def fly(self, seconds, visible=True):
        """Two vehicles at 200 Hz: fluffy_II flies a circle as it should, Raven is 0.8 m beside its reference."""
        start_s = time.monotonic()
        for k in range(int(200 * seconds)):
            angle = 2.0 * math.pi * (time.time() % 8.0) / 8.0
            x, y = math.cos(angle), math.sin(angle)
            head = Header(stamp=rospy.Time.now(), frame_id="/cortex")
            states = [States("fluffy_II", visible, x, y, 1.0, *[0.0] * 9), States("Raven", True, *[0.0] * 12)]
            marker = Mocap_marker(x, y, 1.0)
            lost = Mocap_marker(*[math.nan] * 3)
            references = [
                Trajectory("fluffy_II", x, y, 1.0, 0.0, 0.6, *[0.0] * 7),
                Trajectory("Raven", 0.0, 0.8, *[0.0] * 10),
            ]
            for topic, message in (
                ("/cortex_raw", Cortex(head, states)),
                ("/mocap_data", Mocap_data(head, [Mocap_markers("fluffy_II", 0.0, [marker, lost])])),
                ("/states3", Landmarks(head, [Landmark("Green_pink", 2.3, 0.8, 1.0)])),
                ("/trajectory", Trajectories(head, references)),
            ):
                self.publishers[topic].publish(message)
            if k % 10 == 0:
                self.publishers["/risc2/controller_status"].publish(True)
                self.publishers["/risc2/ardrone/navdata"].publish(Navdata(batteryPercent=60))
            time.sleep(max(0.0, start_s + (k + 1) / 200.0 - time.monotonic()))

    def test_1_every_display_of_the_configuration_has_its_topic(self):
        wanted = {topic: "visualization_msgs/" + kind.split("/")[1] for kind, topic in displays()}
        deadline_s = time.monotonic() + 20.0
        offered = {}
        # A node subscribes before it advertises its last topic: connected inputs do not mean that all outputs stand.
        while not wanted.items() <= offered.items() and time.monotonic() < deadline_s:
            offered = dict(rospy.get_published_topics())
            time.sleep(0.05)
        self.assertEqual({topic: offered.get(topic) for topic in wanted}, wanted)

    def test_2_the_arena_is_there_without_any_flight(self):
        deadline_s = time.monotonic() + 10.0
        while not all(self.taken(topic) for topic in ("/net", "/Grid", "/Cameras")):
            self.assertLess(time.monotonic(), deadline_s, "net, Grid and Cameras did not come")
            time.sleep(0.05)
        self.assertEqual(sum(m.type == Marker.CUBE for m in self.taken("/net")[0]), 4)
        frames = tf2_ros.Buffer()
        listener = tf2_ros.TransformListener(frames)
        ned = frames.lookup_transform("cortex", "ned", rospy.Time(0), rospy.Duration(5.0))
        listener.unregister()
        self.assertEqual(abs(ned.transform.rotation.x), 1.0)

    def test_3_a_flight_is_drawn_at_the_drawing_rate(self):
        self.fly(0.5)
        self.clear()
        self.fly(3.0)
        # A loaded computer draws less often; what matters is that 200 Hz never comes through.
        for topic in ("/Quad_Markers", "/Quad_Labels", "/Cortex_Markers", "/Quad_trajectory", "/desired_trajectory"):
            self.assertGreater(len(self.taken(topic)), 30, topic)
            self.assertLess(len(self.taken(topic)), 90, topic)
        latest = self.taken("/Quad_Markers")[-1]
        self.assertEqual({m.ns for m in latest}, {"fluffy_II", "Raven"})
        self.assertEqual({m.header.frame_id for m in latest}, {"cortex"})
        ids = {tuple((m.ns, m.id) for m in found) for found in self.taken("/Quad_Markers")}
        self.assertEqual(len(ids), 1, "ids changed from one drawing to the next")
        ages_s = [m.header.stamp.to_sec() for m in latest]
        self.assertLess(time.time() - max(ages_s), 1.0)
        self.assertEqual([len(m.points) for m in self.taken("/Cortex_Markers")[-1]], [1])
        self.assertEqual([m.ns for m in self.taken("/Land_Markers")[-1]], ["Green_pink"])
        self.assertEqual([m.text for m in self.taken("/Land_Labels")[-1]], ["Green_pink"])
        lines = [m for found in self.taken("/Quad_trajectory") for m in found if m.ns == "quad_line"]
        self.assertGreater(max(len(m.points) for m in lines), 10)
        desired = [m for found in self.taken("/desired_trajectory") for m in found]
        self.assertEqual({m.text for m in desired if m.ns == "traj_name"}, {"Raven"})
        self.assertIn("traj_line", {m.ns for m in desired})
        self.assertEqual(self.taken("/desired_trajectory_name")[-1][0].text, "test flight")

    def test_4_texts_of_a_vehicle(self):
        self.publishers["/risc2/safety"].publish("ok")
        self.fly(1.5)
        self.assertEqual(self.taken("/Ctrl_Status")[-1][0].text, "Raven: Autonomous")
        self.assertEqual(self.taken("/Battery_Status")[-1][0].text, "Raven: 60%")
        self.publishers["/risc2/safety"].publish("hold: state 120 ms old")
        self.fly(1.5)
        self.assertEqual(self.taken("/Ctrl_Status")[-1][0].text, "Raven: hold: state 120 ms old")

    def test_5_a_lost_vehicle_is_shown_as_lost(self):
        self.fly(0.5)
        self.fly(1.0, visible=False)
        labels = {m.ns: m.text for m in self.taken("/Quad_Labels")[-1]}
        self.assertEqual(labels, {"fluffy_II": "fluffy_II (lost)", "Raven": "Raven"})

    def test_6_silence_draws_nothing(self):
        self.fly(0.2)
        time.sleep(0.5)
        self.clear()
        time.sleep(1.0)
        for topic in ("/Quad_Markers", "/Quad_Labels", "/Cortex_Markers", "/Quad_trajectory"):
            self.assertEqual(self.taken(topic), [], topic)


if __name__ == "__main__":
    rostest.rosrun(PACKAGE, NAME, DrawNodesTest)
