"""The server of the page, also what it uses of viser and websockets that may move, and its scene.

The page in a browser: tests/test_live_view.py.
"""

import socket
import urllib.error
import urllib.request
from dataclasses import replace

import numpy as np
import pytest
from page_client import PageClient, wait_for
from scipy.spatial.transform import Rotation
from websockets.exceptions import InvalidStatus

from risc_visual.browser.marker_scene import HERE, Draw, Erase, Look, Move, Placement, Shape
from risc_visual.browser.page import (
    SHAPES,
    BrowserPanel,
    BrowserScene,
    net_of_sheet,
    text_picture,
)
from risc_visual.browser.page_server import is_page_of_others, open_server

GROUP = "/net/Net"
POINTS = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (1.0, 1.0, 0.0))
OPAQUE = (1.0, 0.5, 0.0, 1.0)


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def server():
    opened = open_server("127.0.0.1", free_port())
    yield opened
    opened.stop()


@pytest.fixture
def scene(server):
    shown = BrowserScene(server, 2.0, 1.5)
    shown.apply([Move(GROUP, Placement((0.0, 0.0, 1.0)))])
    yield shown
    shown.clear()


def draw(scene, look, placement=HERE, marker_id=1):
    """Draw a marker; returns viser's handle of it."""
    path = "%s/%d" % (GROUP, marker_id)
    scene.apply([Draw(path, look, placement)])
    return scene._server.scene.get_handle_by_name(path)


def test_the_page_is_one_file_that_loads_nothing_from_elsewhere(server):
    with urllib.request.urlopen("http://127.0.0.1:%d" % server.get_port(), timeout=20.0) as answer:
        page = answer.read().decode()
    assert "<html" in page
    assert 'src="http' not in page and 'href="http' not in page


def test_nobody_gets_a_tunnel_to_the_internet(server):
    page = PageClient(server.get_port())
    try:
        page.ask_for_tunnel()
        wait_for(lambda: server.get_clients(), "the page")
        button = server.gui.add_button("asked later, so the request has been worked off")
        wait_for(lambda: button.label in page.labels(), "the button")
        button.remove()
    finally:
        page.close()
    assert "ShareUrlUpdated" not in page.kinds
    assert server.request_share_url() is None


def test_a_port_that_is_taken_is_told(server):
    with pytest.raises(ValueError, match="%d.*127.0.0.1" % server.get_port()):
        open_server("127.0.0.1", server.get_port())


def test_an_address_of_another_computer_is_told():
    with pytest.raises(ValueError, match="192.0.2.1.*127.0.0.1"):
        open_server("192.0.2.1", free_port())


@pytest.mark.parametrize("shape", sorted(SHAPES))
def test_every_shape_is_drawn_moved_and_erased(scene, shape):
    size_m = (0.1, 0.2, 0.3)
    handle = draw(scene, Look(shape, size_m, OPAQUE, POINTS, text="seven"), Placement((1.0, 2.0, 3.0)))
    np.testing.assert_allclose(handle.position, (1.0, 2.0, 3.0))
    scene.apply([Move(GROUP + "/1", Placement((0.0, 0.5, 0.0), (1.0, 0.0, 0.0, 0.0)))])
    np.testing.assert_allclose(handle.position, (0.0, 0.5, 0.0))
    np.testing.assert_allclose(handle.wxyz, (0.0, 1.0, 0.0, 0.0))
    scene.apply([Erase(GROUP + "/1")])
    assert scene._server.scene.get_handle_by_name(GROUP + "/1") is None


def test_sizes_are_diameters(scene):
    ball = draw(scene, Look(Shape.SPHERE, (0.2, 0.4, 0.6), OPAQUE))
    assert (ball.radius, ball.scale) == (0.5, (0.2, 0.4, 0.6))
    box = draw(scene, Look(Shape.CUBE, (0.2, 0.4, 0.6), OPAQUE), marker_id=2)
    assert box.dimensions == (0.2, 0.4, 0.6)
    rod = draw(scene, Look(Shape.CYLINDER, (0.2, 0.4, 0.6), OPAQUE), marker_id=3)
    assert (rod.radius, rod.height, rod.scale) == (0.5, 1.0, (0.2, 0.4, 0.6))
    arrow = draw(scene, Look(Shape.ARROW, (0.02, 0.05, 0.07), OPAQUE, POINTS[:2]), marker_id=4)
    assert (arrow.shaft_radius, arrow.head_radius, arrow.head_length) == (0.01, 0.025, 0.07)
    along_x = draw(scene, Look(Shape.ARROW, (0.4, 0.1, 0.1), OPAQUE), marker_id=5)
    np.testing.assert_allclose(along_x.points, [[(0.0, 0.0, 0.0), (0.4, 0.0, 0.0)]])


def test_opacity(scene):
    assert draw(scene, Look(Shape.SPHERE, (1.0, 1.0, 1.0), (1.0, 1.0, 1.0, 0.25))).opacity == 0.25
    assert draw(scene, Look(Shape.SPHERE, (1.0, 1.0, 1.0), (1.0, 1.0, 1.0, 1.0))).opacity is None
    line = Look(Shape.LINE_STRIP, (0.02, 0.0, 0.0), (1.0, 0.0, 0.0, 1.0), POINTS)
    assert tuple(draw(scene, line, marker_id=2).colors) == (255, 0, 0)
    pale = draw(scene, replace(line, rgba=(1.0, 0.0, 0.0, 0.25)), marker_id=2)
    assert 60 < pale.colors[0] < 120, "mixed with the dark ground"


def test_a_faint_wall_is_a_net(scene):
    """A transparent box hides for three.js what is behind it and drawn after it."""
    lines = net_of_sheet((0.02, 2.0, 1.0))
    assert lines.shape == (3 + 5, 2, 3)
    assert np.abs(lines).max(axis=(0, 1)).tolist() == [0.0, 1.0, 0.5]
    lengths = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    assert sorted(lengths.tolist()) == [1.0] * 5 + [2.0] * 3
    assert len({tuple(line.ravel()) for line in lines}) == 8
    wall = Look(Shape.CUBE, (0.02, 2.0, 1.0), (1.0, 1.0, 1.0, 0.1))
    assert draw(scene, wall).points.shape == (8, 2, 3)
    solid = draw(scene, replace(wall, rgba=OPAQUE), marker_id=2)
    assert solid.dimensions == wall.size_m


def test_a_line_grows_in_place(scene):
    line = Look(Shape.LINE_STRIP, (0.02, 0.0, 0.0), OPAQUE, POINTS[:2])
    handle = draw(scene, line)
    assert handle.points.shape == (1, 2, 3)
    assert draw(scene, replace(line, points_m=POINTS, rgba=(0.0, 1.0, 0.0, 1.0))) is handle
    np.testing.assert_allclose(handle.points, [POINTS[0:2], POINTS[1:3]])
    assert tuple(handle.colors) == (0, 255, 0)
    pairs = draw(scene, replace(line, shape=Shape.LINE_LIST, points_m=POINTS), marker_id=2)
    np.testing.assert_allclose(pairs.points, [POINTS[0:2]], err_msg="a point without a partner draws no line")


def test_points_may_have_colours_of_their_own(scene):
    look = Look(Shape.POINTS, (0.1, 0.1, 0.0), OPAQUE, POINTS, ((1.0, 0.0, 0.0, 1.0),) * 2 + ((0.0, 0.0, 1.0, 1.0),))
    np.testing.assert_array_equal(draw(scene, look).colors, [(255, 0, 0), (255, 0, 0), (0, 0, 255)])


def test_a_text_changes_in_place_and_a_faint_one_lies_on_the_floor(scene):
    label = Look(Shape.TEXT, (0.0, 0.0, 0.2), (1.0, 1.0, 1.0, 0.8), text="fluffy_II")
    handle = draw(scene, label)
    assert draw(scene, replace(label, text="fluffy_II (lost)")) is handle
    assert handle.text == "fluffy_II (lost)"
    faint = draw(scene, replace(label, rgba=(1.0, 1.0, 1.0, 0.3)), Placement((1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0)))
    assert faint is not handle
    assert faint.render_height == pytest.approx(0.2)
    w, x, y, z = faint.wxyz
    axes = Rotation.from_quat((x, y, z, w)).as_matrix()
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


def test_clearing_leaves_nothing_but_the_floor(scene, server):
    draw(scene, Look(Shape.SPHERE, (1.0, 1.0, 1.0), OPAQUE))
    scene.clear()
    assert server.scene.get_handle_by_name(GROUP) is None
    assert server.scene.get_handle_by_name("/floor") is not None
    scene.apply([Move(GROUP, HERE)])
    assert draw(scene, Look(Shape.SPHERE, (1.0, 1.0, 1.0), OPAQUE)) is not None


def test_the_panel_shows_what_it_is_told(server):
    panel = BrowserPanel(server, ["risc1", "risc2"], lambda: None, lambda name: None)
    panel.show("<b>news</b>")
    assert panel._status.content == "<b>news</b>"
    server.gui.reset()


def test_two_buttons_pressed_at_once_land_both(server):
    """Each is carried out in a thread of its own, later than it was pressed."""
    landed = []
    BrowserPanel(server, ["risc1", "risc2"], lambda: landed.append("all"), landed.append)
    page = PageClient(server.get_port())
    try:
        wait_for(lambda: page.labels() == {"LAND ALL", "land risc1", "land risc2"}, lambda: str(page.labels()))
        for label in ("land risc1", "land risc2", "LAND ALL"):
            page.press(label)
        wait_for(lambda: len(landed) == 3, lambda: str(landed))
    finally:
        page.close()
        server.gui.reset()
    assert sorted(landed) == ["all", "risc1", "risc2"]


@pytest.mark.parametrize("origin", ["http://elsewhere.example", "http://127.0.0.1:1", "http://localhost:%d", "null"])
def test_pages_of_others_are_refused(server, origin):
    if "%" in origin:  # asked for as 127.0.0.1
        origin %= server.get_port()
    with pytest.raises(InvalidStatus, match="403"):
        PageClient(server.get_port(), origin)


def test_a_name_that_was_made_to_lead_here_is_refused(server):
    """DNS rebinding: a page of evil.example, whose name leads to this computer now. Origin and Host agree."""
    host = "evil.example:%d" % server.get_port()
    for headers in ({"Host": host, "Origin": "http://" + host}, {"Host": host}):
        request = urllib.request.Request("http://127.0.0.1:%d/" % server.get_port(), headers=headers)
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(request, timeout=10.0)


@pytest.mark.parametrize("name", ["localhost", "127.0.0.1", "[::1]", "192.168.0.10", socket.gethostname()])
def test_names_and_addresses_of_this_computer_are_served(name):
    host = name + ":8080"
    assert not is_page_of_others({"Host": host, "Origin": "http://" + host})
    assert not is_page_of_others({"Host": name.upper()})


@pytest.mark.parametrize("host", ["", "[::1", "evil.example", "localhost.evil.example:80", "127.0.0.1.evil.example"])
def test_names_of_others_are_not(host):
    assert is_page_of_others({"Host": host, "Origin": "http://" + host})


def test_its_own_page_is_served(server):
    page = PageClient(server.get_port(), "http://127.0.0.1:%d" % server.get_port())
    try:
        wait_for(lambda: server.get_clients(), "the page")
    finally:
        page.close()


def test_what_cannot_be_drawn_keeps_nothing_else_from_being_drawn(scene, server):
    bad = Look(Shape.LINE_STRIP, (0.02, 0.0, 0.0), (float("nan"), 0.0, 0.0, 1.0), POINTS)
    good = Look(Shape.SPHERE, (0.1, 0.1, 0.1), OPAQUE)
    with pytest.raises(ValueError):
        scene.apply([Draw(GROUP + "/1", bad, HERE), Draw(GROUP + "/2", good, HERE)])
    assert server.scene.get_handle_by_name(GROUP + "/2") is not None
    scene.apply([Erase(GROUP + "/1"), Erase(GROUP + "/2")])
    assert server.scene.get_handle_by_name(GROUP + "/2") is None
