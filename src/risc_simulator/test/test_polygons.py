"""Polygons: cutting them and lines at planes; exact areas in pixels, at every place, in every order of the corners."""

import numpy as np
import pytest

from risc_simulator.video import polygons
from risc_simulator.video.polygons import clip_polygons, coverage

BOX = (0, 0, 8, 6)


def cover(polygons, box=BOX, weight=1.0):
    return coverage([np.asarray(polygon, dtype=float) for polygon in polygons], box, weight)


def square(x0, y0, x1, y1):
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]


def shoelace(points):
    x, y = points.T
    return 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def centroid(points):
    x, y = (points - points.mean(axis=0)).T
    x1, y1 = np.roll(x, -1), np.roll(y, -1)
    cross = x * y1 - x1 * y
    return points.mean(axis=0) + np.array([((x + x1) * cross).sum(), ((y + y1) * cross).sum()]) / (3.0 * cross.sum())


def test_pixel_centres_are_whole_numbers():
    mask = cover([square(1.5, 0.5, 3.5, 1.5)])  # pixels 2 and 3 of row 1, exactly
    expected = np.zeros((6, 8))
    expected[1, 2:4] = 1.0
    assert np.allclose(mask, expected, rtol=0.0, atol=1e-8)


def test_parts_of_pixels():
    mask = cover([square(1.75, 0.75, 3.25, 1.25)])  # half a pixel high; three quarters of columns 2 and 3
    assert np.allclose(mask[1, 1:5], [0.0, 0.375, 0.375, 0.0])
    assert mask.sum() == pytest.approx(0.75)


def test_half_a_pixel_under_a_diagonal():
    mask = cover([[(-0.5, -0.5), (5.5, 5.5), (-0.5, 5.5)]])
    assert np.allclose(np.diag(mask[:, :6]), 0.5)
    assert np.allclose(mask[:, :6], np.tril(np.ones((6, 6)), -1) + 0.5 * np.eye(6))


def test_sense_of_rotation_does_not_matter():
    corners = np.array([(1.2, 0.3), (6.1, 2.2), (3.0, 4.4)])
    assert np.allclose(cover([corners]), cover([corners[::-1]]), atol=1e-6)


def test_random_polygons_have_their_area_and_centroid():
    rng = np.random.default_rng(0)
    box = (-40, 7, 90, 140)
    for _ in range(50):
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 40)))
        if np.diff(np.append(angles, angles[0] + 2.0 * np.pi)).max() > 3.0:
            continue  # the centre would lie outside, and edges would cross
        radius = rng.uniform(3.0, 45.0)
        points = np.stack((np.cos(angles), np.sin(angles)), axis=1) * rng.uniform(0.5, 1.0, (len(angles), 1)) * radius
        points += rng.uniform((10.0, 60.0), (30.0, 80.0))
        mask = cover([points], box)
        assert mask.sum() == pytest.approx(shoelace(points), abs=1e-3)
        rows, columns = np.mgrid[box[1] : box[3], box[0] : box[2]]
        middle = np.array([(columns * mask).sum(), (rows * mask).sum()]) / mask.sum()
        assert np.allclose(middle, centroid(points), atol=0.02)  # a pixel's share counts as if at its centre


def test_what_is_beyond_the_box_changes_nothing_in_it():
    rng = np.random.default_rng(1)
    for _ in range(30):
        points = rng.uniform(-15.0, 22.0, (3, 2))
        large = cover([points], (-20, -20, 30, 30))
        assert np.allclose(cover([points]), large[20:26, 20:28], atol=1e-5)


def test_many_polygons_add_up_by_their_weights():
    mask = cover([square(0.5, 0.5, 2.5, 1.5), square(1.5, 0.5, 3.5, 1.5)], weight=0.5)
    assert np.allclose(mask[1, :5], [0.0, 0.5, 1.0, 0.5, 0.0])


def test_no_polygon():
    mask = coverage([], (0, 0, 3, 2))
    assert mask.shape == (2, 3) and not mask.any()


def test_long_edges():
    mask = cover([square(-0.5, -0.5, 29999.5, 0.5)], (29990, 0, 30010, 2))
    assert np.allclose(mask[0], [1.0] * 10 + [0.0] * 10) and not mask[1].any()


def test_the_plain_function_gives_what_the_compiled_one_does(monkeypatch):
    rng = np.random.default_rng(3)
    shapes = [square(1.75, 0.75, 3.25, 1.25), *rng.uniform(-3.0, 9.0, (5, 3, 2))]  # the first has level edges
    compiled = [cover([shape]) for shape in shapes]
    monkeypatch.setattr(polygons, "_cover", getattr(polygons._cover, "py_func", polygons._cover))
    assert np.allclose([cover([shape]) for shape in shapes], compiled, rtol=0.0, atol=1e-6)


X_MIN, Y_MAX = (1.0, 0.0, 0.0, 0.0), (0.0, -1.0, 0.0, 1.0)  # x >= 0, y <= 1


def area_m2(points):
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
    points, counts = clip_polygons(np.concatenate(polygons), np.array([4] * 4), np.array([X_MIN, Y_MAX]))
    assert counts.tolist()[:2] == [4, 0] and counts.sum() == len(points)
    parts = np.split(points, np.cumsum(counts)[:-1])
    assert np.array_equal(parts[0], polygons[0])
    assert area_m2(parts[2]) == pytest.approx(0.75)
    assert area_m2(parts[3]) == pytest.approx(0.25)
    assert (points[:, 0] >= 0.0).all() and (points[:, 1] <= 1.0).all()


def test_a_corner_cut_off_makes_a_pentagon():
    triangle = np.array([(-1.0, 0.0, 1.0), (3.0, 0.0, 1.0), (-1.0, 4.0, 1.0)])
    points, counts = clip_polygons(triangle, np.array([3]), np.array([X_MIN, Y_MAX]))
    assert counts.tolist() == [4]  # a trapezoid: x from 0 to 3 - y, y from 0 to 1
    assert area_m2(points) == pytest.approx(2.5)


def test_random_polygons_against_sampling():
    rng = np.random.default_rng(2)
    planes = np.array([X_MIN, Y_MAX, (0.3, 0.8, 0.0, 0.5)])
    for _ in range(20):
        triangle = np.column_stack((rng.uniform(-2.0, 2.0, (3, 2)), np.ones(3)))
        points, counts = clip_polygons(triangle, np.array([3]), planes)
        weights = rng.dirichlet((1.0, 1.0, 1.0), 20000)
        samples = weights @ triangle
        kept = (samples @ planes[:, :3].T + planes[:, 3] >= 0.0).all(axis=1).mean()
        # 20000 samples: deviation of the share below 0.0036
        assert (area_m2(points) if counts[0] else 0.0) / area_m2(triangle) == pytest.approx(kept, abs=0.015)


def test_segments():
    ends = np.array(
        [
            [(1.0, 0.0, 0.0), (2.0, 0.0, 0.0)],
            [(-1.0, 0.0, 0.0), (1.0, 0.5, 0.0)],
            [(-1.0, 0.0, 0.0), (-2.0, 0.0, 0.0)],
            [(1.0, 3.0, 0.0), (1.0, -1.0, 0.0)],
        ]
    )
    points, counts = clip_polygons(ends.reshape(-1, 3), np.full(len(ends), 2), np.array([X_MIN, Y_MAX]))
    kept = [points[stop - count : stop][:2] for stop, count in zip(np.cumsum(counts), counts) if count]
    assert np.allclose(
        kept,
        [
            [(1.0, 0.0, 0.0), (2.0, 0.0, 0.0)],
            [(0.0, 0.25, 0.0), (1.0, 0.5, 0.0)],
            [(1.0, 1.0, 0.0), (1.0, -1.0, 0.0)],
        ],
    )
