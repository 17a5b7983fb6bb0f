"""The doctor's findings from given observations, theme by theme; and what it reads from this computer."""

import contextlib
import http.server
import io
import ipaddress
import json
import os
import pathlib
import re
import select
import shutil
import socket
import subprocess
import sys
import threading
import time
import types
from dataclasses import replace

import numpy as np
import pytest
import yaml

from ardrone_autonomy.protocol.navdata import State
from cortex_ros.connection import stream_socket
from cortex_ros.wire import BodyDef
from risc_control.safety import SafetyLimits
from risc_control.vehicles import FlightState, Status
from risc_doctor import (
    axes,
    clock_agreement,
    cortex,
    disk,
    interfaces,
    load,
    network,
    operator_joystick,
    ros_graph,
    serial_lines,
    socket_owners,
    taken_ports,
    vehicles,
)
from risc_doctor import ros_environment as ros
from risc_doctor.__main__ import main
from risc_doctor.checks import CHECKS, run
from risc_doctor.clock_agreement import judge as judge_clock
from risc_doctor.clock_agreement import parse_tracking
from risc_doctor.findings import GREEN, RED, YELLOW, Finding, worst
from risc_doctor.interfaces import Interface, is_own, read_interfaces, source_towards
from risc_doctor.ros_master import MasterError, NobodyThereError, call
from risc_doctor.situation import Situation
from risc_lab.lab import fleet_from_dict, load_fleet, load_templates
from risc_lab.ros.launching import argument_of
from risc_maap_msgs.msg import Counter, SerialLink
from rosserial_python.diagnosis import WARNINGS, Cause

ROOT = pathlib.Path(__file__).resolve().parents[3]
LAB = yaml.safe_load((ROOT / "launch" / "fleets" / "lab3.yaml").read_text())
LAB["mocap"]["host"] = "129.123.5.10"
LAB = fleet_from_dict(LAB)
VIRTUAL = load_fleet(ROOT / "launch" / "fleets" / "ardrones3.yaml")
TEMPLATES = load_templates()


def card(name, *addresses, **state):
    return Interface(name, tuple(map(ipaddress.IPv4Interface, addresses)), **state)


LO = card("lo", "127.0.0.1/8", multicast=False)
CABLE, WIFI = card("eth0", "129.123.5.240/24"), card("wlan0", "192.168.1.2/24")


def levels(findings):
    return [finding.level for finding in findings]


def text_of(findings, level):
    return "\n".join("%s: %s -> %s" % (f.code, f.text, f.cure) for f in findings if f.level == level)


# ---------------------------------------------------------------- network


def test_a_laptop_in_both_networks_is_well():
    findings = network.judge(LAB, [LO, CABLE, WIFI], False, lambda address: None)
    assert worst(findings) == GREEN and "129.123.5.240" in text_of(findings, GREEN)


def test_what_is_wrong_with_the_network_is_named():
    nowhere = network.judge(LAB, [LO, WIFI], False, lambda address: None)
    assert re.search("no_way: .* 129.123.5.10 ", text_of(nowhere, RED))
    routed = network.judge(LAB, [LO, WIFI], False, lambda address: "192.168.1.2")
    assert worst(routed) == YELLOW and "routed_host: " in text_of(routed, YELLOW)
    unplugged = network.judge(LAB, [LO, replace(CABLE, connected=False)], False, lambda address: None)
    assert "unplugged: eth0 " in text_of(unplugged, YELLOW)
    assert "ip link set lo up" in text_of(network.judge(LAB, [CABLE, WIFI], False, lambda address: None), RED)
    assert "no_card: " in text_of(network.judge(LAB, [LO], False, lambda address: None), RED)
    elsewhere = replace(LAB, mocap=replace(LAB.mocap, interface="129.123.5.7"))
    assert "129.123.5.7" in text_of(network.judge(elsewhere, [LO, CABLE], False, lambda address: None), RED)


def test_two_cards_in_one_network_are_told():
    assert levels(network.judge_subnets([LO, CABLE, WIFI], ["192.168.1.1"])) == [GREEN]
    (twice,) = network.judge_subnets([LO, CABLE, card("wlan1", "129.123.5.99/24")], ["192.168.1.1"])
    assert twice.level == YELLOW and "eth0 and wlan1 " in twice.text and "129.123.5.0/24" in twice.text
    assert "ip link set wlan1 down" in twice.cure and "vehicle" not in twice.text + twice.cure
    # a laboratory with the numbers of the vehicle's own Wi-Fi
    (clash,) = network.judge_subnets([card("eth0", "192.168.1.11/24"), WIFI], ["192.168.1.1"])
    assert clash.level == YELLOW and clash.code == "shared_with_vehicle" and "192.168.1.1 " in clash.text


def test_vehicles_of_one_network_must_be_reachable():
    vehicles = tuple(replace(vehicle, address="192.168.1.%d" % k) for k, vehicle in enumerate(LAB.vehicles, 1))
    shared = replace(LAB, own_networks=False, vehicles=vehicles)
    findings = network.judge(shared, [LO, CABLE], False, lambda address: None)
    assert "vehicle 192.168.1.1" in text_of(findings, RED)
    routed = text_of(network.judge(shared, [LO, CABLE], False, lambda address: "129.123.5.240"), YELLOW)
    assert "routed_vehicle: vehicle 192.168.1.1 " in routed
    assert "multicast" not in routed, "nothing of a vehicle is multicast"


def test_multicast_that_the_kernel_would_drop(monkeypatch):
    own = "129.123.5.240"
    assert levels(network.judge_multicast(LAB.mocap, own, CABLE, "", {"all": 1, "eth0": 1})) == [GREEN]
    wrong_card = network.judge_multicast(LAB.mocap, "192.168.1.2", WIFI, "", {"all": 0, "wlan0": 1})
    assert "rp_filter=2" in text_of(wrong_card, YELLOW)
    assert levels(network.judge_multicast(LAB.mocap, own, replace(CABLE, multicast=False), "", {})) == [RED]
    assert network.join_error("225.1.1.1", "127.0.0.1") == ""
    assert network.join_error("225.1.1.1", "203.0.113.7")  # a documentation address, which no computer has
    monkeypatch.setattr(network.net, "source_towards", lambda address: None)
    lost = network.check_multicast(types.SimpleNamespace(fleet=LAB, interfaces=lambda: [LO]))
    assert "no_way: " in text_of(lost, RED)


def test_this_computers_cards_are_read():
    cards = read_interfaces()
    assert any(one.is_loopback and one.up for one in cards)
    assert is_own(cards, "127.5.5.5") and not is_own(cards, "203.0.113.7")
    assert source_towards("127.5.5.5").startswith("127.")


def test_a_bridge_that_waits_for_containers_is_no_cable_that_is_out(monkeypatch, tmp_path):
    for name in ("docker0", "eth0"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "operstate").write_text("down\n")
    (tmp_path / "docker0" / "bridge").mkdir()
    monkeypatch.setattr(interfaces, "_CARDS", tmp_path)
    monkeypatch.setattr(interfaces.psutil, "net_if_addrs", lambda: {"docker0": [], "eth0": []})
    assert [card.connected for card in read_interfaces()] == [True, False]


# ---------------------------------------------------------------- ports


def test_a_port_is_shared_or_taken_and_its_owner_is_named():
    owner = (
        "import socket, sys; s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "if sys.argv[1] == 'share': s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)\n"
        "s.bind(('', 0)); print(s.getsockname()[1], flush=True); sys.stdin.read()"
    )
    for how, level in (("share", GREEN), ("keep", RED)):
        process = subprocess.Popen(
            [sys.executable, "-c", owner, how], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        with process:
            port = int(process.stdout.readline())
            finding = taken_ports._stream_port(port)
            process.stdin.close()
        assert finding.level == level and "pid %d" % process.pid in finding.text
    assert taken_ports._stream_port(port).level == GREEN


@contextlib.contextmanager
def without_privileges():
    """Context manager: drop root rights."""
    before = os.geteuid()
    if before == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(before)


def test_the_folder_of_bags_is_made_by_the_recorder(tmp_path):
    situation = types.SimpleNamespace(bag_folder=tmp_path / "flights", fleet=LAB, master=None)
    assert worst(disk.check(situation)) != RED
    situation.bag_folder = tmp_path / "no" / "such"
    assert "mkdir -p %s," % situation.bag_folder.parent in text_of(disk.check(situation), RED)


def test_what_only_root_may_is_told(tmp_path):
    (tmp_path / "js0").touch(0o000)
    first = int(pathlib.Path("/proc/sys/net/ipv4/ip_unprivileged_port_start").read_text())
    situation = types.SimpleNamespace(bag_folder=pathlib.Path("/usr"), fleet=LAB, master=None)
    with without_privileges():
        port, device = taken_ports._stream_port(1001), operator_joystick.look(str(tmp_path / "js0"), (10, 7))
        folder = disk.check(situation)
    if first > 1001:
        assert port.level == YELLOW and "ip_unprivileged_port_start=1001" in port.cure
    assert device.level == RED and "usermod -aG input" in device.cure
    assert worst(folder) == RED and "forbidden: /usr " in text_of(folder, RED)


def test_a_descriptor_that_is_closed_meanwhile_hides_no_other():
    """Listing the descriptors opens one, here the lowest free number, so it comes before our socket."""
    before, bound = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    with bound:
        bound.bind(("", 0))
        before.close()
        assert socket_owners.users_of_port(bound.getsockname()[1]) == [], "it is our own"


def test_processes_are_called_what_people_call_them():
    names = {
        ("/usr/bin/python3", "/opt/devel/lib/ardrone_autonomy/ardrone_driver", "__name:=x"): "ardrone_driver",
        ("python", "-m", "risc_simulator.virtual_lab", "a.yaml"): "risc_simulator.virtual_lab",
        ("/opt/stream_markers", "__name:=MocapStates"): "stream_markers",
    }
    for words, name in names.items():
        assert socket_owners.Process(7, words).describe() == "%s (pid 7)" % name
    assert argument_of(("a", "__name:=b"), "__name") == "b"


def test_what_cortex_sends_to_this_computer_alone_stays_with_the_program_that_flies_by_it():
    def received(count):
        """Send `count` datagrams. Returns how many arrive at the flying program."""
        for _ in range(count):
            sender.sendto(b"frame", flying.getsockname())
        return sum(bool(select.select([flying], [], [], 0.2)[0] and flying.recv(99)) for _ in range(count))

    udp = socket.AF_INET, socket.SOCK_DGRAM
    with socket.socket(*udp) as flying, socket.socket(*udp) as sender:
        flying.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        flying.bind(("", 0))
        mocap, port = VIRTUAL.mocap, flying.getsockname()[1]
        for group_only, count in ((True, 3), (False, 0)):
            with stream_socket(mocap.host, mocap.stream_group, port, mocap.interface, group_only):
                assert received(3) == count


# ---------------------------------------------------------------- templates


def announced(names):
    return [BodyDef(name, TEMPLATES[name].marker_names if name in TEMPLATES else ("M1",)) for name in names]


EVERYTHING = [v.template for v in VIRTUAL.vehicles] + [landmark.name for landmark in VIRTUAL.landmarks]


def test_templates_that_agree():
    findings = cortex.judge_templates(VIRTUAL, TEMPLATES, announced(EVERYTHING))
    assert levels(findings) == [GREEN] and findings[0].text.startswith("7 of 7")


def test_unknown_missing_misspelt_and_miscounted_bodies():
    bodies = announced(["Fluffy II", "albatross", "Wand"]) + [BodyDef("Raven", ("M1", "M2", "M3"))]
    findings = cortex.judge_templates(VIRTUAL, TEMPLATES, bodies)
    bad, odd = text_of(findings, RED), text_of(findings, YELLOW)
    assert re.search("misspelt: .*'Fluffy II' .*'fluffy_II'", bad) and re.search("'Raven' .* 3 .* 4 ", bad)
    assert re.search("ignored: .*'Wand'", odd) and "landmark 'Blue_green'" in odd
    missing = {name: template for name, template in TEMPLATES.items() if name != "Raven"}
    findings = cortex.judge_templates(VIRTUAL, missing, announced(EVERYTHING))
    assert re.search("not_ours: .*'Raven' of risc3", text_of(findings, RED))


# ---------------------------------------------------------------- axes

STANDING = np.diag([1.0, -1.0, -1.0])  # body axes (x nose, y right, z belly) of a vehicle on the floor to lab axes


def seen_as(matrix=np.eye(3), scale=1.0, yaw_rad=0.7, at=(0.5, -0.3, 0.1)):
    """Frames in which one vehicle of the fleet stands in the lab, and the mocap frame is `matrix` times the lab's."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turned = TEMPLATES["fluffy_II"].markers_m @ STANDING.T @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    exact = scale * (turned + at) @ np.asarray(matrix).T
    rng = np.random.default_rng(3)
    frames = [exact + scale * rng.normal(0.0, 0.001, exact.shape) for _ in range(20)]
    frames[3][1] = np.nan  # a marker is lost now and then
    return {"fluffy_II": frames}


def test_a_vehicle_that_stands_as_it_should():
    findings = axes.judge_poses(VIRTUAL, TEMPLATES, seen_as())
    assert levels(findings) == [GREEN] and "fluffy_II" in findings[0].text


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"scale": 1000.0}, "millimetres: "),
        ({"scale": 0.001}, "metres: "),
        ({"scale": 1.3}, "1.30 "),
        ({"matrix": np.diag([1.0, -1.0, 1.0])}, "mirrored: "),
        ({"matrix": [[0, 1, 0], [1, 0, 0], [0, 0, 1]]}, "mirrored: "),
        ({"matrix": np.diag([1.0, -1.0, -1.0])}, "up is -z"),
        ({"matrix": [[1, 0, 0], [0, 0, -1], [0, 1, 0]]}, "up is -y"),
        ({"at": (0.0, 0.0, -0.9)}, "below: "),
        ({"at": (7.0, 0.0, 0.1)}, "outside: "),
    ],
)
def test_a_frame_that_is_wrong_shows_in_a_vehicle_that_stands(wrong, text):
    findings = axes.judge_poses(VIRTUAL, TEMPLATES, seen_as(**wrong))
    assert levels(findings) == [RED] and text in text_of(findings, RED)


def test_bodies_that_cannot_be_judged_say_why():
    assert axes.judge_poses(VIRTUAL, TEMPLATES, {})[0].code == "no_vehicle"
    lost = {"fluffy_II": [np.full((4, 3), np.nan)]}
    assert "unseen: " in text_of(axes.judge_poses(VIRTUAL, TEMPLATES, lost), YELLOW)
    other = seen_as()
    for frame in other["fluffy_II"]:
        frame[[0, 3]] = frame[[3, 0]]
    assert "misfit: " in text_of(axes.judge_poses(VIRTUAL, TEMPLATES, other), YELLOW)


def moved(matrix, metres=0.5, noise_m=0.002):
    """Moves along +x, +y, +z, seen in a frame that is `matrix` times the true one."""
    rng = np.random.default_rng(5)
    matrix = np.asarray(matrix, dtype=float)
    return {axis: metres * matrix[:, k] + rng.normal(0.0, noise_m, 3) for k, axis in enumerate("xyz")}


def turned_by(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return [[c, -s, 0], [s, c, 0], [0, 0, 1]]


def test_moves_that_are_seen_as_they_were():
    assert levels(axes.judge_moves(moved(np.eye(3)))) == [GREEN] * 3
    assert levels(axes.judge_moves(moved(turned_by(5)))) == [GREEN] * 3, "people do not walk straighter"


@pytest.mark.parametrize(
    ("matrix", "texts"),
    [
        (
            [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
            ["+x (forward) is seen as +y", "+y (to the left) is seen as +x", "left_hand"],
        ),
        (np.diag([1, -1, 1]), ["+y (to the left) is seen as -y", "left_handed: "]),
        ([[1, 0, 0], [0, 0, -1], [0, 1, 0]], ["+y (to the left) is seen as +z", "+z (up) is seen as -y"]),
        (turned_by(90), ["+x (forward) is seen as +y", "+y (to the left) is seen as -x"]),
        (turned_by(180), ["+x (forward) is seen as -x", "+y (to the left) is seen as -y"]),
        (turned_by(40), [" 40 degrees"]),
        (turned_by(-25), [" -25 degrees"]),
        (1000.0 * np.eye(3), [" 500 m"]),
    ],
)
def test_moves_show_axes_that_are_swapped_mirrored_turned_or_out_of_scale(matrix, texts):
    findings = axes.judge_moves(moved(matrix))
    for text in texts:
        assert text in text_of(findings, RED)
    if np.linalg.det(np.asarray(matrix, dtype=float)) > 0.0:
        assert "left_handed: " not in text_of(findings, RED)


def test_moves_that_say_nothing():
    findings = axes.judge_moves(
        {"x": np.array([0.5, 0.0, 0.0]), "y": np.full(3, np.nan), "z": np.array([0, 0, 0.0005])}
    )
    assert levels(findings) == [YELLOW, YELLOW, GREEN]
    assert [finding.code for finding in findings[:2]] == ["move_unseen", "move_in_metres"]
    oblique = axes.judge_moves({"x": np.array([0.4, 0.3, 0.3])})
    assert levels(oblique) == [YELLOW] and oblique[0].code == "oblique"


# ---------------------------------------------------------------- clock, vehicles, joystick, disk

TRACKING = "C0A80101,192.168.1.1,3,1700000000.1,%s,0.00001,0.00002,-6.1,0.01,0.02,0.0003,0.0005,64.2,%s\n"


def test_what_keeps_the_clock():
    good = parse_tracking(TRACKING % ("-0.000021", "Normal"))
    assert (good.synchronised, good.reference, good.offset_s) == (True, "192.168.1.1", 2.1e-5)
    assert judge_clock(good).level == GREEN and judge_clock(good).data["source"] == "chrony"
    slow = parse_tracking(TRACKING % ("0.01", "Normal"))  # in chronyc's sign convention the clock is behind
    assert judge_clock(slow).level == YELLOW
    assert (slow.offset_s, slow.error_s) == (-0.01, pytest.approx(0.00065)) and slow.reference == "192.168.1.1"
    assert judge_clock(parse_tracking(TRACKING % ("-0.2", "Normal"))).level == RED
    assert judge_clock(parse_tracking(TRACKING % ("0.0", "Not synchronised"))).level == YELLOW
    assert parse_tracking("506 Cannot talk to daemon\n") is None and parse_tracking("") is None
    nothing = clock_agreement.ClockState("none", False)
    assert judge_clock(nothing).level == YELLOW and judge_clock(nothing, one_computer=True).level == GREEN
    assert clock_agreement.read_clock().source in ("chrony", "kernel", "none")


def test_ages_of_stamps():
    def level(age_s):
        return worst(clock_agreement.judge_stamps({"/mocap_data": ros_graph.Topic(("a",), 200.0, age_s)}))

    assert [level(age_s) for age_s in (0.004, None, -0.01, -0.03, 0.2)] == [GREEN, GREEN, YELLOW, RED, RED]


def test_batteries_by_the_limit_of_the_loss_ladder():
    limit_pct = SafetyLimits.battery_min_pct
    assert 0.0 < limit_pct < vehicles.NEARLY_EMPTY_PCT

    def level(pct, state=0):
        return worst(vehicles.judge("risc1", "asked", state, pct, limit_pct))

    assert [level(pct) for pct in (80.0, 30.0, 20.0, limit_pct)] == [GREEN, YELLOW, YELLOW, RED]
    assert level(80.0, State.EMERGENCY) == RED and level(18.0, State.BATTERY_LOW) == RED
    assert level(None) == YELLOW and level(80.0, State.FLYING) == GREEN


def test_in_a_flight_the_base_station_knows_the_vehicles_by_their_drivers():
    heard = ros_graph.GraphReport(vehicles={"risc1": Status(FlightState.FLYING, 80.0), "risc3": None})
    situation = types.SimpleNamespace(
        fleet=LAB,
        wanted=(),
        master=object(),
        graph=lambda: heard,
        vehicles=lambda: LAB.vehicles,
        interfaces=lambda: [CABLE],
    )
    findings = vehicles.check(situation)
    assert re.search("risc1 .192.168.1.1. .* flying.* 80 %", text_of(findings, GREEN))
    assert "no_telemetry: risc3 (192.168.1.1)" in text_of(findings, RED)
    assert re.search("no_driver: .* risc2 ", text_of(findings, YELLOW)) and len(findings) == 3


def test_vehicles_are_not_blamed_for_a_graph_that_cannot_be_heard():
    deaf = ros_graph.GraphReport(error="the graph did not answer", vehicles={"risc1": None})
    situation = types.SimpleNamespace(fleet=LAB, wanted=(), master=object(), graph=lambda: deaf)
    (finding,) = vehicles.check(situation)
    assert finding.level == YELLOW and finding.code == "unheard" and "`graph`" in finding.cure


def test_an_address_that_several_vehicles_have_is_none_of_them_by_name():
    def meant(fleet, word):
        return [v.namespace for v in Situation(fleet, "", ROOT, {}, wanted=(word,)).vehicles()]

    assert meant(LAB, "192.168.1.1") == [""] and meant(LAB, "risc2") == ["risc2"]
    assert meant(VIRTUAL, VIRTUAL.vehicles[1].address) == ["risc2"]


def test_joysticks(monkeypatch, tmp_path):
    needed = operator_joystick.needed_indices()
    assert needed == (10, 7), "the game pad of Appendix C"
    assert operator_joystick.judge("js0", "Pad", 11, 8, needed).level == GREEN
    short = operator_joystick.judge("js0", "Pad", 10, 8, needed)
    assert short.level == RED and "button 10" in short.text
    assert operator_joystick.look(str(tmp_path / "js0"), needed).code == "missing"
    assert operator_joystick.look("/dev/null", needed).code == "other_device"
    monkeypatch.setattr(operator_joystick, "_PATTERN", str(tmp_path / "js*"))
    none = [operator_joystick.check(Situation(fleet, "", ROOT, {})) for fleet in (VIRTUAL, LAB)]
    assert list(map(levels, none)) == [[GREEN], [YELLOW]]


# ---------------------------------------------------------------- serial lines


def line(cause, **values):
    state = SerialLink.UP if cause in (Cause.NONE, *WARNINGS) else SerialLink.WAITING
    return SerialLink(port="/dev/ttyACM9", baud=57600, cause=cause, state=state, age_s=2.0, **values)


@pytest.mark.parametrize("cause", [cause for cause in Cause if cause is not Cause.NONE])
def test_every_cause_of_lost_sync_has_a_finding_of_its_own(cause):
    (finding,) = serial_lines.judge("/iris1/arduino", line(cause), [])
    assert finding.code == serial_lines.CODES[cause] and finding.cure
    assert finding.level == (YELLOW if cause in (Cause.BREAKS, Cause.DAMAGE) else RED)
    assert len(set(serial_lines.CODES.values())) == len(serial_lines.CODES)


def test_a_line_that_works_and_one_with_two_readers():
    (well,) = serial_lines.judge("/iris1/arduino", line(Cause.NONE, counters=[Counter("packets", 7)]), ["serial_node"])
    assert (well.code, well.level, well.data) == ("up", GREEN, {"packets": 7})
    for cause in (Cause.STOPPED, Cause.DAMAGE, Cause.NONE):
        (shared,) = serial_lines.judge("/iris1/arduino", line(cause), ["serial_node (pid 1)", "minicom (pid 2)"])
        assert shared.code == "shared" and "minicom (pid 2)" in shared.text
    (types_differ,) = serial_lines.judge("/iris1/arduino", line(Cause.TYPES, refused_topics=["controls"]), ["a", "b"])
    assert types_differ.code == "types" and "controls" in types_differ.text


def test_devices_of_the_fleet_and_who_has_them_open(tmp_path):
    ours, theirs = os.openpty()
    try:
        (busy,) = serial_lines.look("arduino of iris1", os.ttyname(theirs))
        assert busy.code == "in_use" and "(pid %d)" % os.getpid() in busy.text
    finally:
        os.close(theirs)
    path = tmp_path / "ttyACM0"
    assert serial_lines.look("arduino of iris1", str(path))[0].code == "missing"
    path.symlink_to("/dev/ptmx")
    assert serial_lines.look("arduino of iris1", str(path))[0].code == "in_use", "the other end is still open"
    os.close(ours)
    assert socket_owners.users_of_device(str(tmp_path)) == []
    path.unlink()
    path.write_text("")
    assert serial_lines.look("arduino of iris1", str(path))[0].code == "there"


def test_the_driver_of_the_telemetry_has_its_device_to_itself(monkeypatch):
    driver = socket_owners.Process(7, ("/usr/bin/python3", "/x/driver.py", "--device=/dev/null", "__name:=roscopter"))
    monitor = socket_owners.Process(8, ("minicom", "-D", "/dev/null"))
    second = socket_owners.Process(9, ("/usr/bin/python3", "/x/driver.py", "--device=/dev/null", "__name:=other"))
    for users, code, named in (
        ([driver], "driven", 7),
        ([driver, monitor], "in_use", 8),
        ([driver, second], "in_use", 9),
    ):
        monkeypatch.setattr(serial_lines, "users_of_device", lambda path, users=users: users)
        (finding,) = serial_lines.look("telemetry of iris1", "/dev/null")
        assert finding.code == code and "(pid %d)" % named in finding.text


def test_lines_of_a_graph_and_of_a_fleet():
    graph = ros_graph.GraphReport(lines={"/iris1/arduino": line(Cause.SPEED), "/iris2/arduino": None})
    vehicle = types.SimpleNamespace(namespace="iris1", devices={"arduino": "/dev/ttyACM9", "telemetry": "/dev/none"})
    situation = types.SimpleNamespace(graph=lambda: graph, vehicles=lambda: (vehicle,))
    found = serial_lines.check(situation)
    assert [finding.code for finding in found] == ["speed", "mute", "missing"], "a device that is served is told once"
    nothing = types.SimpleNamespace(graph=ros_graph.GraphReport, vehicles=tuple)
    assert [finding.code for finding in serial_lines.check(nothing)] == ["none"]


def test_room_and_speed_for_the_bag(tmp_path):
    need_mb_s = 3.5
    space = [disk.judge_space(tmp_path, minutes * 60 * need_mb_s * 1e6, need_mb_s) for minutes in (5, 30, 90)]
    assert levels(space) == [RED, YELLOW, GREEN] and "5 minutes" in space[0].text
    assert levels([disk.judge_speed(tmp_path, speed, need_mb_s) for speed in (2.0, 5.0, 50.0)]) == [RED, YELLOW, GREEN]
    assert disk.write_speed_mb_s(tmp_path, 8 << 20) > 0.0 and not list(tmp_path.iterdir())


def test_a_computer_without_time():
    assert levels([load.judge(1.2, 2), load.judge(5.0, 2)]) == [GREEN, YELLOW]


# ---------------------------------------------------------------- ROS


class Far:
    """A master on another computer."""

    uri = "http://129.123.5.10:11311"


def test_the_address_that_nodes_tell():
    def judge(master=None, several=True, **environment):
        return ros.judge_own_address(environment, [LO, CABLE, WIFI], master, several, "risc1")

    assert levels(judge(ROS_IP="129.123.5.240")) == [GREEN]
    assert levels(judge()) == [YELLOW] and "'risc1'" in judge()[0].text
    alone = ros.judge_own_address({}, [LO], None, False, "localhost")
    assert levels(alone) == [GREEN]
    lost = ros.judge_own_address({}, [LO], None, False, "no-such-host.invalid")
    assert levels(lost) == [RED] and "/etc/hosts" in lost[0].cure
    wrong = judge(ROS_IP="129.123.5.241")
    assert levels(wrong) == [RED] and "export ROS_IP=129.123.5.240, 192.168.1.2" in wrong[0].cure
    both = judge(ROS_IP="129.123.5.240", ROS_HOSTNAME="no.such.host.invalid")
    assert levels(both) == [YELLOW, RED]
    for environment in ({"ROS_IP": "127.0.0.1"}, {"ROS_HOSTNAME": "localhost"}):
        assert "only_here_several: " in text_of(judge(**environment), YELLOW)
        assert "only_here: " in text_of(judge(Far(), several=False, **environment), RED)
    unnamed = judge(Far(), several=False)
    assert levels(unnamed) == [YELLOW] and unnamed[0].code == "no_ip_several" and "'risc1'" in unnamed[0].text


def test_an_own_name_on_the_loopback_card_is_as_debian_has_it(monkeypatch):
    """127.0.1.1 in /etc/hosts: whether other computers resolve the name otherwise, or not, cannot be seen here."""
    monkeypatch.setattr(ros, "resolve", {"risc2": "127.0.1.1"}.get)

    def judge(master):
        return ros.judge_own_address({"ROS_HOSTNAME": "risc2"}, [LO, CABLE], master, True, "risc2")

    assert levels(judge(None)) == [GREEN]
    monkeypatch.setattr(ros, "resolve", {"risc2": "127.0.1.1", "129.123.5.10": "129.123.5.10"}.get)
    (finding,) = judge(Far())
    assert finding.level == YELLOW and "'risc2'" in finding.text and "127.0.1.1" in finding.text
    assert "unset ROS_HOSTNAME; export ROS_IP=129.123.5.240" in finding.cure, "ROS_HOSTNAME wins over ROS_IP"


def test_a_program_that_is_no_master_is_not_waited_for():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen(1)
        uri = "http://127.0.0.1:%d" % listener.getsockname()[1]
        with pytest.raises(MasterError, match="no answer"):
            call(uri, "getPid", patience_s=0.1)
    with pytest.raises(NobodyThereError):
        call(uri, "getPid")


def test_a_master_that_hangs_does_not_keep_the_doctor():
    program = "import atexit, threading; from risc_doctor.__main__ import leave\n"
    program += "atexit.register(threading.Event().wait); print('[]'); leave(1)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60.0)
    assert (done.returncode, done.stdout) == (1, "[]\n")


def test_a_web_server_is_no_master():
    class Page(http.server.BaseHTTPRequestHandler):
        def do_POST(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<html><br>hello</html>")

        def log_message(self, *words):
            """Print nothing: the output is not read."""

    with http.server.HTTPServer(("127.0.0.1", 0), Page) as server:
        threading.Thread(target=server.handle_request, daemon=True).start()
        with pytest.raises(MasterError, match="ROS program"):
            call("http://127.0.0.1:%d" % server.server_address[1], "getPid")


def test_a_master_that_is_not_reached_is_not_called_absent():
    def levels_of(**answer):
        return levels(ros_graph.check(types.SimpleNamespace(master=None, master_error="why", **answer)))

    assert levels_of(nobody_there=True) == [GREEN] and levels_of(nobody_there=False) == [YELLOW]
    here = Situation(VIRTUAL, "", ROOT, {"ROS_MASTER_URI": "http://127.0.0.1:11311"}, master_error="no answer")
    assert levels(ros.judge_master(here)) == [YELLOW]
    assert levels(ros.judge_master(replace(here, nobody_there=True))) == [GREEN]


def test_rates_and_complaints_of_a_graph():
    def report(rates, complaints=()):
        topics = {name: ros_graph.Topic(("/node",), rate_hz) for name, rate_hz in rates.items()}
        return ros_graph.GraphReport(topics=topics, complaints=list(complaints), statuses=3)

    good = report(dict.fromkeys(ros_graph.TOPICS, 199.0))
    assert levels(ros_graph.judge(good, 200.0)) == [GREEN] * 4
    bad = report({"/mocap_data": 0.0, "/cortex_raw": 120.0}, [(2, "stream", "no host"), (1, "est", "slow")])
    findings = ros_graph.judge(bad, 200.0)
    assert levels(findings) == [RED, YELLOW, YELLOW, RED, YELLOW]
    assert (findings[0].code, findings[2].code) == ("silent", "unpublished")
    assert "/node " in findings[0].text and "/controls" in findings[2].text
    assert levels(ros_graph.judge(ros_graph.GraphReport(), 200.0)) == [GREEN]


# ---------------------------------------------------------------- the whole


def test_a_check_that_breaks_does_not_break_the_others():
    def broken(situation):
        raise KeyError("no such thing")

    checks = {"a": ("", lambda situation: [Finding("a", GREEN, "well")]), "ros": ("", broken)}
    findings = run(None, ["ros", "a"], checks)
    assert [(f.check, f.level) for f in findings] == [("ros", RED), ("a", GREEN)]
    assert "KeyError: 'no such thing'" in findings[0].text and "test_doctor.py" in findings[0].text


def doctor(*words, **environment):
    """Exit code, output and complaints of the command."""
    command = [sys.executable, "-m", "risc_doctor", *map(str, words)]
    environment = dict(os.environ, **environment)
    done = subprocess.run(command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--only", "weather"], "'weather'"),
        (["nowhere.yaml"], "nowhere.yaml"),
        (["--vehicle", "risc9"], "'risc9'"),
        (["--axes", "risc1", "--json"], "--json"),
        (["--axes", "risc1"], "terminal"),
    ],
)
def test_wrong_use_is_told_in_one_line(words, complaint, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    try:
        code = main(words)
    except SystemExit as ended:
        code = ended.code
    out, complaints = capsys.readouterr()
    assert code == 2 and not out and complaint in complaints.splitlines()[-1]


@pytest.mark.parametrize("how", [[], pytest.param(["--json"], marks=pytest.mark.release)])
def test_a_reader_that_has_read_enough_is_no_error(how):
    """`./maap doctor | head`"""
    reader, writer = os.pipe()
    os.close(reader)
    command = [sys.executable, "-m", "risc_doctor", "--only", "joystick", "--joystick", "/dev/null", *how]
    with os.fdopen(writer, "w") as nobody:
        done = subprocess.run(command, stdout=nobody, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (1, "")


def maap(folder, python, *words):
    """Run `./maap WORDS` in a dummy of a built workspace, and see that it makes nothing there.

    python: shell commands that take the place of Python.
    """
    (folder / ".venv" / "bin").mkdir(parents=True)
    (folder / ".venv" / "bin" / "python").write_text("#!/bin/sh\n%s\n" % python)
    (folder / ".venv" / "bin" / "python").chmod(0o755)
    (folder / "devel").mkdir()
    (folder / "devel" / "setup.bash").touch()
    shutil.copy(str(ROOT / "maap"), str(folder))
    (folder / ".maap.lock").touch()
    there = sorted(folder.rglob("*"))
    done = subprocess.run([str(folder / "maap"), *words], capture_output=True, text=True)
    assert sorted(folder.rglob("*")) == there
    return done


@pytest.mark.parametrize(
    ("words", "program"),
    [
        (["doctor", "--json"], "risc_doctor --json"),
        (["machines", "check", "a.launch"], "risc_doctor.machines check a.launch"),
        (["report", "a.bag"], "data_extraction.report a.bag"),
        (["screenshot", "a.bag"], "risc_experiments.screenshot a.bag"),
        (["soak", "--table", "a"], "risc_experiments.soak --table a"),
        (["stop"], "risc_experiments.stop"),
    ],
)
def test_maap_builds_nothing_before_it_looks(words, program, tmp_path):
    """Others may be flying."""
    for name in ("apt-packages.txt", "apt-packages-rviz.txt", "requirements.txt"):
        (tmp_path / name).touch()
    done = maap(tmp_path, 'echo "$@"', *words)
    assert (done.returncode, done.stdout) == (0, "-m %s\n" % program), done.stderr


@pytest.mark.parametrize(("package", "cure"), [("no-such-package", "setup"), ("dpkg", "build")])
def test_a_doctor_that_cannot_run_names_the_cure(package, cure, tmp_path):
    """`machines deploy` brings the workspace to a laptop before its packages are installed there."""
    (tmp_path / "apt-packages.txt").write_text(package + "\n")
    done = maap(tmp_path, "echo line; echo Traceback >&2; echo 'No module named psutil' >&2; exit 1", "doctor")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (1, "", 1)
    assert "psutil" in done.stderr and done.stderr.endswith("./maap %s\n" % cure)


def test_what_another_computer_asks_for_comes_as_one_line_of_json(tmp_path):
    start = time.monotonic()
    code, out, complaints = doctor(
        *("--json", "--only", "workspace,disk,joystick,clock,drone", "--joystick", "/dev/null"),
        *("--drone", "127.251.1.1", "--bag-folder", tmp_path),
    )
    assert code == 1 and not complaints and len(out.splitlines()) == 1
    found = {(item["check"], item["level"]): item for item in json.loads(out)}
    assert {check for check, _ in found} == {"workspace", "disk", "joystick", "clock", "vehicles"} <= set(CHECKS)
    assert "127.251.1.1" in found["vehicles", RED]["text"] and ("joystick", RED) in found
    assert set(found["workspace", GREEN]["data"]) == {"path", "revision", "content"}
    assert found["disk", GREEN]["data"]["speed_mb_s"] > 0.0
    assert time.monotonic() - start < 60.0, "hangs"
