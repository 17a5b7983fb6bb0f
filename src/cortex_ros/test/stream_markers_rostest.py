#!/usr/bin/env python3
"""stream_markers against a small Cortex host: messages, stamps, diagnostics, loss of the host, arguments."""

import math
import os
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
import unittest

import roslib.packages
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from risc_lab.ros.launching import free_tcp_port
from risc_lab.ros.publisher_updates import init_node
from risc_maap_msgs.msg import MocapStatus, MocapTime
from risc_msgs.msg import Mocap_data

MISSING = 9999999.0
DELAY_S = 0.003
RATE_HZ = 100.0
PATIENCE_S = 60.0


def packet(code, payload=b""):
    return struct.pack("<HH", code, len(payload)) + payload


def frame(number):
    """One body, two markers, the second missing; reported delay DELAY_S."""
    body = b"fluffy_II\0" + struct.pack("<i", 2)
    body += struct.pack("<6f", 1000.5, -2000.0, 3000.0, MISSING, MISSING, MISSING)
    body += struct.pack("<ii", 0, 0)
    return packet(
        13, struct.pack("<ii", number, 1) + body + struct.pack("<5i", 0, 0, 0, 0, 0) + struct.pack("<if", 0, DELAY_S)
    )


class Host(threading.Thread):
    """Answers on its command port and streams to a multicast group over loopback while live."""

    texts = {
        b"GetConversionToMillimeters": struct.pack("<f", 1.0),
        b"GetUpAxis": struct.pack("<i", 2),
        b"GetContextFrameRate": struct.pack("<f", RATE_HZ),
        b"LiveMode": b"",
        b"Pause": b"",
    }

    def __init__(self, address, stream_port):
        super().__init__(daemon=True)
        self.command = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.command.bind((address, 0))
        self.stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.stream.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        self.stream.bind((address, 0))
        self.port = self.command.getsockname()[1]
        self.group = ("225.1.1.1", stream_port)
        self.silent = False
        self.live = False
        self.number = 0
        self.closing = False
        self.heard = []

    def run(self):
        due = time.monotonic()
        while not self.closing:
            readable, _, _ = select.select([self.command], [], [], max(0.0, due - time.monotonic()))
            if readable:
                self.answer(*self.command.recvfrom(65536))
            if time.monotonic() >= due:
                due += 1.0 / RATE_HZ
                self.number += 1
                if self.live and not self.silent:
                    self.stream.sendto(frame(self.number), self.group)

    def answer(self, data, client):
        code = struct.unpack_from("<H", data)[0]
        text = data[4:].split(b"\0")[0]
        self.heard.append(text if code == 14 else code)
        if self.silent:
            return
        if code == 0:
            self.command.sendto(packet(2, b"Cortex".ljust(128, b"\0") + bytes((1, 5, 3, 1))), client)
        elif code == 10:
            self.command.sendto(packet(11, struct.pack("<iii", 0, 0, 0)), client)
        elif code == 12:
            self.command.sendto(frame(self.number), client)
        elif code == 14:
            self.live = {b"LiveMode": True, b"Pause": False}.get(text, self.live)
            known = text in self.texts
            self.command.sendto(packet(15, self.texts[text]) if known else packet(16), client)

    def close(self):
        self.closing = True
        self.join()
        self.command.close()
        self.stream.close()


class Inbox:
    """Collects messages of a topic, newest last."""

    def __init__(self, topic, kind):
        self.messages = []
        self.subscriber = rospy.Subscriber(topic, kind, self.messages.append, queue_size=1000, tcp_nodelay=True)

    def wait_for(self, condition, patience_s=PATIENCE_S):
        """Wait for and return the newest message that meets the condition; AssertionError after patience_s."""
        deadline = time.monotonic() + patience_s
        while time.monotonic() < deadline:
            for message in reversed(self.messages):
                if condition(message):
                    return message
            time.sleep(0.01)
        raise AssertionError("no such message within %.0f s" % patience_s)


class StreamMarkersTest(unittest.TestCase):
    def setUp(self):
        process = os.getpid()
        self.address = "127.%d.%d.9" % (200 + process % 50, process // 50 % 250)
        self.stream_port = free_tcp_port()  # used for UDP; Linux gives it to no other program either
        self.host = Host(self.address, self.stream_port)
        self.host.start()
        self.node = None
        self.name = "stream_markers_%d" % time.monotonic_ns()
        self.markers = Inbox("/mocap_data", Mocap_data)
        self.times = Inbox("/mocap_time", MocapTime)
        self.diagnostics = Inbox("/diagnostics", DiagnosticArray)
        self.statuses = Inbox("/mocap_status", MocapStatus)

    def tearDown(self):
        if self.node is not None and self.node.poll() is None:
            self.node.send_signal(signal.SIGINT)
            self.node.wait(PATIENCE_S)
        self.host.close()
        for inbox in (self.markers, self.times, self.diagnostics, self.statuses):
            inbox.subscriber.unregister()

    def start_node(self, *arguments, **params):
        program = roslib.packages.find_node("cortex_ros", "stream_markers")
        self.assertTrue(program, "stream_markers is not built")
        lab = {"host": self.address, "command_port": self.host.port, "stream_port": self.stream_port}
        remaps = ["_%s:=%s" % item for item in dict(lab, **params).items() if item[1] is not None]
        self.node = subprocess.Popen(
            list(program[:1]) + list(arguments) + remaps + ["__name:=" + self.name],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            universal_newlines=True,
        )

    def status(self, level):
        def has_it(message):
            return any(s.name.startswith(self.name) and s.level == level and s.values for s in message.status)

        message = self.diagnostics.wait_for(has_it)
        return next(s for s in message.status if s.name.startswith(self.name))

    def test_messages_stamps_and_diagnostics(self):
        self.start_node()
        message = self.markers.wait_for(lambda m: True)
        self.assertEqual(message.header.frame_id, "cortex")
        self.assertEqual([body.name for body in message.Obj], ["fluffy_II"])
        first, second = message.Obj[0].marker
        self.assertEqual((first.x, first.y, first.z), (1000.5 * 0.001, -2.0, 3.0))
        self.assertTrue(all(math.isnan(v) for v in (second.x, second.y, second.z)))

        # One of the two topics may have connected earlier: use any frame that came on both.
        reference = self.times.wait_for(lambda m: m.header.stamp in [x.header.stamp for x in self.markers.messages])
        stamp = reference.header.stamp
        self.assertLessEqual(abs(reference.frame - self.host.number), 1000)
        self.assertGreaterEqual((reference.receipt - stamp).to_sec(), DELAY_S - 1e-6)
        self.assertAlmostEqual(reference.delay, DELAY_S, places=6)
        self.assertLess((reference.receipt - stamp).to_sec(), 5.0)
        self.assertLess(abs(rospy.get_time() - stamp.to_sec()), 5.0)

        status = self.status(DiagnosticStatus.OK)
        values = {value.key: value.value for value in status.values}
        self.assertEqual(values["host"], "%s:%d" % (self.address, self.host.port))
        self.assertEqual(values["mode"], "stream")
        self.assertEqual(values["malformed"], "0")
        self.assertAlmostEqual(float(values["reported delay [s]"]), DELAY_S, places=5)
        self.assertIn(b"LiveMode", self.host.heard)
        told = self.statuses.wait_for(lambda m: m.up and m.rate_hz > 0.0 and m.frames)
        self.assertLess(told.age_s, 5.0)
        counters = {counter.name: counter.count for counter in told.counters}
        self.assertEqual((counters["malformed"], counters["duplicates"]), (0, 0))

    def test_survives_the_loss_of_the_host(self):
        self.start_node()
        self.markers.wait_for(lambda m: True)
        self.host.silent = True
        del self.diagnostics.messages[:]  # they include "host down" from before it was found
        self.assertIn("host down", self.status(DiagnosticStatus.ERROR).message)
        self.host.live = False
        self.host.silent = False
        restart = rospy.Time.now()
        self.markers.wait_for(lambda m: m.header.stamp > restart)
        self.assertGreaterEqual(self.host.heard.count(b"LiveMode"), 2)
        self.node.send_signal(signal.SIGTERM)
        output = self.node.communicate(timeout=PATIENCE_S)[0]
        self.assertEqual(self.node.returncode, 0)
        self.assertEqual(output.count("cortex host is down"), 1, output)
        self.assertEqual(output.count("is back"), 1, output)

    def test_legacy_arguments_and_legacy_value(self):
        self.start_node("127.0.0.1", self.address, host=None, missing_as_nan="false", mode="poll", pause_on_exit="true")
        message = self.markers.wait_for(lambda m: True)
        second = message.Obj[0].marker[1]
        self.assertEqual((second.x, second.y, second.z), (9999.999, 9999.999, 9999.999))
        self.node.send_signal(signal.SIGINT)
        self.assertEqual(self.node.wait(PATIENCE_S), 0)
        self.assertIn(b"Pause", self.host.heard)

    def test_waits_for_its_own_address(self):
        self.start_node(local_address="192.0.2.77")  # a documentation address: no computer has it
        status = self.status(DiagnosticStatus.ERROR)
        self.assertIn("192.0.2.77", status.message)
        self.assertIsNone(self.node.poll())
        self.node.send_signal(signal.SIGINT)
        output = self.node.communicate(timeout=PATIENCE_S)[0]
        self.assertEqual(self.node.returncode, 0)
        self.assertEqual(output.count("cannot search for the Cortex host yet"), 1, output)

    def test_a_hello_in_the_name_of_the_host_stops_no_frames(self):
        self.start_node()
        self.markers.wait_for(lambda m: True)
        time.sleep(1.1)  # a second set-up within 1 s is not made
        asked = self.host.heard.count(b"GetUpAxis")
        first = self.times.wait_for(lambda m: True).frame
        self.host.stream.sendto(packet(0, b"Cortex".ljust(128, b"\0") + bytes((1, 5, 3, 1))), self.host.group)
        self.times.wait_for(lambda m: m.frame >= first + 50)
        self.assertGreater(self.host.heard.count(b"GetUpAxis"), asked)
        numbers = [m.frame for m in self.times.messages if m.frame >= first]
        self.assertEqual(numbers, list(range(first, first + len(numbers))))

    def test_a_host_with_another_axis_up_is_refused_until_it_has_z_up(self):
        self.host.texts = dict(self.host.texts)
        self.host.texts[b"GetUpAxis"] = struct.pack("<i", 1)
        self.start_node()
        told = (DiagnosticStatus.ERROR, "up axis is y: nothing is published")
        self.diagnostics.wait_for(lambda m: any(s.level == told[0] and told[1] in s.message for s in m.status))
        self.assertTrue(self.host.live)
        self.assertEqual(self.markers.messages, [])
        self.host.texts[b"GetUpAxis"] = struct.pack("<i", 2)
        time.sleep(1.1)  # a second set-up within 1 s is not made
        self.host.stream.sendto(packet(0, b"Cortex".ljust(128, b"\0") + bytes((1, 5, 3, 1))), self.host.group)
        self.markers.wait_for(lambda m: True)

    def test_bad_parameters_end_the_node_with_a_reason(self):
        for params, reason in (
            ({"host": None}, "host is missing"),
            ({"source": "sundial"}, "must be one of: cortex"),
            ({"mode": "steam"}, "mode must be auto, stream or poll"),
            ({"command_port": 70000}, "must be a port from 1 to 65535"),
            ({"stream_group": "10.0.0.1"}, "not a multicast address"),
            ({"live_on_start": "perhaps"}, "wrong type"),
            ({"frame_rate": 0.5}, "frame rate must be from 1 to 10000 Hz"),
            ({"max_delay": 1e9}, "max_delay must be from 0 to 10 s"),
        ):
            self.name += "x"
            self.start_node(**params)
            output = self.node.communicate(timeout=PATIENCE_S)[0]
            self.assertEqual(self.node.returncode, 1, output)
            self.assertIn(reason, output)


if __name__ == "__main__":
    init_node("stream_markers_test")
    rostest.rosrun("cortex_ros", "stream_markers", StreamMarkersTest, sys.argv)
