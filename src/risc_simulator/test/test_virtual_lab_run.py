"""The whole lab in real time on loopback addresses, seen by clients that know only the wire formats."""

import json
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from addresses import free_port, own_net

from risc_lab.lab import FleetLandmark, FleetVehicle, Start
from risc_lab.lab.fleet import Fleet, MocapEndpoint
from risc_simulator import virtual_lab
from risc_simulator.faults import parse_fault
from risc_simulator.models.flight import FlightPhase
from risc_simulator.virtual_lab import LabOptions, VirtualLab, summary

GROUP = "225.1.1.1"
LIVE_MODE = struct.pack("<HH", 14, 9) + b"LiveMode\0"
FRAME_OF_DATA, REQUEST_FRAME = 13, 12

FLEET_YAML = """
name: two
mocap: {host: %(net)s.0.1, stream_port: %(port)d, interface: 127.0.0.1}
vehicles:
  - {namespace: risc1, template: fluffy_II, type: ardrone, address: %(net)s.1.1, start: {position_m: [0.5, 0, 0]}}
  - {namespace: risc2, template: Raven, type: ardrone, address: %(net)s.1.2, start: {position_m: [-0.5, 0, 0]}}
landmarks: [{name: Green_pink, position_m: [2.3, 0.8, 1.0]}]
"""


@pytest.fixture
def net():
    """{"net": first two bytes of addresses, "port": stream port} that no other test run uses."""
    return {"net": own_net(), "port": free_port()}


def make_fleet(net, count=2):
    vehicles = tuple(
        FleetVehicle("risc%d" % (k + 1), name, "ardrone", "%s.1.%d" % (net["net"], k + 1), Start((x, 0.0, 0.0)))
        for k, (name, x) in enumerate([("fluffy_II", 0.5), ("Raven", -0.5)][:count])
    )
    return Fleet(
        "two",
        MocapEndpoint(net["net"] + ".0.1", stream_port=net["port"], interface="127.0.0.1"),
        vehicles,
        (FleetLandmark("Green_pink", (2.3, 0.8, 1.0)),),
    )


def stream_client(port):
    """Open a socket that receives the live stream, as a protocol client does."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    sock.bind((GROUP, port))
    membership = socket.inet_aton(GROUP) + socket.inet_aton("127.0.0.1")
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
    sock.settimeout(15.0)
    return sock


def first_body(datagram):
    """(frame number, name, (n, 3) markers in metres) of the first body in a frame datagram."""
    command, length = struct.unpack_from("<HH", datagram)
    assert command == FRAME_OF_DATA and length == len(datagram) - 4
    number, _ = struct.unpack_from("<ii", datagram, 4)
    end = datagram.index(b"\0", 12)
    (count,) = struct.unpack_from("<i", datagram, end + 1)
    markers = np.frombuffer(datagram, "<f4", 3 * count, end + 5).reshape(count, 3) / 1000.0
    return number, datagram[12:end].decode(), markers


@pytest.fixture
def running(net):
    """The lab in a thread of its own."""
    lab = VirtualLab(make_fleet(net), seed=4)
    stop = threading.Event()
    thread = threading.Thread(target=lab.run, args=(stop,))
    thread.start()
    yield lab
    stop.set()
    thread.join(15.0)
    assert not thread.is_alive()
    lab.close()


def test_stream_reaches_a_raw_client_complete_and_on_time(running, net):
    with stream_client(net["port"]) as stream, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as commands:
        commands.sendto(LIVE_MODE, (net["net"] + ".0.1", 1510))
        frames = []
        arrivals = []
        while len(frames) < 400:  # two seconds
            frames.append(first_body(stream.recv(65536)))
            arrivals.append((running.now_s(), running.frames_skipped))  # the lab's own clock stops while it sleeps
    numbers = [frame[0] for frame in frames]
    assert numbers == list(range(numbers[0], numbers[0] + 400))
    assert {frame[1] for frame in frames} == {"fluffy_II"}
    seen = np.array([frame[2] for frame in frames])
    seen[np.abs(seen) > 1000] = np.nan  # lost markers
    noise = np.nanstd(seen, axis=0)
    assert np.all((noise > 0.0015) & (noise < 0.0025))  # 400 samples of 2 mm
    (name, count), *_ = running.world.layout
    exact = running.world.markers_m()[:count]
    assert name == "fluffy_II"
    np.testing.assert_allclose(np.nanmean(seen, axis=0), exact, atol=0.0006)
    # The schedule is kept under any load of this computer: after stalls, and frames that the lab counts as skipped,
    # there are frames on time again.
    now_s, skipped = np.array(arrivals).T
    late_s = now_s - (np.arange(400) + skipped) / 200.0
    assert late_s[200:].min() == pytest.approx(late_s[:200].min(), abs=0.05)


def test_polling_client_and_a_flight_over_at_commands(running, net):
    """Take off by REF, watch the height by polling frames: physics, radio and both hosts together."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as commands,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as pilot,
    ):
        host = (net["net"] + ".0.1", 1510)
        commands.settimeout(15.0)
        commands.sendto(LIVE_MODE, host)
        commands.recv(100)

        def height_m():
            commands.sendto(struct.pack("<HH", REQUEST_FRAME, 0), host)
            markers = first_body(commands.recv(65536))[2]
            return markers[np.abs(markers[:, 2]) < 1000, 2].mean()

        time.sleep(0.1)
        on_floor_m = height_m()
        deadline_s = running.now_s() + 15.0
        sequence = 1
        while height_m() - on_floor_m < 0.5:
            assert running.now_s() < deadline_s, "it does not climb"
            pilot.sendto(b"AT*REF=%d,290718208\r" % sequence, (net["net"] + ".1.1", 5556))
            sequence += 1
            time.sleep(1 / 30.0)  # the rate of the radio
        assert running.world.vehicles["risc1"].phase in (FlightPhase.TAKING_OFF, FlightPhase.HOVERING)
        assert running.world.vehicles["risc2"].phase is FlightPhase.LANDED


def test_world_time_follows_lab_time_and_catches_up_without_losing_frames(net, clock):
    lab = VirtualLab(make_fleet(net, 1), live=True)
    try:
        with stream_client(net["port"]) as stream:
            lab.run(duration_s=0.1)
            clock.now_s += 0.2  # the computer is busy elsewhere
            lab.run(duration_s=0.5)
            numbers = [first_body(stream.recv(65536))[0] for _ in range(lab.frame)]
        assert numbers == list(range(1, 101))
        assert lab.world.time_s == pytest.approx(0.5)
        assert lab.lateness.max_s > 0.15 and lab.stalls == 0
        assert lab.now_s() == pytest.approx(0.503, abs=1e-3)
    finally:
        lab.close()


def test_a_long_stall_stops_the_clock(net, clock, monkeypatch):
    monkeypatch.setattr(virtual_lab, "MAX_CATCH_UP_S", 0.1)
    lab = VirtualLab(make_fleet(net, 1))
    try:
        lab.run(duration_s=0.05)
        clock.now_s += 0.3
        before = lab.now_s()
        lab.step()
        assert lab.stalls == 1 and before > 0.3
        assert lab.now_s() == pytest.approx(0.058, abs=1e-3)  # when frame 11 was due
    finally:
        lab.close()


@pytest.mark.parametrize(
    ("told", "line", "seed"),
    [({}, "", 0), ({}, "seed: 7", 7), ({"seed": 3}, "seed: 7", 3), ({"seed": 0}, "seed: 7", 0)],
)
def test_a_file_of_faults_has_the_seed_unless_the_lab_is_told_one(net, clock, tmp_path, told, line, seed):
    path = tmp_path / "faults.yaml"
    path.write_text("%s\nfaults: [{fault: loss, severity: 0.5, start_s: 60}]\n" % line)
    lab = LabOptions(faults=str(path), cameras_on_demand=True, **told).make_lab(make_fleet(net, 1))
    try:
        assert lab.statistics()["seed"] == seed
        masses_kg = [v.plant.mass_kg for v in lab.world.vehicles.values()]
    finally:
        lab.close()
    same = VirtualLab(make_fleet(net, 1), seed=seed)
    try:
        assert masses_kg == [v.plant.mass_kg for v in same.world.vehicles.values()]
    finally:
        same.close()


def test_faults_by_name(net, clock):
    lab = VirtualLab(make_fleet(net, 1), live=True)
    try:
        with stream_client(net["port"]) as stream:
            lab.run(duration_s=0.05)
            lab.inject(parse_fault("occlusion:0.1,risc1"))
            lab.run(duration_s=0.2)
            frames = [first_body(stream.recv(65536))[2] for _ in range(40)]
            lost = [bool((np.abs(markers[:, 0]) > 1000).all()) for markers in frames]
            assert 18 <= sum(lost) <= 21 and not any(lost[:9])
            lab.inject(parse_fault("mocap_blackout:0.1"))
            lab.run(duration_s=0.4)
            numbers = []
            stream.settimeout(0.05)
            try:
                while True:
                    numbers.append(first_body(stream.recv(65536))[0])
            except TimeoutError:
                pass
            assert 18 <= len(numbers) <= 22 and numbers[-1] == 80
        lab.inject(parse_fault("battery_low:20,risc1"))
        lab.run(duration_s=0.5)
        assert lab.world.vehicles["risc1"].state.battery_pct == pytest.approx(20.0, abs=0.1)
        with pytest.raises(ValueError, match="risc9"):
            lab.inject(parse_fault("link_blackhole:1,risc9"))
    finally:
        lab.close()


def test_options_reach_the_lab(net):
    fleet = LabOptions(vehicles=1, subnet="127.99", rate=120.0, stream_port=5000).configure(make_fleet(net))
    assert (fleet.mocap.host, fleet.vehicles[0].address, len(fleet.vehicles)) == ("127.99.0.1", "127.99.1.1", 1)
    assert (fleet.mocap.rate_hz, fleet.mocap.stream_port, fleet.mocap.interface) == (120.0, 5000, "127.0.0.1")
    fleet = LabOptions(rate=120.0).configure(make_fleet(net))
    lab = VirtualLab(fleet, ideal=True, delay=0.3, exact_markers=True)
    try:
        lab.run(duration_s=0.1)
        assert lab.world.vehicles["risc2"].plant.command_delay_s == 0.3
        assert lab.world.vehicles["risc2"].plant.mass_kg == 0.45
        assert lab.frame == 12 and lab.world.time_s == pytest.approx(0.1)  # frames lie on the physics' time grid
        exact_m = lab.world.markers_m()
        np.testing.assert_array_equal(lab.cameras.observe(1.0, lab.world.layout, exact_m).markers_m, exact_m)
    finally:
        lab.close()


def test_stream_needs_no_card_of_the_client(net):
    """One fleet file serves both computers: its `interface` is the client's, and the lab ignores it."""
    fleet = make_fleet(net)
    fleet = replace(fleet, mocap=replace(fleet.mocap, interface="192.0.2.254"))
    for interface in ("", "127.0.0.1"):
        lab = VirtualLab(fleet, live=True, interface=interface)
        try:
            with stream_client(net["port"]) as stream:
                lab.run(duration_s=0.05)
                assert [first_body(stream.recv(65536))[0] for _ in range(10)] == list(range(1, 11))
        finally:
            lab.close()
    with pytest.raises(OSError, match="interface 192.0.2.254"):
        VirtualLab(fleet, interface="192.0.2.254")


def test_radio_loss_reaches_every_vehicle(net, clock):
    lab = VirtualLab(make_fleet(net), radio_loss=0.5)
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as pilot:

            def send():
                for k in (1, 2):
                    pilot.sendto(b"AT*PCMD=%d,0,0,0,0,0\r" % lab.frame, ("%s.1.%d" % (net["net"], k), 5556))

            lab.run(duration_s=2.0, on_frame=send)
        statistics = lab.statistics()
        assert statistics["radio_loss"] == 0.5 and "50 %" in lab.describe()
        lost = [vehicle["host"]["radio_slots_lost"] for vehicle in statistics["vehicles"].values()]
        assert all(15 <= count <= 45 for count in lost)  # half of 60, four sigma
    finally:
        lab.close()
    with pytest.raises(ValueError, match=r"\[0, 1\)"):
        VirtualLab(make_fleet(net), radio_loss=1.0)


def test_least_separation_and_collisions_are_told(net):
    lab = VirtualLab(make_fleet(net), ideal=True)
    try:
        first, second = lab.world.vehicles.values()
        first.fly_at((0.0, 0.4, 1.0))
        second.fly_at((0.0, -0.4, 1.0))
        lab.run(duration_s=0.05)
        assert lab.statistics()["least_separation_m"] == pytest.approx(0.8, abs=1e-3)
        second.fly_at((0.0, 0.0, 1.0))
        lab.run(duration_s=0.1)
        statistics = json.loads(json.dumps(lab.statistics()))
        assert statistics["least_separation_m"] == pytest.approx(0.4, abs=1e-3)
        assert [crash["reason"] for crash in statistics["crashes"]] == ["collided with risc2", "collided with risc1"]
        assert "0.40 m" in summary(statistics) and "risc1 collided with risc2 at" in summary(statistics)
    finally:
        lab.close()
    lab = VirtualLab(make_fleet(net, 1), ideal=True)
    try:
        lab.world.vehicles["risc1"].fly_at((0.0, 0.0, 1.0))
        lab.run(duration_s=0.05)
        assert lab.statistics()["least_separation_m"] is None and "separation" not in summary(lab.statistics())
    finally:
        lab.close()


# ------------------------------------------------------------------ the program


def start_program(tmp_path, net, *options):
    path = tmp_path / "fleet.yaml"
    path.write_text(FLEET_YAML % net)
    return subprocess.Popen(
        [sys.executable, "-m", "risc_simulator.virtual_lab", str(path)] + list(options),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=dict(os.environ, PYTHONPATH=os.pathsep.join(sys.path)),
        universal_newlines=True,
    )


@pytest.fixture
def main():
    """The program's main, for a call in this process."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield virtual_lab.main
    for number, handler in handlers.items():
        signal.signal(number, handler)


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.release)])
def test_program_tells_what_listens_and_ends_cleanly(tmp_path, net, number):
    stats = tmp_path / "stats.json"
    with stream_client(net["port"]) as stream:
        program = start_program(tmp_path, net, "--live", "--seed", "7", "--stats", str(stats))
        lines = [program.stdout.readline() for _ in range(7)]
        text = "".join(lines)
        for expected in ("seed 7", net["net"] + ".0.1:1510", "%s:%d" % (GROUP, net["port"]), net["net"] + ".1.2"):
            assert expected in text
        for _ in range(52):  # the host's announcement, then frames
            stream.recv(65536)
    program.send_signal(number)
    out, err = program.communicate(timeout=60)
    assert (program.returncode, err) == (0, "")
    assert "frames in" in out
    content = json.loads(stats.read_text())
    assert content["frames"] > 50 and content["seed"] == 7 and content["simulated"] is True
    assert content["cortex"]["frames_sent"] == content["frames"]
    assert content["vehicles"]["risc2"]["phase"] == "landed"


def test_program_says_who_comes_and_what_is_wrong(tmp_path, net):
    program = start_program(tmp_path, net)
    lines = [program.stdout.readline() for _ in range(7)]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.bind(("127.0.0.1", 0))
        client.settimeout(60.0)
        for _ in range(5):
            client.sendto(b"rubbish", (net["net"] + ".1.2", 5556))
        client.sendto(LIVE_MODE, (net["net"] + ".0.1", 1510))
        client.recv(100)  # once this is answered, the earlier datagrams were read
        who = "127.0.0.1:%d" % client.getsockname()[1]
        program.send_signal(signal.SIGINT)
        out, err = program.communicate(timeout=60)
    assert (program.returncode, err) == (0, "")
    said = [line for line in out.splitlines() if who in line]
    assert any("Cortex" in line and "stream" in line for line in said), (lines, out)
    malformed = [line for line in said if "risc2" in line and "malformed" in line]
    assert len(malformed) == 2 and malformed[1].endswith("5 times"), "once when it came, once counted at the end"


def test_program_streams_to_the_port_of_original_clients(tmp_path, net):
    try:
        stream = stream_client(1001)
    except PermissionError:
        pytest.skip("ports below 1024 need a privilege here")
    program = start_program(tmp_path, net, "--live", "--stream-port", "1001", "--duration", "1")
    with stream:
        datagram = b""
        while struct.unpack_from("<H", datagram.ljust(2))[0] != FRAME_OF_DATA:  # the announcement comes first
            datagram, sender = stream.recvfrom(65536)
            if sender[0] != net["net"] + ".0.1":
                datagram = b""  # of another lab
    assert first_body(datagram)[1] == "fluffy_II"
    assert program.communicate(timeout=60)[1] == ""


def test_program_ends_by_itself_after_its_duration(tmp_path, net):
    program = start_program(tmp_path, net, "--duration", "0.5", "--ideal", "--gusts", "--delay", "0.2")
    out, err = program.communicate(timeout=60)
    assert (program.returncode, err) == (0, "")
    assert "100 frames in 0.5 s" in out and "ideal plants" in out and "gusts" in out


def test_errors_are_one_line_with_cause_and_cure(tmp_path, net):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as occupied:
        occupied.bind((net["net"] + ".1.2", 5556))
        program = start_program(tmp_path, net)
        out, err = program.communicate(timeout=60)
    assert program.returncode == 1 and out == ""
    assert len(err.strip().splitlines()) == 1
    for expected in ("risc2", net["net"] + ".1.2:5556", "in use", "Stop the other"):
        assert expected in err


@pytest.mark.parametrize(
    "option, value, expected",
    [("--vehicles", "5", "2 vehicles"), ("--radio-loss", "1.5", "radio_loss"), ("--interface", "eth9", "eth9")],
)
def test_options_that_cannot_be_are_one_line(tmp_path, net, main, capsys, option, value, expected):
    path = tmp_path / "fleet.yaml"
    path.write_text(FLEET_YAML % net)
    assert main([str(path), option, value]) == 1
    err = capsys.readouterr().err
    assert expected in err and len(err.strip().splitlines()) == 1


def test_sockets_are_closed_when_a_later_host_fails(net):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as occupied:
        occupied.bind((net["net"] + ".1.2", 5556))
        with pytest.raises(OSError, match="in use"):
            VirtualLab(make_fleet(net))
    lab = VirtualLab(make_fleet(net))  # everything is free again
    lab.close()
    lab.close()
