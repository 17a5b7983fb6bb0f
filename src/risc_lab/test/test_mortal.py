"""Commands that do not outlive the program that starts them."""

import shlex
import subprocess
import sys

from risc_lab.mortal import mortal

SCRIPT = """import subprocess, time
from risc_lab.mortal import mortal
print(subprocess.Popen(mortal("TERM", ["sleep", "60"])).pid, flush=True)
time.sleep(60.0)"""


def test_it_runs_as_it_would_otherwise():
    done = subprocess.run(mortal("TERM", ["sh", "-c", "echo $1 $0; exit 3", "a b", 4]), capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (3, "4 a b\n")


def test_it_ends_with_its_parent():
    with subprocess.Popen([sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout.readline()
        parent.kill()
        assert parent.stdout.read() == ""  # which the child has open for as long as it lives


def test_it_does_not_even_start_when_its_parent_was_gone_before():
    for_another = shlex.join(mortal("TERM", ["echo", "started"])) + "; true"  # its parent is a shell, not this process
    assert subprocess.run(["sh", "-c", for_another], capture_output=True, text=True).stdout == ""
