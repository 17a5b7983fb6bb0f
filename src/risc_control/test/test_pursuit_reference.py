"""References of the pursuit: the waiting place, the target of the original release, and what ends it."""

import math

import numpy as np
import pytest

from risc_control.pursuit_reference import _LEAD_S, TargetParams, VirtualTarget
from risc_control.trajectory_manager import Home, Phase

NAME = "fluffy_II"
PLACE = (0.5, 1.2, 1.0)


def waiting():
    """A VirtualTarget whose vehicle has arrived where it waits, and the time."""
    target = VirtualTarget([NAME], [Home(PLACE, 0.0)], TargetParams().waiting_place())
    target.see(NAME, PLACE, np.zeros(3), 0.0)
    target.set_autonomous(NAME, True, 0.0)
    for now_s in np.arange(0.0, 30.0, 0.1):
        if target.sample(now_s).phases == (Phase.COURSE,):
            return target, now_s
    raise AssertionError("it never arrived")


def let_go(target, now_s):
    """Let the target go. Return the time at which it starts."""
    assert target.let_go(now_s)
    target.sample(now_s)
    return now_s + _LEAD_S


def test_the_numbers_are_those_of_the_original():
    target, now_s = waiting()
    reference = target.sample(now_s).derivatives
    assert reference[0, 0] == pytest.approx([0.5643, 1.2213, 1.0, -math.pi / 2.0])
    assert not reference[1:].any() and target.target_speed_m_s(now_s) == 0.0
    now_s = let_go(target, now_s)
    for later_s in (0.0, 3.0, 11.0):
        angle = 0.25 * later_s + math.pi / 2.0
        reference = target.sample(now_s + later_s).derivatives[:, 0]
        assert reference[0] == pytest.approx([0.8 * math.cos(angle), 0.8 * math.sin(angle), 1.0, -math.pi / 2.0])
        assert reference[1] == pytest.approx([-0.2 * math.sin(angle), 0.2 * math.cos(angle), 0.0, 0.0])
    assert target.target_speed_m_s(now_s) == pytest.approx(0.2)
    assert [target.target.name, target.course.name] == ["NGC", "WP"]


def test_velocity_and_acceleration_of_the_target_are_central_differences():
    target, now_s = waiting()
    now_s = let_go(target, now_s)
    step_s = 1e-4
    for time_s in now_s + np.linspace(1.0, 20.0, 7):
        before, here, after = (target.sample(time_s + d).derivatives for d in (-step_s, 0.0, step_s))
        assert (after[:-1] - before[:-1]) / (2.0 * step_s) == pytest.approx(here[1:], abs=1e-6)


def test_the_target_waits_until_the_vehicle_does():
    target = VirtualTarget([NAME], [Home((-1.0, -1.0, 1.0), 0.0)], TargetParams().waiting_place())
    target.see(NAME, (-1.0, -1.0, 1.0), np.zeros(3), 0.0)
    assert not target.let_go(0.0)
    target.set_autonomous(NAME, True, 0.0)
    assert not target.let_go(0.0), "it holds its place"
    assert target.sample(1.0).phases == (Phase.APPROACH,)
    assert target.let_go(1.0) and not target.pursuing
    target.sample(60.0)
    assert target.pursuing and target.watching


def test_a_press_that_comes_while_it_runs_or_at_home_lets_nothing_go_later():
    target, now_s = waiting()
    now_s = let_go(target, now_s)
    assert not target.let_go(now_s), "it runs"
    target.see(NAME, PLACE, np.zeros(3), 0.0)
    assert target.go_home(now_s) == [NAME]
    assert not target.let_go(now_s), "on the way home"
    assert target.sample(now_s + 30.0).phases == (Phase.HOMED,) and not target.let_go(now_s + 30.0)
    assert target.start(now_s + 30.0) == [NAME]
    assert target.sample(now_s + 60.0).phases == (Phase.COURSE,) and not target.pursuing
    now_s = let_go(target, now_s + 60.0)
    assert target.pursuing


def test_its_speed_is_told_before_it_runs_and_after_it_stopped():
    """Otherwise a controller that gets the reference first would fly to the target instead of behind it."""
    target, now_s = waiting()
    assert target.let_go(now_s)
    reference = target.sample(now_s).derivatives
    assert target.target_speed_m_s(now_s) > 0.0 and reference[0, 0, 0] == pytest.approx(0.5643), "still there"
    now_s += 5.0
    assert np.linalg.norm(target.sample(now_s).derivatives[1, 0, :3]) == pytest.approx(0.2)
    target.see(NAME, PLACE, np.zeros(3), 0.0)
    target.go_home(now_s)
    assert target.sample(now_s).derivatives[0, 0, :3] == pytest.approx(PLACE), "where it is"
    assert target.target_speed_m_s(now_s) > 0.0 and target.target_speed_m_s(now_s + 0.2) == 0.0


@pytest.mark.parametrize("end", ["manual", "home"])
def test_whatever_ends_the_pursuit_the_reference_goes_on_from_the_vehicle(end):
    target, now_s = waiting()
    now_s = let_go(target, now_s) + 8.0
    seen_m, velocity_m_s = np.array([0.3, 0.9, 1.05]), np.array([-0.15, 0.1, 0.0])
    assert np.linalg.norm(target.sample(now_s).derivatives[0, 0, :3] - seen_m) > 0.4
    target.see(NAME, seen_m, velocity_m_s, -1.6)
    assert target.sample(now_s).phases == (Phase.COURSE,), "what it sees changes nothing while it pursues"
    target.set_autonomous(NAME, True, now_s)  # as its node repeats 30 times a second
    assert target.pursuing
    if end == "manual":
        assert target.set_autonomous(NAME, False, now_s)
    else:
        assert target.go_home(now_s) == [NAME]
    reference = target.sample(now_s)
    assert reference.derivatives[0, 0] == pytest.approx([*seen_m, -1.6]) and not target.pursuing
    if end == "home":
        assert reference.derivatives[1, 0, :3] == pytest.approx(velocity_m_s)
        home = target.sample(now_s + 30.0)
        assert home.phases == (Phase.HOMED,) and home.derivatives[0, 0, :3] == pytest.approx(PLACE)
        assert target.start(now_s + 30.0) == [NAME]
        assert target.sample(now_s + 60.0).derivatives[0, 0, :3] == pytest.approx([0.5643, 1.2213, 1.0])
