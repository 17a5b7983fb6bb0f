"""Courses are refused where, and only where, a type cannot fly them; each limit is named, with the speed left."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from risc_control.feasibility import check_course, fleet_course, fleet_ways, greatest_factor
from risc_control.reference_buffer import Order
from risc_control.trajectories import (
    COURSES,
    Course,
    YawProgram,
    figure,
    make_course,
    parse_speed,
    peak_speed_m_s,
    speed_factor,
)
from risc_control.trajectory_manager import Phase, make_manager
from risc_control.transitions import WayLimits
from risc_control.waypoints import Waypoints
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab import load_vehicle_type
from risc_lab.lab.arena import Arena
from risc_lab.lab.fleet import unplaced_vehicle
from risc_lab.settings import settings_from

LARGE = Arena(20.0, 20.0, 20.0)


def vehicles(kind="ardrone", count=1, **overrides):
    return [unplaced_vehicle("v%d" % i, "t%d" % i, kind).with_overrides(**overrides) for i in range(count)]


@pytest.mark.parametrize("kind", ["ardrone", "iris"])
@pytest.mark.parametrize("name", sorted(COURSES))
def test_the_courses_of_the_thesis_are_flown_as_ever(name, kind):
    for count in range(1, 5):
        for delay_s in (None, 0.3, 0.5):
            check_course(make_course(name, count), vehicles(kind, count, command_delay_s=delay_s), Arena())


@pytest.mark.parametrize("kind", ["ardrone", "iris"])
def test_those_of_old_nodes_too(kind):
    for course in (
        make_course("circle", 3, radius_m=0.7, period_s=5.0),
        make_course("circles3", 3, centre_m=1.2, radius_m=0.3),
        make_course("slanted8", 1, length_m=1.0, width_m=0.5, period_s=12.0),
        make_course("flat8", 1, length_m=1.0, width_m=0.5, height_m=1.0),
        make_course("knot", 1, period_s=15.0),
    ):
        check_course(course, vehicles(kind), Arena())


def level(radius_m, speed_m_s, height_m=2.0):
    return make_course("circle", 1, radius_m=radius_m, period_s=2.0 * math.pi * radius_m / speed_m_s, height_m=height_m)


def up_and_down(period_s, size_m=0.5, times=1):
    return figure("swing", 1, period_s, lambda a: (0.0 * a, 0.0 * a, 2.0 + size_m * np.sin(times * a)))


def wiggle(times, size_m):
    return figure("wiggle", 1, 2.0 * math.pi, lambda a: (size_m * np.cos(times * a), 0.0 * a, 2.0 + 0.0 * a))


@pytest.mark.parametrize(
    ("course", "arena", "words"),
    [
        (level(9.0, 3.1), LARGE, "speed .* 3.1 m/s.* 3,"),
        (level(0.8, 1.7), LARGE, "tilt .* 20.3 deg.* 17.7,"),
        (up_and_down(4.0), LARGE, "climb .* 8.* % .* 80,"),
        (make_course("spin", 1, turn_s=20.0), LARGE, "yaw rate .* 18 deg/s.* 16,"),
        (wiggle(6, 0.06), LARGE, "jerk: .* deg.* 17.7,"),
        (level(1.0, 0.5, height_m=0.2), LARGE, "lower .* 0.3 m"),
        (level(2.0, 0.5), Arena(), "out .* fence"),
        (make_course("flat8", 1).faster(3.0), Arena(1.75, 1.2), "stop .* fence"),
    ],
)
def test_each_limit_is_named_with_what_is_left(course, arena, words):
    with pytest.raises(ValueError, match=words) as error:
        check_course(course, vehicles(), arena)
    text = str(error.value)
    assert "\n" not in text and re.search(r"'ardrone': .* s .* \(.*\) m; ", text)
    left = re.search(r"--speed (\S+)", text)
    if left:
        fleet = vehicles()
        slower = course.faster(speed_factor(course, left[1]))
        check_course(slower, fleet, arena)
        with pytest.raises(ValueError, match=words.split(" ")[0]):
            check_course(slower.faster(1.05), fleet, arena)
    else:
        assert greatest_factor(course, vehicles(), arena) == 0.0


def test_a_circle_asks_for_what_it_must():
    """Against the formulas of the circle: v^2/r and the drag across it make the tilt, which a loop follows late."""
    kind = load_vehicle_type("ardrone")
    most_m_s2 = GRAVITY_M_S2 * math.tan(0.8 * kind.pitch.gain * kind.tilt_max_rad)
    course, drag_1_s = level(1.5, 1.0), kind.drag_n_s_m / kind.mass_kg
    speed_m_s = greatest_factor(course, vehicles(), LARGE)
    rate_rad_s = speed_m_s / 1.5
    tilt_m_s2 = math.hypot(speed_m_s * rate_rad_s, drag_1_s * speed_m_s)
    inverse = [
        abs(1.0 + 2.0j * loop.damping_ratio * rate_rad_s / wn - (rate_rad_s / wn) ** 2)
        for loop in (kind.roll, kind.pitch)
        for wn in (loop.natural_frequency_rad_s,)
    ]
    assert tilt_m_s2 * max(1.0, *inverse) == pytest.approx(most_m_s2, rel=3e-3)


@settings(max_examples=12, deadline=None)
@given(
    st.floats(0.3, 3.0),
    st.floats(0.2, 2.0),
    st.floats(0.0, 0.6),
    st.floats(3.0, 30.0),
    st.sampled_from(["ardrone", "iris"]),
)
def test_up_to_the_greatest_factor_and_no_farther(length_m, width_m, slant_m, period_s, kind):
    course = make_course("slanted8", 1, length_m=length_m, width_m=width_m, slant_m=slant_m + 1e-3, period_s=period_s,
                         height_m=2.0)  # fmt: skip
    fleet = vehicles(kind)
    factor = greatest_factor(course, fleet, LARGE)
    for part in (0.3, 0.7, 0.999):
        check_course(course.faster(part * factor), fleet, LARGE)
    with pytest.raises(ValueError, match="'slanted8'.*'%s'" % kind):
        check_course(course.faster(1.01 * factor), fleet, LARGE)


def test_the_speed_that_is_left_is_that_of_the_course_by_its_numbers():
    with pytest.raises(ValueError, match="--speed 1.3[23]x"):
        fleet_course("spin", vehicles(), Arena(), "4x")
    with pytest.raises(ValueError, match="--speed 2.0. "):
        fleet_course("flat8", vehicles(), Arena(), "9x")


def test_the_weakest_of_a_fleet_counts():
    course = level(1.0, 1.8)
    check_course(course, vehicles("iris"), LARGE)
    with pytest.raises(ValueError, match="type 'ardrone'"):
        check_course(course, [*vehicles("iris"), *vehicles("ardrone")], LARGE)
    with pytest.raises(ValueError, match="tilt"):
        check_course(course, vehicles("iris", tilt_max_rad=0.2), LARGE)
    with pytest.raises(ValueError, match="yaw rate"):
        check_course(level(1.0, 0.8).with_yaw(YawProgram(along_path=True)), vehicles(), LARGE)


def test_speeds():
    course = make_course("flat8", 1)
    own_m_s = peak_speed_m_s(course)
    assert own_m_s == pytest.approx(math.hypot(1.5, 1.5) * 2.0 * math.pi / 20.0, rel=1e-3)
    assert [speed_factor(course, speed) for speed in ("", "2x", 0.5 * own_m_s)] == pytest.approx([1.0, 2.0, 0.5])
    assert parse_speed("1.5") == (1.5, False) and parse_speed(" 0.5x ") == (0.5, True)
    for wrong in ("fast", "-1", "0x", "nan", "inf", "x", "1.5 m/s"):
        with pytest.raises(ValueError, match="m/s.* 2x.*'%s'" % wrong):
            parse_speed(wrong)
    with pytest.raises(ValueError, match="'origin'.* 2x"):
        speed_factor(make_course("origin", 1), "1.0")


@pytest.mark.parametrize("name", sorted(COURSES))
def test_faster_is_the_same_path_in_less_time(name):
    course = make_course(name, 3)
    fast = course.faster(1.7)
    assert fast.period_s == pytest.approx(course.period_s / 1.7)
    for time_s in np.linspace(0.1, course.period_s, 23):
        expected = course.at(1.7 * time_s) * 1.7 ** np.arange(5.0)[:, None, None]
        assert fast.at(time_s) == pytest.approx(expected, abs=1e-9)


def test_waypoints_without_times_are_flown_as_fast_as_it_goes():
    places = [{"position_m": [x, 0.4 * x, 1.0 + 1.5 * (x > 0.0)]} for x in (-1.0, 0.0, 1.0, 0.0, 0.3)]
    slow, fast = (settings_from(Waypoints, {"waypoints": places, "speed_m_s": speed}) for speed in (0.3, 2.5))
    course, factor = fleet_course(slow, vehicles(), Arena())
    assert factor == 1.0 and peak_speed_m_s(course) == pytest.approx(0.3, rel=1e-3)
    course, factor = fleet_course(fast, vehicles(), Arena())
    assert 0.1 < factor < 1.0
    with pytest.raises(ValueError, match="'ardrone'"):
        check_course(course.faster(1.01), vehicles(), Arena())
    with pytest.raises(ValueError, match="--speed"):
        fleet_course(fast, vehicles(), Arena(), "2.5")
    for place, time_s in zip(places, range(5)):
        place["time_s"] = 0.5 * time_s
    timed = settings_from(Waypoints, {"waypoints": places, "period_s": 2.5})
    with pytest.raises(ValueError, match="--speed"):
        fleet_course(timed, vehicles(), Arena())


def flown(course, factor, limits):
    """(greatest speed, greatest acceleration, phases) of the references of a flight on a course, and home."""
    fleet = vehicles()
    manager = make_manager(fleet, course, limits=limits)
    manager.see("t0", (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0)
    manager.set_autonomous("t0", True, 0.0)
    rows, phases = [], []
    for time_s in np.arange(0.0, 60.0, 0.02):
        if abs(time_s - 25.0) < 1e-6:
            manager.go_home(time_s)
        reference = manager.sample(time_s)
        rows.append(reference.derivatives[: Order.JERK, 0, :3])
        phases.append(reference.phases[0])
    assert phases[-1] is Phase.HOMED
    sizes = np.linalg.norm(np.array(rows), axis=2)
    return sizes[:, Order.VELOCITY].max(), sizes[:, Order.ACCELERATION].max(), phases


def test_ways_to_and_from_a_fast_course_ask_for_no_more_than_it_does():
    course = make_course("flat8", 1, length_m=2.0, width_m=1.0)
    factor = greatest_factor(course, vehicles(), LARGE)
    fast = course.faster(factor)
    limits = fleet_ways(WayLimits(), vehicles(), factor)
    own = np.linalg.norm(fast.over_period(400, Order.ACCELERATION)[..., 0, :3], axis=2).max(axis=0)
    speed_m_s, acceleration_m_s2, phases = flown(fast, factor, limits)
    assert speed_m_s <= 1.2 * own[Order.VELOCITY] + 1e-6
    assert acceleration_m_s2 <= 1.1 * max(own[Order.ACCELERATION], limits.acceleration_most_m_s2) + 1e-6
    # limited by the course's own peaks alone, they need more than the greatest tilt gives
    unlimited = replace(limits, acceleration_most_m_s2=1e3, speed_most_m_s=1e3)
    kind = load_vehicle_type("ardrone")
    assert flown(fast, factor, unlimited)[1] > GRAVITY_M_S2 * math.tan(kind.pitch.gain * kind.tilt_max_rad)


def test_ways_are_as_much_faster_or_slower_as_their_course():
    fleet, limits = vehicles(), WayLimits()
    assert fleet_ways(limits, fleet).speed_m_s == limits.speed_m_s
    twice = fleet_ways(limits, fleet, 2.0)
    assert twice.speed_m_s == 2.0 * limits.speed_m_s and twice.acceleration_m_s2 <= 4.0 * limits.acceleration_m_s2
    assert fleet_ways(limits, fleet, 50.0).speed_m_s == 1.5, "half of what the type may"
    assert fleet_ways(limits, fleet, 0.01).speed_m_s == 0.5 * limits.speed_m_s
    assert fleet_ways(replace(limits, speed_m_s=2.5), fleet, 50.0).speed_m_s == 2.5


def test_a_course_of_many_is_checked_in_no_time():
    course = Course("many", tuple(make_course("circles3", 50).paths), 8.0)
    check_course(course, vehicles(count=50), Arena(10.0, 10.0))
