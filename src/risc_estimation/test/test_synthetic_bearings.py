"""Synthetic bearings: schedule, delay, field of view, noise, names."""

import numpy as np
import pytest

from risc_estimation.expected_bearings import Observer
from risc_estimation.synthetic_bearings import SyntheticBearings, SyntheticParams
from risc_lab.camera import Camera
from risc_lab.lab.calibration import CameraCalibration, CameraMount
from risc_lab.lab.landmark_catalogue import Disc

CAMERA = Camera(CameraCalibration.from_intrinsics("plain", (640, 360), (600.0, 600.0), (320.0, 180.0)))
OBSERVER = Observer(CAMERA, CameraMount(position_m=(0.0, 0.0, 0.0)))
AHEAD = Disc("green", (2.0, 0.0, 1.0), None)
T0_S = 1.7e9  # as large as real stamps


def fly(synthetic, frames, states, start_s=T0_S, rate_hz=200.0):
    """Pictures taken during `frames` frames; states: function of the time since the start."""
    pictures = []
    for k in range(frames):
        pictures += synthetic.update(start_s + k / rate_hz, states(k / rate_hz))
    return pictures


def still(_t_s):
    return {"fluffy_II": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0))}


def turning(t_s):
    return {"fluffy_II": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.2 * t_s))}


def green(pictures):
    return np.array([(stamp_s, views[0].landmarks[0].azimuth_rad) for stamp_s, views in pictures])


def test_pictures_come_on_their_schedule():
    synthetic = SyntheticBearings({"fluffy_II": OBSERVER})
    synthetic.see_landmarks([AHEAD])
    pictures = fly(synthetic, 401, still)
    stamps_s = np.array([stamp_s for stamp_s, _ in pictures])
    assert len(pictures) == 61 and np.diff(stamps_s) == pytest.approx(np.full(60, 1 / 30.0), abs=1e-6)
    assert all(views[0].landmarks[0].visible for _, views in pictures[1:])
    assert np.degrees(green(pictures)[1:, 1]) == pytest.approx(np.zeros(60), abs=1e-5)


@pytest.mark.parametrize("delay_s", [0.0, 0.08])
def test_a_delayed_picture_shows_the_past(delay_s):
    synthetic = SyntheticBearings({"fluffy_II": OBSERVER}, SyntheticParams(delay_s=delay_s))
    synthetic.see_landmarks([AHEAD])
    seen = green(fly(synthetic, 400, turning))
    seen = seen[np.isfinite(seen[:, 1])]
    assert len(seen) > 55
    np.testing.assert_allclose(seen[:, 1], -0.2 * (seen[:, 0] - T0_S - delay_s), atol=1e-6)


def test_the_field_of_view_is_respected():
    synthetic = SyntheticBearings({"fluffy_II": OBSERVER})
    behind, aside = Disc("pink", (-2.0, 0.0, 1.0), None), Disc("blue", (2.0, 1.5, 1.0), None)
    far, back = Disc("far", (9.0, 0.0, 1.0), None), Disc("back", (2.0, 0.3, 1.0), (1.0, 0.0, 0.0))
    synthetic.see_landmarks([AHEAD, behind, aside, far, back])
    _, views = fly(synthetic, 100, still)[-1]
    assert [(item.name, item.visible) for item in views[0].landmarks] == [
        ("green", True),
        ("pink", False),
        ("blue", False),
        ("far", False),
        ("back", False),
    ]
    assert np.isnan(views[0].landmarks[1].azimuth_rad)


def test_vehicles_see_each_other_and_what_they_hide_is_hidden():
    def states(_t_s):
        return {
            "fluffy_II": ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
            "Raven": ((1.0, 0.0, 1.0), (np.pi / 2, 0.0, 0.0)),
        }

    synthetic = SyntheticBearings({"fluffy_II": OBSERVER, "Raven": None})
    synthetic.see_landmarks([AHEAD])
    fluffy, raven = fly(synthetic, 100, states)[-1][1]
    assert (fluffy.vehicle, raven.vehicle) == ("fluffy_II", "Raven")
    assert [(item.name, item.visible) for item in fluffy.quads] == [("Raven", True)]
    assert [item.visible for item in fluffy.landmarks] == [False], "Raven is in front of it, on its side"
    assert [item.visible for item in raven.landmarks + raven.quads] == [False, False], "its camera is not known"


def test_an_invisible_vehicle_sees_nothing_and_is_not_seen():
    synthetic = SyntheticBearings({"fluffy_II": OBSERVER, "Raven": OBSERVER})
    synthetic.see_landmarks([Disc("green", (4.0, 0.0, 1.0), None)])
    both = {"Raven": ((2.0, 0.5, 1.0), (0.0, 0.0, 0.0))}
    pictures = fly(synthetic, 60, lambda t: dict(still(t), **both if t < 0.1 else {}))
    first, last = pictures[2][1], pictures[-1][1]
    assert first[0].quads[0].visible and first[1].landmarks[0].visible
    assert not last[0].quads[0].visible and not last[1].landmarks[0].visible


def test_noise_is_what_was_asked_for_and_a_seed_repeats_it():
    def angles(seed):
        synthetic = SyntheticBearings({"fluffy_II": OBSERVER}, SyntheticParams(noise_deg=0.5, seed=seed))
        synthetic.see_landmarks([AHEAD])
        seen = [views[0].landmarks[0] for _, views in fly(synthetic, 8000, still)[1:]]
        return np.degrees([(item.azimuth_rad, item.elevation_rad) for item in seen])

    first = angles(1)
    assert first.std(axis=0) == pytest.approx([0.5, 0.5], rel=0.06)
    assert np.abs(first.mean(axis=0)).max() < 0.05
    np.testing.assert_array_equal(first, angles(1))
    assert np.abs(first - angles(2)).max() > 0.5


def test_a_bag_played_again_starts_the_schedule_again():
    synthetic = SyntheticBearings({"fluffy_II": OBSERVER})
    synthetic.see_landmarks([AHEAD])
    fly(synthetic, 200, still)
    again = fly(synthetic, 200, still, start_s=T0_S - 100.0)
    assert len(again) >= 29 and again[-1][1][0].landmarks[0].visible
    jump = fly(synthetic, 200, still, start_s=T0_S + 1000.0)
    assert 29 <= len(jump) <= 30, "no pictures for the time that was left out"


@pytest.mark.parametrize(
    "bad", [{"rate_hz": 0.0}, {"delay_s": -0.1}, {"noise_deg": -1.0}, {"min_fraction": 0.0}, {"max_distance_m": 0.0}]
)
def test_bad_settings_are_named(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        SyntheticParams(**bad)
