"""How `./maap machines` judges measurements, for faults that cannot be made on one computer."""

import errno
import os
import re
import socket

import paramiko
import pytest

from risc_doctor.clock_agreement import ClockState
from risc_doctor.findings import FoundError, guarded
from risc_doctor.machines import check, clock_offset, known_hosts, setup, ssh, topic_flow, workspace_digest
from risc_doctor.machines.experiment import Computer, load_experiment
from risc_doctor.machines.workspace_digest import Workspace

RISC2 = Computer("risc2", "127.0.0.9", user="pilot", env_loader="/ws/devel/coop.sh", nodes=1)
MASTER = "http://127.0.0.1:5000"


@pytest.mark.parametrize(
    ("error", "text", "cure"),
    [
        (TimeoutError(), "127.0.0.9 port 22 within 5 s", "same network"),
        (OSError(errno.ENETUNREACH, os.strerror(errno.ENETUNREACH)), " route to 127.0.0.9", "ip route get 127.0.0.9"),
        (ConnectionRefusedError(), "refuses", "openssh-server"),
        (socket.gaierror(), "cannot be resolved", "/etc/hosts"),
    ],
)
def test_an_unreachable_computer_has_its_own_cause(error, text, cure):
    found = ssh.unreachable(error, "127.0.0.9", 22).finding
    assert text in found.text and cure in found.cure


@pytest.mark.parametrize(
    ("offset_s", "uncertainty_s", "level"),
    [
        (0.004, 0.001, "green"),
        (-0.004, 0.010, "green"),
        (0.006, 0.001, "yellow"),
        (0.000, 0.025, "yellow"),  # it may be within the limit or not
        (0.024, 0.025, "yellow"),
        (-0.021, 0.001, "red"),
        (0.100, 0.050, "red"),
    ],
)
def test_the_clock_is_judged_by_offset_and_uncertainty(offset_s, uncertainty_s, level):
    found = clock_offset.judge(offset_s, uncertainty_s, "measured over ssh", "127.0.0.1")
    assert found.level == level
    assert ("behind" if offset_s <= 0.0 else "ahead of") in found.text
    assert level == "green" or ("chrony" in found.cure and "100 ms" in found.cure and "server 127.0.0.1" in found.cure)


@pytest.mark.parametrize(
    ("chrony", "measured_s", "level", "text"),
    [
        ((0.001, 0.0002), (0.0012, 0.001), "green", "1.0 ms ahead .*± 0.2 ms, chrony"),
        # chrony's bound includes the way to our own server: the direct measurement between both computers is better
        ((0.001, 0.030), (0.0012, 0.001), "green", "1.2 ms ahead .*± 1.0 ms, measured .*; chrony"),
        ((0.0, 0.001), (0.030, 0.001), "red", "30.0 ms ahead .*± 1.0 ms, measured .*; chrony .* 0.0 ms behind"),
        ((0.012, 0.002), (0.0, 0.001), "green", " 12.0 ms ahead "),
    ],
)  # fmt: skip
def test_chrony_is_not_believed_against_the_measurement(chrony, measured_s, level, text):
    tracking = ClockState("chrony", True, chrony[0], "127.0.0.1", chrony[1])
    found = clock_offset.combine(tracking, measured_s, "127.0.0.1")
    assert found.level == level and re.search(text, found.text)


def test_chrony_that_follows_another_is_told():
    other, alone = ClockState("chrony", True, 0.0, "127.0.0.7"), ClockState("chrony", False)
    for state, text in ((other, "127.0.0.7"), (alone, "no other clock")):
        assert text in clock_offset.combine(state, (0.0, 0.001), "127.0.0.1").text
    assert "chrony" not in clock_offset.combine(None, (0.0, 0.001), "127.0.0.1").text


def told(**changes):
    """What echo on risc2 prints when all is well, with changes."""
    return {"master_uri": MASTER, "trouble": "", "name_unknown": False, "uri": "http://127.0.0.9:40000", **changes}


@pytest.mark.parametrize(
    ("there", "trouble", "code", "texts"),
    [
        ({}, "", "good", []),
        ({"trouble": "no answer from 127.0.0.1:5000"}, "", "not_there", ["127.0.0.1:5000", "allow from 127.0.0.9"]),
        ({"trouble": "base?", "name_unknown": True}, "", "name_unknown_there", ["risc2: base?", "ROS_IP"]),
        ({}, "no answer from 127.0.0.9:40000", "not_here", ["127.0.0.9:40000", "sudo ufw allow"]),
        ({"uri": "http://10.0.0.99:40000"}, "no answer", "other_address", ["10.0.0.99", "127.0.0.9", "ROS_IP"]),
        ({"master_uri": "http://127.0.0.1:9"}, "", "other_uri", ["http://127.0.0.1:9", "devel/coop.sh"]),
    ],
)
def test_each_direction_of_a_topic_has_its_own_cause(there, trouble, code, texts):
    (found,) = topic_flow.judge(RISC2, MASTER, told(**there), trouble)
    assert found.code == code and all(text in found.text + found.cure for text in texts)


def test_both_directions_may_fail():
    found = topic_flow.judge(RISC2, MASTER, told(trouble="no answer from here"), "no answer from there")
    assert [finding.level for finding in found] == ["red", "red"]


CALIBRATION = "src/risc_lab/config/cameras/risc1.yaml"


@pytest.mark.parametrize(
    ("there", "code", "file"),
    [
        ({"src/a.py": "1", "devel/b": "2", CALIBRATION: "3"}, "same", ""),
        ({"src/a.py": "1", "devel/b": "2", CALIBRATION: "3", "src/pkg/notes.yaml": "4"}, "same", ""),
        ({"src/a.py": "1", "devel/b": "2", CALIBRATION: "9"}, "own_calibration", CALIBRATION),
        ({"src/a.py": "1", "devel/b": "9", CALIBRATION: "3"}, "another_build", "devel/b"),
        ({"src/a.py": "9", "devel/b": "9", CALIBRATION: "3"}, "another", "src/a.py"),
        ({"src/a.py": "1", "devel/b": "2", CALIBRATION: "3", "src/x.py": "4"}, "another", "src/x.py"),
        ({"src/a.py": "1", "devel/b": "2"}, "another", CALIBRATION),
    ],
)
def test_workspaces_are_compared_file_by_file(there, code, file):
    here = Workspace("/ws", "abc", True, {"src/a.py": "1", "devel/b": "2", CALIBRATION: "3"})
    found = workspace_digest.compare(here, Workspace("/ws", "abc", True, there))
    assert found.code == code and file in found.text
    assert workspace_digest.compare(here, Workspace("/ws", "abc", False, {})).level == "red"


def test_known_hosts_serves_the_name_and_the_address(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    key, other = paramiko.ECDSAKey.generate(), paramiko.ECDSAKey.generate()
    lines = known_hosts.missing_lines("risc2", "127.0.0.9", 22, [key, paramiko.RSAKey.generate(1024)])
    assert [line.split()[:2] for line, _ in lines] == [["risc2,127.0.0.9", "ecdsa-sha2-nistp256"]]  # rsa is not used
    known_hosts.add([line for line, _ in lines])
    assert (tmp_path / ".ssh/known_hosts").stat().st_mode & 0o777 == 0o600
    assert known_hosts.missing_lines("risc2", "127.0.0.9", 22, [key]) == []
    (line, _) = known_hosts.missing_lines("risc2", "127.0.0.10", 22, [other])[0]
    assert line.startswith("127.0.0.10 ")  # the name has a key already
    with pytest.raises(known_hosts.ChangedKeyError):
        known_hosts.missing_lines("risc2", "127.0.0.9", 22, [other])


def test_a_server_that_has_only_an_rsa_key_is_known_by_it(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    key = paramiko.RSAKey.generate(1024)
    ((line, _),) = known_hosts.missing_lines("risc2", "127.0.0.9", 22, [key])
    assert line.startswith("risc2,127.0.0.9 ssh-rsa ")
    known_hosts.add([line])
    assert known_hosts.missing_lines("risc2", "127.0.0.9", 22, [key]) == []


OWN = "127.0.0.1"  # of the computer that checks, when all others are on it


@pytest.mark.parametrize(
    ("environment", "wrong"),
    [
        ({"ROS_IP": OWN, "ROS_MASTER_URI": "http://%s:11311" % OWN}, []),
        ({"ROS_IP": OWN, "ROS_MASTER_URI": "http://localhost:11311"}, ["ROS_MASTER_URI=http://localhost:11311"]),
        ({"ROS_IP": "192.0.2.7", "ROS_MASTER_URI": "http://192.0.2.7:11311"}, ["ROS_IP=192.0.2.7", "http://192.0.2.7"]),
        ({"ROS_IP": OWN, "ROS_HOSTNAME": "localhost", "ROS_MASTER_URI": "http://%s:11311" % OWN},
         ["ROS_HOSTNAME=localhost", "> unset ROS_HOSTNAME; export ROS_IP=%s ROS_MASTER_URI=http://%s:" % (OWN, OWN)]),
        ({"ROS_HOSTNAME": "no-such-name.invalid"}, ["ROS_MASTER_URI is not set", "ROS_HOSTNAME=no-such-name.invalid"]),
        ({"ROS_MASTER_URI": "127.0.0.1:11311"}, ["ROS_MASTER_URI=127.0.0.1:11311", "ROS_IP is not set"]),
    ],
)  # fmt: skip
def test_what_this_shell_would_tell_the_others(environment, wrong):
    found = check.check_shell(environment, OWN)
    assert found.level == ("yellow" if wrong else "green")
    printed = "%s\n> %s" % (found.text, found.cure.rpartition("\n")[2])
    assert all(text in printed for text in wrong), printed


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (EOFError(), "no_ssh"),
        (paramiko.SSHException("Error reading SSH protocol banner"), "no_ssh"),
        (paramiko.AuthenticationException(), "refused"),
        (paramiko.PasswordRequiredException(), "passphrase"),
    ],
)
def test_each_end_of_a_login_is_a_finding(error, code, monkeypatch):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr(ssh, "ssh_check_known_hosts", lambda client, *_: None)
    monkeypatch.setattr(paramiko.SSHClient, "connect", fail)
    with pytest.raises(FoundError) as caught:
        ssh.connect(RISC2)
    assert (caught.value.finding.level, caught.value.finding.code) == ("red", code)


@pytest.mark.parametrize(
    ("error", "asks"),
    [
        (paramiko.AuthenticationException(), True),
        (paramiko.SSHException("No authentication methods available"), True),
        (paramiko.PasswordRequiredException(), False),  # the key is installed there
    ],
)
def test_a_password_is_asked_for_only_where_our_key_is_missing(error, asks, monkeypatch):
    def fail(*_, **__):
        raise error

    asked = []
    monkeypatch.setattr(ssh, "ssh_check_known_hosts", lambda client, *_: None)
    monkeypatch.setattr(paramiko.SSHClient, "connect", fail)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr(setup.subprocess, "run", lambda words, **_: asked.append(words))
    with pytest.raises(FoundError):
        setup._log_in(RISC2)
    assert asked == ([["ssh-copy-id", "pilot@127.0.0.9"]] if asks else [])


def test_a_check_that_breaks_is_one_red_finding():
    def fail():
        raise KeyError("surprise")

    (found,) = guarded("nodes", fail)
    assert found.level == "red" and "KeyError: 'surprise'" in found.text


class Talker:
    """Stands in for a session; every command prints the same."""

    computer, here = RISC2, "127.0.0.1"

    def __init__(self, printed):
        self.printed, self.commands = printed, []

    def loaded(self, command, *_):
        self.commands.append(command)
        return ssh.Answer(0, self.printed, "")


@pytest.mark.parametrize("printed", ["", "5", "null", "{}", "[3]", '{"files": 5}', '{"files": {}}', "[]]"])
def test_what_is_no_answer_is_a_finding(printed):
    found = [check._workspace(Talker(printed), None), *check._doctor(RISC2, Talker(printed).loaded)]
    assert [(finding.check, finding.code) for finding in found] == [("workspace", "mute"), ("doctor", "fails")]
    assert all("./maap setup" in finding.cure for finding in found), "it may lack packages"


def test_the_workspace_that_a_link_leads_to_is_the_one_that_is_sourced(tmp_path, monkeypatch, capsys):
    """env-loader=/home/pilot/coop.sh: its grandparent, /, is not a workspace."""
    (tmp_path / "ws" / "devel").mkdir(parents=True)
    (tmp_path / "ws" / "devel" / "setup.sh").touch()
    monkeypatch.setenv("CMAKE_PREFIX_PATH", "%s/ws/devel:/opt/ros" % tmp_path)
    for folder in (tmp_path, tmp_path / "ws"):
        workspace_digest.main(str(folder))
        found = ssh.Answer(0, capsys.readouterr().out, "").told(Workspace)
        assert found.built and found.folder == str(tmp_path / "ws")


@pytest.mark.parametrize(
    ("options", "folder"),
    [
        ("-O '/data/my bags/a.bag' --buffsize=512 -e /(a|b)", "/data/my bags"),
        ("-a -o /tmp/coop_loc_data", "/tmp"),
        ("--output-prefix /data/x /topic", "/data"),
        ("-o flight -a", ""),  # in ~/.ros, which is elsewhere for another login
        ("-a", ""),
        ("-O '/data/a.bag", ""),
    ],
)
def test_the_disk_that_is_looked_at_is_that_of_the_bag(options, folder, tmp_path):
    path = tmp_path / "x.launch"
    path.write_text(
        """<launch><machine name="risc1" address="localhost" default="true"/>
        <node pkg="rosbag" type="record" name="bagger" args="%s"/></launch>"""
        % options
    )
    (computer,) = load_experiment(str(path)).computers
    assert computer.bag_folder == folder
    talker = Talker("[]")
    check._doctor(computer, talker.loaded)
    (command,) = talker.commands
    assert command[-2:] == (["--bag-folder", folder] if folder else ["--only", "disk"])


@pytest.mark.parametrize(
    ("more", "hosts", "checks"),
    [
        ("", ("10.0.0.5",), "disk,subnets,multicast,ports,cortex"),
        ('<node pkg="risc_simulator" type="virtual_lab_node.py" name="lab"/>', (), "disk"),  # there when it flies
    ],
)
def test_the_computer_that_listens_to_cortex_is_asked_for_it(more, hosts, checks, tmp_path):
    path = tmp_path / "x.launch"
    path.write_text(
        """<launch><arg name="fleet" default="my_fleet.yaml"/>
        <machine name="risc2" address="127.0.0.9" user="nobody-here" env-loader="/ws/devel/coop.sh"/>
        <node machine="risc2" pkg="joy" type="joy_node" name="joy"/>
        <machine name="risc1" address="localhost" default="true"/>%s
        <node pkg="cortex_ros" type="stream_markers" name="stream_markers">
          <param name="host" value="10.0.0.5"/></node></launch>"""
        % more
    )
    experiment = load_experiment(str(path))
    assert [computer.name for computer in load_experiment(str(path), only="risc2").computers] == ["risc2"]
    assert [computer.cortex for computer in experiment.computers] == [(), hosts]
    talker = Talker("[]")
    check._doctor(experiment.computers[1], talker.loaded)
    (command,) = talker.commands
    assert command[-2:] == ["--only", checks] and command[3] == "my_fleet.yaml"


@pytest.mark.parametrize(
    ("param", "address"), [('<param name="drone_ip" value="10.0.0.7"/>', "10.0.0.7"), ("", "192.168.1.1")]
)
def test_a_vehicle_is_asked_by_its_address_without_a_fleet_file(param, address, tmp_path):
    """Its address is read from the launch file, which only this computer needs to have."""
    path = tmp_path / "x.launch"
    path.write_text(
        """<launch><arg name="fleet" default="my_fleet.yaml"/>
        <machine name="risc2" address="127.0.0.9" user="nobody-here" env-loader="/ws/devel/coop.sh" default="true"/>
        <group ns="risc1"><node pkg="ardrone_autonomy" type="ardrone_driver" name="driver">%s</node></group></launch>"""
        % param
    )
    (computer,) = load_experiment(str(path)).computers
    talker = Talker("[]")
    check._doctor(computer, talker.loaded)
    (command,) = talker.commands
    assert command[-2:] == ["--vehicle", address]
    assert command[command.index("--only") + 1] == "disk,subnets,vehicles"
    assert "my_fleet.yaml" not in command


def test_a_broken_known_hosts_hides_no_key_that_has_changed(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / ".ssh").mkdir()
    (tmp_path / ".ssh" / "known_hosts").write_text("127.0.0.8 ssh-ed25519 AAAAC!\n")
    monkeypatch.setattr(known_hosts, "shown_keys", lambda *_: [paramiko.RSAKey.generate(1024)])
    with pytest.raises(FoundError) as problem:
        setup._host_key(RISC2, yes=True)
    assert problem.value.finding.code == "corrupt"
