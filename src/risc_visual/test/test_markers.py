"""Markers for rviz: legacy names and colours, unique and stable ids, lifetimes, numbers that rviz accepts."""

import io
import math

import numpy as np
import pytest
from drawn import HEAD, NOW_S, STAMP, cortex, everything, landmarks, mocap, path, rays, scene, twist
from visualization_msgs.msg import Marker, MarkerArray

from risc_control.safety import FailsafeLevel, Verdict
from risc_lab.frames import rotation_body_to_cortex
from risc_visual.drawing.ros import markers
from risc_visual.drawing.ros.airframes import parts_of
from risc_visual.drawing.trails import MAX_PIECES


@pytest.mark.parametrize("topic", sorted(everything()))
def test_every_marker_is_one_that_rviz_accepts(topic):
    found = everything(lost=("Kahn",))[topic]
    assert found
    assert len({(m.ns, m.id) for m in found}) == len(found)
    for m in found:
        assert m.header.frame_id == "cortex" and m.action == Marker.ADD and m.ns
        assert m.lifetime.to_sec() > 0.0  # markers that are not sent any more vanish
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
    assert ids["Cameras"] == [("Camera", k) for k in range(48)]
    assert {ns for ns, _ in ids["Quad_Markers"]} == {"Raven", "Kahn", "Pendulum_tip"}
    assert ids["Quad_Labels"] == [("Kahn", 2), ("Pendulum_tip", 1), ("Raven", 1)]
    assert ids["Ctrl_Status"] == [("controller_status", 0), ("controller_status", 1)]
    assert ids["angle_lines"] == [
        ("risc1", 0), ("risc1/names", 0), ("risc1/names", 4), ("risc1/vehicles", 4),
    ]  # fmt: skip


def test_markers_nobody_sees_are_left_out():
    nan = float("nan")
    bodies = {"Raven": [(0, 0, 1), (nan, nan, nan), (9999.999, 9999.999, 9999.999)], "Kahn": [(nan, nan, nan)]}
    (body,) = scene().bodies(mocap(bodies))
    assert body.ns == "Raven" and [(p.x, p.y, p.z) for p in body.points] == [(0, 0, 1)]
    assert body.header.stamp == STAMP


def test_parts_sit_where_the_body_carries_them():
    R = rotation_body_to_cortex(*np.radians((2.0, -3.0, 100.0)))
    found, _ = scene().vehicles(cortex({"Raven": (1.0, 2.0, 3.0)}, psi_deg=100.0), NOW_S)
    parts = parts_of("ardrone")
    assert [m.id for m in found] == list(range(1, len(parts) + 1))
    for part, m in zip(parts, found):
        at_m = (m.pose.position.x, m.pose.position.y, m.pose.position.z)
        np.testing.assert_allclose(at_m, np.array([1.0, 2.0, 3.0]) + R @ part.centre_m, atol=1e-12)


def test_lost_vehicle_keeps_its_ids_and_turns_grey():
    drawing, places_m = scene(), {"Raven": (0.0, 0.5, 1.0)}
    seen, _ = drawing.vehicles(cortex(places_m), NOW_S)
    lost, (label,) = drawing.vehicles(cortex(places_m, lost=("Raven",)), NOW_S)
    assert [(m.ns, m.id) for m in seen] == [(m.ns, m.id) for m in lost]
    assert {(m.color.r, m.color.g, m.color.b) for m in lost} == {(0.6, 0.6, 0.6)}
    assert label.text == "Raven (lost)"


def test_landmark_colours():
    spheres, _ = scene().landmarks(landmarks(dict.fromkeys(("Orange_blue", "Pink_blue", "new"), (0, 0, 1))))
    colours = [(m.color.r, m.color.g, m.color.b, m.color.a) for m in spheres]
    assert colours == [(1, 0.6, 0, 0.7), (1, 0, 0.5, 0.7), (1, 1, 1, 0.4)]


def test_mode_text():
    drawing = scene()
    alone = drawing.mode(HEAD, 0, "", True)
    assert (alone.text, alone.color.g, alone.scale.z) == ("Autonomous", 1.0, 0.3)
    manual = drawing.mode(HEAD, 1, "Raven", False)
    assert (manual.text, manual.color.r, manual.color.g) == ("Raven: Manual", 1.0, 0.4)
    drawing.note_safety(1, Verdict(FailsafeLevel.HOLD, "state 120 ms old"))
    held = drawing.mode(HEAD, 1, "Raven", True)
    assert (held.text, held.color.r, held.color.g) == ("Raven: hold: state 120 ms old", 1.0, 0.0)


@pytest.mark.parametrize("percent, red, green", [(100, 0, 1), (50, 1, 1), (0, 1, 0), (130, 0, 1), (-1, 1, 0)])
def test_battery_turns_from_green_to_red(percent, red, green):
    m = scene().battery(HEAD, 0, "", percent)
    assert (m.color.r, m.color.g, m.color.b) == (red, green, 0)
    assert m.text == "Battery: %d%%" % percent


def test_lines_of_the_lists_of_vehicles_are_apart():
    for topic, step_m in (("Ctrl_Status", -0.26), ("Battery_Status", 0.26)):
        first, second = (m.pose.position for m in everything()[topic])
        assert (second.x - first.x, second.y - first.y, second.z - first.z) == pytest.approx((step_m, 0.0, step_m))


def test_path_pales_with_age():
    found = path(seconds=35.0)
    assert [m.color.a for m in found] == sorted(m.color.a for m in found)
    assert 0.25 < found[0].color.a < 0.9 and found[-1].color.a == 1.0
    assert {(m.ns, m.id // MAX_PIECES, m.scale.x) for m in found} == {("traj_line", 1, 0.02)}


def test_covariance_is_three_sigma_wide():
    m = scene().covariance(twist((0, 0, 1), (1e-4, 4e-4, 9e-4)), 0)
    np.testing.assert_allclose((m.scale.x, m.scale.y, m.scale.z), (0.03, 0.06, 0.09))


def test_rays_begin_in_the_camera_at_the_time_of_the_picture():
    pen = markers.Pen(0.3, markers.header(STAMP, "fluffy_II/camera"))
    found = markers.ray_markers(pen, "risc1", rays(), 0.4)
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
