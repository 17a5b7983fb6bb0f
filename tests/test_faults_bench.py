"""The benchmark of reaction times, without a flight: what it counts, and which rows it calls late."""

import argparse

import faults as bench
import pytest

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
    reactions_ms = {"risc1": 100.0, "risc2": 110.0}, {"risc1": 105.0}, {}
    events = [
        {"outcome": "completed", "safe": True, "reactions_ms": each_ms, "flying": flying}
        for each_ms, flying in zip(reactions_ms, (2, 2, 0))
    ]
    summary = {"faults": events, "passed": True, "lab_late_ms": {"p99": 1.0}}
    monkeypatch.setattr(bench, "fly", lambda *arguments: summary)
    row = bench.measure("mocap_blackout:0.3", tmp_path, argparse.Namespace(events=3, duration=10.0))
    assert (row["events"], row["reactions"], row["never"], row["max_ms"]) == (3, 3, 1, 110.0)
