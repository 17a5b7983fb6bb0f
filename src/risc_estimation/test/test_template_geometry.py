"""Learning templates: from noisy markers at rest to a file that loads, and which geometries resemble each other."""

import itertools
import math

import numpy as np
import pytest

from risc_estimation.template_geometry import (
    ALIKE_M,
    LEAST_FRAMES,
    at_rest,
    in_axes_of,
    in_own_axes,
    laid_on,
    matches,
    resembling,
    symmetries_when_hidden,
    symmetry,
    template_text,
)
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab.templates import load_templates

TEMPLATES = load_templates()
HULL = TEMPLATES["fluffy_II"]
SQUARE_M = HULL.markers_m[:3]  # three corners
NOISE_M = 0.002


def samples(markers_m, frames=600, noise_m=NOISE_M, seed=1):
    rng = np.random.default_rng(seed)
    return markers_m + rng.normal(0.0, noise_m, (frames, *np.shape(markers_m)))


def test_false_frames_change_nothing():
    recorded = samples(HULL.markers_m)
    recorded[::20, 1] += 0.3
    recorded[5::20, 2] = 9999.999  # a lost marker in bags of the original
    recorded[3::20, 0] = np.nan
    rest = at_rest(recorded)
    np.testing.assert_allclose(rest.markers_m, HULL.markers_m, atol=5e-4)
    np.testing.assert_allclose(rest.noise_m[[0, 2, 3]], NOISE_M, rtol=0.1)
    assert rest.seen.tolist() == [0.95, 1.0, 0.95, 1.0]


@pytest.mark.parametrize(
    "spoil, problem",
    [
        (lambda r: r[: LEAST_FRAMES - 1], "too few"),
        (lambda r: r + np.linspace(0.0, 0.01, len(r))[:, None, None], "marker 1 has moved"),
        (lambda r: r + 0.03 * (np.arange(len(r)) > 500)[:, None, None] * [[0], [1], [0], [0]], "marker 2 has moved"),
        (lambda r: r + 0.02 * np.sin(np.arange(len(r)))[:, None, None] * [[0], [0], [1], [0]], "marker 3 shakes"),
        (lambda r: np.where((np.arange(len(r)) % 3 > 0)[:, None, None], np.nan, r), "marker 1 .* 33 %"),
    ],
)
def test_what_does_not_rest_is_refused(spoil, problem):
    with pytest.raises(ValueError, match=problem):
        at_rest(spoil(samples(HULL.markers_m)))


def test_noise_is_no_motion():
    """Of a hundred recordings none is refused, at the noise of our cameras and at twice as much."""
    for seed in range(100):
        at_rest(samples(HULL.markers_m, frames=200, noise_m=NOISE_M * (1 + seed % 2), seed=seed))


def test_matches_are_all_that_there_are():
    """Against all permutations."""
    rng = np.random.default_rng(3)
    for count in (3, 4, 5):
        markers_m = rng.normal(0.0, 0.03, (count, 3))
        others_m = markers_m + rng.normal(0.0, 0.002, markers_m.shape)
        every = [laid_on(markers_m, others_m, places) for places in itertools.permutations(range(count))]
        for limit_m in (0.002, 0.01, 0.03):
            expected = {match.places for match in every if match.rms_m <= limit_m}
            found = matches(markers_m, others_m, limit_m)
            assert {match.places for match in found} == expected and len(found) == len(expected)
            assert [match.rms_m for match in found] == sorted(match.rms_m for match in found)


def test_a_mirror_image_is_no_match():
    rng = np.random.default_rng(4)
    markers_m = rng.normal(0.0, 0.2, (5, 3))
    assert matches(markers_m, markers_m * [1.0, 1.0, -1.0]) == []


def test_what_is_symmetric_is_told_with_markers_and_turn():
    """Three corners of a square also fit upside down; the fourth marker of the hull tells the two apart."""
    match = symmetry(SQUARE_M)
    assert match.places == (0, 2, 1) and match.rms_m < 1e-9 and match.angle_rad == pytest.approx(math.pi)
    assert symmetry(HULL.markers_m) is None
    assert symmetries_when_hidden(HULL.markers_m).keys() == {3}
    assert symmetries_when_hidden(SQUARE_M) == {}
    skewed_m = SQUARE_M + [[0.0, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.0]]
    assert symmetry(skewed_m) is None and symmetry(skewed_m, 0.02).places == (0, 2, 1)


def test_what_is_like_another_template_is_named():
    rng = np.random.default_rng(5)
    turn = rotation_body_to_cortex(0.3, -0.2, 1.0)
    seen_m = HULL.markers_m[[2, 0, 3, 1]] @ turn.T + [1.0, 2.0, 0.1] + rng.normal(0.0, 0.001, (4, 3))
    found = resembling(seen_m, TEMPLATES)
    assert {"fluffy_II", "Raven"} <= found.keys() and "IRIS" not in found and "Pendulum_tip" not in found
    assert found["Raven"].places == (2, 0, 3, 1) and found["Raven"].rms_m < ALIKE_M
    assert "fluffy_II" in resembling(seen_m[:3], TEMPLATES), "the fewer on the more"
    assert "fluffy_II" in resembling(np.vstack([seen_m, [9.0, 9.0, 9.0]]), TEMPLATES)


def test_the_axes_are_those_of_the_kind():
    """A vehicle that stands with its nose at 40 degrees, its centre at a known place; a landmark as it is mounted."""
    psi, centre_m = math.radians(40.0), np.array([0.5, -0.3, 0.06])
    seen_m = HULL.markers_m @ rotation_body_to_cortex(0.0, 0.0, psi).T + centre_m
    np.testing.assert_allclose(in_own_axes(seen_m, "vehicle", centre_m, psi), HULL.markers_m, atol=1e-12)
    np.testing.assert_allclose(in_own_axes(seen_m, "landmark"), seen_m - seen_m.mean(axis=0), atol=1e-12)
    learnt_m, match = in_axes_of(seen_m + [[0.004], [0.0], [0.0], [0.0]], HULL)
    np.testing.assert_allclose(learnt_m, HULL.markers_m, atol=0.006)
    assert 0.001 < match.rms_m < 0.004
    with pytest.raises(ValueError, match="3 markers .* fluffy_II.* 4"):
        in_axes_of(SQUARE_M, HULL)


@pytest.mark.parametrize("kind", ["vehicle", "landmark", "attached"])
def test_what_is_written_is_a_templates_file(kind, tmp_path):
    path = tmp_path / "learnt.yaml"
    markers_m = HULL.markers_m + 0.00123
    path.write_text(template_text("Heron", kind, HULL.marker_names, markers_m, ("Learnt.", "By a test.")))
    loaded = load_templates(path)["Heron"]
    assert (loaded.kind, loaded.marker_names) == (kind, HULL.marker_names)
    np.testing.assert_allclose(loaded.markers_m, markers_m, atol=5.1e-5)
    assert path.read_text().startswith("# Learnt.\n# By a test.\n")


def test_markers_on_a_line_are_no_vehicle():
    line_m = np.outer([0.0, 0.1, 0.3], [1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match="Heron.* line"):
        template_text("Heron", "vehicle", ("a", "b", "c"), line_m)
