"""Processor use of programs: those that ended meanwhile, names, only the cores that the flight may use."""

import os
import types

import psutil
import pytest

from risc_experiments import processor_use
from risc_experiments.processor_use import ProcessorUse, program_name
from risc_lab.ros.launching import MARK


class Process:
    """A process as psutil shows it."""

    def __init__(self, pid, words, used_s, identity="", created_s=1.0):
        self.pid, self._words, self._used_s, self._identity, self._created_s = pid, words, used_s, identity, created_s

    def create_time(self):
        return self._created_s

    def cmdline(self):
        return self._words

    def name(self):
        return self._words[0]

    def environ(self):
        return {MARK: self._identity}

    def cpu_times(self):
        return types.SimpleNamespace(user=self._used_s, system=0.0)

    def memory_full_info(self):
        return types.SimpleNamespace(pss=2e6)


@pytest.fixture
def computer(monkeypatch):
    """A computer of four cores, of which the flight may use two; its `look` is (time, processes, busy [s] by core)."""
    now = types.SimpleNamespace(look=None)
    kind, fields = type(psutil.cpu_times()), psutil.cpu_times()._fields

    def cpu_times(percpu):
        assert percpu
        return [
            kind(**dict(dict.fromkeys(fields, 0.0), user=busy_s, idle=now.look[0] - busy_s)) for busy_s in now.look[2]
        ]

    monkeypatch.setattr(processor_use.psutil, "process_iter", lambda: now.look[1])
    monkeypatch.setattr(processor_use.psutil, "cpu_times", cpu_times)
    monkeypatch.setattr(processor_use.time, "monotonic", lambda: now.look[0])
    monkeypatch.setattr(processor_use.os, "sched_getaffinity", lambda _: {1, 3})
    return now


def figures_of(computer, looks):
    use = ProcessorUse("ours")
    for computer.look in looks:
        use.look()
    return use.figures()


def test_what_ended_before_the_last_look_is_counted(computer):
    node, browser = ["python3", "controller.py"], ["browser"]
    looks = [
        (0.0, [Process(1, node, 5.0, "ours"), Process(2, browser, 100.0)], [0.0] * 4),
        (2.0, [Process(1, node, 6.0, "ours"), Process(2, browser, 100.2), Process(3, ["cc1plus"], 1.5)], [0.0] * 4),
        (4.0, [Process(1, node, 7.0, "ours"), Process(2, browser, 100.4), Process(4, ["cc1plus"], 1.3)], [0.0] * 4),
    ]
    figures = figures_of(computer, looks)
    assert figures["cpu_cores"] == {"controller.py": 0.5} and figures["memory_mb"] == {"controller.py": 2.0}
    assert (figures["computer"]["busiest_other"], figures["computer"]["busiest_other_cores"]) == ("cc1plus", 0.7)
    assert figures["computer"]["others"] == pytest.approx(0.8)


def test_only_the_cores_that_the_flight_may_use_are_looked_at(computer):
    figures = figures_of(computer, [(0.0, [], [0.0] * 4), (10.0, [], [0.0, 9.0, 0.0, 10.0])])
    assert figures["computer"]["cores"] == 2 and figures["computer"]["idle"] == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["/usr/bin/python3", "-u", "/x/roslaunch", "a.launch"], "roslaunch"),
        (["python3", "-m", "risc_experiments.fly", "--seed", "1"], "risc_experiments.fly"),
        (["python3", "-c", "while True: pass"], "python3"),
        (["/usr/lib/firefox/firefox", "-contentproc"], "firefox"),
        (["python3", "/x/states_estimation.py", "__name:=estimator"], "estimator"),
        (["bash"], "bash"),
    ],
)
def test_names_of_programs(words, name):
    assert program_name(Process(os.getpid(), words, 0.0)) == name
