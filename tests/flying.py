"""Whole flights for tests: start them, wait for them, and end them in any case."""

import contextlib
import json
import os
import pathlib
import signal
import subprocess
import sys
import time

import pytest

from risc_experiments.report import LATE_LIMIT_MS, on_schedule
from risc_lab.ros.launching import MARK

ROOT = pathlib.Path(__file__).resolve().parents[1]
TIMEOUT_S = 400.0  # of a whole flight and its report
PATIENCE_S = 60.0  # for landing, ending the nodes and the report, after an interrupt
STALL_LIMIT_MS = 250.0  # half of what the safety ladder waits before it lands


def start(folder, *arguments, command=(sys.executable,), module="risc_experiments.fly", **options):
    """Start a flight; its output goes to a file in the folder. command: what runs Python.  options: of Popen."""
    folder.mkdir(parents=True, exist_ok=True)
    options.setdefault("env", dict(os.environ, RISC_MAAP_ROOT=str(ROOT)))
    with (folder / "out.txt").open("w") as out:
        return subprocess.Popen(
            [*command, "-m", module, "--out", str(folder), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            **options,
        )


def output_of(folder):
    """What the flight has printed so far."""
    return (folder / "out.txt").read_text(errors="replace")


def finish(process, folder, timeout_s=TIMEOUT_S):
    """Wait for a flight. Returns (exit code, output). One that does not end is ended, and fails the test."""
    try:
        process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        end(process, folder)
        raise AssertionError("not finished within %g s:\n%s" % (timeout_s, output_of(folder))) from None
    return process.returncode, output_of(folder)


def end(process, folder):
    """End a flight and everything that it started: SIGINT first, SIGKILL for what is left."""
    process.send_signal(signal.SIGINT)
    try:
        process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    for pid in left_behind(folder):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def left_behind(folder):
    """Process ids of flights that write into the folder; they have sessions of their own."""
    found = []
    for entry in pathlib.Path("/proc").glob("[0-9]*/environ"):
        try:
            content = entry.read_bytes()
        except OSError:
            continue  # it ended meanwhile
        if MARK.encode() in content and str(folder).encode() in content:
            found.append(int(entry.parent.name))
    return found


def wait_for_line(process, folder, text, timeout_s=180.0):
    """Wait until a flight has printed the text. A flight that does not is ended, and fails the test."""
    deadline = time.monotonic() + timeout_s
    while text not in output_of(folder):
        if process.poll() is not None or time.monotonic() > deadline:
            end(process, folder)
            raise AssertionError("'%s' did not come:\n%s" % (text, output_of(folder)))
        time.sleep(0.2)


def try_to_fly(folder, *arguments, meanwhile=None, **options):
    """Fly to the end. Returns (exit code, output, summary, folder) of the flight, to be passed to `judged` first.

    meanwhile: is called with (process, folder) as soon as the flight is under way.
    """
    process = start(folder, *arguments, **options)
    if meanwhile is not None:
        try:
            meanwhile(process, folder)
        except AssertionError:
            end(process, folder)
            raise
    code, output = finish(process, folder)
    return code, output, summary_of(folder), folder


def summary_of(folder):
    """summary.json of a flight; only the lateness of the lab if there was no time to complete the bag."""
    path, lab = folder / "summary.json", folder / "virtual_lab.json"
    if path.exists():
        return json.loads(path.read_text())
    return {"lab_late_ms": json.loads(lab.read_text()).get("late_ms")} if lab.exists() else {}


def off_schedule(summary):
    """True if the lab of a flight or its pictures were late, either in general or in one long stall."""
    late_ms = summary.get("lab_late_ms")
    return bool(late_ms) and (not on_schedule(summary) or late_ms["max"] > STALL_LIMIT_MS)


def judged(flight):
    """Return the flight, for the test to check. Call it when no other flight is under way.

    If the flight failed and was off schedule, the lab is run alone to find the cause: if this computer is too slow even
    for that, the test is skipped; otherwise our own nodes may have taken the time, and the test fails.
    """
    code, output, summary, folder = flight
    if code == 0 or not off_schedule(summary):
        return flight
    busy_ms, idle_ms = summary["lab_late_ms"]["p99"], lateness_of_the_lab_alone_ms(folder)
    text = "the lab was late by %.0f ms (p99); alone it is late by %.1f ms" % (busy_ms, idle_ms)
    if idle_ms > LATE_LIMIT_MS:
        pytest.skip("this computer is too busy to fly: " + text)
    pytest.fail("%s\n%s" % (text, output))


def lateness_of_the_lab_alone_ms(folder):
    """p99 of the virtual lab's lateness [ms] when it runs alone."""
    statistics = folder / "lab_alone.json"
    fleet = ROOT / "launch" / "fleets" / "ardrones3.yaml"
    command = [sys.executable, "-m", "risc_simulator.virtual_lab", str(fleet)]
    command += ["--subnet", "127.76", "--live", "--duration", "5", "--stats", str(statistics)]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=120)
    assert done.returncode == 0, done.stdout
    return json.loads(statistics.read_text())["late_ms"]["p99"]


def fly(folder, *arguments, **options):
    """`try_to_fly` and `judged` in one, for a flight with no other flight under way."""
    return judged(try_to_fly(folder, *arguments, **options))
