"""risc_visual.browser.marker_scene: what is to be drawn of the markers that come in. The test turns the clock."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from risc_visual.browser.marker_scene import (
    HERE,
    Action,
    Draw,
    Erase,
    Look,
    MarkerScene,
    MarkerValue,
    Move,
    Placement,
    Shape,
)

BALL = Look(Shape.SPHERE, (0.1, 0.1, 0.1), (1.0, 0.0, 0.0, 1.0))
LIFE_S = 1.0


def nowhere(_frame, _stamp_s):
    raise AssertionError("markers in the fixed frame need no other")


def placed(x, y, z, angles=(0.0, 0.0, 0.0)):
    return Placement((x, y, z), tuple(Rotation.from_euler("xyz", angles).as_quat().tolist()))


def marker(marker_id=1, ns="fluffy_II", look=BALL, at=HERE, **more):
    return MarkerValue(ns, marker_id, more.pop("action", Action.ADD), look, at, lifetime_s=LIFE_S, **more)


def pose_matrix(placement):
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(placement.quaternion).as_matrix()
    matrix[:3, 3] = placement.position_m
    return matrix


class Screen:
    """Does what it is told, as a viewer with a tree of nodes would."""

    def __init__(self):
        self.groups, self.markers = {}, {}

    def apply(self, changes):
        for change in changes:
            depth = change.path.count("/")
            if isinstance(change, Draw):
                assert depth == 3
                self.markers[change.path] = (change.look, change.placement)
            elif isinstance(change, Erase):
                assert depth == 3 or not any(path.startswith(change.path + "/") for path in self.markers)
                del (self.markers if depth == 3 else self.groups)[change.path]
            elif depth == 2:
                self.groups[change.path] = change.placement
            else:
                self.markers[change.path] = (self.markers[change.path][0], change.placement)
        return changes

    def seen(self):
        """{path: (Look, (4, 4) pose in the fixed frame)}."""
        return {
            path: (look, pose_matrix(self.groups[path.rsplit("/", 1)[0]]) @ pose_matrix(placement))
            for path, (look, placement) in self.markers.items()
        }


class Viewer:
    """A scene and a screen that shows it."""

    def __init__(self):
        self.scene, self.screen, self.now_s = MarkerScene(), Screen(), 50.0
        self.frames = None

    def note(self, *markers, topic="Quad_Markers"):
        self.scene.note(topic, markers, self.now_s)

    def turn(self, seconds=0.1):
        """Some time passes; returns what changed."""
        self.now_s += seconds
        lookup = nowhere if self.frames is None else lambda frame, stamp_s: self.frames.get((frame, stamp_s))
        return self.screen.apply(self.scene.changes(self.now_s, lookup))

    def positions(self):
        return {path: tuple(pose[:3, 3].round(6)) for path, (_, pose) in self.screen.seen().items()}


def vehicle(at):
    """Three parts that move as one."""
    arm = Look(Shape.LINE_LIST, (0.02, 0.0, 0.0), (1.0, 1.0, 1.0, 1.0), ((0.0, 0.0, 0.0), (0.2, 0.0, 0.0)))
    parts = ((BALL, HERE), (arm, HERE), (BALL, placed(0.2, 0.1, 0.0)))
    return [marker(k, look=look, at=at.of(own)) for k, (look, own) in enumerate(parts, start=1)]


def test_a_new_marker_is_drawn_once():
    viewer = Viewer()
    viewer.note(marker(at=placed(1.0, 2.0, 3.0)))
    group, drawn = viewer.turn()
    assert group == Move("/Quad_Markers/fluffy_II", placed(1.0, 2.0, 3.0))
    assert (drawn.path, drawn.look) == ("/Quad_Markers/fluffy_II/1", BALL)
    assert drawn.placement.is_near(HERE)
    viewer.note(marker(at=placed(1.0, 2.0, 3.0)))
    assert viewer.turn() == [], "the same again is no news"


def test_a_vehicle_that_flies_is_one_move():
    viewer = Viewer()
    viewer.note(*vehicle(placed(0.0, 0.0, 1.0)))
    viewer.turn()
    for k in range(20):
        at = placed(0.1 * k, -0.05 * k, 1.0, (0.3, -0.2, 0.4 * k))
        viewer.note(*vehicle(at))
        changes = viewer.turn()
        assert [(type(change), change.path) for change in changes] == [(Move, "/Quad_Markers/fluffy_II")]
        pose = viewer.screen.seen()["/Quad_Markers/fluffy_II/3"][1]
        np.testing.assert_allclose(pose, pose_matrix(at) @ pose_matrix(placed(0.2, 0.1, 0.0)), atol=1e-4)


def test_what_is_not_rigid_moves_by_itself():
    viewer = Viewer()
    viewer.note(marker(1), marker(2, at=placed(1.0, 0.0, 0.0)))
    viewer.turn()
    viewer.note(marker(1), marker(2, at=placed(1.0, 0.5, 0.0)))
    (move,) = viewer.turn()
    assert move.path == "/Quad_Markers/fluffy_II/2"
    assert move.placement.is_near(placed(1.0, 0.5, 0.0))


def test_only_what_looks_different_is_drawn_anew():
    viewer = Viewer()
    viewer.note(*vehicle(HERE))
    viewer.turn()
    grey = replace(BALL, rgba=(0.6, 0.6, 0.6, 0.4))
    parts = vehicle(HERE)
    viewer.note(parts[0], parts[1], replace(parts[2], look=grey))
    (change,) = viewer.turn()
    assert (type(change), change.path, change.look) == (Draw, "/Quad_Markers/fluffy_II/3", grey)


def test_what_nobody_sends_any_more_vanishes():
    viewer = Viewer()
    viewer.note(marker(1), marker(2))
    viewer.turn()
    viewer.note(marker(1))
    viewer.now_s += LIFE_S - 0.11
    assert viewer.turn(0.0) == []
    assert viewer.turn(0.02) == [Erase("/Quad_Markers/fluffy_II/2")]
    viewer.note(marker(1))
    assert viewer.turn(LIFE_S - 0.01) == []
    assert viewer.turn(0.02) == [Erase("/Quad_Markers/fluffy_II/1"), Erase("/Quad_Markers/fluffy_II")]
    assert (viewer.screen.markers, viewer.screen.groups) == ({}, {})
    viewer.note(marker(1))
    assert len(viewer.turn()) == 2, "and may come again"


def test_without_a_lifetime_it_stays():
    viewer = Viewer()
    viewer.note(replace(marker(), lifetime_s=0.0))
    viewer.turn()
    assert viewer.turn(1e6) == []


def test_the_others_stay_where_they_are_when_the_first_goes():
    viewer = Viewer()
    viewer.note(*vehicle(placed(1.0, 1.0, 1.0, (0.0, 0.0, 1.0))))
    viewer.turn()
    before = viewer.screen.seen()
    viewer.note(marker(1, action=Action.DELETE))
    viewer.turn()
    after = viewer.screen.seen()
    assert set(before) - set(after) == {"/Quad_Markers/fluffy_II/1"}
    for path, (_, pose) in after.items():
        np.testing.assert_allclose(pose, before[path][1], atol=1e-4)


def test_delete_and_delete_all():
    viewer = Viewer()
    viewer.note(marker(1), marker(2), marker(1, ns="Raven"))
    viewer.note(marker(1), topic="Quad_Labels")
    viewer.turn()
    viewer.note(marker(2, action=Action.DELETE), marker(7, action=Action.DELETE), marker(1, "x", action=Action.DELETE))
    assert viewer.turn() == [Erase("/Quad_Markers/fluffy_II/2")]
    viewer.note(marker(9, ns="", action=Action.DELETE_ALL), marker(5, ns="Raven"))
    viewer.turn()
    assert set(viewer.screen.markers) == {"/Quad_Markers/Raven/5", "/Quad_Labels/fluffy_II/1"}


def test_a_marker_that_comes_and_goes_between_two_turns_is_never_drawn():
    viewer = Viewer()
    viewer.note(marker(1), marker(1, action=Action.DELETE))
    assert viewer.turn() == []


@pytest.mark.parametrize("ns", ["risc1/vehicles", "", "a b", "Ä%/-"])
def test_every_namespace_is_a_path_of_its_own(ns):
    viewer = Viewer()
    viewer.note(marker(1, ns=ns), marker(1, ns="other"))
    viewer.turn()
    assert len(viewer.screen.markers) == 2
    assert all(path.count("/") == 3 and "//" not in path for path in viewer.screen.markers)


def test_a_marker_in_another_frame_waits_for_it():
    viewer = Viewer()
    viewer.frames = {}
    ray = marker(1, at=placed(0.0, 0.0, 2.0), frame="fluffy_II/camera", stamp_s=7.5)
    viewer.note(ray)
    assert viewer.turn() == []
    camera = placed(1.0, 0.0, 1.0, (0.0, 0.5 * math.pi, 0.0))  # its z axis is x of the fixed frame
    viewer.frames = {("fluffy_II/camera", 7.5): camera}
    viewer.turn()
    assert viewer.positions() == {"/Quad_Markers/fluffy_II/1": (3.0, 0.0, 1.0)}


def test_a_marker_whose_frame_stays_unknown_is_not_shown_at_its_old_place():
    viewer = Viewer()
    viewer.frames = {("camera", 1.0): HERE}
    viewer.note(marker(1, frame="camera", stamp_s=1.0))
    viewer.turn()
    assert viewer.screen.markers
    for k in range(15):
        viewer.note(marker(1, frame="camera", stamp_s=2.0 + k))
        viewer.turn()
    assert viewer.screen.markers == {}


def test_forgotten_markers_are_drawn_again():
    viewer = Viewer()
    viewer.note(marker())
    first = viewer.turn()
    viewer.scene.forget()
    viewer.note(marker())
    assert viewer.turn() == first


def test_any_course_of_events_shows_what_rviz_would():
    """Against the plain rule: a marker is where it was said last, unless it was deleted or has expired."""
    rng = np.random.default_rng(4)
    viewer, plain = Viewer(), {}
    for _ in range(400):
        for _ in range(rng.integers(0, 6)):
            ns, marker_id = "n%d" % rng.integers(2), int(rng.integers(4))
            path = "/Quad_Markers/%s/%d" % (ns, marker_id)
            dice = rng.random()
            if dice < 0.1:
                viewer.note(marker(marker_id, ns, action=Action.DELETE))
                plain.pop(path, None)
            elif dice < 0.12:
                viewer.note(marker(0, "", action=Action.DELETE_ALL))
                plain.clear()
            else:
                at = placed(*rng.uniform(-2.0, 2.0, 3), rng.uniform(-1.0, 1.0, 3))
                look = replace(BALL, text=str(rng.integers(3)))
                viewer.note(marker(marker_id, ns, look, at))
                plain[path] = (look, at, viewer.now_s + LIFE_S)
        viewer.turn(float(rng.uniform(0.0, 0.4)))
        plain = {path: entry for path, entry in plain.items() if entry[2] > viewer.now_s}
        seen = viewer.screen.seen()
        assert set(seen) == set(plain)
        for path, (look, at, _) in plain.items():
            assert seen[path][0] == look
            np.testing.assert_allclose(seen[path][1], pose_matrix(at), atol=2e-4)
