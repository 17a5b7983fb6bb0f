"""Whether a computer keeps up: the conclusion from measurements on the ground, and its consequences."""

import collections
import json
import os
import re
import signal
import subprocess
import sys
import threading
import types

import pytest

from risc_control.safety import SafetyLimits
from risc_estimation.filters import make_filter
from risc_experiments import fly, headroom
from risc_experiments.headroom import judge, next_rate_hz, verdict
from risc_lab.phases import OperatorPhase

# nothing happens to programs
NO_PROGRAMS = types.SimpleNamespace(check=lambda _: None, start=lambda _: None, end_all=lambda: None, acting=())


def figures(flight=0.6, other=0.0, steal=0.0, cores=2, idle=0.5):
    computer = {"cores": cores, "idle": idle, "steal": steal, "busiest_other": "browser", "busiest_other_cores": other}
    return {"cpu_cores": {"controller": 0.5 * flight, "virtual_lab": 0.5 * flight}, "computer": computer}


def test_a_computer_that_keeps_up():
    assert judge(figures(), [6.0, 7.0, 5.0], [0, 0, 0, 0]) == ""
    assert judge(figures(other=1.0), [6.0, 12.0, 8.0], [0, 0, 0, 0]) == "", "who is busy beside us need not disturb us"
    assert judge({}, [], []) == "", "too little was seen"


@pytest.mark.parametrize(
    ("seen", "reason"),
    [
        ((figures(flight=1.8), [5.0] * 3, [0] * 4), "the flight took 1.80 of 2 cores"),
        ((figures(flight=0.9, cores=1), [5.0] * 3, [0] * 4), "the flight took 0.90 of 1 cores"),
        ((figures(), [59.0, 45.0, 52.0], [0] * 4), "up to 59 ms old"),
        ((figures(other=1.3), [5.0] * 3, [5, 10, 40, 70]), "'browser' took 1.3 cores"),
        ((figures(steal=0.2), [5.0] * 3, [5, 10, 40, 70]), "virtual machine took 20 %"),
        (({}, [5.0] * 3, [5, 10, 40, 70]), "(65 passed over)"),
    ],
)
def test_one_that_does_not_and_who_takes_its_time(seen, reason):
    assert reason in judge(*seen)


@pytest.mark.parametrize(
    ("ages_ms", "passed_over"),
    [([60.0, 55.0, 6.0], [0, 60, 99, 99]), ([6.0, 60.0, 55.0], [0, 0, 60, 99]), ([6.0, 60.0, 6.0], [7, 7, 90, 90])],
)
def test_a_second_of_something_else_costs_no_rate(ages_ms, passed_over):
    """Such a second affects two reports at most."""
    assert judge(figures(), ages_ms, passed_over) == ""


def flown(age_ms=8.0, other=0.0, passed_over=0, on_schedule=True, **others):
    mocap = {"frames_received": 8000, "frames_passed_over": passed_over}
    times = {"latency_ms": {"datagram_to_controls": {"p99": age_ms}}, "lab_late_ms": {"p99": 3.0}, "video_late_ms": 7.0}
    return {**figures(other=other, **others), **times, "mocap": mocap, "on_schedule": on_schedule}


@pytest.mark.parametrize(
    "result",
    [
        flown(),
        flown(idle=0.01, other=0.9),  # busy, but nothing was late
        flown(steal=0.3),
        flown(passed_over=3),  # a hiccup
        dict(flown(), computer={}),
    ],
)
def test_a_computer_that_was_in_time_is_not_blamed_and_the_measurements_are_told(result):
    text = verdict(result)
    assert "not the reason" in text and "%d frames" % result["mocap"]["frames_passed_over"] in text
    assert re.search("controls .* 8 ms .*virtual lab .* 3 ms .*pictures 7 ms", text)


def test_outside_of_the_virtual_lab_it_is_not_told_of_and_without_measurements_nothing_is():
    assert "virtual lab" not in verdict(flown(on_schedule=None))
    nothing = {"cpu_cores": {}, "computer": {}, "mocap": {"frames_received": 0, "frames_passed_over": 0}}
    assert verdict({**flown(age_ms=None, on_schedule=None), **nothing}) == ""


@pytest.mark.parametrize(
    ("result", "text"),
    [
        (flown(passed_over=200, idle=0.04, other=0.9),
         "'browser' .* 0.9 cores, .* 0.60 of 2 cores .200 frames .*, 4 %"),
        (flown(age_ms=80.0, idle=0.02, flight=1.9),
         "flight .* 1.90 of 2 cores .controls .* 80 ms .*, 2 %"),
        (flown(on_schedule=False, steal=0.3),
         "virtual machine .* 30 %, .* 0.60 of 2 cores .*virtual lab .* 3 ms .*pictures 7 ms, 50 %"),
        (dict(flown(passed_over=200), computer={}), "unknown .*200 frames "),
    ],
)  # fmt: skip
def test_what_was_late_blames_the_computer_and_who_kept_it_busy(result, text):
    assert re.match("for want .*: .*" + text, verdict(result))


def test_it_is_judged_once_and_not_while_programs_start(monkeypatch):
    clock = [100.0]
    monkeypatch.setattr(headroom.time, "monotonic", lambda: clock[0])
    watch = types.SimpleNamespace(oldest_ms=collections.deque([900.0] * 5), passed_over=collections.deque([0, 50, 90]))
    room = headroom.Headroom("nobody")
    assert room.look(watch) == "" and not watch.oldest_ms and list(watch.passed_over) == [90]
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


def test_at_the_lowest_rate_that_is_offered_the_estimator_bears_lost_frames():
    params = make_filter().params
    frames_lost = 2
    samples = int(min(params.position_window_s, params.angle_window_s) * headroom.RATES_HZ[-1]) + 1
    assert samples - frames_lost >= params.min_samples
    assert (frames_lost + 1) / headroom.RATES_HZ[-1] < SafetyLimits().state_hold_s


@pytest.fixture
def on_the_ground(tmp_path, monkeypatch):
    """Folder (`path`) of a flight that has not taken off, and the arguments of os.execv (`called`)."""
    (tmp_path / "flight.bag").write_text("what lay on the ground")
    monkeypatch.setenv(fly.TRIED_RATES, "[]")
    called = []
    monkeypatch.setattr(fly.os, "execv", lambda program, words: called.append(words))
    yield types.SimpleNamespace(path=tmp_path, called=called)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, fly.SIGNALS)


def write_fleet(folder, rate_hz):
    fleet = fly.load_fleet(fly.ROOT / "launch/fleets/ardrones3.yaml").to_dict()
    fleet["mocap"]["rate_hz"] = rate_hz
    (folder / "fleet.yaml").write_text(json.dumps(fleet))


def fly_slower(folder, interrupted=False):
    said, event = [], threading.Event()
    if interrupted:
        event.set()
    progress = types.SimpleNamespace(say=said.append)
    arguments = ["--seed", "3", "--out", folder]
    return fly.fly_slower("risc_experiments.fly", arguments, folder, fly.TooSlow("too busy"), progress, event), said


def test_a_slower_flight_begins_again_in_a_process_of_its_own(on_the_ground):
    write_fleet(on_the_ground.path, 200.0)
    _, said = fly_slower(on_the_ground.path)
    assert [re.findall(r"\d+ Hz|too busy", text) for text in said] == [["too busy", "200 Hz", "150 Hz"]]
    words = ["--seed", "3", "--out", str(on_the_ground.path), "--mocap-rate", "150"]
    assert [called[1:] for called in on_the_ground.called] == [["-m", "risc_experiments.fly", *words]]
    assert fly.tried_rates() == [{"rate_hz": 200.0, "reason": "too busy"}]
    assert not (on_the_ground.path / "flight.bag").exists()
    assert fly.arguments(words).mocap_rate == 150.0


def test_below_the_lowest_rate_the_flight_fails_and_says_why(on_the_ground):
    write_fleet(on_the_ground.path, headroom.RATES_HZ[-1])
    result, _ = fly_slower(on_the_ground.path)
    assert "too busy at 50 Hz" in result
    assert not on_the_ground.called and (on_the_ground.path / "flight.bag").exists(), "the report is made of it"
    assert fly.tried_rates() == [{"rate_hz": 50.0, "reason": "too busy"}]


def test_who_is_interrupted_does_not_begin_again(on_the_ground):
    write_fleet(on_the_ground.path, 200.0)
    with pytest.raises(fly.FlightError, match="interrupted"):
        fly_slower(on_the_ground.path, interrupted=True)
    assert not on_the_ground.called


def test_an_interrupt_between_two_processes_reaches_the_second(tmp_path):
    """It comes before the second has a handler: it must neither be lost nor kill."""
    write_fleet(tmp_path, 200.0)
    (tmp_path / "second.py").write_text(
        "import time; time.sleep(0.2)\n"
        "from risc_experiments import fly\n"
        "fly.handle_signals(lambda number, _: print('heard', number))\n"
    )
    first = (
        "import os, pathlib, signal, threading, types\n"
        "from risc_experiments import fly\n"
        "event = threading.Event()\n"
        "fly.handle_signals(lambda *_: event.set())\n"
        "interrupt = lambda text: os.kill(os.getpid(), signal.SIGINT)\n"
        "fly.fly_slower('second', [], pathlib.Path('.'), 'busy', types.SimpleNamespace(say=interrupt), event)\n"
    )
    path = os.pathsep.join(filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        [sys.executable, "-c", first],
        cwd=tmp_path,
        env=dict(os.environ, PYTHONPATH=path),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stdout) == (0, "heard %d\n" % signal.SIGINT)


def test_who_is_landing_is_not_told_to_begin_again(tmp_path, monkeypatch):
    reasons = iter(["", *["too busy"] * 99])
    monkeypatch.setattr(fly, "Headroom", lambda _: types.SimpleNamespace(look=lambda watch: next(reasons)))
    monkeypatch.setenv(fly.TRIED_RATES, "[]")
    watch = types.SimpleNamespace(
        failure=None,
        phase=OperatorPhase.WAITING,
        text="",
        operator_heard=False,
        errors_mm={},
        rate_hz=None,
        operator_silent=lambda _: False,
    )
    looks = []

    def land():
        looks.append("told")
        return True

    def show(*_):
        if looks:
            looks.append("seen")
        if len(looks) > 3:
            watch.failure = "told to land"

    watch.land = land
    interrupted = threading.Event()
    interrupted.set()
    result = fly._follow(
        fly.arguments([]),
        tmp_path,
        types.SimpleNamespace(identity="nobody", running=lambda: True),
        watch,
        NO_PROGRAMS,
        types.SimpleNamespace(show=show, say=lambda text: None),
        interrupted,
    )
    assert result == "told to land" and not isinstance(result, fly.TooSlow)


@pytest.mark.parametrize("answers", [True, False], ids=["refuses", "hangs"])
def test_faults_that_do_not_happen_end_the_flight(monkeypatch, tmp_path, answers):
    """They are asked for once, when all are on the course; the virtual lab refuses one, or does not answer at all."""
    rospy = pytest.importorskip("rospy")
    from risc_experiments.ros import watch as module

    over, asked = threading.Event(), []

    def ask(*fault):
        asked.append(fault)
        if not answers:
            over.wait(60.0)
        return types.SimpleNamespace(success=False, message="no vehicle 'risc9'")

    ask.close = lambda: None
    monkeypatch.setattr(rospy, "ServiceProxy", lambda *_, **__: ask)
    monkeypatch.setattr(module, "CALL_PATIENCE_S", 0.2)
    watch = module.Watch.__new__(module.Watch)
    watch.failure, watch.flight_failed, watch.text, watch.phase = None, False, "", OperatorPhase.FLY
    watch.errors_mm, watch.rate_hz, watch._operator_s, watch._operator_first_s = {}, None, None, None
    watch._refusal, watch._answer_due_s, watch.on_course = "", float("inf"), False

    def land():
        watch.failure, watch.flight_failed = "landing was requested", True
        return True

    def show(*_):
        watch.on_course = True

    watch.land = land
    result = fly._follow(
        fly.arguments(["--fault", "mocap_blackout:0.3@2", "--fault", "wind@5"]),
        tmp_path,
        types.SimpleNamespace(identity="nobody", running=lambda: True),
        watch,
        NO_PROGRAMS,
        types.SimpleNamespace(show=show, say=lambda text: None),
        threading.Event(),
    )
    over.set()
    assert asked == [("mocap_blackout", "", [1.0], [0.3], 2.0, "")]
    assert ("no vehicle 'risc9'" in result) == answers and result.endswith("; landing was requested")
