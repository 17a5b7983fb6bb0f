"""Motions as compiled code evaluates them: what they were in numpy, the same uncompiled, the same as functions."""

import importlib.util
import math
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest

from risc_control.motions import Chains, blend, coasting, standing
from risc_control.trajectories import make_course, on_course
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
    """(k, 5, 2, 4) references of two vehicles: to a course, to another one on the way, and home."""
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


def test_a_way_that_rises_is_continuous_and_meets_both_ends():
    start, end = coasting((1.5, -1.0, 0.8), (0.2, 0.1, -0.1), 0.3, 4.0), on_course(make_course("knot", 3), 1, 3.0)
    way, level = (blend(start, end, 5.0, 8.0, rise_m) for rise_m in (0.7, 0.0))
    for time_s, motion in ((5.0, start), (13.0, end)):
        found, expected = (m.at(np.array([time_s]))[..., :3] for m in (way, motion))
        assert found == pytest.approx(expected, abs=1e-7)
    times = np.linspace(5.0, 13.0, 81)
    higher_m = (way.at(times) - level.at(times))[0, :, 2]
    assert higher_m[[32, 40, 48]] == pytest.approx([0.7] * 3) and higher_m.min() > -1e-12
    step_s = 1e-5
    for time_s in (5.2, 7.0, 8.3, 10.1, 12.9):
        path = way.at(np.array([time_s - step_s, time_s, time_s + step_s]))
        slopes = (path[:-1, 2] - path[:-1, 0]) / (2.0 * step_s)
        assert slopes == pytest.approx(path[1:, 1], rel=1e-5, abs=1e-4)


def test_the_nose_may_take_longer_than_the_path():
    end = on_course(make_course("circles3", 3), 1, 3.0)
    way = blend(standing((0, 0, 1), 0.0), end, 5.0, 4.0, yaw_duration_s=9.0, calls=(7, 8))
    times = np.array([9.0, 11.0, 14.0, 20.0])
    found, expected = way.at(times), end.at(times)
    assert found[..., :3] == pytest.approx(expected[..., :3])
    assert np.angle(np.exp(1j * (found - expected)[0, 2:, 3])) == pytest.approx([0.0, 0.0])
    assert abs(found - expected)[1, 1, 3] > 0.01, "it still turns"
    turned = blend(standing((0, 0, 1), 0.0), end, 5.0, 4.0, yaw_duration_s=9.0, revolutions=-1)
    just_before = np.array([13.999999])
    yaws = [motion.at(just_before)[0, 0, 3] for motion in (turned, way)]
    assert yaws[0] == pytest.approx(yaws[1] - 2.0 * math.pi, abs=1e-4)


def test_what_is_over_or_still_to_come_can_be_forgotten():
    first = blend(standing((0, 0, 1), 0.0), standing((1, 0, 1), 0.0), 1.0, 2.0)
    second = blend(first, standing((1, 1, 1), 0.0), 5.0, 2.0)
    times = np.linspace(4.0, 9.0, 11)
    assert len(second.since(3.5).links) == 2
    assert second.since(3.5).at(times) == pytest.approx(second.at(times))
    assert second.until(4.0).at(times) == pytest.approx(first.at(times))
    assert [int((second.links["end_s"] > time_s).sum()) for time_s in (0.0, 4.0, 8.0)] == [2, 1, 0]


def test_fleet_and_single_vehicle_are_evaluated_by_the_same_code():
    course = make_course("knot", 3)
    ways = [blend(standing((i, 0, 1), 0.0), on_course(course, i, 0.0), 1.0, 4.0, calls=(3, 4)) for i in range(3)]
    chains = Chains(ways)
    for time_s, call in ((0.5, 0), (2.0, 3), (7.0, 4), (8.0, 4)):
        derivatives = chains.at(np.array([time_s]))
        assert chains.is_new == (time_s < 8.0) and chains.calls.tolist() == [call] * 3
        for i, way in enumerate(ways):
            assert (derivatives[:, i] == way.at(np.array([time_s]))[:, 0]).all()
