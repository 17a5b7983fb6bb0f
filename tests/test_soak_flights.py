"""./maap soak with the whole graph: that it flies again and again, and that it finds what leaks or dies.

Second tier: minutes each.
"""

import json
import os
import pathlib
import signal
import subprocess
import sys

import flying
import psutil
import pytest
import yaml

from risc_experiments.soak import table
from risc_experiments.soak.verdict import BAG, FAULTS
from risc_lab.ros.launching import MARK, wait_until
from risc_simulator.faults import load_faults

pytestmark = [pytest.mark.release, pytest.mark.alone]

SOAK = "risc_experiments.soak"
BUSY = {"limits": {"lab_late_ms": 500.0, "latency_ms": 500.0}}  # for a busy computer
LEAK = """
import sys, time
held = []
print("leaking", flush=True)
while True:
    held.append(bytearray(b"x" * (1 << 20)))
    time.sleep(0.2)
"""


def start(folder, hours, *options, **settings):
    folder.mkdir(parents=True)
    path = folder / "settings.yaml"
    path.write_text(yaml.safe_dump(BUSY | settings))
    words = [str(hours), "--seed", "5", "--mocap-rate", "100", "--settings", str(path), *options]
    return flying.start(folder, *words, module=SOAK)


def result_of(folder):
    return json.loads((folder / "soak.json").read_text())


def entries(folder, kind):
    lines = (folder / table.RECORD).read_text().splitlines()
    return [entry for entry in map(json.loads, lines) if entry["kind"] == kind]


def processes_of(folder):
    """{pid: psutil.Process} of the graph, not of its recorders."""
    found = {}
    for pid in flying.left_behind(folder):
        try:
            process = psutil.Process(pid)
            if process.environ().get("ROS_HOME") == str(folder):
                found[pid] = process
        except psutil.Error:
            continue
    return found


def node_of(folder, name):
    for process in processes_of(folder).values():
        if "__name:=" + name in process.cmdline():
            return process
    raise AssertionError("no node " + name)


def wait_for_phase(soak, folder, phase):
    def come():
        return soak.poll() is not None or any(entry["phase"] == phase for entry in entries(folder, "phase"))

    flying.wait_for_line(soak, folder, "results in")
    if not wait_until(come, 240.0) or soak.poll() is not None:
        flying.end(soak, folder)
        raise AssertionError("no phase '%s':\n%s" % (phase, flying.output_of(folder)))


def check_whole(folder, code, output, least_flights):
    """Check a soak that ran to its end."""
    assert code == 0, output
    result = result_of(folder)
    assert result["completed"] and result["violation"] is None and len(result["flights"]) >= least_flights, output
    faults = entries(folder, "fault")
    assert len(faults) >= 2 * least_flights and all(fault["safe"] for fault in faults)
    assert sum(row["events"] for row in result["faults"]) == len(table.counted(faults))
    assert any(row["reactions"] for row in result["faults"])
    # the faults were those of the script, in its order
    for flight in entries(folder, "judged"):
        events = load_faults(folder / "flights" / ("%04d" % flight["flight"]) / FAULTS)
        told = [fault["name"] for fault in faults if fault["flight"] == flight["flight"]]
        assert told == [event.fault for event in events][: len(told)]
    names = set(result["processes"])
    assert {"controller", "operator", "stream_markers", "virtual_lab", "maap soak"} <= names, names
    figures = [process["own_mb"]["last"] for process in result["processes"].values()]
    assert all(own_mb > 0.0 for own_mb in figures if own_mb is not None)
    killed = [fault for fault in faults if fault["name"] == "node_kill"]
    assert figures.count(None) <= len(killed), "only a program that has just come back may have none"
    assert len(list(folder.glob("flights/*/" + BAG))) == min(3, len(result["flights"]))
    assert "| process |" in output
    assert not flying.left_behind(folder)


def test_three_minutes(tmp_path):
    folder = tmp_path / "soak"
    code, output = flying.finish(start(folder, 0.05, line_s=20.0), folder, 900.0)
    check_whole(folder, code, output, 2)
    # no flight starts the graph anew
    assert len({entry["processes"]["virtual_lab"]["pid"] for entry in entries(folder, "sample")}) == 1


def test_programs_that_are_killed_come_back_and_the_fleet_flies_on(tmp_path):
    folder = tmp_path / "soak"
    soak = start(folder, 0.05, "--faults", "node_kill,node_stop")
    code, output = flying.finish(soak, folder, 900.0)
    assert code == 0, output
    faults = entries(folder, "fault")
    assert {fault["name"] for fault in faults} <= {"node_kill", "node_stop"} and len(faults) > 3
    assert any(fault["name"] == "node_kill" and fault["flying"] for fault in faults)
    pids = {}
    for sample in entries(folder, "sample"):
        for name in sample["processes"]:
            pids.setdefault(name, set()).add(sample["processes"][name]["pid"])
    assert any(len(found) > 1 for found in pids.values()), "a program came in the place of one that was killed"
    assert len(result_of(folder)["flights"]) >= 2


def test_ten_minutes(tmp_path):
    folder = tmp_path / "soak"
    code, output = flying.finish(start(folder, 10.0 / 60.0), folder, 1800.0)
    check_whole(folder, code, output, 6)


def test_a_process_that_leaks_ends_it_with_what_is_needed_to_see_it_again(tmp_path):
    folder = tmp_path / "soak"
    soak = start(folder, 0.5, warm_up_s=20.0, least_judged_s=20.0, sample_s=1.0, line_s=5.0)
    leaker = None
    try:
        wait_for_phase(soak, folder, "takeoff")
        identity = node_of(folder, "controller").environ()[MARK]
        with (tmp_path / "leak.py").open("w") as script:
            script.write(LEAK)
        leaker = subprocess.Popen(
            [sys.executable, script.name, "__name:=leaker"],
            env={**os.environ, MARK: identity},
            stdout=subprocess.DEVNULL,
        )
        code, output = flying.finish(soak, folder, 900.0)
    finally:
        if leaker is not None:
            leaker.kill()
            leaker.wait()
    assert code == 1, output
    violation = result_of(folder)["violation"]
    assert violation["invariant"] == "growth" and violation["text"].startswith("leaker: memory"), output
    check_can_be_repeated(folder, violation)


def check_can_be_repeated(folder, violation):
    repeat = violation["repeat"]
    assert repeat["seed"] == 5 and pathlib.Path(repeat["bag"]).exists() and pathlib.Path(repeat["log"]).exists()
    assert load_faults(repeat["faults"])
    words = repeat["command"].split()
    assert words[:3] == ["./maap", "fly", "--seed"] and words[-2:] == ["--faults", repeat["faults"]]
    assert (folder / "soak.md").read_text().count(repeat["command"]) == 1
    assert not flying.left_behind(folder)


def test_a_node_that_dies_ends_it_and_the_vehicles_land(tmp_path):
    folder = tmp_path / "soak"
    soak = start(folder, 0.5)
    wait_for_phase(soak, folder, "fly")
    node_of(folder, "states_estimation").kill()
    code, output = flying.finish(soak, folder, 600.0)
    assert code == 1, output
    violation = result_of(folder)["violation"]
    assert violation["invariant"] == "process" and "states_estimation" in violation["text"], output
    assert not entries(folder, "crash"), output
    check_can_be_repeated(folder, violation)


def test_an_interrupt_lands_and_tells_the_figures_so_far(tmp_path):
    folder = tmp_path / "soak"
    soak = start(folder, 0.5)
    wait_for_phase(soak, folder, "fly")
    soak.send_signal(signal.SIGINT)
    code, output = flying.finish(soak, folder, 600.0)
    assert code == 130 and not result_of(folder)["violation"], output
    assert result_of(folder)["interrupted"] and entries(folder, "end")
    assert wait_until(lambda: not flying.left_behind(folder), 10.0)
