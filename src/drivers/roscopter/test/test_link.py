"""The thread on real devices, without ROS: pseudo terminals, UDP, TCP; loss and return."""

import errno
import os
import random
import socket
import termios
import threading
import time
import tty

import pytest
import scripted_autopilot
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from scripted_autopilot import Running

from risc_lab.testing import wait_for
from roscopter import orders
from roscopter.link import Link
from roscopter.options import Options
from roscopter.transport import open_device

LIMIT_S = 30.0
HOST = "127.0.0.1"
STICKS = [1500] * 8


class Driver:
    """A Link; records its reports and messages."""

    def __init__(self, device, **options):
        self.reports, self.messages, self.failures = [], [], []
        self.link = Link(
            Options(device=device, **options),
            lambda *report: self.reports.append(report),
            self.messages.append,
            self.failures.append,
        )

    def __enter__(self):
        self.link.start()
        return self

    def __exit__(self, *_):
        self.link.stop()
        assert self.failures == []

    def said(self, level):
        return [text for each, text in self.reports if each == level]

    def hears(self):
        """Wait for new telemetry."""
        before = len(self.messages)
        wait_for(lambda: "ATTITUDE" in {message.get_type() for message in self.messages[before:]}, "telemetry")

    def order(self, order):
        outcomes = []
        self.link.post(self.link.autopilot.begin, order, outcomes.append)
        wait_for(lambda: outcomes, "the outcome of " + order.what)
        return outcomes[0]


@pytest.fixture
def serial(tmp_path):
    return tmp_path / "ttyUSB0"


@pytest.fixture(params=["pseudo terminal", "UDP"])
def where(request, serial):
    return serial if request.param == "pseudo terminal" else (HOST, 0)


@pytest.mark.parametrize("version", [1, 2])
def test_telemetry_and_orders(where, version):
    with Running(where, version=version) as vehicle, Driver(vehicle.device) as driver:
        driver.hears()
        assert driver.order(orders.Arm(True, 10.0)).is_done and vehicle.is_armed


def test_a_serial_device_that_goes_and_comes(serial):
    with Driver(str(serial)) as driver:
        wait_for(lambda: driver.said("error"), "a word about the missing device")
        for _ in range(2):
            with Running(serial):
                driver.hears()
            wait_for(lambda: not driver.link.autopilot.is_open, "the loss")
            tried_s = driver.link._reopen_s
            wait_for(lambda tried_s=tried_s: driver.link._reopen_s > tried_s, "another try")
        assert [text.split(" (")[0] for text in driver.said("error")] == [
            "cannot open %s" % serial,
            *["lost %s" % serial] * 2,
        ]
        assert driver.link.counts["times opened"] == 2


def test_an_order_to_a_device_that_is_not_there_fails_at_once(serial):
    with Driver(str(serial)) as driver:
        wait_for(lambda: driver.said("error"), "a word about the missing device")
        assert not driver.order(orders.Arm(True, 10.0)).is_done


def test_a_vehicle_on_udp_that_goes_and_comes():
    with Running((HOST, 0)) as first:
        address = first._line.socket.getsockname()
        with Driver(first.device) as driver:
            driver.hears()
            first.stop()
            wait_for(lambda: not driver.link.autopilot.is_connected, "the loss")
            with Running(address):
                driver.hears()
            assert len(driver.said("error")) == 1 and driver.link.autopilot.counts["reconnects"] == 1


def test_two_drivers_do_not_share_a_serial_device(serial):
    with Running(serial) as vehicle, Driver(vehicle.device) as first:
        first.hears()
        with Driver(vehicle.device) as second:
            wait_for(lambda: second.said("error"), "a word about the device that is taken")
        first.hears()


def test_one_that_listens_answers_the_vehicle_and_nobody_else():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((HOST, 0))
        address = probe.getsockname()
    vehicle, stranger = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    packer = mavlink.MAVLink(None, 1, 1)
    with vehicle, stranger, Driver("udpin:%s:%d" % address) as driver:
        wait_for(lambda: driver.link.autopilot.is_open, "the device")
        stranger.sendto(b"let me in", address)
        vehicle.settimeout(LIMIT_S)
        stranger.setblocking(False)
        vehicle.sendto(mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3).pack(packer), address)
        assert vehicle.recv(4096)
        stranger.sendto(b"and me", address)
        vehicle.sendto(mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3).pack(packer), address)
        assert vehicle.recv(4096)
        with pytest.raises(BlockingIOError):
            stranger.recv(4096)


def frames(system, roll_rad=0.0):
    """Heartbeat and attitude of a vehicle."""
    packer = mavlink.MAVLink(None, system, 1)
    heartbeat = mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3)
    attitude = mavlink.MAVLink_attitude_message(0, roll_rad, 0.0, 0.0, 0.0, 0.0, 0.0)
    return heartbeat.pack(packer) + attitude.pack(packer)


@pytest.fixture
def network():
    """(Socket of the vehicle, socket of a stranger with another address, free address for the link)."""
    net = "127.%d.%d." % (64 + os.getpid() % 128, os.getpid() // 128 % 256)
    vehicle, stranger, ours = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3))
    with vehicle, stranger:
        with ours:
            for number, sock in enumerate((vehicle, stranger, ours), 2):
                sock.bind((net + str(number), 0))
                sock.settimeout(LIMIT_S)
            address = ours.getsockname()
        yield vehicle, stranger, address


def deceive(network, device):
    """A Driver that heard a vehicle, and a stranger that claims to be this vehicle and reports a roll angle."""
    vehicle, stranger, address = network
    with Driver(device) as driver:
        wait_for(lambda: driver.link.autopilot.is_open, "the device")
        for _ in range(2):
            vehicle.sendto(frames(1), address)
            assert vehicle.recv(4096)
            for _ in range(100):
                stranger.sendto(frames(1, roll_rad=1.0), address)
        received = driver.link.counts["received bytes"]
        vehicle.sendto(frames(1), address)  # arrives after all that the stranger sent
        wait_for(lambda: driver.link.counts["received bytes"] > received, "the vehicle")
    return driver


def heard_rolling(driver):
    return any(getattr(message, "roll", 0.0) > 0.5 for message in driver.messages)


def test_the_first_that_is_heard_stays_the_vehicle(network):
    driver = deceive(network, "udpin:%s:%d" % network[2])
    assert not heard_rolling(driver)
    assert str(driver.link.strangers).startswith(network[1].getsockname()[0])
    assert sum("is refused" in text for text in driver.said("warn")) == 1


def test_without_the_check_of_addresses_a_stranger_is_the_vehicle(network, monkeypatch):
    """The control arm."""
    monkeypatch.setattr("roscopter.transport.OneSender.is_from", lambda *_: True)
    assert heard_rolling(deceive(network, "udpin:%s:%d" % network[2]))


def test_a_vehicle_that_is_named_is_heard_alone_from_the_start(network):
    vehicle, stranger, address = network
    with Driver("udpin:%s:%d:%s" % (*address, vehicle.getsockname()[0])) as driver:
        wait_for(lambda: driver.link.autopilot.is_open, "the device")
        stranger.sendto(frames(1), address)
        wait_for(lambda: driver.link.strangers.count, "the refusal")
        assert driver.link.autopilot.target is None
        vehicle.sendto(frames(7), address)
        assert vehicle.recv(4096)
        assert driver.link.autopilot.target == (7, 1)


def test_tcp_that_is_closed_and_comes_again():
    with socket.create_server((HOST, 0)) as server:
        device = "tcp:%s:%d" % server.getsockname()
        server.settimeout(LIMIT_S)
        with Driver(device) as driver:
            for _ in range(2):
                connection, _ = server.accept()
                with connection:
                    vehicle = scripted_autopilot.Autopilot()
                    connection.settimeout(0.02)
                    deadline_s = time.monotonic() + LIMIT_S
                    driver.messages.clear()
                    while "ATTITUDE" not in {message.get_type() for message in driver.messages}:
                        assert time.monotonic() < deadline_s
                        vehicle.advance(time.monotonic())
                        connection.sendall(vehicle.take())
                        try:
                            vehicle.receive(connection.recv(4096), time.monotonic())
                        except TimeoutError:
                            continue
                wait_for(lambda: not driver.link.autopilot.is_open, "the loss")
        assert sum("lost tcp" in text for text in driver.said("error")) == 2


def test_a_server_that_hangs_up_at_once_is_one_line():
    """As a server does that serves one client at a time, and has one already."""
    with socket.create_server((HOST, 0)) as server:
        server.settimeout(LIMIT_S)
        with Driver("tcp:%s:%d" % server.getsockname()) as driver:
            for _ in range(4):
                server.accept()[0].close()
                opened = driver.link.counts["times opened"]
            wait_for(lambda: driver.link.counts["times opened"] >= opened, "the last connection")
        assert len(driver.said("error")) == 1 and len(driver.said("info")) == 1


def test_a_device_that_is_forbidden_says_what_to_do(serial, monkeypatch):
    def refuse(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("roscopter.transport.open_device", refuse)
    with Driver(str(serial)) as driver:
        wait_for(lambda: driver.said("error"), "the error")
        assert "dialout" in driver.said("error")[0]


def test_a_line_that_takes_nothing_does_not_stop_what_comes(serial):
    """A serial line buffers a few kilobytes. What it does not take is lost, telemetry goes on, and no partial message
    is on the line when it takes bytes again.
    """
    master, slave = os.openpty()
    tty.setraw(slave)
    os.symlink(os.ttyname(slave), serial)
    packer = mavlink.MAVLink(None, 1, 1)
    with Driver(str(serial), enable_rc_control=True) as driver:
        wait_for(lambda: driver.link.autopilot.is_open, "the device")
        os.write(master, mavlink.MAVLink_heartbeat_message(2, 3, 81, 0, 3, 3).pack(packer))
        wait_for(lambda: driver.messages, "the heartbeat")

        def flood():
            driver.link.post(driver.link.autopilot.override, STICKS, time.monotonic())
            return driver.link.counts["not sent"] > 10

        wait_for(flood, "the line to be full")
        before = len(driver.messages)
        os.write(master, mavlink.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0).pack(packer))
        wait_for(lambda: len(driver.messages) > before, "telemetry")
        parser, taken, sent = mavlink.MAVLink(None), [], driver.link.counts["sent bytes"]
        parser.robust_parsing = True

        def empty():
            driver.link.post(driver.link.autopilot.override, STICKS, time.monotonic())
            taken.extend(parser.parse_buffer(os.read(master, 65536)) or ())
            return driver.link.counts["sent bytes"] > sent + 2000

        wait_for(empty, "the line to be used again")
    assert {message.get_type() for message in taken} >= {"RC_CHANNELS_OVERRIDE"}
    assert not any(message.get_type() == "BAD_DATA" for message in taken)
    for end in (master, slave):
        os.close(end)


def test_channels_are_given_back_when_it_ends(where):
    with Running(where) as vehicle:
        with Driver(vehicle.device, enable_rc_control=True, rc_timeout=60_000) as driver:
            driver.hears()
            driver.link.post(driver.link.autopilot.override, [1400] * 8, time.monotonic())
            wait_for(lambda: vehicle.channels_us() == [1400] * 8, "the override")
        wait_for(lambda: vehicle.channels_us() == list(scripted_autopilot.RADIO_US), "the release")
        sent = vehicle.named("RC_CHANNELS_OVERRIDE")
        assert [message.chan1_raw for message in sent][-1] == 0


def test_damaged_bytes_cost_only_their_own_messages(where):
    """One byte in 100 is damaged; received values are correct, and messages keep coming."""
    numbers = random.Random(5)

    def spoil(data):
        return bytes(byte ^ 0x55 if numbers.random() < 0.01 else byte for byte in data)

    with Running(where) as vehicle, Driver(vehicle.device) as driver:
        driver.hears()
        vehicle.spoils = spoil
        driver.messages.clear()
        wait_for(lambda: len(driver.messages) > 50, "messages")
        assert driver.link.autopilot.reader.skipped_bytes > 100
        known = scripted_autopilot.TELEMETRY["attitude"]
        for message in driver.messages:
            if message.get_type() == "ATTITUDE":
                assert message.roll == pytest.approx(known["roll"]) and message.yaw == pytest.approx(known["yaw"])


def test_what_is_posted_is_done_while_bytes_rain():
    """Reading 2000 garbage datagrams per second must not delay an order."""
    with Running((HOST, 0)) as vehicle, Driver(vehicle.device) as driver:
        driver.hears()
        over = threading.Event()

        def rain():
            noise = os.urandom(1000)
            while not over.wait(0.0005):
                vehicle._line.write(noise)

        thread = threading.Thread(target=rain)
        thread.start()
        try:
            assert driver.order(orders.Arm(True, 10.0)).is_done
        finally:
            over.set()
            thread.join()


def test_a_line_that_goes_while_it_is_opened_is_one_that_is_not_there(monkeypatch):
    def unplugged(*_args, **_options):
        raise termios.error(errno.EIO, "Input/output error")

    monkeypatch.setattr("serial.Serial", unplugged)
    with pytest.raises(OSError, match="Input/output error"):
        open_device("/dev/ttyUSB0", 57600)
