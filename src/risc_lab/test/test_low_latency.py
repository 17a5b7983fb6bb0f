"""Effect of a flight node's settings on its process, in a separate process."""

import subprocess
import sys

import pytest

pytest.importorskip("rospy")

MESSAGES = 500
PROGRAM = """
import resource, socket, threading
from risc_lab.ros import low_latency
%s
ours, theirs = socket.socketpair()
def receive(count):
    for _ in range(count):
        theirs.send(bytes(2000))
        ours.recv(2**20)  # as rospy does with a buff_size of 1 MB
def work():
    receive(20)
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_minflt
    receive(%d)
    print(resource.getrusage(resource.RUSAGE_THREAD).ru_minflt - before)
thread = threading.Thread(target=work)  # a subscriber's, not the main one
thread.start()
thread.join()
"""


def page_faults(statement):
    command = [sys.executable, "-c", PROGRAM % (statement, MESSAGES)]
    return int(subprocess.run(command, stdout=subprocess.PIPE, check=True).stdout)


def test_memory_of_a_receive_buffer_is_used_again():
    assert page_faults("low_latency._keep_memory()") < 0.1 * MESSAGES
    assert page_faults("") >= MESSAGES, "it would be so anyway"
