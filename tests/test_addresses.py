"""Nothing is sent to a computer or a vehicle that the user has not named: no default of a launch file, of a
configuration file or in the code is an address elsewhere, and what needs one says which argument is missing."""

import ast
import ipaddress
import os
import pathlib
import re
import subprocess
import xml.etree.ElementTree as ET

import pytest
import roslaunch
import yaml
from roslaunch.arg_dump import get_args

from risc_lab.lab import load_fleet

ROOT = pathlib.Path(__file__).resolve().parents[1]
SRC, LEGACY = ROOT / "src", ROOT / "launch/legacy"
LAUNCH_FILES = sorted([*(ROOT / "launch").glob("*.launch"), *LEGACY.glob("*.launch"), *SRC.rglob("launch/*.launch")])
LAUNCH_FILES.remove(SRC / "risc_lab/launch/refuse.launch")  # the others include it to ask
FLEETS = sorted((ROOT / "launch").rglob("fleets/*.yaml"))
ADDRESS = re.compile(r"(?<![\w.])\d{1,3}(?:\.\d{1,3}){3}(?![\w.])")
# Keys and attributes whose value is a computer: there a host name counts like an address.
COMPUTER = re.compile(r"(^|[/_])(ip|host|hostname|address|uri|url)$")
THIS_COMPUTER = ("", "localhost")

# What roslaunch asks for when it is given no address. Every other file loads, and names this computer only.
ASKS = {path.stem: {"fleet"} for path in LEGACY.glob("*.launch") if '"lab" default="false"' in path.read_text()}
ASKS.update(dict.fromkeys(("fleet", "lab", "mocap", "driver", "vehicle", "vehicles", "virtual_lab"), {"fleet"}))
ASKS.update(dict.fromkeys(("ardrone", "dronejoy", "dense_dronejoy", "edge_dronejoy", "vert_dronejoy"), {"ip"}))
ASKS.update(dict.fromkeys(("camera_setup", "risc_camera_setup", "risc_camera_setup_bottom"), {"ip", "fleet"}))
ASKS["Multi_Machine_Experiment"] = {"risc%d_address" % k for k in (1, 2, 3, 4)}
OTHER_ARGUMENTS = {"name": "risc1", "names": "risc1", "bag": "x.bag", "camera": "front", "devices": "/dev/input/js0"}
COPIED_FIRST = {"lab3", "one_computer", "lab"}  # fleet files for a real laboratory, which load only with its addresses

AIRCRAFT = "192.168.1.1"  # every AR.Drone's own, in its own Wi-Fi
ALLOWED = {
    # the program that is an AR.Drone's driver, started by hand without an address
    ("src/drivers/ardrone_autonomy/src/ardrone_autonomy/protocol/__init__.py", AIRCRAFT),
    # these do not load before the user has written an address: COPIED_FIRST
    ("launch/fleets/lab3.yaml", AIRCRAFT),
    ("launch/legacy/fleets/lab.yaml", AIRCRAFT),
    # bound to, to receive broadcasts; a netmask; sent to only on request: --host broadcast
    ("src/risc_simulator/src/risc_simulator/cortex_host.py", "255.255.255.255"),
    ("src/risc_doctor/src/risc_doctor/interfaces.py", "255.255.255.255"),
    ("src/cortex_ros/python/cortex_ros/connection.py", "255.255.255.255"),
}


def elsewhere(text):
    """Addresses in a text that are not this computer's.

    Multicast groups do not count: programs listen to them, and the virtual lab sends to them by the network card that
    has its host's address.
    """
    found = [ipaddress.ip_address(word) for word in ADDRESS.findall(text) if max(map(int, word.split("."))) < 256]
    return [str(a) for a in found if not (a.is_loopback or a.is_multicast or a.is_unspecified)]


def computers(key, value):
    """Addresses and names of other computers in the value of a key: a text, or dicts and lists of texts."""
    if isinstance(value, dict):
        return [found for name, part in value.items() for found in computers(str(name), part)]
    if isinstance(value, (list, tuple)):
        return [found for part in value for found in computers(key, part)]
    text = str(value or "")
    host = re.sub(r"^\w+://|[:/].*", "", text) if COMPUTER.search(key) and not text.startswith("file:") else ""
    is_name = host not in THIS_COMPUTER and not ADDRESS.fullmatch(host)
    return elsewhere(text) + ([host] if is_name else [])


# ------------------------------------------------------------------------------------------- what would be started


def load(path, *argv):
    config, loader = roslaunch.config.ROSLaunchConfig(), roslaunch.xmlloader.XmlLoader()
    loader.ignore_unset_args = False  # as `roslaunch` has it
    loader.load(str(path), config, argv=list(argv), verbose=False)
    return config


def without_addresses(path):
    """(names of the arguments that roslaunch asks for, other computers that it would log in or send to)."""
    names = [arg.get("name") for arg in ET.parse(str(path)).getroot().findall("arg")]
    try:
        config = load(path, *("%s:=%s" % item for item in OTHER_ARGUMENTS.items() if item[0] in names))
    except roslaunch.xmlloader.XmlParseException as refusal:
        asked = r"(\w+):=[A-Z]+\b|requires the '(\w+)' arg|arg '(\w+)' is not defined"
        return {name for names in re.findall(asked, str(refusal)) for name in names if name}, []
    found = [computers("address", machine.address) for machine in config.machines.values()]
    found += [computers(name, param.value) for name, param in config.params.items()]
    found += [elsewhere(node.args or "") for node in config.nodes]
    return set(), sum(found, [])


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: path.stem)
def test_a_launch_file_goes_nowhere_or_asks_where(path):
    assert without_addresses(path) == (ASKS.get(path.stem, set()), [])


@pytest.mark.parametrize(
    "line",
    [
        '<param name="mocap_host" value="cortex-pc"/>',
        '<param name="x" value="203.0.113.5"/>',
        "<rosparam>{mocap: {host: 203.0.113.5}}</rosparam>",
        '<machine name="a" address="203.0.113.5"/>',
        '<machine name="a" address="laptop.example.org"/>',
        '<node pkg="rospy" type="x" name="x" args="-ip 203.0.113.5"/>',
        '<arg name="ip" default="192.168.1.1"/><param name="drone_ip" value="$(arg ip)"/>',
    ],
)
def test_a_planted_address_is_found(line, tmp_path):
    path = tmp_path / "planted.launch"
    path.write_text("<launch>%s</launch>" % line)
    asked, found = without_addresses(path)
    assert not asked and len(found) == 1


def test_roslaunch_says_what_to_write(tmp_path):
    """With --nodes: it reads the file as it always does, and would not send anything if it read on."""
    command = ["roslaunch", "--nodes", str(LEGACY / "DF_demo.launch")]
    environment = dict(os.environ, ROS_LOG_DIR=str(tmp_path))
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 1 and not done.stdout
    assert "fleet:=FILE" in done.stderr and "lab:=true" in done.stderr


def test_two_launch_files_start_the_driver_of_ardrones():
    """One for a vehicle by itself, one for those of a fleet file: its time-outs are set there and nowhere else."""
    paths = [path for folder in (SRC, ROOT / "launch") for path in folder.rglob("*.launch")]
    starts = [path for path in paths if 'type="ardrone_driver"' in path.read_text(encoding="utf-8")]
    alone, fleet = SRC / "drivers/ardrone_autonomy/launch/ardrone.launch", ROOT / "launch/drivers/ardrone.launch"
    assert sorted(starts) == sorted([alone, fleet])


STARTS_A_DRIVER = [path for path in LAUNCH_FILES if "ip" in ASKS.get(path.stem, ()) or path.stem == "driver"]


def hover_after_s(path, *argv):
    """Silence [s] after which the driver that a launch file starts lets its vehicle hover; 0: never."""
    names = [arg.get("name") for arg in ET.parse(str(path)).getroot().findall("arg")]
    told = {**OTHER_ARGUMENTS, "ip": "127.0.0.1", "fleet": ROOT / "launch/fleets/ardrones3.yaml"}
    config = load(path, *("%s:=%s" % item for item in told.items() if item[0] in names), *argv)
    (driver,) = [node for node in config.nodes if node.type == "ardrone_driver"]
    return config.params[driver.namespace + driver.name + "/cmd_timeout"].value


@pytest.mark.parametrize("path", STARTS_A_DRIVER, ids=lambda path: path.stem)
def test_no_launch_file_lets_an_ardrone_keep_the_last_command(path, tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    assert 0.0 < hover_after_s(path) <= 0.5


def test_an_argument_switches_the_hover_off():
    assert hover_after_s(SRC / "drivers/ardrone_autonomy/launch/ardrone.launch", "cmd_timeout:=0") == 0.0


def test_arguments_are_listed_although_they_are_missing():
    listed = get_args([str(ROOT / "launch/Multi_Machine_Experiment.launch")])
    assert ASKS["Multi_Machine_Experiment"] | {"fleet"} <= set(listed)


# ------------------------------------------------------------------------------------------------- what is written


@pytest.mark.parametrize("path", FLEETS, ids=lambda path: path.stem)
def test_a_fleet_file_is_the_virtual_labs_or_has_no_address_yet(path):
    if path.stem in COPIED_FIRST:
        with pytest.raises(ValueError, match="mocap: 'host'"):
            load_fleet(path)
    else:
        assert computers("", load_fleet(path).to_dict()) == []


def texts(path):
    """The texts of a source file that are no comments: [(key, text), ...]."""
    content = path.read_text(encoding="utf-8")
    if path.suffix == ".launch":
        tags = [tag for tag in ET.fromstring(content).iter() if tag.get("name") != "because"]  # that is a message
        pairs = [(key, value) for tag in tags for key, value in tag.attrib.items() if key != "doc"]
        pairs += [(tag.get("name", ""), tag.get("default", tag.get("value", ""))) for tag in tags]
        return [("" if "$(" in value else key, value) for key, value in pairs]
    if path.suffix == ".yaml":
        return [("", part) for part in yaml.safe_load_all(content)]
    if path.suffix == ".py" or "python" in content.partition("\n")[0]:
        tree = ast.parse(content)
        bodies = [node.body for node in ast.walk(tree) if hasattr(node, "body") and isinstance(node.body, list)]
        remarks = {id(body[0].value) for body in bodies if body and isinstance(body[0], ast.Expr)}  # docstrings
        nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Constant) and id(node) not in remarks]
        return [("", node.value) for node in nodes if isinstance(node.value, str)]
    comments = r"//.*|/\*(?s:.)*?\*/" if path.suffix in (".cpp", ".hpp", ".h", ".ino") else r"(?m:^\s*#.*)"
    return [("", re.sub(comments, "", content))]


def written(path):
    return [found for key, text in texts(path) for found in computers(key, text)]


def sources():
    suffixes = (".launch", ".yaml", ".py", ".cpp", ".hpp", ".h", ".ino", ".sh")
    found = [path for folder in (SRC, ROOT / "launch") for path in folder.rglob("*") if path.suffix in suffixes]
    found += [path for path in SRC.rglob("nodes/*") if path.is_file() and not path.suffix]
    found += [*(ROOT / "docker/run").glob("*.sh"), ROOT / "maap"]
    return [path for path in found if "test" not in path.relative_to(ROOT).parts]


def test_no_address_elsewhere_is_written_in_code_or_configuration():
    paths = sources()
    assert len(paths) > 300
    found = {(str(path.relative_to(ROOT)), address) for path in paths for address in written(path)}
    assert found == ALLOWED


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("x.launch", '<launch><arg name="second_address" default="laptop"/></launch>'),
        ("x.launch", '<launch><param name="x" value="203.0.113.5"/></launch>'),
        ("x.yaml", "mocap:\n  host: cortex-pc\n"),
        ("x.yaml", "a: [{b: 203.0.113.5}]\n"),
        ("x.py", 'def f(host="203.0.113.5"):\n    """Of 127.0.0.1."""\n'),
        ("x.cpp", 'std::string host = "203.0.113.5";  // 203.0.113.6\n'),
        ("x.sh", "# 203.0.113.6\nssh 203.0.113.5\n"),
    ],
)
def test_a_planted_default_is_found(name, text, tmp_path):
    (tmp_path / name).write_text(text)
    assert len(set(written(tmp_path / name))) == 1


def test_containers_name_each_other_only():
    """Addresses of compose.yaml and of its fleet file are in the networks that compose.yaml makes."""
    compose = yaml.safe_load((ROOT / "docker/compose.yaml").read_text())
    subnets = [ipaddress.ip_network(network["ipam"]["config"][0]["subnet"]) for network in compose["networks"].values()]
    found = {a for name in ("compose.yaml", "fleet.yaml") for a in elsewhere((ROOT / "docker" / name).read_text())}
    found -= {str(subnet.network_address) for subnet in subnets} | {AIRCRAFT}  # the latter in a comment
    assert found and all(any(ipaddress.ip_address(a) in subnet for subnet in subnets) for a in found)
    assert all(subnet.is_private for subnet in subnets)
