"""Internal failures of ardrone_driver, tested without ROS and without an aircraft."""

import threading
from collections import Counter, deque
from types import SimpleNamespace

import pytest

pytest.importorskip("ardrone_autonomy.msg", reason="the messages are not generated: build and source the workspace")

from ardrone_autonomy.link import Phase  # noqa: E402
from ardrone_autonomy.ros import node  # noqa: E402


class Udp:
    """A stand-in for UdpThread that logs its calls."""

    def __init__(self, log):
        self.link, self._log = SimpleNamespace(phase=Phase.READY, configurations=0), log

    def start(self):
        self._log.append("start")

    def stop(self):
        self._log.append("stop")


@pytest.fixture
def log():
    return []


@pytest.fixture
def make_driver(log, monkeypatch):
    """Function (is_alone) -> ArdroneDriver, whose publishing the test replaces; ROS shuts down after 3 failures."""
    monkeypatch.setattr(node.time, "sleep", lambda _seconds: log.append("sleep"))
    thread = SimpleNamespace(start=lambda: log.append("thread"))
    monkeypatch.setattr(node.threading, "Thread", lambda *_, **__: thread)
    monkeypatch.setattr(node.rospy, "is_shutdown", lambda: log.count("fail") >= 3)
    monkeypatch.setattr(node.rospy.core, "is_shutdown_requested", lambda: False)
    monkeypatch.setattr(node.rospy, "logfatal", lambda *_: None)
    monkeypatch.setattr(node.rospy, "logerr_throttle", lambda *_: None)
    monkeypatch.setattr(node.rospy, "signal_shutdown", lambda _reason: log.append("shutdown"))

    def make(is_alone):
        driver = node.ArdroneDriver.__new__(node.ArdroneDriver)
        driver._is_alone, driver._prefix, driver._period_s = is_alone, "/risc2/", 0.02
        driver._params = SimpleNamespace(realtime_video=True, realtime_navdata=False)
        driver._waiting, driver._arrived, driver._replacing = deque(maxlen=1), threading.Event(), threading.Lock()
        driver._counts = Counter()
        driver._failing_since_s, driver._telemetry = None, SimpleNamespace()
        driver.udp = Udp(log)
        driver._make_udp = lambda: Udp(log)
        return driver

    return make


def fail(log):
    log.append("fail")
    raise RuntimeError("no picture can be published")


def test_beside_others_a_vehicle_whose_publishing_fails_lands_and_rests_before_it_tries_again(make_driver, log):
    driver = make_driver(is_alone=False)
    driver._publish_until_shutdown = lambda: fail(log)
    driver._publish_loop()
    assert log == ["fail", "stop", "sleep", "start"] * 2 + ["fail", "stop", "sleep"]


def test_alone_the_node_ends(make_driver, log):
    driver = make_driver(is_alone=True)
    driver._publish_until_shutdown = lambda: fail(log)
    driver._publish_loop()
    assert log == ["fail", "shutdown"]


def test_two_failures_at_once_replace_the_thread_once(make_driver, log):
    driver = make_driver(is_alone=False)
    failed = driver.udp
    driver._begin_again(failed)
    driver._begin_again(failed)
    assert log.count("start") == 1


def test_camera_frames_that_cannot_be_published_do_not_end_a_flight(make_driver, log):
    driver = make_driver(is_alone=True)
    driver._telemetry.publish_camera_frames = lambda: fail(log)
    driver._tick_video = lambda: None
    driver._publish_until_shutdown()
    assert driver._counts["packets not published"] == 3


def test_a_packet_that_comes_while_another_is_published_waits_for_the_next_loop(make_driver, log):
    """Otherwise a busy computer would publish above its rate, and never handle camera frames and pictures."""
    driver = make_driver(is_alone=True)
    driver._tick_video = lambda: None
    driver._telemetry.publish_camera_frames = lambda: fail(log)

    def publish(packet):
        log.append("packet")
        if packet < 50:
            driver._waiting.append(packet + 1)

    driver._publish = publish
    driver._waiting.append(0)
    driver._publish_until_shutdown()
    assert [entry for entry in log if entry != "sleep"][:3] == ["packet", "fail", "packet"]


def test_a_packet_is_there_when_its_arrival_is_told(make_driver):
    """Otherwise the publishing thread would find nothing and wait for the next packet."""
    driver = make_driver(is_alone=True)
    driver._params.realtime_navdata = True
    driver._waiting = deque(maxlen=node.REALTIME_BACKLOG)
    found = []
    driver._arrived = SimpleNamespace(set=lambda: found.append(driver._waiting[-1]))
    packets = list(range(node.REALTIME_BACKLOG + 1))
    for packet in packets:
        driver._on_packet(packet)
    assert found == packets
    assert driver._counts["skipped packets"] == 1
