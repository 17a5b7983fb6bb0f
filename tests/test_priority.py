"""Who goes first: real processes, their real niceness."""

import os
import pathlib
import subprocess
import sys

import pytest

from risc_lab.priority import FLIGHT, VIRTUAL_LAB

pytestmark = pytest.mark.alone  # parallel tests already have a niceness, which stays

PROGRAM = """
import os, threading
from risc_lab.priority import raise_priority
for niceness in %r:
    raise_priority(niceness)
found = []
thread = threading.Thread(target=lambda: found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id())))
thread.start()
thread.join()
print(os.getpriority(os.PRIO_PROCESS, 0), *found)
"""


AUTOGROUP = pathlib.Path("/proc/self/autogroup")
WITH_PRIORITY = str(pathlib.Path(__file__).parents[1] / "src/risc_lab/nodes/with_priority")


def group_niceness_after(*command):
    """Niceness of a session of its own, in which the command has been run."""
    program = "import subprocess, sys; print(open('/proc/self/autogroup').read())"
    text = subprocess.run([*command, sys.executable, "-c", program], stdout=subprocess.PIPE, check=True,
                          start_new_session=True).stdout.decode()  # fmt: skip
    return int(text.rpartition("nice")[2])


def niceness_after(values, started_with=0, under=()):
    command = [*under, "nice", "-n", str(started_with), sys.executable, "-c", PROGRAM % (values,)]
    return [int(word) for word in subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout.split()]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may raise a priority")
def test_root_goes_first_with_all_threads():
    assert niceness_after([FLIGHT]) == [FLIGHT, FLIGHT]
    assert niceness_after([FLIGHT, VIRTUAL_LAB]) == [VIRTUAL_LAB, VIRTUAL_LAB]
    assert niceness_after([VIRTUAL_LAB, FLIGHT]) == [VIRTUAL_LAB, VIRTUAL_LAB], "never lowered"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can stop being root")
def test_others_go_first_where_their_limit_allows():
    without_root = ["setpriv", "--inh-caps=-sys_nice", "--bounding-set=-sys_nice"]
    assert niceness_after([FLIGHT], under=without_root) == [0, 0]
    limited = ["prlimit", "--nice=30:30"]  # 20 - niceness
    if subprocess.run([*limited, "true"], stderr=subprocess.DEVNULL, check=False).returncode != 0:
        pytest.skip("this root may not raise limits")
    assert niceness_after([FLIGHT], under=(*limited, *without_root)) == [FLIGHT, FLIGHT]


def test_what_was_started_with_nice_stays_so():
    assert niceness_after([FLIGHT, VIRTUAL_LAB], started_with=7) == [7, 7]


@pytest.mark.skipif(not AUTOGROUP.exists(), reason="this kernel does not divide the processor among sessions")
def test_a_session_of_its_own_is_set_as_a_whole():
    with_priority = [sys.executable, WITH_PRIORITY]
    assert group_niceness_after("env") == 0
    assert group_niceness_after(*with_priority, "7") == 7


@pytest.mark.parametrize("arguments", [(), ("7",), ("fast", "true"), ("7", "no_such_command_at_all")])
def test_wrong_use_of_with_priority_is_one_line(arguments):
    with_priority = [sys.executable, WITH_PRIORITY]
    result = subprocess.run([*with_priority, *arguments], stderr=subprocess.PIPE, check=False)
    assert result.returncode == 1
    assert len(result.stderr.decode().splitlines()) == 1
