"""Ellipses: known ones are found again, and the centre of a circle is where projective geometry says."""

import cv2
import numpy as np
import pytest

from risc_visual.vision.ellipses import (
    Ellipse,
    centre_covariance,
    circle_centres,
    distances,
    ellipse_of_moments,
    fit_ellipse,
    fit_grown,
    unit_circle,
)

SHAPES = [
    Ellipse(3.0, -2.0, 20.0, 8.0, 0.4),
    Ellipse(310.5, 170.25, 60.0, 59.0, 2.8),
    Ellipse(50.0, 60.0, 9.0, 3.0, 1.57),
]


def outline(ellipse, count=36):
    return unit_circle(count) @ ellipse.axes().T + (ellipse.x, ellipse.y)


def same(a, b, tolerance):
    middle = np.hypot(a.x - b.x, a.y - b.y)
    spread = a.axes() @ a.axes().T - b.axes() @ b.axes().T
    return middle < tolerance and np.abs(spread).max() < 2.0 * tolerance * b.semi_major


@pytest.mark.parametrize("ellipse", SHAPES)
def test_a_fit_finds_the_ellipse_again(ellipse):
    found, off = fit_ellipse(outline(ellipse))
    assert same(found, ellipse, 1e-2)
    assert np.abs(off).max() < 1e-2


@pytest.mark.parametrize("ellipse", SHAPES)
def test_a_fit_leaves_outliers_out(ellipse):
    points = outline(ellipse)
    points[4:8] += (0.6 * ellipse.semi_minor, -0.4 * ellipse.semi_minor)
    found, _ = fit_ellipse(points)
    assert same(found, ellipse, 0.05 * ellipse.semi_minor)


def test_distances_have_signs_and_pixels():
    ellipse = Ellipse(10.0, 20.0, 30.0, 10.0, 0.0)
    points = np.array([(41.0, 20.0), (10.0, 29.5), (10.0, 32.0)])
    assert distances(points, ellipse) == pytest.approx([1.0, -0.5, 2.0], abs=0.2)


def test_nothing_is_fitted_through_too_few_points_or_a_line():
    assert fit_ellipse(np.zeros((3, 2))) == (None, None)
    assert fit_grown(np.zeros((3, 2)), SHAPES[0], 1.5) == (None, None)
    line = np.column_stack((np.arange(20.0), np.arange(20.0)))
    found, _ = fit_ellipse(line)
    assert found is None or found.semi_minor < 1.0 or found.semi_major > 100.0


@pytest.mark.parametrize("ellipse", SHAPES)
def test_a_grown_outline_is_found_through_much_that_is_none(ellipse):
    wanted = ellipse.grown(1.45)._replace(x=ellipse.x + 0.1 * ellipse.semi_minor)
    points = outline(wanted)
    points[:6] = outline(ellipse.grown(1.8))[:6]
    found, _ = fit_grown(points, ellipse, 1.5)
    assert found.x == pytest.approx(wanted.x, abs=0.03 * ellipse.semi_minor)
    assert found.semi_major == pytest.approx(wanted.semi_major, rel=0.01)


@pytest.mark.parametrize("ellipse", SHAPES)
def test_the_conic_is_zero_on_the_outline_and_negative_inside(ellipse):
    points = np.column_stack((outline(ellipse), np.ones(36)))
    conic = ellipse.conic()
    assert np.abs(np.einsum("ni,ij,nj->n", points, conic, points)).max() < 1e-9
    middle = np.array([ellipse.x, ellipse.y, 1.0])
    assert middle @ conic @ middle == pytest.approx(-1.0)


@pytest.mark.parametrize("ellipse", [SHAPES[1], Ellipse(100.0, 100.0, 60.0, 20.0, 0.7)])
def test_moments_of_a_drawn_ellipse(ellipse):
    mask = np.zeros((360, 640), np.uint8)
    cv2.fillPoly(mask, [np.round(outline(ellipse, 400)).astype(np.int32)], 255)
    found = ellipse_of_moments(cv2.moments(mask, True))
    assert same(found, ellipse, 0.6)
    assert cv2.countNonZero(mask) / found.area == pytest.approx(1.0, abs=0.02)


def test_shapes_without_extent_have_no_ellipse():
    assert ellipse_of_moments(cv2.moments(np.zeros((5, 5), np.uint8), True)) is None


@pytest.mark.parametrize("angle_deg", [-170.0, -90.0, -30.0, 0.0, 10.0, 90.0, 100.0, 180.0, 200.0])
def test_rectangles_are_given_as_opencv_gives_them(angle_deg):
    ellipse = Ellipse(0.0, 0.0, 40.0, 10.0, np.radians(angle_deg))
    width, height, angle = ellipse.rectangle()
    assert 0.0 < angle <= 90.0
    corners = cv2.boxPoints(((0.0, 0.0), (width, height), angle))
    direction = np.array([np.cos(ellipse.angle_rad), np.sin(ellipse.angle_rad)])
    assert np.abs(corners @ direction).max() == pytest.approx(40.0, abs=1e-3)
    (_, opencv_size, opencv_angle) = cv2.minAreaRect(outline(ellipse, 360).astype(np.float32))
    assert opencv_angle == pytest.approx(angle, abs=0.5) or abs(opencv_angle - angle) == pytest.approx(90.0, abs=0.5)
    assert sorted(opencv_size) == pytest.approx([20.0, 80.0], abs=0.1)


@pytest.mark.parametrize("tilt_deg", [0.0, 20.0, 60.0])
@pytest.mark.parametrize("towards_deg", [0.0, 75.0, 190.0])
def test_the_centre_of_a_circle_is_one_of_two_and_its_ring_tells_which(tilt_deg, towards_deg):
    rng = np.random.default_rng(int(tilt_deg + towards_deg))
    centre = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.2, 0.2), 1.0]) * 0.9
    tilt, towards = np.radians(tilt_deg), np.radians(towards_deg)
    normal = np.array([np.sin(tilt) * np.cos(towards), np.sin(tilt) * np.sin(towards), -np.cos(tilt)])
    across = np.cross(normal, [0.3, 0.9, 0.1])
    across /= np.linalg.norm(across)
    basis = np.column_stack((across, np.cross(normal, across)))

    def seen(radius):
        points = centre + radius * unit_circle(200) @ basis.T
        return fit_ellipse(1000.0 * points[:, :2] / points[:, 2:])[0]

    scaling = np.diag([1000.0, 1000.0, 1.0])
    found = circle_centres(scaling @ seen(0.10).conic() @ scaling, 1.5)
    wanted, ring = centre[:2] / centre[2], seen(0.15)
    errors = np.linalg.norm(found[0] - wanted, axis=1)
    best = int(np.argmin(errors))
    assert errors[best] < 3e-4
    assert 1000.0 * found[1][best] == pytest.approx((ring.x, ring.y), abs=0.3)
    if tilt_deg == 60.0:
        assert errors[1 - best] > 5e-3
        other = 1000.0 * found[1][1 - best]
        assert np.hypot(*(other - (ring.x, ring.y))) > 5.0


def directions_of(points, ellipse):
    lengths = ellipse.semi_major**2, ellipse.semi_minor**2
    local = (points - (ellipse.x, ellipse.y)) @ (ellipse.axes() / lengths)
    return local / np.linalg.norm(local, axis=1)[:, None]


@pytest.mark.parametrize("tilt_deg", [0.0, 5.0, 20.0, 50.0])
@pytest.mark.parametrize("share", [0.6, 1.0])
@pytest.mark.parametrize("sigma_px", [0.05, 0.15])
def test_covariance_of_the_centre_of_a_tilted_circle(tilt_deg, share, sigma_px):
    focal, middle = 600.0, np.array([0.3, -0.2, 2.0])
    c, s = np.cos(np.radians(tilt_deg)), np.sin(np.radians(tilt_deg))
    rim = 0.12 * unit_circle(32) @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0]]) + middle
    points, truth = focal * rim[:, :2] / rim[:, 2:], focal * middle[:2] / middle[2]
    across = points - points.mean(axis=0)
    across /= np.linalg.norm(across, axis=1)[:, None]
    to_normal = np.diag((focal, focal, 1.0))
    rng, squares = np.random.default_rng(5), []
    for _ in range(300):
        noisy = points + sigma_px * rng.standard_normal((32, 1)) * across
        if share < 1.0:
            keep = np.arange(32) < share * 32
            noisy = noisy[keep]
        fitted, off_px = fit_ellipse(noisy)
        found = focal * circle_centres(to_normal @ fitted.conic() @ to_normal, 1.5)[0]
        found = sorted(found, key=lambda centre: np.hypot(*(centre - truth)))
        directions, rms_px = directions_of(noisy, fitted), np.sqrt((off_px**2).mean())
        xx, xy, yy = centre_covariance(fitted, directions, rms_px, focal, found[0] - found[1], 1.0)
        error = found[0] - truth
        squares.append(error @ np.linalg.solve([[xx, xy], [xy, yy]], error) / 2.0)
    assert 0.3 < np.mean(squares) < (1.5 if share == 1.0 else 2.0), (
        "on the safe side where the better of two tilts is taken"
    )


def test_covariance_of_a_choice_and_of_a_lens():
    circle = Ellipse(100.0, 100.0, 40.0, 40.0, 0.0)
    directions = directions_of(outline(circle, 32), circle)
    args = circle, directions, 0.0, 600.0, (3.0, 0.0)
    xx, xy, yy = centre_covariance(*args, 0.5)
    sure_xx, _, sure_yy = centre_covariance(*args, 1.0)
    assert (xx - sure_xx, xy, yy - sure_yy) == pytest.approx((2.25, 0.0, 0.0)), "half of 3 px to one side or the other"
    wider = centre_covariance(*args, 0.5, np.diag((2.0, 1.0)))
    assert wider[0] - xx == pytest.approx(3.0 * 2.25, rel=0.01)
    assert centre_covariance(circle, directions[:5], 0.0, 600.0, (3.0, 0.0), 0.5) is None
