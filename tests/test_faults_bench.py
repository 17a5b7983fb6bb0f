"""The benchmark of reaction times, without a flight: what it counts, and which rows it calls late."""

import argparse
import json

import faults as bench
import pytest

from risc_simulator.faults import parse_fault

ROW = {"fault": "mocap_blackout:0.3", "p99_ms": 130.0, "never": 0}


@pytest.mark.parametrize(
    ("changes", "late"),
    [
        ({}, False),
        ({"p99_ms": 150.1}, True),
        ({"p99_ms": None}, True),
        ({"never": 1}, True),
        ({"fault": "mocap_blackout:0.1", "never": 1}, False),
        ({"fault": "node_kill:master", "p99_ms": None, "never": 3}, False),
        ({"fault": "node_stop:controller,0.3", "never": 1}, True),
    ],
)
def test_who_holds_late_or_never_is_told_where_vehicles_have_to_hold(changes, late):
    assert bench.is_late(ROW | changes, hold_ms=150.0) is late


def test_vehicles_that_flew_and_never_reacted_are_counted(monkeypatch, tmp_path):
    """Not those of events that came when all had landed."""
    reactions_ms = {"risc1": 100.0, "risc2": 110.0}, {"risc1": 105.0}, {}
    events = [
        {"outcome": "completed", "safe": True, "reactions_ms": each_ms, "flying": flying}
        for each_ms, flying in zip(reactions_ms, (2, 2, 0))
    ]
    summary = {"faults": events, "passed": True, "lab_late_ms": {"p99": 1.0}}
    monkeypatch.setattr(bench, "fly", lambda *arguments: summary)
    args = argparse.Namespace(events=2, duration=10.0, states="cortex_raw")
    row = bench.measure("mocap_blackout:0.3", tmp_path, args)
    assert (row["events"], row["reactions"], row["never"], row["max_ms"]) == (2, 3, 1, 110.0)


SUMMARY = {"faults": [], "passed": True, "lab_late_ms": {"p99": 1.0}}


@pytest.fixture
def flights(monkeypatch):
    """Options of the flights that were flown, each of which leaves its summary."""
    flown = []

    def call(command, **options):
        folder = bench.pathlib.Path(command[command.index("--out") + 1])
        (folder / "summary.json").write_text(json.dumps(SUMMARY))
        flown.append(command)

    monkeypatch.setattr(bench.subprocess, "call", call)
    return flown


def test_a_flight_that_is_there_is_not_flown_again(flights, tmp_path):
    args = argparse.Namespace(vehicles=3, duration=10.0, mocap_rate=100.0, fleet=None)
    folder = tmp_path / "jump_seed1"
    events = bench.script("jump:0.3", 2, seed=1)
    for _ in range(2):
        assert bench.fly(folder, events, 1, args) == SUMMARY and len(flights) == 1
    (folder / "summary.json").unlink()  # it was interrupted
    (folder / "flight.bag").touch()
    assert bench.fly(folder, events, 1, args) == SUMMARY and len(flights) == 2
    assert not (folder / "flight.bag").exists(), "./maap fly writes over none"
    for other in ({"vehicles": 2}, {"duration": 11.0}, {"fleet": "mixed3.yaml"}):
        with pytest.raises(ValueError, match="jump_seed1 .* other options"):
            bench.fly(folder, events, 1, argparse.Namespace(**vars(args) | other))
    with pytest.raises(ValueError, match="other options"):
        bench.fly(folder, bench.script("jump:0.3", 3, seed=1), 1, args)
    assert len(flights) == 2


ALWAYS = set(bench.PROGRAMS) - {"transmitter", "EKF"}
MIXED = ("--fleet", str(bench.ROOT / "launch/fleets/mixed3.yaml"))


@pytest.mark.parametrize(
    ("options", "more"),
    [
        ((), set()),
        (MIXED, {"transmitter"}),
        ((*MIXED, "--vehicles", "2"), set()),
        (("--states", "cortex_ekf"), {"EKF"}),
    ],
)
def test_programs_that_a_flight_has_not_are_left_out_and_named(options, more, monkeypatch, capsys):
    measured = set()

    def measure(text, *arguments):
        measured.add(parse_fault(text).program)
        return bench.table.row_of(text, []) | {"never": 0, "flights": 1, "passed": 1, "lab_late_p99_ms": 1.0}

    monkeypatch.setattr(bench, "measure", measure)
    bench.main(["--programs", *options])
    told = capsys.readouterr().out
    assert measured == ALWAYS | more
    assert {name for name in ("transmitter", "EKF") if "no %s:" % name in told} == {"transmitter", "EKF"} - more
