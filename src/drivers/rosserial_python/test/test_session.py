"""What others see of a link while its thread changes it."""

import sys
import threading
import time
from types import SimpleNamespace

from diagnostic_updater import DiagnosticStatusWrapper
from scripted_device import announcement, topic_of
from std_msgs.msg import UInt32

from rosserial_python.ports import SerialPort
from rosserial_python.protocol import Id, encode
from rosserial_python.ros import node
from rosserial_python.settings import SerialParams

ANSWER = encode(Id.TIME, bytes(8)) + announcement(Id.PUBLISHER, topic_of(125, "board_status", UInt32))


def test_diagnostics_and_the_session_share_a_link(tmp_path):
    """A deque or dict that changes while another thread iterates over it is a RuntimeError there."""
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
