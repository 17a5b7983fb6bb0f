"""What reaches a subscriber through a DirectConnection, on real sockets."""

import socket
import threading

import pytest

rospy_topics = pytest.importorskip("rospy.topics")

from risc_lab.ros.direct_connection import DirectConnection, send_directly  # noqa: E402

LENGTH = 30000


class Transport:
    """The part of rospy's TCPROSTransport that a connection uses, around a socket."""

    def __init__(self, sock):
        self.socket, self.done = sock, False
        self.stat_bytes = self.stat_num_msg = 0
        self.threads = set()

    def set_cleanup_callback(self, callback):
        self.cleanup = callback

    def write_data(self, data):
        self.threads.add(threading.current_thread())
        self.socket.sendall(data)
        self.stat_bytes += len(data)
        self.stat_num_msg += 1

    def close(self):
        self.done = True
        self.socket.close()
        self.cleanup(self)


@pytest.fixture(name="link")
def _link():
    here, there = socket.socketpair()
    here.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2 * LENGTH)
    there.settimeout(10.0)
    transport = Transport(here)
    yield transport, there
    there.close()
    transport.close()


def message(number):
    """A message with its number in every byte pair."""
    return number.to_bytes(2, "big") * (LENGTH // 2)


def read(sock, length):
    data = b""
    while len(data) < length:
        part = sock.recv(length - len(data))
        assert part, "closed after %d of %d bytes" % (len(data), length)
        data += part
    return data


def test_a_ready_subscriber_is_served_by_the_publishing_thread(link):
    transport, there = link
    connection = DirectConnection(transport, 10)
    for number in range(200):
        connection.write_data(message(number)[:500])
        assert read(there, 500) == message(number)[:500]
    assert transport.threads == set()
    assert (transport.stat_num_msg, transport.stat_bytes) == (200, 200 * 500)


def test_nobody_waits_for_a_subscriber_that_does_not_read_and_messages_stay_whole(link):
    transport, there = link
    connection = DirectConnection(transport, 3)
    count = 300  # far more than the socket's buffers hold: this would block for ever if it waited
    for number in range(count):
        connection.write_data(message(number))
    received = []
    while not received or received[-1] != count - 1:
        data = read(there, LENGTH)
        number = int.from_bytes(data[:2], "big")
        assert data == message(number), "a message was torn"
        received.append(number)
    assert received == sorted(set(received)), "out of order"
    assert received[:2] == [0, 1]
    assert received[-3:] == [count - 3, count - 2, count - 1], "the oldest are dropped, not the newest"
    assert len(received) < count
    connection.write_data(message(7))  # a subscriber that has caught up is served again
    assert read(there, LENGTH) == message(7)


def test_with_queue_size_0_nothing_is_lost(link):
    transport, there = link
    connection = DirectConnection(transport, 0)
    writer = threading.Thread(target=lambda: [connection.write_data(message(number)) for number in range(300)])
    writer.start()
    assert [int.from_bytes(read(there, LENGTH)[:2], "big") for _ in range(300)] == list(range(300))
    writer.join(10.0)


def test_a_subscriber_that_goes_away_is_reported_to_the_publisher(link):
    transport, there = link
    connection = DirectConnection(transport, 10)
    connection.write_data(b"first")
    there.close()
    with pytest.raises(OSError, match=".*"):
        for _ in range(1000):
            connection.write_data(b"nobody there")
            threading.Event().wait(0.005)


def test_publishers_of_a_process_send_directly_once_asked_for(monkeypatch):
    monkeypatch.setattr(rospy_topics, "QueuedConnection", rospy_topics.QueuedConnection)
    send_directly()
    assert rospy_topics.QueuedConnection is DirectConnection
