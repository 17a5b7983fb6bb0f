"""Landmarks: the mean in full view, no jump in partial view, nothing when hidden."""

import numpy as np
import pytest

from risc_estimation.landmark_positions import LANDMARK, locate_landmark

DISC = np.array([[0.0, 0.0, 0.17], [0.0, 0.17, 0.0], [0.0, 0.0, -0.17], [0.0, -0.17, 0.0]])
CENTRE = np.array([2.0, -1.0, 1.2])


class Tracker:
    """One landmark over several frames."""

    def __init__(self, offsets=DISC):
        self.known = np.zeros(1, dtype=LANDMARK)
        self.known["markers"] = len(offsets)
        self.offsets = np.array(offsets)

    def see(self, markers, hidden=()):
        """(position (3,), whether it counts)."""
        position_m = np.zeros(3)
        visible = np.ones(len(markers), dtype=bool)
        visible[list(hidden)] = False
        measured = np.where(visible[:, None], markers, np.nan)
        return position_m, bool(locate_landmark(self.known[0], self.offsets, measured, visible, 0.015, position_m))


def test_full_view_is_the_mean_as_in_the_original():
    rng = np.random.default_rng(0)
    markers = CENTRE + DISC + rng.normal(0.0, 0.002, DISC.shape)
    position, counts = Tracker().see(markers)
    assert counts
    assert position == pytest.approx(markers.mean(axis=0), abs=1e-12)


@pytest.mark.parametrize("hidden", [(0,), (3,), (0, 1), (2, 3)])
def test_partial_view_uses_the_template(hidden):
    position, counts = Tracker().see(CENTRE + DISC, hidden)
    assert counts
    assert position == pytest.approx(CENTRE, abs=1e-12)


def test_landmark_mounted_at_another_angle_does_not_jump_once_seen_whole():
    turned = CENTRE + DISC[:, [2, 0, 1]]
    tracker = Tracker()
    tracker.see(turned)
    for hidden in ((0,), (1, 2)):
        position, counts = tracker.see(turned, hidden)
        assert counts
        assert position == pytest.approx(CENTRE, abs=1e-12)


def test_partial_view_that_contradicts_the_offsets_is_refused():
    turned = CENTRE + DISC[:, [2, 0, 1]]  # never seen whole: the template is wrong for it
    assert not Tracker().see(turned, (0,))[1]


def test_one_marker_or_none_is_not_a_landmark():
    tracker = Tracker()
    tracker.see(CENTRE + DISC)
    assert not tracker.see(CENTRE + DISC, (0, 1, 2))[1]
    assert not tracker.see(CENTRE + DISC, (0, 1, 2, 3))[1]


def test_offsets_are_averaged_over_frames():
    rng = np.random.default_rng(1)
    tracker = Tracker()
    for _ in range(500):
        tracker.see(CENTRE + DISC + rng.normal(0.0, 0.002, DISC.shape))
    position, _ = tracker.see(CENTRE + DISC, (0, 1))
    assert position == pytest.approx(CENTRE, abs=0.7e-3)


@pytest.mark.parametrize("offsets", [[[0.1, 0.0, 0.0], [-0.1, 0.0, 0.0]], [[0.0, 0.0, 0.0]]])
def test_a_small_landmark_needs_all_its_markers(offsets):
    tracker = Tracker(offsets)
    position, counts = tracker.see(CENTRE + offsets)
    assert counts
    assert position == pytest.approx(CENTRE)
    assert not tracker.see(CENTRE + offsets, (0,))[1]
