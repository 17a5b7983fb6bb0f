"""Ways of fleets: apart on the way to the course, home and joining alone; within their limits; cheap; reproducible."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from risc_control import motions, trajectories, transitions
from risc_control.trajectories import SAFE_SEPARATION_M, make_course
from risc_control.trajectory_manager import Home, Phase, TrajectoryManager, WayLimits

STEP_S = 0.05
SPACING_M = 0.95


def grid(vehicles, spacing_m=SPACING_M):
    """(n, 3) places on the floor, in rows."""
    side = math.ceil(math.sqrt(vehicles))
    places = np.array([[k // side, k % side, 0.0] for k in range(vehicles)]) * spacing_m
    return places - [*places[:, :2].mean(axis=0), 0.0]


def circles(vehicles):
    """A circle for each, centres in rows."""
    course = make_course("circles3", vehicles)
    paths = [
        path.with_fields(position_m=centre, yaw_rad=2.0 * math.pi * k / vehicles)
        for k, (path, centre) in enumerate(zip(course.paths, grid(vehicles) + [0.0, 0.0, 1.0]))
    ]
    return replace(course, paths=tuple(paths))


def one_circle(vehicles):
    """One circle for all, as large as needed, at the speed of the small one."""
    radius_m = max(0.8, 0.45 / math.sin(math.pi / vehicles)) if vehicles > 1 else 0.8
    return make_course("circle", vehicles, radius_m=radius_m, period_s=10.0 * radius_m)


def hovering(course, places, **options):
    """TrajectoryManager of vehicles that hover above their places."""
    names = tuple("vehicle %d" % k for k in range(len(places)))
    manager = TrajectoryManager(names, [Home((x, y, 1.0), 0.0) for x, y, _ in places], course, **options)
    rng = np.random.default_rng(7)
    for name, place in zip(names, places):
        manager.see(name, place + [0.0, 0.0, 0.9] + rng.uniform(-0.05, 0.05, 3), np.zeros(3), 0.05)
    return manager


def all_autonomous(manager, now_s):
    for name in manager.names:
        manager.set_autonomous(name, True, now_s)


def flown(manager, begin_s, end_s):
    """(k, 5, n, 4) references from begin_s to end_s."""
    return np.array([manager.sample(time_s).derivatives for time_s in np.arange(begin_s, end_s, STEP_S)])


def closest(derivatives):
    return trajectories.minimum_separation(derivatives[:, 0, :, :3])


@pytest.mark.parametrize("course", [circles, one_circle])
@pytest.mark.parametrize("vehicles", [1, 3, 5, 8, 14, 30])
def test_to_the_course_and_home_they_keep_apart(course, vehicles):
    manager = hovering(course(vehicles), grid(vehicles))
    all_autonomous(manager, 0.0)
    out = flown(manager, 0.0, 60.0)
    assert manager.sample(60.0).phases == (Phase.COURSE,) * vehicles
    assert closest(out) >= SAFE_SEPARATION_M and manager.closest_m >= SAFE_SEPARATION_M
    assert len(manager.go_home(63.0)) == vehicles
    back = flown(manager, 63.0, 150.0)
    assert manager.sample(150.0).phases == (Phase.HOMED,) * vehicles
    assert closest(back) >= SAFE_SEPARATION_M and manager.closest_m >= SAFE_SEPARATION_M
    assert back[-1, 0, :, :2] == pytest.approx(grid(vehicles)[:, :2])


def test_ways_that_are_smoother_for_a_controller_keep_the_limits():
    manager = hovering(make_course("origin", 1), np.array([[1.2, 1.0, 0.0]]), order=12)
    all_autonomous(manager, 0.0)
    way = flown(manager, 0.0, 30.0)[:, :3, 0, :3]
    assert manager.sample(30.0).phases == (Phase.COURSE,)
    peaks = np.sqrt((way[:, 1:] ** 2).sum(axis=-1)).max(axis=0)
    assert (peaks <= (manager.limits.speed_m_s, manager.limits.acceleration_m_s2)).all()


@pytest.mark.parametrize("first,second", list(itertools.permutations([circles, one_circle], 2)))
def test_from_course_to_course_they_keep_apart(first, second):
    manager = hovering(first(14), grid(14))
    all_autonomous(manager, 0.0)
    flown(manager, 0.0, 60.0)
    manager.set_course(second(14), 61.3)
    assert closest(flown(manager, 61.3, 120.0)) >= SAFE_SEPARATION_M
    assert manager.sample(120.0).phases == (Phase.COURSE,) * 14


@pytest.mark.parametrize("course", ["circle", "circles3", "flat8", "slanted8", "knot", "origin"])
def test_who_joins_alone_keeps_clear_of_the_others(course):
    """From a place between or beside their paths; on `origin` only a way over them is clear."""
    flying = make_course(course, 3)
    taken = flying.over_period(int(10 * flying.period_s))[:, 0, :, :3]
    # far from all three paths, whichever vehicle joins
    candidates = [np.array([x, y, 1.0]) for x in np.arange(-2.0, 2.1, 0.25) for y in np.arange(-1.5, 1.6, 0.25)]
    clear_m = [np.linalg.norm(taken - place, axis=2).min() for place in candidates]
    place = candidates[int(np.argmax(np.array(clear_m) * (np.array(clear_m) < 1.0)))]
    manager = hovering(flying, np.array([[0.9, 0, 0], [-0.45, 0.78, 0], [-0.45, -0.78, 0]]), wait_for_all=False)
    for name in manager.names[1:]:
        manager.set_autonomous(name, True, 0.0)
    flown(manager, 0.0, 60.0)
    manager.see(manager.names[0], place, np.zeros(3), 0.0)
    manager.set_autonomous(manager.names[0], True, 60.0)
    assert closest(flown(manager, 60.0, 120.0)) >= SAFE_SEPARATION_M
    assert manager.sample(120.0).phases[0] is Phase.COURSE


def test_over_what_stands_in_between_but_not_too_high():
    """Three stand in a row; the place of the fourth is beyond them."""
    places = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    row, heights_m = trajectories.points("row", places + [0.0, 0.0, 1.0]), []
    for limits in (WayLimits(), WayLimits(highest_m=1.5)):
        manager = hovering(row, places, limits=limits, wait_for_all=False)
        for name in manager.names[1:]:
            manager.set_autonomous(name, True, 0.0)
        flown(manager, 0.0, 30.0)
        manager.see(manager.names[0], (0.0, 1.0, 1.0), np.zeros(3), 0.0)
        manager.set_autonomous(manager.names[0], True, 30.0)
        references = flown(manager, 30.0, 70.0)
        assert (closest(references) >= SAFE_SEPARATION_M) == (limits.highest_m > 2.0)
        assert (manager.closest_m >= SAFE_SEPARATION_M) == (limits.highest_m > 2.0), "and it is said when it cannot be"
        heights_m.append(references[:, 0, 0, 2].max())
    assert 1.7 < heights_m[0] <= 2.4 and heights_m[1] < 1.1
    with pytest.raises(ValueError, match="highest_m"):
        WayLimits(highest_m=0.0)


@pytest.mark.parametrize("vehicles", [3, 14])
def test_all_ways_keep_the_limits(vehicles):
    """However they are delayed, stretched or led over others: the limits, or little more than the course's peaks."""
    manager = hovering(circles(vehicles), grid(vehicles)[::-1].copy())
    all_autonomous(manager, 0.0)
    references = [flown(manager, 0.0, 60.0)]
    manager.set_course(one_circle(vehicles), 60.0)
    references.append(flown(manager, 60.0, 110.0))
    manager.go_home(110.0)
    references = np.concatenate(references + [flown(manager, 110.0, 200.0)])
    limits, own_m_s, own_m_s2 = WayLimits(), 0.2 * math.pi, (0.2 * math.pi) ** 2 / 0.8
    speed, acceleration = (np.linalg.norm(references[:, order, :, :3], axis=2).max() for order in (1, 2))
    assert limits.speed_m_s < speed <= 1.2 * own_m_s + 1e-3 and acceleration <= 1.5 * own_m_s2 + 0.01
    assert np.abs(references[:, 1, :, 3]).max() <= limits.yaw_rate_rad_s + 1e-3


def task_of(vehicles, course=circles):
    manager = hovering(course(vehicles), grid(vehicles), lead_s=1.0)
    all_autonomous(manager, 0.0)
    manager.sample(1.0)
    return manager.task


def test_the_same_task_gives_the_same_plan():
    plans = [transitions.plan_ways(task_of(14, one_circle)) for _ in range(2)]
    assert plans[0].closest_m == plans[1].closest_m and plans[0].epoch_s == plans[1].epoch_s
    for mine, other in zip(plans[0].ways.values(), plans[1].ways.values()):
        assert mine.links.tobytes() == other.links.tobytes()


def test_what_it_takes_grows_gently(monkeypatch):
    """Tables grow with the options or with the vehicles, never with both; pairs are searched, never assignments."""
    sizes, calls = {}, {}
    original = transitions._lacking

    def counted(start_m, end_m, steps, tracks_m, *rest):
        calls[vehicles] = calls.get(vehicles, 0) + 1
        sizes[vehicles] = steps.nbytes + start_m.nbytes + end_m.nbytes + 3 * tracks_m.nbytes
        original(start_m, end_m, steps, tracks_m, *rest)

    monkeypatch.setattr(transitions, "_lacking", counted)
    for vehicles in (14, 50):
        transitions.plan_ways(task_of(vehicles, one_circle))
        assert 1 < calls[vehicles] <= 2 * (transitions._TRIES * vehicles + transitions._MORE_TRIES) + 1
        assert sizes[vehicles] < 5e6  # [bytes]


def test_nothing_is_compiled_in_flight():
    """Once a manager exists, everything called in flight has been compiled for its argument types."""
    compiled = [
        f for module in (motions, trajectories, transitions) for f in vars(module).values() if hasattr(f, "signatures")
    ]
    hovering(circles(2), grid(2))
    before = {f.__name__: len(f.signatures) for f in compiled}
    assert len(before) > 5 and sum(before.values()) > 0
    manager = hovering(one_circle(5), grid(5), limits=WayLimits(1, 1, 1, 2, 30, 2), lead_s=1)
    all_autonomous(manager, 0)
    for time_s in range(60):
        manager.sample(time_s)
        if time_s == 20:
            manager.set_course(circles(5), time_s)
        if time_s == 40:
            manager.go_home(time_s)
        if manager.task:
            manager.accept(manager.task, transitions.plan_ways(manager.task), time_s)
    assert manager.sample(100).phases == (Phase.HOMED,) * 5
    assert {f.__name__: len(f.signatures) for f in compiled} == before
