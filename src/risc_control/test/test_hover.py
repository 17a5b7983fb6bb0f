"""risc_control.hover with its pilot: a vehicle that does not hover by itself, on a clock that the test advances."""

import math

import pytest
from hover_desk import IRIS, Desk, G, Iris, flown, level_at, said
from joystick_desk import DOWN, EMERGENCY, TAKEOFF_LAND, TOGGLE, UP

from risc_control import hover, place_hold, vehicle_pilot
from risc_control.safety import FailsafeLevel, Rule
from risc_control.separation import Look
from risc_control.vehicle_pilot import VehicleNodeParams, VehiclePilot
from risc_control.vehicles import ON_GROUND, FlightState, Status
from risc_lab.lab.vehicle_types import own_numbers
from risc_lab.radio_sticks import RadioSticks

LOWEST = (0.0, 0.0, -1.0, 0.0)
ERRORS = [0.88, 1.0, 1.12]  # factors on the thrust: the range of the virtual lab's vehicles


# --- take-off, hover, landing -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("more", ERRORS)
def test_takes_off_hovers_and_lands(more):
    desk = Desk(Iris(more=more))
    x_m, y_m = desk.iris.position_m[:2]
    desk.up()
    desk.run(4.0)
    heights_m = []
    desk.run(2.0, lambda: heights_m.append(desk.iris.position_m[2]))
    assert max(abs(z_m - hover.HEIGHT_M) for z_m in heights_m) < 0.04
    assert desk.iris.position_m[:2] == pytest.approx((x_m, y_m), abs=0.01)
    desk.press(TAKEOFF_LAND)
    desk.wait_for(FlightState.LANDED, 8.0)
    assert desk.iris.impact_m_s < 0.4 and not desk.iris.armed
    in_turn = [
        FlightState.LANDED,
        FlightState.TAKING_OFF,
        FlightState.HOVERING,
        FlightState.LANDING,
        FlightState.LANDED,
    ]
    assert desk.states[-5:] == in_turn
    assert desk.counts == {"takeoff": 1, "land": 0, "reset": 0, "disarm": 1}


def test_the_throttle_is_lowest_until_it_is_armed():
    desk = Desk(Iris())
    desk.iris.arms = False
    desk.press(TAKEOFF_LAND)
    desk.run(2.0)
    assert all(sticks == LOWEST for _, sticks in desk.sent) and len(desk.sent) > 100
    assert desk.pilot.flight_state == FlightState.TAKING_OFF
    desk.iris.armed = True
    desk.run(3.0)
    assert desk.iris.position_m[2] > 0.5


def test_a_take_off_that_is_not_armed_is_refused():
    desk = Desk(Iris())
    desk.iris.arms = False
    desk.press(TAKEOFF_LAND)
    desk.wait_for(FlightState.LANDED, hover.ARMED_WITHIN_S + 0.5)
    assert "take-off refused" in said(desk)
    assert all(sticks == LOWEST for _, sticks in desk.sent) and desk.counts["disarm"] == 1


def test_a_refusal_is_told_in_the_autopilots_words():
    desk = Desk(Iris())
    desk.iris.arms = False
    desk.press(TAKEOFF_LAND)
    desk.take(desk.pilot.on_refusal("PreArm: Throttle too high", desk.now_s))
    assert desk.pilot.flight_state == FlightState.LANDED and "PreArm: Throttle too high" in said(desk)
    assert not desk.take(desk.pilot.on_refusal("too late", desk.now_s)).log


@pytest.mark.parametrize(("missing", "why"), [("state", "motion capture"), ("board", "transmitter")])
def test_what_it_cannot_be_flown_without_keeps_it_on_the_ground(missing, why):
    desk = Desk()
    desk.alive.discard(missing)
    desk.run(1.0)
    assert not desk.press(TAKEOFF_LAND).takeoff and why in said(desk)
    desk.alive.add(missing)
    desk.run(1.0)
    assert desk.press(TAKEOFF_LAND).takeoff


def test_sticks_move_the_place_that_is_held():
    desk = Desk().up()
    desk.run(2.0)
    x_m, y_m, z_m = desk.iris.position_m
    psi = desk.iris.angles_rad[2]
    desk.joy(UP, axes=(0, 0, 0, 0.0, 0, 0, 0.0, 1.0))  # forward
    desk.run(1.0)
    desk.joy()
    desk.run(3.0)
    moved_m = desk.iris.position_m[0] - x_m, desk.iris.position_m[1] - y_m, desk.iris.position_m[2] - z_m
    length_m = math.hypot(*moved_m[:2])
    assert moved_m[:2] == pytest.approx((length_m * math.cos(psi), -length_m * math.sin(psi)), abs=0.02)
    way_m, climbs_m = (  # at the one speed after a while, at the other not within a second
        speed_m_s * (1.0 - 0.5 * speed_m_s / gains_m_s2) + 0.5 * speed_m_s**2 / place_hold.STOP_M_S2
        for speed_m_s, gains_m_s2 in (
            (hover.HAND_M_S, place_hold.PLACE_M_S2),
            (place_hold.PLACE_UP_M_S2, place_hold.PLACE_UP_M_S2),
        )
    )
    assert (length_m, moved_m[2]) == pytest.approx((way_m, climbs_m), abs=0.03)
    desk.joy(axes=(0, 0, 0, 1.0, 0, 0, 0.0, 0.0))  # left turn
    desk.run(1.0)
    desk.joy()
    desk.run(2.0)
    assert desk.iris.angles_rad[2] == pytest.approx(psi - IRIS.yaw_rate_max_rad_s, abs=0.05)
    assert max(abs(v_m_s) for v_m_s in desk.iris.velocity_m_s) < 0.02
    desk.joy(DOWN)
    desk.run(4.0)  # landing is a button
    assert desk.iris.position_m[2] > 0.15


def test_it_goes_out_of_the_way():
    desk = flown(more=1.0)
    z_m = desk.iris.position_m[2]
    desk.look = Look(True, "too near", climb=1.0, aside=(0.0, 0.0), above=True)
    desk.run(2.5)
    assert desk.pilot.ladder.verdict.rule == Rule.SEPARATION
    assert desk.iris.position_m[2] > z_m + 0.4


# --- change of hands --------------------------------------------------------------------------------------------------


def dips(more):
    """Greatest change of height [m] in 1.5 s after a controller takes over, and after it gives back."""
    desk = flown(more)
    z_m, off_m = desk.iris.position_m[2], []
    desk.run(1.5, lambda: off_m.append(abs(desk.iris.position_m[2] - z_m)))
    assert desk.press(TOGGLE).mode is False
    desk.run(1.5, lambda: off_m.append(abs(desk.iris.position_m[2] - z_m)))
    return max(off_m)


@pytest.mark.parametrize("more", ERRORS)
def test_no_jump_when_a_controller_takes_over_or_gives_back(more, monkeypatch):
    assert dips(more) < 0.02
    if more != 1.0:  # without the trim that was learnt it falls
        with_none = Desk.take

        def take(desk, orders):
            if orders.command is not None and orders.command.answers is not None:
                trim = desk.pilot._adapter.trim_m_s2 / G
                sticks = orders.command.sticks
                orders.command = orders.command._replace(sticks=sticks._replace(up=sticks.up - trim))
            return with_none(desk, orders)

        monkeypatch.setattr(Desk, "take", take)
        assert dips(more) > 0.08


def test_from_motion_it_comes_to_a_stop():
    desk = flown(more=1.0)
    desk.fly = lambda desk: level_at(1.0)(desk)._replace(pitch_rad=-0.05)
    desk.run(1.5)
    v_m_s = math.hypot(*desk.iris.velocity_m_s[:2])
    assert v_m_s > 0.5
    z_m, tilts_rad = desk.iris.position_m[2], []
    desk.press(TOGGLE)
    desk.run(4.0, lambda: tilts_rad.append(math.hypot(*desk.iris.angles_rad[:2])))
    assert math.hypot(*desk.iris.velocity_m_s[:2]) < 0.02 and max(tilts_rad) < 0.3
    assert desk.iris.position_m[2] == pytest.approx(z_m, abs=0.03)


def test_while_the_next_state_may_only_be_late_it_is_level():
    def flown_without(*lost):
        """(time of the hold, the commands from the last one before the hold on)."""
        desk = flown(more=1.0)
        desk.fly = lambda desk: level_at(1.0)(desk)._replace(pitch_rad=-0.05)
        desk.run(1.5)
        desk.alive -= set(lost)
        assert desk.run(0.3, lambda: desk.pilot.ladder.verdict.rule == Rule.STATE)
        held_s = desk.now_s
        desk.run(0.3)
        first = next(k for k, (time_s, _) in enumerate(desk.sent) if time_s >= held_s)
        return held_s, desk.sent[first - 1 :]

    def tilts(*lost):
        held_s, sent = flown_without(*lost)
        return [(time_s - held_s, abs(sticks.forward)) for time_s, sticks in sent[1:]]

    late = tilts("frames")
    assert {tilt for after_s, tilt in late if after_s < vehicle_pilot._WAITS_S} == {0.0}
    assert max(tilt for _, tilt in late) > 0.2, "then it is braked"
    _, [(before_s, before), (at_s, first), *_] = flown_without("state")
    most = own_numbers(IRIS, RadioSticks).stick_rate_1_s * (at_s - before_s)
    assert abs(first.forward - before.forward) == pytest.approx(most), "as fast as its board follows, at once"
    assert tilts("state")[1][1] > 0.2, "one that motion capture says not to see is braked at once"


# --- the ladder -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("autonomous", [True, False])
def test_states_lost_level_and_then_land_mode(autonomous):
    desk = flown(more=0.9) if autonomous else Desk(Iris(more=0.9)).up()
    desk.run(3.0)
    z_m, lost_s = desk.iris.position_m[2], desk.now_s
    desk.alive.discard("state")
    desk.run(0.13)
    level = desk.sent[-1][1]
    assert (level.forward, level.left, level.turn_left) == (0.0, 0.0, 0.0) and level.up == desk.sent[-1][1].up
    desk.run(0.3)
    assert desk.iris.position_m[2] == pytest.approx(z_m, abs=0.03)  # with the trim that was learnt
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.HOLD and desk.iris.mode == "STABILIZE"
    assert desk.run(0.2, lambda: desk.iris.mode == "LAND") and desk.now_s - lost_s < 0.55
    desk.wait_for(FlightState.LANDING, 0.5)
    desk.wait_for(FlightState.LANDED, 5.0)
    assert desk.iris.impact_m_s < 0.7


def drift_of_a_landing_that_is_seen_again_m():
    """Drift [m] of a landing from where it is seen again. Motion capture failed in flight, off the take-off place."""
    desk = flown(more=1.0)
    desk.fly = lambda desk: level_at(1.0)(desk)._replace(pitch_rad=-0.05)
    desk.run(1.5)
    desk.alive.discard("state")
    assert desk.run(1.0, lambda: desk.pilot.ladder.verdict.level == FailsafeLevel.LAND)
    desk.run(0.3)
    desk.alive.add("state")
    x_m, y_m, _ = desk.iris.position_m
    assert desk.run(6.0, lambda: desk.iris.stands)
    return math.dist((x_m, y_m), desk.iris.position_m[:2])


def test_a_landing_that_is_seen_again_ends_there(monkeypatch):
    assert drift_of_a_landing_that_is_seen_again_m() < 0.1
    monkeypatch.setattr(hover, "_NEW_S", math.inf)  # the control arm: it goes back to the place that was held before
    assert drift_of_a_landing_that_is_seen_again_m() > 0.5


def blind_landing(then=1.0):
    """Desk after the loss of states and telemetry: only the radio works. then: factor on its thrust since the loss."""
    desk = flown(more=0.9)
    desk.run(2.0)
    desk.alive -= {"state", "telemetry"}
    desk.iris.more *= then
    desk.run(12.0, lambda: desk.iris.stands)
    return desk


def test_without_states_and_telemetry_it_comes_down_by_the_model(monkeypatch):
    desk = blind_landing()
    assert desk.iris.stands and desk.iris.impact_m_s < 0.8 and desk.iris.mode == "STABILIZE"
    assert desk.run(5.0, lambda: not desk.iris.armed) and desk.iris.mode == "LAND"  # nothing is sent any more
    assert desk.pilot.ladder.verdict.operator  # nothing reports that it lands
    monkeypatch.setattr(hover, "DESCENT_M_S", 0.0)
    assert not blind_landing().iris.stands


def test_where_the_model_is_wrong_its_own_failsafe_lands_it(monkeypatch):
    desk = blind_landing(then=1.01)
    assert desk.iris.stands and desk.iris.impact_m_s < 0.8 and desk.iris.mode == "LAND"
    monkeypatch.setattr(hover.Hover, "must_be_silent", lambda *_: False)
    assert not blind_landing(then=1.01).iris.stands


def test_a_silent_controller_is_held_in_place_and_then_landed():
    desk = flown()
    desk.run(1.0)
    x_m, y_m, z_m = desk.iris.position_m
    desk.fly = None
    desk.run(0.4)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.HOLD
    assert desk.iris.position_m == pytest.approx([x_m, y_m, z_m], abs=0.03)
    desk.wait_for(FlightState.LANDED, 8.0)
    assert desk.counts["land"] == 0 and desk.iris.impact_m_s < 0.4  # by motion capture, not by itself
    assert desk.iris.position_m[:2] == pytest.approx([x_m, y_m], abs=0.05)


@pytest.mark.parametrize("autonomous", [True, False])
def test_silent_telemetry_lands_it(autonomous):
    desk = flown() if autonomous else Desk().up()
    desk.alive.discard("telemetry")
    silent_s = desk.pilot._adapter.SILENT_S
    desk.run(silent_s - 0.3)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.OK
    desk.run(0.8)
    verdict = desk.pilot.ladder.verdict
    assert (verdict.level, verdict.rule) == (FailsafeLevel.LAND, Rule.NAVDATA)
    assert desk.run(6.0, lambda: desk.iris.stands) and desk.iris.impact_m_s < 0.4
    assert not desk.pilot.ladder.verdict.operator  # it is seen to come down
    desk.run(2.0)
    assert desk.sent[-1][1] == LOWEST


@pytest.mark.parametrize("autonomous", [True, False])
def test_a_silent_board_lands_it_by_itself(autonomous):
    desk = flown() if autonomous else Desk().up()
    desk.run(1.0)
    lost_s = desk.now_s
    desk.alive.discard("board")
    assert desk.run(2.0, lambda: desk.iris.mode == "LAND") and desk.now_s - lost_s < hover.WIRE_S + 0.2
    assert "transmitter" in said(desk)
    desk.wait_for(FlightState.LANDED, 5.0)


def test_commands_that_change_nothing_are_noticed():
    """The trainer switch is off: the board sends, but without effect."""
    desk = Desk().up()
    desk.run(2.0)
    desk.alive.discard("radio")
    desk.iris.step = lambda now_s: None  # its pilot holds it there
    desk.iris.velocity_m_s = [0.0] * 3
    desk.press(TAKEOFF_LAND)
    desk.run(5.0)
    assert desk.counts["land"] > 0 and desk.counts["disarm"] == 0


def test_the_autopilots_own_landing_ends_the_controllers_commands():
    desk = flown()
    desk.run(1.0)
    desk.iris.mode = "LAND"
    desk.wait_for(FlightState.LANDING, 0.5)
    answers = []
    desk.run(1.0, lambda: answers.append(desk.pilot.next_command_s))
    assert set(answers) == {math.inf}
    desk.wait_for(FlightState.LANDED, 5.0)
    assert not desk.pilot.autonomous


def test_no_autonomous_flight_in_another_mode():
    desk = Desk(fly=level_at(1.0)).up()
    desk.iris.mode = "LOITER"
    desk.wait_for(FlightState.OTHER_MODE, 1.0)
    assert desk.press(TOGGLE).mode is None and "STABILIZE" in said(desk)
    desk.iris.mode = "STABILIZE"
    desk.wait_for(FlightState.HOVERING, 1.0)
    assert desk.press(TOGGLE).mode is True


@pytest.mark.parametrize(("mode", "state"), [("LOITER", FlightState.OTHER_MODE), ("LAND", FlightState.LANDING)])
def test_another_mode_ends_autonomous_flight_and_it_goes_on_from_where_it_is(mode, state):
    desk = flown(more=1.0)
    desk.run(1.0)
    desk.iris.mode = mode
    desk.wait_for(state, 0.5)
    desk.iris.position_m[0] += 1.0  # its pilot flies it there
    desk.iris.mode = "STABILIZE"
    desk.wait_for(FlightState.HOVERING, 0.5)
    x_m = desk.iris.position_m[0]
    desk.run(2.0)
    assert not desk.pilot.autonomous and desk.iris.position_m[0] == pytest.approx(x_m, abs=0.03)


def test_a_landing_in_another_mode_is_the_autopilots():
    desk = Desk().up()
    desk.iris.mode = "ALT_HOLD"
    desk.wait_for(FlightState.OTHER_MODE, 0.5)
    desk.press(TAKEOFF_LAND)
    desk.run(0.1)
    assert desk.iris.mode == "LAND"
    desk.wait_for(FlightState.LANDED, 5.0)


def test_a_take_off_begins_without_what_was_learnt_before():
    desk = Desk(Iris(more=0.88)).up()
    desk.run(3.0)
    desk.press(TAKEOFF_LAND)
    desk.wait_for(FlightState.LANDED, 8.0)
    assert abs(desk.pilot._adapter.trim_m_s2) > 0.5
    desk.pilot._hover.observer.trim_m_s2 = -3.0  # it hung in the net
    desk.up()


def test_the_operator_takes_over_from_a_landing():
    desk = flown()
    desk.run(1.0)
    desk.fly = None
    desk.wait_for(FlightState.LANDING, 2.0)
    desk.press(TOGGLE)
    desk.wait_for(FlightState.HOVERING, 0.1)
    z_m = desk.iris.position_m[2]
    desk.run(3.0)
    assert desk.iris.position_m[2] == pytest.approx(z_m, abs=0.15)


def test_the_emergency_button_stops_the_motors():
    desk = flown()
    orders = desk.joy(EMERGENCY)
    assert orders.reset and orders.command.sticks == LOWEST
    sent = len(desk.sent)
    desk.run(1.0)
    assert {sticks for _, sticks in desk.sent[sent:]} == {LOWEST}
    desk.wait_for(FlightState.LANDED, 1.0)


def test_without_telemetry_the_emergency_button_has_the_throttle_at_its_lowest():
    desk = flown()
    desk.alive.discard("telemetry")
    desk.joy(EMERGENCY)
    desk.run(0.5)
    assert desk.iris.sticks == LOWEST


def test_a_node_that_ends_has_it_land_by_itself():
    desk = flown()
    desk.run(0.5)
    pilot, rounds = desk.pilot, 0
    while True:
        orders = desk.take(pilot.on_shutdown(desk.now_s))
        assert orders.land and orders.command is not None
        rounds += 1
        desk.alive.discard("node")
        desk.run(0.05)
        pilot.on_status(Status(desk.iris.state, 60.0), desk.now_s)
        if not pilot.needs_landing(desk.now_s):
            break
        assert rounds < 5
    assert desk.iris.mode == "LAND"
    desk.run(4.0, lambda: not desk.iris.armed)
    assert desk.iris.stands and desk.iris.impact_m_s < 0.7
    dead = flown()
    dead.run(0.5)
    dead.alive.discard("node")
    dead.run(0.5)
    assert dead.iris.mode == "STABILIZE" and not dead.iris.stands, "without last orders it flies on"


@pytest.mark.parametrize("first", ["state", "telemetry"])
def test_a_node_that_comes_back_in_flight_holds_the_vehicle_where_it_is(first):
    desk = flown()
    desk.run(1.0)
    desk.fly, z_m = None, desk.iris.position_m[2]
    desk.pilot = VehiclePilot(VehicleNodeParams(joystick_timeout=0.0), IRIS, desk.now_s)
    second = {"state", "telemetry"} - {first}
    desk.alive -= second
    sent = len(desk.sent)
    desk.run(0.4)
    assert len(desk.sent) == sent, "it does not know yet where the vehicle is, or what it does"
    desk.alive |= second
    desk.run(0.3, lambda: len(desk.sent) > sent)
    assert desk.pilot.flight_state == FlightState.HOVERING
    desk.run(3.0)
    assert LOWEST not in {sticks for _, sticks in desk.sent[sent:]}
    assert desk.iris.mode == "STABILIZE" and desk.iris.position_m[2] == pytest.approx(z_m, abs=0.15)


def test_a_node_that_ends_leaves_a_vehicle_that_stands_alone():
    desk = Desk()
    orders = desk.pilot.on_shutdown(desk.now_s)
    assert not orders.land and not desk.pilot.needs_landing(desk.now_s)
    silent = Desk()
    silent.alive.discard("telemetry")
    silent.run(4.0)
    assert silent.pilot.on_shutdown(silent.now_s).land


def test_a_node_that_ends_waits_until_the_vehicle_says_that_it_lands():
    desk = flown()
    desk.take(desk.pilot.on_shutdown(desk.now_s))
    assert desk.pilot.needs_landing(desk.now_s)  # our own landing would end with the node


def test_a_new_node_holds_a_vehicle_that_flies():
    desk = Desk(Iris(more=0.9)).up()
    desk.run(3.0)
    place_m = list(desk.iris.position_m)
    again = Desk.__new__(Desk)
    again.__dict__ = {**desk.__dict__, "pilot": vehicle_pilot.VehiclePilot(desk.pilot._params, IRIS, desk.now_s)}
    again.wait_for(FlightState.HOVERING, 1.0)
    again.run(3.0)
    assert again.iris.position_m[:2] == pytest.approx(place_m[:2], abs=0.1) and again.iris.position_m[2] > 0.6


@pytest.mark.parametrize("mode", ["LAND", "STABILIZE"])
@pytest.mark.parametrize("seen", [True, False])
def test_a_new_node_does_not_say_of_a_vehicle_in_the_air_that_it_stands(mode, seen):
    """Otherwise an operator would think that the flight is over."""
    desk = Desk().up()
    desk.run(2.0)
    desk.iris.mode = mode
    again = Desk.__new__(Desk)
    again.__dict__ = {**desk.__dict__, "pilot": vehicle_pilot.VehiclePilot(desk.pilot._params, IRIS, desk.now_s)}
    again.alive = desk.alive - {"radio", *(() if seen else ("state", "frames"))}
    said = set()
    again.run(0.8, lambda: said.add(again.pilot.flight_state))
    assert desk.iris.armed and not desk.iris.stands and not said & ON_GROUND


def test_a_vehicle_that_somebody_armed_on_the_ground_stays_there():
    desk = Desk()
    desk.iris.armed = True
    desk.run(2.0)
    assert desk.pilot.flight_state == FlightState.INIT and desk.sent[-1][1] == LOWEST and desk.iris.stands
    assert desk.press(TAKEOFF_LAND).disarm
    desk.wait_for(FlightState.LANDED, 1.0)


def test_a_landing_that_is_asked_for_ends_a_take_off_that_is_not_armed_yet():
    desk = Desk()
    desk.iris.arms = False
    desk.press(TAKEOFF_LAND)
    desk.run(0.5)
    assert desk.take(desk.pilot.on_land_request(desk.now_s)).land
    desk.iris.arms = True
    desk.run(3.0)
    assert desk.pilot.flight_state == FlightState.LANDED and desk.iris.stands


def test_the_button_ends_a_take_off_that_is_not_armed_yet():
    desk = Desk()
    desk.iris.arms = False
    desk.press(TAKEOFF_LAND)
    desk.run(0.2)
    assert desk.press(TAKEOFF_LAND).disarm and desk.pilot.flight_state == FlightState.LANDED


def test_the_charge_moves_the_throttle():
    """Eq. 5.5 with the charge that the vehicle reports: between 90 and 50 % the throttle differs by 0.2."""
    throttles = []
    for battery_pct in (90.0, 50.0):
        desk = Desk(Iris(battery_pct=battery_pct)).up()
        desk.run(3.0)
        throttles.append(desk.sent[-1][1].up)
    assert throttles[1] - throttles[0] == pytest.approx(0.21, abs=0.01)
