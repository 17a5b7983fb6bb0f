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
from geometry_msgs.msg import Twist, TwistStamped, Vector3
from std_msgs.msg import Bool, Header
from visualization_msgs.msg import Marker, MarkerArray

from ardrone_autonomy.msg import Navdata
from risc_lab.ros.publisher_updates import init_node
from risc_maap_msgs.msg import Safety, VehicleStatus
from risc_msgs.msg import (
    Angle,
    Angles,
    Cortex,
    Landmark,
    Landmarks,
    Mocap_data,
    Mocap_marker,
    Mocap_markers,
    Observed_angles,
    States,
    Trajectories,
    Trajectory,
    Waypoint,
    Waypoints,
)

PACKAGE = "risc_visual"
NAME = "draw_nodes"
PATIENCE_S = 60.0
START_S = 60.0  # five programs start at a time, and at low priority
CONFIG = pathlib.Path(__file__).resolve().parents[1] / "config"
INPUTS = {
    "/cortex_raw": Cortex,
    "/mocap_data": Mocap_data,
    "/states3": Landmarks,
    "/trajectory": Trajectories,
    "/risc2/controller_status": Bool,
    "/risc2/safety": Safety,
    "/risc2/vehicle_status": VehicleStatus,
    "/risc1/ardrone/navdata": Navdata,
    "/risc2/ardrone/navdata": Navdata,
    "/risc2/position_cov": TwistStamped,
    "/angles": Observed_angles,
    "/waypoints": Waypoints,
}
TUNER = "/transform_tuner/"  # topics of a node that is not among the drawing nodes


def displays():
    """(class, topic) of every marker display of the rviz configurations, sorted."""
    found = set()
    for path in CONFIG.glob("*.rviz"):
        content = yaml.safe_load(path.read_text())["Visualization Manager"]
        found |= {(d["Class"], d["Marker Topic"]) for d in content["Displays"] if "Marker Topic" in d}
    return sorted(item for item in found if not item[1].startswith(TUNER))


class DrawNodesTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        init_node(NAME)
        cls.lock = threading.Lock()
        cls.received = {}
        cls.publishers = {topic: rospy.Publisher(topic, kind, queue_size=10) for topic, kind in INPUTS.items()}
        for kind, topic in displays():
            message = MarkerArray if kind == "rviz/MarkerArray" else Marker
            rospy.Subscriber(topic, message, cls.keep, topic, queue_size=100)
        deadline_s = time.monotonic() + START_S
        while not all(publisher.get_num_connections() for publisher in cls.publishers.values()):
            if time.monotonic() > deadline_s:
                silent = sorted(t for t, publisher in cls.publishers.items() if not publisher.get_num_connections())
                raise AssertionError("no node listened to %s within %g s" % (", ".join(silent), START_S))
            time.sleep(0.02)

    @classmethod
    def keep(cls, message, topic):
        with cls.lock:
            found = message.markers if isinstance(message, MarkerArray) else [message]
            cls.received.setdefault(topic, []).append(found)

    def taken(self, topic):
        with self.lock:
            return list(self.received.get(topic, ()))

    def latest(self, topic):
        """Markers of the newest message; empty before the first."""
        return (self.taken(topic) or [[]])[-1]

    def texts(self, topic):
        """{ns: text} of the newest message."""
        return {m.ns: m.text for m in self.latest(topic)}

    def clear(self):
        with self.lock:
            self.received.clear()

    def fly(self, seconds, visible=True):
        """Two vehicles at 200 Hz: fluffy_II flies a circle as it should, Raven is 0.8 m beside its reference.

        Returns how long it took [s], which is longer on a busy computer.
        """
        start_s = time.monotonic()
        for k in range(int(200 * seconds)):
            angle = 2.0 * math.pi * (rospy.get_time() % 8.0) / 8.0
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
                self.publishers["/risc2/vehicle_status"].publish(VehicleStatus(battery_pct=60.0))
            time.sleep(max(0.0, start_s + (k + 1) / 200.0 - time.monotonic()))
        return time.monotonic() - start_s

    def fly_until(self, condition, what, **options):
        """Fly on until the condition holds. Returns how long it took [s]."""
        start_s = time.monotonic()
        while not condition():
            self.assertLess(time.monotonic() - start_s, PATIENCE_S, "never came: " + what)
            self.fly(0.1, **options)
        return time.monotonic() - start_s

    def test_1_every_display_of_the_configuration_has_its_topic(self):
        wanted = {topic: "visualization_msgs/" + kind.split("/")[1] for kind, topic in displays()}
        deadline_s = time.monotonic() + PATIENCE_S
        offered = {}
        # A node subscribes before it advertises its last topic: connected inputs do not mean that all outputs exist.
        while not wanted.items() <= offered.items() and time.monotonic() < deadline_s:
            offered = dict(rospy.get_published_topics())
            time.sleep(0.05)
        self.assertEqual({topic: offered.get(topic) for topic in wanted}, wanted)

    def test_2_the_arena_is_there_without_any_flight(self):
        deadline_s = time.monotonic() + PATIENCE_S
        while not all(self.taken(topic) for topic in ("/net", "/Grid", "/Cameras")):
            self.assertLess(time.monotonic(), deadline_s, "net, Grid and Cameras did not come")
            time.sleep(0.05)
        self.assertEqual(sum(m.type == Marker.CUBE for m in self.taken("/net")[0]), 4)
        frames = tf2_ros.Buffer()
        listener = tf2_ros.TransformListener(frames)
        ned = frames.lookup_transform("cortex", "ned", rospy.Time(0), rospy.Duration(PATIENCE_S))
        listener.unregister()
        self.assertEqual(abs(ned.transform.rotation.x), 1.0)

    def test_3_a_flight_is_drawn_at_the_drawing_rate(self):
        moving = ("/Quad_Markers", "/Quad_Labels", "/Cortex_Markers", "/Quad_trajectory", "/desired_trajectory")
        still = ("/Land_Markers", "/Land_Labels", "/desired_trajectory_name")
        self.fly_until(lambda: all(map(self.taken, moving)), "any drawing")
        self.clear()
        begin_s = rospy.get_time()
        elapsed_s = self.fly(3.0)
        elapsed_s += self.fly_until(lambda: all(len(self.taken(topic)) > 8 for topic in moving), "8 drawings each")
        counts = {topic: len(self.taken(topic)) for topic in moving}
        # A busy computer draws less often; what matters is that the output never has 200 Hz.
        for topic in moving:
            self.assertLess(counts[topic], 30.0 * elapsed_s + 10.0, topic)  # 25 Hz, and what a stall held back before
        self.fly_until(lambda: all(map(self.taken, still)), "what stands still")
        latest = self.latest("/Quad_Markers")
        self.assertEqual({m.ns for m in latest}, {"fluffy_II", "Raven"})
        self.assertEqual({m.header.frame_id for m in latest}, {"cortex"})
        ids = {tuple((m.ns, m.id) for m in found) for found in self.taken("/Quad_Markers")}
        self.assertEqual(len(ids), 1, "ids changed from one drawing to the next")
        end_s = rospy.get_time()
        self.assertTrue(all(begin_s < m.header.stamp.to_sec() < end_s for m in latest), "stamps of this flight")
        self.assertEqual([len(m.points) for m in self.latest("/Cortex_Markers")], [1])
        self.assertEqual([m.ns for m in self.latest("/Land_Markers")], ["Green_pink"])
        self.assertEqual([m.text for m in self.latest("/Land_Labels")], ["Green_pink"])
        self.assertEqual(self.latest("/desired_trajectory_name")[0].text, "test flight")

        def lines(topic, ns):
            return [len(m.points) for found in self.taken(topic) for m in found if m.ns == ns]

        self.fly_until(lambda: max(lines("/Quad_trajectory", "quad_line"), default=0) > 10, "a path flown")
        self.fly_until(lambda: lines("/desired_trajectory", "traj_line"), "a path to be flown")
        # In a stall fluffy_II can also be far from its reference for a moment.
        self.fly_until(
            lambda: {m.text for m in self.latest("/desired_trajectory") if m.ns == "traj_name"} == {"Raven"},
            "the name of the one that is not at its reference",
        )

    def test_4_texts_of_a_vehicle(self):
        self.publishers["/risc2/safety"].publish(Safety())
        for topic, ns, text in (
            ("/Ctrl_Status", "controller_status", "Raven: Autonomous"),
            ("/Battery_Status", "battery_status", "Raven: 60%"),
        ):
            self.fly_until(lambda topic=topic, wanted={ns: text}: self.texts(topic) == wanted, text)
        for vehicle in ("risc1", "risc2"):  # as in a bag of the original release; risc2 has sent its status already
            self.publishers["/%s/ardrone/navdata" % vehicle].publish(Navdata(batteryPercent=40.0))
        batteries = {"fluffy_II: 40%", "Raven: 60%"}
        self.fly_until(lambda: {m.text for found in self.taken("/Battery_Status") for m in found} == batteries, "both")
        hold = Safety(level=Safety.HOLD, rule=Safety.STATE, reason="state 120 ms old")
        self.publishers["/risc2/safety"].publish(hold)
        wanted = {"controller_status": "Raven: hold: state 120 ms old"}
        self.fly_until(lambda: self.texts("/Ctrl_Status") == wanted, "the text of the safety")
        self.fly_until(lambda: self.texts("/Quad_Labels").get("Raven") == "Raven: HOLD", "the level at the vehicle")
        self.publishers["/risc2/safety"].publish(Safety())
        self.fly_until(lambda: self.texts("/Quad_Labels").get("Raven") == "Raven", "the end of the hold")

    def test_5_a_lost_vehicle_is_shown_as_lost(self):
        for visible, label in ((True, "fluffy_II"), (False, "fluffy_II (lost)")):
            wanted = {"fluffy_II": label, "Raven": "Raven"}
            self.fly_until(lambda wanted=wanted: self.texts("/Quad_Labels") == wanted, label, visible=visible)

    def look(self, observer="risc1", age_s=0.0):
        """Send the bearings of one picture of a vehicle: a landmark, one that is not seen, and another vehicle."""
        stamp = rospy.Time.now() - rospy.Duration(age_s)
        entry = Angles(
            observer,
            [Angle("green", True, 30.0, 10.0), Angle("blue", False, math.nan, math.nan)],
            [Angle("risc2", True, -10.0, 0.0)],
        )
        self.publishers["/angles"].publish(Header(stamp=stamp, frame_id="cortex"), [entry])
        return stamp

    def rays_after(self, seconds=0.5, **options):
        """Fly and look for a while. Returns (markers that are drawn, stamps of the pictures that were sent)."""
        self.clear()
        stamps, start_s = [], time.monotonic()
        while time.monotonic() - start_s < seconds:
            stamps.append(self.look(**options))
            self.fly(0.05)
        found = [m for message in self.taken("/angle_lines") for m in message]
        return [m for m in found if m.action == Marker.ADD], stamps

    def test_6_rays_of_a_picture_begin_at_its_camera_at_its_time(self):
        self.fly(0.3)  # so that the vehicles have been seen
        found, sent = [], []
        deadline_s = time.monotonic() + PATIENCE_S
        while not found:
            self.assertLess(time.monotonic(), deadline_s, "no rays")
            found, stamps = self.rays_after()
            sent += stamps
        self.assertEqual({(m.ns, m.id) for m in found}, {("risc1", 0), ("risc1/vehicles", 5)})
        self.assertEqual({m.header.frame_id for m in found}, {"fluffy_II/camera"})
        self.assertLessEqual({m.header.stamp for m in found}, set(sent))
        green = next(m for m in found if m.ns == "risc1")
        (start, end), az, el = green.points, math.radians(30.0), math.radians(10.0)
        self.assertEqual((start.x, start.y, start.z), (0.0, 0.0, 0.0))
        for value, wanted in (
            (end.x, 4.0 * math.cos(el) * math.cos(az)),
            (end.y, 4.0 * math.cos(el) * math.sin(az)),
            (end.z, -4.0 * math.sin(el)),
        ):
            self.assertAlmostEqual(value, wanted)
        self.assertEqual((green.color.g, green.color.r), (1.0, 0.0))
        self.assertTrue(all(0.0 < m.lifetime.to_sec() < 1.0 for m in found))

    def test_7_rays_that_nobody_sends_any_more_are_taken_back(self):
        deadline_s = time.monotonic() + PATIENCE_S
        while not self.rays_after()[0]:
            self.assertLess(time.monotonic(), deadline_s, "no rays")
        deletions = set()
        while deletions != {("risc1", 0), ("risc1/vehicles", 5)}:
            self.assertLess(time.monotonic(), deadline_s, "never taken back, only %s" % deletions)
            time.sleep(0.05)
            found = [m for message in self.taken("/angle_lines") for m in message]
            deletions = {(m.ns, m.id) for m in found if m.action == Marker.DELETE}

    def test_8_a_picture_without_a_place_is_not_drawn(self):
        self.fly(0.3)
        time.sleep(0.3)
        self.assertEqual(self.rays_after(age_s=60.0)[0], [], "a picture older than tf remembers")
        deadline_s = time.monotonic() + PATIENCE_S
        self.fly(1.5, visible=False)  # fluffy_II is lost
        drawn = True
        while drawn:
            self.assertLess(time.monotonic(), deadline_s, "rays of an unseen vehicle")
            self.clear()
            self.look()
            self.fly(0.3, visible=False)
            drawn = [m for message in self.taken("/angle_lines") for m in message if m.action == Marker.ADD]

    def test_9_waypoints_and_the_way_there(self):
        topics = ("/Way_Markers", "/Heading_Markers", "/Way_Labels", "/Way_trail")
        self.clear()
        deadline_s = time.monotonic() + PATIENCE_S
        while not all(map(self.taken, topics)):
            self.assertLess(time.monotonic(), deadline_s, "waypoints are not drawn")
            self.publishers["/waypoints"].publish(Header(), [Waypoint("fluffy_II", 1.0, -1.0, 1.5, 90.0)])
            self.fly(0.2)
        self.assertEqual(
            [(m.ns, m.id, m.pose.position.y) for m in self.latest("/Way_Markers")], [("fluffy_II", 0, -1.0)]
        )
        turn = self.latest("/Heading_Markers")[0].pose.orientation
        self.assertAlmostEqual(2.0 * math.atan2(turn.z, turn.w), -0.5 * math.pi)  # clockwise from above
        self.assertEqual(self.texts("/Way_Labels"), {"fluffy_II": "fluffy_II"})
        self.assertEqual({m.ns for m in self.latest("/Way_trail")}, {"way_trail"})

    def test_a_covariance_of_a_vehicle(self):
        self.clear()
        deadline_s = time.monotonic() + PATIENCE_S
        while not self.taken("/Cov_Quad"):
            self.assertLess(time.monotonic(), deadline_s, "no covariance")
            twist = Twist(Vector3(1.0, 2.0, 3.0), Vector3(1e-2, 1e-2, 4e-2))
            self.publishers["/risc2/position_cov"].publish(Header(stamp=rospy.Time.now()), twist)
            time.sleep(0.05)
        (m,) = self.latest("/Cov_Quad")
        self.assertEqual((m.ns, m.id, m.pose.position.y), ("covariance", 2, 2.0))
        self.assertAlmostEqual(m.scale.z, 0.6)

    def test_b_silence_draws_nothing(self):
        topics = (
            "/Quad_Markers",
            "/Quad_Labels",
            "/Cortex_Markers",
            "/Quad_trajectory",
            "/angle_lines",
            "/Way_Markers",
        )
        self.clear()
        self.fly_until(lambda: all(map(self.taken, topics[:4])), "any drawing")
        deadline_s = time.monotonic() + PATIENCE_S
        while any(map(self.taken, topics)):  # messages that were still under way; then none for a second
            self.assertLess(time.monotonic(), deadline_s, "it draws on and on")
            self.clear()
            time.sleep(1.0)


if __name__ == "__main__":
    rostest.rosrun(PACKAGE, NAME, DrawNodesTest)
