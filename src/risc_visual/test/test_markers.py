"""What rviz is told: legacy names and colours, unique and stable ids, lifetimes, numbers that rviz accepts."""

import io
import math

import genpy
import numpy as np
import pytest
from visualization_msgs.msg import Marker, MarkerArray

from risc_visual.drawing.cast import Cast, Index, Pose
from risc_visual.drawing.rays import Ray
from risc_visual.drawing.ros import markers
from risc_visual.drawing.scenery import load_scenery
from risc_visual.drawing.trails import MAX_PIECES
from risc_visual.drawing.waypoints import Waypoint

STAMP = genpy.Time(100, 5)
HEAD = markers.header(STAMP)


def views(*names, lost=()):
    cast = Cast(Index())
    cast.views([Pose(name, True, (float(k), 0.5, 1.0), (0.1, -0.2, 2.0)) for k, name in enumerate(names)])
    return cast.views(
        [Pose(name, name not in lost, (float(k), 0.5, 1.0), (0.1, -0.2, 2.0)) for k, name in enumerate(names)]
    )


def rays():
    """Two rays with their numbers."""
    return [
        (0, Ray("green", False, (3.5, 1.0, -0.5), 0.04, (0.0, 1.0, 0.0))),
        (4, Ray("risc2", True, (4.0, 0.0, 0.0), 0.04, (1.0, 0.8, 0.25))),
    ]


def everything():
    scenery = load_scenery()
    waypoints = [Waypoint("Raven", 1, (1.0, 2.0, 1.0), 0.5), Waypoint("", 1, (0.0, 0.0, 1.0), 0.0)]
    numbers = Index()
    return {
        "angle_lines": markers.ray_markers(HEAD, "risc1", rays(), 0.4, 0.3)
        + markers.ray_labels(HEAD, "risc1", rays(), 0.8, 0.3),
        "Way_Markers": markers.waypoint_markers(HEAD, numbers, waypoints, 0.4, 1.0),
        "Heading_Markers": markers.heading_markers(HEAD, numbers, waypoints, 0.4, 1.0),
        "Way_Labels": markers.waypoint_labels(HEAD, numbers, waypoints[:1], 0.8, 1.0),
        "net": markers.net_markers(scenery.net, 3.0),
        "Grid": markers.grid_markers(scenery.grid, 3.0),
        "Cameras": markers.camera_markers(scenery.cameras, 3.0),
        "Cortex_Markers": markers.body_markers(HEAD, [("Raven", [(0, 0, 1), (0, 0.1, 1)])], 1.0),
        "Quad_Markers": markers.vehicle_markers(HEAD, views("Raven", "Kahn", lost=("Kahn",)), 1.0)
        + markers.pendulum_markers(HEAD, "Pendulum_tip", (0, 0, 2), (0, 0, 1), 1.0),
        "Quad_Labels": markers.vehicle_labels(HEAD, views("Raven", "Kahn"), 0.8, 1.0)
        + [markers.pendulum_label(HEAD, "Pendulum_tip", (0, 0, 2), 0.8, 1.0)],
        "Land_Markers": markers.landmark_markers(HEAD, [("Pink_blue", (1, 2, 3))], 1.5, {}),
        "Land_Labels": markers.landmark_labels(HEAD, [("Pink_blue", (1, 2, 3))], 0.8, 1.5),
        "Ctrl_Status": [markers.mode_marker(HEAD, k, name, True, "", 1.5) for k, name in enumerate(("a", "b"))],
        "Battery_Status": [markers.battery_marker(HEAD, k, name, 70.0, 1.5) for k, name in enumerate(("a", "b"))],
        "Cov_Quad": [markers.covariance_marker(HEAD, (0, 0, 1), (1e-4, 4e-4, 9e-4), 1.0)],
        "desired_trajectory": markers.trail_markers(
            HEAD, "traj_line", 1, [(3, [(0, 0, 1), (0, 1, 1)], 0.5)], (0, 1, 0), 0.02, 3.0
        )
        + markers.reference_markers(HEAD, 0, "Raven", (0, 0, 1), True, 0.5),
        "desired_trajectory_name": [markers.title_marker(HEAD, "Circle", 1.5)],
    }


@pytest.mark.parametrize("topic", sorted(everything()))
def test_every_marker_is_one_that_rviz_accepts(topic):
    found = everything()[topic]
    assert found
    assert len({(m.ns, m.id) for m in found}) == len(found)
    for m in found:
        assert m.header.frame_id == "cortex" and m.action == Marker.ADD and m.ns
        assert m.lifetime.to_sec() > 0.0  # what is not sent any more vanishes
        turn = m.pose.orientation
        assert math.hypot(turn.x, turn.y, turn.z, turn.w) == pytest.approx(1.0)
        rgba = (m.color.r, m.color.g, m.color.b, m.color.a)
        assert all(0.0 <= value <= 1.0 for value in rgba) and m.color.a > 0.0
        assert m.scale.z > 0.0 if m.type == Marker.TEXT_VIEW_FACING else m.scale.x > 0.0
        if m.type in (Marker.SPHERE, Marker.CUBE, Marker.CYLINDER, Marker.SPHERE_LIST):
            assert min(m.scale.x, m.scale.y, m.scale.z) > 0.0
        if m.type == Marker.LINE_LIST:
            assert len(m.points) % 2 == 0 and m.points
        if m.type == Marker.ARROW:
            assert len(m.points) == 2 if m.points else min(m.scale.x, m.scale.y, m.scale.z) > 0.0
    buffer = io.BytesIO()
    MarkerArray(found).serialize(buffer)
    assert len(MarkerArray().deserialize(buffer.getvalue()).markers) == len(found)


def test_namespaces_and_ids_of_the_original():
    ids = {topic: sorted((m.ns, m.id) for m in found) for topic, found in everything().items()}
    assert ids["net"] == [("Net", k) for k in range(5)]
    assert ids["Grid"] == [("grid", k) for k in range(20)]
    assert ids["Cameras"][:16] == [("Camera", k) for k in range(16)]
    assert {ns for ns, _ in ids["Quad_Markers"]} == {"Raven", "Kahn", "Pendulum_tip"}
    assert ids["Quad_Labels"] == [("Kahn", 2), ("Pendulum_tip", 1), ("Raven", 1)]
    assert ids["Ctrl_Status"] == [("controller_status", 0), ("controller_status", 1)]
    assert ids["angle_lines"] == [
        ("risc1", 0), ("risc1/names", 0), ("risc1/names", 4), ("risc1/vehicles", 4),
    ]  # fmt: skip
    assert ids["desired_trajectory"][0] == ("traj_line", MAX_PIECES + 3)


def test_markers_nobody_sees_are_left_out():
    nan = float("nan")
    bodies = [("Raven", [(0, 0, 1), (nan, nan, nan), (9999.999, 9999.999, 9999.999)]), ("Kahn", [(nan, nan, nan)])]
    (body,) = markers.body_markers(HEAD, bodies, 1.0)
    assert body.ns == "Raven" and [(p.x, p.y, p.z) for p in body.points] == [(0, 0, 1)]
    assert body.header.stamp == STAMP


def test_parts_sit_where_the_body_carries_them():
    (view,) = Cast(Index()).views([Pose("Raven", True, (1.0, 2.0, 3.0), (0.3, -0.4, 2.5))])
    from risc_lab.frames import rotation_body_to_cortex

    R = rotation_body_to_cortex(0.3, -0.4, 2.5)
    found = markers.vehicle_markers(HEAD, [view], 1.0)
    assert [m.id for m in found] == list(range(1, len(view.parts) + 1))
    for part, m in zip(view.parts, found):
        at_m = (m.pose.position.x, m.pose.position.y, m.pose.position.z)
        np.testing.assert_allclose(at_m, np.array([1.0, 2.0, 3.0]) + R @ part.centre_m, atol=1e-12)


def test_lost_vehicle_keeps_its_ids_and_turns_grey():
    seen = markers.vehicle_markers(HEAD, views("Raven"), 1.0)
    lost = markers.vehicle_markers(HEAD, views("Raven", lost=("Raven",)), 1.0)
    assert [(m.ns, m.id) for m in seen] == [(m.ns, m.id) for m in lost]
    assert {(m.color.r, m.color.g, m.color.b) for m in lost} == {(0.6, 0.6, 0.6)}
    assert markers.vehicle_labels(HEAD, views("Raven", lost=("Raven",)), 0.8, 1.0)[0].text == "Raven (lost)"


def test_landmark_colours():
    named = [(name, (0, 0, 1)) for name in ("Orange_blue", "Pink_blue", "new")]
    given = {"Orange_blue": (1, 0.6, 0, 0.4), "Pink_blue": (1, 0, 0.5, 0.3)}
    found = markers.landmark_markers(HEAD, named, 1.0, given)
    colours = [(m.color.r, m.color.g, m.color.b, m.color.a) for m in found]
    assert colours == [(1, 0.6, 0, 0.4), (1, 0, 0.5, 0.3), (1, 1, 1, 0.4)]


def test_mode_text():
    alone = markers.mode_marker(HEAD, 0, "", True, "", 1.0)
    assert (alone.text, alone.color.g, alone.scale.z) == ("Autonomous", 1.0, 0.3)
    assert (alone.pose.position.x, alone.pose.position.y, alone.pose.position.z) == (-3, -2, 0)
    manual = markers.mode_marker(HEAD, 1, "Raven", False, "", 1.0)
    assert (manual.text, manual.color.r, manual.color.g) == ("Raven: Manual", 1.0, 0.4)
    held = markers.mode_marker(HEAD, 1, "Raven", True, "hold: state 120 ms old", 1.0)
    assert (held.text, held.color.r, held.color.g) == ("Raven: hold: state 120 ms old", 1.0, 0.0)


@pytest.mark.parametrize("percent, red, green", [(100, 0, 1), (50, 1, 1), (0, 1, 0), (130, 0, 1), (-1, 1, 0)])
def test_battery_turns_from_green_to_red(percent, red, green):
    m = markers.battery_marker(HEAD, 0, "", percent, 1.0)
    assert (m.color.r, m.color.g, m.color.b) == (red, green, 0)
    assert m.text == "Battery: %d%%" % percent


def test_path_pales_with_age():
    pieces = [(0, [(0, 0, 1), (0, 1, 1)], 1.0), (1, [(0, 1, 1), (0, 2, 1)], 0.0)]
    old, new = markers.trail_markers(HEAD, "quad_line", 0, pieces, markers.RED[:3], 0.04, 3.0)
    assert (new.color.r, new.color.g, new.color.b, new.color.a) == (1, 0, 0, 1)
    assert old.color.a == 0.25 and old.scale.x == 0.04


def test_covariance_is_three_sigma_wide():
    m = markers.covariance_marker(HEAD, (0, 0, 1), (1e-4, 4e-4, 9e-4), 1.0)
    np.testing.assert_allclose((m.scale.x, m.scale.y, m.scale.z), (0.03, 0.06, 0.09))


def test_rays_begin_in_the_camera_at_the_time_of_the_picture():
    head = markers.header(STAMP, "fluffy_II/camera")
    found = markers.ray_markers(head, "risc1", rays(), 0.4, 0.3)
    assert {(m.header.frame_id, m.header.stamp) for m in found} == {("fluffy_II/camera", STAMP)}
    assert [[(p.x, p.y, p.z) for p in m.points] for m in found] == [
        [(0.0, 0.0, 0.0), (3.5, 1.0, -0.5)],
        [(0.0, 0.0, 0.0), (4.0, 0.0, 0.0)],
    ]
    assert {(m.lifetime.to_sec(), m.color.a, m.scale.x) for m in found} == {(0.3, 0.4, 0.04)}


def test_forgetting_needs_no_frame_of_a_camera():
    gone = markers.gone_marker("risc1", 3)
    assert (gone.action, gone.ns, gone.id, gone.header.frame_id) == (Marker.DELETE, "risc1", 3, "cortex")
    assert gone.header.stamp.is_zero()
