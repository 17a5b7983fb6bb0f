"""How `./maap machines` judges what it measured, where a real fault of that kind cannot be made on one computer."""

import errno
import os
import socket

import paramiko
import pytest

from risc_experiments.machines import clock, known_hosts, ssh, topics, workspace
from risc_experiments.machines.experiment import Computer

RISC2 = Computer("risc2", "127.0.0.9", user="pilot", env_loader="/ws/devel/coop.sh", nodes=1)
MASTER = "http://127.0.0.1:5000"


@pytest.mark.parametrize(
    ("error", "text", "cure"),
    [
        (socket.timeout(), "no answer from 127.0.0.9 port 22 within 5 s", "same network"),
        (OSError(errno.ENETUNREACH, os.strerror(errno.ENETUNREACH)), "no way to 127.0.0.9", "cable or the Wi-Fi here"),
        (ConnectionRefusedError(), "refuses", "openssh-server"),
        (socket.gaierror(), "cannot be resolved", "/etc/hosts"),
    ],
)
def test_an_unreachable_computer_has_its_own_cause(error, text, cure):
    found = ssh.why_unreachable(error, "127.0.0.9", 22)
    assert text in found[0] and cure in found[1]


@pytest.mark.parametrize(
    ("offset_s", "uncertainty_s", "level"),
    [
        (0.004, 0.001, "green"),
        (-0.004, 0.010, "green"),
        (0.006, 0.001, "yellow"),
        (0.000, 0.025, "yellow"),  # it may be right, nobody knows
        (0.024, 0.025, "yellow"),
        (-0.021, 0.001, "red"),
        (0.100, 0.050, "red"),
    ],
)
def test_the_clock_is_judged_by_offset_and_uncertainty(offset_s, uncertainty_s, level):
    found = clock.judge(offset_s, uncertainty_s, "measured over ssh", "127.0.0.1")
    assert found.level == level
    assert ("behind" if offset_s <= 0.0 else "ahead of") in found.text
    assert level == "green" or ("chrony" in found.cure and "100 ms" in found.cure and "server 127.0.0.1" in found.cure)


TRACKING = """Reference ID    : 7F000001 (%s)
Stratum         : 3
Ref time (UTC)  : Sun Nov 22 09:00:00 2026
System time     : 0.000231000 seconds slow of NTP time
Last offset     : -0.000012345 seconds
Root delay      : 0.001000000 seconds
Root dispersion : 0.000200000 seconds
Leap status     : %s
"""


def test_chrony_is_read():
    found = clock.parse_tracking(TRACKING % ("127.0.0.1", "Normal"))
    assert found == clock.Tracking("127.0.0.1", True, pytest.approx(-0.000231), pytest.approx(0.0007))
    assert not clock.parse_tracking(TRACKING % ("", "Not synchronised")).synchronised
    assert clock.parse_tracking("506 Cannot talk to daemon") is None


def conversation(**changes):
    """What echo on risc2 prints when all is well, changed."""
    well = {
        "master_uri": MASTER,
        "master_trouble": "",
        "heard": True,
        "answered": True,
        "uri": "http://127.0.0.9:40000/",
    }
    return dict(well, **changes)


@pytest.mark.parametrize(
    ("there", "here", "texts"),
    [
        ({}, True, ["they flow in both directions"]),
        ({"answered": False}, True, ["they flow in both directions"]),
        (
            {"heard": False, "trouble": "no answer from 127.0.0.1:5001"},
            True,
            ["nothing flows from here to risc2: no answer from 127.0.0.1:5001", "firewall here"],
        ),
        (
            {"heard": False, "trouble": "the name base cannot be resolved"},
            True,
            ["nothing flows from here to risc2", "set ROS_IP here"],
        ),
        ({"answered": False}, False, ["nothing flows from risc2 to here: the node there answers", "firewall there"]),
        (
            {"answered": False, "uri": "http://10.0.0.99:40000/"},
            False,
            ["nothing flows from risc2 to here: nodes there say that they are at 10.0.0.99", "a wrong ROS_IP"],
        ),
        (
            {"master_trouble": "no answer from 127.0.0.1:5000"},
            False,
            ["nodes there do not reach a ROS master here", "sudo ufw allow from 127.0.0.9"],
        ),
    ],
)
def test_each_direction_of_a_topic_has_its_own_cause(there, here, texts):
    (found,) = topics.judge(RISC2, MASTER, conversation(**there), {"heard": here})
    assert all(text in found.text + found.cure for text in texts)


def test_both_directions_may_fail():
    found = topics.judge(RISC2, MASTER, conversation(heard=False, answered=False), {"heard": False})
    assert [finding.level for finding in found] == ["red", "red"]


CALIBRATION = "src/risc_visual/config/cameras/risc1.yaml"


@pytest.mark.parametrize(
    ("there", "level", "text"),
    [
        ({"src/a.py": "1", "devel/b": "2", CALIBRATION: "3"}, "green", "the same as here"),
        ({"src/a.py": "1", "devel/b": "2", CALIBRATION: "3", "src/pkg/notes.yaml": "4"}, "green", "the same as here"),
        ({"src/a.py": "1", "devel/b": "2", CALIBRATION: "9"}, "yellow", "its own calibration: " + CALIBRATION),
        ({"src/a.py": "1", "devel/b": "9", CALIBRATION: "3"}, "yellow", "not the same build: devel/b differs"),
        ({"src/a.py": "9", "devel/b": "9", CALIBRATION: "3"}, "red", "src/a.py differs"),
        ({"src/a.py": "1", "devel/b": "2", CALIBRATION: "3", "src/x.py": "4"}, "red", "src/x.py differs"),
        ({"src/a.py": "1", "devel/b": "2"}, "red", CALIBRATION + " differs"),
    ],
)
def test_workspaces_are_compared_file_by_file(there, level, text):
    here = {"revision": "abc", "built": True, "files": {"src/a.py": "1", "devel/b": "2", CALIBRATION: "3"}}
    found = workspace.compare(here, {"revision": "abc", "built": True, "files": there})
    assert found.level == level and text in found.text
    assert workspace.compare(here, {"revision": "abc", "built": False, "files": {}}).level == "red"


def test_known_hosts_serves_the_name_and_the_address(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    key, other = paramiko.ECDSAKey.generate(), paramiko.ECDSAKey.generate()
    lines = known_hosts.missing_lines("risc2", "127.0.0.9", 22, [key, paramiko.RSAKey.generate(1024)])
    assert [line.split()[:2] for line, _ in lines] == [["risc2,127.0.0.9", "ecdsa-sha2-nistp256"]]  # rsa is of no use
    known_hosts.add([line for line, _ in lines])
    assert known_hosts.missing_lines("risc2", "127.0.0.9", 22, [key]) == []
    (line, _) = known_hosts.missing_lines("risc2", "127.0.0.10", 22, [other])[0]
    assert line.startswith("127.0.0.10 ")  # the name is taken
    with pytest.raises(known_hosts.ChangedKeyError):
        known_hosts.missing_lines("risc2", "127.0.0.9", 22, [other])
