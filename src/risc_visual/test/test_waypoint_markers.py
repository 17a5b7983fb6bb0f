"""Waypoints: place, heading and names."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from visualization_msgs.msg import Marker

from risc_msgs.msg import Waypoint, Waypoints
from risc_visual.cast import Index
from risc_visual.ros import markers
from risc_visual.ros.conversions import waypoints_from_msg

HEAD = markers.header()
NAN = float("nan")


def message(*entries):
    return Waypoints(Obj=[Waypoint(*entry) for entry in entries])


@pytest.mark.parametrize(
    "heading_deg, nose",
    [(0, (1, 0, 0)), (90, (0, -1, 0)), (-90, (0, 1, 0)), (180, (-1, 0, 0)), (45, (0.5**0.5, -(0.5**0.5), 0))],
)
def test_heading_is_clockwise_from_above(heading_deg, nose):
    (arrow,) = markers.heading_markers(
        HEAD, Index(), waypoints_from_msg(message(("Raven", 1, 2, 3, heading_deg))), 0.4, 1.0
    )
    turn = arrow.pose.orientation
    np.testing.assert_allclose(Rotation.from_quat((turn.x, turn.y, turn.z, turn.w)).apply((1, 0, 0)), nose, atol=1e-12)
    assert (arrow.type, arrow.scale.x, arrow.scale.y, arrow.scale.z) == (Marker.ARROW, 0.255, 0.07, 0.07)
    assert (arrow.pose.position.x, arrow.pose.position.y, arrow.pose.position.z) == (1, 2, 3)


def test_balls_arrows_and_names_share_namespace_and_id():
    waypoints = waypoints_from_msg(message(("Raven", 1, 2, 3, 0), ("Kahn", 0, 0, 1, 0)))
    index = Index()
    balls = markers.waypoint_markers(HEAD, index, waypoints, 0.4, 1.0)
    labels = markers.waypoint_labels(HEAD, index, waypoints, 0.8, 1.0)
    arrows = markers.heading_markers(HEAD, index, waypoints, 0.4, 1.0)
    for found in (balls, labels, arrows):
        assert [(m.ns, m.id) for m in found] == [("Raven", 0), ("Kahn", 1)]
        assert all(m.lifetime.to_sec() == 1.0 and m.header.frame_id == "cortex" for m in found)
    assert [m.text for m in labels] == ["Raven", "Kahn"]
    assert labels[0].pose.position.z == pytest.approx(3.3)
    assert {m.scale.x for m in balls} == {0.17}
    swapped = markers.waypoint_markers(HEAD, index, waypoints[::-1], 0.4, 1.0)
    assert [(m.ns, m.id) for m in swapped] == [("Kahn", 1), ("Raven", 0)]


def test_names_that_repeat_or_lack_have_ids_of_their_own():
    waypoints = waypoints_from_msg(message(("", 0, 0, 1, 0), ("", 1, 0, 1, 0), ("Raven", 0, 1, 1, 0)))
    found = markers.waypoint_markers(HEAD, Index([("Raven", 1)]), waypoints, 0.4, 1.0)
    assert [(m.ns, m.id) for m in found] == [("waypoint", 1), ("waypoint", 2), ("Raven", 0)]


def test_numbers_that_are_none_are_not_drawn():
    entries = (("a", NAN, 0, 1, 0), ("b", 0, 0, 1, NAN), ("c", 0, 0, float("inf"), 0), ("d", 0, 0, 1, 0))
    assert [item.name for item in waypoints_from_msg(message(*entries))] == ["d"]
