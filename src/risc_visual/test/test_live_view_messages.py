"""risc_visual.browser.ros.live_view: what the drawing nodes send is what the browser view takes and shows."""

import math
import pathlib

import pytest
import yaml
from geometry_msgs.msg import Quaternion
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from risc_visual.browser.marker_scene import Action, Look, Placement, Shape
from risc_visual.browser.page import SHAPES
from risc_visual.browser.ros import live_view
from risc_visual.drawing.airframes import AIRFRAMES
from risc_visual.drawing.cast import View
from risc_visual.drawing.ros import markers
from risc_visual.drawing.scenery import load_scenery

CONFIG = pathlib.Path(__file__).parents[1] / "config"
HEAD = markers.header()
AT_M = (1.0, 2.0, 3.0)


def converted(message):
    return live_view.marker_from_msg(message)


def everything_that_is_drawn():
    scenery = load_scenery()
    view = View("fluffy_II", 0, AT_M, (0.0, 0.0, 0.0, 1.0), AIRFRAMES["ardrone"], (0.3, 0.7, 1.0), False)
    found = markers.net_markers(scenery.net, 3.0) + markers.grid_markers(scenery.grid, 3.0)
    found += markers.camera_markers(scenery.cameras, 3.0) + markers.body_markers(HEAD, [("fluffy_II", [AT_M])], 1.0)
    found += markers.vehicle_markers(HEAD, [view], 1.0) + markers.vehicle_labels(HEAD, [view], 0.8, 1.0)
    found += markers.pendulum_markers(HEAD, "Pendulum_tip", AT_M, AT_M, 1.0)
    found += markers.landmark_markers(HEAD, [("Green_pink", AT_M)], 1.0, {})
    found += markers.landmark_labels(HEAD, [("Green_pink", AT_M)], 0.8, 1.0)
    found += markers.trail_markers(HEAD, "quad_line", 0, [(3, [AT_M, AT_M], 0.5)], (1.0, 0.0, 0.0), 0.04, 1.0)
    found += markers.reference_markers(HEAD, 0, "fluffy_II", AT_M, True, 1.0)
    found += [
        markers.covariance_marker(HEAD, AT_M, (0.1, 0.1, 0.1), 1.0),
        markers.mode_marker(HEAD, 0, "fluffy_II", True, "", 1.0),
        markers.battery_marker(HEAD, 0, "fluffy_II", 80.0, 1.0),
        markers.title_marker(HEAD, "circles3", 1.0),
    ]
    return found


def test_everything_that_is_drawn_for_rviz_can_be_shown():
    found = everything_that_is_drawn()
    shown = [converted(message) for message in found]
    assert None not in shown
    assert {marker.look.shape for marker in shown} <= SHAPES
    assert len({(marker.ns, marker.marker_id, marker.look.shape) for marker in shown}) > 90


def test_every_topic_that_rviz_shows_is_shown():
    """Of every configuration; a display's kind is that of its topic's messages."""
    wanted = set()
    for path in CONFIG.glob("*.rviz"):
        displays = yaml.safe_load(path.read_text(encoding="utf-8"))["Visualization Manager"]["Displays"]
        wanted |= {(item["Class"], item["Marker Topic"].lstrip("/")) for item in displays if "Marker Topic" in item}
    shown = {("rviz/MarkerArray", topic) for topic in live_view.WHOLE + live_view.ARRAYS}
    shown |= {("rviz/Marker", topic) for topic in live_view.SINGLE}
    in_the_panel = {("rviz/Marker", "Ctrl_Status"), ("rviz/Marker", "Battery_Status")}
    assert wanted and wanted - shown == in_the_panel


def test_every_part_of_a_message_arrives():
    stamp = markers.header().stamp.from_sec(12.5)
    message = markers.marker(
        markers.header(stamp, "/fluffy_II/camera"),
        "quad_line",
        7,
        Marker.LINE_STRIP,
        AT_M,
        (0.01, 0.0, 0.0),
        (1.0, 0.5, 0.0, 0.25),
        2.5,
        Quaternion(0.0, 0.0, 2.0, 0.0),
        [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)],
        "text",
    )
    message.colors = [ColorRGBA(1.0, 0.0, 0.0, 1.0), ColorRGBA(0.0, 1.0, 0.0, 1.0)]
    found = converted(message)
    assert (found.ns, found.marker_id, found.action) == ("quad_line", 7, Action.ADD)
    assert found.look == Look(
        Shape.LINE_STRIP,
        (0.01, 0.0, 0.0),
        (1.0, 0.5, 0.0, 0.25),
        ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
        ((1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)),
        "text",
    )
    assert found.placement == Placement(AT_M, (0.0, 0.0, 1.0, 0.0)), "made a unit quaternion"
    assert (found.frame, found.stamp_s, found.lifetime_s) == ("fluffy_II/camera", 12.5, 2.5)


def test_an_orientation_that_nobody_has_set_is_no_turn():
    assert converted(Marker(type=Marker.CUBE)).placement.quaternion == (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_numbers_that_are_none_are_not_shown(bad):
    message = markers.net_markers(load_scenery().net, 1.0)[4]
    assert converted(message) is not None
    message.points[3].y = bad
    assert converted(message) is None
    message = markers.title_marker(HEAD, "x", 1.0)
    message.pose.position.x = bad
    assert converted(message) is None
    message = markers.title_marker(HEAD, "x", 1.0)
    message.pose.orientation = Quaternion(bad, 0.0, 0.0, 1.0)
    assert converted(message) is None
    message = markers.title_marker(HEAD, "x", 1.0)
    message.color = ColorRGBA(1.0, bad, 0.0, 1.0)  # a new one: markers share theirs
    assert converted(message) is None
    message = markers.net_markers(load_scenery().net, 1.0)[4]
    message.colors = [ColorRGBA(1.0, 0.0, bad, 1.0)]
    assert converted(message) is None


def test_a_type_or_action_of_no_meaning_is_not_shown():
    assert converted(Marker(type=12)) is None
    assert converted(Marker(action=1)) is None
    assert converted(Marker(type=Marker.MESH_RESOURCE)).look.shape not in SHAPES
    assert converted(Marker(action=Marker.DELETEALL)).action == Action.DELETE_ALL
