#!/usr/bin/env python3
"""serial_node and the real firmware, built for this computer, over a pseudo-terminal: messages in, PPM signal out."""

import os
import pathlib
import random
import select
import sys
import tempfile
import threading
import time
import unittest

import numpy as np
import rospy
import rostest
from node_process import LATE_S, Node
from scripted_device import PseudoTerminal
from std_msgs.msg import Header

from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import wait_for
from risc_maap_msgs.msg import PpmStatus, SerialLink
from risc_msgs.msg import Control, Controls
from risc_simulator.vehicles.iris.transmitter import TICKS_PER_US, Board, PpmReceiver

STEP_S = 0.001
LEVEL, LOWEST = 1500, 1000  # [us]
JUMP_US = 125  # largest change that the firmware accepts without a second message


class BoardOnTerminal:
    """The firmware in real time; the test may alter the bytes on the line (to_board, to_host)."""

    def __init__(self, end):
        self.to_board = self.to_host = lambda data: data
        self.channels_us = set()  # of all frames of the signal since the test cleared it
        self.newest_us = ()
        self._end, self._board, self._receiver = end, Board(), PpmReceiver()
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def refused_frames(self):
        """{reason: count} of bad frames. Ignores "no gap before", which the first frame always causes."""
        return {reason: n for reason, n in self._receiver.counts.items() if reason not in ("frames", "no gap before")}

    def plug(self, end):
        with self._lock:
            self._end = end

    def reset(self):
        with self._lock:
            self._board.reset()

    def _run(self):
        begin_s = time.monotonic()
        while not self._over.is_set():
            with self._lock:
                if self._end is not None and select.select([self._end], [], [], 0.0)[0]:
                    self._board.receive(self.to_board(os.read(self._end, 4096)))
                now_s = time.monotonic() - begin_s
                self._board.advance(now_s)
                sent = self.to_host(self._board.sent())
                if sent and self._end is not None:
                    os.write(self._end, sent)
                for _, channels in self._receiver.feed(self._board.edges(), int(1e6 * now_s) * TICKS_PER_US):
                    self.newest_us = channels
                    self.channels_us.add(channels)
            time.sleep(STEP_S)  # of simulated hardware, not a wait for anything

    def stop(self):
        self._over.set()
        self._thread.join(5.0)
        self._board.close()


def message(roll=0.0, throttle=-1.0):
    return Controls(Header(stamp=rospy.Time.now(), frame_id="cortex"), [Control("IRIS", roll, 0.0, 0.0, throttle)])


class FirmwareTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.port = PseudoTerminal(pathlib.Path(folder.name) / "ttyACM0")
        self.board = BoardOnTerminal(self.port.plug_in())
        self.addCleanup(self.port.close)
        self.addCleanup(self.board.stop)
        self.node = Node(port=self.port.url)
        self.addCleanup(self.node.end)
        self.node.wait_state(SerialLink.UP)
        self.status = self.node.listen("ppm_status", PpmStatus)
        self.publisher = self.node.publisher("controls", Controls)

    def fly(self, roll, throttle=-1.0):
        """Publish a command until the signal and ppm_status show it."""
        wanted = (round(LEVEL + 500 * roll), LEVEL, round(LEVEL + 500 * throttle), LEVEL)
        due_s = 0.0

        def shown():
            nonlocal due_s
            if time.monotonic() >= due_s:
                due_s = time.monotonic() + 0.02
                self.publisher.publish(message(roll, throttle))
            return self.board.newest_us == wanted and self.status and tuple(self.status[-1].channels_us) == wanted

        wait_for(shown, "%s, found %s" % (wanted, self.board.newest_us))
        self.assertEqual(self.status[-1].state, PpmStatus.FLYING)

    def test_messages_in_and_the_signal_out(self):
        for roll, throttle in ((0.0, -1.0), (0.1, -1.0), (-0.2, -0.5), (0.0, 0.25)):
            self.fly(roll, throttle)
        self.assertEqual(self.node.status and self.node.links[-1].refused_topics, [])
        self.assertEqual(self.board.refused_frames, {})
        # a status comes every 0.1 s, later on a busy computer
        wait_for(lambda: abs((self.status[-1].header.stamp - rospy.Time.now()).to_sec()) < 0.1, "the board's time")

    def test_noise_and_loss_on_the_line(self):
        """Commands over a noisy line: the signal shows no other command, and works afterwards."""
        rng = random.Random(2)
        self.fly(0.1)
        self.board.channels_us.clear()

        def noise(data):
            kept = bytes(byte for byte in data if rng.random() < 0.98)
            return bytes(b ^ 1 << rng.randrange(8) if rng.random() < 0.02 else b for b in kept)

        self.board.to_board = self.board.to_host = noise
        before = self.status[-1].damaged_packets

        def damaged():
            self.publisher.publish(message(0.1))
            time.sleep(0.01)  # period of the commands
            return self.status[-1].damaged_packets > before + 30 and self.node.counter("damaged") > 5

        wait_for(damaged, "damage at both ends")
        self.board.to_board = self.board.to_host = lambda data: data
        self.fly(0.1)
        shown = self.board.channels_us - {(LEVEL + 50, LEVEL, LOWEST, LEVEL)}
        # one damaged packet in 256 passes the sums, and moves a stick by at most JUMP_US; silence is the failsafe
        for roll, pitch, throttle, yaw in shown:
            self.assertTrue(LEVEL - JUMP_US <= roll <= LEVEL + 50 + JUMP_US and throttle <= LOWEST + JUMP_US, shown)
            self.assertTrue(max(abs(pitch - LEVEL), abs(yaw - LEVEL)) <= JUMP_US, shown)
        self.assertEqual(self.board.refused_frames, {})

    def test_a_dead_line_is_noticed_and_the_failsafe_is_the_boards(self):
        def line(passes):
            self.board.to_board = self.board.to_host = lambda data: data if passes else b""

        self.fly(0.1)
        ages_s = []
        for _ in range(7):
            line(True)
            self.node.wait_state(SerialLink.UP)
            ages_s.append(self.node.loss(lambda: line(False)).age_s)
        print("noticed after %s s" % np.round(ages_s, 3))
        self.assertGreaterEqual(min(ages_s), 0.3)
        self.assertLess(np.median(ages_s), 0.3 + LATE_S)
        wait_for(lambda: self.board.newest_us == (LEVEL, LEVEL, 950, LEVEL), "the failsafe")
        line(True)
        self.node.wait_state(SerialLink.UP)
        self.fly(0.1)

    def test_the_reset_button_and_the_plug(self):
        self.fly(0.1)
        self.board.reset()
        self.fly(-0.1)
        self.board.plug(None)
        self.port.unplug()
        self.node.wait_state(SerialLink.CLOSED, SerialLink.MISSING)
        self.board.plug(self.port.plug_in())
        self.node.wait_state(SerialLink.UP)
        self.fly(0.2)

    def test_a_fleet_never_reaches_the_board(self):
        self.fly(0.1)
        accepted = self.status[-1].accepted
        fleet = message(0.3)
        fleet.Obj *= 20
        self.publisher.publish(fleet)
        self.node.wait_state(SerialLink.UP, SerialLink.SIZE)
        self.fly(0.1)
        self.assertGreater(self.status[-1].accepted, accepted)
        self.assertNotIn((LEVEL + 150, LEVEL, LOWEST, LEVEL), self.board.channels_us)


if __name__ == "__main__":
    init_node("firmware_rostest")
    rostest.rosrun("rosserial_python", "firmware", FirmwareTest, sys.argv)
