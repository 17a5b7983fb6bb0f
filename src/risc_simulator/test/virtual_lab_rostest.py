#!/usr/bin/env python3
"""The node of the virtual lab: ground truth, diagnostics, fault injection."""

import math
import socket
import struct
import threading
import unittest

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from std_msgs.msg import Float64

from risc_lab.ros.publisher_updates import init_node
from risc_maap_msgs.msg import BoardMotion, FaultKinds, Faults
from risc_maap_msgs.srv import InjectFault, PutBack
from risc_msgs.msg import Cortex

HOST = ("127.213.0.1", 1510)
FRAME_RATE_REQUEST = struct.pack("<HH", 14, 20) + b"GetContextFrameRate\0"


class VirtualLabTest(unittest.TestCase):
    def collect(self, count, timeout_s=20.0):
        """[(time of receipt, message)] of the next `count` messages on /ground_truth."""
        received, full = [], threading.Event()

        def on_message(msg):
            if len(received) < count:
                received.append((rospy.get_time(), msg))
            else:
                full.set()

        subscriber = rospy.Subscriber("/ground_truth", Cortex, on_message, queue_size=1000, tcp_nodelay=True)
        self.assertTrue(full.wait(timeout_s), "only %d messages on /ground_truth" % len(received))
        subscriber.unregister()
        return received

    def host_answers(self, timeout_s=0.2):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
            client.settimeout(timeout_s)
            client.sendto(FRAME_RATE_REQUEST, HOST)
            try:
                answer = client.recv(100)
            except TimeoutError:
                return False
        self.assertEqual(struct.unpack("<HHf", answer), (15, 4, 200.0))
        return True

    def wait_until(self, condition, what, timeout_s=20.0):
        deadline_s = rospy.get_time() + timeout_s
        while not condition():
            self.assertLess(rospy.get_time(), deadline_s, what)
            rospy.sleep(0.02)

    def test_ground_truth_is_complete_and_dated_at_the_exposure(self):
        received = self.collect(400)
        stamps = [msg.header.stamp.to_sec() for _, msg in received]
        gaps = sorted(b - a for a, b in zip(stamps, stamps[1:]))
        self.assertAlmostEqual(gaps[len(gaps) // 2], 0.005, delta=1e-4)
        # A missing message would shift all later ones by 5 ms. Some may be stamped late, in a stall of this computer.
        shifts = sorted(stamp - 0.005 * k for k, stamp in enumerate(stamps))
        self.assertLess(shifts[360] - shifts[4], 0.004)
        ages = sorted(time_s - stamp for (time_s, _), stamp in zip(received, stamps))
        self.assertGreater(ages[0], 0.003 - 5e-4)  # the reported delay
        self.assertLess(ages[len(ages) // 2], 0.5)
        msg = received[-1][1]
        self.assertEqual(msg.header.frame_id, "cortex")
        self.assertEqual([(state.name, state.visible) for state in msg.Obj], [("fluffy_II", True), ("Raven", True)])
        first = msg.Obj[0]
        self.assertAlmostEqual(first.psi, 90.0, places=6)  # degrees
        self.assertEqual((round(first.x, 6), round(first.y, 6)), (0.5, 0.2))

    def test_diagnostics(self):
        seen = {}

        def on_message(msg):
            for status in msg.status:
                if status.name.endswith("virtual lab"):
                    seen.update({value.key: value.value for value in status.values})

        subscriber = rospy.Subscriber("/diagnostics", DiagnosticArray, on_message)
        self.wait_until(lambda: seen.get("risc2") == "landed" and float(seen["rate (Hz)"]) > 100, "no diagnostics")
        self.assertEqual(seen["crashes"], "0")
        subscriber.unregister()

    def test_bad_orders_do_not_end_it(self):
        board = rospy.Publisher("/virtual_lab/board", BoardMotion, queue_size=20)
        light = rospy.Publisher("/virtual_lab/light", Float64, queue_size=20)
        self.wait_until(lambda: board.get_num_connections() and light.get_num_connections(), "no subscriber")
        for bad in (float("nan"), float("inf"), -1.0):
            board.publish("risc1", bad)
            light.publish(bad)
        board.publish("risc9", 1.0)
        rospy.wait_for_service("/virtual_lab/inject", 20.0)
        self.assertTrue(rospy.ServiceProxy("/virtual_lab/inject", InjectFault)().success)
        self.collect(10)

    def test_faults(self):
        told = []
        subscriber = rospy.Subscriber("/virtual_lab/faults", Faults, told.append, queue_size=100)
        self.addCleanup(subscriber.unregister)
        rospy.wait_for_service("/virtual_lab/inject", 20.0)
        inject = rospy.ServiceProxy("/virtual_lab/inject", InjectFault)
        self.assertTrue(inject().success)  # ends faults of other tests
        for bad, cause in (
            ({"fault": "fire"}, "fire"),
            ({"fault": "mocap_blackout", "duration_s": [-1.0]}, "duration_s"),
            ({"fault": "wind", "severity": [0.1, 0.2]}, "severity"),
            ({"fault": "wind", "severity": [math.nan]}, "severity"),
            ({"fault": "wind", "vehicle": "risc9"}, "risc9"),
            ({"fault": "drop", "channel": "risc1/nav"}, "risc1/nav"),
            ({"fault": "wind", "start_s": -3.0}, "past"),
            ({"fault": "wind", "start_s": math.nan}, "start_s"),
            ({"fault": "node_kill"}, "./maap fly"),
        ):
            answer = inject(**bad)
            self.assertFalse(answer.success, bad)
            self.assertIn(cause, answer.message)
            self.assertNotIn("\n", answer.message)
        self.assertTrue(self.host_answers(15.0))

        before_s = rospy.get_time()
        answer = inject(fault="blackhole", duration_s=[math.inf], channel="cortex/requests", start_s=1.0)
        after_s = rospy.get_time()
        self.assertTrue(answer.success, answer.message)

        def of_it():
            """Records of this fault before it has an end, oldest first."""
            records = [record for message in list(told) for record in message.faults]
            return [record for record in records if record.ends.is_zero() and record.begins.to_sec() > before_s]

        self.wait_until(of_it, "not told")
        waiting = of_it()[0]
        self.assertFalse(waiting.active)
        self.assertGreater(waiting.begins.to_sec(), before_s + 0.5)
        self.assertLess(waiting.begins.to_sec(), after_s + 1.5)
        self.assertEqual((waiting.args, waiting.ends.to_sec()), ("inf,channel=cortex/requests", 0.0))
        self.assertIn("landed", waiting.safe)
        self.wait_until(lambda: any(record.active for record in told[-1].faults), "it does not begin")
        self.assertFalse(self.host_answers())

        self.assertTrue(inject(fault="wind", severity=[0.5], vehicle="risc2", start_s=60.0).success)
        self.assertTrue(inject().success)
        self.wait_until(lambda: told[-1].faults and not any(record.active for record in told[-1].faults), "no end")
        blackhole, wind = told[-1].faults
        self.assertEqual((blackhole.id, wind.vehicle), (waiting.id, "risc2"))
        self.assertGreater(blackhole.ends, blackhole.begins)
        self.assertLess(wind.ends, wind.begins, "it never began")
        self.wait_until(self.host_answers, "the fault does not end")
        self.assertTrue(inject(fault="wind", vehicle="risc1", start_s=60.0).success)
        self.wait_until(lambda: [record.name for record in told[-1].faults] == ["wind"], "what is over is told once")
        self.assertTrue(inject().success)

    def test_put_back(self):
        rospy.wait_for_service("/virtual_lab/put_back", 20.0)
        put_back = rospy.ServiceProxy("/virtual_lab/put_back", PutBack)
        answer = put_back("risc9")
        self.assertFalse(answer.success)
        self.assertIn("risc1, risc2", answer.message)
        for which in ("risc2", ""):
            answer = put_back(which)
            self.assertTrue(answer.success, answer.message)

    def test_faults_are_offered(self):
        kinds = {kind.name: kind for kind in rospy.wait_for_message("/virtual_lab/fault_kinds", FaultKinds, 20.0).kinds}
        blackout, wind = kinds["mocap_blackout"], kinds["wind"]
        self.assertEqual((blackout.argument, blackout.unit, blackout.per_vehicle), ("duration_s", "s", False))
        self.assertEqual(dict(zip(blackout.grades, blackout.grade_values))["severe"], 3.0)
        self.assertEqual((wind.argument, wind.unit, wind.per_vehicle), ("severity", "m/s", True))
        self.assertTrue(all(kind.least <= kind.default_value <= kind.greatest for kind in kinds.values()))


if __name__ == "__main__":
    init_node("virtual_lab_rostest")
    rostest.rosrun("risc_simulator", "virtual_lab_rostest", VirtualLabTest)
