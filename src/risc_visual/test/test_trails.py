"""Paths in pieces: complete, bounded, stable ids, little to send."""

import math

import pytest

from risc_visual.drawing.params import PathParams
from risc_visual.drawing.trails import MAX_PIECES, PIECE_POINTS, Trail

TURNS = 25


def circle(t_s):
    angle = 2.0 * math.pi * t_s / 8.0
    return (0.8 * math.cos(angle), 0.8 * math.sin(angle), 1.0)


def fly(trail, seconds, rate_hz=25.0, path=circle, start_s=100.0):
    """Like rviz: keeps the newest shape of every slot. Returns (shapes, points sent per turn)."""
    shapes, sent = {}, []
    for k in range(int(seconds * rate_hz) + 1):
        now_s = start_s + k / rate_hz
        trail.add(now_s, path(k / rate_hz))
        pieces = trail.to_send(now_s, k, TURNS)
        sent.append(sum(len(points) for _, points, _ in pieces))
        shapes.update({slot: points for slot, points, _ in pieces})
    return shapes, sent


def length_m(shapes):
    return sum(math.dist(a, b) for points in shapes.values() for a, b in zip(points, points[1:]))


def test_what_was_sent_is_the_whole_path_without_a_gap():
    shapes, _ = fly(Trail(40.0, PathParams()), seconds=10.0)
    assert length_m(shapes) == pytest.approx(2 * math.pi * 0.8 * 10 / 8, rel=2e-3)
    ordered = [shapes[slot] for slot in sorted(shapes)]
    for piece, following in zip(ordered, ordered[1:]):
        assert piece[-1] == following[0]
    assert ordered[-1][-1] == circle(10.0)


def test_sending_costs_little_however_long_the_path():
    _, sent = fly(Trail(40.0, PathParams()), seconds=40.0)
    whole = 40 * 0.63 / 0.02
    assert max(sent) < 0.15 * whole
    assert sum(sent[-TURNS:]) / TURNS < 0.06 * whole


def test_every_piece_is_sent_once_a_round():
    trail = Trail(40.0, PathParams())
    shapes, _ = fly(trail, seconds=20.0)
    now_s = 120.0
    again = {slot for turn in range(TURNS) for slot, _, _ in trail.to_send(now_s, turn, TURNS)}
    assert again == set(shapes)


def test_old_pieces_are_forgotten_and_age_is_a_fraction():
    trail = Trail(5.0, PathParams())
    fly(trail, seconds=20.0)
    pieces = trail.to_send(120.0, 0, 1)
    ages = [age for _, _, age in pieces]
    assert ages == sorted(ages, reverse=True)
    assert 0.8 < ages[0] <= 1.0 and ages[-1] == 0.0
    assert trail.to_send(130.0, 0, 1) == []  # nothing came for longer than the path's duration


def test_slots_are_bounded_and_kept():
    trail = Trail(1e6, PathParams())
    fly(trail, seconds=200.0)
    slots = [slot for slot, _, _ in trail.to_send(300.0, 0, 1)]
    assert len(slots) == len(set(slots)) == MAX_PIECES
    assert set(slots) == set(range(MAX_PIECES))
    assert all(len(points) <= PIECE_POINTS + 1 for _, points, _ in trail.to_send(300.0, 0, 1))


def test_hovering_adds_no_points():
    shapes, _ = fly(Trail(40.0, PathParams()), 10.0, path=lambda t: (0.001 * math.sin(t), 0.0, 1.0))
    assert sum(len(points) for points in shapes.values()) == 2


@pytest.mark.parametrize("gap_s, jump_m", [(1.0, 0.0), (0.04, 0.8)])
def test_gap_and_jump_break_the_line(gap_s, jump_m):
    trail = Trail(40.0, PathParams())
    for k in range(10):
        trail.add(0.04 * k, (0.03 * k, 0.0, 1.0))
    for k in range(10):
        trail.add(0.36 + gap_s + 0.04 * k, (0.27 + 0.03 * k, jump_m, 1.0))
    first, second = (points for _, points, _ in trail.to_send(1.0, 0, 1))
    assert first[-1] == (0.27, 0.0, 1.0)
    assert second[0] == (0.27, jump_m, 1.0)


def test_bag_that_starts_again_starts_the_path_again():
    trail = Trail(40.0, PathParams())
    fly(trail, 5.0, start_s=100.0)
    fly(trail, 0.1, start_s=50.0)
    pieces = trail.to_send(50.1, 0, 1)
    assert len(pieces) == 1 and pieces[0][1][0] == circle(0.0)
