"""The report's collectors: each one with bags of a few messages and known answers."""

import json
import math
import struct
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import rosbag
import rospy
import yaml
from cv_bridge import CvBridge
from rosgraph_msgs.msg import Log
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Empty, String

from data_extraction.bags import Bag, BagError, _ChunkReader
from data_extraction.camera_topics import one_topic_each
from data_extraction.progress import bar
from data_extraction.report.battery import BatteryCollector
from data_extraction.report.collector import ReportCollector
from data_extraction.report.computers import Computer, ComputerCollector
from data_extraction.report.drops import CELL_M, DropCollector, cell_edges
from data_extraction.report.events import EventCollector, head_and_tail
from data_extraction.report.faults import FaultCollector
from data_extraction.report.fence import FenceCollector
from data_extraction.report.gates import GateCollector
from data_extraction.report.ladder import LadderCollector
from data_extraction.report.origin import Origin, parameter_hash, read_beside
from data_extraction.report.snapshots import SnapshotCollector
from data_extraction.samples import Arrivals, Samples
from risc_control.safety import WITHOUT_EFFECT, FailsafeLevel, Rule, SafetyLimits, fence_of
from risc_lab.lab import load_vehicle_type
from risc_lab.lab.arena import NET_HALF_X_M, NET_HALF_Y_M, Arena
from risc_lab.lab.fleet import fleet_from_dict
from risc_lab.lab.vehicle_types import vehicle_type_file
from risc_lab.phases import OperatorPhase, OperatorResult, OutCause, TrajectoryPhase
from risc_lab.registry import VARIABLE
from risc_maap_msgs.msg import (
    CommandSent,
    CommandsSent,
    Counter,
    Crash,
    EstimatorStatus,
    FaultRecord,
    Faults,
    MocapStatus,
    OperatorState,
    PpmStatus,
    Safety,
    Told,
    TrajectoryPhases,
    VehicleNodeStatus,
    VehicleOut,
    VehiclePhase,
    VehicleStatus,
)
from risc_msgs.msg import Cortex, Mocap_data, Mocap_marker, Mocap_markers, Observed_rois, Risc_roi, Risc_rois, States
from roscopter.msg import State

T0_S = 1000.0
NAN = float("nan")
BRIDGE = CvBridge()


@pytest.fixture
def play(tmp_path):
    """Function that writes (topic, message, time [s]) rows into a bag and feeds the bag to a collector."""

    def run(collector, rows):
        path = tmp_path / "some.bag"
        with rosbag.Bag(str(path), "w") as bag:
            for topic, message, t_s in rows:
                if getattr(message, "_has_header", False) and message.header.stamp.is_zero():
                    message.header.stamp = rospy.Time.from_sec(t_s)
                bag.write(topic, message, rospy.Time.from_sec(t_s))
        with Bag(path) as bag:
            for message in bag.messages():
                if collector.wants(message[0]):
                    collector(*message)
        return collector

    return run


def body(name, *places):
    return Mocap_markers(name=name, marker=[Mocap_marker(*place) for place in places])


def test_markers_are_lost_where_their_object_was(play):
    lost, sentinel = (NAN, NAN, NAN), (9999.999, 9999.999, 9999.999)
    frames = [
        [body("Raven", (1.1, 0.6, 1.0), (1.1, 0.6, 1.0))],
        [body("Raven", (1.1, 0.6, 1.0), lost)],
        [body("Raven", lost, sentinel), body("Kahn", lost)],
        [body("Raven", (-2.0, -1.9, 1.0), (-2.0, -1.9, 1.0))],
    ]
    rows = [("/mocap_data", Mocap_data(Obj=bodies), T0_S + 0.005 * k) for k, bodies in enumerate(frames)]
    drops = play(DropCollector(), rows).result(T0_S + 0.015)
    raven = drops.markers["Raven"]
    assert (raven.markers, raven.lost, raven.frames, raven.blind_frames) == (8, 3, 4, 1)
    assert drops.markers_lost == 4 and drops.unplaced == 1, "where Kahn was is unknown"
    edges_x, edges_y = cell_edges(Arena())
    cell = (np.searchsorted(edges_x, 1.1) - 1, np.searchsorted(edges_y, 0.6) - 1)
    assert (drops.lost_map[cell], drops.seen_map[cell]) == (3, 3)
    assert drops.lost_map.sum() == 3 and drops.seen_map.sum() == 5
    assert (drops.frames, drops.gaps) == (4, 0)
    assert drops.longest_gap_s == pytest.approx(0.005, abs=1e-6)


def test_the_maps_cells_cover_the_net():
    for arena in (Arena(), Arena(5.0, 4.4)):
        for edges, half in zip(cell_edges(arena), (arena.half_x_m, arena.half_y_m)):
            assert edges[0] == -edges[-1] and half <= edges[-1] < half + CELL_M
        assert DropCollector(arena)._drops.seen_map.shape == tuple(len(edges) - 1 for edges in cell_edges(arena))


def test_a_vehicle_counts_as_lost_only_after_it_was_seen(play):
    seen = [False, False, True, True, False, False, False, True, False]
    rows = [
        ("/cortex_raw", Cortex(Obj=[States(name="Raven", visible=is_seen, x=0.1 * k, y=-0.5)]), T0_S + 0.1 * k)
        for k, is_seen in enumerate(seen)
    ]
    drops = play(DropCollector(), rows).result(T0_S + 0.8)
    raven = drops.vehicles["Raven"]
    assert (raven.frames, raven.invisible, raven.times) == (7, 4, 2)
    assert raven.longest_s == pytest.approx(0.3, abs=1e-6)
    assert np.array(drops.lost_places_m) == pytest.approx(np.array([[0.4, -0.5], [0.8, -0.5]]))


def test_a_gap_of_the_stream_is_counted(play):
    rows = [("/mocap_data", Mocap_data(), T0_S + t_s) for t_s in (0.0, 0.005, 0.405, 0.41)]
    drops = play(DropCollector(), rows).result(T0_S + 0.415)
    assert drops.gaps == 1 and drops.longest_gap_s == pytest.approx(0.4, abs=1e-6)


@pytest.mark.parametrize("late_s", [0.004, 500.0])  # 500: the stamps are from another clock
def test_what_is_lost_at_the_end_is_lost_until_then(tmp_path, late_s):
    """When the frames stop, the estimator publishes that once, with the stamp of the last frame."""
    path = tmp_path / "silent.bag"
    seen, lost = (Cortex(Obj=[States(name="Raven", visible=visible)]) for visible in (True, False))
    with rosbag.Bag(str(path), "w") as bag:
        for stamp_s, receipt_s, states in ((0.0, 0.0, seen), (0.005, 0.005, seen), (0.005, 0.105, lost)):
            states.header.stamp = rospy.Time.from_sec(T0_S + stamp_s)
            frame = Mocap_data(header=states.header)
            if states is seen:
                bag.write("/mocap_data", frame, rospy.Time.from_sec(T0_S + late_s + receipt_s))
            bag.write("/cortex_raw", states, rospy.Time.from_sec(T0_S + late_s + receipt_s))
    collector = DropCollector()
    with Bag(path) as bag:
        for message in bag.messages():
            collector(*message)
    for _ in range(2):  # result() changes nothing
        drops = collector.result(T0_S + late_s + 5.005)
        assert drops.vehicles["Raven"].longest_s == pytest.approx(5.0, abs=1e-6)
        assert drops.gaps == 1
        assert (drops.longest_gap_s, drops.silent_end_s) == pytest.approx((5.0, 5.0), abs=1e-6)


def test_without_motion_capture_there_is_nothing_to_lose():
    assert DropCollector().result(T0_S) is None


def moving(t_s, x=0.0, u=0.0, y=0.0, z=1.0, name="Raven"):
    return "/cortex_raw", Cortex(Obj=[States(name=name, visible=True, x=x, y=y, z=z, u=u)]), t_s


ARDRONE = {"Raven": load_vehicle_type("ardrone")}


def test_the_fence_margin_is_the_nearest_side_now_and_where_it_stops(play):
    rows = [moving(T0_S, x=0.5), moving(T0_S + 0.03, x=1.0, u=2.0), moving(T0_S + 1.0, y=-1.8), moving(T0_S + 2.0)]
    raven = play(FenceCollector(types=ARDRONE), rows).result(0.0)["Raven"]
    assert raven.fence.limits == SafetyLimits() and raven.type_known
    assert raven.least_m == pytest.approx(NET_HALF_Y_M - 1.8)
    assert raven.least_place_m == pytest.approx((0.0, -1.8, 1.0))
    assert raven.least_s == pytest.approx(T0_S + 1.0, abs=1e-6)
    goes_on_m = raven.fence.stop_m(0, 2.0)
    assert 1.0 < goes_on_m < 2.5
    assert raven.least_stopped_m == pytest.approx(min(NET_HALF_Y_M - 1.8, NET_HALF_X_M - 1.0 - goes_on_m))
    t_s, now_m, stopped_m = raven.table.T
    assert t_s == pytest.approx([T0_S, T0_S + 1.0, T0_S + 2.0], abs=1e-6), "one point each 0.1 s"
    assert now_m[0] == pytest.approx(NET_HALF_X_M - 1.0)
    assert stopped_m[0] == pytest.approx(NET_HALF_X_M - 1.0 - goes_on_m)


def test_the_floor_is_no_fence(play):
    raven = play(FenceCollector(), [moving(T0_S, z=0.05)]).result(0.0)["Raven"]
    assert raven.least_m == pytest.approx(NET_HALF_Y_M)


def test_the_fence_is_that_of_the_flights_parameters(play):
    vehicle = {"namespace": "risc3", "template": "Raven", "type": "ardrone", "address": "127.0.0.1"}
    vehicle["start"] = {"position_m": [0, 0, 0]}
    fleet = fleet_from_dict({"name": "one", "mocap": {"host": "127.0.0.1"}, "vehicles": [vehicle]})
    node = {"fence_margin_m": 0.3, "fence_max_m": [1.0, 1.0, 2.0], "fence_min_m": [-1.0, -1.0, -1.0], "TakeoffLand": 6}
    fences = Origin(parameters={"risc3": {"joystick_controller": node}, "risc1": {}}, fleet=fleet).fences()
    assert fences["Raven"].margin_m == 0.3
    raven = play(FenceCollector(fences), [moving(T0_S, x=0.9)]).result(0.0)["Raven"]
    assert raven.least_m == pytest.approx(0.1)
    assert Origin(parameters=None, fleet=fleet).fences() == {}
    node = {"joystick_timeout": 0.7, "ScaleRoll": 3.0}  # what launch/joystick_controller.launch sets
    parameters = {"risc3": {"joystick_controller": node, "joy_node": {"dev": ""}}, "virtual_lab": {"vehicles": -1}}
    fences = Origin(parameters=parameters, fleet=fleet).fences()
    limits = {name: fence.limits for name, fence in fences.items()}
    assert limits == {"Raven": SafetyLimits(joystick_timeout=0.7, **fence_of(fleet.arena))}


def fence_limits(folder, rows):
    """{vehicle: limit [m] of its distance from the net in a report, None if its type is unknown}."""
    with rosbag.Bag(str(folder / "flight.bag"), "w") as bag:
        for topic, message, t_s in rows:
            bag.write(topic, message, rospy.Time.from_sec(t_s))
    with Bag(folder / "flight.bag") as bag:
        collector = ReportCollector(bag, read_beside(folder / "flight.bag"))
        for message in bag.messages(collector.wanted):
            collector(*message)
        margins = collector.material().margins
    return {name: item.fence.margin_m if item.type_known else None for name, item in margins.items()}


def test_without_a_fleet_the_fence_is_that_of_the_type_that_the_bag_tells(tmp_path):
    """An IRIS+ reaches 0.15 m farther than an AR.Drone."""
    ardrone_m = SafetyLimits().fence_margin_m
    rows = [moving(T0_S + k, name=name) for k, name in enumerate(("Raven", "IRIS", "Big", "Small", "Ghost"))]
    rows += [
        ("/big/apm/state", State(mode="STABILIZE"), T0_S),
        ("/big/node_status", VehicleNodeStatus(name="Big"), T0_S + 0.1),
        ("/small/ardrone/takeoff", Empty(), T0_S),
        ("/small/vehicle_status", VehicleStatus(name="Small"), T0_S + 0.1),
        ("/ghost/vehicle_status", VehicleStatus(name="Ghost"), T0_S + 0.1),
    ]
    assert fence_limits(tmp_path, rows) == pytest.approx(
        {"Raven": ardrone_m, "IRIS": ardrone_m + 0.15, "Big": ardrone_m + 0.15, "Small": ardrone_m, "Ghost": None}
    )


def test_a_type_with_the_driver_of_another_is_told_by_no_topic(tmp_path, monkeypatch):
    content = yaml.safe_load(vehicle_type_file("ardrone").read_text(encoding="utf-8"))
    content.update(name="small_drone", radius_m=0.1, driver="ardrone")
    del content["laboratory"]
    (tmp_path / "vehicle_types").mkdir()
    (tmp_path / "vehicle_types/small_drone.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    (tmp_path / "vehicle_types/small_drone.py").write_text("from risc_control.vehicles.ardrone import Adapter\n")
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    rows = [("/one/ardrone/takeoff", Empty(), T0_S), ("/one/vehicle_status", VehicleStatus(name="One"), T0_S + 0.1)]
    limits = fence_limits(tmp_path, [moving(T0_S, name="One"), *rows])
    assert limits == {"One": SafetyLimits().fence_margin_m}


def test_without_a_fleet_file_the_fence_is_that_of_the_fleet_in_the_parameters(tmp_path):
    vehicle = {"namespace": "iris1", "template": "Ghost", "type": "iris", "address": "127.0.0.1"}
    vehicle["start"] = {"position_m": [0, 0, 0]}
    fleet = {"name": "one", "mocap": {"host": "127.0.0.1"}, "vehicles": [vehicle]}
    (tmp_path / "parameters.yaml").write_text(yaml.safe_dump({"fleet": fleet}))
    limits = fence_limits(tmp_path, [moving(T0_S, name="Ghost")])
    assert limits == {"Ghost": pytest.approx(SafetyLimits().fence_margin_m + 0.15)}


def safety(level, rule, reason):
    return Safety(level=getattr(Safety, level), rule=getattr(Safety, rule), reason=reason)


def test_levels_last_until_the_next_change_or_the_end(play):
    held = safety("HOLD", "STATE", "state 120 ms old")
    landed = Safety(level=Safety.LAND, rule=Safety.REQUEST, reason="x", operator=True)
    told = [(0.0, Safety()), (2.0, held), (2.4, held), (2.5, Safety()), (4.0, landed)]
    rows = [("/risc1/safety", message, T0_S + t_s) for t_s, message in told]
    spans = play(LadderCollector(), rows).result(T0_S + 5.0)["risc1"]
    assert [span.level for span in spans] == [
        FailsafeLevel.OK,
        FailsafeLevel.HOLD,
        FailsafeLevel.OK,
        FailsafeLevel.LAND,
    ]
    assert [span.reason for span in spans] == ["", "state 120 ms old", "", "x" + WITHOUT_EFFECT]
    assert [span.rule for span in spans] == [Rule.NONE, Rule.STATE, Rule.NONE, Rule.REQUEST]
    lengths_s = [span.end_s - span.begin_s for span in spans]
    assert lengths_s == pytest.approx([2.0, 0.5, 1.5, 1.0], abs=1e-6)


def test_of_very_many_levels_every_landing_is_kept_and_none_is_stretched(play):
    told = [safety("HOLD", "STATE", str(k)) if k % 2 else Safety() for k in range(2101)]
    told += [safety("LAND", "BATTERY", text) for text in ("20 % left", "19 % left")]
    told += [Safety(), safety("HOLD", "STATE", "x")]
    rows = [("/risc1/safety", message, T0_S + k) for k, message in enumerate(told)]
    collector = play(LadderCollector(), rows)
    spans = collector.result(T0_S + 10_000.0)["risc1"]
    assert len(spans) == 2001
    assert (spans[-2].level, spans[-2].begin_s, spans[-2].end_s) == (FailsafeLevel.HOLD, T0_S + 1999.0, T0_S + 2000.0)
    assert (spans[-1].level, spans[-1].begin_s, spans[-1].end_s) == (FailsafeLevel.LAND, T0_S + 2101.0, T0_S + 2103.0)
    assert collector.left_out == 50 + 2, "holds after the 2000th change, the landing's other reason, the last hold"


def estimator(t_s, frames, unknown=(), **counters):
    counters = [Counter(*item) for item in counters.items()]
    return "/estimator_status", EstimatorStatus(frames=frames, counters=counters, unknown_bodies=list(unknown)), t_s


def test_gates_count_over_restarts_of_their_node(play):
    rows = [
        estimator(T0_S, 100, misfits=3, tilted=0),
        estimator(T0_S + 1.0, 300, ["Condor"], misfits=7, tilted=0, of_no_gate=5),
        estimator(T0_S + 2.0, 50, misfits=1, tilted=2),
        ("/mocap_status", MocapStatus(frames=9, counters=[Counter("malformed", 4)]), T0_S),
    ]
    counts = play(GateCollector(), rows).result(0.0)
    assert (counts["mocap_status"].frames, counts["mocap_status"].refused) == (9, {"malformed": 4})
    counted = counts["estimator_status"]
    assert counted.frames == 350
    assert counted.refused == {"misfits": 8, "tilted": 2}
    assert counted.unknown == "Condor"


def test_computers_that_fly_are_named_with_their_worst_figures(play):
    def status(computer, oldest_s, behind_s, group="/risc1"):
        told = VehicleNodeStatus(computer=computer, oldest_state_s=oldest_s, clock_behind_s=behind_s)
        return group + "/node_status", told, T0_S

    rows = [status("risc2", 0.0125, 0.0), status("risc2", 0.03, 0.048), status("risc2", 0.008, 0.001)]
    rows.append(status("base", 0.005, 0.0, group=""))
    assert play(ComputerCollector(), rows).result(0.0) == {
        "risc1": Computer("risc2", 30.0, 48.0),
        "vehicle": Computer("base", 5.0, 0.0),
    }


def test_charge_and_time_in_the_air(play):
    rows = []
    for k, state in enumerate((2, 2, 6, 3, 3, 4, 8, 2, 2)):
        rows.append(("/risc1/vehicle_status", VehicleStatus(battery_pct=90.0 - k, state=state), T0_S + k))
    rows.append(("/vehicle_status", VehicleStatus(battery_pct=math.nan), T0_S))
    batteries = play(BatteryCollector(), rows).result(0.0)
    assert set(batteries) == {"risc1"}, "that one does not report its charge"
    assert (batteries["risc1"].first_pct, batteries["risc1"].last_pct) == (90.0, 82.0)
    assert batteries["risc1"].air_s == pytest.approx(5.0)


def test_events_are_what_changes(play):
    def joy(t_s, *pressed):
        return "/risc1/joy", Joy(buttons=[int(index in pressed) for index in range(8)]), T0_S + t_s

    def phases(t_s, of_kahn):
        told = [VehiclePhase("Raven", TrajectoryPhase.COURSE), VehiclePhase("Kahn", of_kahn)]
        return "/trajectory_phase", TrajectoryPhases(vehicles=told), T0_S + t_s

    rows = [
        *(("/operator/phase", OperatorState(), T0_S + t_s) for t_s in (0.0, 0.05, 5.5)),
        joy(0.1),
        joy(0.2, 6),
        joy(0.3, 6),
        joy(0.4),
        *(("/risc1/ardrone/land", Empty(), T0_S + 1.0 + 0.2 * k) for k in range(5)),
        ("/risc1/controller_status", Bool(False), T0_S + 3.0),
        ("/risc1/controller_status", Bool(True), T0_S + 3.1),
        phases(4.0, TrajectoryPhase.HOLD),
        phases(4.1, TrajectoryPhase.HOME),
        ("/rosout", Log(level=Log.INFO, name="/a", msg="fine"), T0_S + 5.0),
        ("/rosout", Log(level=Log.WARN, name="/a", msg="not so fine"), T0_S + 5.1),
        ("/operator/result", OperatorState(result=OperatorResult.OK), T0_S + 6.0),
    ]
    events = play(EventCollector(), rows).result()
    assert [(event.source, event.text, event.count) for event in events] == [
        ("operator", "waiting", 1),
        ("risc1", "joystick button 6", 1),
        ("risc1", "landing ordered", 5),
        ("risc1", "mode: autonomous", 1),
        ("Raven", "trajectory: course", 1),
        ("Kahn", "trajectory: hold", 1),
        ("Kahn", "trajectory: home", 1),
        ("a", "not so fine", 1),
        ("operator", "result: ok", 1),
    ]


@pytest.mark.parametrize("count", [450, 2000])
def test_of_many_events_the_first_and_the_last_are_kept(play, count):
    rows = [("/operator/phase", OperatorState(text="%d" % k), T0_S + k) for k in range(count)]
    collector = play(EventCollector(), rows)
    texts = [event.text for event in collector.result()]
    assert texts == ["waiting: %d" % k for k in (*range(200), *range(count - 200, count))]
    assert collector.left_out == count - 400


def test_warnings_are_left_out_before_phases(play):
    texts = ["warning " + "x" * k for k in range(1500)]
    rows = [("/rosout", Log(level=Log.WARN, name="/a", msg=text), T0_S + k) for k, text in enumerate(texts)]
    rows += [("/operator/phase", OperatorState(text="%d" % k), T0_S + 700.5 + k) for k in range(10)]
    rows.append(("/risc1/ardrone/land", Empty(), T0_S + 710.9))
    collector = play(EventCollector(), sorted(rows, key=lambda row: row[2]))
    kept = [event.text for event in head_and_tail(collector.result(), 60) if not event.is_minor]
    assert kept == ["waiting: %d" % k for k in range(10)] + ["landing ordered"]
    assert (len(collector.result()), collector.left_out) == (400, 1111)


def test_a_vehicle_without_a_namespace_is_not_called_after_its_topics(play):
    assert [event.source for event in play(EventCollector(), [("/ardrone/land", Empty(), T0_S)]).result()] == [
        "vehicle"
    ]


def test_events_of_an_iris_are_its_autopilots_and_its_boards(play):
    rows = [("/iris1/apm/state", State(mode="STABILIZE"), T0_S + k) for k in range(3)]
    rows += [("/iris1/ppm_status", PpmStatus(state=PpmStatus.FLYING), T0_S + 3.0 + 0.1 * k) for k in range(5)]
    rows += [("/iris1/apm/state", State(mode="STABILIZE", armed=True), T0_S + 4.0)]
    rows += [("/iris1/ppm_status", PpmStatus(state=PpmStatus.FAILSAFE), T0_S + 5.0)]
    rows += [("/iris1/apm/state", State(mode="LAND", armed=True), T0_S + 5.5)]
    events = play(EventCollector(), rows).result()
    assert [(event.source, event.text) for event in events] == [
        ("iris1", "autopilot: STABILIZE, disarmed"),
        ("iris1", "PPM of the transmitter's board: follows commands"),
        ("iris1", "autopilot: STABILIZE, armed"),
        ("iris1", "PPM of the transmitter's board: failsafe"),
        ("iris1", "autopilot: LAND, armed"),
    ]


def test_the_rectified_compressed_picture_is_preferred():
    image, packed = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
    types = {
        "/risc1/ardrone/image_raw": image,
        "/risc1/ardrone/image_raw/compressed": packed,
        "/risc1/ardrone/image_rect_color": image,
        "/risc2/ardrone/image_raw": image,
        "/risc3/ardrone/camera_info": "sensor_msgs/msg/CameraInfo",
        "/risc3/ardrone/image_modi": image,
    }
    assert one_topic_each(types) == {"/risc1/ardrone/image_rect_color", "/risc2/ardrone/image_raw"}


def picture(t_s, grey):
    message = BRIDGE.cv2_to_imgmsg(np.full((90, 160, 3), grey, np.uint8), "bgr8")
    message.header.frame_id = "ardrone_base_frontcam"
    return "/risc1/ardrone/image_rect_color", message, t_s


def regions(t_s, *names):
    found = [Risc_roi(name, True, 80, 45, 40.0, 30.0, 0.0) for name in names]
    lost = [Risc_roi(name="lost")]
    return "/land_rois", Observed_rois(Obj=[Risc_rois("risc1", found + lost, [])]), t_s


def test_the_picture_with_most_found_in_it_is_taken_whichever_came_first(play):
    rows = []
    for k in range(30):
        rows += [picture(T0_S + 0.1 * k, 100), regions(T0_S + 0.1 * k, *(["a"] if k != 14 else ["a", "b"]))]
    rows = [row for row in rows if row[0] != "/land_rois" or row[2] < T0_S + 2.0]  # the last third was not evaluated
    collector = SnapshotCollector({"/risc1/ardrone/image_rect_color": "sensor_msgs/msg/Image"}, T0_S, 3.0)
    snapshots = play(collector, rows).result(0.0)
    assert collector.notes == []
    assert [item.found for item in snapshots] == [["a"], ["a", "b"], []]
    assert [item.has_regions for item in snapshots] == [True, True, False]
    assert snapshots[1].stamp_s == pytest.approx(T0_S + 1.4)
    drawn = cv2.imdecode(np.frombuffer(snapshots[1].jpeg, np.uint8), cv2.IMREAD_COLOR).astype(int)
    assert drawn.shape == (90, 160, 3)
    assert drawn[30, 80, 1] - drawn[30, 80, 2] > 50, "the upper side of the region is green"
    assert abs(drawn[45, 80] - 100).max() < 20, "its middle is as it was"


def test_a_damaged_picture_is_named_and_left_out(play):
    topic, message, t_s = picture(T0_S, 100)
    message.step = 10
    collector = SnapshotCollector({topic: "sensor_msgs/msg/Image"}, T0_S, 1.0)
    assert play(collector, [(topic, message, t_s)]).result(0.0) == []
    assert len(collector.notes) == 1 and collector.notes[0].startswith("risc1, front camera: ")


PARAMETERS = {
    "run_id": "1234",
    "fleet": {"mocap": {"host": "127.78.0.1", "rate_hz": 200.0}},
    "controller": {"q_yaw": 4.0, "vehicles": "risc1"},
    "virtual_lab": {"stats": "/home/a/flights/1/virtual_lab.json", "seed": 1},
}


def test_the_hash_is_of_what_matters_only():
    other = json.loads(json.dumps(PARAMETERS))
    other["run_id"], other["fleet"]["mocap"]["host"] = "5678", "127.99.0.1"
    other["virtual_lab"]["stats"] = "/home/b/elsewhere/virtual_lab.json"
    other["joystick_buttons"] = {"_controller": {"node": "/controller", "buttons": []}}  # as soon as nodes have started
    other = dict(reversed(list(other.items())))
    assert parameter_hash(other) == parameter_hash(PARAMETERS)
    other["controller"]["q_yaw"] = 4.5
    assert parameter_hash(other) != parameter_hash(PARAMETERS)
    assert len(parameter_hash(PARAMETERS)) == 64


def test_what_lies_beside_a_bag_is_read(tmp_path):
    nothing = read_beside(tmp_path / "flight.bag")
    assert (nothing.flight, nothing.parameters, nothing.fleet, nothing.summary, nothing.hash) == (
        {},
        None,
        None,
        {},
        None,
    )
    (tmp_path / "parameters.yaml").write_text(yaml.safe_dump(PARAMETERS))
    (tmp_path / "flight.yaml").write_text("seed: 7\n")
    origin = read_beside(tmp_path / "flight.bag")
    assert origin.hash == parameter_hash(PARAMETERS) and origin.flight == {"seed": 7}


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("flight.yaml", "{"),
        ("flight.yaml", "- 1"),
        ("flight.yaml", "arguments: 7"),
        ("flight.yaml", "versions: []"),
        ("summary.json", "{'a'}"),
    ],
)
def test_a_file_that_cannot_be_read_is_named(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=name):
        read_beside(tmp_path / "flight.bag")


def test_a_flight_file_with_empty_parts_says_nothing(tmp_path):
    (tmp_path / "flight.yaml").write_text("arguments:\nversions:\n")
    assert read_beside(tmp_path / "flight.bag").flight == {}


def test_samples_stay_evenly_spread():
    samples = Samples(2, limit=100)
    for k in range(1000):
        samples.append((k, -k))
    table = samples.table()
    assert 50 <= len(table) <= 100
    assert samples.every == 16 and (np.diff(table[:, 0]) == 16).all()
    assert (table[:, 1] == -table[:, 0]).all() and table[0, 0] == 0
    assert Samples(3).table().shape == (0, 3)


def test_the_bar_fills():
    assert bar(0.0).startswith("[...") and bar(0.0).endswith("  0 %")
    assert bar(0.5).count("#") == bar(0.5).count(".")
    assert bar(7.0) == bar(1.0) and "." not in bar(1.0) and bar(1.0).endswith("100 %")


def test_the_first_arrival_of_a_stamp_counts():
    arrivals = Arrivals()
    for stamp_ns, receipt_s in ((5, 1.0), (3, 2.0), (5, 3.0)):
        arrivals.append(SimpleNamespace(sec=0, nanosec=stamp_ns), receipt_s)
    stamps_ns, receipts_s = arrivals.first()
    assert stamps_ns.tolist() == [3, 5] and receipts_s.tolist() == [2.0, 1.0]


@pytest.mark.parametrize("compression", ["none", "bz2"])
@pytest.mark.parametrize("step", [1, 777])  # 777: every chunk spans all of the time
def test_messages_come_in_order_also_from_overlapping_chunks(tmp_path, compression, step):
    """Topic after topic; every message comes once."""
    path, count = tmp_path / "muddle.bag", 2000
    with rosbag.Bag(str(path), "w", chunk_threshold=1000, compression=compression) as bag:
        for topic in ("/a", "/b"):
            for k in range(count):
                bag.write(topic, String("%s %d" % (topic, k)), rospy.Time.from_sec(T0_S + k * step % count))
    with Bag(path) as bag:
        rows = list(bag.messages())
        assert len(list(bag.messages(["/b"]))) == count
        assert bag.topics == {"/a": count, "/b": count}
        assert bag.start_s == pytest.approx(T0_S) and bag.duration_s == pytest.approx(count - 1)
    times_s = [t_s for _, t_s, _ in rows]
    assert times_s == sorted(times_s)
    assert {(topic, message.data) for topic, _, message in rows} == {
        (topic, "%s %d" % (topic, k)) for topic in ("/a", "/b") for k in range(count)
    }
    assert len(rows) == 2 * count


def test_a_clock_that_stood_still_does_not_fill_the_memory(tmp_path, monkeypatch):
    path, read, records = tmp_path / "still.bag", [], _ChunkReader._records
    monkeypatch.setattr(_ChunkReader, "_records", lambda self, info: read.append(info) or records(self, info))
    with rosbag.Bag(str(path), "w", chunk_threshold=1000) as bag:
        for k in range(200):
            bag.write("/a", String("%03d" % k), rospy.Time.from_sec(T0_S))
    with Bag(path) as bag:
        for k, (_, _, message) in enumerate(bag.messages()):
            assert message.data == "%03d" % k and len(read) <= 1 + k / 10, "no more was read than is needed"
    assert k == 199


def test_a_chunk_that_is_damaged_is_said(tmp_path):
    path = tmp_path / "damaged.bag"
    with rosbag.Bag(str(path), "w", compression="bz2") as bag:
        for k in range(1000):
            bag.write("/a", String("text %d" % k), rospy.Time.from_sec(T0_S + k))
    data = bytearray(path.read_bytes())
    data[data.index(b"BZh") + 200] ^= 0xFF
    path.write_bytes(bytes(data))
    with Bag(path) as bag, pytest.raises(BagError, match="damaged.bag"):
        list(bag.messages())


def test_a_chunk_that_lost_its_end_is_said(tmp_path):
    path = tmp_path / "short.bag"
    with rosbag.Bag(str(path), "w", compression="bz2") as bag:
        for k in range(1000):
            bag.write("/a", String("text %d" % k), rospy.Time.from_sec(T0_S + k))
    data = bytearray(path.read_bytes())
    begin = data.index(b"BZh")
    (size,) = struct.unpack_from("<I", data, begin - 4)
    struct.pack_into("<I", data, begin - 4, size - 50)
    path.write_bytes(bytes(data))
    with Bag(path) as bag, pytest.raises(BagError, match="short.bag.*rosbag reindex"):
        list(bag.messages())


# ---------------------------------------------------------------- faults


SAFE = ["completed", "held", "landed"]


def at(t_s):
    return rospy.Time.from_sec(T0_S + t_s)


def fault(number, begin_s, lasts_s=0.5, active=True, safe=SAFE, vehicle="risc1", name="jump", args="0.3,risc1"):
    """FaultRecord; its times count from T0_S."""
    ends = at(begin_s + lasts_s) if lasts_s else rospy.Time()
    return FaultRecord(number, name, args, vehicle, at(begin_s), ends, active, list(safe))


def told(*records, t_s):
    return "/virtual_lab/faults", Faults(faults=list(records)), T0_S + t_s


def said(vehicle, t_s, level, rule=Safety.STATE):
    return "/%s/safety" % vehicle, Safety(level=level, rule=rule), T0_S + t_s


def sent(t_s, level, name="fluffy_II"):
    commands = [CommandSent(name=name, sent=at(t_s), level=level)]
    return "/commands_sent", CommandsSent(commands=commands), T0_S + t_s + 0.2  # it may come late


def operator(t_s, phase=OperatorPhase.FLY, on_course=True, out=()):
    return "/operator/phase", OperatorState(phase=phase, on_course=on_course, out=list(out)), T0_S + t_s


def truth(t_s, x=0.0, z=1.0, w=0.0, name="fluffy_II"):
    return "/ground_truth", Cortex(Obj=[States(name=name, visible=True, x=x, z=z, w=w)]), T0_S + t_s


def flown(play, *rows):
    """Faults of a flight that is on its course from 1 s to 20 s."""
    rows = [operator(0.0, OperatorPhase.WAITING, False), operator(1.0), *rows]
    rows += [operator(20.0, OperatorPhase.LAND), operator(25.0, OperatorPhase.DONE)]
    return play(FaultCollector(), sorted(rows, key=lambda row: row[2])).result(T0_S + 30.0)


def test_a_fault_that_changes_nothing_is_completed(play):
    faults = flown(play, told(fault(1, 3.0, active=False), t_s=2.0), told(fault(1, 3.0), t_s=3.0), sent(3.1, Safety.OK))
    (figures,) = faults.figures()
    assert figures == {
        "name": "jump",
        "args": "0.3,risc1",
        "vehicle": "risc1",
        "start_s": 2.0,
        "end_s": 2.5,
        "outcome": "completed",
        "safe": True,
        "reaction_ms": None,
        "reactions_ms": {},
        "flying": 3,
    }
    assert faults.waiting == 0 and faults.out == {}


def test_what_the_operator_said_of_the_flight_before_is_of_that_one(play):
    """The operator's last messages are latched, so a recorder that starts between two flights gets them."""
    over = {"phase": OperatorPhase.ABORTED, "result": OperatorResult.FAILED, "on_course": True}
    old = OperatorState(**over, out=[VehicleOut("risc2", OutCause.LADDER, "landed")])
    old.header.stamp = at(-30.0)
    rows = [("/operator/phase", old, T0_S - 0.2), ("/operator/result", old, T0_S + 0.5)]
    faults = flown(play, *rows, told(fault(1, 3.0), t_s=3.0))
    (outcome,) = faults.outcomes
    assert (outcome.outcome, faults.out, faults.course_s) == ("completed", {}, pytest.approx(T0_S + 1.0))


def test_the_reaction_is_the_first_command_of_a_higher_level(play):
    faults = flown(
        play,
        sent(2.0, Safety.HOLD),  # before the fault, and already over
        sent(2.1, Safety.OK),
        told(fault(1, 3.0), t_s=3.0),
        sent(3.05, Safety.OK),
        said("risc1", 3.11, Safety.HOLD),
        sent(3.12, Safety.HOLD),
        sent(3.15, Safety.HOLD),
        sent(3.15, Safety.HOLD, "albatross"),
        sent(3.2, Safety.LAND, "albatross"),
        said("risc1", 3.6, Safety.OK),
        sent(3.6, Safety.OK),
    )
    (outcome,) = faults.outcomes
    assert (outcome.outcome, outcome.is_safe) == ("completed", True), "it flew on"
    assert outcome.reactions_s == pytest.approx({"risc1": 0.12, "risc2": 0.15}, abs=1e-6)
    assert outcome.reaction_s == pytest.approx(0.12, abs=1e-6)


def heard(t_s, order, vehicle="risc1"):
    message = Told(vehicle=vehicle, order=order)
    message.header.stamp = at(t_s)
    return "/virtual_lab/told", message, T0_S + t_s


def test_of_a_virtual_vehicle_it_is_the_time_at_which_it_receives_the_command(play):
    """Its driver sends it on. A command that another vehicle receives, or that came before, is another one."""
    times_s = {"risc1": (3.05, 3.11, 3.125, 3.16), "risc2": (3.121, 3.1995)}
    came = [
        ("/virtual_lab/inputs", *heard(t_s, Told.FLY, vehicle)[1:]) for vehicle in times_s for t_s in times_s[vehicle]
    ]
    rows = (sent(3.12, Safety.HOLD), sent(3.2, Safety.HOLD, "albatross"), sent(3.3, Safety.LAND, "albatross"))
    faults = flown(play, told(fault(1, 3.0), t_s=3.0), *sorted((*rows, *came), key=lambda row: row[2]))
    assert faults.outcomes[0].reactions_s == pytest.approx({"risc1": 0.125, "risc2": 0.1995}, abs=1e-6)
    unheard = flown(play, told(fault(1, 3.0), t_s=3.0), came[0], *rows)
    assert "risc1" not in unheard.outcomes[0].reactions_s, "the link was cut"


def test_so_is_the_first_order_to_hover_or_to_land_that_the_vehicle_hears(play):
    """The order comes from a program between the ladder and the vehicle, when the ladder's program has died."""
    faults = flown(
        play,
        heard(0.5, Told.LAND),
        heard(0.6, Told.HOVER),
        heard(1.5, Told.FLY),
        ("/program_faults", Faults(faults=[fault(1, 3.0, name="node_kill", args="driver")]), T0_S + 3.0),
        heard(3.02, Told.HOVER),
        heard(3.1, Told.HOVER, "risc2"),
        sent(3.3, Safety.LAND),
        heard(3.4, Told.LAND),
        heard(20.5, Told.HOVER, "risc3"),  # the operator lands them
    )
    assert faults.outcomes[0].reactions_s == pytest.approx({"risc1": 0.02, "risc2": 0.1}, abs=1e-6)


def test_faults_of_the_lab_and_of_programs_have_numbers_of_their_own(play):
    killed = fault(1, 6.0, lasts_s=2.0, name="node_kill", args="controller", vehicle="")
    faults = flown(
        play,
        told(fault(1, 3.0), t_s=3.0),
        ("/program_faults", Faults(faults=[killed]), T0_S + 6.0),
        truth(15.0, z=0.05),
    )
    assert [outcome.text for outcome in faults.outcomes] == ["jump:0.3,risc1", "node_kill:controller"]
    assert faults.outcomes[1].is_of("risc2") and faults.waiting == 0


def test_each_fault_answers_for_what_happens_until_the_next(play):
    faults = flown(
        play,
        told(fault(1, 3.0), fault(2, 6.0, active=False), fault(3, 9.0, active=False, safe=["completed"]), t_s=3.0),
        told(fault(2, 6.0), t_s=6.0),
        said("risc1", 7.0, Safety.HOLD),
        said("risc1", 7.5, Safety.OK),
        said("risc2", 7.5, Safety.HOLD),
        told(fault(3, 9.0, safe=["completed"]), t_s=9.0),
        said("risc1", 9.1, Safety.HOLD),
        said("risc1", 9.5, Safety.LAND),
        truth(15.0, z=0.05),
    )
    assert [(fault.outcome, fault.is_safe) for fault in faults.outcomes] == [
        ("completed", True), ("held", True), ("landed", False),
    ]  # fmt: skip
    assert faults.left_ok_s == {"risc1": pytest.approx(T0_S + 9.5), "risc2": pytest.approx(T0_S + 7.5)}


@pytest.mark.parametrize(
    "rows",
    [
        [("/virtual_lab/crash", Crash(vehicle="risc1", reason="flew into the net"), T0_S + 4.0)],
        [truth(4.0, x=NET_HALF_X_M), truth(15.0, z=0.05)],
        [truth(4.0, z=0.5, w=-3.0), truth(15.0, z=0.05)],  # its motors were cut
        [said("risc1", 4.0, Safety.LAND), truth(24.0, z=0.5)],  # it never came down
    ],
    ids=["crash", "net", "fell", "in the air"],
)
def test_a_breach_is_what_touched_left_or_stayed_up(play, rows):
    (outcome,) = flown(play, told(fault(1, 3.0), t_s=3.0), *rows).outcomes
    assert (outcome.outcome, outcome.is_safe) == ("breach", False)
    (before,) = flown(play, told(fault(1, 5.0), t_s=5.0), *rows[:1]).outcomes
    assert before.outcome == "completed", "what came before is not its own"


@pytest.mark.parametrize("other, is_safe", [("", True), ("risc2", False)])
def test_a_fall_may_be_safe_but_not_onto_another_vehicle(play, other, is_safe):
    crash = "/virtual_lab/crash", Crash(vehicle="risc1", other=other, reason="fell"), T0_S + 4.0
    (outcome,) = flown(play, told(fault(1, 3.0, safe=["breach"]), t_s=3.0), crash).outcomes
    assert (outcome.outcome, outcome.is_safe) == ("breach", is_safe)


def test_a_vehicle_that_is_out_has_landed_and_the_operators_own_landing_is_none(play):
    out = VehicleOut("risc1", OutCause.SILENT, "silent")
    after = said("risc1", 21.0, Safety.LAND, Safety.REQUEST)
    (outcome,) = flown(play, told(fault(1, 3.0), t_s=3.0), after).outcomes
    assert outcome.outcome == "completed"
    faults = flown(play, told(fault(1, 3.0), t_s=3.0), operator(6.0, out=[out]), operator(7.0, out=[out]), after)
    assert faults.outcomes[0].outcome == "landed"
    assert faults.out["risc1"] == (pytest.approx(T0_S + 6.0), OutCause.SILENT, "silent")


def test_what_never_began_has_no_outcome(play):
    endless = fault(2, 4.0, lasts_s=None)
    faults = flown(play, told(fault(1, 40.0, active=False), endless, t_s=4.0))
    assert [outcome.end_s for outcome in faults.outcomes] == [None] and faults.waiting == 1
    assert faults.figures()[0]["end_s"] is None
    assert not flown(play) and flown(play).figures() == []


def test_faults_are_events(play):
    rows = [told(fault(1, 3.0, active=False), t_s=2.0), told(fault(1, 3.0), t_s=3.0)]
    rows += [told(fault(1, 3.0, active=False), t_s=3.5)]
    events = play(EventCollector(), rows).result()
    assert [(round(event.time_s - T0_S, 6), event.text) for event in events] == [
        (3.0, "fault jump:0.3,risc1 begins"), (3.5, "fault jump:0.3,risc1 ends"),
    ]  # fmt: skip
