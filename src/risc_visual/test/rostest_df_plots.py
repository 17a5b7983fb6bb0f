#!/usr/bin/env python3
"""DF_Plots.py on the wire: a flight at 200 Hz, the button of the vehicle's joystick, the service, the node's end."""

import contextlib
import csv
import math
import pathlib
import shutil
import threading
import time
import unittest
from functools import partial

import cv2
import rosnode
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import Joy
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from risc_control.ros.joystick_buttons import claim_buttons
from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import wait_for
from risc_maap_msgs.msg import TrajectoryPhases, VehiclePhase
from risc_msgs.msg import Control, Controls, Cortex, States, Trajectories, Trajectory

PACKAGE = "risc_visual"
NAME = "df_plots"
NODE = "/data_logger"
BUTTON = 2  # /plot_button of the test file
PATIENCE_S = 100.0  # a page takes a second on an idle computer
wait_for = partial(wait_for, limit_s=PATIENCE_S)
RATE_HZ = 200.0
LATE_S = 0.05  # the vehicle is behind its reference by this time
SPEED_M_S = 0.5


class Flight:
    """A vehicle on a circle, behind its reference by LATE_S; the test triggers everything else that it publishes."""

    def __init__(self):
        self.flying = threading.Event()
        self._states = rospy.Publisher("/cortex_raw", Cortex, queue_size=1)
        self._references = rospy.Publisher("/trajectory", Trajectories, queue_size=1)
        self._commands = rospy.Publisher("/controls", Controls, queue_size=1)
        self._phases = rospy.Publisher("/trajectory_phase", TrajectoryPhases, queue_size=10, latch=True)
        self.joy = rospy.Publisher("/risc1/joy", Joy, queue_size=10)
        threading.Thread(target=self._run, daemon=True).start()

    @property
    def is_heard(self):
        topics = (self._states, self._references, self._commands, self._phases, self.joy)
        return all(publisher.get_num_connections() for publisher in topics)

    def tell(self, course, phase):
        self._phases.publish(TrajectoryPhases(course=course, vehicles=[VehiclePhase("fluffy_II", phase)]))

    def press(self):
        for value in (0, 1, 1, 0):
            buttons = [0] * 8
            buttons[BUTTON] = value
            self.joy.publish(Joy(buttons=buttons))
            time.sleep(0.05)

    def _run(self):
        rate = rospy.Rate(RATE_HZ)
        try:
            while not rospy.is_shutdown():
                if self.flying.is_set():
                    self._publish(rospy.Time.now())
                rate.sleep()
        except rospy.ROSException:
            pass  # the end of the test

    def _publish(self, now):
        angle, before = SPEED_M_S * now.to_sec(), SPEED_M_S * (now.to_sec() - LATE_S)
        head = Header(stamp=now, frame_id="cortex")
        there = Trajectory(name="fluffy_II", x=math.cos(angle), y=math.sin(angle), z=1.0)
        there.xdot, there.ydot = -SPEED_M_S * math.sin(angle), SPEED_M_S * math.cos(angle)
        here = States(name="fluffy_II", visible=True, x=math.cos(before), y=math.sin(before), z=1.0, phi=2.0)
        here.u, here.v = there.xdot, there.ydot
        self._references.publish(Trajectories(head, [there]))
        self._states.publish(Cortex(head, [here]))
        self._commands.publish(Controls(head, [Control(name="fluffy_II", phi=0.5)]))


class DFPlotsTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.folder = pathlib.Path(rospy.get_param("/plots_folder"))
        cls.levels = {}
        rospy.Subscriber("/diagnostics", DiagnosticArray, cls.keep)
        cls.flight = Flight()
        cls.plot = rospy.ServiceProxy(NODE + "/plot", Trigger)
        cls.plot.wait_for_service(PATIENCE_S)
        wait_for(lambda: cls.flight.is_heard, "the node listens to everything")

    @classmethod
    def tearDownClass(cls):
        shutil.rmtree(str(cls.folder), ignore_errors=True)

    @classmethod
    def keep(cls, message):
        for status in message.status:
            cls.levels[status.name.split(": ")[-1]] = status.level

    def files(self, text, suffix):
        return sorted(self.folder.glob("*%s%s" % (text, suffix)))

    def rows(self, path):
        with path.open() as stream:
            return [{key: float(value or "nan") for key, value in row.items()} for row in csv.DictReader(stream)]

    def test_1_nothing_else_may_use_its_button(self):
        with self.assertRaisesRegex(ValueError, "both Up and plot_button"):
            claim_buttons({"Up": BUTTON}, ["/risc1/joy"])

    def test_1_before_a_flight_there_is_nothing_to_plot(self):
        answer = self.plot()
        self.assertFalse(answer.success)
        wait_for(lambda: self.levels.get("DF_Plots") == DiagnosticStatus.WARN, "a warning that nothing comes")

    def test_2_the_button_of_the_vehicles_joystick_asks_for_the_plots(self):
        self.flight.tell("circle", VehiclePhase.COURSE)
        self.flight.flying.set()
        time.sleep(4.0)
        self.flight.press()
        wait_for(lambda: self.files("circle", ".png"), "a page of the circle")
        self.plot()  # answers after everything has been written
        (picture,) = self.files("circle", ".png")
        image = cv2.imread(str(picture))
        self.assertGreater(image.shape[1], 1000)
        self.assertGreater(image.std(), 5.0, "an empty page")
        (table,) = self.files("circle", ".csv")
        rows = self.rows(table)
        self.assertGreater(len(rows), 10)
        duration_s = rows[-1]["time_s"] - rows[0]["time_s"]
        self.assertLess(len(rows), 25.0 * duration_s + 10.0, "20 Hz, not the 200 of the topic")
        chord_m = 2.0 * math.sin(0.5 * SPEED_M_S * LATE_S)
        for row in rows:
            # Both topics are sampled 20 times a second, at different times: paired by stamps the error is still exact.
            error_m = [row[axis + "_desired_m"] - row[axis + "_m"] for axis in "xyz"]
            self.assertAlmostEqual(math.hypot(*error_m[:2]), chord_m, delta=2e-3)
            self.assertAlmostEqual(error_m[2], 0.0)
            self.assertLess(math.hypot(row["u_error_m_s"], row["v_error_m_s"]), 2e-3)
        commanded = [row["phi_desired_deg"] for row in rows if not math.isnan(row["phi_desired_deg"])]
        self.assertGreater(len(commanded), len(rows) // 2)
        for value in commanded:
            self.assertAlmostEqual(value, -0.5 * 20.0 * 1.1714, places=2)
        wait_for(lambda: self.levels.get("DF_Plots") == DiagnosticStatus.OK, "diagnostics are content")

    def test_3_a_segment_that_is_over_gets_its_page_unasked(self):
        (table,) = self.files("circle", ".csv")
        before = len(self.rows(table))
        self.flight.tell("circle", VehiclePhase.HOME)

        def has_grown():
            with contextlib.suppress(ValueError):  # it is being written, and ends within a number
                return len(self.rows(table)) > before

        wait_for(has_grown, "the whole of the segment")

    def test_4_the_service_draws_the_one_under_way(self):
        time.sleep(2.0)
        answer = self.plot()
        self.assertTrue(answer.success)
        self.assertIn(str(self.folder), answer.message)
        self.assertEqual(len(self.files("circle_home", ".png")), 1)
        self.assertEqual(len(self.files("circle", ".png")), 1, "the first segment has kept its name")

    def test_5_what_was_not_drawn_is_drawn_at_the_end(self):
        self.flight.tell("flat8", VehiclePhase.HOME)
        time.sleep(3.0)
        self.assertEqual(self.files("flat8_home", ".csv"), [])
        rosnode.kill_nodes([NODE])
        wait_for(lambda: self.files("flat8_home", ".png"), "the last page")
        self.assertGreater(len(self.rows(self.files("flat8_home", ".csv")[0])), 5)


if __name__ == "__main__":
    init_node(NAME)
    rostest.rosrun(PACKAGE, NAME, DFPlotsTest)
