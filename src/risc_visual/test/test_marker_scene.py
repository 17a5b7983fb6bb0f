"""risc_visual.browser.marker_scene: what a page shows of incoming markers. The clock is simulated."""

import copy
import functools
import math
import pathlib

import genpy
import numpy as np
import pytest
import yaml
from drawn import everything
from geometry_msgs.msg import Point, Pose, Quaternion, Transform, Vector3
from scipy.spatial.transform import Rotation
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from risc_lab.ros.launching import free_tcp_port
from risc_visual.browser import marker_scene
from risc_visual.browser.marker_scene import MarkerScene
from risc_visual.browser.marker_shapes import SHAPES, net_of_sheet, text_picture
from risc_visual.browser.page_server import open_server
from risc_visual.browser.ros import live_view

CONFIG = pathlib.Path(__file__).parents[1] / "config"
LIFE_S = 1.0
PART = "/Quad_Markers/fluffy_II/%d"
CORNERS = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0))


@pytest.fixture(scope="module")
def server():
    opened = open_server("127.0.0.1", free_tcp_port())
    yield opened
    opened.stop()


@pytest.fixture
def view(server):
    shown = View(server)
    yield shown
    shown.scene.clear()


class View:
    """A scene, and what viser shows of it."""

    def __init__(self, server):
        self.scene, self.now_s, self.frames = MarkerScene(server, 2.0, 1.5), 50.0, {}
        self._server = server

    def note(self, *markers, topic="Quad_Markers"):
        return self.scene.note(topic, copy.deepcopy(markers), self.now_s)

    def turn(self, seconds=0.1):
        """Advance the clock and draw; returns how much has changed."""
        self.now_s += seconds
        return self.scene.draw(self.now_s, lambda frame, stamp: self.frames.get((frame, stamp.to_sec())))

    def show(self, *markers):
        """Draw markers; returns viser's handle of the first."""
        self.note(*markers)
        self.turn()
        return self.handle(PART % markers[0].id)

    def handle(self, path):
        return self._server.scene.get_handle_by_name(path)

    def pose(self, path):
        """(4, 4) of a marker in the fixed frame."""
        return matrix(self.handle(path.rsplit("/", 1)[0])) @ matrix(self.handle(path))

    def shown(self):
        """Paths of the markers."""
        return {path for path in self._server.scene._handle_from_node_name if path.count("/") == 3}


def matrix(handle):
    found = np.eye(4)
    found[:3, :3] = Rotation.from_quat(np.roll(handle.wxyz, -1)).as_matrix()
    found[:3, 3] = handle.position
    return found


def placed(x, y, z, angles=(0.0, 0.0, 0.0)):
    """(4, 4)."""
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = Rotation.from_euler("xyz", angles).as_matrix(), (x, y, z)
    return found


def marker(number=1, ns="fluffy_II", at=np.eye(4), shape=Marker.SPHERE, size_m=(0.1,) * 3, points_m=(), **more):
    rgba = more.pop("rgba", (1.0, 0.5, 0.0, 1.0))
    head = Header(frame_id=more.pop("frame", "cortex"), stamp=genpy.Time.from_sec(more.pop("stamp_s", 0.0)))
    turn = Quaternion(*Rotation.from_matrix(at[:3, :3]).as_quat().tolist())
    return Marker(
        header=head, ns=ns, id=number, type=shape, pose=Pose(Point(*at[:3, 3].tolist()), turn), scale=Vector3(*size_m),
        color=ColorRGBA(*rgba), points=[Point(*point) for point in points_m], lifetime=genpy.Duration(LIFE_S), **more,
    )  # fmt: skip


def vehicle(at):
    """Three parts that move as one."""
    arm = {"shape": Marker.LINE_LIST, "size_m": (0.02, 0.0, 0.0), "points_m": CORNERS[:2]}
    return [marker(1, at=at), marker(2, at=at, **arm), marker(3, at=at @ placed(0.2, 0.1, 0.0))]


def test_a_new_marker_is_drawn_once(view):
    at = placed(1.0, 2.0, 3.0)
    view.show(marker(at=at))
    np.testing.assert_allclose(view.pose(PART % 1), at, atol=1e-6)
    view.note(marker(at=at))
    assert view.turn() == 0, "the same again changes nothing"


def test_a_vehicle_that_flies_is_one_change(view):
    view.show(*vehicle(placed(0.0, 0.0, 1.0)))
    for k in range(1, 20):
        at = placed(0.1 * k, -0.05 * k, 1.0, (0.3, -0.2, 0.4 * k))
        view.note(*vehicle(at))
        assert view.turn() == 1
        np.testing.assert_allclose(view.pose(PART % 3), at @ placed(0.2, 0.1, 0.0), atol=1e-4)


def test_what_is_not_rigid_moves_by_itself(view):
    view.show(marker(1), marker(2, at=placed(1.0, 0.0, 0.0)))
    view.note(marker(1), marker(2, at=placed(1.0, 0.5, 0.0)))
    assert view.turn() == 1
    np.testing.assert_allclose(view.pose(PART % 2), placed(1.0, 0.5, 0.0), atol=1e-6)


def test_only_what_looks_different_is_drawn_anew(view):
    view.show(*vehicle(np.eye(4)))
    before = [view.handle(PART % k) for k in (1, 2, 3)]
    parts = vehicle(np.eye(4))
    parts[2].color = ColorRGBA(0.6, 0.6, 0.6, 0.4)
    view.note(*parts)
    assert view.turn() == 1
    after = [view.handle(PART % k) for k in (1, 2, 3)]
    assert [one is other for one, other in zip(before, after)] == [True, True, False]


def test_what_nobody_sends_any_more_vanishes(view):
    view.show(marker(1), marker(2))
    view.note(marker(1))
    view.turn(LIFE_S - 0.11)
    assert view.shown() == {PART % 1, PART % 2}
    view.turn(0.02)
    assert view.shown() == {PART % 1}
    view.turn(0.1)
    assert view.shown() == set() and view.handle("/Quad_Markers/fluffy_II") is None
    view.show(marker(1))
    assert view.shown() == {PART % 1}, "and may come again"


def test_without_a_lifetime_it_stays(view):
    forever = marker()
    forever.lifetime = genpy.Duration(0)
    view.show(forever)
    assert view.turn(1e6) == 0 and view.shown()


def test_the_others_stay_where_they_are_when_the_first_goes(view):
    view.show(*vehicle(placed(1.0, 1.0, 1.0, (0.0, 0.0, 1.0))))
    before = {k: view.pose(PART % k) for k in (2, 3)}
    view.note(marker(1, action=Marker.DELETE))
    view.turn()
    assert view.shown() == {PART % 2, PART % 3}
    for k, pose in before.items():
        np.testing.assert_allclose(view.pose(PART % k), pose, atol=1e-4)


def test_delete_and_delete_all(view):
    view.note(marker(1), marker(2), marker(1, ns="Raven"))
    view.note(marker(1), topic="Quad_Labels")
    view.turn()
    view.note(marker(2, action=Marker.DELETE), marker(7, action=Marker.DELETE), marker(1, "x", action=Marker.DELETE))
    view.turn()
    assert view.shown() == {PART % 1, "/Quad_Markers/Raven/1", "/Quad_Labels/fluffy_II/1"}
    view.note(marker(9, ns="", action=Marker.DELETEALL), marker(5, ns="Raven"))
    view.turn()
    assert view.shown() == {"/Quad_Markers/Raven/5", "/Quad_Labels/fluffy_II/1"}


def test_a_marker_that_comes_and_goes_between_two_turns_is_never_drawn(view):
    view.note(marker(1), marker(1, action=Marker.DELETE))
    assert view.turn() == 0 and view.shown() == set()


@pytest.mark.parametrize("ns", ["risc1/vehicles", "", "a b", "\u00c4%/-"])
def test_every_namespace_is_a_path_of_its_own(view, ns):
    view.note(marker(1, ns=ns), marker(1, ns="other"))
    view.turn()
    assert len(view.shown()) == 2 and not any("//" in path for path in view.shown())


def test_a_marker_in_another_frame_waits_for_it(view):
    view.note(marker(1, at=placed(0.0, 0.0, 2.0), frame="/fluffy_II/camera", stamp_s=7.5))
    assert view.turn() == 0 and view.shown() == set()
    turn = Quaternion(*Rotation.from_euler("y", 0.5 * math.pi).as_quat().tolist())  # its z is x of the fixed frame
    view.frames = {("fluffy_II/camera", 7.5): Transform(Vector3(1.0, 0.0, 1.0), turn)}
    view.turn()
    np.testing.assert_allclose(view.pose(PART % 1)[:3, 3], (3.0, 0.0, 1.0), atol=1e-6)


def test_a_marker_whose_frame_stays_unknown_is_not_shown_at_its_old_place(view):
    view.frames = {("camera", 1.0): Transform(rotation=Quaternion(0.0, 0.0, 0.0, 1.0))}
    view.show(marker(1, frame="camera", stamp_s=1.0))
    assert view.shown()
    for k in range(15):
        view.note(marker(1, frame="camera", stamp_s=2.0 + k))
        view.turn()
    assert view.shown() == set()


def test_clearing_leaves_nothing_but_the_floor(view):
    view.show(marker())
    view.scene.clear()
    assert view.shown() == set() and view.handle("/Quad_Markers/fluffy_II") is None
    assert view.handle("/floor") is not None
    view.show(marker())
    assert view.shown()


def test_any_course_of_events_shows_what_rviz_would(view):
    """Against the simple rule: a marker is at its last pose, unless it was deleted or has expired."""
    rng = np.random.default_rng(4)
    plain = {}
    for _ in range(200):
        for _ in range(rng.integers(0, 6)):
            ns, number = "n%d" % rng.integers(2), int(rng.integers(4))
            path = "/Quad_Markers/%s/%d" % (ns, number)
            dice = rng.random()
            if dice < 0.1:
                view.note(marker(number, ns, action=Marker.DELETE))
                plain.pop(path, None)
            elif dice < 0.12:
                view.note(marker(0, "", action=Marker.DELETEALL))
                plain.clear()
            else:
                at = placed(*rng.uniform(-2.0, 2.0, 3), rng.uniform(-1.0, 1.0, 3))
                view.note(marker(number, ns, at, rgba=(0.5, 0.5, 0.5, float(rng.choice((0.5, 1.0))))))
                plain[path] = (at, view.now_s + LIFE_S)
        view.turn(float(rng.uniform(0.0, 0.4)))
        plain = {path: entry for path, entry in plain.items() if entry[1] > view.now_s}
        assert view.shown() == set(plain)
        for path, (at, _) in plain.items():
            np.testing.assert_allclose(view.pose(path), at, atol=2e-4)


def test_what_cannot_be_drawn_keeps_nothing_else_from_being_drawn(view, monkeypatch):
    def look_of(drawn):
        if drawn.id == 1:
            raise ValueError("no such thing")
        return real(drawn)

    real = marker_scene.look_of
    monkeypatch.setattr(marker_scene, "look_of", look_of)
    view.note(marker(1), marker(2))
    with pytest.raises(ValueError, match="no such thing"):
        view.turn()
    assert view.shown() == {PART % 2}
    view.note(marker(1, action=Marker.DELETE))
    view.turn()
    assert view.shown() == {PART % 2}


def test_everything_that_is_drawn_for_rviz_can_be_shown(view):
    for topic, found in everything().items():
        assert view.note(*found, topic=topic) == set()
    view.turn()
    assert len(view.shown()) == sum(map(len, everything().values()))


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


def test_an_orientation_that_nobody_has_set_is_no_turn(view):
    plain = marker()
    plain.pose.orientation = Quaternion()
    view.show(plain)
    np.testing.assert_allclose(view.pose(PART % 1), np.eye(4), atol=1e-9)


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e30])
@pytest.mark.parametrize("where", ["pose.position.x", "pose.orientation.w", "color.g", "scale.z", "points", "colors"])
def test_numbers_that_are_none_are_not_shown(view, where, bad):
    line = marker(shape=Marker.LINE_STRIP, points_m=CORNERS)
    item, _, last = where.rpartition(".")
    if item:
        setattr(functools.reduce(getattr, item.split("."), line), last, bad)
    elif last == "points":
        line.points[1].y = bad
    else:
        line.colors = [ColorRGBA(1.0, 0.0, bad, 1.0)]
    view.note(line)
    view.turn()
    assert view.shown() == set()


def test_types_and_actions_of_no_meaning_are_not_shown(view):
    assert view.note(marker(shape=12), marker(shape=Marker.MESH_RESOURCE), marker(action=1)) == {10, 12}
    view.turn()
    assert view.shown() == set()


@pytest.mark.parametrize("shape", sorted(SHAPES))
def test_every_shape_is_drawn_moved_and_erased(view, shape):
    look = {"shape": shape, "size_m": (0.1, 0.2, 0.3), "points_m": CORNERS, "text": "seven"}
    handle = view.show(marker(at=placed(1.0, 2.0, 3.0), **look))
    np.testing.assert_allclose(view.pose(PART % 1)[:3, 3], (1.0, 2.0, 3.0), atol=1e-6)
    assert view.show(marker(at=placed(0.0, 0.5, 0.0, (math.pi, 0.0, 0.0)), **look)) is handle
    np.testing.assert_allclose(view.pose(PART % 1), placed(0.0, 0.5, 0.0, (math.pi, 0.0, 0.0)), atol=1e-6)
    view.note(marker(action=Marker.DELETE))
    view.turn()
    assert view.handle(PART % 1) is None


def test_sizes_are_diameters(view):
    size_m = (0.2, 0.4, 0.6)
    ball = view.show(marker(size_m=size_m))
    assert (ball.radius, ball.scale) == (0.5, size_m)
    box = view.show(marker(2, shape=Marker.CUBE, size_m=size_m))
    assert box.dimensions == size_m
    rod = view.show(marker(3, shape=Marker.CYLINDER, size_m=size_m))
    assert (rod.radius, rod.height, rod.scale) == (0.5, 1.0, size_m)
    arrow = view.show(marker(4, shape=Marker.ARROW, size_m=(0.02, 0.05, 0.07), points_m=CORNERS[:2]))
    assert (arrow.shaft_radius, arrow.head_radius, arrow.head_length) == (0.01, 0.025, 0.07)
    along_x = view.show(marker(5, shape=Marker.ARROW, size_m=(0.4, 0.1, 0.1)))
    np.testing.assert_allclose(along_x.points, [[(0.0, 0.0, 0.0), (0.4, 0.0, 0.0)]])


def test_opacity(view):
    assert view.show(marker(rgba=(1.0, 1.0, 1.0, 0.25))).opacity == 0.25
    assert view.show(marker(2)).opacity is None
    line = {"shape": Marker.LINE_STRIP, "size_m": (0.02, 0.0, 0.0), "points_m": CORNERS}
    assert tuple(view.show(marker(3, rgba=(1.0, 0.0, 0.0, 1.0), **line)).colors) == (255, 0, 0)
    pale = view.show(marker(3, rgba=(1.0, 0.0, 0.0, 0.25), **line))
    assert 60 < pale.colors[0] < 120, "mixed with the dark ground"


def test_a_faint_wall_is_a_net(view):
    """In three.js a transparent box hides what is behind it if that is drawn later."""
    lines = net_of_sheet((0.02, 2.0, 1.0))
    assert lines.shape == (3 + 5, 2, 3)
    assert np.abs(lines).max(axis=(0, 1)).tolist() == [0.0, 1.0, 0.5]
    lengths = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    assert sorted(lengths.tolist()) == [1.0] * 5 + [2.0] * 3
    assert len({tuple(line.ravel()) for line in lines}) == 8
    wall = {"shape": Marker.CUBE, "size_m": (0.02, 2.0, 1.0)}
    assert view.show(marker(rgba=(1.0, 1.0, 1.0, 0.1), **wall)).points.shape == (8, 2, 3)
    assert view.show(marker(2, **wall)).dimensions == wall["size_m"]


def test_a_line_grows_in_place(view):
    line = {"shape": Marker.LINE_STRIP, "size_m": (0.02, 0.0, 0.0)}
    handle = view.show(marker(points_m=CORNERS[:2], **line))
    assert handle.points.shape == (1, 2, 3)
    assert view.show(marker(points_m=CORNERS, rgba=(0.0, 1.0, 0.0, 1.0), **line)) is handle
    np.testing.assert_allclose(handle.points, [CORNERS[0:2], CORNERS[1:3]])
    assert tuple(handle.colors) == (0, 255, 0)
    pairs = view.show(marker(2, shape=Marker.LINE_LIST, size_m=(0.02, 0.0, 0.0), points_m=CORNERS))
    np.testing.assert_allclose(pairs.points, [CORNERS[0:2]], err_msg="a point without a partner draws no line")


def test_points_may_have_colours_of_their_own(view):
    points = marker(shape=Marker.POINTS, points_m=CORNERS)
    points.colors = [ColorRGBA(1.0, 0.0, 0.0, 1.0)] * 2 + [ColorRGBA(0.0, 0.0, 1.0, 1.0)]
    np.testing.assert_array_equal(view.show(points).colors, [(255, 0, 0), (255, 0, 0), (0, 0, 255)])


def test_a_text_changes_in_place_and_a_faint_one_lies_on_the_floor(view):
    label = {"shape": Marker.TEXT_VIEW_FACING, "size_m": (0.0, 0.0, 0.2)}
    handle = view.show(marker(text="fluffy_II", rgba=(1.0, 1.0, 1.0, 0.8), **label))
    assert view.show(marker(text="fluffy_II (lost)", rgba=(1.0, 1.0, 1.0, 0.8), **label)) is handle
    assert handle.text == "fluffy_II (lost)"
    faint = view.show(marker(text="1.0", rgba=(1.0, 1.0, 1.0, 0.3), **label))
    assert faint is not handle
    assert faint.render_height == pytest.approx(0.2)
    axes = view.pose(PART % 1)[:3, :3]
    np.testing.assert_allclose(axes[:, 0], (0.0, -1.0, 0.0), atol=1e-6, err_msg="its right is -y")
    np.testing.assert_allclose(axes[:, 1], (-1.0, 0.0, 0.0), atol=1e-6, err_msg="its bottom is -x")


def test_a_text_as_a_picture():
    picture = text_picture("-1.5", (1.0, 0.5, 0.0, 0.5))
    assert picture.dtype == np.uint8 and picture.shape[2] == 4
    assert picture[..., 3].max() == 127
    assert (picture[..., :3] == (255, 127, 0)).all()
    inked = np.argwhere(picture[..., 3] > 60)
    assert inked.min(axis=0).min() > 0 and (inked.max(axis=0) < np.array(picture.shape[:2]) - 1).all(), "cut off"
    assert text_picture("X (m)", (1.0, 1.0, 1.0, 1.0)).shape[1] > picture.shape[1]
