"""The files beside a bag that say with what it was flown; and the report of a flight that failed early."""

import json
import pathlib
import re
import subprocess
import threading
import xmlrpc.client

import rosbag
import rospy
import yaml

from data_extraction.progress import Progress
from data_extraction.report.__main__ import make
from data_extraction.report.origin import parameter_hash, read_beside
from risc_experiments.flight_record import plain, write_flight, write_parameters
from risc_experiments.fly import arguments
from risc_experiments.report import make_report
from risc_lab.lab import load_fleet
from risc_lab.revision import revision
from risc_msgs.msg import Cortex, States

ROOT = pathlib.Path(__file__).resolve().parents[3]
FLEET = ROOT / "launch" / "fleets" / "ardrones3.yaml"


def test_a_flight_is_written_down_and_read_again(tmp_path):
    args = arguments(["--seed", "7", "--delay", "0.3", "--fleet", str(FLEET), "--out", str(tmp_path)])
    write_flight(args, load_fleet(FLEET), ROOT, tmp_path)
    parameters = {"rosversion": "1.15.15\n", "rosdistro": "Debian\n", "controller": {"q_yaw": 4.0}}
    write_parameters(parameters, tmp_path)
    (tmp_path / "fleet.yaml").write_text(yaml.safe_dump(load_fleet(FLEET).to_dict()))
    origin = read_beside(tmp_path / "flight.bag")
    flight = origin.flight
    assert origin.command_delays_s() == dict.fromkeys(("fluffy_II", "albatross", "Raven"), 0.3)
    assert (flight["experiment"], flight["seed"], flight["fleet"]) == ("circles3", 7, "ardrones3")
    assert flight["vehicles"] == ["risc1", "risc2", "risc3"]
    assert flight["arguments"]["delay"] == 0.3 and flight["arguments"]["fleet"] == str(FLEET)
    assert flight["versions"]["ROS"] == "Debian 1.15.15" and flight["versions"]["Python"].startswith("3.")
    assert origin.parameters == parameters and origin.hash == parameter_hash(parameters)
    assert (tmp_path / "parameters.yaml").read_text().startswith("controller:"), "sorted"


def test_what_yaml_does_not_know_becomes_text():
    value = plain({1: (pathlib.Path("/a"), None, 2.5, True), "b": xmlrpc.client.Binary(b"x")})
    assert yaml.safe_load(yaml.safe_dump(value)) == {"1": ["/a", None, 2.5, True], "b": value["b"]}
    assert isinstance(value["b"], str)


def git(folder, *words):
    command = ["git", "-c", "user.name=a", "-c", "user.email=a@example.org", "-C", str(folder), *words]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()


def test_the_revision_says_when_there_are_changes(tmp_path):
    assert revision(tmp_path / "nowhere") is None
    git(tmp_path, "init", "--quiet")
    (tmp_path / "a").write_text("1")
    git(tmp_path, "add", "a")
    git(tmp_path, "commit", "--quiet", "-m", "a")
    head = git(tmp_path, "rev-parse", "--short=12", "HEAD")
    assert revision(tmp_path) == head
    (tmp_path / "a").write_text("2")
    assert revision(tmp_path) == head + " with changes"


def test_a_flight_without_a_reference_still_has_its_report(tmp_path):
    (tmp_path / "fleet.yaml").write_text(yaml.safe_dump(load_fleet(FLEET).to_dict()))
    with rosbag.Bag(str(tmp_path / "flight.bag"), "w") as bag:
        for k in range(10):
            message = Cortex(Obj=[States(name="Raven", visible=True, z=1.0)])
            message.header.stamp = rospy.Time.from_sec(1000.0 + 0.1 * k)
            bag.write("/cortex_raw", message, message.header.stamp)
    args = arguments(["--out", str(tmp_path)])
    tried = [{"rate_hz": 250.0, "reason": "too busy"}]
    assert make_report(args, tmp_path, "nobody took off", Progress(), threading.Event(), tried) == 1
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["passed"] is False and len(summary["reasons"]) == 2
    assert (summary["cpu_cores"], summary["memory_mb"], summary["computer"]) == ({}, {}, {}), "nothing was measured"
    assert summary["mocap"]["frames_passed_over"] == 0
    assert (summary["mocap"]["wanted_hz"], summary["mocap"]["given_up"]) == (250.0, tried)
    read = (tmp_path / "report.html").read_text
    text = read(encoding="utf-8")
    assert "FAILED" in text and "simulated" in text
    assert re.search("250 Hz .*: too busy", text)
    assert all(": %s." % reason in text for reason in summary["reasons"])
    make(tmp_path / "flight.bag")
    assert read(encoding="utf-8").count(": too busy") == 1, "made again from the bag it says so, too"
