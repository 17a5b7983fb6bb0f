"""./maap soak: scripts of faults, drift, invariants, tables; each invariant also with what must not raise it."""

import datetime
import json
import math
import os
import subprocess
import sys
import uuid
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from risc_experiments.scorecard import plan
from risc_experiments.soak import invariants, output, script, table
from risc_experiments.soak.__main__ import main
from risc_experiments.soak.drift import MOST_SAMPLES, Track, drift
from risc_experiments.soak.processes import OURSELVES, Processes
from risc_experiments.soak.run import LogFollower, Record
from risc_experiments.soak.settings import ProgramFaultParams, SoakLimits, SoakParams, load_params
from risc_lab.ros.launching import MARK, wait_until
from risc_simulator.faults import load_fault_file

HOUR_S = 3600.0
PARAMS = SoakParams()
LIMITS = PARAMS.limits
VEHICLES = ["risc1", "risc2", "risc3"]


# ------------------------------------------------------------------ scripts


def test_the_settings_of_the_tree_are_the_defaults():
    assert load_params() == PARAMS


CARD = plan.load_params()
ALL = script.deck_of((), PARAMS, CARD)


def faults_of(number, seed=1, deck=ALL, duration_s=40.0):
    return script.faults_of(number, seed, deck, VEHICLES, duration_s)


def test_a_seed_gives_the_same_faults_again_and_another_flight_or_seed_others():
    assert faults_of(7) == faults_of(7)
    assert len({faults_of(number, seed) for number in range(1, 6) for seed in (1, 2)}) == 10


def test_faults_of_a_flight_end_within_it_and_are_safe_ones():
    events = []
    for number in range(1, 80):
        flight = faults_of(number)
        assert flight
        ends_s = [event.start_s + event.duration_s for event in flight]
        assert all(before < event.start_s for before, event in zip(ends_s, flight[1:]))
        assert max(ends_s) <= 40.0 and min(event.start_s for event in flight) > 3.0
        events += flight
    for event in events:
        assert "breach" not in event.settings.safe
        assert (event.vehicle in VEHICLES) is event.settings.per_vehicle
    assert len({event.fault for event in events}) > 20
    of_programs = [event for event in events if event.program]
    assert 0.08 < len(of_programs) / len(events) < 0.25
    assert {event.fault for event in of_programs} == set(script.OF_PROGRAMS)
    assert {event.program for event in of_programs} == set(PARAMS.programs.names)
    stops_s = [event.duration_s for event in of_programs if event.fault == script.STOP]
    assert 0.1 <= min(stops_s) < max(stops_s) <= 3.0


def test_a_script_flies_as_a_file_of_faults(tmp_path):
    events = next(flight for flight in map(faults_of, range(1, 99)) if any(event.program for event in flight))
    (tmp_path / "faults.yaml").write_text(script.file_text(events, 7))
    flown = load_fault_file(tmp_path / "faults.yaml")
    assert flown.faults == events and flown.seed == 7


def test_wanted_faults_are_drawn_alone_and_wrong_names_are_named():
    assert script.deck_of(("wind", "jump"), PARAMS, CARD)[:2] == (("wind", "jump"), ())
    wind = script.deck_of(("wind",), PARAMS, CARD)
    assert {event.fault for event in faults_of(1, deck=wind, duration_s=60.0)} == {"wind"}
    kills = script.deck_of(("node_kill",), PARAMS, CARD)
    assert {event.fault for event in faults_of(1, deck=kills)} == {"node_kill"}
    without = SoakParams(leave_out=("wind", "node_kill"))
    left = script.deck_of((), without, CARD)
    assert "wind" not in left.names and left.of_programs == ("node_stop",)
    assert script.deck_of((), SoakParams(programs=ProgramFaultParams(names=())), CARD).of_programs == ()
    for wanted, params in ((("fire",), PARAMS), ((), SoakParams(leave_out=("fire",)))):
        with pytest.raises(ValueError, match="'fire'; .*wind.*node_kill"):
            script.deck_of(wanted, params, CARD)
    with pytest.raises(ValueError, match="no fault"):
        script.deck_of(("wind",), without, CARD)
    assert all("breach" not in event.settings.safe for event in ALL.samples)


# ------------------------------------------------------------------ drift


def memory(slope_mb_h, hours=2.0, noise_mb=0.5, step_mb=0.0, seed=1):
    """(times, megabytes) of a process that warms up for ten minutes."""
    t_s = np.arange(0.0, HOUR_S * hours, 10.0)
    rng = np.random.default_rng(seed)
    warm = 20.0 * (1.0 - np.exp(-t_s / 120.0))
    return t_s, 80.0 + warm + slope_mb_h * t_s / HOUR_S + noise_mb * rng.standard_normal(t_s.size) + step_mb * (
        t_s > 0.6 * t_s[-1]
    )


def test_a_leak_is_found_with_its_rate_and_a_process_that_only_warms_up_is_not():
    for seed in range(5):
        found = drift(*memory(12.0, seed=seed), 600.0)
        assert found.low < 12.0 < found.high and found.high - found.low < 1.0
        still = drift(*memory(0.0, seed=seed), 600.0)
        assert abs(still.slope) < 0.3 and not still.exceeds(1.0, 0.0)
    assert found.judged_s == pytest.approx(2.0 * HOUR_S - 610.0)


def test_one_step_and_wild_values_are_no_drift():
    t_s, values = memory(0.0, step_mb=15.0)
    values[::37] = 500.0  # a sample at a bad moment
    assert not drift(t_s, values, 600.0).exceeds(LIMITS.memory_mb_h, LIMITS.memory_mb)
    values[5] = math.nan
    assert math.isfinite(drift(t_s, values, 600.0).slope)


def test_of_too_little_nothing_is_said():
    assert drift(np.zeros(0), np.zeros(0), 0.0).last is None
    few = drift(np.arange(5.0), np.arange(5.0), 0.0)
    assert (few.slope, few.first, few.last) == (None, 2.0, 2.0) and not few.exceeds(0.0, 0.0)
    warm = drift(np.arange(50.0), np.arange(50.0), 100.0)
    assert warm.slope is None and warm.last == 47.0


def test_a_track_keeps_a_weekend_in_bounded_memory():
    track = Track("own_mb", "threads")
    for t_s in np.arange(0.0, 60.0 * HOUR_S, 10.0):
        track.add(t_s, 100.0 + t_s / HOUR_S, 12)
    assert len(track) <= MOST_SAMPLES + 1
    assert track.drift("own_mb", 600.0).slope == pytest.approx(1.0)
    assert track.drift("threads", 600.0)[:5] == (12.0, 12.0, 0.0, 0.0, 0.0)


# ------------------------------------------------------------------ invariants


def track_of(figure, values, every_s=10.0):
    track = Track(*invariants.FIGURES)
    for k, value in enumerate(values):
        track.add(k * every_s, *(value if name == figure else 10.0 for name in invariants.FIGURES))
    return track


@pytest.mark.parametrize("figure, per_minute", [("own_mb", 1.0), ("descriptors", 0.5), ("threads", 0.5)])
def test_a_process_that_grows_is_a_violation_and_one_that_does_not_is_none(figure, per_minute):
    rng = np.random.default_rng(1)
    minutes = np.arange(0.0, 30.0, 1.0 / 6.0)
    noise = rng.integers(-1, 2, minutes.size)
    found = list(invariants.growth("/toy", track_of(figure, 50.0 + per_minute * minutes + noise), 600.0, PARAMS))
    assert [violation.invariant for violation in found] == ["growth"]
    assert found[0].text.startswith("/toy: ")
    assert not list(invariants.growth("/toy", track_of(figure, 50.0 + noise), 600.0, PARAMS))
    # nothing is reported while it warms up, or while there are too few samples
    assert not list(invariants.growth("/toy", track_of(figure, 50.0 + per_minute * minutes), 1700.0, PARAMS))


def latencies(values_ms):
    track = Track("p50_ms", "p99_ms")
    for k, value in enumerate(values_ms):
        track.add(75.0 * k, 5.0, value)
    return track


def test_latency_that_grows_is_a_violation():
    rng = np.random.default_rng(2)
    flights = np.arange(48)
    noise = rng.uniform(-2.0, 2.0, flights.size)
    found = invariants.latency(latencies(10.0 + 0.5 * flights + noise), 600.0, PARAMS)
    assert found.invariant == "latency" and "limit" in found.text
    noise[::9] = 60.0  # flights while other programs run
    assert invariants.latency(latencies(10.0 + noise), 600.0, PARAMS) is None
    assert invariants.latency(latencies([]), 600.0, PARAMS) is None


def judged(**changes):
    return {"reasons": [], "lab_late_ms": {"p99": 1.0}, **changes}


def test_a_flight_that_failed_or_whose_lab_was_late_is_a_violation():
    assert invariants.flight(judged(), LIMITS) is None
    assert invariants.flight(judged(lab_late_ms={"p99": None}), LIMITS) is None
    found = invariants.flight(judged(reasons=["fault jump:0.5,risc2: breach", "risc2: fell"]), LIMITS)
    assert found == ("flight", "fault jump:0.5,risc2: breach; risc2: fell")
    found = invariants.flight(judged(lab_late_ms={"p99": LIMITS.lab_late_ms + 1.0}), LIMITS)
    assert found.invariant == "late"


def test_a_crash_is_a_violation_unless_a_fault_allows_it():
    assert invariants.crash("risc1", "flew into the net", ()).invariant == "crash"
    assert invariants.crash("risc1", "flew into the net", {"landed", "held"}) is not None
    assert invariants.crash("risc1", "flew into the net", {"landed", "breach"}) is None


def test_a_process_that_ends_is_a_violation_unless_it_was_killed_on_purpose():
    assert invariants.gone([]) is None and invariants.gone([("/controller", 10, True)]) is None
    found = invariants.gone([("/controller", 10, False), ("/operator", 11, True)])
    assert found.invariant == "process" and "/controller (process 10)" in found.text and "operator" not in found.text
    assert invariants.not_back({"/operator": LIMITS.back_s}, LIMITS) is None
    assert "/operator: killed" in invariants.not_back({"/operator": LIMITS.back_s + 1.0}, LIMITS).text


def test_a_fleet_that_does_not_take_off_again_is_a_violation():
    assert invariants.not_ready(LIMITS.ready_s, "risc1 not seen", LIMITS) is None
    assert "risc1 not seen" in invariants.not_ready(LIMITS.ready_s + 1.0, "risc1 not seen", LIMITS).text


def test_an_error_that_no_fault_explains_and_any_traceback_are_violations():
    assert invariants.error("/x", "oh no", True) is None
    assert "/x" in invariants.error("/x", "oh no", False).text
    assert invariants.traceback("Traceback\n  File\nKeyError: 'a'\n").text.endswith("KeyError: 'a'")


def test_a_full_disk_is_a_violation():
    assert invariants.disk(LIMITS.free_disk_mb, LIMITS) is None
    assert invariants.disk(LIMITS.free_disk_mb - 1.0, LIMITS).invariant == "disk"


def test_tracebacks_are_found_in_a_log_that_grows(tmp_path):
    path = tmp_path / "roslaunch.log"
    path.write_text("[INFO] all is well\n")
    log = LogFollower(path)
    assert log.tracebacks() == []
    with path.open("a") as stream:
        stream.write("Traceback (most recent call last):\n")
        stream.flush()
        assert log.tracebacks() == [], "it has only begun"
        stream.write('  File "x.py", line 1, in f\n    f()\nKeyError: 1\n[INFO] and on\n')
        stream.flush()
        (found,) = log.tracebacks()
        assert found.splitlines()[-1] == "KeyError: 1"
        stream.write("[INFO] nothing more\n")
        stream.flush()
        assert log.tracebacks() == []


# ------------------------------------------------------------------ processes

TOY = """
import os, sys, threading
held = []
for word in sys.stdin:
    if word == "memory\\n":
        held.append(bytearray(b"x" * (1 << 20)))
    elif word == "descriptors\\n":
        held.append(os.dup(0))
    elif word == "threads\\n":
        held.append(threading.Thread(target=threading.Event().wait, daemon=True))
        held[-1].start()
    print(word, flush=True)
"""


class Toy:
    """A process of a launch that takes up the resources it is told to."""

    def __init__(self, identity, name):
        words = [sys.executable, "-c", TOY, "__name:=" + name]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen(words, env={**os.environ, MARK: identity}, **pipes)
        self.take("nothing")

    def take(self, what):
        self.process.stdin.write(what + "\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == what + "\n"
        assert self.process.stdout.readline() == "\n"

    def end(self):
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()


@pytest.fixture
def toys():
    identity, started = uuid.uuid4().hex, []

    def start(name):
        started.append(Toy(identity, name))
        return started[-1]

    start.identity = identity
    yield start
    for toy in started:
        toy.end()


@pytest.mark.parametrize(
    "takes, what", [("memory", "memory of its own"), ("descriptors", "open descriptors"), ("threads", "threads")]
)
def test_a_real_process_that_takes_more_and_more_is_found_among_those_that_do_not(toys, takes, what):
    leaker, _still = toys("leaker"), toys("still")
    processes = Processes(toys.identity)
    for k in range(24):  # minutes
        leaker.take(takes)
        looks = processes.look(60.0 * k)
    assert set(looks) == {OURSELVES, "leaker", "still"}
    found = {
        process.name: [violation.text for violation in invariants.growth(process.name, process.track, 300.0, PARAMS)]
        for process in processes.living
        if process.name != OURSELVES
    }
    assert found["still"] == [] and len(found["leaker"]) == 1 and what in found["leaker"][0]


def test_a_real_process_that_ends_is_missed_and_its_successor_is_another_one(toys):
    toy, _other = toys("toy"), toys("toy")
    processes, nobody = Processes(toys.identity), frozenset()
    processes.look(0.0)
    processes.expect()
    assert set(processes.expected) == {OURSELVES, "toy", "toy 2"} and processes.ended(nobody) == []
    toy.process.kill()
    assert wait_until(lambda: processes.ended(nobody), 20.0)
    ((name, pid, killed),) = processes.ended(nobody)
    assert (pid, killed, name in ("toy", "toy 2")) == (toy.process.pid, False, True)
    assert processes.ended({pid}) == [(name, pid, True)]
    assert processes.ended({os.getpid()}) == [(name, pid, True)], "what a killed one had started ends with it"
    assert not processes.replace(name)
    toys("toy")
    processes.find(60.0)
    assert processes.ended(nobody) and processes.replace(name) and processes.ended(nobody) == []


# ------------------------------------------------------------------ tables


def fault(name, outcome="completed", safe=True, **reactions_ms):
    return {
        "name": name, "args": "1", "outcome": outcome, "safe": safe, "reactions_ms": reactions_ms, "flying": 2,
        "program": "",
    }  # fmt: skip


def write(folder, faults, tail=""):
    folder.mkdir()
    record = Record(folder)
    record.add("sample", processes={})
    for item in faults:
        record.add("fault", flight=1, **item)
    record.close()
    with (folder / table.RECORD).open("a") as stream:
        stream.write(tail)
    return folder


def test_faults_of_several_soaks_add_up(tmp_path, capsys):
    first = [fault("jump", risc1=100.0, risc2=200.0), fault("wind", outcome="held")]
    second = [fault("jump", outcome="landed", safe=False, risc1=300.0), fault("jump") | {"flying": 0}]
    folders = [write(tmp_path / "a", first), write(tmp_path / "b", second, tail='{"time": "2')]
    kill = fault("node_kill") | {"program": "controller"}
    assert [row["fault"] for row in table.rows_of([kill, kill])] == ["node_kill:controller"]
    row, wind = table.rows_of(table.read(folders[0]) + table.read(folders[1]))
    assert (row["fault"], row["events"], row["reactions"], row["p50_ms"], row["max_ms"]) == ("jump", 2, 3, 200.0, 300.0)
    assert (row["outcomes"], row["unsafe"]) == ({"completed": 1, "landed": 1}, 1)
    assert (wind["reactions"], wind["p99_ms"]) == (0, None)
    assert main(["--table", *map(str, folders)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("| fault | events |") and len(lines) == 5
    assert lines[2] == "| jump | 2 | 3 | 200.0 | 300.0 | 300.0 | completed 1, landed 1 | 1 |"
    assert lines[4].startswith("| all | 3 | 3 |")


def test_a_folder_that_is_no_soaks_is_named(tmp_path, capsys):
    (tmp_path / table.RECORD).write_text("no\n{}\n")
    for folder, said in ((tmp_path, "line 1: not a line of a soak"), (tmp_path / "none", "No such file")):
        with pytest.raises(SystemExit) as end:
            main(["--table", str(folder)])
        assert end.value.code == 2 and said in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    "words, said",
    [
        ([], "HOURS"),
        (["0"], "0.001 to 1000, found 0"),
        (["soon"], "'soon'"),
        (["1", "--table", "x"], "HOURS"),
        (["1", "--faults", "fire"], "'fire'"),
        (["1", "--faults", ",,"], "argument --faults: "),
        (["1", "--duration", "6"], "no fault fits"),
        (["1", "--seed", "-1"], "from 0 on, found -1"),
        (["1", "--controller", "none"], "'none'"),
        (["1", "--settings", "/nowhere.yaml"], "/nowhere.yaml"),
    ],
)
def test_bad_arguments_get_one_clear_line(words, said, capsys):
    with pytest.raises(SystemExit) as end:
        main(words)
    line = capsys.readouterr().err.splitlines()[-1]
    assert end.value.code == 2 and line.startswith("maap soak: error: ") and said in line


def test_a_settings_file_with_a_wrong_key_is_named(tmp_path, capsys):
    (tmp_path / "soak.yaml").write_text("limits: {memory_gb: 1}\n")
    with pytest.raises(SystemExit):
        main(["1", "--settings", str(tmp_path / "soak.yaml")])
    assert "memory_gb" in capsys.readouterr().err.splitlines()[-1]


def a_soak(folder, violation=None):
    """The state that `output` reads, after a soak of two flights."""
    process = SimpleNamespace(name="/controller", key=(10, 1.0), alive=True, since_s=0.0)
    names = ("rss_mb", "pss_mb", "own_mb", "descriptors", "threads", "cpu_cores")
    process.track, totals, latency = Track(*names), Track(*names[1:]), Track("p50_ms", "p99_ms")
    for k in range(40):
        process.track.add(10.0 * k, 100.0, 60.0, 50.0, 20, 8, math.nan if k == 0 else 0.2)
        totals.add(10.0 * k, 60.0, 50.0, 20, 8, 0.2)
    latency.add(100.0, 4.0, 9.0)
    faults = [fault("jump", risc1=100.0)]
    return SimpleNamespace(
        folder=folder,
        folder_of=lambda number: folder / "flights" / ("%04d" % number),
        args=SimpleNamespace(command="./maap soak 0.1", seed=3, hours=0.1, vehicles=2, trajectory=None, controller=None,
                             estimator=None, mocap_rate=100.0, fleet=None, gusts=True),  # fmt: skip
        params=PARAMS, began=datetime.datetime.now().astimezone(), violation=violation, violated=violation and 2,
        interrupted=False, flights=[{"number": 1}, {"number": 2}], faults=faults,
        put_back=Counter(risc1=1), flown_s=390.0, duration_s=360.0, warm_s=120.0, warm_of=lambda _: 120.0,
        processes=SimpleNamespace(known=[process]), totals=totals, latencies=latency,
        record=Record(folder),
    )  # fmt: skip


def test_all_is_written_and_says_how_to_see_a_violation_again(tmp_path):
    folder = tmp_path / "flights" / "0002"
    folder.mkdir(parents=True)
    (folder / "flight.bag").touch()
    soak = a_soak(tmp_path, invariants.Violation("crash", "risc1 fell"))
    output.write_all(soak)
    result = json.loads((tmp_path / "soak.json").read_text())
    assert result["completed"] is False and result["processes"]["/controller"]["own_mb"]["slope"] == 0.0
    repeat = result["violation"]["repeat"]
    faults = str(folder / "faults.yaml")
    assert (repeat["bag"], repeat["faults"], repeat["seed"]) == (str(folder / "flight.bag"), faults, 3)
    words = "./maap fly --seed 3 --duration 40 --vehicles 2 --mocap-rate 100.0 --gusts --faults %s"
    assert repeat["command"] == words % faults
    text = (tmp_path / "soak.md").read_text()
    assert "crash: risc1 fell" in text and "`%s`" % repeat["command"] in text and "| jump | 1 | 1 |" in text
    page = (tmp_path / "soak.html").read_text()
    assert "crash: risc1 fell" in page and "/controller" in page and "jump" in page


def test_a_soak_without_a_violation_says_so(tmp_path):
    output.write_all(a_soak(tmp_path))
    result = json.loads((tmp_path / "soak.json").read_text())
    assert result["completed"] is True and result["violation"] is None
    kinds = [json.loads(line)["kind"] for line in (tmp_path / table.RECORD).read_text().splitlines()]
    assert kinds == ["end"]


def test_bad_settings_are_refused():
    for values in ({"duration_s": 1.0}, {"sample_s": 0.0}, {"keep_flights": -1}):
        with pytest.raises(ValueError):
            SoakParams(**values)
    with pytest.raises(ValueError):
        SoakLimits(ready_s=0.0)
    assert SoakParams().warm_up_of(360.0) == 120.0 and SoakParams().warm_up_of(7200.0) == 600.0
