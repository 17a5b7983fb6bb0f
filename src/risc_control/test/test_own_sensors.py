"""An IRIS+ that is no longer seen keeps its place by what was learnt before and by its reports of tilt and height.

A simulated vehicle with its node, on a clock that the test advances: perturbed plants, noise, reports that are late.
"""

import math

import numpy as np
import pytest
from hover_desk import TOGGLE, Desk, Iris, Sensors, circling, flown, level_at

WITHIN_S = 2.0
SEEDS = range(6)


def drift_m(seed, happens, reports, params):
    """(horizontal, vertical) drift [m] of a vehicle within 2 s after its loss on a circle."""
    rng = np.random.default_rng(1000 + seed)
    thrust, delay, bandwidth, roll, pitch, late = np.clip(rng.standard_normal(6), -2.0, 2.0).tolist()
    iris = Iris(
        more=1.0 + 0.042 * thrust,
        delay_s=max(0.01, 0.05 + 0.02 * delay),
        quicker=1.0 + 0.15 * bandwidth,
        level_rad=(0.0052 * roll, 0.0052 * pitch),
    )
    desk = Desk(iris, state_land_s=math.inf, **params)
    desk.sensors = Sensors(seed, 0.08 + 0.02 * late) if reports else None
    desk.seen = lambda own: own._replace(velocity_m_s=tuple(own.velocity_m_s + 0.01 * rng.standard_normal(3)))
    desk.up().fly = circling
    desk.run(0.1)
    assert desk.press(TOGGLE).mode is True
    desk.run(rng.uniform(6.0, 8.0))
    desk.alive.discard("state")
    happens(desk)
    desk.run(0.1)
    places_m = [list(iris.position_m)]
    desk.run(WITHIN_S, lambda: places_m.append(list(iris.position_m)))
    went_m = np.array(places_m) - places_m[0]
    return np.hypot(*went_m[:, :2].T).max(), np.abs(went_m[:, 2]).max()


def drifts_m(happens=lambda desk: None, reports=True, **params):
    """((n,) horizontal, (n,) vertical) drift [m] of a vehicle for each seed.

    happens: called with the desk at the loss.  reports: False: no reports of tilt and height.
    """
    return np.array([drift_m(seed, happens, reports, params) for seed in SEEDS]).T


def test_what_it_learnt_of_its_level_keeps_it_in_its_place():
    level_m, up_m = drifts_m()
    assert np.median(level_m) < 0.14 and level_m.max() < 0.2 and up_m.max() < 0.12
    # the control arm: the model alone, whose level is right
    alone_m, _ = drifts_m(hold_corrects=False)
    assert np.median(alone_m) > 1.3 * np.median(level_m) and alone_m.max() > 0.2


def tips(desk):
    desk.iris.trim_rad = 0.010, -0.007


def test_a_tilt_that_nobody_commanded_counts():
    level_m, _ = drifts_m(tips)
    silent_m, _ = drifts_m(tips, reports=False)  # the control arm
    assert np.median(level_m) < 0.3 and np.median(silent_m) > 1.15 * np.median(level_m)


def sags(desk):
    desk.iris.more *= 0.95


def test_a_thrust_that_changes_is_seen_by_its_height():
    _, up_m = drifts_m(sags)
    _, silent_m = drifts_m(sags, reports=False)  # the control arm
    assert up_m.max() < 0.55 < silent_m.min()


def are_late(desk):
    desk.sensors.late_s += 0.3


def are_stuck(desk):
    desk.sensors.stuck = True


def are_not_numbers(desk):
    tells = desk.sensors.heard
    odd = {"tilt_rad": (math.nan, 0.0), "height_m": math.inf, "climb_m_s": math.nan}
    desk.sensors.heard = lambda *arguments: [status._replace(**odd) for status in tells(*arguments)]


@pytest.fixture(scope="module")
def none_m():
    return drifts_m(reports=False)


@pytest.mark.parametrize(
    "happens", [are_late, *(pytest.param(other, marks=pytest.mark.release) for other in (are_stuck, are_not_numbers))]
)
def test_reports_of_no_use_do_no_harm(happens, none_m):
    useless_m = drifts_m(happens)
    assert (np.median(useless_m, axis=1) < np.median(none_m, axis=1) + 0.01).all()
    assert (useless_m < none_m + 0.04).all()


def test_without_states_and_telemetry_it_is_commanded_until_it_is_down():
    """From a height that a controller has brought it to."""
    desk = flown(more=1.0)
    desk.fly = level_at(1.6)
    desk.run(4.0)
    desk.alive -= {"state", "telemetry"}
    assert desk.run(8.0, lambda: desk.iris.stands) and desk.iris.mode == "STABILIZE", "the autopilot does not land it"
    assert desk.iris.impact_m_s < 0.6
