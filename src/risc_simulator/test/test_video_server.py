"""Schedule, clock and configuration of the virtual cameras, without a lab."""

import logging
import select
import socket
import time
from types import SimpleNamespace

import numpy as np
import pytest
from addresses import own_net

from ardrone_autonomy.protocol.video import StreamParser
from risc_lab.lab import FleetVehicle, Start, load_templates, load_vehicle_type
from risc_lab.lab.fleet import Fleet, MocapEndpoint
from risc_simulator.vehicles import virtual_type
from risc_simulator.vehicles.ardrone.host import ArdroneHost, Ports
from risc_simulator.video.camera_process import Cameras
from risc_simulator.video.server import BITRATES_KBIT_S, RATES_HZ, VideoServer
from risc_simulator.virtual_lab import VirtualLab
from risc_simulator.wires import Wires
from risc_simulator.world import World

FRONT, BOTTOM = 0, 1
ADDRESS = own_net() + ".1.1"
RATE_HZ, LATENCY_S = 20.0, 0.12
PATIENCE_S = 60.0  # for a process to start on a busy computer


def fleet_of(count, calibration=""):
    address = own_net() + ".1.%d"
    vehicles = tuple(
        FleetVehicle(
            "risc%d" % (k + 1),
            template,
            "ardrone",
            address % (k + 1),
            Start((0.5 * k, 0.0, 0.0)),
            calibration,
        )
        for k, template in enumerate(("fluffy_II", "albatross", "Raven")[:count])
    )
    return Fleet("some", MocapEndpoint(ADDRESS), vehicles)


class GreyEye:
    """Returns the same small picture for every request."""

    @staticmethod
    def look(*_):
        return np.full((48, 64, 3), 90, np.uint8)


class Bench:
    """A VideoServer in simulated time, whose camera process is played by the test."""

    def __init__(self, count=1):
        self.world = SimpleNamespace(time_s=0.0, truth=lambda: np.zeros((count, 12)), vehicles={})
        fleet = fleet_of(count)
        for vehicle in fleet.vehicles:
            self.world.vehicles[vehicle.namespace] = SimpleNamespace(virtual=virtual_type("ardrone"))
        self.listeners = [socket.create_server((ADDRESS, 0)) for _ in range(count)]
        self.server = VideoServer(self.world, fleet, 1, Wires(), self.listeners)
        self.stations = list(self.server.stations.values())
        self.server._link, self.process = socket.socketpair()
        self.server._process, self.server.ready = SimpleNamespace(wait=lambda _: None), True
        self.orders = []
        self.server._send_to_process = self.orders.append
        self._cameras = [Cameras(k, vehicle, None, 1) for k, vehicle in enumerate(fleet.vehicles)]
        for cameras, station in zip(self._cameras, self.stations):
            cameras._eyes = [GreyEye, GreyEye]
            station.configure(FRONT, RATE_HZ, 4000.0, True)
        self.clients = []

    def connect(self, index=0):
        """Connect a new client; return a function headers(count) that receives its next PaVE headers."""
        client = socket.create_connection(self.listeners[index].getsockname(), PATIENCE_S)
        self.clients.append(client)
        assert select.select([self.listeners[index]], (), (), PATIENCE_S)[0]
        self.server.serve(0.0)
        parser = StreamParser()

        def headers(count):
            found = []
            while len(found) < count:
                found += [packet.header for packet in parser.feed(client.recv(1 << 16))]
            return found

        return headers

    def tick(self, now_s):
        """Run the lab's cycle with the world at this time. Returns the number of orders it gave."""
        self.world.time_s = now_s
        before = len(self.orders)
        self.server.tick(now_s)
        return len(self.orders) - before

    def draw(self, now_s):
        """Let the camera process finish the newest order."""
        self.process.sendall(self._cameras[self.orders[-1].index].take(self.orders[-1], ()))
        while self.server._taking is not None:
            self.server.on_readable(self.server._link, now_s)
            if self.server._taking is not None and not self.server._received:
                return  # the next order was sent

    def close(self):
        self.server.close()
        for sock in (*self.clients, *self.listeners, self.process):
            sock.close()


@pytest.fixture
def make_bench():
    benches = []

    def make(*arguments):
        benches.append(Bench(*arguments))
        return benches[-1]

    yield make
    for bench in benches:
        bench.close()


def watched(make_bench):
    """(Bench whose only camera has a client, its station); the first picture was ordered at 100 s."""
    bench = make_bench()
    (station,) = bench.stations
    bench.connect()
    assert bench.tick(100.0) == 1
    return bench, station


def test_nothing_is_made_before_somebody_watches(make_bench):
    bench = make_bench()
    assert bench.tick(1.0) == 0
    bench.connect()
    assert bench.tick(1.005) == 1


def test_the_rhythm_is_absolute_and_what_the_computer_missed_is_counted(make_bench):
    bench, station = watched(make_bench)
    bench.draw(100.001)
    assert bench.tick(100.045) == 0
    assert bench.tick(100.06) == 1 and station.next_s == pytest.approx(100.1)
    bench.draw(100.22)
    assert bench.tick(100.225) == 1 and station.skipped == 2 and station.next_s == pytest.approx(100.25)


def test_pictures_arrive_after_the_latency_and_the_lateness_is_that_of_those_that_came_soonest(make_bench):
    bench = make_bench()
    (station,) = bench.stations
    headers = bench.connect()
    assert station.statistics()["late_ms"] == 0.0
    for k, late_s in enumerate((0.02, 0.03, 0.5)):
        assert bench.tick(100.0 + k) == 1
        bench.draw(100.01 + k)
        assert bench.server.due_s == pytest.approx(100.0 + k + LATENCY_S)
        bench.server.send(100.0 + k + 0.9 * LATENCY_S)
        assert station.pictures == k, "not yet"
        bench.server.send(100.0 + k + LATENCY_S + late_s)
    assert 20.0 <= station.statistics()["late_ms"] < 30.0
    assert [header.timestamp_ms for header in headers(3)] == [100000, 101000, 102000]


def test_cameras_take_turns_and_what_is_due_waits_for_none_that_draws(make_bench):
    bench = make_bench(3)
    for index in range(3):
        bench.connect(index)
    assert bench.tick(1.0) == 1
    bench.draw(1.004)  # the next is ordered at once, of the newest world state
    bench.draw(1.01)
    assert [order.index for order in bench.orders] == [0, 1, 2]
    assert bench.tick(1.0 + LATENCY_S) == 0, "the third is still being drawn"
    bench.server.send(1.0 + LATENCY_S)
    assert [station.pictures for station in bench.stations] == [1, 1, 0]


def test_a_camera_that_is_off_misses_nothing(make_bench):
    bench, station = watched(make_bench)
    bench.draw(100.01)
    station.configure(FRONT, RATE_HZ, 4000.0, False)
    assert bench.tick(103.0) == 0
    station.configure(FRONT, RATE_HZ, 4000.0, True)
    assert bench.tick(105.0) == 1, "begins anew"
    assert station.skipped == 0


def test_no_two_pictures_of_one_time(make_bench):
    """A stalled lab must not look like an aircraft whose clock has been set back."""
    bench = make_bench()
    bench.connect()
    assert bench.tick(1.0) == 1
    bench.draw(1.2)
    bench.server.tick(1.2)
    assert len(bench.orders) == 1
    assert bench.tick(1.205) == 1


def test_the_first_watcher_gets_a_new_stream_and_others_what_comes(make_bench):
    bench = make_bench()

    def picture(now_s):
        assert bench.tick(now_s) == 1
        bench.draw(now_s)
        bench.server.send(now_s + LATENCY_S)

    headers = bench.connect()
    picture(1.0)
    picture(2.0)
    first, second = headers(2)
    assert first.frame_type == 1 and second.frame_type == 3
    bench.clients[0].close()
    bench.server.serve(3.0)
    headers = bench.connect()
    picture(4.0)
    (again,) = headers(1)
    assert again.frame_type == 1 and again.stream_id == first.stream_id + 1
    others = bench.connect()
    picture(5.0)
    assert headers(1)[0].frame_number == others(1)[0].frame_number == 3


@pytest.fixture
def host():
    """An aircraft with its video, whose camera process does not run."""
    fleet = fleet_of(1)
    world = World(fleet, {"ardrone": load_vehicle_type("ardrone")}, load_templates())
    host = ArdroneHost(world.vehicles["risc1"], ADDRESS, Ports(0, 0, 0, 0))
    server = VideoServer(world, fleet, 0, host.wires, [host.video_listener])
    host.attach_video(server.stations["risc1"])
    yield host, server.stations["risc1"]
    server.close()
    host.close()
    assert host.sockets() == []


def send(host, *commands):
    """Send AT commands, each "NAME,arguments", in one datagram."""
    send.sequence += len(commands)
    first = send.sequence - len(commands) + 1
    texts = ["AT*%s=%d,%s\r" % (c.split(",", 1)[0], first + k, c.split(",", 1)[1]) for k, c in enumerate(commands)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.sendto("".join(texts).encode("ascii"), (ADDRESS, host.ports.at))
    (at,) = [s for s in host.sockets() if isinstance(s, socket.socket) and s.getsockname()[1] == host.ports.at]
    assert select.select([at], (), (), PATIENCE_S)[0]
    host.on_readable(at, 0.0)


send.sequence = 0


@pytest.mark.parametrize("number", ["-7", "0", "99999999999999999999", "9" * 400, "1e300"])
def test_no_number_in_the_configuration_is_too_much(host, number):
    host, station = host
    for key in ("video:video_channel", "video:codec_fps", "video:max_bitrate"):
        send(host, 'CONFIG,"%s","%s"' % (key, number))
    assert host.statistics()["config_writes"] == 3
    assert station.channel in (FRONT, BOTTOM)
    assert RATES_HZ[0] <= station.rate_hz <= RATES_HZ[1]
    assert BITRATES_KBIT_S[0] <= station.bitrate_kbit_s <= BITRATES_KBIT_S[1]


def test_another_session_brings_its_own_values(host):
    host, station = host
    send(host, 'CONFIG,"custom:session_id","11111111"')
    ids = 'CONFIG_IDS,"11111111","%s","%s"' % host.configuration.current_ids[1:]
    send(host, ids, 'CONFIG,"video:video_channel","1"')
    assert station.channel == BOTTOM
    send(host, 'CONFIG,"custom:session_id","22222222"')
    assert station.channel == FRONT, "a new session begins with the defaults"
    send(host, 'CONFIG,"custom:session_id","11111111"')
    assert station.channel == BOTTOM


@pytest.mark.parametrize("cameras_ahead", [True, False])
def test_a_file_that_cannot_be_used_is_told_once(caplog, cameras_ahead):
    """With cameras_ahead it is reported at the start, not when the first client connects."""
    with caplog.at_level(logging.ERROR):
        lab = VirtualLab(fleet_of(1, calibration="/nowhere/camera.yaml"), cameras_ahead=cameras_ahead)
        try:
            if not cameras_ahead:
                client = socket.create_connection((ADDRESS, 5555), PATIENCE_S)
            deadline_s = time.monotonic() + PATIENCE_S
            while "start the lab again" not in caplog.text:
                assert time.monotonic() < deadline_s, "nothing was said"
                lab.run(duration_s=lab.exposure_s + 0.2)
            assert not lab.cameras_ready
            lab.run(duration_s=lab.exposure_s + 0.2)
            assert lab._video._process is None and caplog.text.count("start the lab again") == 1
            if not cameras_ahead:
                client.close()
        finally:
            lab.close()


def test_a_computer_that_cannot_start_a_process_does_not_end_the_lab(make_bench, caplog, monkeypatch):
    def refuse(*_arguments, **_options):
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr("risc_simulator.video.server.subprocess.Popen", refuse)
    bench = make_bench()
    bench.server._hang_up()
    bench.server._process = None
    bench.connect()
    for k in range(200):
        bench.tick(0.01 * k)
    assert bench.server._process is None and caplog.text.count("unavailable") == 1
    bench.tick(6.0)
    assert caplog.text.count("unavailable") == 2, "asked again"
