"""risc_control.vehicle_pilot: what the vehicle node decides, on a clock that the test advances."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from joystick_desk import EMERGENCY, SHUT_DOWN, TAKEOFF_LAND, TOGGLE, UP, JoystickDesk
from scipy.integrate import solve_ivp

from risc_control.failsafe import SafetyLadder
from risc_control.joystick import Sticks
from risc_control.safety import FailsafeLevel, Rule, fence_of
from risc_control.separation import ALONE, Look
from risc_control.vehicle_pilot import (
    OwnState,
    SlotClock,
    VehicleNodeParams,
    VehiclePilot,
)
from risc_control.vehicles import Controls, FlightState, Status
from risc_control.vehicles.ardrone import climb_ahead, status
from risc_lab.command_history import CommandHistory
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab.arena import Arena
from risc_lab.lab.vehicle_types import load_vehicle_type
from risc_lab.settings import settings_from

ARDRONE = load_vehicle_type("ardrone")
HOVER_N = ARDRONE.mass_kg * GRAVITY_M_S2
LEVEL = OwnState((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)


class Desk(JoystickDesk):
    """A pilot with everything around it: ticks at 60 Hz, states and controls at 200 Hz, navdata at 50 Hz.

    With "joystick" in `alive` the newest joystick message is repeated at 20 Hz.
    """

    def __init__(self, **params):
        parsed = VehicleNodeParams(**{"joystick_timeout": 0.0, "preflight": False, **params})
        self.now_s = 500.0
        self.pilot = VehiclePilot(parsed, ARDRONE, self.now_s)
        self.flight_state = FlightState.LANDED
        self.battery = 90.0
        self.sensed = dict  # further fields of its Status
        self.state, self.look, self.suspect = LEVEL, ALONE, ""
        self.control = Controls(0.0, 0.0, 0.0, HOVER_N)
        self.alive = {"state", "controls", "navdata"}
        self.orders = []  # (time, Orders) that ask for something
        self._step = 0
        self.run(0.2)

    def take(self, orders):
        self.orders.append((self.now_s, orders))
        return orders

    def run(self, duration_s):
        """Run for duration_s; return the commands sent meanwhile as [(time, Sticks, stamp)]."""
        first = len(self.orders)
        for _ in range(round(duration_s / 0.005)):
            self.now_s += 0.005
            self._step += 1
            if self.suspect:
                self.pilot.on_suspect(self.suspect, self.now_s)
            elif "state" in self.alive:
                self.pilot.on_state(self.state, 0.004, self.now_s, self.look)
            if "controls" in self.alive:
                self.take(self.pilot.on_controls(self.control, 1e9 + self.now_s, 0.005, self.now_s))
            if "navdata" in self.alive and self._step % 4 == 0:
                status = Status(self.flight_state, self.battery, **self.sensed())
                self.take(self.pilot.on_status(status, self.now_s))
            if "joystick" in self.alive and self._step % 10 == 0:
                self.repeat()
            if self._step % 3 == 0:
                self.take(self.pilot.tick(self.now_s))
        return [(t, *orders.command[:2]) for t, orders in self.orders[first:] if orders.command is not None]

    def fly(self, autonomous=False):
        """Bring the vehicle into the air."""
        self.flight_state = FlightState.FLYING
        self.run(0.2)
        if autonomous:
            assert self.press(TOGGLE).mode is True
        return self

    def count(self, what, since=0):
        return sum(bool(getattr(orders, what)) for _, orders in self.orders[since:])


def texts(orders):
    return " ".join(text for _, text in orders.log)


# --- take-off and landing --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("state", list(FlightState))
def test_the_reported_state_decides_between_takeoff_and_landing(state):
    desk = Desk()
    desk.flight_state = state
    desk.run(0.1)
    for _ in range(3):  # pressing again never inverts (D-31)
        orders = desk.press(TAKEOFF_LAND)
        assert (orders.takeoff, orders.land) == ((True, False) if state == FlightState.LANDED else (False, True))


def _lose(what):
    return lambda desk: (desk.alive.discard(what), desk.run(0.2))


def _see(**changes):
    def change(desk):
        desk.state = LEVEL._replace(**changes)
        desk.run(0.4)

    return change


def _rarely(desk):
    desk.alive.discard("state")
    for _ in range(30):
        desk.pilot.on_state(desk.state, 0.004, desk.now_s)
        desk.run(0.09)


def _late(desk):
    desk.alive.discard("state")
    for _ in range(30):
        desk.pilot.on_state(desk.state, 0.12, desk.now_s)
        desk.run(0.02)


def _suspect(desk):
    desk.suspect = "its yaw jumped"
    desk.run(0.05)


@pytest.mark.parametrize(
    ("trouble", "words"),
    [
        (_lose("state"), "uncover"),
        (_rarely, "a second"),
        (_late, "0.12 s old"),
        (_see(position_m=(0.0, 1.95, 0.1)), "inside"),
        (_see(phi_rad=0.4), "level floor"),
        (_lose("controls"), "controller"),
        (lambda desk: [desk.pilot.on_markers(3, 4) for _ in range(3)], "3 of its markers"),
        (_suspect, "yaw jumped"),
        (lambda desk: setattr(desk.pilot, "_nearest", lambda: (0.4, "albatross")), "from albatross"),
    ],
)
def test_preflight_checks_refuse_a_take_off_and_say_what_to_do(trouble, words):
    for preflight in (True, False):
        desk = Desk(preflight=preflight)
        trouble(desk)
        orders = desk.press(TAKEOFF_LAND)
        assert orders.takeoff is not preflight
        assert (words in texts(orders)) is preflight, texts(orders)
        assert len(orders.refusals) == preflight and all(words in text for text in orders.refusals)


def test_preflight_checks_let_take_off_what_is_ready():
    desk = Desk(preflight=True)
    desk.pilot._nearest = lambda: (0.6, "albatross")
    assert desk.press(TAKEOFF_LAND).takeoff
    for markers in ([(3, 4), (4, 4), (3, 4)], []):  # one was hidden for a moment; no counts came
        desk = Desk(preflight=True)
        for counted in markers:
            desk.pilot.on_markers(*counted)
        assert desk.press(TAKEOFF_LAND).takeoff
    desk = Desk(preflight=True, preflight_markers=3)
    desk.pilot.on_markers(3, 4)
    assert desk.press(TAKEOFF_LAND).takeoff
    for needed in (False, True):
        desk = Desk(preflight=True)
        params = VehicleNodeParams(joystick_timeout=0.0, preflight_controller=needed)
        desk.pilot = VehiclePilot(params, ARDRONE, desk.now_s)
        desk.alive.discard("controls")  # no controller was heard: it is flown by hand
        desk.run(0.5)
        orders = desk.press(TAKEOFF_LAND)
        assert orders.takeoff is not needed
        assert ("no controller was heard" in texts(orders)) is needed
        desk.alive.add("controls")
        desk.run(0.5)
        assert needed is False or desk.press(TAKEOFF_LAND).takeoff
    desk = Desk(preflight=True)
    desk.pilot.disagreement = "the full scales differ"
    orders = desk.press(TAKEOFF_LAND)
    assert not orders.takeoff and desk.pilot.disagreement in texts(orders)
    desk = Desk(preflight=True)
    desk.pilot = VehiclePilot(VehicleNodeParams(joystick_timeout=0.0), ARDRONE, desk.now_s)
    desk.alive.discard("state")
    desk.run(0.5)
    assert "not seen" in texts(desk.press(TAKEOFF_LAND))


@pytest.mark.parametrize("limit_s", [1.0, 0.0])
def test_no_take_off_while_a_joystick_is_lost(limit_s):
    """The person's, with the emergency stop; the virtual operator's is still there. Without the limit it takes off."""
    desk = Desk(joystick_timeout=limit_s)
    for sender in ("/joy_node", "/operator", "/joy_node"):
        desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s, sender=sender)
    desk.run(1.1)
    orders = desk.press(TAKEOFF_LAND)
    if limit_s == 0.0:
        assert orders.takeoff
        return
    assert not orders.takeoff and "/joy_node" in texts(orders)
    desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s, sender="/joy_node")
    assert desk.press(TAKEOFF_LAND).takeoff


def test_a_simulator_needs_no_joystick():
    desk = Desk(Simulation=True, joystick_timeout=1.0)
    desk.run(5.0)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.OK
    desk.joy()
    desk.run(1.1)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.LAND


def test_without_navdata_the_button_lands():
    desk = Desk()
    desk.pilot = VehiclePilot(VehicleNodeParams(), ARDRONE, desk.now_s)
    orders = desk.press(TAKEOFF_LAND)
    assert (orders.takeoff, orders.land) == (False, True)
    assert "heard" in texts(orders)
    assert len(orders.refusals) == 1 and "Wi-Fi" in orders.refusals[0]
    assert orders.refusals[0] in texts(orders)
    desk.run(0.1)
    assert desk.press(TAKEOFF_LAND).refusals == [], "it is heard now, and takes off"


@pytest.mark.parametrize("looks", [True, False])
def test_no_take_off_when_the_last_word_of_one_that_stands_is_old(looks, monkeypatch):
    """If the age of its last report is not checked, it takes off."""
    desk = Desk()
    desk.alive.remove("navdata")
    desk.run(1.1)
    if not looks:
        monkeypatch.setattr(SafetyLadder, "navdata_is_fresh", lambda *_: True)
    orders = desk.press(TAKEOFF_LAND)
    assert (orders.takeoff, orders.land) == (not looks, looks)
    assert ["Wi-Fi" in text for text in orders.refusals] == [True] * looks


def test_a_landing_of_one_that_is_silent_in_the_air_is_no_refusal():
    desk = Desk().fly()
    desk.alive.remove("navdata")
    desk.run(1.1)
    orders = desk.press(TAKEOFF_LAND)
    assert orders.land and orders.refusals is None


@pytest.mark.parametrize("limit_s", [1.0, 0.4, 0.0])
def test_an_old_report_of_landed_does_not_take_off_again(limit_s):
    """Take-off was pressed, then the vehicle falls silent; its last report is "landed"."""
    desk = Desk(navdata_timeout_s=limit_s)
    assert desk.press(TAKEOFF_LAND).takeoff
    desk.alive.remove("navdata")
    desk.run(1.1)
    for _ in range(3):
        orders = desk.press(TAKEOFF_LAND)
        assert (orders.takeoff, orders.land) == (False, True)
        assert "silent" in texts(orders)
        desk.run(20.0)
    assert desk.pilot.airborne
    assert desk.pilot.needs_landing(desk.now_s), "the last orders of the node are repeated"


def test_landed_counts_again_some_time_after_a_takeoff_without_effect():
    desk = Desk(joystick_timeout=1.0)
    assert desk.press(TAKEOFF_LAND).takeoff
    assert desk.pilot.airborne
    desk.run(2.9)
    assert desk.pilot.airborne
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.LAND, "the joystick fell silent, and it may be in the air"
    desk.run(0.2)
    assert not desk.pilot.airborne
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.OK
    desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s)
    assert desk.press(TAKEOFF_LAND).takeoff


def test_a_press_that_was_held_up_is_not_obeyed():
    """It was meant to land the vehicle, which its ladder has landed meanwhile: now it would be a take-off."""
    desk = Desk()
    buttons = [1 if k == TAKEOFF_LAND else 0 for k in range(11)]
    for age_s in (10.0, 9.95, 0.31):
        orders = desk.pilot.on_joy(buttons, [0.0] * 8, desk.now_s, age_s)
        assert (orders.takeoff, orders.land, orders.command) == (False, False, None)
        assert any("%.1f s late" % age_s in text for _, text in orders.log)
    orders = desk.pilot.on_joy(buttons, [0.0] * 8, desk.now_s, 0.29)
    assert not orders.takeoff, "the button has been down since"
    desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s, 0.05)
    assert desk.pilot.on_joy(buttons, [0.0] * 8, desk.now_s, 0.05).takeoff


@pytest.mark.parametrize(("button", "order"), [(EMERGENCY, "reset"), (SHUT_DOWN, "shut_down"), (TAKEOFF_LAND, "land")])
def test_a_button_to_stop_that_went_down_in_a_late_message_counts_when_it_is_still_down_in_time(button, order):
    desk = Desk().fly(autonomous=True)
    found = []
    for age_s, down in ((0.0, ()), (0.4, (button,)), (0.35, (button,)), (0.25, (button,)), (0.2, (button,)), (0.2, ())):
        orders = desk.pilot.on_joy([int(k in down) for k in range(11)], [0.0] * 8, desk.now_s, age_s)
        found.append(getattr(orders, order))
    assert found == [False, False, False, True, False, False]


def test_a_button_that_was_down_only_in_late_messages_is_none():
    desk = Desk().fly(autonomous=True)
    for age_s, down in ((10.0, EMERGENCY), (9.0, None), (0.1, None)):
        assert not desk.pilot.on_joy([int(k == down) for k in range(11)], [0.0] * 8, desk.now_s, age_s).reset


def test_the_toggle_that_went_down_in_a_late_message_ends_autonomous_mode_and_never_begins_it():
    desk = Desk().fly(autonomous=True)
    buttons = [int(k == TOGGLE) for k in range(11)]
    assert desk.pilot.on_joy(buttons, [0.0] * 8, desk.now_s, 0.4).mode is None
    assert desk.pilot.on_joy(buttons, [0.0] * 8, desk.now_s, 0.2).mode is False
    desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s)
    desk.pilot.on_joy(buttons, [0.0] * 8, desk.now_s, 0.4)
    assert desk.pilot.on_joy(buttons, [0.0] * 8, desk.now_s, 0.2).mode is None
    assert not desk.pilot.autonomous


def test_sticks_that_were_held_up_move_nothing():
    desk = Desk().fly()
    for age_s, up in ((1.0, 0.0), (0.1, 1.0)):
        desk.pilot.on_joy([1 if k == UP else 0 for k in range(11)], [0.0] * 8, desk.now_s, age_s)
        assert {sticks.up for _, sticks, _ in desk.run(0.3)} == {up}


def test_a_joystick_whose_messages_are_all_late_counts_as_silent():
    desk = Desk(joystick_timeout=1.0).fly()
    for _ in range(15):
        desk.now_s += 0.1
        desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s, 0.5)
        desk.pilot.tick(desk.now_s)
    assert (desk.pilot.ladder.verdict.level, desk.pilot.ladder.verdict.rule) == (FailsafeLevel.LAND, Rule.JOYSTICK)


def test_a_joystick_stamped_by_a_clock_that_is_ahead_is_obeyed_and_its_late_messages_are_not():
    desk = Desk()
    buttons = [1 if k == TAKEOFF_LAND else 0 for k in range(11)]
    desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s, -2.0)
    assert not desk.pilot.on_joy(buttons, [0.0] * 8, desk.now_s, -1.0).takeoff, "one second late"
    desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s, -2.0)
    assert desk.pilot.on_joy(buttons, [0.0] * 8, desk.now_s, -1.95).takeoff


def test_the_clock_of_another_computer_makes_no_joystick_late():
    """A virtual operator on a computer whose clock is ahead, and a person's joystick beside it, for safety."""
    desk = Desk().fly()
    desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s, -2.0, "/operator")
    buttons = [int(k == EMERGENCY) for k in range(11)]
    assert desk.pilot.on_joy(buttons, [0.0] * 8, desk.now_s, 0.001, "/risc1/joy_node").reset


@pytest.mark.parametrize("age_s", [0.0, 0.4])
def test_of_two_joysticks_neither_makes_a_held_button_a_new_press(age_s):
    """Held until the vehicle stands, the button to land would be a take-off."""
    desk = Desk().fly()
    down = [int(k == TAKEOFF_LAND) for k in range(11)]
    lands = takeoffs = 0
    for k in range(40):
        if k == 20:
            desk.flight_state = FlightState.LANDED
        desk.run(0.05)
        desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s, 0.0, "/operator")
        orders = desk.pilot.on_joy(down, [0.0] * 8, desk.now_s, age_s if k < 10 else 0.0, "/risc1/joy_node")
        lands, takeoffs = lands + orders.land, takeoffs + orders.takeoff
    assert (lands, takeoffs) == (1, 0)


def test_of_two_joysticks_the_larger_deflection_counts():
    """A person's sticks beside a virtual operator, whose joystick says 30 times a second that its own are centred."""
    desk = Desk(AxisRoll=0, AxisPitch=1).fly()
    desk.pilot.on_joy([0] * 11, [0.5, -1.0] + [0.0] * 6, desk.now_s, 0.0, "/risc1/joy_node")
    desk.pilot.on_joy([0] * 11, [-0.2] + [0.0] * 7, desk.now_s, 0.0, "/operator")
    assert {sticks for _, sticks, _ in desk.run(0.2)} == {Sticks(-1.0, 0.5, 0.0, 0.0)}


def test_without_a_timeout_a_dead_joysticks_deflection_ends_with_the_next_message_of_another():
    desk = Desk(stick_timeout=0.0).fly()
    desk.pilot.on_joy([int(k == UP) for k in range(11)], [0.0] * 8, desk.now_s, 0.0, "/risc1/joy_node")
    assert {sticks.up for _, sticks, _ in desk.run(1.0)} == {1.0}
    desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s, 0.0, "/operator")
    assert {sticks.up for _, sticks, _ in desk.run(0.2)} == {0.0}


def test_a_silent_joysticks_deflection_ends_while_another_goes_on():
    desk = Desk(stick_timeout=0.5).fly()
    desk.pilot.on_joy([int(k == UP) for k in range(11)], [0.0] * 8, desk.now_s, 0.0, "/risc1/joy_node")
    ups, orders = [], len(desk.orders)
    for _ in range(8):
        desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s, 0.0, "/operator")
        ups.extend(sticks.up for _, sticks, _ in desk.run(0.1))
    assert (ups[0], ups[-1]) == (1.0, 0.0)
    assert "/risc1/joy_node" in " ".join(texts(order) for _, order in desk.orders[orders:])


def test_a_toggle_that_went_down_in_a_late_message_does_not_take_back_the_ladders_landing():
    desk = Desk().fly(autonomous=True)
    desk.alive = {"navdata"}
    desk.run(0.7)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.LAND
    for age_s in (0.4, 0.2):
        desk.pilot.on_joy([int(k == TOGGLE) for k in range(11)], [0.0] * 8, desk.now_s, age_s)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.LAND


def test_a_joystick_whose_clock_was_set_back_is_obeyed_again_soon():
    desk = Desk().fly()
    desk.pilot.on_joy([0] * 11, [0.0] * 8, desk.now_s, -2.0)
    since_s, buttons = desk.now_s, [int(k == EMERGENCY) for k in range(11)]
    while not desk.pilot.on_joy(buttons, [0.0] * 8, desk.now_s, 0.001).reset:
        desk.now_s += 0.05
        assert desk.now_s - since_s < 4.1


def test_landed_counts_at_once_when_the_takeoff_was_seen():
    desk = Desk()
    desk.press(TAKEOFF_LAND)
    for state, airborne in (
        (FlightState.TAKING_OFF, True),
        (FlightState.LANDING, True),
        (FlightState.UNKNOWN, True),
        (FlightState.LANDED, False),
    ):
        desk.flight_state = state
        desk.run(0.1)
        assert desk.pilot.airborne is airborne


def test_needs_landing_until_it_reports_that_it_lands():
    desk = Desk()
    assert not desk.pilot.needs_landing(desk.now_s)
    desk.fly()
    assert desk.pilot.needs_landing(desk.now_s)
    desk.flight_state = FlightState.LANDING
    desk.run(0.1)
    assert not desk.pilot.needs_landing(desk.now_s)
    desk.alive.remove("navdata")
    desk.run(1.1)
    assert desk.pilot.needs_landing(desk.now_s), "an old report"


@pytest.mark.parametrize("limits", [{}, {"navdata_timeout_s": 0.0}])
def test_reports_that_repeat_themselves_are_no_reports(limits):
    desk = Desk(**limits).fly(autonomous=True)
    for velocity in (lambda: (0.001 * desk.now_s, 0.0), lambda: (0.0, 0.0)):  # it moves; a model at rest
        desk.sensed = lambda velocity=velocity: {"velocity_m_s": velocity()}
        desk.run(3.0)
        assert desk.pilot.ladder.verdict.level == FailsafeLevel.OK
    desk.sensed = lambda: {"velocity_m_s": (0.01, 0.0)}
    desk.run(0.9)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.OK
    desk.run(0.3)
    lands = desk.pilot.ladder.verdict.level == FailsafeLevel.LAND
    assert lands is not bool(limits)
    assert ("navdata the same for 1.0 s" in desk.pilot.ladder.verdict.reason) is lands


def test_a_vehicle_that_stands_may_repeat_itself():
    desk = Desk()
    desk.sensed = lambda: {"velocity_m_s": (0.3, 0.0)}
    desk.run(3.0)
    assert desk.press(TAKEOFF_LAND).takeoff


@pytest.mark.parametrize("limits", [{}, {"battery_min_pct": 0.0}])
def test_takeoff_is_refused_on_an_empty_battery_unless_the_limit_is_off(limits):
    desk = Desk(**limits)
    desk.battery = 9.0
    desk.run(0.1)
    orders = desk.press(TAKEOFF_LAND)
    assert orders.takeoff is bool(limits)
    assert ("battery" in texts(orders)) is not bool(limits)


def test_holding_the_button_counts_once():
    desk = Desk()
    assert desk.joy(TAKEOFF_LAND).takeoff
    for _ in range(20):
        assert not desk.joy(TAKEOFF_LAND).takeoff


def test_landing_ends_autonomous_mode():
    desk = Desk().fly(autonomous=True)
    orders = desk.press(TAKEOFF_LAND)
    assert (orders.land, orders.mode) == (True, False)


@pytest.mark.parametrize("state", [FlightState.LANDED, FlightState.FLYING, FlightState.UNKNOWN])
@pytest.mark.parametrize("autonomous", [True, False])
def test_emergency_works_always(state, autonomous):
    desk = Desk().fly(autonomous)
    desk.flight_state = state
    desk.alive = {"navdata"}
    desk.run(1.0)
    assert desk.press(EMERGENCY).reset


def test_shut_down_button():
    assert Desk().press(SHUT_DOWN).shut_down


@pytest.mark.parametrize("ends", [True, False])
def test_last_orders_are_level_and_land_and_nothing_follows(ends, monkeypatch):
    """Were the end not remembered, the controller would fly on after the last order, and the button take off."""
    if not ends:
        monkeypatch.setattr(VehiclePilot, "_ended", property(lambda _: False, lambda *_: None), raising=False)
    desk = Desk().fly(autonomous=True)
    desk.control = Controls(0.1, 0.0, 0.0, HOVER_N)
    assert desk.run(0.1)[-1][1].left == pytest.approx(0.1)
    assert desk.count("land") == 0, "without them it flies on"
    orders = desk.pilot.on_shutdown(desk.now_s)
    assert orders.land
    assert orders.command[:2] == (Sticks(0.0, 0.0, 0.0, 0.0), None)
    follows = desk.run(1.0)  # controls still arrive while the node ends
    assert (follows == []) is ends
    assert ends or follows[-1][1].left == pytest.approx(0.1)
    desk.flight_state = FlightState.LANDED
    desk.run(0.1)
    assert desk.press(TAKEOFF_LAND).takeoff is not ends
    assert desk.press(EMERGENCY).reset


# --- modes -----------------------------------------------------------------------------------------------------------


def test_starts_in_manual_mode_and_toggles():
    desk = Desk().fly()
    assert not desk.pilot.autonomous
    assert desk.press(TOGGLE).mode is True
    assert desk.press(TOGGLE).mode is False


@pytest.mark.parametrize("lost", ["state", "controls"])
def test_autonomous_mode_is_refused_without_data(lost):
    """D-30: the button before the first Controls message ended the node."""
    desk = Desk()
    desk.pilot = VehiclePilot(VehicleNodeParams(), ARDRONE, desk.now_s)
    desk.alive.remove(lost)
    desk.fly()
    orders = desk.press(TOGGLE)
    assert orders.mode is None
    assert not desk.pilot.autonomous
    assert "no %s " % lost in texts(orders)


def test_autonomous_mode_is_refused_on_old_data():
    desk = Desk().fly()
    desk.alive.remove("controls")
    desk.run(0.2)
    assert "controls 2" in texts(desk.press(TOGGLE))


@pytest.mark.parametrize("state", list(FlightState))
def test_autonomous_mode_only_when_commands_go_out(state):
    """References start to move with the switch; a vehicle that takes no commands yet would be left behind."""
    desk = Desk()
    desk.flight_state = state
    desk.run(0.1)
    orders = desk.press(TOGGLE)
    if state in (3, 4, 7):
        assert orders.mode is True
    else:
        assert orders.mode is None
        assert "(state %d, %s)" % (state, state.name.lower().replace("_", " ")) in texts(orders)


def test_autonomous_mode_in_a_state_of_no_name():
    desk = Desk()
    desk.flight_state = 12
    desk.run(0.1)
    assert "state 12" in texts(desk.press(TOGGLE))
    off = Desk(navdata_timeout_s=0.0)
    off.pilot = VehiclePilot(VehicleNodeParams(navdata_timeout_s=0.0), ARDRONE, off.now_s)
    off.alive.remove("navdata")
    off.run(0.1)
    assert "no state yet" in texts(off.press(TOGGLE))


def test_status_is_published_at_30_hz():
    desk = Desk()
    since = len(desk.orders)
    desk.run(3.0)
    statuses = [orders.status for _, orders in desk.orders[since:] if orders.status is not None]
    assert len(statuses) == pytest.approx(90, abs=1)
    assert not any(statuses)


# --- commands --------------------------------------------------------------------------------------------------------


def test_manual_commands_go_out_at_30_hz_and_follow_the_sticks():
    desk = Desk(ScaleRoll=2.0).fly()
    axes = [0.0] * 8
    axes[6], axes[7], axes[3] = 0.5, -1.0, 0.25
    desk.alive.add("joystick")
    desk.joy(UP, axes=axes)
    sent = desk.run(3.0)
    assert len(sent) == pytest.approx(90, abs=1)
    for _, sticks, stamp_s in sent:
        assert (sticks, stamp_s) == (Sticks(-1.0, 0.25, 1.0, 0.25), None)


def test_a_silent_joystick_centres_its_sticks():
    desk = Desk().fly()
    axes = [0.0] * 8
    axes[7] = 0.5
    desk.joy(UP, axes=axes)
    assert {sticks for _, sticks, _ in desk.run(0.45)} == {Sticks(0.5, 0.0, 1.0, 0.0)}
    desk.run(0.1)
    assert {sticks for _, sticks, _ in desk.run(5.0)} == {Sticks(0.0, 0.0, 0.0, 0.0)}
    warnings = [text for _, orders in desk.orders for level, text in orders.log if level == "warn"]
    assert len(warnings) == 1
    assert "autorepeat_rate" in warnings[0]
    desk.joy(UP, axes=axes)
    assert desk.run(0.2)[-1][1] == Sticks(0.5, 0.0, 1.0, 0.0), "and it may come back"


def test_a_silent_joystick_at_rest_is_no_warning():
    desk = Desk().fly()
    desk.joy()
    desk.run(5.0)
    assert not any("joystick" in texts(orders) for _, orders in desk.orders)


def test_stick_timeout_off():
    desk = Desk(stick_timeout=0.0).fly()
    desk.joy(UP)
    assert desk.run(60.0)[-1][1].up == 1.0


@pytest.mark.parametrize("state", list(FlightState))
def test_commands_only_in_flying_states(state):
    desk = Desk()
    desk.flight_state = state
    desk.run(0.1)
    assert bool(desk.run(0.5)) == (state in (3, 4, 7))


@pytest.mark.parametrize(
    ("control", "expected"),
    [
        (Controls(0.0, 0.3, 0.0, HOVER_N), Sticks(0.3, 0.0, 0.0, 0.0)),  # theta: forward
        (Controls(-0.4, 0.0, 0.0, HOVER_N), Sticks(0.0, -0.4, 0.0, 0.0)),  # phi: left
        (Controls(0.0, 0.0, 0.5, HOVER_N), Sticks(0.0, 0.0, 0.0, 0.5)),  # psi: counter-clockwise
        (Controls(0.0, 0.0, 0.0, HOVER_N + 0.45), Sticks(0.0, 0.0, None, 0.0)),  # thrust: up
        (Controls(2.0, -3.0, 1.5, 30.0), Sticks(-1.0, 1.0, 1.0, 1.0)),  # limited (D-29)
        (Controls(0.0, 0.0, 0.0, 0.0), Sticks(0.0, 0.0, -1.0, 0.0)),
    ],
)
def test_controls_become_commands(control, expected):
    desk = Desk().fly(autonomous=True)
    desk.run(0.2)
    desk.control = control
    _, sticks, stamp_s = desk.run(0.05)[0]
    if expected.up is None:  # 1 m/s^2 for 0.3 s from rest
        expected = expected._replace(up=0.3)
    assert sticks == pytest.approx(expected, abs=1e-9)
    assert stamp_s > 1e9


def test_thrust_is_mapped_with_the_tilt_and_the_climb_rate():
    desk = Desk().fly(autonomous=True)
    desk.state = OwnState((0.0, 0.0, 1.0), (0.0, 0.0, -0.2), 0.2, -0.1, 0.0)
    _, sticks, _ = desk.run(0.05)[0]
    lag = math.exp(-(0.004 + ARDRONE.command_delay_s + 0.5 / 29.5) / ARDRONE.climb_time_constant_s)
    expected = -0.2 * lag + 0.3 * (GRAVITY_M_S2 * math.cos(0.2) * math.cos(0.1) - GRAVITY_M_S2)
    assert sticks.up == pytest.approx(expected, abs=2e-3)


def test_autonomous_commands_answer_a_controls_message_and_keep_the_rate():
    desk = Desk().fly(autonomous=True)
    sent = desk.run(4.0)
    assert len(sent) == pytest.approx(4 * 29.5, abs=1)
    for time_s, _, stamp_s in sent:
        assert stamp_s == pytest.approx(1e9 + time_s, abs=1e-6), "sent on the cycle of the state it answers"
    gaps = np.diff([time_s for time_s, _, _ in sent[1:]])  # the first slot is still that of the watchdog
    assert gaps.min() > 0.029
    assert gaps.max() < 0.036


def test_slow_controls_are_all_sent():
    slots = SlotClock(30.0)
    assert all(slots.due(k / 20.0) for k in range(100))


def test_slots_keep_the_average_rate():
    slots = SlotClock(30.0)
    rng = np.random.default_rng(3)
    times = np.arange(0.0, 20.0, 0.005) + rng.uniform(0.0, 0.002, 4000)
    assert sum(slots.due(t) for t in times) == pytest.approx(600, abs=1)


def _believe_all_commands(monkeypatch):
    """Disable the check that a command is finite."""

    def hear(pilot, own, age_s, now_s):
        pilot.ladder.controls.note(age_s, now_s)
        return True

    monkeypatch.setattr(VehiclePilot, "hear_controls", hear)


@pytest.mark.parametrize("looks", [True, False])
@pytest.mark.parametrize("what", Controls._fields)
def test_a_command_that_is_not_a_number_is_ignored(what, looks, monkeypatch):
    """Without the check it is sent to the vehicle."""
    if not looks:
        _believe_all_commands(monkeypatch)
    desk = Desk().fly(autonomous=True)
    desk.control = desk.control._replace(**{what: math.nan})
    sent = desk.run(0.09)
    if not looks:
        assert sent and all(math.isnan(sum(sticks)) for _, sticks, _ in sent)
        return
    assert sent == []
    assert any("not finite" in texts(orders) for _, orders in desk.orders)
    assert desk.run(0.1)[0][1] == Sticks(0.0, 0.0, 0.0, 0.0), "and then it is a loss like any other"


def test_climb_ahead_solves_the_climb_loop():
    history = CommandHistory(1)
    commands = [(0.00, 0.5), (0.033, -0.3), (0.067, 0.8), (0.10, 0.1), (0.133, -1.0)]
    for time_s, command in commands:
        history.append(0, time_s, np.array([0.0, 0.0, command, 0.0]))

    def in_force(t):
        return next((c for s, c in reversed(commands) if s + 0.12 <= t), 0.0)

    start_s, now_s = 0.145, 0.16
    expected = solve_ivp(lambda t, v: (in_force(t) - v) / 0.3, (start_s, now_s + 0.12), [0.2], max_step=1e-4).y[0, -1]
    found = climb_ahead(0.2, start_s, now_s + 0.12, history.vehicles[0], 0.12, 0.3)
    assert found == pytest.approx(expected, abs=1e-4)


def test_climb_ahead_without_commands_decays():
    nothing = CommandHistory(1).vehicles[0]
    assert climb_ahead(0.6, 5.0, 5.1, nothing, 0.1, 0.3) == pytest.approx(0.6 * math.exp(-1.0 / 3.0))


# --- safety ladder ---------------------------------------------------------------------------------------------------


def test_loss_of_states_holds_then_lands_then_rests():
    desk = Desk().fly(autonomous=True)
    desk.control = Controls(0.0, 0.0, 0.3, HOVER_N)
    desk.run(0.5)
    desk.alive.remove("state")
    lost_s, since = desk.now_s, len(desk.orders)
    sent = desk.run(0.3)
    first_hold_s = next(t for t, sticks, _ in sent if sticks == Sticks(0.0, 0.0, 0.0, 0.0))
    assert 0.09 < first_hold_s - lost_s < 0.115
    assert all(sticks == Sticks(0.0, 0.0, 0.0, 0.0) for t, sticks, _ in sent if t > first_hold_s)
    assert desk.count("land", since) == 0
    desk.run(0.4)
    landings = [t for t, orders in desk.orders[since:] if orders.land]
    assert 0.49 < landings[0] - lost_s < 0.515
    desk.run(1.0)
    landings = [t for t, orders in desk.orders[since:] if orders.land]
    assert len(landings) == pytest.approx(6, abs=1), "ordered again every 0.2 s"
    desk.alive.add("state")
    desk.flight_state = FlightState.LANDING
    desk.run(1.0)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.LAND, "sticky"
    desk.flight_state = FlightState.LANDED
    desk.run(0.1)
    since = len(desk.orders)
    assert not desk.pilot.autonomous
    assert desk.run(1.0) == []
    assert desk.count("land", since) == 0
    told = [(o.safety.level, o.safety.rule, o.safety.limit_s) for _, o in desk.orders if o.safety is not None]
    ok, hold, land = FailsafeLevel
    assert told == [
        (ok, Rule.NONE, None), (hold, Rule.STATE, 0.1), (land, Rule.STATE, 0.5), (ok, Rule.NONE, None)
    ]  # fmt: skip


def test_no_command_answers_a_state_that_cannot_be_true():
    desk = Desk().fly(autonomous=True)
    desk.control = Controls(0.1, 0.0, 0.0, HOVER_N)
    assert desk.run(0.09)
    desk.suspect = "its yaw jumped"
    for level in (FailsafeLevel.OK, FailsafeLevel.HOLD):
        sent = desk.run(0.09)
        assert sent and all(command == (Sticks(0.0, 0.0, 0.0, 0.0), None) for command in (item[1:] for item in sent))
        assert desk.pilot.ladder.verdict.level == level, "it is told when that lasts"
    assert desk.pilot.ladder.verdict.rule == Rule.SUSPECT
    desk.suspect = ""
    assert desk.run(0.1)[-1][1].left == pytest.approx(0.1)


@pytest.mark.parametrize("lost", ["state", "controls"])
def test_one_that_holds_by_itself_is_braked_first(lost):
    desk = Desk(state_land_s=9.0, controls_land_s=9.0).fly(autonomous=True)
    desk.state = LEVEL._replace(velocity_m_s=(0.5, 0.0, 0.0))
    desk.run(0.2)
    desk.alive.remove(lost)
    sent = desk.run(0.2)
    assert sent[-1][1].forward < -0.5 and abs(sent[-1][1].left) < 0.01 and sent[-1][1].up == 0.0
    desk.state = LEVEL
    sent = desk.run(1.2)
    assert sent[-1][1] == Sticks(0.0, 0.0, 0.0, 0.0), "the rest is its own hover's"
    zero_s = next(t for t, sticks, _ in sent if not any(sticks))
    assert all(not any(sticks) for t, sticks, _ in sent if t > zero_s), "once it holds, it holds"
    desk.state = LEVEL._replace(velocity_m_s=(0.5, 0.0, 0.0))
    desk.alive.add(lost)
    desk.run(0.2)
    desk.alive.remove(lost)
    assert desk.run(0.2)[-1][1].forward < -0.5, "the next time, too"


@pytest.mark.parametrize("sees_the_floor", [True, False])
def test_its_own_velocity_counts_where_its_bottom_camera_sees_the_floor(sees_the_floor):
    desk = Desk(state_land_s=9.0, hold_auto_hover=sees_the_floor).fly(autonomous=True)
    desk.state = LEVEL._replace(velocity_m_s=(0.25, 0.0, 0.0))
    desk.run(0.2)
    desk.alive.remove("state")
    for k in range(30):
        report = status(SimpleNamespace(state=FlightState.FLYING, batteryPercent=90.0, vx=1.0 + 0.01 * k, vy=-1.0))
        desk.pilot.on_status(report, desk.now_s)
        desk.run(0.005)
    told = [sticks for _, sticks, _ in desk.run(0.3)]
    assert (told[-1] == Sticks(0.0, 0.0, 0.0, 0.0)) == sees_the_floor, "slow by what it says: left to its own hover"
    assert (min(sticks.forward for sticks in told) > -0.6) == sees_the_floor, "else braked in full"


def test_commands_that_are_not_numbers_count_as_silence_and_are_named(monkeypatch):
    desk = Desk().fly(autonomous=True)
    desk.control = Controls(0.0, 0.0, math.nan, HOVER_N)
    with monkeypatch.context() as off:
        _believe_all_commands(off)
        desk.run(0.7)
        assert desk.pilot.ladder.verdict.level == FailsafeLevel.OK, "they would be a sign of life"
    desk.run(0.15)
    verdict = desk.pilot.ladder.verdict
    assert (verdict.level, verdict.rule) == (FailsafeLevel.HOLD, Rule.CONTROLS) and "not finite" in verdict.reason
    desk.run(0.4)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.LAND and "not finite" in desk.pilot.ladder.verdict.reason
    desk = Desk().fly(autonomous=True)
    desk.alive.remove("controls")
    desk.run(0.15)
    assert "finite" not in desk.pilot.ladder.verdict.reason


@pytest.mark.parametrize(("phi", "levels"), [(1.0, (0, 1, 2)), (-3.0, (0, 1, 2)), (0.9, (0, 0, 0))])
def test_full_tilt_for_long_holds_and_lands(phi, levels):
    desk, off = Desk().fly(), Desk(saturated_land_s=0.0).fly()
    for each in (desk, off):
        each.control = Controls(phi, 0.0, 0.0, HOVER_N)
        each.run(3.0)
        assert each.press(TOGGLE).mode is True, "in manual mode it is not followed"
    for wait_s, level in zip((0.7, 0.2, 0.8), levels):
        desk.run(wait_s)
        off.run(wait_s)
        assert desk.pilot.ladder.verdict.level == level and off.pilot.ladder.verdict.level == FailsafeLevel.OK
    assert desk.pilot.ladder.verdict.rule == (Rule.CONTROLS if levels[2] else Rule.NONE)


def test_full_tilt_says_nothing_of_a_controller_that_is_not_obeyed():
    """One that holds because of others is far from where its controller wants it."""
    desk = Desk().fly(autonomous=True)
    desk.control = Controls(1.0, 0.0, 0.0, HOVER_N)
    desk.look = Look(holds=True, reason="near", above=True)
    desk.run(4.0)
    assert desk.pilot.ladder.verdict.text == "hold: near"


def test_hold_ends_on_the_first_fresh_controls():
    desk = Desk().fly(autonomous=True)
    desk.control = Controls(0.1, 0.0, 0.0, HOVER_N)
    desk.alive -= {"state", "controls"}
    desk.run(0.3)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.HOLD
    desk.alive |= {"state", "controls"}
    sent = desk.run(0.05)
    assert sent[-1][1].left == pytest.approx(0.1)


def test_operator_takes_over_from_a_landing():
    desk = Desk().fly(autonomous=True)
    desk.alive.remove("state")
    desk.run(0.7)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.LAND
    assert desk.press(TOGGLE).mode is False
    since = len(desk.orders)
    axes = [0.0] * 8
    axes[7] = 0.5
    desk.alive.add("joystick")
    desk.joy(axes=axes)
    assert desk.run(0.5)[-1][1].forward == 0.5
    assert desk.count("land", since) == 0


def test_operator_takes_over_from_a_landing_in_manual_mode():
    desk = Desk(joystick_timeout=1.0).fly()
    desk.run(1.5)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.LAND
    desk.press(TOGGLE)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.OK
    assert not desk.pilot.autonomous


@pytest.mark.parametrize(
    ("phi_deg", "theta_deg", "refused"), [(0.0, 90.0, True), (-50.0, 0.0, True), (25.0, 25.0, False)]
)
def test_autonomous_mode_is_refused_to_a_vehicle_that_is_seen_lying_on_its_side(phi_deg, theta_deg, refused):
    desk = Desk().fly()
    desk.state = LEVEL._replace(phi_rad=math.radians(phi_deg), theta_rad=math.radians(theta_deg))
    desk.run(0.1)
    orders = desk.press(TOGGLE)
    assert desk.pilot.autonomous != refused
    assert ("tilted" in texts(orders)) == refused


def test_level_only_hold():
    desk = Desk(hold_auto_hover=False).fly(autonomous=True)
    desk.alive.remove("state")
    desk.run(0.3)
    assert [orders.level_only for _, orders in desk.orders if orders.command is not None][-1] is True
    desk = Desk().fly(autonomous=True)
    desk.alive.remove("state")
    desk.run(0.3)
    told = [orders.level_only for _, orders in desk.orders if orders.command is not None]
    assert True in told and told[-1] is False, "level as long as the state may only be late"


@pytest.mark.parametrize("psi_deg", [0.0, 70.0, -130.0])
@pytest.mark.parametrize("climb", [1, -1, 0])
def test_one_that_is_too_near_holds_brakes_and_moves_apart(psi_deg, climb):
    desk = Desk().fly(autonomous=True)
    psi_rad = math.radians(psi_deg)
    # 0.4 m/s along the nose, which points along (cos psi, -sin psi), and 0.2 to the left
    forward, left = np.array([math.cos(psi_rad), -math.sin(psi_rad)]), np.array([math.sin(psi_rad), math.cos(psi_rad)])
    desk.state = LEVEL._replace(velocity_m_s=(*(0.4 * forward + 0.2 * left), 0.0), psi_rad=psi_rad)
    desk.control = Controls(0.3, 0.3, 0.1, HOVER_N)
    desk.look = Look(holds=True, reason="near", climb=climb)
    desk.run(0.2)
    commands = [sticks for _, sticks, _ in desk.run(0.3)]
    assert len(commands) > 5
    # it is braked by its model: each command takes those that are under way into account
    forward, left = np.mean([sticks[:2] for sticks in commands], axis=0)
    assert forward < left < -0.1 and {sticks[2:] for sticks in commands} == {(0.3 * climb, 0.0)}
    desk.run(0.6)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.LAND and not desk.count("land"), "it still moves"
    desk.state = LEVEL._replace(psi_rad=psi_rad)
    desk.run(0.4)
    assert desk.count("land")
    assert desk.run(0.3)[-1][1] == Sticks(0.0, 0.0, 0.0, 0.0), "landing is the vehicle's own affair"


def test_one_that_does_not_hold_by_itself_is_braked_where_the_others_are_near():
    desk = Desk(hold_auto_hover=False).fly(autonomous=True)
    desk.state = LEVEL._replace(velocity_m_s=(0.4, 0.0, 0.0))
    desk.look = Look(holds=True, reason="near")
    desk.run(0.2)
    assert desk.run(0.2)[-1][1].forward < -0.1


def test_one_that_is_above_another_one_goes_aside_before_it_lands():
    desk = Desk().fly(autonomous=True)
    desk.look = Look(holds=True, reason="near", above=True, aside=(0.0, 1.0))
    assert {sticks for _, sticks, _ in desk.run(1.0)[-10:]} == {Sticks(0.0, 0.0, 0.0, 0.0)}, "it stops first"
    desk.run(0.2)
    sticks = desk.run(0.2)[-1][1]
    assert sticks.left > 0.1 and sticks.forward == 0.0 and not desk.count("land")
    desk.state = LEVEL._replace(velocity_m_s=(0.0, 0.5, 0.0))
    assert desk.run(0.2)[-1][1].left < 0.0, "it goes slowly"
    desk.look = ALONE
    assert desk.run(0.2)[-1][1].left < 0.0 and not desk.count("land"), "nor does it land on its way"
    desk.state = LEVEL
    desk.run(0.4)
    assert desk.count("land")


def test_after_a_landing_of_the_ladder_it_can_start_again():
    desk = Desk().fly(autonomous=True)
    desk.battery = 5.0
    desk.run(0.6)
    assert (desk.pilot.ladder.verdict.level, desk.pilot.ladder.verdict.rule) == (FailsafeLevel.LAND, Rule.BATTERY)
    desk.flight_state = FlightState.LANDED
    desk.run(0.1)
    desk.battery = 95.0
    desk.run(0.1)
    assert desk.press(TAKEOFF_LAND).takeoff
    desk.fly(autonomous=True)
    assert desk.run(0.2)


def test_emergency_in_the_air_is_not_taken_for_landed():
    desk = Desk().fly(autonomous=True)
    desk.flight_state = FlightState.UNKNOWN
    desk.run(0.2)
    assert desk.pilot.airborne
    desk.alive.remove("state")
    desk.run(0.7)
    assert desk.count("land") > 0


def test_packets_without_a_battery_are_no_empty_battery():
    """The driver publishes a packet without the vehicle's main block as state 0, battery 0."""
    desk = Desk().fly(autonomous=True)
    desk.flight_state = FlightState.UNKNOWN
    desk.battery = status(SimpleNamespace(state=FlightState.UNKNOWN, batteryPercent=0.0, vx=0.0, vy=0.0)).battery_pct
    desk.run(5.0)
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.OK
    desk.flight_state, desk.battery = FlightState.FLYING, 90.0
    assert desk.run(0.2), "flies on"


# --- a landing that is requested --------------------------------------------------------------------------------------


def request(desk):
    """Ask for a landing. Return the answer (done, text)."""
    orders = desk.pilot.on_land_request(desk.now_s)
    desk.take(orders)
    return orders.answer


@pytest.mark.parametrize("autonomous", [True, False])
def test_a_request_lands_in_both_modes_until_it_stands(autonomous):
    desk = Desk(joystick_timeout=1.0).fly()
    if autonomous:
        assert desk.press(TOGGLE).mode is True
    desk.alive.add("joystick")
    desk.joy(axes=(0.0,) * 7 + (0.5,))  # a stick that is held does not fly on
    since = len(desk.orders)
    assert request(desk)[0] is True
    asked = desk.orders[-1][1]
    assert asked.land and (asked.safety.level, asked.safety.rule) == (FailsafeLevel.LAND, Rule.REQUEST), "at once"
    assert asked.command[:2] == (Sticks(0.0, 0.0, 0.0, 0.0), None)
    sent = desk.run(1.0)
    assert desk.count("land", since) == pytest.approx(6, abs=1), "ordered again every 0.2 s"
    assert all(sticks == Sticks(0.0, 0.0, 0.0, 0.0) for _, sticks, _ in sent)
    desk.flight_state = FlightState.LANDED
    desk.run(0.1)
    since = len(desk.orders)
    assert not desk.pilot.autonomous
    desk.run(1.0)
    assert desk.count("land", since) == 0
    assert request(desk)[0] is True, "it stands"
    assert desk.count("land", since) == 0
    assert desk.press(TAKEOFF_LAND).takeoff, "and it may fly again"


def test_the_operator_takes_over_from_a_requested_landing():
    desk = Desk().fly(autonomous=True)
    request(desk)
    desk.run(0.5)
    desk.press(TOGGLE)
    since = len(desk.orders)
    desk.alive.add("joystick")
    desk.joy(axes=(0.0,) * 7 + (0.5,))
    assert desk.run(0.5)[-1][1].forward == 0.5, "the sticks fly again"
    assert desk.count("land", since) == 0


def test_a_request_during_the_take_off_lands():
    desk = Desk()
    desk.press(TAKEOFF_LAND)
    since = len(desk.orders)
    assert request(desk)[0], "it may be in the air already, whatever it reported last"
    desk.run(0.5)
    assert desk.count("land", since) >= 2


def test_a_request_to_a_silent_vehicle_is_ordered_and_called_unsure():
    desk = Desk()
    desk.pilot = VehiclePilot(VehicleNodeParams(), ARDRONE, desk.now_s)
    done, text = request(desk)
    assert (done, desk.orders[-1][1].land) == (False, True)
    assert "silent" in text
    desk = Desk().fly()
    desk.alive.remove("navdata")
    desk.run(2.0)
    done, text = request(desk)
    assert (done, desk.pilot.ladder.verdict.level) == (False, FailsafeLevel.LAND)
    assert "silent" in text


@pytest.mark.parametrize("state", [FlightState.UNKNOWN, FlightState.TEST])
def test_a_request_to_a_vehicle_whose_state_proves_nothing_is_ordered_and_called_unsure(state):
    """A node that was restarted during a flight may hear nothing else."""
    desk = Desk()
    desk.pilot = VehiclePilot(VehicleNodeParams(), ARDRONE, desk.now_s)
    desk.flight_state = state
    desk.run(0.5)
    assert not desk.pilot.airborne
    since = len(desk.orders)
    done, text = request(desk)
    assert (done, desk.count("land", since)) == (False, 1)
    assert "(state %d, %s)" % (state, state.name.lower()) in text


def test_a_request_to_a_node_that_ends_orders_nothing():
    desk = Desk().fly()
    desk.take(desk.pilot.on_shutdown(desk.now_s))
    done, text = request(desk)
    assert not done and "ending" in text
    assert desk.orders[-1][1].land is False


# --- simulators without navdata --------------------------------------------------------------------------------------


def test_simulation_sends_without_navdata_and_resets_the_simulator():
    desk = Desk(Simulation=True)
    desk.alive.remove("navdata")
    assert desk.run(0.5)
    assert desk.joy(TAKEOFF_LAND).simulator_reset is True
    orders = desk.joy()
    assert (orders.takeoff, orders.land) == (False, False)
    assert desk.press(TOGGLE).mode is True


def test_simulation_reset_parameter_falls_back_when_the_button_is_released():
    desk = Desk(Simulation=True)
    assert desk.joy(TAKEOFF_LAND).simulator_reset is True
    assert desk.joy(TAKEOFF_LAND).simulator_reset is None, "written on change only"
    assert desk.joy().simulator_reset is False
    assert desk.joy().simulator_reset is None


# --- parameters and identity -----------------------------------------------------------------------------------------


def test_the_fence_is_the_net_unless_it_is_set():
    limits = VehicleNodeParams(**fence_of(Arena(6.0, 5.0, 4.0)))
    assert (limits.fence_min_m, limits.fence_max_m) == ((-6.0, -5.0, -1.0), (6.0, 5.0, 4.0))


@pytest.mark.parametrize(
    ("value", "meaning"), [("False", False), ("true", True), ("0", False), (1, True), (False, False)]
)
def test_simulation_may_be_a_text_as_launch_files_of_old_have_it(value, meaning):
    params = settings_from(VehicleNodeParams, {"Simulation": value}, lenient=True)
    assert params.Simulation is meaning  # D-32: bool("False") is true


def test_bad_parameters():
    for name, value in (
        ("Simulation", "perhaps"),
        ("fence_min_m", [1, 2]),
        ("state_hold_s", "short"),
        ("fence_max_m", [1, 2, "high"]),
        ("AxisRoll", "six"),
        ("command_rate_hz", True),
        ("stick_timeout", -1),
        ("takeoff_grace_s", "inf"),
    ):
        with pytest.raises(ValueError, match=name):
            settings_from(VehicleNodeParams, {name: value}, lenient=True)


def test_a_controller_with_other_full_scales_is_not_obeyed():
    desk = Desk().fly()
    desk.pilot.disagreement = "climb_max_m_s is 1 here, but 0.2 there"
    orders = desk.press(TOGGLE)
    assert orders.mode is None and "climb_max_m_s is 1 here" in texts(orders)
    desk.pilot.disagreement = ""
    assert desk.press(TOGGLE).mode is True
    desk.pilot.disagreement, since = "as before", len(desk.orders)
    desk.run(0.7)
    assert desk.count("land", since) > 0, "as if it were silent"


@pytest.mark.parametrize(("speed_m_s", "stops_s"), [(0.0, 0.0), (2.5, 0.3), (2.5, 5.0)])
def test_one_that_moves_stops_before_it_lands(speed_m_s, stops_s):
    """Low on battery: told to land when it is slow, and after a second at the latest. Until then it brakes."""
    desk = Desk().fly(autonomous=True)
    desk.state, desk.battery = LEVEL._replace(velocity_m_s=(speed_m_s, 0.0, 0.0)), 5.0
    while desk.pilot.ladder.verdict.level < FailsafeLevel.LAND:
        sent = desk.run(0.005)
    assert desk.count("land") == (speed_m_s == 0.0)
    if speed_m_s:
        sent += desk.run(min(stops_s, 0.9))
        assert min(sticks.forward for _, sticks, _ in sent) < -0.5 and not desk.count("land")
        desk.state = LEVEL if stops_s < 1.0 else desk.state
        desk.run(0.2)
        assert desk.count("land")


def test_always_a_little_too_late_is_too_late():
    """States that are all 0.11 s old: held, and landed after the same time as in a loss."""
    desk = Desk().fly(autonomous=True)
    desk.alive.discard("state")
    levels = []
    for _ in range(120):
        desk.pilot.on_state(LEVEL, 0.105, desk.now_s)
        desk.run(0.005)
        levels.append(desk.pilot.ladder.verdict.level)
    held, landed = levels.index(FailsafeLevel.HOLD), levels.index(FailsafeLevel.LAND)
    assert 0.005 * (landed - held) == pytest.approx(0.4, abs=0.02)
