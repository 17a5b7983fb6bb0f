"""The window of bearings that a mount is fitted to: joining, keeping aside, forgetting."""

import numpy as np
import pytest
from mount_flight import T0_S

from risc_estimation.mount_samples import BearingWindow, WindowParams
from risc_lab.frames import rotation_body_to_cortex

PLACES = {"green": (2.0, 0.0, 1.0), "pink": (2.0, 1.0, 1.0)}
AHEAD = {"green": (0.0, 0.0)}


def pose_at(t_s):
    return (0.5 * t_s, 0.0, 1.0), (0.0, 0.0, 0.3 * t_s)


def window_of(params=None, poses_s=None, places=None):
    window = BearingWindow(params)
    window.see_landmarks(PLACES if places is None else places)
    for t_s in poses_s if poses_s is not None else np.arange(0.0, 1.0, 0.02):
        window.see_pose(T0_S + t_s, *pose_at(t_s))
    return window


def test_a_landmark_is_put_into_the_body_axes_of_the_moment_of_exposure():
    window = window_of()
    window.see_bearings(T0_S + 0.51, {"pink": (0.1, -0.2)})
    samples = window.latest(10.0)
    position_m, euler_rad = pose_at(0.51)
    expected = (np.array(PLACES["pink"]) - position_m) @ rotation_body_to_cortex(*euler_rad)
    np.testing.assert_allclose(samples.points_body_m, [expected], atol=1e-5)
    np.testing.assert_allclose(samples.rays, [[np.cos(0.2) * np.cos(0.1), np.cos(0.2) * np.sin(0.1), np.sin(0.2)]])
    assert list(samples.names) == ["pink"] and samples.times_s == pytest.approx([T0_S + 0.51])


def test_a_bearing_waits_for_its_pose():
    window = window_of()
    window.see_bearings(T0_S + 1.01, AHEAD)
    assert len(window.latest(10.0).times_s) == 0
    window.see_pose(T0_S + 1.02, *pose_at(1.02))
    np.testing.assert_allclose(window.latest(10.0).points_body_m[0], _body_point(1.01), atol=1e-4)


def _body_point(t_s):
    position_m, euler_rad = pose_at(t_s)
    return (np.array(PLACES["green"]) - position_m) @ rotation_body_to_cortex(*euler_rad)


def test_what_has_no_pose_is_left_out_and_counted():
    window = window_of(poses_s=list(np.arange(0.0, 1.0, 0.02)) + list(np.arange(1.5, 2.0, 0.02)))
    window.see_bearings(T0_S + 1.25, AHEAD)  # not seen in between
    window.see_bearings(T0_S - 0.5, AHEAD)  # before the first
    assert len(window.latest(10.0).times_s) == 0
    assert window.refused == {"the vehicle was not seen": 2}


def test_a_bearing_whose_pose_never_comes_does_not_wait_for_ever():
    window = window_of(WindowParams(late_max_s=2.0))
    window.see_bearings(T0_S + 1.5, AHEAD)
    window.see_bearings(T0_S + 4.0, AHEAD)
    assert window.refused == {"the vehicle was not seen": 1}


def test_a_landmark_that_nobody_knows_is_told():
    window = window_of(places={"green": (2.0, 0.0, 1.0), "pink": (np.nan, 0.0, 0.0)})
    window.see_bearings(T0_S + 0.5, {"pink": (0.0, 0.0), "Orange": (0.0, 0.0), "green": (0.0, 0.0)})
    assert list(window.latest(10.0).names) == ["green"]
    assert window.refused == {"the place of pink is not known": 1, "the place of Orange is not known": 1}


def test_a_bearing_that_is_no_number_is_left_out_and_counted():
    window = window_of()
    window.see_bearings(T0_S + 0.5, {"green": (np.nan, 0.0), "pink": (0.1, -0.2)})
    window.see_bearings(T0_S + 0.6, {"green": (0.0, np.inf), "unheard_of": (np.nan, np.nan)})
    assert list(window.latest(10.0).names) == ["pink"] and np.all(np.isfinite(window.latest(10.0).rays))
    assert window.refused == {"the bearing is no number": 3}


def test_a_picture_without_a_stamp_is_of_the_newest_pose():
    window = BearingWindow()
    window.see_landmarks(PLACES)
    window.see_bearings(0.0, {})
    assert not window.refused
    window.see_bearings(0.0, AHEAD)
    assert window.refused == {"the vehicle was not seen": 1}
    for t_s in (0.0, 0.02, 0.04):
        window.see_pose(T0_S + t_s, *pose_at(t_s))
        window.see_bearings(0.0, AHEAD)
    samples = window.latest(10.0)
    assert samples.times_s == pytest.approx([T0_S, T0_S + 0.02, T0_S + 0.04]), "nothing is forgotten in between"
    np.testing.assert_allclose(samples.points_body_m, [_body_point(t_s) for t_s in (0.0, 0.02, 0.04)], atol=1e-5)


def test_every_third_second_is_kept_aside():
    start_s = 3 * (T0_S // 3)
    window = BearingWindow()
    window.see_landmarks(PLACES)
    for k in range(600):
        stamp_s = start_s + k / 50.0
        window.see_pose(stamp_s, *pose_at(0.0))
        window.see_bearings(stamp_s, AHEAD)
    to_solve, to_check = window.samples()
    assert set(np.floor(to_solve.times_s - start_s) % 3) == {0.0, 1.0}
    assert set(np.floor(to_check.times_s - start_s) % 3) == {2.0}
    assert (len(to_solve.times_s), len(to_check.times_s)) == (400, 200)
    assert len(window.latest(1.0).times_s) == 51


def test_old_bearings_are_forgotten_and_record_forgets_all():
    window = BearingWindow(WindowParams(window_s=5.0))
    window.see_landmarks(PLACES)
    for k in range(500):
        window.see_pose(T0_S + k / 50.0, *pose_at(0.0))
        window.see_bearings(T0_S + k / 50.0, {"green": (0.0, 0.0), "red": (0.0, 0.0)})
    times_s = window.latest(100.0).times_s
    assert times_s.max() - times_s.min() == pytest.approx(5.0, abs=0.021)
    assert window.refused
    window.restart()
    assert len(window.latest(100.0).times_s) == 0 and not window.refused
    window.see_bearings(T0_S + 9.9, AHEAD)
    assert len(window.latest(100.0).times_s) == 1, "poses and landmarks are still known"


def test_a_bag_played_again_starts_afresh():
    window = window_of(WindowParams(late_max_s=2.0), poses_s=np.arange(0.0, 10.0, 0.02))
    window.see_bearings(T0_S + 9.9, AHEAD)
    window.see_pose(T0_S, *pose_at(0.0))
    window.see_pose(T0_S + 0.02, *pose_at(0.02))
    window.see_bearings(T0_S + 0.01, AHEAD)
    assert window.latest(100.0).times_s == pytest.approx([T0_S + 0.01])


@pytest.mark.parametrize("bad", [{"window_s": 0.0}, {"held_out_every": 1}, {"late_max_s": -1.0}])
def test_bad_settings_are_named(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        WindowParams(**bad)
