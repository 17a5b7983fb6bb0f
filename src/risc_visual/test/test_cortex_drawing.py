"""What draw_cortex draws from messages; and that in a fleet of fifty each vehicle keeps its ids."""

import random
import time

import genpy
import pytest
from geometry_msgs.msg import Twist, TwistStamped, Vector3
from std_msgs.msg import Header

from risc_control.safety import FailsafeLevel, Verdict
from risc_lab.lab.fleet import FleetVehicle, Start
from risc_lab.lab.templates import load_templates
from risc_msgs.msg import Cortex, Landmark, Landmarks, States
from risc_visual.drawing.cast import Index
from risc_visual.drawing.params import CortexParams, TrajectoryParams
from risc_visual.drawing.ros import markers
from risc_visual.drawing.ros.cortex_drawing import CortexDrawing
from risc_visual.drawing.ros.paths import PathDrawing
from risc_visual.vision.landmark_config import load_landmarks

NOW_S = 100.0
HEAD = markers.header(genpy.Time.from_sec(NOW_S))
NAN = float("nan")


def vehicle(number):
    return FleetVehicle("risc%d" % number, "vehicle_%d" % number, "ardrone", "127.0.0.%d" % number, Start((0, 0, 0)))


def drawing(fleet=(), **params):
    return CortexDrawing(CortexParams(**params), fleet, load_templates(), load_landmarks())


def cortex(names, lost=(), stamp_s=100.0):
    states = [
        States(name, name not in lost, 0.1 * k, 0.05 * k, 1.0, *[0.0] * 3, 2.0, -3.0, 7.0 * k, *[0.0] * 3)
        for k, name in enumerate(names)
    ]
    return Cortex(Header(stamp=genpy.Time.from_sec(stamp_s), frame_id="cortex"), states)


def keys(found):
    return [(m.ns, m.id) for m in found]


def twist(position_m, variances_m2):
    return TwistStamped(Header(stamp=genpy.Time(100)), Twist(Vector3(*position_m), Vector3(*variances_m2)))


def test_fifty_vehicles_keep_their_ids_whatever_the_order_and_whoever_is_lost():
    fleet = [vehicle(k) for k in range(1, 51)]
    names = [entry.template for entry in fleet]
    scene = drawing(fleet)
    first, labels = scene.vehicles(cortex(names), NOW_S)
    parts = len(first) // 50
    assert len(first) == 50 * parts > 250 and len(labels) == 50
    assert len(set(keys(first))) == len(first) and len(set(keys(labels))) == 50
    colour = {(m.ns, m.id): m.color for m in first}
    shuffled = random.Random(7).sample(names, 50)
    second, labels2 = scene.vehicles(cortex(shuffled, lost=names[:5], stamp_s=100.04), 100.04)
    assert sorted(keys(second)) == sorted(keys(first)) and sorted(keys(labels2)) == sorted(keys(labels))
    for m in second:
        lost = m.ns in names[:5]
        assert (m.color == colour[m.ns, m.id]) is not lost
    for m in first + labels + second + labels2:
        assert 0.0 < m.lifetime.to_sec() <= 1.0
        assert m.header.frame_id == "cortex"
    assert {m.text for m in labels2} == {name + (" (lost)" if name in names[:5] else "") for name in names}


def test_paths_of_fifty_vehicles_have_ids_of_their_own_and_a_bounded_life():
    names = ["vehicle_%d" % k for k in range(50)]
    paths = PathDrawing("quad_line", (1.0, 0.0, 0.0), 0.04, 10.0, TrajectoryParams(), Index(names))
    alive = {}
    for step in range(100):
        head = markers.header(genpy.Time.from_sec(100.0 + 0.04 * step))
        found = paths.draw(head, {name: (0.03 * step, 0.1 * k, 1.0) for k, name in enumerate(names)})
        assert len(set(keys(found))) == len(found)
        for m in found:
            assert 0.0 < m.lifetime.to_sec() <= 3.0
            alive.setdefault(m.id, set()).add(m.points[0].y)
    assert all(len(places) == 1 for places in alive.values()), "an id went from one vehicle to another"
    assert len({place for places in alive.values() for place in places}) == 50
    paths.keep_only(names[:1])
    assert {m.points[0].y for m in paths.draw(head, {})} == {0.0}


def test_the_failsafe_level_stands_at_the_vehicle_and_in_its_line():
    scene = drawing([vehicle(1), vehicle(2)])
    scene.note_safety(0, Verdict(FailsafeLevel.LAND, "battery at 8 %"))
    scene.note_safety(1, Verdict(FailsafeLevel.OK, ""))
    assert scene.mode(HEAD, 0, "vehicle_1", True).text == "vehicle_1: land: battery at 8 %"
    assert scene.mode(HEAD, 1, "vehicle_2", False).text == "vehicle_2: Manual"
    labels = {m.ns: m for m in scene.vehicles(cortex(["vehicle_1", "vehicle_2"]), NOW_S)[1]}
    assert {name: m.text for name, m in labels.items()} == {"vehicle_1": "vehicle_1: LAND", "vehicle_2": "vehicle_2"}
    assert (labels["vehicle_1"].color.r, labels["vehicle_1"].color.g) == (1.0, 0.0)
    scene.note_safety(0, Verdict(FailsafeLevel.OK, ""))
    scene.mode(HEAD, 0, "vehicle_1", True)
    assert scene.vehicles(cortex(["vehicle_1"]), NOW_S)[1][0].text == "vehicle_1"


@pytest.mark.parametrize("later_s, text", [(1.4, "vehicle_1: HOLD"), (1.6, "vehicle_1"), (-60.0, "vehicle_1")])
def test_the_level_of_a_vehicle_that_says_nothing_more_is_no_news(later_s, text):
    """Only ROS time counts: a bag may be played slowly, or from the beginning."""
    scene = drawing([vehicle(1)], status_hz=2.0)
    scene.note_safety(0, Verdict(FailsafeLevel.HOLD, "state 120 ms old"))
    scene.mode(HEAD, 0, "vehicle_1", True)
    now_s = NOW_S + later_s
    assert scene.vehicles(cortex(["vehicle_1"], stamp_s=now_s), now_s)[1][0].text == text


def test_a_level_lasts_while_a_bag_is_played_slowly():
    scene = drawing([vehicle(1)], status_hz=1e3)  # a text lives 3 ms
    scene.note_safety(0, Verdict(FailsafeLevel.HOLD, "state 120 ms old"))
    scene.mode(HEAD, 0, "vehicle_1", True)
    time.sleep(0.01)
    assert scene.vehicles(cortex(["vehicle_1"]), NOW_S + 0.001)[1][0].text == "vehicle_1: HOLD"


def test_pendulum_stands_on_its_vehicle():
    states = [
        States("vehicle_1", True, 0.0, 0.0, 1.0, *[0.0] * 9),
        States("Pendulum_tip", True, 0.1, 0.0, 1.9, *[0.0] * 9),
    ]
    found, labels = drawing([vehicle(1)]).vehicles(Cortex(Header(stamp=genpy.Time(100)), states), NOW_S)
    ball, rod = [m for m in found if m.ns == "Pendulum_tip"]
    assert (ball.pose.position.x, ball.pose.position.z, ball.scale.x) == (0.1, 1.9, 0.076)
    assert [(p.x, p.y, p.z) for p in rod.points] == [(0.0, 0.0, 1.0), (0.1, 0.0, 1.9)]
    assert [m.text for m in labels] == ["vehicle_1", "Pendulum_tip"]


def test_landmarks_have_the_colour_of_their_kind():
    msg = Landmarks(Header(stamp=genpy.Time(100)), [Landmark("Pink_blue", 2.3, 0.8, 1.5), Landmark("pole", 0, 0, 0)])
    spheres, labels = drawing().landmarks(msg)
    assert [(m.ns, m.color.r, m.color.g, m.color.b, m.color.a) for m in spheres] == [
        ("Pink_blue", 1.0, 0.0, 0.5, 0.7),
        ("pole", 1.0, 1.0, 1.0, 0.4),
    ]
    assert [m.text for m in labels] == ["Pink_blue", "pole"]


def test_covariances_of_several_vehicles_stand_beside_each_other():
    scene = drawing()
    found = [scene.covariance(twist((k, 0, 1), (1e-4, 4e-4, 0.0)), k) for k in range(3)]
    assert keys(found) == [("covariance", 0), ("covariance", 1), ("covariance", 2)]
    assert found[1].scale.x == pytest.approx(0.03) and found[1].scale.y == pytest.approx(0.06)
    assert min(m.scale.z for m in found) > 0.0  # rviz refuses a sphere without a thickness
    assert found[2].pose.position.x == 2.0


@pytest.mark.parametrize("position_m, variances_m2", [((NAN, 0, 1), (0, 0, 0)), ((0, 0, 1), (-1e-9, 0, 0))])
def test_a_covariance_that_is_none_is_not_drawn(position_m, variances_m2):
    assert drawing().covariance(twist(position_m, variances_m2), 0) is None
