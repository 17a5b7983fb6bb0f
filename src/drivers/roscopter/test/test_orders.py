"""Orders against a scripted autopilot, with simulated time: done, refused, lost, late."""

import pytest
from bench import Bench
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from roscopter import orders

PLACES = [
    orders.Item(mavlink.MAV_CMD_NAV_WAYPOINT, 1.0, 2.0, 0.0, 90.0, 417500000 + k, -1118100000, 8.0) for k in range(3)
]
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM


@pytest.fixture(params=[1, 2], ids=["MAVLink 1", "MAVLink 2"])
def bench(request):
    return Bench(version=request.param).connect()


def test_arm_and_disarm_are_seen_in_the_heartbeat(bench):
    assert bench.order(orders.Arm(True, 10.0)).is_done
    assert bench.vehicle.is_armed and bench.autopilot.is_armed
    assert bench.order(orders.Arm(False, 10.0)).is_done
    assert not bench.vehicle.is_armed


def test_a_refusal_says_what_the_autopilot_says(bench):
    bench.vehicle.answers[ARM] = mavlink.MAV_RESULT_FAILED
    bench.vehicle.explanation = [(4, b"PreArm: RC not calibrated"), (6, b"barometer is fine")]
    outcome = bench.order(orders.Arm(True, 10.0), limit_s=2.0)
    assert not outcome.is_done
    assert "FAILED" in outcome.why and "PreArm: RC not calibrated" in outcome.why
    assert "barometer" not in outcome.why
    assert any("PreArm" in text for text in bench.said("warn"))  # it is also on rosout, with its severity


@pytest.mark.parametrize("lost", [1, 3])
def test_an_order_that_is_lost_is_sent_again(bench, lost):
    bench.vehicle.ignores = lost
    assert bench.order(orders.Arm(True, 10.0)).is_done
    assert [message.confirmation for message in bench.vehicle.named("COMMAND_LONG")] == list(range(lost + 1))


def test_an_answer_that_is_lost_does_not_matter_when_the_heartbeat_tells(bench):
    bench.vehicle.no_answers = True
    assert bench.order(orders.Arm(True, 10.0)).is_done


def test_no_answer_at_all_ends_after_the_timeout(bench):
    bench.vehicle.is_deaf = True
    begin_s = bench.now_s
    outcome = bench.order(orders.Arm(True, 4.0))
    assert not outcome.is_done and "no answer" in outcome.why
    assert bench.now_s - begin_s == pytest.approx(4.0, abs=0.2)


def test_yes_without_deeds_is_no_success(bench):
    bench.vehicle.obeys_disarm = False
    bench.vehicle.is_armed = True
    outcome = bench.order(orders.Arm(False, 3.0))
    assert not outcome.is_done and " yes" in outcome.why
    assert len(bench.vehicle.named("COMMAND_LONG")) == 1  # it was accepted, so it is not sent again


def test_an_order_in_progress_waits(bench):
    bench.vehicle.answers[ARM] = mavlink.MAV_RESULT_IN_PROGRESS
    outcomes = []
    bench.autopilot.begin(orders.Arm(True, 10.0), outcomes.append, bench.now_s)
    bench.run(3.0)
    assert not outcomes and len(bench.vehicle.named("COMMAND_LONG")) == 1
    bench.vehicle.is_armed = True
    bench.run(1.5)
    assert outcomes == [(True, "")]


def test_the_answer_to_another_command_is_none(bench):
    bench.vehicle.is_deaf = True
    outcomes = []
    bench.autopilot.begin(orders.take_off(5.0, 3.0), outcomes.append, bench.now_s)
    bench.vehicle.send("command_ack", command=mavlink.MAV_CMD_NAV_LAND, result=mavlink.MAV_RESULT_ACCEPTED)
    bench.run(1.0)
    assert outcomes == []
    bench.vehicle.send("command_ack", command=mavlink.MAV_CMD_NAV_TAKEOFF, result=mavlink.MAV_RESULT_ACCEPTED)
    bench.run(0.2)
    assert outcomes == [(True, "")]


def test_the_answer_to_another_ground_station_is_none():
    bench = Bench(version=2).connect()
    bench.vehicle.is_deaf = True
    outcomes = []
    bench.autopilot.begin(orders.take_off(5.0, 3.0), outcomes.append, bench.now_s)
    for station in (99, 255):
        answer = {"command": mavlink.MAV_CMD_NAV_TAKEOFF, "result": mavlink.MAV_RESULT_ACCEPTED}
        bench.vehicle.send("command_ack", target_system=station, **answer)
        bench.run(0.2)
        assert bool(outcomes) == (station == 255)


@pytest.mark.parametrize("number, name", [(9, "LAND"), (2, "ALT_HOLD"), (0, "STABILIZE")])
def test_a_mode_is_seen_in_the_heartbeat(bench, number, name):
    bench.vehicle.mode = 5
    assert bench.order(orders.SetMode(name, number, 1.0)).is_done
    assert bench.vehicle.mode == number and bench.autopilot.mode == name
    (sent,) = bench.vehicle.named("SET_MODE")
    assert sent.base_mode == mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED


def test_the_mode_timeout_of_a_second_leaves_time_for_a_heartbeat_a_second():
    """The original's default failed whenever a heartbeat came just before the order."""
    bench = Bench().connect()
    bench.vehicle.ignores = 1
    assert bench.order(orders.SetMode("LAND", 9, 1.0)).is_done


def test_a_mode_that_is_refused(bench):
    bench.vehicle.answers[11] = mavlink.MAV_RESULT_DENIED
    bench.vehicle.explanation = [(3, b"Mode change failed: requires position")]
    outcome = bench.order(orders.SetMode("LOITER", 5, 1.0), limit_s=2.0)
    assert not outcome.is_done and "DENIED" in outcome.why and "requires position" in outcome.why


def launch():
    return orders.Sequence(
        "launch", [orders.SetMode("GUIDED", 4, 1.0), orders.Arm(True, 10.0), orders.take_off(10.0, 15.0)]
    )


def test_launch_is_mode_arm_take_off(bench):
    assert bench.order(launch()).is_done
    assert bench.vehicle.mode == 4 and bench.vehicle.is_armed
    assert [message.command for message in bench.vehicle.named("COMMAND_LONG")] == [ARM, mavlink.MAV_CMD_NAV_TAKEOFF]
    assert bench.vehicle.named("COMMAND_LONG")[-1].param7 == 10.0


def test_launch_ends_where_it_is_refused(bench):
    bench.vehicle.answers[ARM] = mavlink.MAV_RESULT_FAILED
    outcome = bench.order(launch())
    assert not outcome.is_done and outcome.why.startswith("arm: ")
    assert [message.command for message in bench.vehicle.named("COMMAND_LONG")] == [ARM]


def test_a_newer_order_takes_the_place_of_one_that_waits(bench):
    bench.vehicle.answers[ARM] = mavlink.MAV_RESULT_IN_PROGRESS
    first = []
    bench.autopilot.begin(orders.Arm(True, 10.0), first.append, bench.now_s)
    assert bench.order(orders.SetMode("LAND", 9, 1.0)).is_done
    assert len(first) == 1 and not first[0].is_done


def test_an_order_to_nobody_fails_at_once():
    bench = Bench()
    bench.vehicle.is_silent = True
    outcomes = []
    bench.autopilot.begin(orders.Arm(True, 10.0), outcomes.append, bench.now_s)
    assert not outcomes[0].is_done and ["heard" in text for text in bench.said("error")] == [True]


def test_an_order_goes_out_to_an_autopilot_that_has_fallen_silent():
    """It may still receive: landing without telemetry is better than not trying."""
    bench = Bench().connect()
    bench.vehicle.is_silent = True
    bench.until(lambda: not bench.autopilot.is_connected)
    assert not bench.order(orders.SetMode("LAND", 9, 1.0)).is_done
    assert bench.vehicle.mode == 9


# ------------------------------------------------------------------------------------------------------- missions


def send(bench, items, limit_s=60.0):
    outcomes = []
    bench.autopilot.send_mission(items, outcomes.append, bench.now_s)
    bench.until(lambda: outcomes, limit_s)
    return outcomes[0]


@pytest.mark.parametrize("asks_int", [True, False])
def test_a_mission_arrives_as_it_is(bench, asks_int):
    bench.run(1.0)
    bench.vehicle.asks_int = asks_int
    assert send(bench, PLACES).is_done
    home, *rest = bench.vehicle.mission
    scale = 1 if asks_int else 1e-7
    assert (home.seq, home.frame, home.command) == (0, mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_CMD_NAV_WAYPOINT)
    assert home.x == pytest.approx(417500001 * scale, rel=1e-6)  # where the vehicle is
    for number, (item, place) in enumerate(zip(rest, PLACES, strict=True), 1):
        assert (item.seq, item.command, item.frame) == (number, place.command, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT)
        assert (item.param1, item.param2, item.param4, item.z) == (1.0, 2.0, 90.0, 8.0)
        assert (item.x, item.y) == pytest.approx((place.latitude * scale, place.longitude * scale), rel=1e-6)
    if asks_int:
        assert [item.x for item in rest] == [417500000, 417500001, 417500002]


@pytest.mark.parametrize("lost", [1, 2, 4])
def test_a_mission_goes_on_when_steps_are_lost(bench, lost):
    bench.vehicle.forgets = lost
    assert send(bench, PLACES).is_done
    assert len(bench.vehicle.mission) == 1 + len(PLACES)


def test_a_mission_that_nobody_takes_ends(bench):
    bench.vehicle.is_deaf = True
    begin_s = bench.now_s
    outcome = send(bench, PLACES)
    assert not outcome.is_done and "does not ask" in outcome.why
    assert bench.now_s - begin_s <= orders.longest_mission_s(len(PLACES), 0.5)


def test_a_mission_that_stops_on_the_way_ends(bench):
    outcomes = []
    bench.autopilot.send_mission(PLACES, outcomes.append, bench.now_s)
    bench.until(lambda: bench.vehicle.named("MISSION_COUNT"))
    bench.vehicle.forgets = 1000
    bench.until(lambda: outcomes)
    assert not outcomes[0].is_done and "item" in outcomes[0].why


def test_a_mission_that_is_refused(bench):
    bench.vehicle.answers["mission"] = mavlink.MAV_MISSION_NO_SPACE
    outcome = send(bench, PLACES)
    assert not outcome.is_done and "NO_SPACE" in outcome.why


def test_the_end_of_another_mission_is_not_ours(bench):
    bench.vehicle.forgets = 1
    outcomes = []
    bench.autopilot.send_mission(PLACES, outcomes.append, bench.now_s)
    bench.vehicle.acknowledge_mission(mavlink.MAV_MISSION_ACCEPTED)
    bench.step()
    assert outcomes == []
    bench.until(lambda: outcomes)
    assert outcomes[0].is_done and len(bench.vehicle.mission) == 1 + len(PLACES)


def test_a_mission_is_cleared_only_when_that_is_asked(bench):
    bench.run(15.0)  # the original does it 10 s after the first heartbeat
    assert bench.vehicle.missions_cleared == 0
    assert send(bench, []).is_done
    assert bench.vehicle.missions_cleared == 1


def test_a_mission_and_a_command_run_side_by_side(bench):
    outcomes = []
    bench.vehicle.forgets = 3
    bench.autopilot.send_mission(PLACES, outcomes.append, bench.now_s)
    assert bench.order(orders.Arm(True, 10.0)).is_done
    bench.until(lambda: outcomes)
    assert outcomes[0].is_done
