"""Waypoints: place, heading, names, and the paths of the vehicles that have one."""

import time

import genpy
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from risc_msgs.msg import Cortex, States, Waypoint, Waypoints
from risc_visual.drawing.params import WaypointParams
from risc_visual.drawing.ros.waypoint_drawing import WaypointDrawing
from risc_visual.drawing.trails import MAX_PIECES

NAN = float("nan")
NOW_S = 100.0


def message(*entries):
    return Waypoints(Obj=[Waypoint(*entry) for entry in entries])


def drawn(*entries, names=()):
    """(balls, arrows, labels) of waypoints."""
    return WaypointDrawing(WaypointParams(), names).waypoints(message(*entries), NOW_S)


@pytest.mark.parametrize(
    "heading_deg, nose",
    [(0, (1, 0, 0)), (90, (0, -1, 0)), (-90, (0, 1, 0)), (180, (-1, 0, 0)), (45, (0.5**0.5, -(0.5**0.5), 0))],
)
def test_heading_is_clockwise_from_above(heading_deg, nose):
    _, (arrow,), _ = drawn(("Raven", 1, 2, 3, heading_deg))
    turn = arrow.pose.orientation
    np.testing.assert_allclose(Rotation.from_quat((turn.x, turn.y, turn.z, turn.w)).apply((1, 0, 0)), nose, atol=1e-12)
    assert (arrow.type, arrow.scale.x, arrow.scale.y, arrow.scale.z) == (Marker.ARROW, 0.255, 0.07, 0.07)
    assert (arrow.pose.position.x, arrow.pose.position.y, arrow.pose.position.z) == (1, 2, 3)


def test_balls_arrows_and_names_share_namespace_and_id():
    drawing = WaypointDrawing(WaypointParams(), ())
    entries = ("Raven", 1, 2, 3, 0), ("Kahn", 0, 0, 1, 0)
    balls, arrows, labels = drawing.waypoints(message(*entries), NOW_S)
    for found in (balls, labels, arrows):
        assert [(m.ns, m.id) for m in found] == [("Raven", 0), ("Kahn", 1)]
        assert all(m.lifetime.to_sec() == 1.0 and m.header.frame_id == "cortex" for m in found)
    assert [m.text for m in labels] == ["Raven", "Kahn"]
    assert labels[0].pose.position.z == pytest.approx(3.3)
    assert {m.scale.x for m in balls} == {0.17}
    swapped, _, _ = drawing.waypoints(message(*entries[::-1]), NOW_S)
    assert [(m.ns, m.id) for m in swapped] == [("Kahn", 1), ("Raven", 0)]


def test_names_that_repeat_or_lack_have_ids_of_their_own():
    balls, _, _ = drawn(("", 0, 0, 1, 0), ("", 1, 0, 1, 0), ("Raven", 0, 1, 1, 0), names=["Raven"])
    assert [(m.ns, m.id) for m in balls] == [("waypoint", 1), ("waypoint", 2), ("Raven", 0)]


def test_numbers_that_are_none_are_not_drawn():
    entries = (("a", NAN, 0, 1, 0), ("b", 0, 0, 1, NAN), ("c", 0, 0, float("inf"), 0), ("d", 0, 0, 1, 0))
    assert [m.text for m in drawn(*entries)[2]] == ["d"]


def flown(scene, begin_s, seconds=0.4):
    """Paths after two vehicles have flown along x for a while from a time on, drawn at 25 Hz."""
    for now_s in np.arange(begin_s, begin_s + seconds, 0.04):
        states = [States(name, True, now_s - begin_s, 0.0, 1.0, *[0.0] * 9) for name in ("Raven", "Kahn")]
        found = scene.paths(Cortex(Header(stamp=genpy.Time.from_sec(now_s)), states), now_s)
    return found


def told(**params):
    """Drawing that got a waypoint of Kahn, the second of two vehicles, at NOW_S."""
    scene = WaypointDrawing(WaypointParams(**params), ["Raven", "Kahn"])
    balls, arrows, labels = scene.waypoints(message(("Kahn", 0, 0, 1, 0)), NOW_S)
    assert [m.type for m in balls + arrows + labels] == [Marker.SPHERE, Marker.ARROW, Marker.TEXT_VIEW_FACING]
    return scene


def test_only_who_has_a_waypoint_has_a_path():
    (path,) = flown(told(), NOW_S)
    assert (path.ns, path.id) == ("way_trail", MAX_PIECES) and len(path.points) > 5


@pytest.mark.parametrize("later_s, paths", [(0.5, 1), (1.1, 0), (-60.0, 0)])
def test_a_waypoint_that_is_not_sent_again_is_no_news(later_s, paths):
    """Only ROS time counts: a bag may be played slowly, or from the beginning."""
    scene = told(lifetime_s=1.0)
    assert len(flown(scene, NOW_S)) == 1
    assert len(flown(scene, NOW_S + later_s)) == paths


def test_a_path_lasts_while_a_bag_is_played_slowly():
    scene = told(lifetime_s=0.5)
    time.sleep(0.6)
    assert len(flown(scene, NOW_S)) == 1
