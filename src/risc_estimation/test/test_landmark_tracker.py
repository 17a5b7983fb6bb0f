"""Landmarks: the mean in full view, no jump in partial view, nothing when hidden."""

import numpy as np
import pytest

from risc_estimation.landmarks import LandmarkTracker

DISC = np.array([[0.0, 0.0, 0.17], [0.0, 0.17, 0.0], [0.0, 0.0, -0.17], [0.0, -0.17, 0.0]])
CENTRE = np.array([2.0, -1.0, 1.2])


def tracker():
    made = LandmarkTracker(residual_max_m=0.015)
    made.add("Green_pink", DISC)
    return made


def see(markers, hidden=()):
    """(measured, seen) of one landmark."""
    seen = np.ones((1, 4), dtype=bool)
    seen[0, list(hidden)] = False
    return np.where(seen[:, :, None], markers[None], 0.0), seen


def test_full_view_is_the_mean_as_in_the_original():
    rng = np.random.default_rng(0)
    markers = CENTRE + DISC + rng.normal(0.0, 0.002, DISC.shape)
    positions, visible = tracker().update(*see(markers))
    assert visible.tolist() == [True]
    assert positions[0] == pytest.approx(markers.mean(axis=0), abs=1e-12)


@pytest.mark.parametrize("hidden", [(0,), (3,), (0, 1), (2, 3)])
def test_partial_view_uses_the_template(hidden):
    positions, visible = tracker().update(*see(CENTRE + DISC, hidden))
    assert visible.tolist() == [True]
    assert positions[0] == pytest.approx(CENTRE, abs=1e-12)


def test_landmark_mounted_at_another_angle_does_not_jump_once_seen_whole():
    turned = CENTRE + DISC[:, [2, 0, 1]]
    made = tracker()
    made.update(*see(turned))
    for hidden in ((0,), (1, 2)):
        positions, visible = made.update(*see(turned, hidden))
        assert visible.tolist() == [True]
        assert positions[0] == pytest.approx(CENTRE, abs=1e-12)


def test_partial_view_that_contradicts_the_offsets_is_refused():
    turned = CENTRE + DISC[:, [2, 0, 1]]  # never seen whole: the template is wrong for it
    assert tracker().update(*see(turned, (0,)))[1].tolist() == [False]


def test_one_marker_or_none_is_not_a_landmark():
    made = tracker()
    made.update(*see(CENTRE + DISC))
    assert made.update(*see(CENTRE + DISC, (0, 1, 2)))[1].tolist() == [False]
    assert made.update(*see(CENTRE + DISC, (0, 1, 2, 3)))[1].tolist() == [False]


def test_offsets_are_averaged_over_frames():
    rng = np.random.default_rng(1)
    made = tracker()
    for _ in range(500):
        made.update(*see(CENTRE + DISC + rng.normal(0.0, 0.002, DISC.shape)))
    positions, _ = made.update(*see(CENTRE + DISC, (0, 1)))
    assert positions[0] == pytest.approx(CENTRE, abs=0.7e-3)


def test_templates_of_different_size_share_the_tracker():
    made = tracker()
    assert made.add("Small", np.array([[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0]])) == 1
    assert made.defined.tolist() == [[True] * 4, [True, True, False, False]]
    measured = np.zeros((2, 4, 3))
    measured[0], measured[1, :2] = CENTRE + DISC, [[0.6, 1.0, 0.0], [0.4, 1.0, 0.0]]
    positions, visible = made.update(measured, made.defined)
    assert visible.all()
    assert positions == pytest.approx(np.array([CENTRE, [0.5, 1.0, 0.0]]))
