"""Periodic work, on a simulated clock."""

import threading
from types import SimpleNamespace

import pytest

pytest.importorskip("rospy")

from risc_lab.ros import guard, ticker  # noqa: E402
from risc_lab.ros.ticker import Ticker  # noqa: E402


@pytest.fixture(autouse=True)
def told(monkeypatch):
    """Logged errors; ROS is running."""
    errors = []
    monkeypatch.setattr(ticker.rospy, "logerr", errors.append)
    monkeypatch.setattr(ticker.rospy, "on_shutdown", lambda _hook: None)
    monkeypatch.setattr(guard, "is_closing", lambda: False)
    return errors


def starts_of(durations_s, monkeypatch, period_s=1.0):
    """Start times [s] of calls whose work takes durations_s."""
    now_s, starts = [0.0], []
    clock = SimpleNamespace(
        monotonic=lambda: now_s[0], sleep=lambda seconds: now_s.__setitem__(0, now_s[0] + max(seconds, 0.0))
    )

    def work():
        starts.append(now_s[0])
        now_s[0] += durations_s[len(starts) - 1]
        if len(starts) == len(durations_s):
            one._over.set()

    monkeypatch.setattr(ticker, "time", clock)
    one = Ticker.__new__(Ticker)
    one._period_s, one._work, one._over = period_s, work, threading.Event()
    one._run()
    return starts


def test_the_schedule_is_absolute(monkeypatch):
    assert starts_of([0.3, 0.9, 0.0, 0.5, 0.0], monkeypatch) == [1.0, 2.0, 3.0, 4.0, 5.0]


def test_a_call_that_is_a_little_late_does_not_move_those_after_it(monkeypatch):
    assert starts_of([0.0, 1.25, 0.0, 0.0], monkeypatch) == [1.0, 2.0, 3.25, 4.0]


def test_calls_that_were_missed_are_not_made_up_for(monkeypatch):
    assert starts_of([0.0, 0.0, 3.5, 0.0, 0.0], monkeypatch) == [1.0, 2.0, 3.0, 6.5, 7.5]


def test_an_exception_is_told_and_the_next_call_comes(told):
    done, calls = threading.Event(), []

    def work():
        calls.append(None)
        if len(calls) < 3:
            raise KeyError("of the test")
        done.set()

    one = Ticker(0.001, work)
    assert done.wait(30.0)
    one.stop()
    (text,) = told  # the second failure comes too soon to be logged
    assert "of the test" in text and "Traceback" in text


@pytest.mark.parametrize("period_s", [0.0, -1.0, float("nan")])
def test_a_period_that_is_none(period_s):
    with pytest.raises(ValueError, match="period"):
        Ticker(period_s, lambda: None)
