"""Whether a computer keeps up: what is concluded from what was seen on the ground, and what follows."""

import collections
import json
import types

import pytest

from risc_experiments import fly, headroom
from risc_experiments.headroom import judge, next_rate_hz


def figures(flight=0.6, other=0.0, steal=0.0, cores=2):
    computer = {"cores": cores, "steal": steal, "busiest_other": "browser", "busiest_other_cores": other}
    return {"cpu_cores": {"controller": 0.5 * flight, "virtual_lab": 0.5 * flight}, "computer": computer}


def test_a_computer_that_keeps_up():
    assert judge(figures(), [6.0, 7.0, 5.0], [0, 0, 0]) == ""
    assert judge(figures(other=1.0), [6.0, 12.0, 8.0], [0, 0, 0]) == "", "who is busy beside us need not disturb us"
    assert judge({}, [], []) == "", "too little was seen"


@pytest.mark.parametrize(
    ("seen", "reason"),
    [
        ((figures(flight=1.8), [5.0] * 3, [0] * 3), "takes 1.80 of 2 cores"),
        ((figures(flight=0.9, cores=1), [5.0] * 3, [0] * 3), "takes 0.90 of 1 cores"),
        ((figures(), [9.0, 45.0, 52.0], [0] * 3), "up to 52 ms old"),
        ((figures(other=1.3), [5.0] * 3, [10, 40, 70]), "70 passed over); browser takes 1.3 cores"),
        ((figures(steal=0.2), [5.0] * 3, [10, 40, 70]), "the host of this virtual machine takes 20 %"),
    ],
)
def test_one_that_does_not_and_who_takes_its_time(seen, reason):
    assert reason in judge(*seen)


def test_a_single_hiccup_is_no_reason():
    assert judge(figures(), [5.0, 60.0, 6.0], [0, 30, 30]) == ""


def test_it_is_judged_once_and_not_while_programs_start(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(headroom.time, "monotonic", lambda: clock[0])
    watch = types.SimpleNamespace(oldest_ms=collections.deque([900.0] * 5), passed_over=collections.deque([0, 50, 90]))
    room = headroom.Headroom("nobody")
    assert room.look(watch) == "" and not watch.oldest_ms and not watch.passed_over
    watch.oldest_ms.extend([80.0, 90.0, 85.0])
    clock[0] += 0.9 * headroom.JUDGED_S
    assert room.look(watch) == ""
    clock[0] += 0.2 * headroom.JUDGED_S
    assert "90 ms old" in room.look(watch)
    assert room.look(watch) == ""
    assert headroom.JUDGED_S < headroom.READY_S - 0.5, "the operator must not take off meanwhile"


def test_rates_go_down_to_the_lowest():
    rates, rate_hz = [], 200.0
    while rate_hz is not None:
        rates.append(rate_hz)
        rate_hz = next_rate_hz(rate_hz)
    assert rates == list(headroom.RATES_HZ)
    assert next_rate_hz(120.0) == 100.0


def test_a_slower_flight_begins_again_in_a_process_of_its_own(tmp_path, monkeypatch):
    (tmp_path / "flight.bag").write_text("what lay on the ground")
    fleet = fly.load_fleet(fly.ROOT / "launch/fleets/ardrones3.yaml")
    (tmp_path / "fleet.yaml").write_text(json.dumps(fleet.to_dict()))
    monkeypatch.setenv(fly.TRIED_RATES, "[]")
    called = []
    monkeypatch.setattr(fly.os, "execv", lambda program, words: called.append(words))
    said = types.SimpleNamespace(say=called.append)
    fly.fly_slower(["--seed", "3"], tmp_path, fly.TooSlow("too busy"), said)
    assert called[0] == "too busy: too little time for motion capture at 200 Hz, flying at 150 Hz"
    assert called[1][1:] == ["-m", "risc_experiments.fly", "--seed", "3", "--out", str(tmp_path), "--mocap-rate", "150"]
    assert fly.tried_rates() == [{"rate_hz": 200.0, "reason": "too busy"}]
    assert not (tmp_path / "flight.bag").exists()
    assert fly.arguments(called[1][3:]).mocap_rate == 150.0
