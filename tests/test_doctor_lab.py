"""The doctor and running programs: a vehicle moved by hand, a graph, a virtual lab with one fault after the other."""

import contextlib
import dataclasses
import io
import json
import os
import pathlib
import queue
import re
import signal
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import yaml

from risc_doctor import by_hand
from risc_doctor.__main__ import main
from risc_doctor.checks import CHECKS
from risc_doctor.findings import GREEN, RED, YELLOW, exit_code
from risc_doctor.ros_master import Master, MasterError
from risc_lab.lab import load_fleet, load_templates
from risc_lab.ros.launching import Launch, PortReservation, free_tcp_port, marked_processes
from risc_simulator.cortex_host import CortexHost
from risc_simulator.faults import parse_fault
from risc_simulator.models.mocap_cameras import CameraParams, MocapCameras
from risc_simulator.virtual_lab import VirtualLab

ROOT = pathlib.Path(__file__).resolve().parents[1]
PATIENCE_S = 120.0
GRAPH_HZ = 50.0  # of motion capture; the test only asks whether the nodes run


@contextlib.contextmanager
def reserved_fleet():
    """A fleet at addresses and with a stream port that no other process uses."""
    reservation = PortReservation()
    try:
        fleet = load_fleet(ROOT / "launch" / "fleets" / "ardrones3.yaml").in_subnet(reservation.subnet)
        port = free_tcp_port()  # needed for UDP, but Linux gives a reserved TCP port to no other process either
        yield dataclasses.replace(fleet, mocap=dataclasses.replace(fleet.mocap, stream_port=port))
    finally:
        reservation.close()


class RunningLab:
    """A virtual lab in a thread of its own."""

    def __init__(self, fleet):
        self.fleet = fleet
        self._lab = VirtualLab(fleet, live=True)
        self._orders = queue.Queue()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        try:
            self._lab.run(self._stop, on_frame=self._obey)
        finally:
            self._lab.close()

    def _obey(self):
        while not self._orders.empty():
            order, done = self._orders.get()
            order(self._lab)
            done.set()

    def do(self, order):
        """Call a function of the lab in its thread."""
        done = threading.Event()
        self._orders.put((order, done))
        assert done.wait(PATIENCE_S)

    def close(self):
        self._stop.set()
        self._thread.join(PATIENCE_S)


@pytest.fixture
def no_master(monkeypatch):
    """An environment in which no ROS master runs."""
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:%d" % free_tcp_port())
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    monkeypatch.delenv("ROS_HOSTNAME", raising=False)


def arguments(fleet, folder, *words):
    """Arguments of the doctor; fleet: Fleet, None = that of the graph."""
    path = folder / "fleet.yaml"
    if fleet is not None:
        path.write_text(yaml.safe_dump(fleet.to_dict()))
        words = (str(path), *words)
    return [*words, "--json", "--bag-folder", str(folder)]


def sorted_out(printed):
    """{(check, level): "code: text -> cure"; ...} of the doctor's JSON."""
    found = {}
    for item in json.loads(printed):
        key = item["check"], item["level"]
        found[key] = found.get(key, "") + "%(code)s: %(text)s -> %(cure)s\n" % item
    return found


def doctor(*situation):
    """Run the doctor in this process, which makes no difference without a graph. Returns (findings, exit code).

    situation: see `arguments`.
    """
    with contextlib.redirect_stdout(io.StringIO()) as out:
        code = main(arguments(*situation))
    return sorted_out(out.getvalue()), code


def doctor_process(*situation):
    """As `doctor`, in a process of its own: with its own node, and this process is another program to it."""
    command = [sys.executable, "-m", "risc_doctor", *arguments(*situation)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode in (0, 1), done.stderr
    return sorted_out(done.stdout), done.returncode


def levels(found, check):
    return {level for name, level in found if name == check}


# ---------------------------------------------------------------- move +x, see +x


class HandWorld:
    """A world with one vehicle that is moved by hand, seen in a frame that is `matrix` times the lab's."""

    def __init__(self, matrix):
        self.time_s = 0.0
        self.at_m = np.array([0.3, -0.2, 0.1])
        self._matrix = np.asarray(matrix, dtype=float)
        self._markers_m = load_templates()["fluffy_II"].markers_m * (1.0, -1.0, -1.0)

        self.layout = (("fluffy_II", len(self._markers_m)),)

    def markers_m(self):
        return (self._markers_m + self.at_m) @ self._matrix.T


@contextlib.contextmanager
def host_of(world, mocap):
    """A Cortex host that shows the world, in a thread."""
    cameras = MocapCameras(CameraParams.ideal())
    host = CortexHost(world, mocap, cameras, live_on_start=True)
    stop = threading.Event()

    def run():
        start_s = time.monotonic()
        while not stop.wait(1.0 / mocap.rate_hz):
            for sock in host.sockets():
                host.on_readable(sock, world.time_s)
            world.time_s = time.monotonic() - start_s
            host.tick(world.time_s)
        host.close()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(PATIENCE_S)


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        (np.eye(3), []),
        ([[0, 1, 0], [1, 0, 0], [0, 0, 1]], ["+x (forward) is seen as +y", "left_handed"]),
    ],
)
def test_moved_by_hand(matrix, words):
    world = HandWorld(matrix)
    steps = iter([np.zeros(3), [0.5, 0.0, 0.0], np.zeros(3), [0.0, 0.5, 0.0], np.zeros(3), [0.0, 0.0, 0.5]])
    prompts = []

    def operator(prompt):
        prompts.append(prompt)
        time.sleep(0.2)  # people take their time: what came before the move must not count
        world.at_m = world.at_m + next(steps)

    with reserved_fleet() as fleet, host_of(world, fleet.mocap):
        findings = by_hand.look(fleet, "risc1", operator, look_s=0.1)
        unseen = by_hand.look(fleet, "risc2", lambda prompt: None, look_s=0.1)
    assert len(prompts) == 6 and "to the left (+y)" in prompts[3]
    assert exit_code(findings) == bool(words)
    assert words or [finding.level for finding in findings] == [GREEN] * 3, findings
    told = "\n".join("%s: %s" % (finding.code, finding.text) for finding in findings)
    assert all(word in told for word in words), told
    assert exit_code(unseen) == 1 and "'albatross'" in unseen[0].text


# ---------------------------------------------------------------- a graph


def wait_until(true, what):
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < deadline, what
        time.sleep(0.1)


AWAITED = "/risc1/ardrone/navdata", "/mocap_data", "/cortex_raw"
# without the nodes that fly: the doctor looks at these only, and they start sooner
GRAPH = """<launch>
  <arg name="fleet"/>
  <include file="{0}/fleet.launch" pass_all_args="true"/>
  <include file="{0}/lab.launch" pass_all_args="true"/>
  <include file="{0}/mocap.launch" pass_all_args="true"/>
  <group ns="risc1">
    <include file="{0}/driver.launch" pass_all_args="true">
      <arg name="names" value="risc1"/>
    </include>
  </group>
</launch>
"""
LISTENER = """
import sys
import rospy
from ardrone_autonomy.msg import Navdata
from risc_lab.ros.publisher_updates import init_node

init_node("patient", anonymous=True, disable_rostime=True)
for topic in sys.argv[1:]:
    rospy.wait_for_message(topic, rospy.AnyMsg)
while not rospy.wait_for_message("/risc1/ardrone/navdata", Navdata).batteryPercent:
    pass  # the driver configures it still
"""  # one process that waits: starting doctors until all is there would take seconds for each


def everything_is_published():
    with contextlib.suppress(MasterError):  # none yet
        return set(AWAITED) <= set(Master(os.environ["ROS_MASTER_URI"]).publishers())
    return False


@pytest.mark.alone
def test_a_graph_that_runs_is_asked_and_its_vehicles_are_left_alone(tmp_path, monkeypatch):
    port = free_tcp_port()
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:%d" % port)
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    with reserved_fleet() as fleet:
        path = tmp_path / "flown.yaml"
        fleet = fleet.with_vehicles(1)  # the lab needs less time for one
        slower = dataclasses.replace(fleet, mocap=dataclasses.replace(fleet.mocap, rate_hz=GRAPH_HZ))
        path.write_text(yaml.safe_dump(slower.to_dict()))
        file = tmp_path / "graph.launch"
        file.write_text(GRAPH.format(ROOT / "launch"))
        launch = Launch(file, {"fleet": path}, tmp_path, port)
        try:
            wait_until(lambda: launch.running() and everything_is_published(), "the graph does not start")
            subprocess.run([sys.executable, "-c", LISTENER, *AWAITED], check=True, timeout=PATIENCE_S)
            checks = "cortex,vehicles,ros,graph,clock,ports"
            found, _ = doctor_process(None, tmp_path, "--only", checks, "--vehicle", "risc1")
            with monkeypatch.context() as elsewhere:
                elsewhere.setenv("ROS_MASTER_URI", "http://127.0.0.1:%d" % free_tcp_port())
                apart, _ = doctor(fleet, tmp_path, "--only", "vehicles", "--vehicle", "risc1")
            with stopped(process_of(launch, "stream_markers")):
                after, code = doctor_process(None, tmp_path, "--only", "ros,graph")
        finally:
            launch.stop()
    assert "battery: risc1 (%s)" % fleet.vehicles[0].address in found["vehicles", GREEN]
    assert re.search("not_asked: .* ardrone_driver .*127.0.0.1:%d" % port, apart["vehicles", YELLOW])
    assert re.search(r"rate\w*: frames", "".join(found.values())), "the stream is shared with stream_markers"
    assert levels(found, "ports") == {GREEN}, found
    assert ("graph", GREEN) in found or ("graph", YELLOW) in found, found
    for topic in ("/mocap_data", "/cortex_raw"):
        assert re.search("(rate|slow): %s " % topic, "".join(found.values()))
    assert "/cortex_raw" in "".join(text for (check, _), text in found.items() if check == "clock"), found
    assert "http://127.0.0.1:%d" % port in found["ros", GREEN]
    assert code == 1 and re.search("silent: .* /mocap_data,.* /stream_markers ", after["graph", RED])
    assert re.search("dead_nodes: .*/stream_markers.* -> rosnode cleanup", after["ros", YELLOW]), after


@contextlib.contextmanager
def stopped(pid):
    """Context manager: the process hangs (SIGSTOP) inside."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def process_of(launch, word):
    return next(pid for pid, command in marked_processes(launch.identity).items() if word in command)


# ---------------------------------------------------------------- a virtual lab: last, as it runs to the end


@pytest.fixture(scope="module")
def lab():
    with reserved_fleet() as fleet:
        running = RunningLab(fleet)
        yield running
        running.close()


@pytest.mark.alone
def test_every_check_says_something(lab, no_master, tmp_path):
    """What they say is not tested: the joystick, the disk, the clock and the load are this computer's."""
    found, _ = doctor(lab.fleet, tmp_path)
    assert {check for check, _ in found} == set(CHECKS)


@pytest.mark.alone
def test_a_healthy_lab_can_fly(lab, no_master, tmp_path):
    good = "multicast", "ports", "templates", "axes", "vehicles", "ros", "graph"
    found, code = doctor_process(lab.fleet, tmp_path, "--only", ",".join(("network", "cortex", *good)))
    assert code == 0 and not [key for key in found if key[1] == RED], found
    for check in good:
        assert levels(found, check) == {GREEN}, found
    assert "rate: frames" in found["cortex", GREEN] or "rate_" in found["cortex", YELLOW]
    assert found["vehicles", GREEN].count("asked directly") == 3
    assert re.search("plausible: .* fluffy_II, albatross, Raven", found["axes", GREEN])


@pytest.mark.alone
def test_what_is_wrong_with_vehicles(lab, no_master, tmp_path):
    def trouble(the_lab):
        the_lab.world.vehicles["risc2"].set_battery_pct(9.0)
        the_lab.inject(parse_fault("link_blackhole:600,risc3"))

    def mend(the_lab):
        the_lab.world.vehicles["risc2"].set_battery_pct(90.0)
        the_lab.end_faults()

    lab.do(trouble)
    found, code = doctor(lab.fleet, tmp_path, "--only", "vehicles")
    lab.do(mend)
    assert code == 1 and "risc1" in found["vehicles", GREEN]
    assert re.search("battery_low: risc2 .* [89] %", found["vehicles", RED])
    assert "risc3 (%s) " % lab.fleet.vehicles[2].address in found["vehicles", RED]
    assert "charge" in found["vehicles", RED]


@pytest.mark.alone
def test_what_is_wrong_with_motion_capture(lab, no_master, tmp_path):
    only = "--only", "cortex,templates,axes,ports"
    strange = dataclasses.replace(lab.fleet.vehicles[0], template="Fluffy_II")
    other = dataclasses.replace(
        lab.fleet,
        mocap=dataclasses.replace(lab.fleet.mocap, rate_hz=100.0),
        vehicles=(strange, *lab.fleet.vehicles[1:]),
    )
    found, code = doctor(other, tmp_path, *only)
    assert code == 1 and re.search("rate_wrong: .* 100 Hz", found["cortex", YELLOW])
    assert re.search("misspelt: .*'fluffy_II' .*'Fluffy_II'", found["templates", RED])

    lab.do(lambda the_lab: the_lab.cortex_host.set_live(False))
    found, _ = doctor(lab.fleet, tmp_path, *only)
    assert "not_live: " in found["cortex", YELLOW] and levels(found, "axes") == {YELLOW}
    found, _ = doctor(lab.fleet, tmp_path, "--live", "--only", "cortex")
    assert re.search(r"rate\w*: frames", "".join(found.values())), "it was asked to go live"

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief:
        thief.bind(("", lab.fleet.mocap.stream_port))
        found, code = doctor_process(lab.fleet, tmp_path, *only)
    assert code == 1 and "stream_taken: " in found["ports", RED] and "pid %d" % os.getpid() in found["ports", RED]
    assert "no_stream: " in found["cortex", YELLOW]


def test_without_a_lab_nothing_flies_and_a_wrong_address_is_told(no_master, monkeypatch, tmp_path):
    monkeypatch.setenv("ROS_IP", "203.0.113.7")  # nobody's
    with reserved_fleet() as fleet:
        found, code = doctor(fleet, tmp_path)
    assert code == 1
    assert fleet.mocap.host in found["cortex", RED]
    assert found["vehicles", RED].count("silent: ") + found["vehicles", RED].count("no_lab: ") == 3
    assert {levels(found, check) == {YELLOW} for check in ("templates", "axes")} == {True}
    assert "not_own: ROS_IP is 203.0.113.7" in found["ros", RED]
