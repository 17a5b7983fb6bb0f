"""A vehicle that is not seen any more holds its place: whole flights offline, of every kind, on perturbed plants."""

import numpy as np
import pytest

from risc_experiments.hold_drift import MOVING, drift, flight
from risc_experiments.offline import fly_all
from risc_simulator.faults import parse_fault

MOST_M = 0.3  # the requirement: within 2 s, the median over seeds


def farthest_m(type_name, courses, seeds, **options):
    """Greatest drift [m], median over flights."""
    flights = [flight(type_name, course, seed, **options) for course in courses for seed in seeds]
    return np.median([drift(result).farthest_m for result in fly_all(flights)])


@pytest.mark.parametrize("type_name", ["ardrone", "iris"])
def test_it_stops_where_it_is(type_name):
    several = type_name, ("circle", "knot"), (1,)
    assert farthest_m(*several) < MOST_M
    # the control arm: level attitude, and only what the vehicle does by itself
    assert farthest_m(*several, node={"hold_brakes": False}) > MOST_M


def test_a_floor_without_texture():
    """The error of its level, 0.3 degrees, is not observed: 0.1 m more in 2 s."""
    several, bare = ("ardrone", ("circle",), (1, 2)), (parse_fault("bare_floor:inf"),)
    assert farthest_m(*several, faults=bare, node={"hold_auto_hover": False}) < MOST_M + 0.1
    # the control arm: it believes that its bottom camera sees
    assert farthest_m(*several, faults=bare, node={"hold_brakes": False}) > 2.0 * MOST_M


@pytest.mark.release
@pytest.mark.parametrize("gusts", [False, True])
@pytest.mark.parametrize("type_name", ["ardrone", "iris"])
def test_it_stops_on_every_course(type_name, gusts):
    assert farthest_m(type_name, MOVING, range(1, 21), gusts=gusts) < MOST_M
