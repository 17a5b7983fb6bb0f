"""Programs of a flight are found by what they do, and killed, stopped and continued."""

import os
import pathlib
import subprocess
import sys

import psutil
import pytest

from risc_experiments.programs import find, programs, successor
from risc_lab.ros.launching import MARK
from risc_lab.testing import wait_for

IDENTITY = "a flight of test_programs"


@pytest.fixture
def node():
    """Function that starts a process as roslaunch starts a node, in a flight."""
    started = []

    def start(name, space="", identity=IDENTITY):
        environment = dict(os.environ, ROS_NAMESPACE=space, **{MARK: identity})
        words = [sys.executable, "-c", "import sys; print(); sys.stdin.read()", "__name:=" + name, "__log:=x"]
        if name == "rosmaster":
            words = ["bash", "-c", 'exec -a rosmaster bash -c "echo; read"']
        process = subprocess.Popen(words, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        started.append(process)
        process.stdout.readline()  # it has started
        return process

    yield start
    for process in started:
        process.kill()
        process.wait()
        process.stdin.close()
        process.stdout.close()


def state_of(process):
    return psutil.Process(process.pid).status()


def test_roles_and_names_find_the_nodes_of_one_flight(node):
    controller, drawing = node("controller"), node("draw_cortex")
    node("controller", identity="another flight")
    assert [program.node for program in programs(IDENTITY)] == ["/controller", "/draw_cortex"]
    assert find(IDENTITY, "controller").process.pid == controller.pid
    assert find(IDENTITY, "draw_cortex").process.pid == drawing.pid
    assert find(IDENTITY, "/draw_cortex").process.pid == drawing.pid


def test_the_master_is_one_of_them(node):
    master = node("rosmaster")
    assert find(IDENTITY, "master").process.pid == master.pid


def test_who_is_missing_is_told_and_who_is_there(node):
    node("controller"), node("stream_markers"), node("draw_cortex")
    with pytest.raises(LookupError, match="'trajectory' .* mocap_client, controller, draw_cortex$"):
        find(IDENTITY, "trajectory")
    with pytest.raises(LookupError, match="none"):
        find("no flight", "controller")


def test_of_several_a_vehicle_has_its_own_or_shares_one(node):
    first, second = node("roscopter", "/iris1/apm"), node("roscopter", "/iris2/apm")
    assert find(IDENTITY, "driver", "iris2").process.pid == second.pid
    assert find(IDENTITY, "driver").process.pid == first.pid
    with pytest.raises(LookupError, match="'driver'"):
        find(IDENTITY, "driver", "risc1")
    shared = node("ardrone_driver")
    assert find(IDENTITY, "driver", "risc1").process.pid == shared.pid
    assert find(IDENTITY, "driver", "iris2").process.pid == second.pid
    assert find(IDENTITY, "driver").process.pid == shared.pid


def test_a_type_from_elsewhere_has_its_driver_among_them(node, monkeypatch):
    toy = node("toy_commands", "/risc1")
    with pytest.raises(LookupError, match="'driver'"):
        find(IDENTITY, "driver", "risc1")
    monkeypatch.setenv("RISC_MAAP_MEMBERS", str(pathlib.Path(__file__).parent / "members"))
    assert find(IDENTITY, "driver", "risc1").process.pid == toy.pid


def test_a_killed_one_is_back_when_its_own_node_is_started_again(node):
    first, _second = node("roscopter", "/iris1/apm"), node("roscopter", "/iris2/apm")
    killed = find(IDENTITY, "driver", "iris1")
    assert successor(IDENTITY, killed) is None, "it has not even ended"
    killed.kill()
    first.wait()
    assert successor(IDENTITY, killed) is None, "what flies another vehicle does not stand in for it"
    again = node("roscopter", "/iris1/apm")
    assert successor(IDENTITY, killed).process.pid == again.pid


def test_they_hang_go_on_and_die(node):
    process = node("controller")
    program = find(IDENTITY, "controller")
    program.stop()
    wait_for(lambda: state_of(process) == psutil.STATUS_STOPPED)
    program.resume()
    wait_for(lambda: state_of(process) == psutil.STATUS_SLEEPING)
    assert 0.0 <= program.age_s < 60.0 and not program.killed
    program.stop()
    program.kill()
    assert process.wait() == -9 and program.killed
    program.kill()  # one that has ended is no reason to fail
    with pytest.raises(LookupError):
        find(IDENTITY, "controller")
