"""Motions as compiled code evaluates them: what they were in numpy, the same uncompiled, the same as functions."""

import importlib.util
import math
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest

from risc_control import motions
from risc_control.motions import Blend, coasting, standing
from risc_control.trajectories import COURSES, Course, make_course, on_course
from risc_control.trajectory_manager import Home, Phase, TrajectoryManager

GOLDEN = pathlib.Path(__file__).parent / "golden"


def golden_script():
    spec = importlib.util.spec_from_file_location("golden_motions", GOLDEN / "motions.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    return script


def test_courses_and_blends_are_what_they_were():
    expected, sampled = np.load(GOLDEN / "motions.npz"), golden_script().sampled()
    assert set(sampled) == set(expected)
    for name, rows in sampled.items():
        assert rows == pytest.approx(expected[name], abs=1e-9), name


def test_uncompiled_it_is_the_same(tmp_path):
    code = "import numpy, test_motions as t; numpy.save(%r, t.whole_flight())" % str(tmp_path / "plain.npy")
    path = os.pathsep.join([str(pathlib.Path(__file__).parent)] + sys.path)
    environment = dict(os.environ, NUMBA_DISABLE_JIT="1", PYTHONPATH=path)
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, timeout=120)
    assert whole_flight() == pytest.approx(np.load(tmp_path / "plain.npy"), abs=1e-9)


def whole_flight():
    """(k, 5, 2, 4) references of two vehicles to a course, to another one meanwhile, and home."""
    manager = TrajectoryManager(("a", "b"), (Home((1, 0, 1), 0.0), Home((-1, 0, 1), 2.0)), make_course("quadrants", 2))
    for name, x in (("a", -0.5), ("b", 0.5)):
        manager.see(name, (x, 0.1, 0.9), (0.1, 0.0, 0.0), 1.0)
        manager.set_autonomous(name, True, 0.0)
    rows = []
    for time_s in np.arange(0.0, 40.0, 0.5):
        rows.append(manager.sample(time_s).derivatives)
        if time_s == 2.0:
            manager.set_course(make_course("flat8", 2), time_s)
        if time_s == 15.0:
            manager.go_home(time_s)
    assert manager.sample(40.0).phases == (Phase.HOMED,) * 2
    return np.array(rows)


class Spirals:
    """What a student may write: paths that are nothing but Python."""

    period_s = 9.0

    def __init__(self, phases=(0.0, 2.0, 4.0)):
        self._phases = np.array(phases)

    def __len__(self):
        return len(self._phases)

    def at(self, times_s):
        w = 2.0 * math.pi / self.period_s
        angle = w * np.broadcast_to(times_s, max(np.size(times_s), len(self))) + self._phases
        turns = [np.stack([np.cos(angle + k * math.pi / 2), np.sin(angle + k * math.pi / 2), 0 * angle], 1) * w**k
                 for k in range(5)]  # fmt: skip
        turns[0][:, 2] = 1.0
        return np.array(turns)

    def reordered(self, order):
        return Spirals(self._phases[np.asarray(order)])


def test_a_course_may_be_a_python_function(monkeypatch):
    def spirals(vehicles):
        plain = make_course("circle", vehicles, radius_m=1.0, period_s=9.0)
        return Course("spirals", Spirals(np.arange(vehicles) * 2.0 * math.pi / vehicles), plain.shifts_s * 0, plain.yaw)

    monkeypatch.setitem(COURSES, "spirals", spirals)
    by_function, compiled = make_course("spirals", 3), make_course("circle", 3, radius_m=1.0, period_s=9.0)
    for time_s in (0.0, 4.4):
        for mine, known in zip(by_function.at(time_s), compiled.at(time_s)):
            assert mine == pytest.approx(known, abs=1e-12)
    times = np.linspace(5.0, 15.0, 11)
    ways = [Blend(standing((0, 0, 1), 0.0), on_course(course, 1, 2.0), 6.0, 5.0) for course in (by_function, compiled)]
    for mine, known in zip(ways[0](times), ways[1](times)):
        assert mine == pytest.approx(known, abs=1e-12)

    references = []
    for course in (by_function, compiled):
        homes = [Home((x, y, 1), 0.0) for x, y in ((0.9, 0.0), (-0.45, 0.78), (-0.45, -0.78))]
        manager = TrajectoryManager(("a", "b", "c"), homes, course)
        for name in manager.names:
            manager.set_autonomous(name, True, 0.0)
        references.append(np.array([manager.sample(time_s).derivatives for time_s in np.arange(0.0, 20.0, 0.25)]))
        manager.go_home(20.0)
        assert manager.sample(60.0).phases == (Phase.HOMED,) * 3
    assert references[0] == pytest.approx(references[1], abs=1e-9)


def test_a_way_that_rises_is_continuous_and_meets_both_ends():
    start, end = coasting((1.5, -1.0, 0.8), (0.2, 0.1, -0.1), 0.3, 4.0), on_course(make_course("knot", 3), 1, 3.0)
    way, level = (Blend(start, end, 5.0, 8.0, rise_m) for rise_m in (0.7, 0.0))
    for time_s, motion in ((5.0, start), (13.0, end)):
        assert way(np.array([time_s]))[0] == pytest.approx(motion(np.array([time_s]))[0], abs=1e-7)
    times = np.linspace(5.0, 13.0, 81)
    higher_m = (way(times)[0] - level(times)[0])[0, :, 2]
    assert higher_m[[32, 40, 48]] == pytest.approx([0.7] * 3) and higher_m.min() > -1e-12
    step_s = 1e-5
    for time_s in (5.2, 7.0, 8.3, 10.1, 12.9):
        path, _ = way(np.array([time_s - step_s, time_s, time_s + step_s]))
        slopes = (path[:-1, 2] - path[:-1, 0]) / (2.0 * step_s)
        assert slopes == pytest.approx(path[1:, 1], rel=1e-5, abs=1e-4)


def test_the_nose_may_take_longer_than_the_path():
    end = on_course(make_course("circles3", 3), 1, 3.0)
    way = Blend(standing((0, 0, 1), 0.0), end, 5.0, 4.0, yaw_duration_s=9.0, calls=(7, 8))
    times = np.array([9.0, 11.0, 14.0, 20.0])
    assert way(times)[0] == pytest.approx(end(times)[0])
    assert np.angle(np.exp(1j * (way(times)[1][0] - end(times)[1][0])))[2:] == pytest.approx([0.0, 0.0])
    assert abs(way(times)[1][1, 1] - end(times)[1][1, 1]) > 0.01, "it still turns"
    turned = Blend(standing((0, 0, 1), 0.0), end, 5.0, 4.0, yaw_duration_s=9.0, revolutions=-1)
    just_before = np.array([13.999999])
    assert turned(just_before)[1][0] == pytest.approx(way(just_before)[1][0] - 2.0 * math.pi, abs=1e-4)


def test_what_is_over_or_still_to_come_can_be_forgotten():
    first = Blend(standing((0, 0, 1), 0.0), standing((1, 0, 1), 0.0), 1.0, 2.0)
    second = Blend(first, standing((1, 1, 1), 0.0), 5.0, 2.0)
    times = np.linspace(4.0, 9.0, 11)
    assert len(second.since(3.5).links) == 2
    assert second.since(3.5)(times)[0] == pytest.approx(second(times)[0])
    assert second.until(4.0)(times)[0] == pytest.approx(first(times)[0])
    assert [second.blends_after(time_s) for time_s in (0.0, 4.0, 8.0)] == [2, 1, 0]


def test_fleet_and_single_vehicle_are_evaluated_by_the_same_code():
    course = make_course("knot", 3)
    ways = [Blend(standing((i, 0, 1), 0.0), on_course(course, i, 0.0), 1.0, 4.0, calls=(3, 4)) for i in range(3)]
    tables = np.concatenate([way.table for way in ways])
    links = np.stack([way.links for way in ways])
    links["first"] += np.cumsum([0] + [len(way.table) for way in ways[:-1]])[:, None]
    derivatives, calls = np.empty((5, 3, 4)), np.zeros(3, dtype=int)
    for time_s, call in ((0.5, 0), (2.0, 3), (7.0, 4)):
        is_new = motions.sample_fleet(links, np.full(3, 2), tables, motions.NO_PATHS, time_s, derivatives, calls)
        assert is_new == (call != 0) and calls.tolist() == [call] * 3
        for i, way in enumerate(ways):
            path, yaw = way(np.array([time_s]))
            assert (derivatives[:, i, :3] == path[:, 0]).all() and (derivatives[:3, i, 3] == yaw[:, 0]).all()
