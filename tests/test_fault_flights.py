"""Whole flights of the whole graph in which something goes wrong, as `./maap fly --fault` makes them."""

import csv
import math
import os
import queue
import signal
import subprocess
import threading
import time
import xmlrpc.client
from dataclasses import replace

import numpy as np
import pytest
import yaml
from faults import limit_ms
from flying import ROOT, fly

from risc_experiments.programs import find
from risc_lab.lab import load_fleet
from risc_lab.ros.launching import MARK, Launch, PortReservation, end_processes, free_tcp_port
from risc_lab.testing import wait_for
from risc_simulator.faults import EVERYONE, REGISTRY, FaultEvent, fault_settings, parse_fault
from risc_simulator.models.flight import FlightPhase
from risc_simulator.socket_host import Told
from risc_simulator.virtual_lab import VirtualLab

pytestmark = pytest.mark.alone
SHORT = ("--vehicles", "1", "--duration", "8", "--mocap-rate", "100")


def flown(folder, *faults, options=SHORT):
    """(exit code, output, summary) of a flight with faults."""
    words = [word for fault in faults for word in ("--fault", fault)]
    code, output, summary, _ = fly(folder, *options, *words)
    return code, output, summary


def hold_in_time(fault, folder, summary):
    """Whether all vehicles that flew were sent the command to hold in time, by the clock of the computer that flies.

    Not before 50 ms, since states may be that old, counted from their exposure; not after the limit plus the greatest
    lateness of the virtual lab.
    """
    reactions_ms = list(fault["reactions_ms"].values())
    most_ms = limit_ms(folder / "fleet.yaml") + summary["lab_late_ms"]["max"]
    return len(reactions_ms) == fault["flying"] and 50.0 < min(reactions_ms) <= max(reactions_ms) <= most_ms


def test_a_flight_goes_on_after_short_faults_and_without_a_master_and_a_long_blackout_lands_it(tmp_path):
    faults = "mocap_blackout:0.3@2", "node_kill:master@4", "node_stop:controller,0.2@4.5", "mocap_blackout:3@6"
    code, output, summary = flown(tmp_path, *faults, options=("--vehicles", "2", *SHORT[2:]))
    assert code == 0, output
    (short, master, hang, long), page = summary["faults"], (tmp_path / "report.html").read_text(encoding="utf-8")
    assert (short["name"], short["args"], short["outcome"]) == ("mocap_blackout", "0.3", "completed"), output
    assert short["start_s"] == pytest.approx(2.0, abs=1.0) and short["end_s"] - short["start_s"] == pytest.approx(0.3)
    assert short["flying"] == 2 and hold_in_time(short, tmp_path, summary), short
    assert (master["name"], master["args"], master["outcome"]) == ("node_kill", "master", "completed"), output
    assert master["start_s"] == pytest.approx(4.0, abs=1.0) and not master["reactions_ms"], "not needed in flight"
    assert (hang["args"], hang["outcome"]) == ("controller,0.2", "completed"), output
    assert hang["end_s"] - hang["start_s"] == pytest.approx(0.2, abs=0.05)
    assert hold_in_time(hang, tmp_path, summary), hang
    assert (long["args"], long["outcome"], long["safe"]) == ("3", "landed", True), output
    mocap = summary["mocap"]
    assert mocap["frames_sent"] - mocap["frames_received"] > 200, "no way round it: single frames are none either"
    assert 'id="faults"' in page and "fault mocap_blackout:0.3 begins" in page


@pytest.mark.release
def test_a_flight_with_a_short_blackout_ends_at_home(tmp_path):
    code, output, summary = flown(tmp_path, "mocap_blackout:0.3@2")
    assert code == 0 and [fault["outcome"] for fault in summary["faults"]] == ["completed"], output


MIXED = ("--fleet", ROOT / "launch" / "fleets" / "mixed3.yaml", "--mocap-rate", "100")  # risc1, risc2 and iris1
OF_TYPES = "risc1", "iris1"  # to which faults of a single vehicle happen
FIRST_S, APART_S, LASTS_S = 2.0, 6.0, 2.0
REST_S = 4.0  # after a long fault, until the next one begins: each is judged until then


def begins(faults):
    """When each of the faults begins [s], and when the flight ends."""
    times_s = [FIRST_S]
    for lasts_s in (parse_fault(text).duration_s for text in faults):
        times_s.append(times_s[-1] + (max(APART_S, lasts_s + REST_S) if math.isfinite(lasts_s) else APART_S))
    return times_s


def each_flown(folder, *faults):
    """Fly a mixed fleet until each fault has begun while all vehicles were up. Returns the outcomes in order."""
    outcomes = []
    while len(outcomes) < len(faults):
        left = faults[len(outcomes) :]
        *starts_s, end_s = begins(left)
        timed = ["%s@%g" % each for each in zip(left, starts_s)]
        duration = ("--duration", "%g" % end_s)
        code, output, summary = flown(folder / str(len(outcomes)), *timed, options=(*MIXED, *duration))
        assert code == 0, output
        found = summary["faults"]
        assert found and all(fault["safe"] for fault in found), output
        events = map(parse_fault, left[: len(found)])
        assert [(fault["name"], fault["args"]) for fault in found] == [(event.fault, event.args) for event in events]
        downs = [k for k, fault in enumerate(found, 1) if fault["outcome"] in ("landed", "breach")]
        assert downs or len(found) == len(left), output
        outcomes += found[: min(downs, default=len(found))]
    return outcomes


def lasting(name, *words, vehicles=OF_TYPES):
    """The fault for each of these vehicles if it is one of a vehicle; a lasting one is limited in time.

    words: its argument; none: the default.
    """
    settings = fault_settings(name)
    if settings.argument == "severity" or not words and math.isinf(settings.default.duration_s):
        shortest_s, longest_s = settings.duration_s
        words += ("duration_s=%g" % min(max(LASTS_S, shortest_s), longest_s),)
    vehicles = vehicles if settings.per_vehicle else [""]
    return ["%s:%s" % (name, ",".join(filter(None, [vehicle, *words]))) for vehicle in vehicles]


FAULTS = [text for name in REGISTRY.names() if not fault_settings(name).on_programs for text in lasting(name)]
FAULTS += ["cut:duration_s=0.05,channel=iris1/arduino"]  # the board is reset, and is back at once
FALLS = [text for text in FAULTS if text.startswith("motor_loss")]  # after which the others land, too
STAYS = [text for text in FAULTS if text not in FALLS]
GRADED = [name for name in REGISTRY.names() if fault_settings(name).grades]
SEVERE = [text for name in GRADED for text in lasting(name, "severe", vehicles=[EVERYONE])]
SEVERE += ["clock_step:1", "clock_step:-1", "burst:5,duration_s=6"]  # at the ends of their ranges
A_TEST = 4  # faults


@pytest.mark.release
@pytest.mark.parametrize(
    "faults",
    [*([text] for text in FALLS), *(STAYS[k : k + A_TEST] for k in range(0, len(STAYS), A_TEST))],
    ids="-".join,
)
def test_every_fault_ends_safe(tmp_path, faults):
    each_flown(tmp_path, *faults)


@pytest.mark.release
@pytest.mark.parametrize("faults", [SEVERE[k : k + A_TEST] for k in range(0, len(SEVERE), A_TEST)], ids="-".join)
def test_every_severe_fault_ends_safe(tmp_path, faults):
    """That of a vehicle happens to all at once."""
    each_flown(tmp_path, *faults)


PROGRAMS = (
    "mocap_client",
    "states_estimation",
    "controller",
    "trajectory",
    "vehicle_node,risc1",
    "vehicle_node,iris1",
    "driver,risc1",
    "driver,iris1",
    "transmitter,iris1",
    "joystick",
    "master",
)
COME_BACK = ("mocap_client", "driver,iris1", "transmitter,iris1")  # they may be back before a vehicle has to land


# Horizontal. Without faults vehicles reach 0.5 m/s and 0.5 m/s^2 on the way to their courses; a stop takes 2.5 m/s^2.
FASTEST_M_S, HARDEST_M_S2 = 0.65, 2.8
OVER_S, STEP_S = 0.2, 0.02  # averaging time; step of the grid


def jumped(folder):
    """{name: (greatest horizontal speed, acceleration)} of those that went beyond the limits, by the ground truth."""
    with (folder / "csv" / "ground_truth.csv").open() as file:
        rows = {float(row["stamp"]): row for row in csv.DictReader(file)}
    stamps_s, found, over = sorted(rows), {}, round(OVER_S / STEP_S)
    grid_s = np.arange(stamps_s[0], stamps_s[-1], STEP_S)
    for name in (key.removesuffix(".visible") for key in rows[stamps_s[0]] if key.endswith(".visible")):
        places_m = np.array([[float(rows[stamp_s]["%s.%s" % (name, axis)]) for axis in "xy"] for stamp_s in stamps_s])
        places_m = np.column_stack([np.interp(grid_s, stamps_s, along) for along in places_m.T])
        speeds = (places_m[over:] - places_m[:-over]) / OVER_S
        accelerations = (speeds[over:] - speeds[:-over]) / OVER_S
        most = tuple(float(np.hypot(*of.T).max()) for of in (speeds, accelerations))
        if most[0] > FASTEST_M_S or most[1] > HARDEST_M_S2:
            found[name] = most
    return found


@pytest.mark.parametrize(
    "motion_m, found",
    [
        (lambda t_s: 0.5 * t_s, False),  # at 0.5 m/s
        (lambda t_s: 0.5 * np.cos(t_s), False),  # as on a course
        (lambda t_s: 0.3 * (t_s >= 1.0), True),  # it jumps
        (lambda t_s: 0.6 * abs(t_s - 1.0), True),  # never too fast, but it turns round at once
    ],
)
def test_a_jump_is_found_in_a_record(tmp_path, motion_m, found):
    (tmp_path / "csv").mkdir()
    with (tmp_path / "csv" / "ground_truth.csv").open("w") as file:
        file.write("stamp,risc1.visible,risc1.x,risc1.y,risc2.visible,risc2.x,risc2.y\n")
        for t_s in np.arange(0.0, 2.0, 0.01):
            file.write("%.2f,True,0,0,True,1,%.4f\n" % (t_s, motion_m(t_s)))
    assert set(jumped(tmp_path)) == ({"risc2"} if found else set())


@pytest.mark.release
@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_that_hangs_for_a_moment_and_one_that_dies_end_safe_and_nobody_jumps(tmp_path, program):
    """Also when it is back: programs that are started again do not make a vehicle that flies jump."""
    name, _, vehicle = program.partition(",")
    hang = ",".join(filter(None, (name, "0.2", vehicle)))
    _, dead = each_flown(tmp_path, "node_stop:" + hang, "node_kill:" + program)
    assert not any(map(jumped, tmp_path.iterdir())), [jumped(folder) for folder in tmp_path.iterdir()]
    assert dead["outcome"] == ("completed" if program == "master" else "landed") or program in COME_BACK


@pytest.mark.release
@pytest.mark.parametrize("duration", ["3", "inf"])
@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_that_hangs_for_long_ends_safe(tmp_path, program, duration):
    name, _, vehicle = program.partition(",")
    (hang,) = each_flown(tmp_path, "node_stop:" + ",".join(filter(None, (name, duration, vehicle))))
    assert jumped(tmp_path / "0") == {}
    assert hang["outcome"] == ("completed" if program == "master" else "landed")


@pytest.mark.release
def test_the_recorder_may_hang_but_not_die_and_who_is_not_there_is_named(tmp_path):
    (hang,) = each_flown(tmp_path / "hang", "node_stop:recorder,2")
    assert hang["outcome"] == "completed"
    for name, fault, cause in (
        ("die", "node_kill:recorder", "flights are judged by what is recorded"),
        ("none", "node_kill:autopilot", "no program 'autopilot' is part of this flight; there are mocap_client,"),
        ("vehicle", "node_kill:driver,risc9", "no vehicle 'risc9'; there are risc1, risc2, iris1"),
    ):
        code, output, _ = flown(tmp_path / name, fault, options=MIXED)
        assert code == 1 and cause in output.splitlines()[-1], output


IDENTITY = "a flight of test_fault_flights"
LIMIT_S = 120.0


@pytest.fixture
def lab(tmp_path):
    """A virtual lab of three that no launch file owns, and the arguments of one that flies them."""
    reservation = PortReservation()
    fleet = load_fleet(ROOT / "launch" / "fleets" / "ardrones3.yaml").in_subnet(reservation.subnet)
    fleet = replace(fleet, mocap=replace(fleet.mocap, rate_hz=100.0))
    path = tmp_path / "fleet.yaml"
    path.write_text(yaml.safe_dump(fleet.to_dict(), sort_keys=False))
    lab, stop = VirtualLab(load_fleet(path), seed=1), threading.Event()
    lab.launch_arguments = {"lab": "false", "fleet": path, "rate": 100, "duration": 300}
    lab.orders = queue.SimpleQueue()  # carried out by its own thread

    def obey():
        while not lab.orders.empty():
            lab.orders.get()()

    runner = threading.Thread(target=lab.run, args=(stop, None, obey), daemon=True)
    runner.start()
    yield lab
    stop.set()
    runner.join()
    lab.close()
    reservation.close()


def all_told(lab, told):
    return all(host.told is told for host in lab.vehicle_hosts.values())


def all_landed(lab):
    return all(vehicle.phase is FlightPhase.LANDED for vehicle in lab.world.vehicles.values())


@pytest.mark.release
def test_a_roslaunch_that_owns_the_master_lands_all_vehicles_when_that_dies(lab, tmp_path):
    port = free_tcp_port()
    environment = dict(
        os.environ, ROS_MASTER_URI="http://127.0.0.1:%d" % port, ROS_IP="127.0.0.1", ROS_HOME=str(tmp_path)
    )
    words = ["%s:=%s" % item for item in lab.launch_arguments.items()]
    command = ["roslaunch", "-p", str(port), str(ROOT / "launch" / "circles3.launch"), *words]
    with (tmp_path / "roslaunch.log").open("wb") as log:
        launch = subprocess.Popen(
            command, env=dict(environment, **{MARK: IDENTITY}), stdout=log, stderr=log, start_new_session=True
        )
    try:
        wait_for(lambda: all_told(lab, Told.FLY), limit_s=LIMIT_S)
        find(IDENTITY, "master").kill()
        wait_for(lambda: all_told(lab, Told.LAND) and all_landed(lab), limit_s=LIMIT_S)
        wait_for(lambda: launch.poll() is not None, limit_s=LIMIT_S)
        assert not lab.world.crashes
    finally:
        launch.send_signal(signal.SIGINT)
        launch.wait(LIMIT_S)
        end_processes(IDENTITY)


@pytest.mark.release
def test_beside_a_roscore_of_its_own_the_fleet_flies_on_and_lands_when_roslaunch_ends(lab, tmp_path):
    port = free_tcp_port()
    launch = Launch(ROOT / "launch" / "circles3.launch", lab.launch_arguments, tmp_path, port)
    try:
        wait_for(lambda: all_told(lab, Told.FLY), limit_s=LIMIT_S)
        find(launch.identity, "master").kill()
        until_s = lab.world.time_s + 10.0
        while lab.world.time_s < until_s:
            assert all_told(lab, Told.FLY) and launch.running()
            time.sleep(0.05)
    finally:
        killed = launch.stop()
    assert not killed
    wait_for(lambda: all_landed(lab), limit_s=LIMIT_S)
    assert not lab.world.crashes


@pytest.mark.release
@pytest.mark.parametrize("ladder", [True, False])
def test_a_vehicle_that_is_seen_turned_lands_and_without_the_ladder_crashes(lab, tmp_path, ladder):
    port = free_tcp_port()
    launch = Launch(ROOT / "launch" / "circles3.launch", lab.launch_arguments, tmp_path, port)
    try:
        master = xmlrpc.client.ServerProxy("http://127.0.0.1:%d" % port)  # up, and roslaunch has just begun
        assert master.setParam("/test", "/joystick_controller/ladder", ladder)[0] == 1
        wait_for(lambda: all_told(lab, Told.FLY), limit_s=LIMIT_S)
        until_s = lab.world.time_s + 12.0  # on their courses
        wait_for(lambda: lab.world.time_s > until_s, limit_s=LIMIT_S)
        lab.orders.put(lambda: lab.inject(FaultEvent("flip", "risc1", duration_s=15.0)))
        turned = lab.world.vehicles["risc1"]
        wait_for(lambda: lab.world.crashes or turned.phase is FlightPhase.LANDED, limit_s=LIMIT_S)
    finally:
        launch.stop()
    assert bool(lab.world.crashes) is not ladder
