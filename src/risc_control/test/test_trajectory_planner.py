"""The thread that plans ways beside the references, without ROS around it."""

import threading
import time
from types import SimpleNamespace

import pytest

pytest.importorskip("rospy")

from risc_control.ros import trajectory_node  # noqa: E402
from risc_control.ros.trajectory_node import ManagerWiring  # noqa: E402


def test_a_task_that_cannot_be_planned_is_told_and_the_next_one_is_planned(monkeypatch):
    told, flown, rests = [], threading.Event(), []
    manager = SimpleNamespace(task="impossible", safe_m=1.0)

    def plan_ways(task):
        if task == "impossible":
            raise ValueError("no way")
        return SimpleNamespace(closest_m=2.0)

    def accept(task, _plan, _now_s):
        assert task == "possible"
        manager.task = None
        flown.set()
        return True

    def rest(seconds):
        rests.append(seconds)
        manager.task = "possible"  # the vehicles are sent elsewhere

    manager.accept = accept
    monkeypatch.setattr(trajectory_node, "plan_ways", plan_ways)
    monkeypatch.setattr(trajectory_node, "time", SimpleNamespace(sleep=rest))
    monkeypatch.setattr(trajectory_node.rospy, "logerr", lambda *_: told.append("error"))
    wiring = ManagerWiring.__new__(ManagerWiring)
    wiring.manager, wiring.lock, wiring._to_plan = manager, threading.Lock(), threading.Event()
    wiring.clock = SimpleNamespace(now_s=lambda: 0.0)
    threading.Thread(target=wiring._plan, daemon=True).start()
    wiring._to_plan.set()
    deadline_s = time.monotonic() + 30.0
    while not rests and time.monotonic() < deadline_s:
        time.sleep(0.001)
    wiring._to_plan.set()  # as every sample of the references does while there is a task
    assert flown.wait(30.0)
    assert told == ["error"]
    assert rests == [trajectory_node._REST_S]
