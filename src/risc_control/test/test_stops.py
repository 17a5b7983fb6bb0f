"""An IRIS+ that has to hold stops as soon as the fence assumes: perturbed plants, on a clock that tests advance."""

import math

import numpy as np
import pytest
from hover_desk import IRIS, TOGGLE, Desk, G, Iris, level_at

from risc_control import place_hold
from risc_control.fence import Fence
from risc_control.vehicle_pilot import VehicleNodeParams
from risc_control.vehicles import Command

SLOW_M_S = 0.05
OPEN = {"fence_min_m": (-9.0, -9.0, 0.0), "fence_max_m": (9.0, 9.0, 3.0), "controls_land_s": math.inf}


def along(speed_m_s):
    """A controller that flies north."""

    def fly(desk):
        own, level = desk.iris.own(), level_at(1.2)(desk)
        north, east = 2.0 * (speed_m_s - own.velocity_m_s[0]), 2.0 * own.velocity_m_s[1]
        sine, cosine = math.sin(own.psi_rad), math.cos(own.psi_rad)
        roll_rad, pitch_rad = (cosine * east - sine * north) / G, -(cosine * north + sine * east) / G
        return Command(roll_rad, pitch_rad, 0.0, level.thrust_n)

    return fly


def stop(seed, speed_m_s):
    """(speed, way, deceleration) of a vehicle whose controller falls silent: way from the command to hold until it is
    slow, deceleration between 80 and 20 % of its speed.
    """
    thrust, delay, bandwidth, roll, pitch = np.clip(np.random.default_rng(seed).standard_normal(5), -2.0, 2.0).tolist()
    iris = Iris(1.0 + 0.042 * thrust, 60.0, max(0.01, 0.05 + 0.02 * delay), 1.0 + 0.15 * bandwidth,
                (0.0052 * roll, 0.0052 * pitch))  # fmt: skip
    desk = Desk(iris, **OPEN).up()
    desk.fly = along(speed_m_s)
    desk.run(0.1)
    assert desk.press(TOGGLE).mode is True
    desk.run(2.5)
    desk.fly = None
    assert desk.run(0.3, lambda: desk.pilot.ladder.verdict.level > 0)
    speed_m_s, began_m, speeds_m_s = iris.velocity_m_s[0], iris.position_m[0], []
    assert desk.run(5.0, lambda: speeds_m_s.append(iris.velocity_m_s[0]) or speeds_m_s[-1] < SLOW_M_S)
    way_m, speeds_m_s = iris.position_m[0] - began_m, np.array(speeds_m_s)
    between = np.count_nonzero((speeds_m_s < 0.8 * speed_m_s) & (speeds_m_s > 0.2 * speed_m_s))
    return speed_m_s, way_m, 0.6 * speed_m_s / (0.005 * between)


@pytest.mark.parametrize(
    ("wanted_m_s", "least_m_s2"),
    [(0.5, place_hold.PLACE_M_S2), (1.0, place_hold.STOP_M_S2), (1.5, place_hold.STOP_M_S2)],
)
def test_it_stops_as_the_fence_counts_on(wanted_m_s, least_m_s2, monkeypatch):
    fence = Fence(VehicleNodeParams(**OPEN), IRIS)
    for seed in range(5):
        speed_m_s, way_m, slows_m_s2 = stop(seed, wanted_m_s)
        assert abs(speed_m_s - wanted_m_s) < 0.2
        assert way_m < fence.stop_m(0, speed_m_s) and slows_m_s2 > least_m_s2
    # the control arm: the place that is held slows down more slowly
    monkeypatch.setattr(place_hold, "STOP_M_S2", 0.4)
    speed_m_s, way_m, slows_m_s2 = stop(0, wanted_m_s)
    assert way_m > fence.stop_m(0, speed_m_s) and slows_m_s2 < place_hold.PLACE_M_S2
