"""risc_control.failsafe: every rule of the safety ladder, on a clock that the test advances."""

import dataclasses
import math

import pytest

from risc_control.failsafe import Freshness, SafetyLadder
from risc_control.fence import Fence, pushed_m_s2
from risc_control.safety import FailsafeLevel, Rule, SafetyLimits
from risc_control.separation import ALONE, Look
from risc_lab.lab import load_vehicle_type
from risc_lab.lab.arena import NET_HALF_X_M

ARDRONE = load_vehicle_type("ardrone")
INSIDE = (0.5, -0.5, 1.0)
AT_REST = (0.0, 0.0, 0.0)


class Flight:
    """A ladder in autonomous flight on which everything arrives at 200 Hz, except what the test cuts off."""

    def __init__(self, limits=None, autonomous=True):
        self.now_s = 1000.0
        self.ladder = SafetyLadder(limits or SafetyLimits(), ARDRONE, self.now_s)
        self.autonomous = autonomous
        self.position = INSIDE
        self.velocity = AT_REST
        self.battery = 80.0
        self.look, self.suspect = ALONE, ""
        self.alive = {"state", "controls", "navdata", "joystick"}
        self.run(0.1)

    def run(self, duration_s, airborne=True, obeys=False):
        """Run for duration_s; return the verdict at the end."""
        for _ in range(round(duration_s / 0.005)):
            self.now_s += 0.005
            if self.suspect:
                self.ladder.note_suspect(self.suspect, self.now_s)
            elif "state" in self.alive:
                self.ladder.note_state(self.position, self.velocity, 0.004, self.now_s)
                self.ladder.note_look(self.look, self.now_s)
            if "controls" in self.alive:
                self.ladder.controls.note(0.006, self.now_s)
            if "navdata" in self.alive:
                self.ladder.note_navdata(self.battery, self.now_s)
            if "joystick" in self.alive:
                self.ladder.note_joystick(self.now_s)
            self.ladder.update(self.now_s, self.autonomous, airborne, obeys)
        return self.ladder.verdict


def test_normal_flight_is_ok():
    verdict = Flight().run(5.0)
    assert (verdict.level, verdict.text) == (FailsafeLevel.OK, "ok")


def decided(verdict):
    """A verdict without its text."""
    return verdict.level, verdict.rule


@pytest.mark.parametrize("what", ["state", "controls"])
def test_loss_holds_then_lands(what):
    flight = Flight()
    flight.alive.remove(what)
    assert flight.run(0.09).level == FailsafeLevel.OK
    assert decided(flight.run(0.02)) == (FailsafeLevel.HOLD, Rule[what.upper()])
    assert flight.run(0.35).level == FailsafeLevel.HOLD
    assert decided(flight.run(0.05)) == (FailsafeLevel.LAND, Rule[what.upper()])
    assert [reaction.level for reaction in flight.ladder.reactions] == [FailsafeLevel.HOLD, FailsafeLevel.LAND]
    for reaction in flight.ladder.reactions:
        assert 0.0 < reaction.beyond_s <= 0.0051, "noticed at the first look after the limit"


def test_states_that_cannot_be_true_hold_then_land():
    """They do not count as states; what is wrong with them is in the reason."""
    flight = Flight()
    flight.suspect = "its yaw jumped"
    assert flight.run(0.09).level == FailsafeLevel.OK
    verdict = flight.run(0.02)
    assert (verdict.level, verdict.rule) == (FailsafeLevel.HOLD, Rule.SUSPECT) and "yaw jumped" in verdict.text
    flight.suspect = ""
    assert flight.run(0.005).level == FailsafeLevel.OK
    flight.suspect = "its yaw jumped"
    verdict = flight.run(0.51)
    assert (verdict.level, verdict.rule) == (FailsafeLevel.LAND, Rule.SUSPECT) and "yaw jumped" in verdict.text
    # one that is not seen any more is lost, whatever was wrong before
    flight = Flight()
    flight.suspect = "its yaw jumped"
    flight.run(0.05)
    flight.suspect = ""
    flight.alive.remove("state")
    assert flight.run(0.3).rule == Rule.STATE


@pytest.mark.parametrize("what", ["state", "controls", "navdata", "joystick"])
def test_without_its_ladder_a_vehicle_flies_on_whatever_is_lost(what):
    flight = Flight(SafetyLimits(ladder=False))
    flight.alive.remove(what)
    assert flight.run(5.0).level == FailsafeLevel.OK
    assert flight.ladder.autonomy_problem(flight.now_s) != "", "a flight does not begin so"
    flight.ladder.request_landing(flight.now_s)
    assert flight.ladder.verdict.level == FailsafeLevel.LAND


def test_hold_ends_at_once_when_fresh_again():
    flight = Flight()
    flight.alive.remove("state")
    assert flight.run(0.3).level == FailsafeLevel.HOLD
    flight.alive.add("state")
    assert flight.run(0.005).level == FailsafeLevel.OK


def test_land_stays_when_fresh_again_until_landed():
    flight = Flight()
    flight.alive.remove("state")
    flight.run(0.6)
    flight.alive.add("state")
    assert flight.run(1.0, obeys=True).level == FailsafeLevel.LAND
    assert flight.run(0.005, airborne=False).level == FailsafeLevel.OK


def test_land_ends_when_the_operator_takes_over():
    flight = Flight()
    flight.alive.remove("state")
    assert flight.run(0.6).level == FailsafeLevel.LAND
    flight.autonomous = False
    flight.ladder.take_over()
    assert flight.run(1.0).level == FailsafeLevel.OK, "in manual mode the operator's eyes replace mocap"


def test_old_stamps_are_losses_even_when_messages_arrive():
    ladder = SafetyLadder(SafetyLimits(), ARDRONE, 9.9)
    ladder.note_navdata(90.0, 10.0)
    ladder.note_state(INSIDE, AT_REST, 0.3, 10.0)  # a network that delivers late
    ladder.controls.note(0.3, 10.0)
    held = ladder.update(10.0, True, True)
    assert held.level == FailsafeLevel.HOLD and "300 ms" in held.reason
    ladder.note_state(INSIDE, AT_REST, 150.0, 10.1)  # the backlog after a cable was pulled
    assert ladder.update(10.1, True, True).level == FailsafeLevel.LAND


def test_a_state_that_is_old_because_none_came_is_not_called_late():
    fresh = Freshness("state", 0.1)
    fresh.note(0.004, 5.0)
    assert "124 ms" in fresh.describe(5.12) and fresh.describe(5.12).count(" ms") == 1


def test_stamps_in_the_future_do_not_count_and_say_why():
    fresh = Freshness("state", 0.1)
    fresh.note(-0.05, 5.0)
    assert fresh.age_s(5.0) == 0.0, "a little is tolerated"
    fresh.note(-2.0, 5.2)
    assert fresh.age_s(5.2) == pytest.approx(0.2)
    assert "2000 ms" in fresh.describe(5.2)
    assert "clocks" in fresh.describe(5.2)


def test_before_the_first_message():
    ladder = SafetyLadder(SafetyLimits(), ARDRONE, 0.2)
    assert math.isinf(ladder.state.age_s(1.0))
    assert "state" in ladder.autonomy_problem(1.0)
    ladder.note_state(INSIDE, AT_REST, 0.0, 1.0)
    assert "controls" in ladder.autonomy_problem(1.0)
    ladder.controls.note(0.0, 1.0)
    assert "navdata" in ladder.autonomy_problem(1.0)
    assert ladder.autonomy_problem(1.0, needs_navdata=False) == ""
    ladder.note_navdata(50.0, 1.0)
    assert ladder.autonomy_problem(1.0) == ""
    assert "state 110 ms" in ladder.autonomy_problem(1.11), "what would hold also refuses"


def test_silent_vehicle_lands():
    flight = Flight()
    flight.alive.remove("navdata")
    assert flight.run(0.99).level == FailsafeLevel.OK
    assert decided(flight.run(0.02)) == (FailsafeLevel.LAND, Rule.NAVDATA)
    off = Flight(SafetyLimits(navdata_timeout_s=0.0))
    off.alive.remove("navdata")
    assert off.run(5.0).level == FailsafeLevel.OK


@pytest.mark.parametrize("autonomous", [True, False])
def test_lost_joystick_lands_in_both_modes(autonomous):
    flight = Flight(SafetyLimits(joystick_timeout=1.0), autonomous)
    flight.alive.remove("joystick")
    assert flight.run(0.99).level == FailsafeLevel.OK
    assert decided(flight.run(0.02)) == (FailsafeLevel.LAND, Rule.JOYSTICK)
    flight.alive.add("joystick")
    assert flight.run(1.0).level == FailsafeLevel.LAND, "stays until landed or taken over"


def test_a_silent_joystick_is_no_loss_where_somebody_says_so():
    flight = Flight(SafetyLimits(joystick_timeout=0.0))
    flight.alive.remove("joystick")
    assert flight.run(30.0).level == FailsafeLevel.OK


def test_a_joystick_that_is_lost_is_missed_beside_others():
    """The person's joystick, with the emergency stop, is lost; the virtual operator's goes on."""
    flight = Flight()
    for _ in range(2):
        flight.ladder.note_joystick(flight.now_s, "/joy_node")
    assert flight.run(0.99).level == FailsafeLevel.OK
    assert "/joy_node" in flight.run(0.02).text and flight.ladder.verdict.level == FailsafeLevel.LAND
    flight.ladder.take_over()
    assert flight.run(5.0).level == FailsafeLevel.OK, "the operator knows of it"
    flight.ladder.note_joystick(flight.now_s, "/joy_node")
    assert flight.run(1.1).level == FailsafeLevel.LAND, "it was there again"


def test_whoever_sends_one_joystick_message_owes_no_second():
    flight = Flight()
    flight.ladder.note_joystick(flight.now_s, "/rostopic_1_2")
    assert flight.run(5.0).level == FailsafeLevel.OK


def test_a_joystick_that_goes_on_the_ground_is_missed_for_a_minute_but_lands_nobody():
    flight = Flight()
    for _ in range(2):
        flight.ladder.note_joystick(flight.now_s, "/joy_node")
    flight.run(0.9, airborne=False)
    assert flight.ladder.lost_joystick(flight.now_s) is None
    flight.run(0.2, airborne=False)
    assert flight.ladder.lost_joystick(flight.now_s) == "/joy_node"
    flight.now_s += 60.0
    assert flight.ladder.lost_joystick(flight.now_s) is None
    assert flight.run(5.0).level == FailsafeLevel.OK


@pytest.mark.parametrize("position", [(2.35, 0, 1), (-2.35, 0, 1), (0, 1.9, 1), (0, -1.9, 1), (0, 0, 2.9)])
def test_fence_lands_after_some_frames(position):
    flight = Flight()
    flight.position = position
    assert flight.run(0.045).level == FailsafeLevel.OK
    verdict = flight.run(0.02)
    assert verdict.level == FailsafeLevel.LAND
    assert "fence at (%.2f, %.2f, %.2f)" % position in verdict.text
    assert "fence" in flight.ladder.autonomy_problem(flight.now_s)


@pytest.mark.parametrize("position", [(2.2, 1.8, 2.7), (-2.2, -1.8, 0.0)])
def test_inside_the_fence(position):
    flight = Flight()
    flight.position = position
    assert flight.run(1.0).level == FailsafeLevel.OK


@pytest.mark.parametrize(
    ("position", "velocity", "holds"),
    [
        ((1.0, 0.0, 1.0), (1.8, 0.0, 0.0), True),  # it needs some 1.6 m to stop
        ((1.0, 0.0, 1.0), (1.2, 0.0, 0.0), False),
        ((1.95, 0.0, 1.0), (-2.0, 0.0, 0.0), False),  # on its way back in
        ((0.0, -1.6, 1.0), (0.0, -0.6, 0.0), True),
        ((0.0, 0.0, 2.5), (0.0, 0.0, 0.9), True),
        ((0.0, 0.0, 2.5), (0.0, 0.0, 0.4), False),
        ((0.0, 0.0, 0.2), (0.0, 0.0, -1.0), False),  # the floor does not count
    ],
)
def test_a_vehicle_that_cannot_stop_inside_holds_and_then_lands(position, velocity, holds):
    flight = Flight()
    flight.position, flight.velocity = position, velocity
    verdict = flight.run(0.1)
    assert (verdict.level, verdict.rule) == (
        (FailsafeLevel.HOLD, Rule.FENCE) if holds else (FailsafeLevel.OK, Rule.NONE)
    )
    verdict = flight.run(SafetyLimits.fence_land_s)
    assert verdict.level == (FailsafeLevel.LAND if holds else FailsafeLevel.OK)
    # one that has stopped in time flies on; the next time it is held until it lands
    flight = Flight()
    for lands in (False, True)[: 2 * holds]:
        flight.position, flight.velocity = position, velocity
        assert flight.run(0.3).level == FailsafeLevel.HOLD
        flight.position, flight.velocity = INSIDE, AT_REST
        assert flight.run(1.5).level == (FailsafeLevel.LAND if lands else FailsafeLevel.OK)


def test_the_place_where_it_stops_depends_on_its_type_its_tilt_and_its_link():
    ardrone, iris = Fence(SafetyLimits(), ARDRONE), Fence(SafetyLimits(), load_vehicle_type("iris"))
    late = Fence(SafetyLimits(), load_vehicle_type("ardrone", {"command_delay_s": 0.3}))
    assert iris.stop_m(0, 0.5) < ardrone.stop_m(0, 0.5) and iris.stop_m(0, 2.0) > ardrone.stop_m(0, 2.0)
    assert late.stop_m(0, 1.0) == pytest.approx(ardrone.stop_m(0, 1.0) + 0.2)
    assert ardrone.stop_m(0, 0.0) == 0.0 == ardrone.stop_m(0, -1.0)
    assert ardrone.stop_m(0, 0.0, 1.0) > 0.1 and ardrone.stop_m(0, 1.0, -1.0) < ardrone.stop_m(0, 1.0)
    assert ardrone.stop_m(0, 2.0) > 2.0 * ardrone.stop_m(0, 1.0)
    edge = (NET_HALF_X_M - 0.3, 0.0, 1.0)  # where the hull of an IRIS+ would be 0.1 m behind the net
    assert not ardrone.is_outside(edge) and iris.is_outside(edge)
    with pytest.raises(ValueError, match="fence_min_m"):
        Fence(SafetyLimits(fence_margin_m=2.0), load_vehicle_type("iris"))


@pytest.mark.parametrize(("angles_deg", "way"), [((0, -10, 0), (1, 0)), ((10, 0, 0), (0, -1)), ((0, -10, 90), (0, -1))])
def test_a_tilt_pushes(angles_deg, way):
    """Nose down: forward; right wing down: right; turned to the right, forward is where right was."""
    m_s2 = 9.80665 * math.tan(math.radians(10))
    assert pushed_m_s2(*map(math.radians, angles_deg)) == pytest.approx((m_s2 * way[0], m_s2 * way[1], 0.0))


def test_one_false_position_is_no_escape():
    flight = Flight()
    flight.position = (9.0, 0.0, 1.0)
    flight.run(0.005)
    flight.position = INSIDE
    assert flight.run(0.2).level == FailsafeLevel.OK
    flight.position = (9.0, 0.0, 1.0)
    flight.run(0.005)
    flight.alive.remove("state")  # and neither is one followed by silence
    assert flight.run(0.2).text.startswith("hold: state")


NEAR = Look(holds=True, reason="0.55 m from Raven")
JOINS = Look(holds=True, reason="0.90 m from Raven, which holds", joins=True)


def test_one_that_is_too_near_to_others_holds_then_lands():
    flight, limits = Flight(), SafetyLimits()
    flight.look = NEAR
    assert flight.run(limits.separation_delay_s - 0.01).level == FailsafeLevel.OK, "one false measurement is not enough"
    verdict = flight.run(0.02)
    assert (verdict.level, verdict.reason) == (FailsafeLevel.HOLD, NEAR.reason)
    assert flight.run(limits.separation_land_s - 0.02).level == FailsafeLevel.HOLD
    assert flight.run(0.04).level == FailsafeLevel.LAND
    flight.look = ALONE
    assert flight.run(1.0, obeys=True).level == FailsafeLevel.LAND
    assert flight.run(0.005, airborne=False).level == FailsafeLevel.OK


@pytest.mark.parametrize("what", ["state", "controls"])
def test_those_that_hold_because_of_the_same_loss_go_on_together(what):
    """Each learns a little late that the others no longer hold: without this a short loss would land them all."""
    flight, limits = Flight(), SafetyLimits()
    flight.alive.remove(what)
    assert flight.run(0.11).level == FailsafeLevel.HOLD
    flight.look = JOINS
    assert flight.run(0.1).rule in (Rule.STATE, Rule.CONTROLS)
    flight.alive.add(what)
    assert flight.run(limits.separation_delay_s - 0.01).level == FailsafeLevel.OK
    flight.look = ALONE
    assert flight.run(2.0).level == FailsafeLevel.OK
    flight.look = JOINS  # the control arm: the others do not go on
    assert flight.run(limits.separation_delay_s + 0.01).rule == Rule.SEPARATION


def test_two_that_are_near_each_other_do_not_go_on_after_a_loss():
    """Nearness seen before or during the loss counts: otherwise each short loss would give them more time."""
    flight = Flight()
    flight.alive.remove("controls")
    assert flight.run(0.11).level == FailsafeLevel.HOLD
    flight.look = NEAR
    assert flight.run(0.1).rule == Rule.CONTROLS
    flight.alive.add("controls")
    assert flight.run(0.005).rule == Rule.SEPARATION
    flight = Flight()
    flight.look = NEAR
    assert flight.run(0.03).level == FailsafeLevel.OK
    flight.alive.remove("state")
    assert flight.run(0.12).rule == Rule.STATE
    flight.alive.add("state")
    assert flight.run(0.005).rule == Rule.SEPARATION


def test_one_that_has_held_does_not_follow_its_reference():
    flight = Flight()
    flight.look = NEAR
    flight.run(0.2)
    flight.look = ALONE
    assert flight.run(0.5).level == FailsafeLevel.HOLD
    assert flight.run(0.5).level == FailsafeLevel.LAND


def test_nobody_lands_on_one_that_is_below_unless_it_stays_there():
    flight, limits = Flight(), SafetyLimits()
    flight.look = NEAR._replace(above=True, climb=1, aside=(0.0, 1.0))
    flight.run(0.5)
    assert flight.ladder.apart(flight.now_s) == NEAR._replace(above=True, climb=1), "aside only when it is time to land"
    assert flight.run(limits.separation_wait_s - 0.5).level == FailsafeLevel.HOLD
    assert flight.ladder.apart(flight.now_s) == flight.look
    assert flight.run(0.2).level == FailsafeLevel.LAND and flight.ladder.apart(flight.now_s) is None
    flight = Flight()
    flight.look = Look(holds=True, above=True)
    flight.run(3.0)
    flight.look = ALONE
    assert flight.run(0.01).level == FailsafeLevel.LAND


def test_manual_mode_leaves_the_others_to_the_operator():
    flight = Flight(autonomous=False)
    flight.look = NEAR._replace(climb=1)
    assert flight.run(3.0).level == FailsafeLevel.OK and flight.ladder.apart(flight.now_s) is None
    assert flight.ladder.autonomy_problem(flight.now_s) == NEAR.reason


def test_the_operator_takes_over_from_one_that_holds_because_of_others():
    flight = Flight()
    flight.look = NEAR
    assert flight.run(0.5).level == FailsafeLevel.HOLD
    flight.autonomous = False
    flight.ladder.take_over()
    assert flight.run(1.0).level == FailsafeLevel.OK
    flight.autonomous, flight.look = True, ALONE
    assert flight.run(3.0).level == FailsafeLevel.OK, "what was is over"


def test_what_it_flies_on_comes_before_the_others():
    flight = Flight()
    flight.look = NEAR
    flight.run(0.2)
    flight.alive.remove("controls")
    flight.run(0.2)
    assert flight.ladder.verdict.level == FailsafeLevel.HOLD and flight.ladder.verdict.reason.startswith("controls")
    assert flight.ladder.apart(flight.now_s) is None
    assert flight.run(0.35).reason.startswith("controls 5")
    flight = Flight()
    flight.look = NEAR
    flight.run(0.2)
    flight.alive.remove("state")
    flight.run(0.2)
    flight.look = ALONE
    flight.alive.add("state")
    assert flight.run(0.3).level == FailsafeLevel.HOLD, "its loss was short, but it had held before"


def test_low_battery_lands():
    flight = Flight()
    flight.battery = 10.4
    assert flight.run(0.1).level == FailsafeLevel.OK
    flight.battery = 10.0
    assert flight.run(0.495).level == FailsafeLevel.OK
    assert decided(flight.run(0.02)) == (FailsafeLevel.LAND, Rule.BATTERY)
    off = Flight(SafetyLimits(battery_min_pct=0.0))
    off.battery = 0.0
    assert off.run(1.0).level == FailsafeLevel.OK


def test_one_false_battery_report_is_no_empty_battery():
    flight = Flight()
    for silence in (False, True):
        flight.battery = 0.0
        flight.run(0.4)
        assert flight.ladder.battery_is_low(), "enough to refuse a take-off"
        if silence:
            flight.alive.remove("navdata")  # silence does not make it more true
        flight.battery = 80.0
        assert flight.run(0.5).level == FailsafeLevel.OK


def test_reports_without_a_battery_change_nothing_about_it():
    ladder = SafetyLadder(SafetyLimits(navdata_timeout_s=1.0), ARDRONE, 0.0)
    ladder.note_navdata(None, 1.0)
    assert not ladder.battery_is_low()
    assert ladder.navdata_is_fresh(1.9), "but they are reports"
    ladder.note_navdata(9.0, 2.0)
    ladder.note_navdata(None, 2.1)
    assert ladder.battery_is_low()


@pytest.mark.parametrize("autonomous", [True, False])
def test_a_requested_landing_lands_in_every_mode_until_it_stands(autonomous):
    flight = Flight(autonomous=autonomous)
    flight.ladder.request_landing(flight.now_s)
    for duration_s, obeys in ((0.005, False), (10.0, True)):
        verdict = flight.run(duration_s, obeys=obeys)
        assert decided(verdict) == (FailsafeLevel.LAND, Rule.REQUEST), "everything is fresh, and it still lands"
    assert flight.run(0.005, airborne=False).level == FailsafeLevel.OK
    assert flight.run(1.0).level == FailsafeLevel.OK, "the next flight is not landed"


def test_a_requested_landing_ends_when_the_operator_takes_over():
    flight = Flight(autonomous=False)
    flight.ladder.request_landing(flight.now_s)
    flight.run(0.1)
    flight.ladder.take_over()
    assert flight.run(1.0).level == FailsafeLevel.OK


def test_a_requested_landing_without_effect_becomes_the_operators():
    flight = Flight(autonomous=False)
    flight.ladder.request_landing(flight.now_s)
    assert not flight.run(1.9).operator
    assert flight.run(0.2).operator


def test_a_request_lands_from_hold_and_leaves_another_landing_its_reason():
    flight = Flight()
    flight.alive.remove("state")
    assert flight.run(0.3).level == FailsafeLevel.HOLD
    flight.ladder.request_landing(flight.now_s)
    assert decided(flight.run(0.005)) == (FailsafeLevel.LAND, Rule.REQUEST)
    lost = Flight()
    lost.alive.remove("navdata")
    assert lost.run(1.5).level == FailsafeLevel.LAND
    lost.ladder.request_landing(lost.now_s)
    assert decided(lost.run(0.5)) == (FailsafeLevel.LAND, Rule.NAVDATA)


@pytest.mark.parametrize("limit_s", [0.5, 1.0, 0.0])
def test_old_reports_tell_nothing(limit_s):
    ladder = SafetyLadder(SafetyLimits(navdata_timeout_s=limit_s), ARDRONE, 0.0)
    assert not ladder.navdata_is_fresh(0.0), "none yet"
    ladder.note_navdata(50.0, 10.0)
    used_s = limit_s or 1.0
    assert ladder.navdata_is_fresh(10.0 + used_s)
    assert not ladder.navdata_is_fresh(10.01 + used_s)


def test_manual_mode_needs_nothing_but_the_joystick():
    flight = Flight(autonomous=False)
    flight.alive = {"joystick"}
    flight.position, flight.battery = (5.0, 5.0, 5.0), 1.0
    assert flight.run(10.0).level == FailsafeLevel.OK


def test_on_the_ground_nothing_is_lost():
    flight = Flight()
    flight.alive.clear()
    assert flight.run(5.0, airborne=False).level == FailsafeLevel.OK


def test_landing_without_effect_becomes_the_operators():
    flight = Flight()
    flight.alive.remove("state")
    verdict = flight.run(0.6)
    assert (verdict.level, verdict.operator) == (FailsafeLevel.LAND, False)
    assert not flight.run(1.8).operator
    verdict = flight.run(0.3)
    assert verdict.operator
    assert verdict.rule is Rule.STATE
    assert "emergency stop" in verdict.text


def test_a_vehicle_that_obeys_is_left_to_land():
    flight = Flight()
    flight.alive.remove("state")
    flight.run(0.6)
    assert not flight.run(20.0, obeys=True).operator


def test_the_call_for_the_operator_ends_when_it_obeys():
    flight = Flight()
    flight.alive.remove("state")
    assert flight.run(3.0).operator
    verdict = flight.run(0.005, obeys=True)
    assert (verdict.level, verdict.operator) == (FailsafeLevel.LAND, False)
    assert "emergency stop" not in verdict.text


def test_one_report_of_landing_followed_by_silence_does_not_count_for_ever():
    flight = Flight()
    flight.alive.remove("state")
    flight.run(0.6, obeys=True)
    flight.alive.remove("navdata")
    assert not flight.run(2.9, obeys=True).operator
    verdict = flight.run(0.2, obeys=True)
    assert verdict.operator
    assert "emergency stop" in verdict.text


@pytest.mark.parametrize(
    "bad",
    [
        {"state_hold_s": 0.0},
        {"state_hold_s": 0.6},
        {"controls_land_s": 0.05},
        {"navdata_timeout_s": -1.0},
        {"fence_margin_m": math.nan},
        {"fence_margin_m": 3.0},
        {"fence_min_m": (-1.0, -1.0, math.inf)},
    ],
)
def test_bad_limits_are_named(bad):
    with pytest.raises(ValueError, match=next(iter(bad)).split("_")[0]):
        dataclasses.replace(SafetyLimits(), **bad)


def test_a_clock_that_is_behind_makes_no_state_younger():
    ladder = SafetyLadder(SafetyLimits(), ARDRONE, 0.0)
    for k in range(20):  # 2 ms on the way, our clock 50 ms behind
        ladder.note_state((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), -0.048, 0.005 * k)
    assert ladder.state.ages.behind_s == pytest.approx(0.048)
    ladder.note_state((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.06, 0.2)  # 110 ms on the way
    assert ladder.state.age_s(0.2) == pytest.approx(0.108)
