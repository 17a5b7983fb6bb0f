"""The scenery: numbers of the survey, and what follows from them."""

import numpy as np
import pytest
import yaml

from risc_lab.lab.arena import Arena
from risc_lab.lab.yaml_reader import package_file
from risc_lab.settings import settings_from
from risc_visual.drawing.scenery import Scenery, load_scenery


@pytest.fixture(scope="module")
def scenery():
    return load_scenery()


def content():
    return yaml.safe_load(package_file("risc_visual", "config/arena.yaml").read_text())


def test_walls_are_those_of_the_original(scenery):
    centres = {tuple(np.round(centre, 6)) for centre, _ in scenery.net.walls()}
    assert centres == {(2.492954, 0, 1.5), (-2.492954, 0, 1.5), (0, 2.05178, 1.5), (0, -2.05178, 1.5)}
    sizes = [size for _, size in scenery.net.walls()]
    np.testing.assert_allclose(sizes[:2], [(0.01, 4.1, 3)] * 2, atol=5e-3)
    np.testing.assert_allclose(sizes[2:], [(4.986, 0.01, 3)] * 2, atol=5e-3)


def test_a_file_may_have_a_net_of_its_own():
    assert set(content()["net"]) == {"thickness_m"}, "the laboratory's is that of risc_lab.lab.arena"
    changed = content()
    changed["net"].update(half_x_m=4.0)
    net = settings_from(Scenery, changed).net
    assert (net.half_x_m, net.half_y_m, net.thickness_m) == (4.0, Arena().half_y_m, 0.01)


def test_around_another_net_everything_is_further_out(scenery):
    assert scenery.around(Arena()) == scenery
    larger = scenery.around(Arena(5.0, 4.5, 4.0))
    assert (larger.net.half_x_m, larger.net.half_y_m, larger.net.height_m) == (5.0, 4.5, 4.0)
    for camera, before in zip(larger.cameras.poses, scenery.cameras.poses):
        assert np.abs(camera.position_m)[:2] - np.abs(before.position_m)[:2] == pytest.approx([2.507046, 2.44822])
    assert larger.grid.labels(larger.net)[0] == ("5.0", (5.0, 5.0, 0.0))


def test_edges_join_the_eight_corners(scenery):
    edges = scenery.net.edges().reshape(12, 2, 3)
    assert len({tuple(end) for end in edges.reshape(-1, 3)}) == 8
    steps = edges[:, 1] - edges[:, 0]
    assert (np.count_nonzero(steps, axis=1) == 1).all()  # along one axis each
    assert np.linalg.norm(steps, axis=1).sum() == pytest.approx(4 * (2 * 2.492954 + 2 * 2.05178 + 3.0))


def test_numbers_stand_outside_of_the_net_from_metre_to_metre(scenery):
    net = scenery.net
    labels = scenery.grid.labels(net)
    values = ["%.1f" % (2.0 - 0.5 * k) for k in range(9)]
    assert [text for text, _ in labels] == [*values, *values, "X (m)", "Y (m)"]
    assert all(float(text) == x and y > net.half_y_m for text, (x, y, _) in labels[:9])
    assert all(float(text) == y and x < -net.half_x_m for text, (x, y, _) in labels[9:18])


def test_sixteen_cameras_look_down_into_the_arena(scenery):
    assert len(scenery.cameras.poses) == 16
    np.testing.assert_allclose(scenery.cameras.poses[0].position_m, (-3.43574, 0.16033, 2.52688))
    for camera, turn in zip(scenery.cameras.poses, scenery.cameras.turns()):
        R = turn.as_matrix()
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)
        assert R[2, 0] == pytest.approx(-0.5)  # 30 degrees below the horizon
        assert R[2, 1] == pytest.approx(0.0)  # upright
        assert R[2, 2] > 0.0
        # the optical axis, drawn out to half the camera's height, is over the floor inside the net
        at_m = np.array(camera.position_m) + R[:, 0] * (0.5 * camera.position_m[2] / 0.5)
        assert np.hypot(*at_m[:2]) < np.hypot(*camera.position_m[:2])


def test_heading_is_a_compass_course_from_y(scenery):
    along_y, along_x = (scenery.cameras.turns()[k].as_matrix()[:2, 0] for k in (4, 0))
    np.testing.assert_allclose(along_y, (0.0, np.cos(np.radians(30))), atol=1e-12)
    np.testing.assert_allclose(along_x, (np.cos(np.radians(30)), 0.0), atol=1e-12)


@pytest.mark.parametrize(
    "change, complaint",
    [
        (lambda c: c["net"].update(height_m=0.0), "height_m"),
        (lambda c: c["grid"].update(step_m=0.0), "step_m"),
        (lambda c: c["cameras"]["poses"][3].update(heading_deg="north"), "heading_deg"),
        (lambda c: c["cameras"].update(lens="8 mm"), "lens"),
    ],
)
def test_bad_file_is_refused_by_name(change, complaint):
    bad = content()
    change(bad)
    with pytest.raises(ValueError, match=complaint):
        settings_from(Scenery, bad)
