"""The thread of a line: what ends it, and what other threads see of the link."""

import os
import sys
import threading
import time
from types import SimpleNamespace

import pytest
from diagnostic_updater import DiagnosticStatusWrapper
from scripted_device import PseudoTerminal, announcement, topic_of
from std_msgs.msg import UInt32

from risc_lab.testing import wait_for
from rosserial_python.link import Link, State
from rosserial_python.ports import SerialPort
from rosserial_python.protocol import Decoder, Id, encode
from rosserial_python.ros import node
from rosserial_python.session import Session
from rosserial_python.settings import SerialParams

ANSWER = encode(Id.TIME, bytes(8)) + announcement(Id.PUBLISHER, topic_of(125, "board_status", UInt32))


@pytest.fixture
def terminal(tmp_path):
    """(board's end, port at the other end)."""
    pair = PseudoTerminal(tmp_path / "ttyACM0")
    yield pair.plug_in(), SerialPort(pair.url, 57600, 10.0)
    pair.close()


@pytest.mark.parametrize("is_alone", [True, False], ids=["alone", "one of several boards"])
def test_a_defect_ends_the_line_and_a_node_that_has_no_other(monkeypatch, terminal, is_alone):
    """Alone, the node ends and is restarted; otherwise it would live on without serving its line."""
    end, port = terminal
    ends = []
    monkeypatch.setattr(node.rospy, "signal_shutdown", lambda reason: ends.append(device.close()))
    monkeypatch.setattr(Link, "received", lambda *_: {}["defect"])
    device = node.Device(port, SerialParams(), lambda message: None, once=not is_alone)
    os.write(end, ANSWER)
    wait_for(lambda: device.session.is_over, "the thread's end")
    assert len(ends) == is_alone and device.session.link.facts.state is State.CLOSED
    device.close()


def test_a_silent_board_is_not_asked_again_after_the_goodbye(monkeypatch, terminal):
    """It would answer by publishing again, with no host to receive it."""
    end, port = terminal
    monkeypatch.setattr(Link, "idle", False)  # the goodbye takes as long as it may
    session = Session(port, 0.05, lambda packet: None, pytest.fail)
    session.start()
    wait_for(lambda: session.link.facts.counts["requests"] > 1, "questions")
    assert session.stop()
    packets = Decoder().feed(os.read(end, 4096), 0.0)
    assert len(packets) > 2 and packets[-1].topic_id == Id.TX_STOP


def test_diagnostics_and_the_session_share_a_link(tmp_path):
    """Changing a deque or dict while another thread iterates over it raises RuntimeError there."""
    device = node.Device(SerialPort(str(tmp_path / "none"), 57600, 10.0), SerialParams(), lambda message: None)
    line = SimpleNamespace(byte_s=1e-4, write=len, queued=lambda: 0)
    link, over, interval_s = device.session.link, threading.Event(), sys.getswitchinterval()

    def serve():
        while not over.is_set():
            link.opened(line, time.monotonic())
            for data in (ANSWER, *100 * [b"noise"]):
                link.received(data, time.monotonic())
            link.closed(time.monotonic())

    thread = threading.Thread(target=serve)
    sys.setswitchinterval(1e-6)
    try:
        thread.start()
        for _ in range(2000):
            device.fill(DiagnosticStatusWrapper())
            device.tell(again=True)
    finally:
        sys.setswitchinterval(interval_s)
        over.set()
        thread.join()
        device.close()
