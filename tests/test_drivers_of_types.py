"""Each type of vehicle is flown by its own driver, through the same launch files.

A toy type from a folder of members has two driver nodes: they start beside ardrone_driver and fly the toy's virtual
vehicle.
"""

import os
import pathlib
import re
import struct
import subprocess
import sys
import threading
import time

import pytest
import roslaunch
import yaml

from risc_doctor import ros_master
from risc_lab.lab import fleet_from_dict
from risc_lab.ros.launching import Launch, PortReservation, free_tcp_port, marked_processes
from risc_simulator.models.flight import FlightPhase
from risc_simulator.virtual_lab import VirtualLab

ROOT = pathlib.Path(__file__).resolve().parents[1]
LAUNCH = ROOT / "launch/vehicles.launch"
MEMBERS = ROOT / "src/risc_experiments/test/members"
TEMPLATES = {"risc1": "fluffy_II", "risc2": "albatross", "risc3": "Raven"}
TOY_NODES = {"/risc2/toy_commands", "/risc2/toy_status"}
STARTED_S, RISEN_S = 120.0, 20.0
TAKE_OFF, UP = 6, 9  # buttons, see JoystickParams


@pytest.fixture(autouse=True)
def members(monkeypatch):
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(MEMBERS))


def make_fleet(subnet="127.77", **types):
    return fleet_from_dict(
        {
            "name": "mixed",
            "mocap": {"host": subnet + ".0.1", "stream_port": 12001},
            "vehicles": [
                {"namespace": name, "template": TEMPLATES[name], "type": kind, "address": "%s.1.%d" % (subnet, k),
                 "start": {"position_m": [1.2 * k - 2.4, 0, 0]}}
                for k, (name, kind) in enumerate(types.items(), 1)
            ],
        }
    )  # fmt: skip


def written(fleet, folder):
    path = folder / "fleet.yaml"
    path.write_text(yaml.safe_dump(fleet.to_dict()), encoding="utf-8")
    return path


def load(folder, monkeypatch, **types):
    """({node}, parameters) of the launch file for vehicles of these types."""
    monkeypatch.setenv("ROS_LOG_DIR", str(folder / "log"))
    config = roslaunch.config.ROSLaunchConfig()
    argv = ["names:=" + " ".join(types), "fleet:=%s" % written(make_fleet(**types), folder)]
    roslaunch.xmlloader.XmlLoader().load(str(LAUNCH), config, argv=argv, verbose=False)
    return {node.namespace + node.name for node in config.nodes}, config.params


def test_each_type_has_its_driver_and_one_serves_all_ardrones(tmp_path, monkeypatch):
    nodes, params = load(tmp_path, monkeypatch, risc1="ardrone", risc2="toy_quad", risc3="ardrone")
    assert nodes == {"/ardrone_driver", "/joystick_controller", *TOY_NODES}
    assert params["/risc2/toy_commands/address"].value == "127.77.1.2"
    addresses = {name: param.value for name, param in params.items() if name.endswith("/drone_ip")}
    where = "/ardrone_driver/vehicles/%s/drone_ip"
    assert addresses == {where % "risc1": "127.77.1.1", where % "risc3": "127.77.1.3"}
    assert params["/drivers"].value == {"ardrone": ["risc1", "risc3"], "toy_quad": ["risc2"]}


def test_a_home_is_not_needed(tmp_path, monkeypatch):
    """Services that a computer starts by itself have none."""
    monkeypatch.delenv("HOME", raising=False)
    nodes, _ = load(tmp_path, monkeypatch, risc1="ardrone")
    assert "/ardrone_driver" in nodes
    assert list((tmp_path / "log").glob("drivers*.launch"))


def test_without_an_ardrone_its_driver_is_not_started(tmp_path, monkeypatch):
    nodes, _ = load(tmp_path, monkeypatch, risc2="toy_quad")
    assert nodes == {"/joystick_controller", *TOY_NODES}


def test_a_type_may_take_the_driver_of_another(tmp_path, monkeypatch):
    (tmp_path / "vehicle_types").mkdir()
    content = yaml.safe_load((ROOT / "src/risc_lab/config/vehicle_types/ardrone.yaml").read_text(encoding="utf-8"))
    content.update(name="heavy", mass_kg=0.5, driver="ardrone")
    (tmp_path / "vehicle_types/heavy.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(tmp_path))
    nodes, params = load(tmp_path, monkeypatch, risc1="ardrone", risc2="heavy")
    assert nodes == {"/ardrone_driver", "/joystick_controller"}
    assert params["/ardrone_driver/vehicles/risc2/drone_ip"].value == "127.77.1.2"


def test_a_driver_is_told_what_to_open(tmp_path, monkeypatch):
    folder = tmp_path / "vehicle_types"
    folder.mkdir()
    content = yaml.safe_load((MEMBERS / "vehicle_types/toy_quad.yaml").read_text(encoding="utf-8"))
    content.update(name="wired", devices={"line": "socket://{address}:11411"})
    (folder / "wired.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    (folder / "wired.launch").write_text(
        "<launch><arg name='namespace'/><arg name='line'/><arg name='lift'/><group ns='/$(arg namespace)'>"
        "<param name='line' type='str' value='$(arg line)'/><param name='lift' value='$(arg lift)'/></group></launch>"
    )
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(tmp_path))
    params = load(tmp_path, monkeypatch, risc1="wired")[1]
    assert params["/risc1/line"].value == "socket://127.77.1.1:11411"
    assert params["/risc1/lift"].value == content["own"]["lift"], "a number of its own"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [(None, "no lone.launch in"), ("<launch><arg name='baud'/></launch>", "'baud'")],
)
def test_what_is_missing_is_said(tmp_path, monkeypatch, capfd, text, complaint):
    folder = tmp_path / "vehicle_types"
    folder.mkdir()
    content = (MEMBERS / "vehicle_types/toy_quad.yaml").read_text(encoding="utf-8")
    (folder / "lone.yaml").write_text(content.replace("toy_quad", "lone"), encoding="utf-8")
    if text is not None:
        (folder / "lone.launch").write_text(text)
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(tmp_path))
    with pytest.raises(roslaunch.RLException, match="fleet_value"):
        load(tmp_path, monkeypatch, risc1="lone")
    assert complaint in capfd.readouterr().err


class Stick:
    """A joystick for joy_node to read."""

    def __init__(self, path):
        os.mkfifo(path)
        self._fd = os.open(path, os.O_RDWR)

    def press(self, button, value):
        os.write(self._fd, struct.pack("=IhBB", 0, value, 1, button))


def wait_until(condition, timeout_s, problem):
    deadline = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < deadline, problem()
        time.sleep(0.1)


def both_launch_files(fleet, folder):
    """A launch file that includes those of the fleet and of its vehicles, without motion capture, with joysticks in the
    folder.
    """
    path = folder / "both.launch"
    names = {"launch": LAUNCH.parent, "fleet": fleet, "folder": folder}
    path.write_text(
        "<launch><include file='{launch}/fleet.launch'><arg name='fleet' value='{fleet}'/></include>"
        "<include file='{launch}/vehicles.launch'><arg name='names' value='risc1 risc2'/>"
        "<arg name='fleet' value='{fleet}'/><arg name='preflight' value='false'/>"
        "<arg name='joysticks' value='{folder}/js0 {folder}/js1'/></include></launch>".format(**names)
    )
    return path


@pytest.mark.alone
def test_a_toy_flies_by_its_own_driver_beside_an_ardrone(tmp_path):
    reservation = PortReservation()
    fleet = make_fleet(reservation.subnet, risc1="ardrone", risc2="toy_quad")
    stick, port, ended = Stick(tmp_path / "js1"), free_tcp_port(), threading.Event()
    os.mkfifo(tmp_path / "js0")
    lab = VirtualLab(fleet, seed=1)
    thread = threading.Thread(target=lab.run, args=(ended,))
    thread.start()
    launch = Launch(both_launch_files(written(fleet, tmp_path), tmp_path), {}, tmp_path, port, reservation)

    def has(*nodes):
        assert launch.running(), launch.log_tail(40)
        try:
            for node in nodes:
                ros_master.call(ros_master.call("http://127.0.0.1:%d" % port, "lookupNode", node), "getPid")
        except ros_master.MasterError:
            return False
        return True

    def said(*command):
        environment = {**os.environ, "ROS_MASTER_URI": "http://127.0.0.1:%d" % port}
        return subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, timeout=STARTED_S).stdout

    toy = lab.world.vehicles["risc2"]
    rest_m = toy.height_m
    try:
        nodes = *TOY_NODES, "/ardrone_driver", "/joystick_controller", "/risc2/joy_node"
        wait_until(lambda: has(*nodes), STARTED_S, launch.log_tail)

        def takes_off():  # a press may come before joy_node is connected; another one in the air lands it
            if toy.phase is FlightPhase.LANDED:
                stick.press(TAKE_OFF, 1)
                stick.press(TAKE_OFF, 0)
            asked_s = time.monotonic()
            while toy.phase is not FlightPhase.FLYING and time.monotonic() < asked_s + 10.0:
                time.sleep(0.05)
            return toy.phase is FlightPhase.FLYING

        said("rostopic", "echo", "-n1", "/risc2/vehicle_status")  # before it has been heard, the button means land
        wait_until(takes_off, STARTED_S, launch.log_tail)
        stick.press(UP, 1)
        wait_until(lambda: toy.height_m > rest_m + 0.3, RISEN_S, launch.log_tail)
        stick.press(UP, 0)
        for vehicle in fleet.vehicles:
            told = said("rostopic", "echo", "-n1", "/%s/vehicle_status" % vehicle.namespace)
            assert re.search(r'name: "%s"\nstate: \d\nbattery_pct: [1-9]' % vehicle.template, told), told
        listed = said(sys.executable, "-m", "risc_doctor", str(tmp_path / "fleet.yaml"), "--only", "vehicles")
        for name in ("risc1", "risc2"):
            assert re.search(r"%s \(\S+\) .*battery \d+ %%" % name, listed), listed
    finally:
        killed = launch.stop()
        ended.set()
        thread.join()
        lab.close()
        reservation.close()
    assert not killed and not marked_processes(launch.identity)
