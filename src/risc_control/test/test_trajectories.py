"""Courses: exact derivatives, the numbers of chapter 6, separation, the arena; transitions and yaw."""

import math
from dataclasses import replace

import numpy as np
import pytest

from risc_control.motions import blend, coasting, standing
from risc_control.reference_buffer import Axis, Order
from risc_control.trajectories import (
    COURSES,
    SAFE_SEPARATION_M,
    YawProgram,
    course_for_fleet,
    course_separation,
    figure,
    harmonics,
    make_course,
    minimum_separation,
    on_course,
    quadrant,
)
from risc_lab.lab import generated_fleet
from risc_lab.lab.arena import NET_HALF_X_M, NET_HALF_Y_M, Arena

MARGIN_M = 0.4


def sampled(course, count=500):
    return course.over_period(count, 4)[..., :3]


@pytest.mark.parametrize("name", sorted(COURSES))
@pytest.mark.parametrize("vehicles", [1, 3])
def test_every_derivative_is_the_central_difference_of_the_one_before(name, vehicles):
    course, step_s = make_course(name, vehicles), 1e-4
    for time_s in np.linspace(0.013, course.period_s - 0.017, 41):
        before, here, after = (course.at(time_s + d, 8) for d in (-step_s, 0.0, step_s))
        slopes = (after[:-1] - before[:-1]) / (2.0 * step_s)
        assert slopes[:4] == pytest.approx(here[1:5], abs=2e-5), time_s
        assert slopes[4:] == pytest.approx(here[5:], rel=1e-5, abs=1e-2), time_s
        assert course.at(time_s, 2) == pytest.approx(here[:3], abs=1e-14), "the same with less"


@pytest.mark.parametrize("name", ["circle", "flat8", "slanted8", "knot"])
def test_yaw_along_the_path_is_exact_and_points_forward(name):
    course, step_s = make_course(name, 2).with_yaw(YawProgram(along_path=True)), 1e-5
    for time_s in np.linspace(0.1, course.period_s, 37):
        derivatives = course.at(time_s, 6)
        yaw = derivatives[..., 3]
        nose = np.stack([np.cos(yaw[0]), -np.sin(yaw[0])], axis=1)  # cortex x, y at a clockwise yaw
        speed = np.linalg.norm(derivatives[1, :, :2], axis=1)
        assert (nose * derivatives[1, :, :2]).sum(axis=1) == pytest.approx(speed)
        before, after = (course.at(time_s + d, 6)[..., 3] for d in (-step_s, step_s))
        turned = np.angle(np.exp(1j * (after[0] - before[0])))
        assert turned / (2.0 * step_s) == pytest.approx(yaw[1], abs=1e-5)
        assert (after[1:-1] - before[1:-1]) / (2.0 * step_s) == pytest.approx(yaw[2:], rel=1e-6, abs=1e-4)


def test_circle_is_that_of_chapter_6():
    course = make_course("circle", 1)
    path = sampled(course)
    assert course.period_s == 8.0
    assert np.linalg.norm(path[:, 0, 0, :2], axis=1) == pytest.approx(0.8)
    assert np.all(path[:, 0, 0, 2] == 1.0)
    assert course.at(0.0)[0, 0, :3].tolist() == pytest.approx([0.8, 0.0, 1.0])
    assert course.at(2.0)[0, 0, :3].tolist() == pytest.approx([0.0, 0.8, 1.0])


@pytest.mark.parametrize(("name", "height", "slant"), [("flat8", 0.75, 0.0), ("slanted8", 1.0, 0.5)])
def test_eights_are_those_of_chapter_6(name, height, slant):
    course, w = make_course(name, 1), 2.0 * math.pi / 10.0
    assert course.period_s == 20.0
    for t in (0.0, 1.3, 7.7, 14.0):
        expected = [1.5 * math.cos(w * t / 2), 0.75 * math.sin(w * t), height + slant * math.sin(w * t)]
        assert course.at(t)[0, 0, :3].tolist() == pytest.approx(expected)


def test_knot_is_the_torus_form_with_the_chain_rule():
    """r = a + b cos(q th/p), z = n + b sin(q th/p): the original's numbers, derivatives with respect to time (D-34)."""
    course, w = make_course("knot", 1), 2.0 * math.pi / 10.0
    for t in (0.0, 2.2, 9.9, 17.0):
        th = w * t
        r = 0.65 + 0.25 * math.cos(1.5 * th)
        expected = [r * math.cos(th), r * math.sin(th), 1.0 + 0.25 * math.sin(1.5 * th)]
        assert course.at(t)[0, 0, :3].tolist() == pytest.approx(expected)


def test_circles3_keep_a_constant_distance_and_turn_slowly_enough():
    course = make_course("circles3", 3)
    path = sampled(course)
    for i, j in ((0, 1), (1, 2), (0, 2)):
        assert np.linalg.norm(path[:, 0, i] - path[:, 0, j], axis=1) == pytest.approx(math.sqrt(3.0) * 0.5)
    assert path[:, 0].mean(axis=0)[0] == pytest.approx([0.5, 0.0, 1.0], abs=1e-9)
    yaw_rates = course.over_period(400, Order.VELOCITY)[:, Order.VELOCITY, :, Axis.PSI]
    assert np.abs(yaw_rates).max() == pytest.approx(2.0 * math.pi / 24.0)
    assert np.diff(course.at(0.0)[0, :, 3]) == pytest.approx(2.0 * math.pi / 3.0)


@pytest.mark.parametrize("vehicles", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("name", ["circle", "circles3", "flat8", "slanted8", "origin"])
def test_vehicles_keep_apart_inside_the_net(name, vehicles):
    course = make_course(name, vehicles)
    assert course_separation(course) >= SAFE_SEPARATION_M
    path = sampled(course)
    furthest = np.abs(path[:, 0]).max(axis=(0, 1))
    assert furthest[0] < NET_HALF_X_M - MARGIN_M and furthest[1] < NET_HALF_Y_M - MARGIN_M
    assert path[:, 0, :, 2].min() > 0.4 and path[:, 0, :, 2].max() < 2.0


def extent(course):
    path = sampled(course, 200)
    return path[:, 0].min(axis=(0, 1)), path[:, 0].max(axis=(0, 1))


@pytest.mark.parametrize("vehicles", [6, 8, 14, 30, 50])
@pytest.mark.parametrize("name", ["circle", "circles3", "origin", "quadrants", "spin"])
def test_more_vehicles_fly_copies_of_the_figure_or_rows(name, vehicles):
    arena = generated_fleet(vehicles).arena
    course = course_for_fleet(name, vehicles, arena)
    assert len(course) == vehicles and course.name == name and course.period_s == make_course(name, 1).period_s
    assert course_separation(course, 400) >= SAFE_SEPARATION_M
    low, high = extent(course)
    assert np.abs([low, high]).max(axis=0)[0] <= arena.half_x_m - 0.7
    assert np.abs([low, high]).max(axis=0)[1] <= arena.half_y_m - 0.7
    assert low[2] >= 0.5 and high[2] <= 2.5


@pytest.mark.parametrize("name", ["flat8", "knot", "slanted8"])
def test_large_figures_need_a_larger_net_or_say_so(name):
    with pytest.raises(ValueError, match="'%s'.* 50 .*0.75 m" % name):
        course_for_fleet(name, 50, generated_fleet(14).arena)
    course = course_for_fleet(name, 50, Arena(10.0, 9.0))
    assert course_separation(course, 400) >= SAFE_SEPARATION_M


def test_copies_are_side_by_side_and_then_above_each_other():
    flat, high = (course_for_fleet("flat8", 10, arena) for arena in (Arena(4.0, 4.0), Arena(3.0, 2.0, 4.0)))
    assert np.ptp([corner[2] for corner in extent(flat)]) == 0.0
    assert extent(high)[1][0] == pytest.approx(1.5) and np.ptp([corner[2] for corner in extent(high)]) == 1.2
    turned = course_for_fleet("flat8", 10, Arena(4.0, 4.0)).with_yaw(YawProgram(0.4, along_path=True))
    for time_s in np.linspace(0.0, 20.0, 7):
        path = flat.at(time_s)
        assert path[1:, :5] == pytest.approx(path[1:, 5:]), "five and five, the same figure"
        velocity = path[1]
        assert np.exp(1j * (turned.at(time_s)[0, :, 3] - 0.4)) == pytest.approx(
            (velocity[:, 0] - 1j * velocity[:, 1]) / np.hypot(velocity[:, 0], velocity[:, 1])
        )


def test_up_to_five_fly_one_figure_whatever_the_net():
    for vehicles in (1, 3, 5):
        mine, plain = course_for_fleet("knot", vehicles, Arena(1.0, 1.0)), make_course("knot", vehicles)
        assert np.array_equal(mine.at(3.3), plain.at(3.3))
    with pytest.raises(ValueError, match="at most 4 vehicles"):
        course_for_fleet("quadrants", 5, Arena())
    with pytest.raises(ValueError, match=" radius;.* radius_m"):
        course_for_fleet("circle", 8, Arena(), radius=1.0)


def test_a_figure_that_brings_wide_vehicles_too_near_is_refused():
    for wider_m, vehicles, is_flown in ((0.15, 4, False), (0.15, 3, True), (0.3, 3, True), (0.4, 3, False)):
        if is_flown:
            assert np.array_equal(
                course_for_fleet("knot", vehicles, Arena(), wider_m).at(3.3), make_course("knot", vehicles).at(3.3)
            )
        else:
            need = "'knot' .* %d vehicles .* %.2f m" % (vehicles, 0.6 + wider_m)
            with pytest.raises(ValueError, match=need):
                course_for_fleet("knot", vehicles, Arena(), wider_m)
    assert len(course_for_fleet("knot", 4, Arena())) == 4, "AR.Drones fly it as ever"


@pytest.mark.parametrize(("name", "number"), [("circles3", "centre_m"), ("origin", "spacing_m"), ("spin", "spacing_m")])
def test_wide_vehicles_with_places_of_their_own_are_farther_apart(name, number):
    def apart_m(*wider_m, **options):
        return course_separation(course_for_fleet(name, 3, Arena(), *wider_m, **options), 400)

    assert apart_m(0.3) == pytest.approx(apart_m() + 0.3)
    assert apart_m(0.3, **{number: 1.1}) == apart_m(**{number: 1.1}), "but where the number is given"
    alone = course_for_fleet(name, 1, Arena(), 0.15)
    assert np.array_equal(alone.at(3.3), make_course(name, 1).at(3.3)), "one alone is where it ever was"


@pytest.mark.parametrize("name", ["circle", "circles3", "flat8"])
def test_many_wide_vehicles_are_kept_farther_apart_or_refused(name):
    course = course_for_fleet(name, 8, Arena(8.0, 8.0), 0.3)
    assert course_separation(course, 400) >= SAFE_SEPARATION_M + 0.3
    with pytest.raises(ValueError, match=" 8 vehicles, 1.05 m "):
        course_for_fleet(name, 8, Arena(1.6, 1.5, 2.0), 0.3)


def test_a_path_of_ones_own_is_a_function_of_the_phase(monkeypatch):
    """Of any smooth shape: any number of vehicles can fly it, and all its derivatives are known."""

    def clover(vehicles, size_m=1.2):
        def path(a):
            r = size_m * np.exp(0.3 * np.cos(4.0 * a) - 0.3)
            return r * np.cos(a), r * np.sin(a), 1.0 + 0.1 * np.sin(a)

        return figure("clover", vehicles, 15.0, path)

    monkeypatch.setitem(COURSES, "clover", clover)
    course = make_course("clover", 3, size_m=1.0)
    assert course_separation(course) > SAFE_SEPARATION_M and course.at(0.0)[0, 0, :3] == pytest.approx([1.0, 0.0, 1.0])
    before, here, after = (course.at(4.0 + d, 7) for d in (-1e-5, 0.0, 1e-5))
    assert (after[:-1] - before[:-1]) / 2e-5 == pytest.approx(here[1:], rel=1e-4, abs=1e-4)
    assert len(course_for_fleet("clover", 12, Arena(5.0, 5.0))) == 12
    with pytest.raises(ValueError, match="smooth"):
        harmonics(lambda a: (np.abs(a - 3.0), 0.0, 1.0), 8.0)


def test_separation_of_three_is_what_it_is():
    """Figures that the documentation may state."""
    figures = {name: round(course_separation(make_course(name, 3)), 2) for name in COURSES}
    assert figures == {
        "circle": 1.39,
        "circles3": 0.87,
        "flat8": 1.30,
        "knot": 0.94,
        "origin": 0.95,
        "quadrants": 1.06,
        "slanted8": 1.49,
        "spin": 0.95,
    }


def test_spin_stands_and_turns_once_in_30_s():
    course = make_course("spin", 1)
    for time_s in (0.0, 7.5, 21.0):
        derivatives = course.at(time_s)
        assert derivatives[:, 0, :3].tolist() == [[0.0, 0.0, 1.0]] + 4 * [[0.0, 0.0, 0.0]]
        assert derivatives[:3, 0, 3] == pytest.approx([2.0 * math.pi * time_s / 30.0, 2.0 * math.pi / 30.0, 0.0])


def test_half_a_period_apart_two_vehicles_would_meet_on_an_eight():
    course = make_course("flat8", 2)
    crossing = replace(course, paths=(on_course(course, 0, 0.0), on_course(course, 0, 10.0)))
    assert course_separation(crossing) < 0.01 < course_separation(course)


def test_quadrants_in_turn_with_a_rest_in_each():
    course = make_course("quadrants", 1)
    corners = [course.at(7.0 * k + 1.0)[:, 0, :3] for k in range(5)]
    assert [corner[0].tolist() for corner in corners] == [
        [0.75, 0.75, 1.0],
        [-0.75, 0.75, 1.0],
        [-0.75, -0.75, 1.0],
        [0.75, -0.75, 1.0],
        [0.75, 0.75, 1.0],
    ]
    assert all(np.all(corner[1:] == 0.0) for corner in corners)
    assert quadrant(3, 2).at(0.0)[0, :, :3].tolist() == [[-0.75, -0.75, 1.0], [0.75, -0.75, 1.0]]


def test_minimum_separation():
    positions = np.zeros((4, 3, 3))
    positions[:, 1, 0], positions[:, 2, 1] = 2.0, 3.0
    positions[2, 2] = [2.0, 0.0, 0.5]
    assert minimum_separation(positions) == pytest.approx(0.5)
    assert minimum_separation(positions[:, :1]) == math.inf


def test_reordering_swaps_whole_vehicles():
    for name in ("circles3", "quadrants", "knot"):
        course = make_course(name, 3)
        other = course.reordered([2, 0, 1])
        assert np.array_equal(other.at(3.3), course.at(3.3)[:, [2, 0, 1]])


@pytest.mark.parametrize(
    ("name", "vehicles", "options", "message"),
    [
        ("loop", 1, {}, "loop.*circle, circles3"),
        ("circle", 0, {}, "one vehicle"),
        ("quadrants", 5, {}, "at most 4 vehicles"),
        ("circle", 1, {"radius": 1.0}, " radius;.*height_m, period_s, radius_m"),
        ("circle", 1, {"radius_m": -1.0}, "'circle'.*'radius_m'"),
        ("circle", 1, {"period_s": math.nan}, "'period_s' .* finite"),
    ],
)
def test_wrong_courses_say_why(name, vehicles, options, message):
    with pytest.raises(ValueError, match=message):
        make_course(name, vehicles, **options)


def course_motion(name="knot", vehicle=1, epoch_s=3.0):
    return on_course(make_course(name, 3), vehicle, epoch_s)


def test_motions_are_what_they_say():
    times = np.array([10.0, 11.5])
    derivatives = standing(np.array([1.0, 2.0, 3.0]), 0.4).at(times)
    assert derivatives[0].tolist() == [[1.0, 2.0, 3.0, 0.4]] * 2 and np.all(derivatives[1:] == 0.0)
    derivatives = coasting(np.zeros(3), np.array([0.3, 0.0, 0.0]), 0.0, 10.0).at(np.array([10.0, 30.0]))
    assert derivatives[1, 0].tolist() == [0.3, 0.0, 0.0, 0.0]
    assert derivatives[:2, 1, 0] == pytest.approx([0.3, 0.0], abs=1e-6)
    course = make_course("knot", 3)
    derivatives = course_motion().at(times)
    for k, time_s in enumerate(times):
        assert derivatives[:, k] == pytest.approx(course.at(time_s - 3.0)[:, 1])


@pytest.mark.parametrize("smooth", [4, 6, 9])
@pytest.mark.parametrize("rise_m", [0.0, 0.6])
def test_blend_meets_both_motions_to_the_order_that_it_claims(smooth, rise_m):
    start, end = coasting(np.array([1.5, -1.0, 0.8]), np.array([0.2, 0.1, -0.1]), 0.3, 4.0), course_motion()
    end = end.with_fields(smooth=smooth)
    for duration_s in (6.0, 12.0):
        way = blend(start, end, 5.0, duration_s, rise_m)
        inside_s = 1e-12  # just after its beginning and before its end
        for time_s, motion in ((5.0 + inside_s, start), (5.0 + duration_s - inside_s, end)):
            found, expected = (m.at(np.array([time_s]), smooth + 1)[:, 0] for m in (way, motion))
            assert found[: smooth + 1, :3] == pytest.approx(expected[: smooth + 1, :3], abs=1e-3)
            assert found[:3, :3] == pytest.approx(expected[:3, :3], abs=1e-12)
            assert np.abs(found[smooth + 1, :3] - expected[smooth + 1, :3]).max() > 0.01, "and no further"
            assert np.exp(1j * found[0, 3]) == pytest.approx(np.exp(1j * expected[0, 3]))
            assert found[1:3, 3] == pytest.approx(expected[1:3, 3], abs=1e-6)


def test_blend_derivatives_are_central_differences():
    step_s = 1e-5
    for smooth in (4, 7):
        way = blend(course_motion("circle", 0), course_motion("slanted8", 2).with_fields(smooth=smooth), 5.0, 3.0)
        for time_s in (4.0, 5.4, 6.5, 7.9, 9.0):
            derivatives = way.at(np.array([time_s - step_s, time_s, time_s + step_s]), 2 * smooth + 1)
            slopes = (derivatives[:-1, 2] - derivatives[:-1, 0]) / (2.0 * step_s)
            assert slopes == pytest.approx(derivatives[1:, 1], rel=1e-5, abs=1e-4)


def test_blend_stays_between_its_motions():
    """A polynomial between two states of motion does not: it may swing out of the net."""
    start, end = course_motion("flat8", 0), course_motion("slanted8", 1)
    times = np.linspace(5.0, 8.0, 200)
    path, first, last = (motion.at(times)[0, :, :3] for motion in (blend(start, end, 5.0, 3.0), start, end))
    assert np.all(path <= np.maximum(first, last) + 1e-12) and np.all(path >= np.minimum(first, last) - 1e-12)


def test_blend_turns_the_short_way():
    place = np.zeros(3)
    way = blend(standing(place, 3.0), standing(place, -3.0), 0.0, 4.0)
    yaws = way.at(np.array([1.0, 3.0, 3.9999, 4.0, 9.0]))[0, :, 3]
    assert yaws[:3] == pytest.approx([3.03, 3.25, 2.0 * math.pi - 3.0], abs=0.01)
    assert yaws[3:] == pytest.approx([-3.0, -3.0]), "from its end on it is the end"
    with pytest.raises(ValueError, match="time > 0"):
        blend(standing(place, 0.0), standing(place, 0.0), 0.0, 0.0)


def test_a_blend_between_two_places_is_the_minimum_snap_way():
    way = blend(standing(np.zeros(3), 0.0), standing(np.ones(3), 0.0), 0.0, 1.0)
    step = way.at(np.array([-1.0, 0.0, 0.5, 1.0, 2.0]))[:, :, 0]
    assert step[0] == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0])
    assert step[1:, [0, 1, 3, 4]] == pytest.approx(np.zeros((4, 4)), abs=1e-9)
    s = 0.3  # 126 s^5 - 420 s^6 + 540 s^7 - 315 s^8 + 70 s^9
    expected = 126 * s**5 - 420 * s**6 + 540 * s**7 - 315 * s**8 + 70 * s**9
    assert way.at(np.array([s]))[0, 0, 2] == pytest.approx(expected)
