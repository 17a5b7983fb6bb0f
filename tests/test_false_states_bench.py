"""The benchmark of false states: what it counts in made-up frames and in a flight."""

import json

import false_states as bench
import numpy as np
import pytest

STAMPS_S = 0.005 * np.arange(400)
EVENTS = [(0.4, 0.5), (1.2, 1.3)]  # 20 frames each


def frames():
    """(visible, wrong) of two vehicles that are seen and known."""
    return np.ones((400, 2), dtype=bool), np.zeros((400, 2), dtype=bool)


def test_what_is_not_visible_does_no_harm():
    visible, wrong = frames()
    visible[80:102, 0], wrong[80:102, 0] = False, True
    flight = bench.judge(STAMPS_S, visible, wrong, EVENTS)
    assert (flight["events"], flight["false"], flight["harmful"], flight["after"]) == (2, 40, 0, 0)
    assert flight["settled_ms"] == pytest.approx([10.0, 0.0]) and flight["noticed_frames"] == [0.0, np.inf]
    row = bench.row_of("flip", [flight])
    assert row["ok"] and row["share"] == 0.0 and "noticed_frames_p99" not in row


def test_what_is_visible_and_wrong_does_in_an_event_and_after_it():
    visible, wrong = frames()
    wrong[90:101, 1] = True
    flight = bench.judge(STAMPS_S, visible, wrong, EVENTS)
    assert (flight["harmful"], flight["after"]) == (10, 1)
    row = bench.row_of("freeze", [flight, flight])
    assert row["share"] == pytest.approx(0.25) and not row["ok"]
    assert row["events"] == 4 and row["noticed_frames_p99"] is None, "it was never noticed"


@pytest.mark.parametrize(("settled", "noticed", "ok"), [(9, 3, True), (11, 3, False), (9, 4, False)])
def test_what_settles_or_is_noticed_late_is_missed(settled, noticed, ok):
    """Frames of 5 ms: invisible from `noticed` frames of an event on until `settled` frames after it."""
    visible, wrong = frames()
    for first in 80, 240:
        visible[first + noticed : first + 20 + settled] = False
    row = bench.row_of("freeze", [bench.judge(STAMPS_S, visible, wrong, EVENTS)])
    assert (row["settled_ms_p50"], row["noticed_frames_p99"]) == (pytest.approx(5.0 * settled), noticed)
    assert row["ok"] == ok


def test_events_are_those_of_the_seed():
    first, again, other = (bench.script("jump", 20, 0.005, seed)["faults"] for seed in (1, 1, 2))
    assert first == again != other
    assert all(0.005 <= event["duration_s"] <= bench.LONGEST_S for event in first)
    ends_s = [event["start_s"] + event["duration_s"] for event in first]
    assert all(end_s + 0.3 < event["start_s"] for end_s, event in zip(ends_s, first[1:])), "clean frames between"


@pytest.mark.release
@pytest.mark.alone
def test_a_flight_is_judged(tmp_path):
    file = tmp_path / "figures.json"
    options = ["--faults", "jump", "--duration", "12", "--vehicles", "1"]
    assert bench.main([*options, "--out", str(tmp_path / "out"), "--json", str(file)]) == 0
    (row,) = json.loads(file.read_text(encoding="utf-8"))["rows"]
    assert row["events"] > 5 and row["false"] > 40 and row["harmful"] == row["after"] == 0
    assert row["settled_ms_p50"] <= bench.SETTLED_MS and row["ok"]
