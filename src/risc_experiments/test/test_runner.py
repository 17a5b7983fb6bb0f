"""The parts of the runner that judge a flight, end processes and show progress."""

import io
import os
import pathlib
import re
import socket
import subprocess
import sys

import numpy as np
import pytest
import yaml

from data_extraction.flight_metrics import Flight, Mocap, VehicleFlight
from data_extraction.progress import Progress
from data_extraction.report.faults import FaultOutcome, Faults, Out
from risc_experiments.flight_progress import flight_detail
from risc_experiments.fly import FlightError, WebPage, arguments, launch_arguments, longest_s, prepare_fleet
from risc_experiments.judge import judge
from risc_experiments.operator import OperatorParams, time_limit_s
from risc_lab.lab import Arena, generated_fleet, load_fleet
from risc_lab.phases import OutCause
from risc_lab.ros.launching import MARK, Launch, PortReservation, free_tcp_port, marked_processes, wait_until


def vehicle(**changes):
    """A vehicle that flew a circle perfectly and landed."""
    t_s = np.arange(0.0, 40.0, 0.01)
    path = np.column_stack((np.cos(t_s), np.sin(t_s), np.where(t_s < 39.0, 1.0, 0.08)))
    result = VehicleFlight(t_s, path, path.copy(), np.zeros(len(t_s)), np.zeros(len(t_s)), (t_s > 5.0) & (t_s < 35.0))
    result.settle_s, result.position_rmse_m, result.position_max_m, result.yaw_rmse_rad = 0.0, 0.01, 0.02, 0.01
    for name, value in changes.items():
        setattr(result, name, value)
    return result


def reasons(failure="", **changes):
    return judge(Flight(0.0, {"Raven": vehicle(**changes)}, {}, Mocap(), "ground truth"), failure)


def test_a_good_flight_passes():
    assert reasons() == []


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"course": np.zeros(4000, dtype=bool)}, "never reached"),
        ({"settle_s": None, "position_rmse_m": None}, "never settled"),
        ({"position_rmse_m": 0.2}, "RMSE 200 mm "),
        ({"position_max_m": 0.5}, "largest error 500 mm"),
        ({"yaw_rmse_rad": 0.5}, "yaw RMSE 28.6 deg"),
        ({"actual_m": np.tile([2.47, 0.0, 0.1], (4000, 1))}, "net"),
        ({"actual_m": np.tile([0.0, 0.0, 0.9], (4000, 1))}, "still 0.90 m up"),
    ],
)
def test_each_way_to_fail_is_named(changes, reason):
    assert len(reasons(**changes)) == 1
    assert reasons(**changes)[0].startswith("Raven: ") and reason in reasons(**changes)[0]


def test_an_error_that_grows_is_told():
    t_s = vehicle().t_s
    path = vehicle().actual_m + np.outer(np.select([t_s < 15.0, t_s < 25.0], [0.1, 0.2], 0.3), [1.0, 0.0, 0.0])
    path[-1, 2] = 0.08
    (reason,) = reasons(position_rmse_m=0.2, actual_m=path)
    assert reason.endswith(" 100, 200, 300 mm)")


def test_two_faults_are_both_named():
    assert len(reasons(position_rmse_m=0.2, position_max_m=0.5)) == 2


def test_the_operator_has_a_say():
    assert reasons("no take-off") == ["no take-off"]


def fault(begin_s=10.0, vehicle="risc1", outcome="landed", is_safe=True):
    return FaultOutcome("jump", "0.3", vehicle, begin_s, begin_s + 1.0, outcome, is_safe, {}, flying=2)


def judged(faults, out=(), left_ok_s=(), kept_apart=(), **changes):
    """Reasons to fail a flight of fluffy_II (risc1), with these changes, and Raven (risc2), which did well."""
    vehicles = {"fluffy_II": vehicle(**changes), "Raven": vehicle()}
    found = Faults(list(faults), 0, 5.0, dict(out), dict(left_ok_s), set(kept_apart))
    names = {"fluffy_II": "risc1", "Raven": "risc2"}
    return judge(Flight(0.0, vehicles, {}, Mocap(), "ground truth"), "", faults=found, namespaces=names)


FAR_OFF = {"position_rmse_m": 0.2, "position_max_m": 1.0}
LANDED = Out(12.0, OutCause.LADDER, "landed by its safety ladder (state 500 ms old)")


def test_a_vehicle_that_suffered_may_land_and_be_off_its_course():
    assert judged([fault()], {"risc1": LANDED}, {"risc1": 11.5}, **FAR_OFF) == []
    assert judged([fault(vehicle="")], {"risc1": LANDED, "risc2": LANDED}, **FAR_OFF) == []
    for nobody in ([], [fault(vehicle="risc2")]):
        assert len(judged(nobody, **FAR_OFF)) == 2, "without a fault of its own it must be where it should"
    nowhere = np.zeros(4000, dtype=bool)
    assert judged([fault()], {"risc1": LANDED}, {"risc1": 11.5}, course=nowhere) == [], "landed on the way to a figure"
    (up,) = judged([fault()], actual_m=np.tile([0.0, 0.0, 0.9], (4000, 1)))
    assert up.startswith("fluffy_II: ") and "0.90 m" in up


def test_an_outcome_that_is_not_safe_fails_the_flight():
    assert judged([fault(), fault(outcome="breach", is_safe=False)]) == ["fault jump:0.3: breach"]


@pytest.mark.parametrize(
    ("faults", "out", "kept_apart", "excused"),
    [
        ([fault(vehicle="risc2")], LANDED, (), False),  # the fault is another vehicle's
        ([fault(vehicle="risc2")], LANDED, ["risc1"], True),  # it was too near to that vehicle
        ([fault(13.0)], LANDED, (), False),  # the fault had not begun
        ([], LANDED, (), False),
        ([fault()], Out(12.0, OutCause.NODE, "lost its joystick node"), (), False),  # a fault ends no node
        ([fault()], Out(40.0, OutCause.OVERDUE, "did not land within 30 s"), (), False),
        ([fault()], Out(12.0, OutCause.SILENT, "silent: no report for 2 s"), (), True),
    ],
)
def test_what_no_fault_explains_fails_the_flight(faults, out, kept_apart, excused):
    assert judged(faults, {"risc1": out}, kept_apart=kept_apart) == ([] if excused else ["risc1 " + out.reason])


def test_marked_processes_are_found_by_their_mark_only():
    sleepers = [
        subprocess.Popen(
            [sys.executable, "-c", "import time; print('here', flush=True); time.sleep(60)"],
            env=dict(os.environ, **{MARK: mark}),
            stdout=subprocess.PIPE,
        )
        for mark in ("flight-a", "flight-b")
    ]
    try:
        assert [sleeper.stdout.readline() for sleeper in sleepers] == [b"here\n"] * 2  # its environment is its own now
        assert list(marked_processes("flight-a")) == [sleepers[0].pid]
        assert marked_processes("flight") == {}
    finally:
        for sleeper in sleepers:
            sleeper.kill()
            sleeper.communicate()
    assert marked_processes("flight-a") == {}


def test_no_launch_outlives_the_program_that_started_it(tmp_path):
    """However that dies: the next flight would find its ports taken, and nothing would land its vehicles."""
    pytest.importorskip("roslaunch")
    (tmp_path / "empty.launch").write_text("<launch/>")
    script = """import sys, time
from risc_lab.ros.launching import Launch
launch = Launch(sys.argv[1] + "/empty.launch", {}, sys.argv[1], int(sys.argv[2]))
print(launch.identity, flush=True)
time.sleep(60.0)"""
    command = [sys.executable, "-c", script, str(tmp_path), str(free_tcp_port())]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        identity = program.stdout.readline().strip()
        # not while rosout is being started, which roscore would not end yet
        assert wait_until(lambda: any("/rosout " in command for command in marked_processes(identity).values()), 30.0)
        program.kill()
    assert wait_until(lambda: not marked_processes(identity), 30.0)


def test_nothing_is_launched_before_the_master_says_what_its_run_is_called(tmp_path, monkeypatch):
    """roslaunch would invent a run id, and end. This master listens for a second before it has one."""
    master = """import sys, time
from xmlrpc.server import SimpleXMLRPCServer
begin_s, server = time.monotonic(), SimpleXMLRPCServer(("127.0.0.1", int(sys.argv[2])), logRequests=False)
server.register_function(lambda caller, key: [1, "", time.monotonic() > begin_s + 1.0], "hasParam")
server.serve_forever()"""
    launch = """import os, xmlrpc.client
print("is up:", xmlrpc.client.ServerProxy(os.environ["ROS_MASTER_URI"]).hasParam("/test", "/run_id")[2])"""
    for name, text in (("roscore", master), ("roslaunch", launch)):
        (tmp_path / name).write_text("#!%s\n%s\n" % (sys.executable, text))
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    started = Launch("any.launch", {}, tmp_path, free_tcp_port())
    try:
        assert wait_until(lambda: not started.running(), 30.0)
        assert started.log_tail() == "is up: True"
    finally:
        started.stop()


def test_reservations_do_not_share_a_subnet():
    numbers = range(252, 254)  # used by no other test: test files run in parallel
    first, second = PortReservation(numbers), PortReservation(numbers)
    try:
        assert {first.subnet, second.subnet} == {"127.252", "127.253"}
        with pytest.raises(RuntimeError, match="loopback"):
            PortReservation(numbers)
        first.close()
        third = PortReservation(numbers)
        assert third.subnet == "127.252"
        third.close()
    finally:
        first.close()
        second.close()


def test_free_port_is_free():
    ports = {free_tcp_port() for _ in range(20)}
    assert len(ports) > 10, "those who ask at the same time get different ones"
    first_of_the_kernel = int(pathlib.Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
    assert min(ports) > 1024 and (max(ports) < first_of_the_kernel or first_of_the_kernel < 30000)
    taken = ports.pop()
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", taken))
        assert free_tcp_port(taken) != taken
    assert free_tcp_port(taken) == taken


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_on_a_terminal_renews_one_line_that_fits(monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    terminal = Terminal()
    Progress(terminal).show(
        "fly", flight_detail({"fluffy_II": 4.2, "albatross": None, "Raven": 12.0}, 200.0) + "x" * 80
    )
    assert terminal.getvalue().startswith("\r\033[K") and "\n" not in terminal.getvalue()
    assert len(terminal.getvalue()) <= 59 + len("\r\033[K")


def test_progress_into_a_file_is_lines_without_control_characters():
    stream = io.StringIO()
    progress = Progress(stream)
    progress.show("takeoff")
    progress.show("takeoff", "too soon to be shown again")
    progress.show("fly", flight_detail({"Raven": 3.0}, 200.0))
    progress.say("done")
    lines = stream.getvalue().splitlines()
    assert [line.split()[2] for line in lines[:2]] == ["takeoff", "fly"]
    assert lines[1].endswith("Raven    3 mm  mocap 200 Hz") and lines[2] == "done"
    assert "\033" not in stream.getvalue()


def test_progress_of_many_vehicles_is_one_line():
    errors_mm = {"v%d" % k: float(k) for k in range(20)}
    assert flight_detail(errors_mm, 200.0) == "20 vehicles  median  10  v19   19 mm  mocap 200 Hz"
    errors_mm["v3"] = None
    assert flight_detail(errors_mm, None).startswith("20 vehicles, 1 unknown  median")
    assert flight_detail(dict.fromkeys(errors_mm), None) == "20 vehicles    - mm  mocap -"


def test_the_page_is_told_when_it_is_there_and_not_before():
    stream, port = io.StringIO(), free_tcp_port()
    page = WebPage(port, Progress(stream))
    page.look()
    assert stream.getvalue() == ""
    with socket.socket() as server:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        server.bind(("127.0.0.1", port))
        server.listen(1)
        page.look()
    page.look()
    page.end()
    assert re.fullmatch(".* http://127.0.0.1:%d\n" % port, stream.getvalue())


def test_a_page_that_never_came_is_told_at_the_end():
    stream = io.StringIO()
    page = WebPage(free_tcp_port(), Progress(stream))
    page.look()
    page.end()
    assert "roslaunch.log" in stream.getvalue()


def test_defaults_of_the_command_line():
    args = arguments([])
    assert (args.experiment, args.vehicles, args.duration, args.seed, args.delay) == ("circles3", 3, 30.0, 1, None)
    for demo in ("df_demo", "iris"):
        args = arguments([demo])
        assert (args.vehicles, args.duration) == (1, 20.0)


def test_a_flight_through_waypoints_keeps_them_in_its_folder(tmp_path):
    path = tmp_path / "square.yaml"
    corners = [[1.0, 1.0, 1.0], [-1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [1.0, -1.0, 1.0]]
    path.write_text(yaml.safe_dump({"waypoints": [{"position_m": corner} for corner in corners]}))
    (tmp_path / "flight").mkdir()
    args = arguments(["--vehicles", "1", "--trajectory", str(path), "--speed", "0.9"])
    fleet = prepare_fleet(args, "127.99", tmp_path / "flight")
    told = launch_arguments(args, fleet, tmp_path / "flight")
    assert (told["trajectory"], told["speed"]) == ("square", "0.9")
    assert told["waypoints"].parent == tmp_path / "flight" and told["waypoints"].read_bytes() == path.read_bytes()
    args = arguments(["--vehicles", "1", "--trajectory", str(path), "--speed", "9"])
    with pytest.raises(ValueError, match="'square' .*'ardrone': .* --speed"):
        prepare_fleet(args, "127.99", tmp_path / "flight")


def test_as_many_vehicles_as_asked_for(tmp_path):
    fleet = prepare_fleet(arguments(["--vehicles", "8", "--trajectory", "flat8"]), "127.99", tmp_path)
    assert [v.namespace for v in fleet.vehicles] == ["risc%d" % k for k in range(1, 9)]
    assert fleet == load_fleet(tmp_path / "fleet.yaml") and fleet.vehicles[7].address == "127.99.1.8"
    assert fleet.arena.half_x_m > 2.5 and "ardrone8" in fleet.templates.templates, "the file describes the whole lab"
    assert launch_arguments(arguments(["--vehicles", "8"]), fleet, tmp_path)["vehicles"].split()[7] == "risc8"
    for words, states in (([], "cortex_raw"), (["--states", "cortex_ekf"], "cortex_ekf")):
        assert launch_arguments(arguments(words), fleet, tmp_path)["states"] == states
    few = prepare_fleet(arguments(["--vehicles", "5"]), "127.99", tmp_path)
    assert few.name == "ardrones5" and few.arena == Arena()


def test_a_course_that_cannot_keep_them_apart_is_refused_before_anything_flies(tmp_path):
    small = tmp_path / "small.yaml"
    small.write_text(yaml.safe_dump(dict(generated_fleet(8).to_dict(), arena={"half_x_m": 2.6, "half_y_m": 2.6})))
    with pytest.raises(ValueError, match="'knot'.* 8 "):
        prepare_fleet(arguments(["--fleet", str(small), "--vehicles", "8", "--trajectory", "knot"]), "127.99", tmp_path)
    with pytest.raises(ValueError, match="1 to 250"):
        prepare_fleet(arguments(["--vehicles", "300"]), "127.99", tmp_path)


def test_bearings_need_a_calibrated_camera_on_every_vehicle(tmp_path):
    fleets = pathlib.Path(__file__).resolve().parents[3] / "launch" / "fleets"
    several = ["--fleet", str(fleets / "ardrones5.yaml"), "--vehicles", "4"]
    assert len(prepare_fleet(arguments(["circles3", *several]), "127.99", tmp_path).vehicles) == 4
    with pytest.raises(FlightError, match="risc4.*calibration"):
        prepare_fleet(arguments(["coop", *several]), "127.99", tmp_path)
    typo = tmp_path / "typo.yaml"
    typo.write_text((fleets / "ardrones3.yaml").read_text(encoding="utf-8").replace("risc2.yaml", "risk2.yaml"))
    with pytest.raises(ValueError, match="risk2.yaml"):
        prepare_fleet(arguments(["coop", "--fleet", str(typo)]), "127.99", tmp_path)


@pytest.mark.parametrize(("demo", "kind"), [("df_demo", "ardrone"), ("iris", "iris")])
def test_a_flight_has_time_for_all_that_its_operator_does(tmp_path, demo, kind):
    """The demos rest at the origin before each of their figures."""
    args = arguments([demo, "--duration", "20"])
    fleet = prepare_fleet(args, "127.99", tmp_path)
    steps = launch_arguments(args, fleet, tmp_path)["bumper_steps"]
    assert longest_s(args) - time_limit_s(OperatorParams(duration=20.0, bumper_steps=steps)) > 25.0
    assert steps == 5 and "bumper_steps" not in launch_arguments(arguments([]), fleet, tmp_path)
    assert [vehicle.type for vehicle in fleet.vehicles] == [kind]


def test_the_experiment_of_the_iris_wants_one(tmp_path):
    mixed = pathlib.Path(__file__).resolve().parents[3] / "launch/fleets/mixed3.yaml"
    with pytest.raises(FlightError, match="'mixed3' .*'ardrone'"):
        prepare_fleet(arguments(["iris", "--fleet", str(mixed)]), "127.99", tmp_path)


def test_a_vehicle_may_be_heard_of_while_the_last_ones_are_shown():
    """Its report arrives in a thread of rospy."""
    pytest.importorskip("rospy")
    from risc_experiments.ros.watch import Watch
    from risc_maap_msgs.msg import ControllerReport, TrackingError

    watch = Watch.__new__(Watch)
    watch.errors_mm, watch.oldest_ms = {}, []

    def hear(name):
        watch._on_controller(ControllerReport(vehicles=[TrackingError(name, 0.004)]))

    hear("risc1")
    for _ in watch.errors_mm:
        hear("risc2")
    assert watch.errors_mm == {"risc1": 4.0, "risc2": 4.0}
