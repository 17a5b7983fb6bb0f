"""Pursuit of a virtual target: the law, and what the controller adds to it. Closed loop: risc_experiments' tests."""

import math

import numpy as np
import pytest

from risc_control.controllers import ControlLoop, differential_flatness, guidance
from risc_control.controllers.guidance import pursuit_acceleration
from risc_control.pursuit_reference import TargetParams
from risc_lab.lab import load_vehicle_type
from risc_lab.states import S, States

ARDRONE = load_vehicle_type("ardrone")
PARAMS = guidance.Params()
RADIUS_M, SPEED_M_S = 0.8, 0.2
DT_S = 0.005


def states(visible=True, x=0.0, y=0.0):
    """States of a vehicle at rest there; one that is not visible has a row of zeros, as from states_from_msg."""
    rows = np.zeros((1, len(S)))
    rows[0, :3] = np.array([x, y, 1.0]) * visible
    return States(np.array([visible]), rows)


def standing(x=0.0, y=0.0):
    reference = np.zeros((5, 1, 4))
    reference[0] = x, y, 1.0, 0.0
    return reference


def update(controller, state, reference, stamp_s=0.0):
    everyone = np.ones(1, dtype=bool)
    return controller.update(stamp_s, stamp_s + 0.004, state, reference, reference, everyone, everyone)


def pursue(position, velocity, target):
    return pursuit_acceleration(*map(complex, (position, velocity, target)), SPEED_M_S, PARAMS)


def point(controller):
    """Where the law's point is, north + i east."""
    return controller.controller._points[0].position_m


@pytest.mark.parametrize("turn", [1.0, -1.0])
def test_behind_a_target_on_a_circle_it_stays_on_that_circle(turn):
    """R* behind on the same circle, at the target's speed: the acceleration is the centripetal one, nothing else."""
    ahead = 2.0 * math.asin(0.5 * PARAMS.range_m / RADIUS_M)  # angle at the centre of a chord of length R*
    for angle in (0.0, 1.0, 4.0):
        place = RADIUS_M * np.exp(1j * angle)
        velocity = turn * 1j * SPEED_M_S * np.exp(1j * angle)
        target = RADIUS_M * np.exp(1j * (angle + turn * ahead))
        assert pursue(place, velocity, target) == pytest.approx(-(SPEED_M_S**2) / RADIUS_M * np.exp(1j * angle))


def test_it_turns_towards_the_target_and_keeps_its_range():
    v = 0.2 + 0j
    straight = pursue(0, v, PARAMS.range_m)
    assert straight == pytest.approx(0.0), "nothing to correct"
    assert pursue(0, v, 0.5j).imag == pytest.approx(2.0 * 0.2**2 / PARAMS.range_m), "abeam: 2 V^2 / R*"
    assert pursue(0, v, -0.5j).imag == pytest.approx(-2.0 * 0.2**2 / PARAMS.range_m)
    assert pursue(0, v, -0.5 + 0.01j).imag == pytest.approx(2.0 * 0.2**2 / PARAMS.range_m), "behind: as hard as abeam"
    assert pursue(0, v, -0.5).imag != 0.0, "straight behind: any side, but not on"
    assert pursue(0, v, 1.0).real > 0.0 > pursue(0, v, 0.2).real
    assert pursue(0, 0, 0.7j) == pytest.approx(1j * abs(pursue(0, 0, 0.7j))), "from rest it sets out for the target"
    assert np.isfinite(pursue(0, 0, 0)) and np.isfinite(pursue(0.3, 0, 0.3))
    assert abs(pursue(0, 0, 50.0)) <= PARAMS.speed_gain_1_s * PARAMS.speed_max_m_s + 1e-12


def test_turning_the_scene_turns_the_answer():
    scene = np.array([0.3 + 0.1j, 0.1 - 0.2j, -0.4 + 0.6j])
    for angle in (0.7, 2.0, -2.5):
        turn = np.exp(1j * angle)
        assert pursue(*(turn * scene)) == pytest.approx(turn * pursue(*scene))


def test_a_target_that_stands_is_flown_to_like_any_reference():
    pursuer, tracker = (
        ControlLoop(guidance.Controller, [ARDRONE]),
        ControlLoop(differential_flatness.Controller, [ARDRONE]),
    )
    outputs = [update(controller, states(), standing(0.1, 0.2)) for controller in (pursuer, tracker)]
    assert np.array(outputs[0].controls).tolist() == np.array(outputs[1].controls).tolist()
    assert pursuer.controller.range_m[0] == pytest.approx(math.hypot(0.1, 0.2))
    update(pursuer, states(visible=False), standing(), stamp_s=0.1)
    assert np.isnan(pursuer.controller.range_m[0])


def test_the_pursuit_begins_where_the_vehicle_is_and_moves_on_with_the_law():
    """The point runs away from a vehicle that never moves, and is back at it once it is not flown autonomously."""
    controller = ControlLoop(guidance.Controller, [ARDRONE])
    controller.controller.target_speed_m_s = SPEED_M_S
    update(controller, states(), standing(y=-0.7))
    assert point(controller) == 0.0
    for k in range(1, 200):
        update(controller, states(), standing(y=-0.7), k * DT_S)
    assert point(controller).imag > 0.05 and abs(point(controller).real) < 1e-9, "east is - y"
    assert controller.controller.range_m[0] == pytest.approx(0.7), "of the vehicle, not of the point"
    one = np.ones(1, dtype=bool)
    controller.update(1.0, 1.004, states(), standing(y=-0.7), standing(y=-0.7), one, ~one)
    assert point(controller) == 0.0
    for k in range(201, 300):
        update(controller, states(), standing(y=-0.7), k * DT_S)
    update(controller, states(), standing(y=-0.7), 5.0)
    assert point(controller) == 0.0, "a gap in the states"


def test_a_vehicle_out_of_sight_has_no_place_its_point_runs_on():
    """A vehicle at (0.8, 0.3), whose row reads (0, 0) while it is not seen."""

    def points(seen, gap_s=DT_S):
        controller = ControlLoop(guidance.Controller, [ARDRONE])
        controller.controller.target_speed_m_s = SPEED_M_S
        stamp_s, found = 0.0, []
        for k, visible in enumerate(seen):
            stamp_s += gap_s if k and not seen[k - 1] else DT_S
            update(controller, states(visible, 0.8, 0.3), standing(0.8, -0.18), stamp_s)
            found.append(point(controller))
        return np.array(found)

    all_seen = points([True] * 40)
    for lost in ([5], [5, 7, 9], [0], [5, 6, 7, 8, 9]):
        some_seen = points([k not in lost for k in range(40)])
        seen = np.array([k for k in range(40) if k not in lost])
        assert np.abs(some_seen[seen] - all_seen[seen]).max() < 1e-3
        if 0 not in lost:
            assert np.abs(some_seen - all_seen).max() < 1e-12, "the law needs the target only"
    long = [True] * 10 + [False] * 30 + [True]
    assert points(long)[-1] == 0.8 - 0.3j, "0.15 s: anew"
    assert points([True] * 10 + [False, True], gap_s=0.2)[-1] == 0.8 - 0.3j


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: guidance.Params(range_m=0.0), "range_m"),
        (lambda: guidance.Params(speed_gain_1_s=math.nan), "speed_gain_1_s"),
        (lambda: TargetParams(radius_m=-1.0), "radius_m"),
    ],
)
def test_wrong_settings_say_why(make, message):
    with pytest.raises(ValueError, match=message):
        make()
