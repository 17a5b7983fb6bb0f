"""Runs what catkin would run (gtest, rostest) and checks that every launch file loads; one result a file."""

import contextlib
import os
import pathlib
import re
import shlex
import shutil
import signal
import subprocess
import uuid
import xml.etree.ElementTree as ET

import pytest
import roslaunch

from risc_lab.ros.launching import MARK, marked_processes

ROSTEST_S = 400.0  # more than every time-limit in a .test file
ROOT = pathlib.Path(__file__).resolve().parents[1]
ROSTESTS = sorted((ROOT / "src").rglob("test/*.test"))
LAUNCH_FILES = sorted((ROOT / "launch").glob("*.launch")) + sorted((ROOT / "src").rglob("launch/*.launch"))
LAUNCH_FILES.remove(ROOT / "src/risc_lab/launch/refuse.launch")  # never loads, on purpose
GTESTS = sorted(path for path in (ROOT / "devel" / "lib").glob("*/test_*") if os.access(str(path), os.X_OK))
# Of the second tier. The tuner: risc_visual/transform_tuner. roscopter, serial_node and what flies an IRIS+ are in
# test_iris_flight.py, the operator in every flight, landmarks in that of `coop`; all have tests without a graph, and
# serial_node meets the firmware in rosserial_python/firmware.
RELEASE = {
    "risc_experiments/tuner_by_mouse",
    "roscopter/roscopter",
    "rosserial_python/serial_node",
    "risc_control/iris_nodes",
    "risc_experiments/operator",
    "risc_visual/landmark_nodes",
}
# Arguments for launch files that cannot do without.
ADDRESSES = {"fleet": str(ROOT / "launch/fleets/ardrones3.yaml"), "ip": "127.77.1.1",
             **{"risc%d_address" % k: "127.0.0.%d" % k for k in (1, 2, 3, 4)}}  # fmt: skip
OWN_FLEET = {"iris"}  # launch files that fly the fleet that they name
REQUIRED_ARGUMENTS = {"name": "risc1", "names": "risc1 risc2", "bag": "/tmp/x.bag", "camera": "front",
                      "devices": "/dev/input/js0", **ADDRESSES}  # fmt: skip


def package_of(path):
    return next(parent.name for parent in path.parents if (parent / "package.xml").exists())


def label(path):
    return "%s/%s" % (path.parent.name if path.suffix != ".test" else package_of(path), path.stem)


@pytest.mark.alone
@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=label(path), marks=[pytest.mark.release] if label(path) in RELEASE else [])
        for path in ROSTESTS
    ],
)
def test_rostest(path, tmp_path):
    identity = uuid.uuid4().hex
    environment = dict(os.environ, ROS_HOME=str(tmp_path), ROS_IP="127.0.0.1", **{MARK: identity})
    output = tmp_path / "out.txt"
    with output.open("w") as stream:
        process = subprocess.Popen(
            ["rostest", str(path)], env=environment, stdout=stream, stderr=subprocess.STDOUT, start_new_session=True
        )
    try:
        code = process.wait(ROSTEST_S)
    except subprocess.TimeoutExpired:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(30)
        code = "not finished within %g s" % ROSTEST_S
    finally:
        # Its master and nodes have sessions of their own; they must not disturb the tests that follow.
        for pid in marked_processes(identity):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.wait()
    assert code == 0, "%s\n%s" % (code, output.read_text(errors="replace")[-6000:])


def test_gtests_are_built():
    assert GTESTS, "no gtest in devel/lib: run ./maap test, which builds them"


@pytest.mark.parametrize("path", GTESTS, ids=lambda path: path.name)
def test_gtest(path):
    done = subprocess.run([str(path)], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=300)
    assert done.returncode == 0, done.stdout[-6000:]


@pytest.mark.parametrize("path", LAUNCH_FILES, ids=lambda path: "%s/%s" % (path.parent.parent.name, path.stem))
def test_launch_file_loads(path):
    """Every include, package, executable and YAML file that it names exists."""
    wanted = [arg.get("name") for arg in ET.parse(str(path)).getroot().findall("arg")
              if arg.get("value") is None and (arg.get("default") is None or arg.get("name") in ADDRESSES)]  # fmt: skip
    wanted = [name for name in wanted if path.stem not in OWN_FLEET]
    argv = ["%s:=%s" % (name, REQUIRED_ARGUMENTS[name]) for name in wanted]
    config = roslaunch.config.ROSLaunchConfig()
    roslaunch.xmlloader.XmlLoader().load(str(path), config, argv=argv, verbose=False)
    for node in config.nodes:
        assert roslaunch.node_args.create_local_process_args(node, roslaunch.core.Machine("local", "localhost"))


@pytest.mark.parametrize("name", ["circles3", "coop", "df_demo", "iris"])
def test_the_estimator_of_a_flight_reaches_its_node(name):
    for argv, expected in (([], "least_squares"), (["estimator:=thesis"], "thesis")):
        config, path = roslaunch.config.ROSLaunchConfig(), ROOT / "launch" / (name + ".launch")
        roslaunch.xmlloader.XmlLoader().load(str(path), config, argv=argv, verbose=False)
        assert config.params["/states_estimation/filter"].value == expected


@pytest.mark.parametrize("name", ["circles3", "coop", "df_demo", "iris"])
def test_the_states_that_a_controller_flies_by_are_an_argument(name):
    for argv, topic in (([], "/cortex_raw"), (["states:=cortex_ekf"], "/cortex_ekf")):
        config, path = roslaunch.config.ROSLaunchConfig(), ROOT / "launch" / (name + ".launch")
        roslaunch.xmlloader.XmlLoader().load(str(path), config, argv=argv, verbose=False)
        assert config.params["/controller/states_topic"].value == topic
        assert [node.name for node in config.nodes if node.type == "quad_EKF.py"] == (["EKF"] if argv else [])


PROGRAM, SOURCE = str(ROOT / "devel/lib/package/node"), str(ROOT / "src/package/nodes/node.py")


@contextlib.contextmanager
def shown_as(*words):
    """A process of this workspace with this command line. It blocks, as nothing reads its output."""
    environment = dict(os.environ, CMAKE_PREFIX_PATH=str(ROOT / "devel"))
    with subprocess.Popen(words, executable=shutil.which("yes"), env=environment, stdout=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.kill()


def test_nothing_is_built_under_nodes_that_run():
    with shown_as("node", "__name:=pretender") as process:
        command = [str(ROOT / "maap"), "build"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode == 1 and str(process.pid) in re.findall(r"\d+", done.stderr)


@pytest.mark.parametrize(
    "words, is_node",
    [
        (("node", "__name:=by_roslaunch"), True),
        ((PROGRAM,), True),
        (("python3", PROGRAM), True),
        (("/usr/bin/python3.11", SOURCE), True),
        (("vim", SOURCE), False),
        (("python3", "-m", "pytest", SOURCE), False),
    ],
)
def test_what_counts_as_a_node_of_this_workspace(words, is_node):
    """Also what rosrun starts, by an interpreter or not; an editor is none."""
    text = (ROOT / "maap").read_text(encoding="utf-8")
    function = re.search(r"^nodes_of_this_workspace\(\) \{.*?^\}", text, re.MULTILINE | re.DOTALL)[0]
    script = "root=%s\n%s\nnodes_of_this_workspace" % (shlex.quote(str(ROOT)), function)
    with shown_as(*words) as process:
        found = subprocess.run(
            ["bash", "-euc", script], capture_output=True, text=True, timeout=60.0, check=True
        ).stdout
    assert (str(process.pid) in found.split()) == is_node
