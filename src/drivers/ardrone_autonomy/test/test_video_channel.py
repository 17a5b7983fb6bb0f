from collections import namedtuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ardrone_autonomy.video_channel import BOTTOM, FRONT, SETTLE_S, CameraTracker

PERIOD_S = 1.0 / 30.0
H264, MPEG4 = 4, 3
Header = namedtuple("Header", "stream_id codec")


class Scene:
    """A tracker and the clock; `show` gives it the next picture."""

    def __init__(self, channel=FRONT):
        self.tracker = CameraTracker(channel)
        self.now_s = 50.0
        self.stream_id = 1
        self.codec = H264
        self.connection = 1

    def show(self, is_idr=False):
        self.now_s += PERIOD_S
        return self.tracker.camera(Header(self.stream_id, self.codec), is_idr, self.connection, self.now_s)

    def order(self, channel):
        self.tracker.order(channel, self.now_s)


@pytest.fixture
def scene():
    scene = Scene()
    scene.show(True)
    return scene


def test_begins_with_the_channel_of_the_configuration():
    assert Scene(FRONT).show(True) == FRONT
    assert Scene(BOTTOM).show(True) == BOTTOM


def test_the_old_camera_until_the_stream_id_changes(scene):
    scene.order(BOTTOM)
    assert [scene.show() for _ in range(20)] == [FRONT] * 20
    scene.stream_id += 1
    assert [scene.show(i == 0) for i in range(20)] == [BOTTOM] * 20


def test_an_idr_shortly_after_the_order_is_still_of_the_old_camera(scene):
    scene.order(BOTTOM)
    assert scene.show(is_idr=True) == FRONT


def test_a_vehicle_that_keeps_its_stream_id_is_believed_after_a_while(scene):
    scene.order(BOTTOM)
    scene.now_s += SETTLE_S
    assert scene.show() == FRONT
    assert scene.show(is_idr=True) == BOTTOM
    assert scene.show() == BOTTOM


@pytest.mark.parametrize("changes", [1, 2])
def test_after_two_orders_in_a_row_nobody_knows_until_they_have_settled(scene, changes):
    scene.order(BOTTOM)
    scene.order(FRONT)
    assert scene.show() == FRONT
    for _ in range(changes):  # the aircraft may skip an outdated order
        scene.stream_id += 1
        assert scene.show(True) is None
    scene.now_s += SETTLE_S
    assert scene.show() is None
    assert scene.show(is_idr=True) == FRONT


def test_another_codec_is_not_another_camera(scene):
    scene.order(BOTTOM)
    scene.stream_id, scene.codec = 2, MPEG4
    assert scene.show(True) == FRONT
    scene.stream_id = 3
    assert scene.show(True) == BOTTOM


def test_a_change_that_nobody_ordered_keeps_the_camera(scene):
    scene.order(BOTTOM)
    scene.stream_id += 1
    scene.show(True)
    scene.stream_id += 1
    assert scene.show(True) == BOTTOM


def test_an_order_without_effect_does_not_delay_the_next(scene):
    scene.order(FRONT)  # written again after a reconnection: no new stream
    scene.now_s += SETTLE_S
    assert scene.show(is_idr=True) == FRONT
    scene.order(BOTTOM)
    scene.stream_id += 1
    assert scene.show(True) == BOTTOM


def test_a_new_connection_keeps_the_camera(scene):
    scene.order(BOTTOM)
    scene.stream_id += 1
    scene.show(True)
    scene.connection, scene.stream_id = 2, 9
    assert scene.show(True) == BOTTOM


def test_orders_given_while_nobody_watched_hold_for_the_next_connection(scene):
    scene.order(BOTTOM)
    scene.now_s += 60.0
    scene.connection, scene.stream_id = 2, 9
    assert scene.show(True) == BOTTOM


def test_a_stream_opened_right_after_an_order_is_of_nobody_knows_which_camera(scene):
    scene.order(BOTTOM)
    scene.connection, scene.stream_id = 2, 9
    assert scene.show(True) is None
    assert scene.show() is None
    scene.stream_id = 10
    assert scene.show(True) == BOTTOM


def test_and_is_settled_by_an_idr_when_the_change_came_first(scene):
    scene.order(BOTTOM)
    scene.connection, scene.stream_id = 2, 9
    assert scene.show(True) is None
    scene.now_s += SETTLE_S
    assert scene.show() is None
    assert scene.show(True) == BOTTOM


def test_a_configuration_makes_earlier_orders_void(scene):
    scene.order(BOTTOM)
    scene.tracker.reset(FRONT)
    scene.connection, scene.stream_id = 2, 9
    assert scene.show(True) == FRONT
    scene.now_s += SETTLE_S
    assert scene.show(True) == FRONT


@given(st.lists(st.sampled_from(["front", "bottom", "switch", "codec", "picture", "idr", "wait", "connect"])))
def test_in_the_end_it_is_the_last_order(events):
    scene, last = Scene(), FRONT
    for event in events:
        if event in ("front", "bottom"):
            last = FRONT if event == "front" else BOTTOM
            scene.order(last)
        elif event == "switch":
            scene.stream_id += 1
        elif event == "codec":
            scene.stream_id, scene.codec = scene.stream_id + 1, H264 + MPEG4 - scene.codec
        elif event == "wait":
            scene.now_s += SETTLE_S
        elif event == "connect":
            scene.connection += 1
        else:
            assert scene.show(event == "idr") in (FRONT, BOTTOM, None)
    scene.show()
    scene.now_s += SETTLE_S
    scene.show(True)
    assert scene.show(True) == last
