"""Schedule, clock and configuration of the virtual cameras, without a lab."""

import logging
import os
import select
import socket
import time

import numpy as np
import pytest

from ardrone_autonomy.protocol.video import StreamParser
from risc_lab.lab import FleetVehicle, Start, load_templates, load_vehicle_type
from risc_lab.lab.fleet import Fleet, MocapEndpoint
from risc_simulator.faults import Wires
from risc_simulator.notices import Notices
from risc_simulator.vehicles.ardrone.host import ArdroneHost, Ports
from risc_simulator.video.blackboard import BITRATES_KBIT_S, RATES_HZ, Blackboard, Snapshot
from risc_simulator.video.host import VideoHost, begin_s
from risc_simulator.video.launcher import VehicleVideo, VideoLauncher
from risc_simulator.video.server import Station
from risc_simulator.virtual_lab import VirtualLab
from risc_simulator.world import World

FRONT, BOTTOM = 0, 1
ADDRESS = "127.94.%d.%d" % (os.getpid() // 250 % 250, 1 + os.getpid() % 250)  # tests may run side by side
RATE_HZ, BITRATE_KBIT_S = 20.0, 4000.0
PATIENCE_S = 60.0  # for a process to start on a busy computer


class GreyEye:
    """Takes the same small picture of whatever it is asked to look at."""

    @staticmethod
    def look(_row):
        return np.full((48, 64, 3), 90, np.uint8)


def wait_for(sock):
    assert select.select([sock], (), (), PATIENCE_S)[0]


@pytest.fixture
def listener():
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as sock:
        sock.bind((ADDRESS, 0))
        sock.listen(4)
        yield sock


@pytest.fixture
def watched(listener):
    """(Station, function that gives the next so many PaVE headers that its client receives)."""
    station = Station(
        listener,
        [GreyEye, GreyEye],
        latency_s=0.0,
        notices=Notices(logging.getLogger(), "risc1"),
        stream=Wires().stream("risc1/video"),
    )
    client = socket.create_connection(listener.getsockname(), PATIENCE_S)
    parser = StreamParser()
    wait_for(listener)
    station.on_readable(listener)

    def headers(count):
        found = []
        while len(found) < count:
            found += [packet.header for packet in parser.feed(client.recv(1 << 16))]
        return found

    yield station, headers
    client.close()
    station.close()


def expose(station, lab_s):
    station.expose(Snapshot(0.0, lab_s, np.zeros((1, 12))), 0, FRONT, RATE_HZ, BITRATE_KBIT_S)
    station.send(1.0, lab_s, link_up=True)


def test_the_rhythm_is_absolute_and_what_the_computer_missed_is_counted(watched):
    station, _ = watched
    assert station.due_s(RATE_HZ, 100.0) == 100.0
    expose(station, 1.0)
    assert station.due_s(RATE_HZ, 100.01) == pytest.approx(100.05)
    assert station.due_s(RATE_HZ, 100.17) == pytest.approx(100.15) and station.skipped == 2


def test_lateness_is_that_of_the_pictures_that_came_soonest(watched):
    station, _ = watched
    station.due_s(RATE_HZ, 100.0)
    assert station.late_s == 0.0
    for k, late_s in enumerate((0.02, 0.03, 0.5)):
        station.expose(Snapshot(100.0 + k, 1.0 + k, np.zeros((1, 12))), 0, FRONT, RATE_HZ, BITRATE_KBIT_S)
        station.send(100.0 + k + late_s, 1.0 + k, link_up=True)
    assert 0.02 <= station.late_s < 0.03


def test_what_is_due_waits_for_no_camera_that_draws(monkeypatch):
    listeners = [socket.create_server((ADDRESS, 0)) for _ in range(3)]
    clients = [socket.create_connection(listener.getsockname(), PATIENCE_S) for listener in listeners]
    vehicles = tuple(
        FleetVehicle("risc%d" % k, template, "ardrone", "127.93.1.%d" % k, Start((0.5 * k, 0.0, 0.0)))
        for k, template in enumerate(("fluffy_II", "albatross", "Raven"), 1)
    )
    board = Blackboard(3)
    host = VideoHost(Fleet("three", MocapEndpoint(ADDRESS), vehicles), 1, board, listeners)
    for listener, station in zip(listeners, host._stations.values()):
        wait_for(listener)
        station.on_readable(listener)
    done = []
    monkeypatch.setattr(VideoHost, "_expose", lambda _host, index, *_: done.append("draw %d" % index))
    for index, station in host._stations.items():
        monkeypatch.setattr(station, "send", lambda *_, index=index, **__: done.append("send %d" % index))
    for _ in range(2):  # the first tells the lab that somebody watches
        board.publish(time.monotonic(), 1.0, np.zeros((3, 12)))
        host._work()
    everything = ["send 0", "send 1", "send 2"]
    drawn = [k for k, what in enumerate(done) if what.startswith("draw")]
    assert len(drawn) >= 3
    for k in drawn:
        assert done[max(0, k - 3) : k] == everything, done
    host.close()
    board.close()
    for client in clients:
        client.close()


def test_a_camera_that_is_off_misses_nothing(watched):
    station, _ = watched
    station.due_s(RATE_HZ, 100.0)
    expose(station, 1.0)
    assert station.due_s(RATE_HZ, 103.0, is_on=False) is None
    assert station.due_s(RATE_HZ, 105.0) == 105.0, "begins anew"
    assert station.skipped == 0


def test_no_two_pictures_of_one_time(watched):
    """A lab that stands still for a moment must not look like an aircraft whose clock has been set back."""
    station, headers = watched
    station.due_s(RATE_HZ, 100.0)
    for lab_s in (1.0, 1.005, 1.005, 1.0051, 1.01):
        expose(station, lab_s)
    found = headers(3)
    assert [header.timestamp_ms for header in found] == [1000, 1005, 1010]
    assert [header.frame_number for header in found] == [0, 1, 2]
    assert (station.pictures, station.skipped) == (3, 2)


def fleet_of_one(calibration=""):
    vehicle = FleetVehicle("risc1", "fluffy_II", "ardrone", ADDRESS, Start((0.5, 0.0, 0.0)), calibration)
    return Fleet("one", MocapEndpoint(ADDRESS), (vehicle,))


@pytest.fixture
def host():
    """An aircraft with its video, whose camera process does not run."""
    fleet = fleet_of_one()
    world = World(fleet, {"ardrone": load_vehicle_type("ardrone")}, load_templates())
    host = ArdroneHost(world.vehicles["risc1"], ADDRESS, Ports(0, 0, 0, 0))
    launcher = VideoLauncher(fleet, 0, [host.video_listener])
    host.attach_video(VehicleVideo(launcher, 0))
    yield host, launcher
    host.close()
    launcher.close()


def send(host, *commands):
    """AT commands of which each is "NAME,arguments", in one datagram."""
    send.sequence += len(commands)
    first = send.sequence - len(commands) + 1
    texts = ["AT*%s=%d,%s\r" % (c.split(",", 1)[0], first + k, c.split(",", 1)[1]) for k, c in enumerate(commands)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.sendto("".join(texts).encode("ascii"), (ADDRESS, host.ports.at))
    (at,) = [s for s in host.sockets() if isinstance(s, socket.socket) and s.getsockname()[1] == host.ports.at]
    wait_for(at)
    host.on_readable(at, 0.0)


send.sequence = 0


@pytest.mark.parametrize("number", ["-7", "0", "99999999999999999999", "9" * 400, "1e300"])
def test_no_number_in_the_configuration_is_too_much(host, number):
    host, launcher = host
    for key in ("video:video_channel", "video:codec_fps", "video:max_bitrate"):
        send(host, 'CONFIG,"%s","%s"' % (key, number))
    board = launcher.board
    assert host.statistics()["config_writes"] == 3
    assert board.channel[0] in (FRONT, BOTTOM)
    assert RATES_HZ[0] <= board.rate_hz[0] <= RATES_HZ[1]
    assert BITRATES_KBIT_S[0] <= board.bitrate_kbit_s[0] <= BITRATES_KBIT_S[1]


def test_another_session_brings_its_own_values(host):
    host, launcher = host
    send(host, 'CONFIG,"custom:session_id","11111111"')
    ids = 'CONFIG_IDS,"11111111","%s","%s"' % host.configuration.current_ids[1:]
    send(host, ids, 'CONFIG,"video:video_channel","1"')
    assert launcher.board.channel[0] == BOTTOM
    send(host, 'CONFIG,"custom:session_id","22222222"')
    assert launcher.board.channel[0] == FRONT, "a new session begins with the defaults"
    send(host, 'CONFIG,"custom:session_id","11111111"')
    assert launcher.board.channel[0] == BOTTOM


def test_a_closed_host_has_no_sockets_while_cameras_run(host, monkeypatch):
    host, _ = host
    monkeypatch.setattr(VideoLauncher, "may_start", False)  # as while the camera process runs
    host.watch_streams()
    assert host.video_listener not in host.sockets()
    host.close()
    assert host.sockets() == []


def test_a_file_that_cannot_be_used_is_told_once(listener, caplog):
    launcher = VideoLauncher(fleet_of_one(calibration="/nowhere/camera.yaml"), 0, [listener])
    try:
        launcher.start()
        deadline_s = time.monotonic() + PATIENCE_S
        with caplog.at_level(logging.ERROR):
            while launcher.running:
                assert time.monotonic() < deadline_s, "the camera process goes on without its calibration"
                time.sleep(0.05)
                launcher.check()
        assert not launcher.may_start and "start the lab again" in caplog.text
        assert launcher._rest_until_s == float("inf")
    finally:
        launcher.close()


def test_a_file_that_cannot_be_used_is_told_before_anybody_watches(caplog):
    """With cameras that start with the lab: not when the first client looks in vain."""
    with caplog.at_level(logging.ERROR):
        lab = VirtualLab(fleet_of_one(calibration="/nowhere/camera.yaml"), cameras_ahead=True)
        try:
            deadline_s = time.monotonic() + PATIENCE_S
            while "start the lab again" not in caplog.text:
                assert time.monotonic() < deadline_s, "nothing was said"
                lab.run(duration_s=lab.exposure_s + 0.2)
            assert not lab.cameras_ready
        finally:
            lab.close()


def test_a_computer_that_cannot_start_a_process_does_not_end_the_lab(listener, caplog, monkeypatch):
    def refuse(*_arguments, **_options):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr("risc_simulator.video.launcher.subprocess.Popen", refuse)
    launcher = VideoLauncher(fleet_of_one(), 0, [listener])
    launcher.start()
    assert not launcher.running and not launcher.may_start and "unavailable" in caplog.text
    launcher.close()


def test_no_picture_is_begun_just_before_one_is_sent():
    assert begin_s(1.0, 1.001, 0.03, []) <= 1.001
    assert begin_s(1.0, 1.001, 0.03, [1.006, 1.050]) == 1.006, "after what would come in the middle of the work"
    assert begin_s(1.0, 1.001, 0.03, [0.999, 1.050]) <= 1.001
    assert begin_s(1.0, 1.029, 0.03, [1.035]) == 1.030, "it does not wait for ever"
    assert begin_s(1.0, 1.031, 0.03, [1.035]) <= 1.031
