"""Views of rviz: where the orbit camera sees points, and configurations for pictures."""

import numpy as np
import pytest

from risc_lab.lab.yaml_reader import package_file
from risc_visual.pictures.captions import LIGHT
from risc_visual.pictures.orbit_view import (
    OrbitView,
    load_config,
    marker_topics,
    orbit_view_from_dict,
    picture_config,
    saved_view,
)

SIZE = (1280, 900)
VIEW = OrbitView(distance_m=8.0, pitch_rad=0.5, yaw_rad=2.0, focal_point_m=(0.3, -0.6, 1.1))
HEIGHT_SEEN_M = 2.0 * VIEW.distance_m * np.tan(np.pi / 8.0)  # at the focal point, with rviz' 45 degrees


def test_the_focal_point_is_in_the_middle():
    np.testing.assert_allclose(VIEW.project(VIEW.focal_point_m, *SIZE), (639.5, 449.5), atol=1e-9)


def test_the_camera_stands_where_rviz_puts_it():
    view = OrbitView(distance_m=2.0, pitch_rad=np.pi / 6, yaw_rad=np.pi / 2, focal_point_m=(1.0, 2.0, 3.0))
    np.testing.assert_allclose(view.eye_m, (1.0, 2.0 + np.sqrt(3.0), 4.0), atol=1e-12)


@pytest.mark.parametrize(("yaw", "to_the_right"), [(0.0, (0, 1, 0)), (np.pi / 2, (-1, 0, 0)), (np.pi, (0, -1, 0))])
def test_right_and_up_are_where_a_person_sees_them(yaw, to_the_right):
    view = OrbitView(distance_m=5.0, pitch_rad=0.0, yaw_rad=yaw)
    shift = HEIGHT_SEEN_M / VIEW.distance_m * view.distance_m / 900 * 100  # [m] that are 100 pixels there
    np.testing.assert_allclose(view.project(shift * np.array(to_the_right), *SIZE), (739.5, 449.5), atol=1e-6)
    np.testing.assert_allclose(view.project((0.0, 0.0, shift), *SIZE), (639.5, 349.5), atol=1e-6)


def test_the_field_of_view_is_the_height_of_the_picture():
    towards = VIEW.focal_point_m - VIEW.eye_m
    up = np.cross(np.cross(towards, (0.0, 0.0, 1.0)), towards)
    top = VIEW.focal_point_m + 0.5 * HEIGHT_SEEN_M * up / np.linalg.norm(up)
    np.testing.assert_allclose(VIEW.project(top, *SIZE), (639.5, -0.5), atol=1e-6)


def test_what_is_behind_the_camera_is_nowhere():
    behind = 2.0 * VIEW.eye_m - VIEW.focal_point_m
    pixels = VIEW.project([VIEW.focal_point_m, behind], *SIZE)
    assert np.isfinite(pixels[0]).all() and np.isnan(pixels[1]).all()


def test_straight_from_above_the_heading_is_that_of_the_yaw():
    view = OrbitView(distance_m=10.0, pitch_rad=np.pi / 2, yaw_rad=np.pi)
    x_axis, y_axis = view.project([(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)], *SIZE) - (639.5, 449.5)
    assert x_axis[1] < -50 and abs(x_axis[0]) < 1e-6, "x is up in the picture"
    assert y_axis[0] < -50 and abs(y_axis[1]) < 1.0, "y is left in the picture"


@pytest.mark.parametrize("changes", [{"distance_m": 0.0}, {"field_rad": np.pi}, {"focal_point_m": (0.0, 1.0)}])
def test_views_that_cannot_be_are_refused(changes):
    with pytest.raises(ValueError, match=next(iter(changes))):
        OrbitView(**dict({"distance_m": 1.0, "pitch_rad": 0.0, "yaw_rad": 0.0}, **changes))


@pytest.mark.parametrize("size", [SIZE, (300, 900)])
@pytest.mark.parametrize("pitch_rad", [0.1, 0.6, np.pi / 2])
def test_a_fitted_view_is_filled(size, pitch_rad):
    box = np.array([(x, y, z) for x in (-2.5, 2.5) for y in (-2.0, 2.0) for z in (0.0, 3.0)])
    view = OrbitView(distance_m=1.0, pitch_rad=pitch_rad, yaw_rad=2.6).fitted(box, *size, margin=0.05)
    pixels = view.project(box, *size)
    free = np.minimum(pixels.min(axis=0), np.array(size) - 1 - pixels.max(axis=0)) / size
    assert free.min() == pytest.approx(0.05, abs=0.005)
    assert pixels.min(axis=0) + pixels.max(axis=0) == pytest.approx(np.array(size) - 1, abs=2.0), "in the middle"
    assert (view.pitch_rad, view.yaw_rad) == (pitch_rad, 2.6), "from the same side"
    assert orbit_view_from_dict(view.as_dict({"Class": "rviz/Orbit"})) == view


def test_shipped_configuration_becomes_one_for_pictures():
    config = load_config(package_file("risc_visual", "config/Diff_flat.rviz"))
    top = saved_view(config, "Top")
    made = picture_config(config, top, SIZE, 5, LIGHT, ("/net",), ("traj_name",))
    assert orbit_view_from_dict(made["Visualization Manager"]["Views"]["Current"]).pitch_rad > 1.5
    assert made["Window Geometry"] == {"X": 0, "Y": 0, "Width": 1280, "Height": 900} and made["Panels"] == []
    assert made["Visualization Manager"]["Global Options"]["Frame Rate"] == 5
    assert made["Visualization Manager"]["Global Options"]["Fixed Frame"] == "cortex"
    assert set(marker_topics(config)) - set(marker_topics(made)) == {"/net"} and "/Quad_Markers" in marker_topics(made)
    manager = made["Visualization Manager"]
    assert manager["Global Options"]["Background Color"] == "255; 255; 255"
    assert all(item.get("Namespaces", {"traj_name": False}) == {"traj_name": False} for item in manager["Displays"])
    assert saved_view(config)["Distance"] == config["Visualization Manager"]["Views"]["Current"]["Distance"]
    with pytest.raises(ValueError, match="Bottom.*Flight, Top"):
        saved_view(config, "Bottom")


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "fleet.yaml"
    path.write_text("name: ardrones3\n")
    with pytest.raises(ValueError, match="fleet.yaml.* rviz "):
        load_config(path)
    with pytest.raises(ValueError, match="rviz/Orbit.*rviz/FPS"):
        orbit_view_from_dict({"Class": "rviz/FPS"}, "some.rviz")
    with pytest.raises(ValueError, match="some.rviz: 'pitch_rad'"):
        orbit_view_from_dict({"Class": "rviz/Orbit", "Distance": 1.0}, "some.rviz")
