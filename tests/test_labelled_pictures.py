"""The labelled set: reproducible, and as varied as it says."""

import itertools
import math

import labelled_pictures as dataset
import numpy as np
import pytest
from labelled_pictures import calibration_pictures, landmark_set

from risc_lab.camera import Camera
from risc_lab.lab.calibration import load_calibration
from risc_simulator.video.scene import load_style

COUNT = 60


@pytest.fixture(scope="module")
def samples():
    return list(landmark_set(11, COUNT))


def landmarks_of(samples):
    return [(sample, truth) for sample in samples for truth in sample.truths if truth.kind == "landmark"]


def test_a_seed_gives_the_same_set_whatever_its_length(samples):
    for again, sample in zip(landmark_set(11, 3), samples):
        assert np.array_equal(again.image, sample.image)
        assert again.truths == sample.truths and again.conditions == sample.conditions
    other = next(landmark_set(12, 1))
    assert not np.array_equal(other.image, samples[0].image)


def test_pictures_and_conditions(samples):
    assert len(samples) == COUNT
    for index, sample in enumerate(samples):
        conditions = sample.conditions
        assert sample.image.shape == (360, 640, 3) and sample.image.dtype == np.uint8
        assert conditions["index"] == index and conditions["calibration"] in dataset.CALIBRATIONS
        assert dataset.GAIN[0] <= conditions["gain"] <= dataset.GAIN[1]
        assert 0.0 <= conditions["blur_px"] < 12.0
        names = [truth.name for truth in sample.truths if truth.kind == "landmark"]
        assert len(set(names)) == len(names) <= conditions["landmarks"] <= 4
        assert all(isinstance(value, (int, float, str)) for value in conditions.values())  # fit for JSON


def test_the_set_spans_what_it_promises(samples):
    truths = [truth for _, truth in landmarks_of(samples)]
    conditions = [sample.conditions for sample in samples]
    distance = np.array([truth.distance_m for truth in truths])
    obliqueness = np.degrees([truth.obliqueness_rad for truth in truths])
    assert distance.min() >= 0.7 and distance.max() <= 4.0 and np.ptp(distance) > 2.5
    assert obliqueness.max() <= 70.001 and obliqueness.max() > 55.0 and obliqueness.min() < 15.0
    gain = np.array([c["gain"] for c in conditions])
    assert gain.min() < 0.5 and gain.max() > 1.5
    blur = np.array([c["blur_px"] for c in conditions])
    assert (blur == 0.0).any() and (blur > 4.0).any()
    seen = np.array([truth.seen_fraction for truth in truths])
    assert ((seen > 0.1) & (seen < 0.9)).any() and (seen > 0.99).mean() > 0.5
    assert {c["landmarks"] for c in conditions} == {0, 1, 2, 3, 4}
    assert {truth.name for truth in truths} == {kind.name for kind in load_style().catalogue.landmarks}
    assert {c["calibration"] for c in conditions} == set(dataset.CALIBRATIONS)
    for kind in ("panels", "balls", "vehicles"):
        assert {min(c[kind], 1) for c in conditions} == {0, 1}


def test_the_smallest_discs_are_about_8_px(samples):
    focal_px = min(focal[0] for focal, _, _ in dataset.CALIBRATIONS.values())
    smallest = focal_px * 0.20 / dataset.DISTANCE_M[1] * math.cos(dataset.OBLIQUENESS_RAD[1])
    assert smallest < 8.0
    found = [truth.diameter_px for _, truth in landmarks_of(samples)]
    assert min(found) < 18.0 and max(found) > 80.0


def test_centres_have_the_paint_of_their_landmark(samples):
    style = load_style()
    checked = 0
    for sample, truth in landmarks_of(samples):
        if truth.seen_fraction < 0.99 or truth.diameter_px < 20.0 + 2.0 * sample.conditions["blur_px"]:
            continue
        x, y = np.round(truth.centre_px).astype(int)
        found = sample.image[y - 2 : y + 3, x - 2 : x + 3].reshape(-1, 3).mean(axis=0)
        paint = np.array(style.disc(truth.name, (0, 0, 1), (1, 0, 0)).centre_bgr) * sample.conditions["gain"]
        # vignette takes up to 35 %, the colour of the light changes blue and red by up to 15 %
        assert (found <= np.minimum(1.2 * paint, 255.0) + 6.0).all()
        assert (found >= np.minimum(0.5 * paint, 250.0) - 6.0).all()
        checked += 1
    assert checked > 20


def test_no_ball_hangs_where_it_would_be_a_landmark():
    """With a ball of a centre's paint about, no panel may have the hue of the ring that belongs to it."""
    rng = np.random.default_rng(0)
    for forbidden in ({"pink"}, {"blue", "green"}, set()):
        for _ in range(300):
            hue, _, _ = dataset._hsv(rng, forbidden)
            for name in forbidden:
                assert abs((hue - dataset._HUES[name] + 90.0) % 180.0 - 90.0) > 19.0


def test_it_is_an_iterator_that_works_as_it_goes():
    assert len(list(itertools.islice(landmark_set(1, 10**9), 2))) == 2


def test_calibration_pictures_come_with_their_truth_and_reproduce():
    camera = Camera(load_calibration("ardrone_front.yaml"))
    pictures = list(calibration_pictures(camera, 7, count=3))
    again = list(calibration_pictures(camera, 7, count=3))
    assert len(pictures) == 3
    for picture, same in zip(pictures, again):
        assert picture.image.shape == (360, 640, 3) and picture.image.dtype == np.uint8
        assert np.array_equal(picture.image, same.image) and np.array_equal(picture.corners_px, same.corners_px)
        # the four squares that meet at a corner: two are dark, two are bright, opposite ones are alike
        grid = picture.corners_px.reshape(6, 8, 2)
        for row in range(1, 5):
            across, down = 0.35 * (grid[row, 4] - grid[row, 3]), 0.35 * (grid[row + 1, 3] - grid[row, 3])
            shades = [
                picture.image[tuple(np.round(grid[row, 3] + a * across + b * down).astype(int)[::-1])].mean()
                for a, b in ((1, 1), (-1, -1), (1, -1), (-1, 1))
            ]
            assert abs(shades[0] - shades[1]) < 40.0 and abs(shades[2] - shades[3]) < 40.0
            assert abs(shades[0] - shades[2]) > 80.0
