#!/usr/bin/env python3
"""serial_node against a scripted board: both directions, noise, silence, reset, unplugging, a stall, the end."""

import contextlib
import itertools
import json
import os
import pathlib
import random
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import unittest

import numpy as np
import rospy
import rostest
from diagnostic_msgs.msg import DiagnosticStatus
from node_process import LATE_S, Node
from rosgraph_msgs.msg import Log
from scripted_device import BUFFER_BYTES, Board, Listener, PseudoTerminal, serialised, topic_of
from std_msgs.msg import Header, String, UInt32
from std_srvs.srv import SetBool, SetBoolRequest, SetBoolResponse, Trigger, TriggerResponse

from risc_lab.ros.publisher_updates import init_node
from risc_lab.testing import LIMIT_S, wait_for
from risc_maap_msgs.msg import SerialLink
from risc_msgs.msg import Control, Controls
from rosserial_msgs.msg import Log as DeviceLog
from rosserial_msgs.srv import RequestParamRequest, RequestParamResponse
from rosserial_python.protocol import Id, encode

MAX_AGE_S = 0.25  # ~max_age
CONTROLS, NUMBERS, STATUS = 100, 101, 125  # ids of the board's topics
TOPICS = {
    Id.PUBLISHER: [topic_of(STATUS, "board_status", UInt32)],
    Id.SUBSCRIBER: [topic_of(CONTROLS, "controls", Controls), topic_of(NUMBERS, "numbers", UInt32)],
}
ALIVE = serialised(UInt32(7))
BEAT = encode(STATUS, ALIVE)


def commands(number, vehicles=1, stamp=None):
    header = Header(stamp=stamp or rospy.Time.now(), frame_id="cortex")
    return Controls(header, [Control("IRIS", number, 0.0, 0.0, -1.0)] * vehicles)


def reasons(status):
    """Reasons for refused topics in a DiagnosticStatus."""
    return [item.value for item in status.values if item.key.startswith("refused ") and item.value]


@contextlib.contextmanager
def scene(is_network=False, topics=TOPICS, beat=BEAT, ready=True, **params):
    """(board, its port, node) on a pseudo-terminal or over TCP."""
    with tempfile.TemporaryDirectory() as folder, Board(topics, beat=beat) as board:
        if is_network:
            port = Listener(board)
        else:
            port = PseudoTerminal(pathlib.Path(folder) / "ttyACM0")
            board.plug(port.plug_in())
        node = Node(port=port.url, **params)
        try:
            if ready:
                node.wait_state(SerialLink.UP)
            yield board, port, node
        finally:
            code = node.end()
            board.plug(None)
            port.close()
        assert code == 0, code


def works(board, node, number=1.0):
    """Wait until commands reach the board, and its status the ROS graph."""
    heard, publisher = node.listen("board_status", UInt32), node.publisher("controls", Controls)
    before = len(board.of_topic(CONTROLS))

    def came():
        publisher.publish(commands(number))
        return len(board.of_topic(CONTROLS)) > before and heard

    wait_for(came, "messages in both directions")


def times(board):
    """Times that the board was told; the first may answer the request that precedes its announcements."""
    return [rospy.Time(*struct.unpack("<II", payload)) for payload in board.of_topic(Id.TIME)]


def connected(port):
    """Connect to a node that is about to listen."""
    made = []

    def attempt():
        with contextlib.suppress(OSError):
            made.append(socket.create_connection(("127.0.0.1", port), 1.0))
        return made

    wait_for(attempt, "the node to listen")
    made[0].setblocking(False)
    return made[0]


class SerialNodeTest(unittest.TestCase):
    def test_both_directions(self):
        for is_network in (False, True):
            with scene(is_network) as (board, _, node):
                heard, publisher = node.listen("board_status", UInt32), node.publisher("controls", Controls)
                message = commands(0.25)
                message.header.stamp = rospy.Time()  # without a stamp it cannot become too old on a slow computer
                publisher.publish(message)
                wait_for(lambda b=board, h=heard: b.of_topic(CONTROLS) and h, "messages in both directions")
                self.assertEqual(board.of_topic(CONTROLS), [serialised(message)])
                self.assertEqual({m.data for m in heard}, {7})
                self.assertIn([node.namespace + "/board_status", "std_msgs/UInt32"], rospy.get_published_topics())
                wait_for(lambda: any(s.level == DiagnosticStatus.OK for s in node.status), "diagnostics")
                self.assertEqual(node.status[-1].name, node.name.lstrip("/") + ": rosserial_python")

    def test_time_log_and_parameters(self):
        with scene() as (board, _, node):
            rospy.set_param(node.namespace + "/gains", [1.5, 2])
            rospy.set_param(node.name + "/text", "hi")
            rospy.set_param(node.namespace + "/tree", {"a": 1})
            before = rospy.Time.now()
            board.received.clear()
            board.send(encode(Id.TIME, bytes(8)))
            board.send(encode(Id.LOG, serialised(DeviceLog(DeviceLog.WARN, "the voltage is low"))))
            wait_for(lambda: any(before <= told for told in times(board)), "the time")
            self.assertLessEqual(max(times(board)), rospy.Time.now())
            wait_for(lambda: (Log.WARN, "the voltage is low") in node.logs, "its log")
            expected = {
                "gains": RequestParamResponse(floats=[1.5, 2.0]),
                "~text": RequestParamResponse(strings=["hi"]),
                "tree": RequestParamResponse(),
                "missing": RequestParamResponse(),
            }
            for count, (name, response) in enumerate(expected.items(), 1):
                board.send(encode(Id.PARAMETER, serialised(RequestParamRequest(name))))
                wait_for(lambda n=count: len(board.of_topic(Id.PARAMETER)) == n, name)
                self.assertEqual(board.of_topic(Id.PARAMETER)[-1], serialised(response), name)
            wait_for(lambda: node.said("/missing,"), "a reason")

    def test_nothing_of_a_damaged_packet_is_published_and_noise_ends_without_a_trace(self):
        noise = random.Random(1)
        with scene() as (board, _, node):
            heard = node.listen("board_status", UInt32)
            works(board, node)

            def damage(data):
                data = bytearray(data)
                for _ in range(noise.randrange(1, 4)):
                    data[noise.randrange(len(data))] ^= 1 << noise.randrange(8)
                return bytes(data[: noise.randrange(1, len(data))]) if noise.random() < 0.3 else bytes(data)

            board.damage = damage
            for _ in range(300):
                board.send(noise.randbytes(noise.randrange(1, 80)))
                board.send(damage(BEAT))
            wait_for(lambda: node.links[-1].counters and node.counter("damaged") > 50, "damage to be counted")
            board.damage = lambda data: data
            works(board, node)
            # an 8-bit sum lets some damage pass: that is a valid UInt32, or it is refused
            self.assertLess(sum(m.data != 7 for m in heard), 10)
            node.wait_state(SerialLink.UP)

    def test_damage_that_the_checksum_cannot_see_is_refused_by_its_type(self):
        with scene(beat=b"") as (board, _, node):
            heard = node.listen("board_status", UInt32)
            for payload in (ALIVE + b"\0", ALIVE[:-1], b""):
                board.send(encode(STATUS, payload))
            board.send(encode(Id.LOG, b"\x01\xff\xff\xff\xff"))
            board.send(encode(Id.PUBLISHER, b"nonsense"))
            board.send(BEAT)
            wait_for(lambda: heard, "the sound one")
            wait_for(lambda: node.counter("bad payloads") == 5, "the others to be counted")
            self.assertEqual([m.data for m in heard], [7])

    def test_a_dead_link_is_noticed_and_comes_back_by_itself(self):
        ages_s = []
        for is_network in (False, True):
            for beat in (BEAT, b""):  # a board that publishes, and a quiet one
                with scene(is_network, beat=beat) as (board, _, node):
                    for _ in range(2):
                        board.beat = beat
                        lost = node.loss(lambda b=board: setattr(b, "is_silent", True))
                        self.assertEqual((lost.cause, round(lost.limit_s, 6)), (SerialLink.STOPPED, 0.3))
                        ages_s.append(lost.age_s)
                        board.reset()
                        board.is_silent, board.beat = False, BEAT
                        node.wait_state(SerialLink.UP)
                        works(board, node)
        print("noticed after %s s" % np.round(ages_s, 3))
        self.assertGreaterEqual(min(ages_s), 0.3)
        self.assertLess(np.median(ages_s), 0.3 + LATE_S)
        with scene(silence=0.5) as (board, _, node):  # the control arm: a later detection is measured as such
            self.assertGreater(node.loss(lambda: setattr(board, "is_silent", True)).age_s, 0.3 + LATE_S)

    def test_a_reset_board_is_asked_for_its_topics(self):
        with scene() as (board, _, node):
            works(board, node)
            for _ in range(3):
                board.reset()
                wait_for(lambda: board.is_configured, "the request")
                works(board, node)

    def test_another_sketch_after_a_reset(self):
        with scene() as (board, _, node):
            works(board, node)
            board.announced = {Id.SUBSCRIBER: [topic_of(CONTROLS, "words", String)]}
            board.reset()
            publisher = node.publisher("words", String)
            board.received.clear()
            publisher.publish("hello")
            wait_for(lambda: board.of_topic(CONTROLS), "its new topic")
            self.assertEqual(board.of_topic(CONTROLS), [serialised(String("hello"))])

    def test_unplugged_and_plugged_in_again(self):
        with scene() as (board, port, node):
            works(board, node)
            board.plug(None)
            port.unplug()
            node.wait_state(SerialLink.CLOSED, SerialLink.MISSING)
            board.reset()
            board.plug(port.plug_in())
            node.wait_state(SerialLink.UP)
            works(board, node)

    def test_the_path_leads_to_another_device_while_the_old_one_is_still_open(self):
        with scene() as (board, port, node):
            works(board, node)
            old = port._ends  # the old line is silent, but never hung up
            board.plug(port.plug_in())
            board.reset()
            wait_for(lambda: board.is_configured, "the node to open the new device")
            works(board, node)
            for end in old:
                os.close(end)

    def test_a_connection_that_ends_or_is_cut_is_made_again(self):
        with scene(is_network=True) as (board, port, node):
            for _ in range(3):
                works(board, node)
                connection = port._connection
                board.reset()
                connection.shutdown(socket.SHUT_RDWR)
                wait_for(lambda c=connection: port._connection is not c and board.is_configured, "the next connection")

    def test_after_a_stall_no_old_command_comes(self):
        """The board stops reading, at 200 commands a second, and resumes when the link has been lost for 1 s.

        Commands that the line's buffer took before the loss was noticed come late; later ones do not come.
        """

        def old_ones(**params):
            with scene(**params) as (board, _, node):
                publisher = node.publisher("controls", Controls)
                works(board, node)
                over, count = threading.Event(), itertools.count(1)

                def stream():
                    while not over.wait(0.005):
                        publisher.publish(commands(next(count)))

                thread = threading.Thread(target=stream)
                thread.start()
                try:
                    wait_for(lambda: len(board.of_topic(CONTROLS)) > 20, "commands")
                    with board._lock:
                        board.is_stalled = board.is_silent = True
                    if not params:
                        node.wait_state(SerialLink.WAITING)
                    lost = rospy.Time.now()
                    wait_for(lambda: rospy.Time.now() - lost > rospy.Duration(1.0), "the stall's end")
                    begin = rospy.Time.now()
                    with board._lock:
                        board.received.clear()
                        board.is_stalled = board.is_silent = False
                    stamps = []

                    def fresh():
                        for payload in board.of_topic(CONTROLS)[len(stamps) :]:
                            message = Controls()
                            message.deserialize(payload)
                            stamps.append(message.header.stamp)
                        return stamps and stamps[-1] > begin

                    wait_for(fresh, "commands of now")
                    return sum(lost < stamp < begin - rospy.Duration(MAX_AGE_S) for stamp in stamps)
                finally:
                    over.set()
                    thread.join()

        self.assertEqual(old_ones(), 0)
        without = old_ones(silence=1e3, max_age=1e3, baud=12000000)
        self.assertGreater(without, 10, "with the protections off there are old ones, or this test shows nothing")

    def test_a_message_that_is_old_when_it_comes_is_not_sent(self):
        with scene() as (board, _, node):
            publisher = node.publisher("controls", Controls)
            works(board, node)
            passed = Controls(Header(), commands(4.0).Obj)  # without a stamp: never late; sent after those of `works`
            publisher.publish(passed)
            wait_for(lambda: serialised(passed) in board.of_topic(CONTROLS), "one without a stamp")
            reports = len(node.links)
            wait_for(lambda: len(node.links) >= reports + 2, "a report that counts those of `works`")
            before = node.counter("late")  # may be above 0 on a busy computer
            old = commands(5.0, stamp=rospy.Time.now() - rospy.Duration(2.0))
            publisher.publish(old)
            wait_for(lambda: node.counter("late") == before + 1, "a report")
            works(board, node, 6.0)
            self.assertNotIn(serialised(old), board.of_topic(CONTROLS))

    def test_a_fleet_does_not_fit(self):
        with scene() as (board, _, node):
            publisher = node.publisher("controls", Controls)
            works(board, node)
            board.received.clear()
            message = commands(1.0, vehicles=20)
            self.assertGreater(len(serialised(message)), BUFFER_BYTES)
            publisher.publish(message)
            node.wait_state(SerialLink.UP, SerialLink.SIZE)
            self.assertEqual(node.links[-1].oversized_topics, ["controls"])
            wait_for(lambda: node.said("NAMESPACE/controls"), "the cure")
            self.assertNotIn(serialised(message), board.of_topic(CONTROLS))

    def test_other_definitions_are_refused_and_the_rest_works(self):
        topics = {
            Id.PUBLISHER: [*TOPICS[Id.PUBLISHER], topic_of(126, "texts", String, md5sum=32 * "0")],
            Id.SUBSCRIBER: [*TOPICS[Id.SUBSCRIBER], topic_of(102, "x", String)._replace(type="no_such/Type")],
        }
        with scene(topics=topics) as (board, _, node):
            node.wait_state(SerialLink.UP, SerialLink.TYPES)
            wait_for(lambda: node.links[-1].refused_topics == ["texts", "x"], "both to be refused")
            wait_for(lambda: any(len(reasons(status)) == 2 for status in node.status), "the reasons")
            works(board, node)

    def test_a_service_of_the_board_and_one_that_it_calls(self):
        topics = {
            **TOPICS,
            Id.SERVER_RESPONSE: [topic_of(130, "blink", SetBool, half="_response_class")],
            Id.SERVER_REQUEST: [topic_of(110, "blink", SetBool, half="_request_class")],
            Id.CLIENT_REQUEST: [topic_of(131, "ask", Trigger, half="_request_class")],
            Id.CLIENT_RESPONSE: [topic_of(111, "ask", Trigger, half="_response_class")],
        }
        with scene(topics=topics) as (board, _, node):
            service = rospy.Service(node.namespace + "/ask", Trigger, lambda _: TriggerResponse(True, "yes"))
            answer = encode(130, serialised(SetBoolResponse(True, "on")))
            board.on_packet = lambda packet: answer if packet.topic_id == 110 else b""
            rospy.wait_for_service(node.namespace + "/blink", LIMIT_S)
            response = rospy.ServiceProxy(node.namespace + "/blink", SetBool)(SetBoolRequest(True))
            self.assertEqual((response.success, response.message), (True, "on"))
            self.assertEqual(board.of_topic(110), [serialised(SetBoolRequest(True))])

            def asked():
                board.send(encode(131, b""))
                return board.of_topic(111)

            wait_for(asked, "the answer")
            self.assertEqual(board.of_topic(111)[0], serialised(TriggerResponse(True, "yes")))
            service.shutdown()

    def test_what_is_wrong_with_a_port_has_a_name(self):
        with tempfile.TemporaryDirectory() as folder:
            missing = Node(port=folder + "/ttyACM9")
            missing.wait_state(SerialLink.CLOSED, SerialLink.MISSING)
            self.assertEqual(missing.end(), 0)
        with scene() as (_, port, _):
            second = Node(port=port.url)
            second.wait_state(SerialLink.CLOSED, SerialLink.TAKEN)
            self.assertEqual(second.end(), 0)
        refused = Node(port="socket://127.0.0.1:1")
        refused.wait_state(SerialLink.CLOSED, SerialLink.UNREACHABLE)
        self.assertEqual(refused.end(), 0)
        with scene(ready=False) as (board, _, node):
            board.is_silent = True
            node.wait_state(SerialLink.WAITING, SerialLink.SILENT)
        for noise, cause in (
            (bytes(range(0, 250, 3)), SerialLink.SPEED),
            (bytes.fromhex("ffff0a0008000000000000000000ed"), SerialLink.VERSION),
        ):
            with scene(topics={}, beat=b"", ready=False) as (board, _, node):
                board.damage = lambda data, noise=noise: noise
                node.wait_state(SerialLink.WAITING, cause)

    def test_the_doctor_hears_of_it(self):
        """It also names the other process that has the terminal open: this one."""
        command = [sys.executable, "-m", "risc_doctor", "--only", "serial", "--json"]
        for is_network, code, text in ((True, "speed", "socket://"), (False, "shared", "(pid %d)" % os.getpid())):
            with scene(is_network, topics={}, beat=b"", ready=False) as (board, _, node):
                board.damage = lambda data: bytes(range(0, 250, 3))
                node.wait_state(SerialLink.WAITING, SerialLink.SPEED)
                done = subprocess.run(command, capture_output=True, text=True, timeout=2 * LIMIT_S)
                (finding,) = json.loads(done.stdout)
                self.assertEqual((finding["check"], finding["code"], finding["level"]), ("serial", code, "red"))
                self.assertIn(text, finding["text"])

    def test_nonsense_parameters_are_one_line(self):
        for arguments, params, text in (
            (("/dev/x", "1", "2"), {}, "two arguments"),
            (("tcp", "many"), {}, "TCP port"),
            ((), {"baud": "fast"}, "baud"),
            ((), {"port": "socket://nowhere"}, "socket://HOST:PORT"),
            ((), {"port": "rfc2217://127.0.0.1:1"}, "rfc2217://127.0.0.1:1"),
        ):
            node = Node(*arguments, output=subprocess.PIPE, **params)
            wait_for(lambda n=node: n.process.poll() is not None, "the end")
            output = node.process.stdout.read()
            self.assertEqual(node.end(), 1)
            self.assertEqual([text in line for line in output.splitlines() if "[INFO]" not in line], [True], output)

    def test_listening_and_several_devices(self):
        with socket.create_server(("127.0.0.1", 0)) as free:
            number = free.getsockname()[1]
        of_all = "/rosserial_embeddedlinux"
        for is_fork, is_of_all in ((False, False), (True, False), (True, True)):
            if is_of_all:
                rospy.set_param(of_all, {"tcp_port": number, "fork_server": True})
                self.addCleanup(rospy.delete_param, of_all)
            node = Node("tcp") if is_of_all else Node("tcp", str(number), fork_server=is_fork)
            boards, connections = [], []
            try:
                for k in range(2 if is_fork else 1):
                    topics = {Id.SUBSCRIBER: [topic_of(CONTROLS, "board%d/numbers" % k, UInt32)]}
                    board = Board(topics)
                    boards.append(board)

                    connections.append(connected(number))
                    board.plug(connections[-1].fileno())
                for k, board in enumerate(boards):
                    node.publisher("board%d/numbers" % k, UInt32).publish(k)
                    wait_for(lambda b=board, k=k: b.of_topic(CONTROLS) == [serialised(UInt32(k))], "its number")
                self.assertEqual(node.end(), 0)
            finally:
                node.end()
                for board in boards:
                    board.stop()
                for connection in connections:
                    connection.close()

    def test_at_the_end_the_board_is_told_to_be_quiet(self):
        for is_network in (False, True):
            with scene(is_network) as (board, _, node):
                works(board, node)
                self.assertEqual(node.end(), 0)
                wait_for(lambda b=board: b.of_topic(Id.TX_STOP), "TX_STOP")
                self.assertFalse(board.is_configured)


if __name__ == "__main__":
    init_node("serial_node_rostest")
    rostest.rosrun("rosserial_python", "serial_node", SerialNodeTest, sys.argv)
