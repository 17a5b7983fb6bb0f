"""Camera model: statistics of noise and occlusion, reproducibility, independence, scripted windows, ghosts."""

import pathlib

import numpy as np
import pytest

from risc_simulator.models.mocap_cameras import CameraParams, MocapCameras

RATE_HZ = 200.0
BODIES = [
    ("Raven", np.array([[0.1, 0.0, 1.0], [0.0, 0.1, 1.0], [-0.1, 0.0, 1.0], [0.0, -0.1, 1.1]])),
    ("Landmark_A", np.array([[1.0, 1.0, 0.0], [1.1, 1.0, 0.0], [1.0, 1.2, 0.0]])),
]
GOLDEN = pathlib.Path(__file__).parent / "golden"
LAYOUT = tuple((name, len(markers)) for name, markers in BODIES)
EXACT = np.concatenate([markers for _, markers in BODIES])


def run(cameras, frames, hides=None):
    """Observations of `frames` frames at RATE_HZ. hides: {frame before which: arguments of `hide`}."""
    seen = []
    for k in range(frames):
        if hides and k in hides:
            cameras.hide(*hides[k])
        seen.append(cameras.observe(k / RATE_HZ, LAYOUT, EXACT))
    return seen


def markers_of(observations):
    return np.array([o.markers_m for o in observations])


def test_ideal_cameras_report_the_exact_markers():
    seen = MocapCameras(CameraParams.ideal()).observe(0.0, LAYOUT, EXACT)
    assert np.array_equal(seen.markers_m, EXACT)
    assert seen.unidentified_m.shape == (0, 3)
    assert seen.layout == (("Raven", 4), ("Landmark_A", 3))


def test_input_is_not_changed():
    before = EXACT.copy()
    run(MocapCameras(), 10, {1: ("Raven", 1.0)})
    assert np.array_equal(EXACT, before)


def test_the_same_numbers_as_ever():
    """Noise, occlusions and ghosts of a seed match the golden file bit for bit."""
    golden = np.load(GOLDEN / "mocap_cameras.npz")
    params = CameraParams(occlusions_per_marker_hz=2.0, ghosts_hz=20.0)
    seen = run(MocapCameras(params, seed=5), 150)
    markers_m = markers_of(seen)
    markers_m[20:40, 1:3] = np.nan  # hidden on purpose there
    assert np.array_equal(markers_m, golden["markers_m"], equal_nan=True)
    assert np.isnan(golden["markers_m"]).any(axis=(1, 2)).mean() > 0.2
    assert np.array_equal(np.concatenate([o.unidentified_m for o in seen]), golden["unidentified_m"])
    assert [len(o.unidentified_m) for o in seen] == golden["unidentified_count"].tolist()


def test_noise_is_white_with_the_given_deviation():
    noise = markers_of(run(MocapCameras(CameraParams(occlusions_per_marker_hz=0.0), seed=1), 4000)) - EXACT
    # 4000 frames x 7 markers: the error of the estimated deviation is 0.6 % (4 sigma: 2.4 %) per axis
    assert np.allclose(noise.std(axis=(0, 1)), 0.002, rtol=0.024)
    assert np.all(np.abs(noise.mean(axis=(0, 1))) < 4 * 0.002 / np.sqrt(4000 * 7))
    lag_one = np.mean(noise[1:] * noise[:-1]) / 0.002**2
    assert abs(lag_one) < 4 / np.sqrt(4000 * 21)


def test_same_seed_same_output_other_seed_other_output():
    params = CameraParams(occlusions_per_marker_hz=2.0, ghosts_hz=20.0)
    first, second, other = (run(MocapCameras(params, seed), 200) for seed in (5, 5, 6))
    assert np.array_equal(markers_of(first), markers_of(second), equal_nan=True)
    assert all(np.array_equal(a.unidentified_m, b.unidentified_m) for a, b in zip(first, second))
    assert not np.array_equal(markers_of(first), markers_of(other), equal_nan=True)


def test_hiding_a_body_leaves_the_noise_of_the_others_alone():
    params = CameraParams(occlusions_per_marker_hz=1.0, ghosts_hz=5.0)
    free = run(MocapCameras(params, seed=3), 300)
    scripted = run(MocapCameras(params, seed=3), 300, {40: ("Raven", 0.9)})
    without = markers_of(run(MocapCameras(CameraParams(occlusions_per_marker_hz=0.0, ghosts_hz=0.0), seed=3), 300))
    a, b = markers_of(free), markers_of(scripted)
    hidden_by_script = np.zeros(a.shape[:2], bool)
    hidden_by_script[40:180, :4] = True
    assert np.isnan(b[hidden_by_script]).all()
    assert np.array_equal(a[~hidden_by_script], b[~hidden_by_script], equal_nan=True)
    seen = ~np.isnan(a)
    assert not seen.all()
    assert np.array_equal(a[seen], without[seen])
    assert all(np.array_equal(p.unidentified_m, q.unidentified_m) for p, q in zip(free, scripted))


def test_occlusions_have_the_given_rate_and_length():
    params = CameraParams(noise_std_m=0.0, occlusions_per_marker_hz=1.0, occlusion_mean_s=0.05, ghosts_hz=0.0)
    hidden = np.isnan(markers_of(run(MocapCameras(params, seed=2), 40000))[:, :, 0])  # 200 s x 7 markers
    starts = np.count_nonzero(hidden[1:] & ~hidden[:-1])
    # visible for 1 s, hidden for 0.05 s in the mean: 1333 losses, Poisson deviation 37
    assert abs(starts - 1400 / 1.05) < 4 * 37
    # seen by a 5 ms grid a loss lasts 0.0525 s in the mean (the frame of its start is always lost)
    assert np.count_nonzero(hidden) / RATE_HZ / starts == pytest.approx(0.0525, rel=0.12)
    assert np.array_equal(np.isnan(markers_of(run(MocapCameras(params, seed=2), 300)))[..., 0], hidden[:300])


def test_a_lost_marker_is_lost_in_all_coordinates():
    markers = markers_of(run(MocapCameras(CameraParams(occlusions_per_marker_hz=5.0), seed=4), 400))
    missing = np.isnan(markers)
    assert missing.any()
    assert np.array_equal(missing.any(axis=2), missing.all(axis=2))


def test_bodies_are_hidden_until_their_time_and_no_longer():
    hides = {10: ("Landmark_A", 0.1), 15: ("Raven", 0.09), 16: ("Raven", 0.085)}
    hidden = np.isnan(markers_of(run(MocapCameras(CameraParams.ideal()), 40, hides))[:, :, 0])
    expected = np.zeros((40, 7), bool)
    expected[10:20, 4:] = expected[15:18, :4] = True
    assert np.array_equal(hidden, expected)


def test_an_unknown_body_cannot_be_hidden():
    cameras = MocapCameras()
    cameras.observe(0.0, LAYOUT, EXACT)
    with pytest.raises(ValueError, match="'Crow'.*Raven, Landmark_A"):
        cameras.hide("Crow", 1.0)


def test_ghosts_appear_inside_the_volume_live_and_vanish():
    params = CameraParams(noise_std_m=0.0, ghosts_hz=10.0, ghost_mean_s=0.2)
    observations = run(MocapCameras(params, seed=8), 20000)  # 100 s
    counts = np.array([len(o.unidentified_m) for o in observations])
    # M/G/infinity queue: mean 2 (plus half a frame), variance 2, correlated over 0.2 s: 250 independent samples
    assert abs(counts.mean() - 2.0) < 4 * np.sqrt(2.0 / 250) + 0.03
    assert counts.min() == 0
    everything = np.concatenate([o.unidentified_m for o in observations])
    assert (everything >= params.volume_min_m).all() and (everything <= params.volume_max_m).all()
    assert np.ptp(everything, axis=0).min() > 2.0


def test_changed_bodies_give_a_new_layout():
    cameras = MocapCameras(CameraParams.ideal())
    first, again = cameras.observe(0.0, LAYOUT, EXACT), cameras.observe(0.005, LAYOUT, EXACT)
    assert first.layout is again.layout
    fewer = cameras.observe(0.01, LAYOUT[1:], EXACT[4:])
    assert fewer.layout == (("Landmark_A", 3),)
    assert cameras.observe(0.015, (), np.empty((0, 3))).markers_m.shape == (0, 3)
    with pytest.raises(ValueError, match="7 markers"):
        cameras.observe(0.02, LAYOUT, EXACT[1:])


@pytest.mark.parametrize(
    "bad",
    [
        {"noise_std_m": -0.001},
        {"occlusions_per_marker_hz": float("nan")},
        {"volume_min_m": (0, 0, 3), "volume_max_m": (1, 1, 1)},
        {"volume_min_m": (0, 0)},
    ],
)
def test_bad_parameters_are_refused(bad):
    with pytest.raises(ValueError):
        CameraParams(**bad)
