"""Minimum-snap paths: through their points, continuous to the sixth derivative, with the least possible snap."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.polynomial.polynomial import polyder, polyval

from risc_control import minimum_snap
from risc_control.minimum_snap import best_durations, greatest_speed, pieces, reversed_pieces


@st.composite
def ways(draw):
    """(points (n, 3), durations, closed); neighbouring points are distinct."""
    closed, n = draw(st.booleans()), draw(st.integers(2, 7))
    points = draw(arrays(float, (n, 3), elements=st.floats(-3.0, 3.0))) + 10.0 * np.arange(n)[:, None]
    durations = draw(arrays(float, n if closed else n - 1, elements=st.floats(0.3, 5.0)))
    return points, durations, closed


def ends(coefficients, durations, order):
    """(m, c) derivatives at the beginnings of pieces, and at their ends."""
    slopes = [polyder(piece, order) if order else piece for piece in coefficients]
    scales = np.asarray(durations)[:, None] ** order
    return tuple(np.array([polyval(u, slope) for slope in slopes]) / scales for u in (0.0, 1.0))


def snap(coefficients, durations):
    """Integral of the squared snap, by Gauss' rule, which is exact here."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    total = 0.0
    for piece, duration in zip(coefficients, durations):
        values = polyval(0.5 * (nodes + 1.0), polyder(piece, 4)) / duration**4
        total += 0.5 * duration * float((weights * (values**2).sum(axis=0)).sum())
    return total


@settings(max_examples=60, deadline=None)
@given(ways())
def test_it_leads_through_the_points_and_is_continuous_to_the_sixth_derivative(way):
    points, durations, closed = way
    coefficients = pieces(points, durations, closed)
    for order in range(7):
        begins, finals = ends(coefficients, durations, order)
        following = np.roll(begins, -1, axis=0)
        size = 1e-6 * np.ptp(points) / durations.min() ** order  # rounding
        if not closed:
            following, finals = following[:-1], finals[:-1]
        assert finals == pytest.approx(following, abs=size), order
        if order == 0:
            assert begins == pytest.approx(points[: len(begins)], abs=1e-9)
    if not closed:
        for order in (1, 2, 3):
            begins, finals = ends(coefficients, durations, order)
            assert np.abs([begins[0], finals[-1]]).max() < 1e-6 * np.ptp(points) / durations.min() ** order


@settings(max_examples=30, deadline=None)
@given(ways(), st.integers(0, 2**32 - 1))
def test_other_derivatives_at_the_points_make_more_snap(way, seed):
    points, durations, closed = way
    own = minimum_snap._end_values(points, durations, closed)
    least = snap(pieces(points, durations, closed), durations)
    change = np.random.default_rng(seed).normal(size=(len(points), 4, 3)) * np.array([0.0, 0.1, 0.1, 0.1])[:, None]
    if not closed:
        change[0] = change[-1] = 0.0
    changed = own + np.concatenate([change[: len(own)], np.roll(change, -1, axis=0)[: len(own)]], axis=1)
    scaled = minimum_snap._scales(durations)[..., None] * changed
    other = np.einsum("ke,mec->mkc", minimum_snap._BASIS, scaled)
    assert snap(other, durations) >= least * (1.0 - 1e-9)


def test_between_two_places_it_is_the_known_polynomial():
    step = pieces(np.array([[0.0], [1.0]]), np.array([2.0]), False)[0, :, 0]
    assert step == pytest.approx([0, 0, 0, 0, 35, -84, 70, -20], abs=1e-9)


@pytest.mark.parametrize("closed", [True, False])
def test_gradient_of_the_times_is_the_central_difference(closed):
    rng = np.random.default_rng(4)
    points = rng.normal(size=(6, 3))
    logarithms = np.log(rng.uniform(0.5, 2.0, 6 if closed else 5))
    gradient = minimum_snap._cost(logarithms, points, closed)[1]
    for i in range(len(logarithms)):
        step = 1e-6 * np.eye(len(logarithms))[i]
        after, before = (minimum_snap._cost(logarithms + sign * step, points, closed)[0] for sign in (1, -1))
        assert (after - before) / 2e-6 == pytest.approx(gradient[i], abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(ways())
def test_chosen_times_need_less_snap_than_a_steady_speed(way):
    points, _, closed = way
    others = np.roll(points, -1, axis=0) if closed else points[1:]
    steady = np.linalg.norm(others - points[: len(others)], axis=1)
    chosen = best_durations(points, closed)
    assert chosen.sum() == pytest.approx(1.0) and (chosen > 0.0).all()
    least, other = (snap(pieces(points, d, closed), d) for d in (chosen, steady / steady.sum()))
    assert least <= other * (1.0 + 1e-9)


def test_the_way_back_is_the_same_way():
    points, durations = np.random.default_rng(2).normal(size=(4, 3)), np.array([1.0, 2.0, 0.5])
    there = pieces(points, durations, False)
    back = reversed_pieces(there)
    for u in (0.0, 0.3, 1.0):
        there_m = np.array([polyval(1.0 - u, piece) for piece in there[::-1]])
        assert np.array([polyval(u, piece) for piece in back]) == pytest.approx(there_m)
    assert greatest_speed(back, durations[::-1]) == pytest.approx(greatest_speed(there, durations))
