"""What every filter of the registry must do, those of the tree and one from a member folder (members/filters)."""

import math
import pathlib
from dataclasses import fields

import numpy as np
import pytest
from mocap_frames import pack_bodies

from risc_estimation.filters import COUNTS, REGISTRY, Status, VelocityFilter, make_filter
from risc_estimation.pose_fit import PoseFitParams
from risc_estimation.state_estimator import StatesEstimator
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.templates import load_templates
from risc_lab.registry import VARIABLE
from risc_lab.states import S

NAMES = ["alpha_beta", "ekf", "least_squares", "thesis"]
TEMPLATES = load_templates()
DT_S = 0.005


@pytest.fixture(autouse=True)
def members(monkeypatch):
    monkeypatch.setenv(VARIABLE, str(pathlib.Path(__file__).parent / "members"))


def frame(*places, name="fluffy_II"):
    """(layout, markers) of vehicles at places ((x, y, z) [m], yaw [rad]); name: of a single vehicle."""
    names = [name] if len(places) == 1 else ["fluffy_II", "Raven"]
    return pack_bodies(
        {
            name: np.asarray(place) + TEMPLATES[name].markers_m @ rotation_body_to_cortex(0.0, 0.0, psi).T
            for name, (place, psi) in zip(names, places)
        }
    )


def make(name, vehicles=()):
    return StatesEstimator(TEMPLATES, PoseFitParams(frozen_frames=0), vehicles, make_filter(name))


def test_the_registry_holds_them_all_and_each_has_its_settings():
    assert REGISTRY.names() == NAMES
    for name in NAMES:
        assert set(REGISTRY.settings(name)) == {item.name for item in fields(REGISTRY.module(name).Filter.PARAMS)}
    with pytest.raises(ValueError, match="'kalmann' .*filters; .*: %s" % ", ".join(NAMES)):
        make_filter("kalmann")


@pytest.mark.parametrize("name", NAMES)
def test_steady_motion_is_followed(name):
    """Half a metre a second, a radian a second through 180 degrees: after a second all filters agree with it."""
    estimator = make(name)
    for k in range(400):
        t = k * DT_S
        estimate = estimator.update(t, *frame(((0.5 * t - 1.0, 0.0, 1.0), 2.0 + t), ((0.0, 1.0, 1.0), 0.0)))
        if estimate.visible[0] and k > 200:
            assert estimate.states[0, [S.X, S.U, S.V, S.R]] == pytest.approx([0.5 * t - 1.0, 0.5, 0.0, 1.0], abs=2e-3)
            assert math.remainder(estimate.states[0, S.PSI] - 2.0 - t, 2.0 * math.pi) == pytest.approx(0.0, abs=2e-3)
    assert estimate.visible.all() and estimator.status() == [Status.TRACKED] * 2
    assert (np.abs(estimate.states[:, S.PSI]) <= math.pi).all()
    covariances = estimator.covariances()
    assert covariances is None or covariances.shape == (2, 12, 12)
    counters, accelerations = estimator.counters(), estimator.accelerations()
    assert counters is None or (counters.dtype == COUNTS and counters["poses"].tolist() == [400, 400])
    assert accelerations is None or accelerations.shape == (2, 3)


@pytest.mark.parametrize("name", NAMES)
def test_nobody_is_shown_at_once_outside_or_after_the_clock_was_set(name):
    estimator = make(name, ["fluffy_II", "Raven"])
    assert not estimator.update(0.0, (), np.zeros((0, 3))).visible.any()
    assert estimator.status() == [Status.LOST] * 2
    for k in range(1, 100):
        estimate = estimator.update(k * DT_S, *frame(((0.0, 0.0, 1.0), 0.0), ((0.0, 5.0, 1.0), 0.0)))
        if k == 1:
            assert estimator.status() == [Status.SETTLING, Status.OUTSIDE]
    assert estimate.visible.tolist() == [True, False]
    assert estimator.status() == [Status.TRACKED, Status.OUTSIDE]
    for k in range(3):
        estimate = estimator.update(1000.0 + k * DT_S, *frame(((1.0, 1.0, 1.0), 0.0)))
    assert not estimate.visible.any(), "a new clock"
    lost = estimator.update(1000.5, (), np.zeros((0, 3)))
    assert not lost.visible[0] or estimator.status()[0] is Status.PREDICTED


class Recorder(VelocityFilter):
    """Filter that records what it is given."""

    late_s = 0.05
    ON_BOARD = ("gyro",)

    def __init__(self):
        super().__init__(None)
        self.given, self.resets = [], 0

    def reset(self):
        self.resets += 1

    def update(self, poses):
        self.given.append((poses.stamp_s, poses.position_m.copy(), poses.covariances()))

    def on_board(self, row, stamp_s, what, values):
        self.given.append((stamp_s, row, what, values))


def test_a_filter_is_given_raw_poses_late_ones_if_it_takes_them_and_what_is_measured_on_board():
    recorder = Recorder()
    estimator = StatesEstimator(TEMPLATES, None, ["Raven", "fluffy_II"], recorder)
    body = frame(((0.1, 0.2, 1.0), 0.0))
    assert estimator.update(1.000, *body) is not None
    assert estimator.update(1.010, *body) is not None
    estimator.on_board("fluffy_II", 1.012, "gyro", np.zeros(3))
    estimator.on_board("fluffy_II", 1.012, "command", np.zeros(4))
    estimator.on_board("Kahn", 1.012, "gyro", np.zeros(3))
    assert estimator.update(1.005, *body) is None, "late: it changes the filter, states are not reported twice"
    assert estimator.update(0.900, *body) is None and estimator.counts.backward_stamps == 1, "too late"
    assert estimator.update(1.015, *body).stamp_s == 1.015
    assert [entry[0] for entry in recorder.given] == [1.000, 1.010, 1.012, 1.005, 1.015]
    assert recorder.given[2][1:3] == (1, "gyro")
    assert recorder.given[0][1][1] == pytest.approx([0.1, 0.2, 1.0])
    assert np.isfinite(recorder.given[0][2][1]).all() and recorder.resets == 0
    assert (estimator.counts.frames, estimator.counts.late_frames) == (4, 1)


def test_a_clock_that_was_set_back_a_little_is_none_of_a_late_frame():
    """Set back by less than late_s: the filter gets frames of the new clock once it is accepted, as without late_s."""
    recorder = Recorder()
    estimator = StatesEstimator(TEMPLATES, velocity_filter=recorder)
    seen = [estimator.update(t, *frame(((0.1, 0.2, 1.0), 0.0))) for t in (1.000, 1.010, 0.970, 0.980, 0.990, 1.000)]
    assert [estimate is not None for estimate in seen] == [True, True, False, False, True, True]
    assert [entry[0] for entry in recorder.given] == [1.000, 1.010, 0.990, 1.000] and recorder.resets == 1


def test_without_late_s_what_is_late_does_not_reach_the_filter():
    recorder = Recorder()
    recorder.late_s = 0.0
    estimator = StatesEstimator(TEMPLATES, velocity_filter=recorder)
    for stamp_s in (1.000, 1.010, 1.005, 1.010):
        estimator.update(stamp_s, *frame(((0.1, 0.2, 1.0), 0.0)))
    assert [entry[0] for entry in recorder.given] == [1.000, 1.010]


def test_a_burst_of_late_frames_blinds_nobody_and_a_clock_set_back_as_little_starts_afresh():
    """At a steady 200 Hz: frames up to 20 ms late reach a filter that takes them; those of a clock set back do not."""
    body = frame(((0.1, 0.2, 1.0), 0.0))
    for estimator in (make("least_squares"), StatesEstimator(TEMPLATES, velocity_filter=Recorder())):
        estimates = [estimator.update(k * DT_S, *body) for k in (*range(60), 64, 61, 62, 63, 65, 66)]
        late = estimator.counts.late_frames
        assert estimator.counts.clock_resets == 0 and late + estimator.counts.backward_stamps == 3
        if late:
            assert [round(entry[0] / DT_S) for entry in estimator._filter.given][60:] == [64, 61, 62, 63, 65, 66]
        else:
            assert all(estimate.visible.all() for estimate in estimates[59:] if estimate is not None)
        for k in range(67, 74):
            estimator.update(k * DT_S - 0.0225, *body)
        assert estimator.counts.clock_resets == 1
