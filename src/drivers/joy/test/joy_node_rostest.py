#!/usr/bin/env python3
"""joy_node end to end, on records written to a FIFO."""

import os
import pathlib
import signal
import struct
import time
import unittest
from xmlrpc.client import ServerProxy

import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import Joy, JoyFeedback, JoyFeedbackArray

from risc_lab.ros.publisher_updates import init_node
from risc_lab.ros.testing import Listener, publishers_heard, wait_for

BUTTON, AXIS, INIT = 0x01, 0x02, 0x80
TIMEOUT_S = 60.0


def record(value, kind, number):
    return struct.pack("=IhBB", 0, value, kind, number)


def status_is(level):
    """Predicate: diagnostics report this level for the joystick."""

    def fits(array):
        return any("Joystick Driver Status" in status.name and status.level == level for status in array.status)

    return fits


def hang(duration_s, meanwhile):
    """Stop the node for duration_s (SIGSTOP), and call meanwhile() while it is stopped."""
    pid = ServerProxy(rospy.get_master().lookupNode("/joy_node")[2]).getPid("/test")[2]
    os.kill(pid, signal.SIGSTOP)
    meanwhile()
    time.sleep(duration_s)
    os.kill(pid, signal.SIGCONT)


class JoyNodeTest(unittest.TestCase):
    def test_device_appears_works_vanishes_and_returns(self):
        path = pathlib.Path(rospy.get_param("/joy_node/dev"))
        joy = Listener("joy", Joy)
        diagnostics = Listener("/diagnostics", DiagnosticArray)
        wait_for(lambda: publishers_heard(joy.subscriber), "a publisher of joy")
        diagnostics.wait_for(status_is(2), "status 'not open' while the device is missing")

        os.mkfifo(str(path))
        self.addCleanup(path.unlink)
        with open(str(path), "wb", buffering=0) as stick:  # waits until the node has opened it
            announced = b"".join(record(0, BUTTON | INIT, n) for n in range(11))
            announced += b"".join(record(32767, AXIS | INIT, n) for n in range(8))
            stick.write(announced)
            first = joy.nth(1)
            self.assertEqual((list(first.buttons), list(first.axes)), ([0] * 11, [0.0] * 8))
            self.assertEqual(first.header.frame_id, str(path))
            self.assertLess(abs((rospy.Time.now() - first.header.stamp).to_sec()), TIMEOUT_S)

            stick.write(record(1, BUTTON, 6)[:5])
            stick.write(record(1, BUTTON, 6)[5:] + record(0, BUTTON, 6))
            self.assertEqual((joy.nth(2).buttons[6], joy.nth(3).buttons[6]), (1, 0))

            stick.write(record(-32767, AXIS, 6) + record(32767, AXIS, 7))
            moved = joy.nth(4)
            self.assertEqual((moved.axes[6], moved.axes[7]), (1.0, -1.0), "one message for both axes")
            diagnostics.wait_for(status_is(0), "status OK")

            feedback = rospy.Publisher("joy/set_feedback", JoyFeedbackArray, queue_size=1, latch=True)
            feedback.publish(array=[JoyFeedback(type=JoyFeedback.TYPE_RUMBLE, id=0, intensity=1.0)])
            stick.write(record(1, BUTTON, 10))
            self.assertEqual(joy.nth(5).buttons[10], 1, "feedback to a device without rumble must not matter")
            time.sleep(0.1)
            self.assertEqual(len(joy.messages), 5, "without autorepeat only changes are published")

            hang(2.0, lambda: stick.write(record(1, BUTTON, 6) + record(0, BUTTON, 6)))
            self.assertEqual(joy.nth(6).buttons[6], 0, "a press of the time in which the node hung is old")
            stick.write(record(1, BUTTON, 3))
            self.assertEqual((joy.nth(7).buttons[3], len(joy.messages)), (1, 7))
            reports = len(diagnostics.messages)
        diagnostics.wait_for(status_is(2), "status 'not open' after the other end has gone", after=reports)
        with open(str(path), "wb", buffering=0) as stick:  # the node must come back for it
            stick.write(record(1, BUTTON, 0))
            again = joy.nth(8)
            self.assertEqual((list(again.buttons), list(again.axes)), ([1], []), "a fresh state after a loss")


if __name__ == "__main__":
    init_node("joy_node_test")
    rostest.rosrun("joy", "joy_node_test", JoyNodeTest)
