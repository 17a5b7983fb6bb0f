"""Faults that are found in a recording of motion capture are those that were put into it, and they can be flown."""

import json
import math

import numpy as np
import pytest
import rosbag
import rospy
import yaml

from risc_experiments.scorecard import __main__ as command
from risc_experiments.scorecard.from_bag import Recording, events_of, make_script, seen_faults
from risc_lab.lab import load_fleet, load_templates
from risc_lab.lab.yaml_reader import package_file
from risc_lab.phases import TrajectoryPhase
from risc_maap_msgs.msg import TrajectoryPhases, VehiclePhase
from risc_msgs.msg import Mocap_data, Mocap_marker, Mocap_markers
from risc_simulator.faults import REGISTRY, Bodies, load_faults
from risc_simulator.models.mocap_cameras import CameraParams, MocapCameras
from risc_simulator.world import World

FRAME_S = 0.005
FRAMES = 400
BEGIN, END = 100, 200  # frames of the fault
FLEET = load_fleet(package_file("..", "launch/fleets/ardrones3.yaml"))
NAMES = tuple(vehicle.template for vehicle in FLEET.vehicles)
SPACES = {vehicle.template: vehicle.namespace for vehicle in FLEET.vehicles}


def recorded(change=lambda seen: seen, hears=lambda k: True, late_s=lambda k: 0.003):
    """Recording of vehicles that climb, with noise. change: function of the Observations between BEGIN and END."""
    types = {vehicle.type: vehicle.vehicle_type for vehicle in FLEET.vehicles}
    world = World(FLEET, types, load_templates(fleet=FLEET), seed=1, perturbed=False, gusts=False, step_s=FRAME_S)
    for vehicle, fleet_vehicle in zip(world.vehicles.values(), FLEET.vehicles):
        vehicle.fly_at(fleet_vehicle.start.position_m[:2] + (1.0,), 0.3)
    cameras = MocapCameras(CameraParams.of_arena(FLEET.arena), seed=1)
    recording = Recording(NAMES)
    for k in range(FRAMES):
        world.step_to(k * FRAME_S)
        seen = cameras.observe(k * FRAME_S, world.layout, world.markers_m())
        if BEGIN <= k < END:
            seen = change(seen)
        if not hears(k):
            continue
        recording.stamps_s.append(seen.time_s)
        recording.late_s.append(late_s(k))
        start = 0
        for name, count in seen.layout:
            if name in NAMES:
                recording.markers_m[name].append(seen.markers_m[start : start + count].copy())
            start += count
    return recording


def put_in(fault, severity):
    """The change that a fault makes to the second vehicle."""
    templates = load_templates(fleet=FLEET)
    markers_m = {name: np.array(templates[name].markers_m) for name in NAMES}
    bodies = Bodies(NAMES[1:2], NAMES[:1] + NAMES[2:], markers_m)
    act = REGISTRY.module(fault).make(severity, np.random.default_rng(1), bodies)
    return lambda seen: act(seen, seen.time_s)[0][1]


def test_a_good_recording_shows_nothing():
    assert seen_faults(recorded()) == []
    assert seen_faults(Recording(NAMES)) == []


@pytest.mark.parametrize(
    "fault, severity, seen_severity",
    [
        ("jump", 0.3, 0.3),
        ("flip", 180.0, 180.0),
        ("name_exchange", 1.0, None),
        ("marker_swap", 1.0, None),
        ("ghost_marker", 0.2, 0.2),
        ("occlusion", 1.0, 1.0),
    ],
)
def test_what_was_put_in_is_seen_and_nothing_else(fault, severity, seen_severity):
    (seen,) = seen_faults(recorded(put_in(fault, severity)))
    assert seen.fault == fault and (seen.body == NAMES[1] or fault == "name_exchange" and seen.body in NAMES)
    assert seen.start_s == pytest.approx(BEGIN * FRAME_S, abs=1e-6)
    assert seen.duration_s == pytest.approx((END - BEGIN) * FRAME_S, abs=0.02)
    if seen_severity is None:
        assert seen.severity is None
    else:
        assert abs(seen.severity) == pytest.approx(seen_severity, rel=0.05)


def test_gaps_delays_and_frames_that_repeat_are_seen():
    (gap,) = seen_faults(recorded(hears=lambda k: not BEGIN <= k < END))
    assert gap.fault == "mocap_blackout" and gap.duration_s == pytest.approx((END - BEGIN) * FRAME_S, abs=0.02)
    (late,) = seen_faults(recorded(late_s=lambda k: 0.053 if BEGIN <= k < END else 0.003))
    assert late.fault == "delay" and late.severity == pytest.approx(0.05)
    assert late.start_s == pytest.approx(BEGIN * FRAME_S) and late.duration_s == pytest.approx(0.5, abs=0.02)
    recording = recorded()
    for frames in recording.markers_m.values():
        frames[BEGIN:END] = [frames[BEGIN - 1]] * (END - BEGIN)
    (frozen,) = seen_faults(recording)
    assert frozen.fault == "freeze" and frozen.duration_s == pytest.approx(0.5, abs=0.02)


def test_times_count_from_when_the_course_is_reached():
    recording = recorded(put_in("jump", 0.3))
    recording.course_s = (0.4, math.inf)
    (event,), outside = events_of(recording, seen_faults(recording), {NAMES[1]: "risc7"})
    assert (event.vehicle, event.start_s, outside) == ("risc7", pytest.approx(0.1), 0)
    recording.course_s = (0.7, math.inf)
    assert events_of(recording, seen_faults(recording), {}) == ([], 1)


def write_bag(path, recording, course_s):
    with rosbag.Bag(str(path), "w") as bag:
        phases = TrajectoryPhases(vehicles=[VehiclePhase(name, int(TrajectoryPhase.COURSE)) for name in NAMES])
        phases.header.stamp = rospy.Time.from_sec(1000.0 + course_s)
        bag.write("/trajectory_phase", phases, phases.header.stamp)
        for k, stamp_s in enumerate(recording.stamps_s):
            message = Mocap_data()
            message.header.stamp = rospy.Time.from_sec(1000.0 + stamp_s)
            for name in NAMES:
                markers = [Mocap_marker(*row) for row in recording.markers_m[name][k].tolist()]
                message.Obj.append(Mocap_markers(name=name, marker=markers))
            bag.write("/mocap_data", message, message.header.stamp + rospy.Duration(0.003))


def test_a_bag_becomes_a_file_of_faults(tmp_path):
    path = tmp_path / "bad.bag"
    write_bag(path, recorded(put_in("jump", 0.3), hears=lambda k: not 300 <= k < 360), course_s=0.1)
    events, outside = make_script(path, tmp_path / "out" / "faults.yaml", SPACES)
    assert outside == 0 and tuple(events) == load_faults(tmp_path / "out" / "faults.yaml")
    jump, gap = events
    assert (jump.fault, jump.vehicle, jump.start_s) == ("jump", SPACES[NAMES[1]], pytest.approx(0.4, abs=1e-3))
    assert (gap.fault, gap.vehicle, gap.start_s) == ("mocap_blackout", "", pytest.approx(1.395, abs=1e-3))
    assert (
        yaml.safe_load((tmp_path / "out" / "faults.yaml").read_text(encoding="utf-8"))["faults"][0]["fault"] == "jump"
    )


def test_a_bag_of_other_vehicles_is_refused_and_what_is_beyond_a_fault_is_as_much_as_it_can_be(tmp_path):
    path = tmp_path / "bad.bag"
    write_bag(path, recorded(), course_s=0.1)
    with pytest.raises(ValueError, match="Crow.*fleet.yaml"):
        make_script(path, tmp_path / "faults.yaml", {"Crow": "risc1"})
    assert make_script(path, tmp_path / "faults.yaml", SPACES | {"Crow": "risc9"}) == ([], 0), "Crow was not there"
    recording = recorded(hears=lambda k: k < END)
    recording.stamps_s[-1] += 75.0
    (gap,), _ = events_of(recording, seen_faults(recording), SPACES)
    assert (gap.fault, gap.duration_s) == ("mocap_blackout", 60.0)


def test_the_faults_of_a_bag_fly(tmp_path, capsys):
    path, folder = tmp_path / "bad.bag", tmp_path / "out"
    options = ("--from", str(path), "--seeds", "2", "--minutes", "0.7", "--workers", "1", "--out", str(folder))
    write_bag(path, recorded(hears=lambda k: not 300 <= k < 360), course_s=0.1)
    assert command.main(options) == 0
    (row,) = json.loads((folder / "scorecard.json").read_text(encoding="utf-8"))["rows"]
    assert row["fault"] == "bad_faults.yaml" and row["detected_by"] == {"hold": 2}
    assert "mocap_blackout" in capsys.readouterr().err
    write_bag(path, recorded(), course_s=0.1)
    with pytest.raises(SystemExit):
        command.main(options)
    assert str(path) in capsys.readouterr().err
