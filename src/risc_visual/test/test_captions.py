"""Texts of a picture: none covers another or a vehicle, wherever the vehicles are."""

import itertools

import numpy as np
import pytest
from drawn import HEAD, everything, scene

from risc_visual.drawing.palette import on_white
from risc_visual.drawing.ros import markers
from risc_visual.pictures.captions import DARK, LIGHT, Box, Name, Row, lay_out, scene_size, write
from risc_visual.pictures.rviz_pictures import VEHICLE_REACH_M, VIEWS, layout_of, outline_m, views_from

SIZES = ((1280, 900), (640, 480), (2400, 1600), (900, 1200))
NAMES = ("fluffy_II", "albatross", "Raven", "Kahn", "Condor", "IRIS")


def drawn(positions_m, **more):
    """The markers of draw_cortex, draw_risc_maap and draw_trajectories for vehicles at these positions."""
    found = everything(dict(zip(NAMES, positions_m)), **{"tip": False, **more})
    found = {"/" + topic: content for topic, content in found.items() if topic != "angle_lines"}
    text = "risc1: 0.14 deg (1.4 px) RMS of 180 bearings"
    found["/transform_tuner/text"] = [markers.Pen(1.0).text("risc1", 0, text, (0, 0, 0), 0.1, (1.0,) * 4)]
    return {(topic, marker.ns, marker.id): marker for topic, content in found.items() for marker in content}


def flights():
    """Positions of vehicles: apart, over each other, close together, many."""
    rng = np.random.default_rng(0)
    yield [(0.5, 0.5, 1.0), (-0.5, 0.5, 1.0), (0.0, -0.5, 1.0)]
    yield [(0.0, 0.0, 0.5), (0.0, 0.0, 1.2), (0.0, 0.0, 2.0)]
    yield [(2.3, 0.9, 1.0), (2.3, -0.9, 1.2)]
    for _ in range(5):
        yield rng.uniform((-2.0, -1.6, 0.2), (2.0, 1.6, 2.0), (len(NAMES), 3))


@pytest.mark.parametrize("name", VIEWS)
@pytest.mark.parametrize("size", SIZES)
def test_no_text_covers_another_or_a_vehicle(name, size):
    (view,) = views_from([name], size)
    for positions_m in flights():
        layout = layout_of(view, drawn(positions_m), "t = 12.3 s")
        for one, other in itertools.combinations(layout.texts, 2):
            assert not one.box.overlaps(other.box), (one, other)
        for at_m in positions_m:
            corners = view.camera.project(at_m + outline_m(*VEHICLE_REACH_M), *view.scene_px)
            vehicle = Box(*corners.min(axis=0), *corners.max(axis=0))
            assert not any(text.box.overlaps(vehicle) for text in layout.texts)
        for text in layout.texts:
            assert 0 <= text.box.left < text.box.right <= size[0] and 0 <= text.box.top < text.box.bottom <= size[1]
        said = [text.text for text in layout.texts]
        for vehicle in NAMES[: len(positions_m)]:
            assert said.count(vehicle) >= 2, "beside the vehicle, and in the panel"


def test_mode_and_battery_of_a_laboratory_without_a_fleet_are_those_of_its_vehicle():
    (view,) = views_from(["oblique"], (1280, 900))
    content = drawn([(0.5, 0.5, 1.0)])
    for topic, message in (
        ("/Ctrl_Status", scene().mode(HEAD, 0, "", True)),
        ("/Battery_Status", scene().battery(HEAD, 0, "", 80.0)),
    ):
        content = {key: marker for key, marker in content.items() if key[0] != topic}
        content[topic, message.ns, message.id] = message
    said = [text.text for text in layout_of(view, content).texts]
    assert "Autonomous" in said and "Battery: 80%" in said


def test_what_is_written_stays_in_its_box():
    """Only pixels in the boxes of texts, in marks, and in lines to distant names change."""
    scene = np.zeros((600, scene_size((800, 600))[0], 3), dtype=np.uint8)
    names = [
        Name("fluffy_II", (200.0, 300.0), (40.0, 20.0), (1.0, 1.0, 1.0), vehicle=True),
        Name("gjpqy", (400, 20), (5.0, 5.0), (1, 0, 0)),
    ]
    layout = lay_out(names, [Row("circles3", bold=True), Row("a long line that has to be wrapped")], (800, 600), DARK)
    picture = write(scene, layout, DARK)
    changed = (picture[:, : scene.shape[1]] != 0).any(axis=2)
    panel = (picture[:, scene.shape[1] :] != DARK.panel).any(axis=2)
    changed = np.hstack((changed, panel))
    assert changed.sum() > 300
    for text in layout.texts:
        left, top, right, bottom = (int(value) for value in text.box)
        assert changed[top : bottom + 1, left : right + 1].any(), text
        changed[top : bottom + 2, left : right + 2] = False
    assert not changed.any()


def test_the_light_scheme_is_light_and_its_inks_are_dark():
    (view,) = views_from(["oblique"], (640, 480), light=True)
    assert view.config["Visualization Manager"]["Global Options"]["Background Color"] == "255; 255; 255"
    assert view.scheme is LIGHT and min(LIGHT.ground + LIGHT.panel) > 230 and max(LIGHT.ink) < 80


@pytest.mark.parametrize(
    "rgb", [(1, 1, 1), (0, 1, 0), (1.0, 0.8, 0.25), (0.3, 0.7, 1.0), (0.85, 0.85, 0.9), (0, 0, 1), (1, 0.4, 0)]
)
def test_every_colour_can_be_told_from_white_paper(rgb):
    dark = np.array(on_white(rgb))
    luminance = np.array((0.2126, 0.7152, 0.0722)) @ dark**2.2
    assert 1.05 / (luminance + 0.05) >= 3.0 and dark.min() >= 0.0
    if np.ptp(rgb) > 0.15:  # the same hue
        assert np.argmax(dark) == np.argmax(rgb) and np.allclose(dark / dark.max(), np.array(rgb) / max(rgb), atol=1e-6)
