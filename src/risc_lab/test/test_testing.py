"""risc_lab.ros.testing.publishers_heard against a publisher that keeps its subscriber waiting."""

import socket
import struct
import threading
from xmlrpc.server import SimpleXMLRPCServer

import pytest

rospy = pytest.importorskip("rospy")

import rosgraph  # noqa: E402
from rospy.impl.tcpros_base import TCPROSTransport  # noqa: E402
from rospy.impl.tcpros_pubsub import TCPROSSub  # noqa: E402
from std_msgs.msg import Bool  # noqa: E402

from risc_lab.ros.testing import publishers_heard  # noqa: E402


def header(**fields):
    """TCPROS header, as bytes on the wire."""
    lines = [("%s=%s" % item).encode() for item in fields.items()]
    body = b"".join(struct.pack("<I", len(line)) + line for line in lines)
    return struct.pack("<I", len(body)) + body


@pytest.fixture
def connections(monkeypatch):
    """List of the rows that every node reports as its connections (getBusInfo)."""
    told = []
    with SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False) as node:
        node.register_function(lambda _caller: [1, "bus info", told], "getBusInfo")
        monkeypatch.setattr(rosgraph.Master, "lookupNode", lambda *_: "http://127.0.0.1:%d" % node.server_address[1])
        thread = threading.Thread(target=node.serve_forever)
        thread.start()
        yield told
        node.shutdown()
        thread.join()


def test_a_publisher_counts_when_its_header_has_come_and_it_sends_to_us(connections):
    subscriber = rospy.Subscriber("/heard", Bool, lambda _message: None)
    transport = TCPROSTransport(TCPROSSub("/heard", Bool), "/heard")
    here, there = socket.socketpair()
    try:
        subscriber.impl.add_connection(transport)
        transport.set_socket(here, "/lidar")
        assert subscriber.get_num_connections() == 1 and publishers_heard(subscriber) == set()
        there.sendall(header(callerid="/lidar", type=Bool._type, md5sum=Bool._md5sum))
        transport.read_header()
        ours = rospy.get_name()
        for row in [1, ours, "o", "TCPROS", "/other"], [2, ours, "i", "TCPROS", "/heard"]:
            connections.append([*row, True, ""])
            assert publishers_heard(subscriber) == set()
        connections.append([3, ours, "o", "TCPROS", "/heard", True, ""])
        assert publishers_heard(subscriber) == {"/lidar"}
    finally:
        there.close()
        transport.close()
        subscriber.unregister()
