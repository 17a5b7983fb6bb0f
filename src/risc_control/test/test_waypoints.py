"""Files of waypoints: what they mean, and one clear error for each way of being wrong."""

import math

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from risc_control.reference_buffer import Order
from risc_control.trajectories import (
    YawProgram,
    course_for_fleet,
    course_separation,
    find_course,
    make_course,
    on_course,
    peak_speed_m_s,
)
from risc_control.waypoints import Waypoints, load_waypoints
from risc_lab.lab.arena import Arena
from risc_lab.settings import settings_from

SQUARE = [(1.0, 1.0, 1.0), (-1.0, 1.0, 1.2), (-1.0, -1.0, 1.0), (1.0, -1.0, 0.8)]


def waypoints(points=SQUARE, each=None, **fields):
    each = each or [{}] * len(points)
    listed = [{"position_m": list(point), **more} for point, more in zip(points, each)]
    return settings_from(Waypoints, {"waypoints": listed, **fields}, "file")


def test_a_closed_course_goes_round_through_all_points():
    course = make_course(waypoints(speed_m_s=0.8), 1)
    assert course.name == "waypoints" and peak_speed_m_s(course) == pytest.approx(0.8, rel=1e-3)
    path = course.paths[0].at(np.linspace(0.0, course.period_s, 4001), Order.POSITION)[0, :, :3]
    for point in SQUARE:
        assert np.linalg.norm(path - point, axis=1).min() < 1e-3
    around = course.paths[0].at(np.array([-0.4, course.period_s - 0.4, 3.0 * course.period_s - 0.4]))
    assert around[:, 1:] == pytest.approx(around[:, :2][:, [0, 0]], abs=1e-9)


def test_an_open_course_rests_at_both_ends_and_comes_back_the_same_way():
    course = make_course(waypoints(closed=False), 1)
    half_s = 0.5 * course.period_s
    ends = course.paths[0].at(np.array([0.0, half_s]), Order.JERK)
    assert ends[0, :, :3] == pytest.approx(np.array([SQUARE[0], SQUARE[-1]]))
    assert ends[1:] == pytest.approx(0.0, abs=1e-9)
    there, back = (course.paths[0].at(half_s + sign * np.linspace(0.0, half_s, 50))[0] for sign in (-1, 1))
    assert there == pytest.approx(back, abs=1e-9)


def test_given_times_are_kept():
    each = [{"time_s": time_s} for time_s in (0.0, 2.0, 5.0, 6.5)]
    course = make_course(waypoints(each=each, period_s=9.0), 1)
    assert course.period_s == 9.0
    assert [course.at(item["time_s"])[0, 0, :3].tolist() for item in each] == [pytest.approx(point) for point in SQUARE]


@pytest.mark.parametrize(("closed", "rounds"), [(True, 0), (True, 1), (False, 0)])
def test_yaw_takes_the_short_way_between_waypoints(closed, rounds):
    yaws = [170.0, -170.0, 160.0, 175.0] if not rounds else [0.0, 90.0, 180.0, -90.0]
    course = make_course(waypoints(each=[{"yaw_deg": yaw} for yaw in yaws], closed=closed), 1)
    path = course.paths[0].at(np.linspace(0.0, course.period_s, 2000, endpoint=False), 1)
    turned = np.angle(np.exp(1j * np.diff(path[0, :, 3], append=path[0, :1, 3])))
    assert turned.sum() == pytest.approx(2.0 * math.pi * rounds, abs=1e-6)
    assert np.abs(turned).max() < 0.1, "without a jump"
    nearest = [np.linalg.norm(path[0, :, :3] - point, axis=1).argmin() for point in SQUARE]
    assert np.cos(path[0, nearest, 3] - np.radians(yaws)) == pytest.approx(1.0, abs=1e-3)
    constant = course.with_yaw(YawProgram(0.7)).at(1.3)
    assert constant[:, 0, 3].tolist() == [0.7, 0.0, 0.0, 0.0, 0.0]
    assert constant[..., :3] == pytest.approx(course.at(1.3)[..., :3])


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(-2.0, 2.0)] * 3), min_size=2, max_size=6, unique=True),
    st.booleans(),
    st.floats(0, 1),
)
def test_derivatives_are_central_differences(points, closed, part):
    points = [(x, y, 3.0 * k + z) for k, (x, y, z) in enumerate(points)]
    each = [{"yaw_deg": 40.0 * k} for k in range(len(points))]
    course = make_course(waypoints(points, each, closed=closed), 1)
    time_s, step_s = part * course.period_s, 1e-4 * course.period_s
    before, here, after = (course.at(time_s + d, 6)[:, 0] for d in (-step_s, 0.0, step_s))
    unit = course.period_s ** np.arange(7.0)[:, None]  # as if the course took 1 s
    before, here, after = unit * before, unit * here, unit * after
    turned = np.angle(np.exp(1j * (after[0, 3] - before[0, 3])))
    assert turned / 2e-4 == pytest.approx(here[1, 3], abs=1e-3 * max(1.0, np.abs(here[:5, 3]).max()))
    slopes = (after[:4, :3] - before[:4, :3]) / 2e-4
    assert slopes == pytest.approx(here[1:5, :3], abs=1e-3 * np.abs(here[:7]).max())


def test_several_fly_it_one_after_the_other_where_that_keeps_them_apart():
    course = course_for_fleet(waypoints(), 3, Arena())
    assert len(course) == 3 and course_separation(course) > 0.75
    with pytest.raises(ValueError, match=" 2 vehicles .* 0.0. m "):
        make_course(waypoints(closed=False), 2)
    assert len(course_for_fleet(waypoints(), 12, Arena(8.0, 8.0))) == 12, "and more fly copies"


def test_faster_is_the_same_path():
    course = make_course(waypoints(each=[{"yaw_deg": yaw} for yaw in (0.0, 40.0, 10.0, -30.0)]), 2)
    fast = course.faster(2.5)
    assert fast.period_s == pytest.approx(course.period_s / 2.5)
    for time_s in (0.0, 1.1, 3.7):
        assert fast.at(time_s) == pytest.approx(course.at(2.5 * time_s) * 2.5 ** np.arange(5.0)[:, None, None])
        moved = on_course(fast, 1, 4.0).at(np.array([4.0 + time_s]))[:, 0]
        assert moved == pytest.approx(fast.at(time_s)[:, 1])


def test_a_file(tmp_path):
    path = tmp_path / "my.yaml"
    path.write_text(yaml.safe_dump({"name": "mine", "waypoints": [{"position_m": list(p)} for p in SQUARE]}))
    assert make_course(find_course(str(path)), 1).name == "mine"
    path.write_text(yaml.safe_dump({"waypoints": [{"position_m": list(p)} for p in SQUARE]}))
    assert make_course(find_course(str(path)), 1).name == "my"
    path.write_text("name: mine\nwaypoints:\n  - {position: [1, 2, 3]}\n")
    with pytest.raises(ValueError, match=r"my.yaml: waypoints\[0\]: .* position; .* position_m"):
        load_waypoints(path)
    with pytest.raises(ValueError, match="none.yaml"):
        find_course(str(tmp_path / "none.yaml"))


@pytest.mark.parametrize(
    ("points", "each", "fields", "message"),
    [
        (SQUARE[:1], None, {}, "2 to 200 waypoints, .* 1"),
        ([*SQUARE, (1.0, -1.01, 0.8)], None, {}, "waypoints 4 and 5 "),
        ([*SQUARE, SQUARE[0]], None, {}, "waypoints 5 and 1 .* first "),
        (SQUARE, [{"yaw_deg": 3.0}, {}, {}, {}], {}, "waypoint 2 .* yaw_deg"),
        (SQUARE, [{}, {}, {"time_s": 3.0}, {}], {}, "waypoint 1 .* time_s"),
        (
            SQUARE,
            [{"time_s": k + 1.0} for k in range(4)],
            {"period_s": 9.0},
            "time_s .* first .* 0, found 1",
        ),
        (SQUARE, [{"time_s": 1.0 * k} for k in range(4)], {}, "period_s is missing"),
        (SQUARE, [{"time_s": 1.0 * k} for k in range(4)], {"period_s": 3.0}, "period_s .* 3 s, found 3"),
        (
            SQUARE,
            [{"time_s": t} for t in (0.0, 2.0, 2.0, 5.0)],
            {"closed": False},
            "time_s of waypoint 3 ",
        ),
        (SQUARE, None, {"period_s": 3.0}, "period_s .* time_s"),
        (SQUARE, None, {"speed_m_s": 0.0}, "'speed_m_s'"),
        ([(0.0, math.nan, 1.0), *SQUARE], None, {}, "finite"),
        ([(0.0, 1.0), *SQUARE], None, {}, r"position_m"),
    ],
)
def test_wrong_files_say_why(points, each, fields, message):
    with pytest.raises(ValueError, match=message) as error:
        waypoints(points, each, **fields)
    assert "\n" not in str(error.value)


def test_an_open_course_may_end_where_it_begins():
    course = make_course(waypoints([*SQUARE, SQUARE[0]], closed=False), 1)
    assert course.at(0.5 * course.period_s)[0, 0, :3].tolist() == pytest.approx(SQUARE[0])
