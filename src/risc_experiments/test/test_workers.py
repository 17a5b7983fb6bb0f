"""Items in worker processes: their order, how many results wait, and that no worker is left after any kind of end."""

import importlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time

import psutil
import pytest

from risc_experiments.workers import AHEAD, in_order

PATIENCE_S = 60.0
HELD = []  # semaphores that a worker holds


def square(number):
    time.sleep(0.01 * (number % 3))
    return number * number


def note_and_wait(path):
    """Create a file; the first item waits until seven others are known to be over, and 0.3 s more."""
    path.touch()
    while path.name == "0" and len(list(path.parent.glob("over *"))) < 2 * AHEAD - 1:
        time.sleep(0.01)
    if path.name == "0":
        time.sleep(0.3)


def die_of(number):
    if number == 5:
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def refuse(number):
    if number == 3:
        raise ValueError("no %d" % number)
    return number


def hold_semaphore(then_s):
    if not HELD:
        HELD.append(multiprocessing.get_context("forkserver").Lock())
    time.sleep(then_s)


def message_of(package):
    return importlib.import_module(package + ".msg").__name__


def own_pid(_):
    return os.getpid()


@pytest.mark.parametrize("workers", [1, 2, 5, None])
def test_results_come_in_the_order_of_the_items(workers):
    over = []
    assert list(in_order(square, range(20), workers, over.append)) == [number**2 for number in range(20)]
    assert over == list(range(1, 21))


def test_more_workers_than_items_and_no_items():
    assert list(in_order(square, [3], 8)) == [9]
    assert list(in_order(square, [], 8)) == []


def test_few_results_wait_for_one_that_takes_long(tmp_path):
    def on_progress(over):
        (tmp_path / ("over %d" % over)).touch()

    results = in_order(note_and_wait, [tmp_path / str(k) for k in range(100)], 2, on_progress)
    next(results)
    assert len(list(tmp_path.glob("over *"))) == len(list(tmp_path.glob("[0-9]*"))) == 2 * AHEAD
    results.close()


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_is_raised_when_it_is_its_items_turn(workers):
    results = in_order(refuse, range(8), workers)
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="no 3"):
        next(results)
    assert not multiprocessing.active_children()


def test_a_worker_that_dies_is_one_clear_error():
    with pytest.raises(ChildProcessError, match=r"signal 9.* 5"):
        list(in_order(die_of, range(8), 2))
    assert not multiprocessing.active_children()


def test_workers_find_built_messages_beside_sources(monkeypatch):
    """Also if the caller's path has the sources of a package first, as after importing it."""
    import ardrone_autonomy

    source = [path for path in ardrone_autonomy.__path__ if "devel" not in path][0]
    monkeypatch.syspath_prepend(os.path.dirname(source))
    assert list(in_order(message_of, ["ardrone_autonomy"] * 2, 2)) == ["ardrone_autonomy.msg"] * 2


def test_no_workers_are_refused_at_once():
    with pytest.raises(ValueError, match="worker.* 0"):
        in_order(square, [1, 2], 0)


def test_workers_end_when_somebody_has_seen_enough():
    results = in_order(own_pid, range(100), 2)
    pid = next(results)
    assert pid != os.getpid() and psutil.pid_exists(pid)
    results.close()
    assert not psutil.pid_exists(pid)


HOLDING = """
from test_workers import hold_semaphore
from risc_experiments.workers import in_order
results = in_order(hold_semaphore, [0, 0, 100, 100], 2)
next(results), next(results)  # each worker has made its own, and is in the middle of an item
results.close()
"""


@pytest.mark.parametrize("killed", [False, True])
def test_workers_give_back_what_they_hold(killed):
    """Otherwise Python complains of leaked semaphores at the end, as it does if workers are killed."""
    words = "from multiprocessing.context import ForkServerProcess as P; P.terminate = P.kill" if killed else ""
    run = subprocess.run(
        [sys.executable, "-c", words + HOLDING],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([os.path.dirname(__file__), *sys.path])},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0 and ("leaked" if killed else "") in run.stderr
    assert killed or not run.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_nothing_is_left_of_flights_that_are_interrupted(number):
    """Ctrl-C reaches every process of a terminal; a SIGKILL reaches the caller alone."""
    command = ["env", "--default-signal=INT"]  # tests in the background may ignore SIGINT
    command += [sys.executable, "-m", "risc_experiments.offline", "--workers", "2", "--vehicles", "1"]
    command += ["--trajectory", "circle", "--seeds", "9999", "--duration", "1"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    flying = subprocess.Popen(command, text=True, start_new_session=True, **pipes)
    flying.stdout.readline()
    assert flying.stdout.readline().split()[0] == "circle"  # the first flight is over
    session = [process for process in psutil.process_iter() if _session(process) == flying.pid]
    assert len(session) >= 4  # the caller, the fork server and two workers
    if number == signal.SIGINT:
        os.killpg(flying.pid, number)
    else:
        os.kill(flying.pid, number)
    stderr = flying.communicate(timeout=PATIENCE_S)[1]
    assert flying.returncode == (130 if number == signal.SIGINT else -number)
    assert "Traceback" not in stderr, stderr
    assert not psutil.wait_procs(session, PATIENCE_S)[1]


def _session(process):
    try:
        return os.getsid(process.pid)
    except ProcessLookupError:
        return None
