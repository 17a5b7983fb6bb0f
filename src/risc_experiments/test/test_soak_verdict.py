"""./maap soak: a flight is judged from its bag; messages about the flight before do not matter."""

import json

import pytest
import rosbag
import rospy
import yaml

from risc_experiments.fleets import default_fleet
from risc_experiments.soak.verdict import BAG, FLEET, JUDGED, judge_flight, main
from risc_lab.phases import OperatorPhase, OperatorResult, OutCause, TrajectoryPhase
from risc_maap_msgs.msg import (
    CommandSent,
    CommandsSent,
    Crash,
    FaultRecord,
    Faults,
    MocapTime,
    OperatorState,
    Safety,
    TrajectoryPhases,
    VehicleOut,
    VehiclePhase,
)
from risc_msgs.msg import Cortex, States, Trajectories, Trajectory

T0_S, STEP_S = 1.7e9, 0.02
LATE_S, LATENCY_S = 0.004, 0.007
WAITS_S, COURSE_S, HOME_S, LANDS_S, OVER_S = 1.0, 3.0, 13.0, 15.0, 17.0


def at(t_s):
    return rospy.Time.from_sec(T0_S + t_s)


def put(message, t_s):
    message.header.stamp = at(t_s)
    return message


def fault(active, begin_s=6.0, safe=("completed", "held", "landed")):
    return FaultRecord(7, "jump", "0.3,risc1", "risc1", at(begin_s), at(begin_s + 1.0), active, list(safe))


@pytest.fixture
def flight(tmp_path):
    """Function that writes the bag of a flight of two vehicles, with further rows. Returns its folder."""
    fleet = default_fleet(2, "circle")
    delay_s = fleet.mocap.reported_delay_s
    (tmp_path / FLEET).write_text(yaml.safe_dump(fleet.to_dict()))
    names = [vehicle.template for vehicle in fleet.vehicles]

    def rows():
        over = {"phase": OperatorPhase.ABORTED, "result": OperatorResult.FAILED, "on_course": True}
        old = OperatorState(**over, out=[VehicleOut("risc2", OutCause.LADDER, "fell")])
        yield 0.1, "/operator/phase", put(old, -60.0)
        for t_s, phase in ((WAITS_S, OperatorPhase.WAITING), (1.5, OperatorPhase.TAKEOFF), (2.5, OperatorPhase.FLY),
                           (COURSE_S, OperatorPhase.FLY), (HOME_S, OperatorPhase.HOME),
                           (LANDS_S, OperatorPhase.LAND)):  # fmt: skip
            yield t_s, "/operator/phase", put(OperatorState(phase=phase, on_course=t_s >= COURSE_S), t_s)
        yield 1.2, "/operator/result", put(old, -60.0)
        done = OperatorState(phase=OperatorPhase.DONE, result=OperatorResult.OK, on_course=True)
        for topic in ("phase", "result"):
            yield OVER_S, "/operator/" + topic, put(done, OVER_S)
        for t_s, phase in ((COURSE_S, TrajectoryPhase.COURSE), (HOME_S, TrajectoryPhase.HOMED)):
            told = [VehiclePhase(name, phase) for name in names]
            yield t_s, "/trajectory_phase", put(TrajectoryPhases(course="circle", vehicles=told), t_s)
        for k in range(round((OVER_S + 0.5) / STEP_S)):
            t_s = k * STEP_S
            high = 1.0 if 2.5 < t_s < 16.0 else 0.08
            seen = [States(name=name, visible=True, x=float(i), z=high) for i, name in enumerate(names)]
            yield t_s + delay_s + LATE_S, "/ground_truth", put(Cortex(Obj=seen), t_s)
            if t_s > 2.5:
                wanted = [Trajectory(name=name, x=float(i), z=1.0) for i, name in enumerate(names)]
                yield t_s, "/trajectory", put(Trajectories(Obj=wanted), t_s)
                yield t_s + delay_s, "/mocap_time", put(MocapTime(frame=k, receipt=at(t_s + delay_s)), t_s)
                sent = at(t_s + delay_s + LATENCY_S)
                held = int(6.11 < t_s < 6.9)
                commands = [CommandSent(name=names[0], sent=sent, answers=at(t_s), level=held)]
                yield t_s + 0.02, "/commands_sent", put(CommandsSent(commands=commands), t_s + 0.02)

    def write(*more):
        with rosbag.Bag(str(tmp_path / BAG), "w") as bag:
            for t_s, topic, message in sorted((*rows(), *more), key=lambda row: row[0]):
                bag.write(topic, message, at(t_s))
        return tmp_path

    return write


def happened(active_s=6.0, **fields):
    """A jump of risc1, for which it holds."""
    return [
        (2.0, "/virtual_lab/faults", put(Faults(faults=[fault(False, **fields)]), 2.0)),
        (active_s, "/virtual_lab/faults", put(Faults(faults=[fault(True, **fields)]), active_s)),
        (6.1, "/risc1/safety", put(Safety(level=Safety.HOLD, rule=Safety.SUSPECT), 6.1)),
        (7.0, "/risc1/safety", put(Safety(level=Safety.OK), 7.0)),
    ]


def test_a_good_flight_has_its_faults_reactions_and_latencies(flight):
    judged = judge_flight(flight(*happened()), 1, "")
    assert judged["reasons"] == [] and judged["out"] == {}
    (found,) = judged["faults"]
    assert (found["name"], found["outcome"], found["safe"], found["start_s"]) == ("jump", "completed", True, 3.0)
    assert found["flying"] == 2
    assert found["reactions_ms"]["risc1"] == pytest.approx(120.0 + 1e3 * LATENCY_S, abs=25.0)
    assert judged["latency_ms"]["p99"] == pytest.approx(1e3 * LATENCY_S, abs=0.1)
    assert judged["lab_late_ms"]["p99"] == pytest.approx(1e3 * LATE_S, abs=0.1)
    assert judged["lab_gap_ms"] == pytest.approx(1e3 * STEP_S, abs=0.1)


def test_what_went_wrong_is_told(flight):
    crash = 6.5, "/virtual_lab/crash", put(Crash(vehicle="risc1", reason="fell"), 6.5)
    folder = flight(*happened(), crash)
    assert judge_flight(folder, 1, "")["reasons"] == ["fault jump:0.3,risc1: breach"]
    assert judge_flight(folder, 0, None)["reasons"] == ["fault jump:0.3,risc1: breach"], "cut short, too"
    assert any("2 of 3 faults" in reason for reason in judge_flight(folder, 3, "")["reasons"])
    assert judge_flight(folder, 3, "no hover")["reasons"][0] == "no hover"
    cut_short = judge_flight(flight(*happened()), 3, None)
    assert cut_short["reasons"] == [], "nothing is missing of it"


def test_of_a_fault_is_told_how_many_flew_when_it_began(flight):
    out = [VehicleOut("risc2", OutCause.LADDER, "landed")]
    left = OperatorState(phase=OperatorPhase.FLY, on_course=True, out=out)
    judged = judge_flight(flight(*happened(), (5.0, "/operator/phase", put(left, 5.0))), 1, "")
    assert judged["faults"][0]["flying"] == 1 and judged["reasons"] == ["risc2 landed"], "it left before the fault"


def test_references_that_end_early_say_nothing_about_where_vehicles_are_at_the_end(flight):
    whole = flight(*happened())
    with rosbag.Bag(str(whole / BAG)) as bag:
        rows = list(bag.read_messages())
    with rosbag.Bag(str(whole / BAG), "w") as bag:
        for topic, message, time in rows:
            if topic != "/trajectory" or time < at(10.0):
                bag.write(topic, message, time)
    assert judge_flight(whole, 1, "")["reasons"] == []
    with rosbag.Bag(str(whole / BAG), "w") as bag:
        for topic, message, time in rows:
            if time < at(12.0):
                bag.write(topic, message, time)
    assert any("1.00 m" in reason for reason in judge_flight(whole, 1, "")["reasons"])


def test_the_program_writes_what_it_found_and_names_a_bag_that_is_none(flight, capsys):
    folder = flight(*happened())
    assert main([str(folder), "--asked", "1"]) == 0
    assert json.loads((folder / JUDGED).read_text())["faults"][0]["name"] == "jump"
    (folder / JUDGED).unlink()
    (folder / BAG).write_text("no bag")
    assert main([str(folder), "--cut-short"]) == 1
    assert BAG in capsys.readouterr().out and not (folder / JUDGED).exists()
