"""Cutting polygons and lines at planes."""

import numpy as np
import pytest

from risc_simulator.video.clipping import clip_polygons, clip_segments

X_MIN, Y_MAX = (1.0, 0.0, 0.0, 0.0), (0.0, -1.0, 0.0, 1.0)  # x >= 0, y <= 1


def area(points):
    a = np.roll(points, -1, axis=0)
    return 0.5 * np.linalg.norm(np.cross(points, a).sum(axis=0))


def test_polygons_inside_outside_and_across():
    square = np.array([(0.0, 0.0, 2.0), (1.0, 0.0, 2.0), (1.0, 1.0, 2.0), (0.0, 1.0, 2.0)])
    polygons = [
        square + (1.0, -1.0, 0.0),
        square + (-5.0, 0.0, 0.0),
        square + (-0.25, 0.0, 0.0),
        square + (-0.5, 0.5, 0),
    ]
    points, counts = clip_polygons(np.concatenate(polygons), [4] * 4, np.array([X_MIN, Y_MAX]))
    assert counts.tolist()[:2] == [4, 0] and counts.sum() == len(points)
    parts = np.split(points, np.cumsum(counts)[:-1])
    assert np.array_equal(parts[0], polygons[0])
    assert area(parts[2]) == pytest.approx(0.75)
    assert area(parts[3]) == pytest.approx(0.25)
    assert (points[:, 0] >= 0.0).all() and (points[:, 1] <= 1.0).all()


def test_a_corner_cut_off_makes_a_pentagon():
    triangle = np.array([(-1.0, 0.0, 1.0), (3.0, 0.0, 1.0), (-1.0, 4.0, 1.0)])
    points, counts = clip_polygons(triangle, [3], np.array([X_MIN, Y_MAX]))
    assert counts.tolist() == [4]  # a trapezoid: x from 0 to 3 - y, y from 0 to 1
    assert area(points) == pytest.approx(2.5)


def test_random_polygons_against_sampling():
    rng = np.random.default_rng(2)
    planes = np.array([X_MIN, Y_MAX, (0.3, 0.8, 0.0, 0.5)])
    for _ in range(20):
        triangle = np.column_stack((rng.uniform(-2.0, 2.0, (3, 2)), np.ones(3)))
        points, counts = clip_polygons(triangle, [3], planes)
        weights = rng.dirichlet((1.0, 1.0, 1.0), 20000)
        samples = weights @ triangle
        kept = (samples @ planes[:, :3].T + planes[:, 3] >= 0.0).all(axis=1).mean()
        # 20000 samples: deviation of the share below 0.0036
        assert (area(points) if counts[0] else 0.0) / area(triangle) == pytest.approx(kept, abs=0.015)


def test_segments():
    ends = np.array(
        [
            [(1.0, 0.0, 0.0), (2.0, 0.0, 0.0)],
            [(-1.0, 0.0, 0.0), (1.0, 0.5, 0.0)],
            [(-1.0, 0.0, 0.0), (-2.0, 0.0, 0.0)],
            [(1.0, 3.0, 0.0), (1.0, -1.0, 0.0)],
        ]
    )
    before = ends.copy()
    kept = clip_segments(ends, np.array([X_MIN, Y_MAX]))
    assert np.array_equal(ends, before)
    assert np.allclose(
        kept,
        [
            [(1.0, 0.0, 0.0), (2.0, 0.0, 0.0)],
            [(0.0, 0.25, 0.0), (1.0, 0.5, 0.0)],
            [(1.0, 1.0, 0.0), (1.0, -1.0, 0.0)],
        ],
    )
