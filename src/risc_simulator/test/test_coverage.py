"""Pixel coverage: exact areas, at every place, in every order of the corners."""

import numpy as np
import pytest

from risc_simulator.video.coverage import coverage


def cover(polygons, box=(0, 0, 8, 6), masks=None, weights=None):
    polygons = [np.asarray(polygon, dtype=float) for polygon in polygons]
    masks = np.zeros(len(polygons), int) if masks is None else np.asarray(masks)
    boxes = [box] * (masks.max() + 1 if len(masks) else 1)
    weights = np.ones(len(polygons)) if weights is None else weights
    return coverage(np.concatenate(polygons), [len(p) for p in polygons], masks, weights, boxes)


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
    (mask,) = cover([square(1.5, 0.5, 3.5, 1.5)])  # pixels 2 and 3 of row 1, exactly
    expected = np.zeros((6, 8))
    expected[1, 2:4] = 1.0
    assert np.array_equal(mask, expected)


def test_parts_of_pixels():
    (mask,) = cover([square(1.75, 0.75, 3.25, 1.25)])  # half a pixel high; three quarters of columns 2 and 3
    assert np.allclose(mask[1, 1:5], [0.0, 0.375, 0.375, 0.0])
    assert mask.sum() == pytest.approx(0.75)


def test_half_a_pixel_under_a_diagonal():
    (mask,) = cover([[(-0.5, -0.5), (5.5, 5.5), (-0.5, 5.5)]])
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
            continue  # the middle would be outside, and edges cross
        radius = rng.uniform(3.0, 45.0)
        points = np.stack((np.cos(angles), np.sin(angles)), axis=1) * rng.uniform(0.5, 1.0, (len(angles), 1)) * radius
        points += rng.uniform((10.0, 60.0), (30.0, 80.0))
        (mask,) = cover([points], box)
        assert mask.sum() == pytest.approx(shoelace(points), abs=1e-3)
        rows, columns = np.mgrid[box[1] : box[3], box[0] : box[2]]
        middle = np.array([(columns * mask).sum(), (rows * mask).sum()]) / mask.sum()
        assert np.allclose(middle, centroid(points), atol=0.02)  # what a pixel holds counts as at its middle


def test_what_is_beyond_the_box_changes_nothing_in_it():
    rng = np.random.default_rng(1)
    for _ in range(30):
        points = rng.uniform(-15.0, 22.0, (3, 2))
        large = cover([points], (-20, -20, 30, 30))[0]
        assert np.allclose(cover([points])[0], large[20:26, 20:28], atol=1e-5)


def test_many_polygons_add_up_by_their_weights():
    (mask,) = cover([square(0.5, 0.5, 2.5, 1.5), square(1.5, 0.5, 3.5, 1.5)], weights=[0.5, 0.5])
    assert np.allclose(mask[1, :5], [0.0, 0.5, 1.0, 0.5, 0.0])


def test_masks_are_independent():
    first, second = cover([square(0.5, 0.5, 2.5, 1.5), square(1.5, 2.5, 3.5, 3.5)], masks=[0, 1])
    assert first.sum() == pytest.approx(2.0) and first[1, 1] == 1.0
    assert second.sum() == pytest.approx(2.0) and second[3, 2] == 1.0


def test_no_polygon():
    (mask,) = coverage(np.empty((0, 2)), [], [], [], [(0, 0, 3, 2)])
    assert mask.shape == (2, 3) and not mask.any()


def test_long_edges_are_worked_on_in_portions():
    (mask,) = cover([square(-0.5, -0.5, 29999.5, 0.5)], (29990, 0, 30010, 2))
    assert np.allclose(mask[0], [1.0] * 10 + [0.0] * 10) and not mask[1].any()
