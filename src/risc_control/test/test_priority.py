"""Who goes first: real processes, their real niceness."""

import os
import subprocess
import sys

import pytest

from risc_control.priority import FLIGHT, VIRTUAL_LAB

PROGRAM = """
import os, threading
from risc_control.priority import raise_priority
for niceness in %r:
    raise_priority(niceness)
found = []
thread = threading.Thread(target=lambda: found.append(os.getpriority(os.PRIO_PROCESS, threading.get_native_id())))
thread.start()
thread.join()
print(os.getpriority(os.PRIO_PROCESS, 0), *found)
"""


def niceness_after(values, started_with=0):
    command = ["nice", "-n", str(started_with), sys.executable, "-c", PROGRAM % (values,)]
    return [int(word) for word in subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout.split()]


@pytest.mark.skipif(os.geteuid() != 0, reason="only root may raise a priority")
def test_root_goes_first_with_all_threads():
    assert niceness_after([FLIGHT]) == [FLIGHT, FLIGHT]
    assert niceness_after([FLIGHT, VIRTUAL_LAB]) == [VIRTUAL_LAB, VIRTUAL_LAB]
    assert niceness_after([VIRTUAL_LAB, FLIGHT]) == [VIRTUAL_LAB, VIRTUAL_LAB], "never lowered"


def test_what_was_started_with_nice_stays_so():
    assert niceness_after([FLIGHT, VIRTUAL_LAB], started_with=7) == [7, 7]
