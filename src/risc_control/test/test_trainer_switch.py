"""Whether an IRIS+ follows what we send or its pilot's sticks, and what its vehicle node makes of it."""

import math
import random

import pytest
from hover_desk import IRIS, Desk, Iris, flown, level_at, said
from joystick_desk import TAKEOFF_LAND, TOGGLE

from risc_control.joystick import CENTRED, Sticks
from risc_control.safety import FailsafeLevel
from risc_control.vehicles import FlightState, iris
from risc_control.vehicles.iris import OTHER_US, TrainerSwitch, hover_throttle


def channels_of(sticks):
    """Channels [us] that the board sends for these sticks."""
    fractions = -sticks.left, -sticks.forward, sticks.up, -sticks.turn_left
    return [1500 + round(500.0 * fraction) for fraction in fractions]


class Told:
    """What a TrainerSwitch is told, ten times a second; sent and received: functions of the time."""

    def __init__(self):
        self.switch, self.now_s, self.changes = TrainerSwitch(), 100.0, []

    def run(self, duration_s, sent, received):
        for _ in range(round(duration_s / 0.1)):
            self.now_s += 0.1
            if sent is not None:
                self.switch.send(sent(self.now_s), self.now_s)
            if received is not None and self.switch.receive(received(self.now_s), self.now_s):
                self.changes.append(self.now_s)
        return self.switch.is_off


def constant(*channels_us):
    return lambda now_s: list(channels_us) + [1500] * 4


OURS, THEIRS = constant(1500, 1500, 1400, 1500), constant(1500, 1500, 1400 + OTHER_US + 1, 1500)


def figure(late_s, size_us=140.0):
    """Channels of a circle flown fast, delayed by late_s."""
    return lambda now_s: [
        *(1500 + round(size_us * math.sin(2.5 * (now_s - late_s) + phase)) for phase in (0.0, 1.6)),
        *(1400 + round(40.0 * math.sin(1.1 * (now_s - late_s))), 1500),
    ]


def test_sticks_that_differ_are_noticed_and_that_they_do_no_more():
    told = Told()
    assert not told.run(2.0, OURS, OURS)
    begin_s = told.now_s
    assert told.run(2.0, OURS, THEIRS) and told.changes[0] - begin_s < 1.0
    begin_s = told.now_s
    assert not told.run(2.0, OURS, OURS) and told.changes[1] - begin_s < 1.0


@pytest.mark.parametrize("late_s", [0.0, 0.2, 0.5, 0.9])
def test_late_is_not_different(late_s):
    told = Told()
    assert not told.run(60.0, figure(0.0), figure(late_s)) and told.changes == []


def test_what_is_as_ours_within_what_transmitters_do_is_ours():
    random.seed(1)
    told = Told()
    told.run(2.0, OURS, OURS)

    def noisy(now_s):
        return [us + random.randint(-OTHER_US, OTHER_US) for us in OURS(now_s)]

    assert not told.run(30.0, OURS, noisy) and told.changes == []


@pytest.mark.parametrize(
    ("sent", "received"),
    [
        (OURS, THEIRS),  # a transmitter that changes our pulses, or a switch that was never held
        (OURS, None),  # no telemetry of the channels
        (None, OURS),  # no board
        (OURS, constant(0, 0, 0, 0)),  # the receiver has none
        (OURS, constant(65535, 65535, 65535, 65535)),
    ],
)
def test_nothing_is_said_before_both_have_agreed(sent, received):
    told = Told()
    assert not told.run(20.0, sent, received) and told.changes == []
    assert len(told.switch._sent) < 20, "what is not answered is not kept for ever"


def test_a_short_difference_is_none():
    told = Told()
    told.run(2.0, OURS, OURS)
    for _ in range(10):
        told.run(0.3, OURS, THEIRS)
        told.run(0.6, OURS, OURS)
    assert told.changes == []


def test_what_was_held_up_is_not_different():
    """A driver stalled for two seconds, and all of its delayed reports come at once."""
    told = Told()
    now, soon = figure(0.0, 350.0), figure(0.1, 350.0)
    told.run(3.0, now, soon)
    for _ in range(5):
        told.run(2.0, now, None)
        for k in range(20):
            late = figure(2.0 - 0.1 * k, 350.0)(told.now_s)
            if told.switch.receive(late, told.now_s + 1e-3 * k):
                told.changes.append(told.now_s)
        told.run(1.5, now, soon)
    assert told.changes == [] and told.switch._has_agreed


# --- in flight --------------------------------------------------------------------------------------------------------


class Piloted(Iris):
    """An IRIS+ that reports what it receives. pilot: gives the pilot's sticks while the trainer switch is released."""

    def __init__(self, **values):
        super().__init__(**values)
        self.switch, self.pilot, self.board, self._told_s = TrainerSwitch(), None, Sticks(0.0, 0.0, -1.0, 0.0), 0.0

    @property
    def state(self):
        state = super().state
        return FlightState.PILOT if state == FlightState.FLYING and self.switch.is_off else state

    def send(self, sticks, now_s):
        self.board = sticks
        super().send(sticks, now_s)

    def step(self, now_s):
        if self.pilot is not None:
            self._under_way, self.heard_s, self.sticks = [], now_s, self.pilot(self)
        super().step(now_s)
        if now_s - self._told_s > 0.099:
            self._told_s = now_s
            self.switch.send(channels_of(self.board), now_s)
            self.switch.receive(channels_of(self.sticks), now_s)


def hovering(vehicle, climb_m_s=0.0):
    """Sticks of a pilot: nearly level, at this climb rate."""
    lift, hand = 0.3 * (climb_m_s - vehicle.velocity_m_s[2]), 0.1 * math.sin(3.0 * vehicle.heard_s)
    return CENTRED._replace(
        forward=hand, up=hover_throttle(IRIS, vehicle.battery_pct) + (1.0 / vehicle.more - 1.0) + lift
    )


def taken(**values):
    """Desk in autonomous mode, then taken over by the vehicle's pilot, who lets it drift off."""
    desk = Desk(Piloted(**values)).up()
    desk.run(4.0)
    desk.fly = level_at(desk.iris.position_m[2])
    desk.run(0.1)
    assert desk.press(TOGGLE).mode is True, desk.said
    desk.run(2.0)
    assert desk.pilot.autonomous and not desk.iris.switch.is_off
    desk.iris.pilot = lambda vehicle: hovering(vehicle, 0.6)
    desk.taken_s = desk.now_s
    return desk


def test_its_pilot_takes_over_and_nobody_fights(monkeypatch):
    desk = taken()
    assert desk.run(3.0, lambda: not desk.pilot.autonomous) and desk.now_s - desk.taken_s < 2.5
    assert desk.pilot.flight_state == FlightState.PILOT and "transmitter" in said(desk)
    orders = dict(desk.counts)
    desk.iris.pilot = hovering
    desk.fly = None  # nor does this silence land it
    desk.alive.discard("state")
    desk.run(5.0)
    desk.alive.add("state")
    desk.run(5.0)
    assert desk.press(TOGGLE).mode is None and desk.pilot.flight_state == FlightState.PILOT
    desk.press(TAKEOFF_LAND)
    desk.run(5.0)
    assert desk.counts == orders and desk.iris.mode == "STABILIZE"
    assert desk.pilot.ladder.verdict.level == FailsafeLevel.OK

    monkeypatch.setattr(iris, "OTHER_US", 2000)
    desk = taken()
    desk.run(1.5)
    desk.iris.pilot, desk.fly = hovering, None
    desk.run(5.0)
    assert desk.counts != orders and desk.iris.mode == "LAND"  # as without detection of the switch


def given_back():
    desk = taken()
    desk.run(2.5)
    desk.iris.pilot = hovering
    desk.run(3.0)
    desk.iris.pilot = None
    desk.run(1.5)
    return desk


def test_given_back_it_stays_where_it_is_and_the_button_takes_it(monkeypatch):
    desk = given_back()
    place_m = list(desk.iris.position_m)
    assert place_m[2] > 1.3 and not desk.iris.switch.is_off
    desk.run(3.0)
    assert desk.pilot.flight_state == FlightState.PILOT  # the pilot's sticks may happen to equal ours
    assert math.dist(desk.iris.position_m, place_m) < 0.15
    assert desk.press(TOGGLE).mode is None and desk.pilot.flight_state == FlightState.HOVERING
    desk.run(3.0)
    assert math.dist(desk.iris.position_m, place_m) < 0.15 and max(map(abs, desk.iris.velocity_m_s)) < 0.05
    desk.fly = level_at(desk.iris.position_m[2])
    desk.run(0.2)
    assert desk.press(TOGGLE).mode is True


def test_given_back_it_lands_by_the_button_or_when_it_is_not_seen():
    desk = given_back()
    desk.press(TAKEOFF_LAND)
    desk.wait_for(FlightState.LANDED, 12.0)
    assert desk.counts["land"] == 0 and desk.iris.impact_m_s < 0.4
    desk = given_back()
    desk.alive.discard("state")
    desk.wait_for(FlightState.LANDED, 12.0)
    assert desk.counts["land"] > 0


def test_what_its_pilot_did_is_not_learnt():
    desk = taken(more=0.95)
    trim_m_s2 = desk.pilot._hover.observer.trim_m_s2
    assert desk.run(3.0, lambda: desk.pilot.flight_state == FlightState.PILOT)
    assert desk.pilot._hover.observer.trim_m_s2 == pytest.approx(trim_m_s2, abs=0.05)


def test_a_node_that_ends_lets_its_pilot_fly():
    desk = taken()
    desk.run(2.5)
    assert not desk.pilot.on_shutdown(desk.now_s).land and not desk.pilot.needs_landing(desk.now_s)
    desk = flown()
    assert desk.pilot.on_shutdown(desk.now_s).land and desk.pilot.needs_landing(desk.now_s)


def test_who_asks_for_a_landing_hears_who_has_it():
    desk = taken()
    desk.run(2.5)
    done, text = desk.take(desk.pilot.on_land_request(desk.now_s)).answer
    assert not done and "pilot" in text


def test_it_does_not_take_off_by_somebody_elses_sticks():
    desk = Desk(Piloted())
    desk.run(2.0)
    desk.iris.pilot = lambda _: Sticks(0.0, 0.0, -0.7, 0.0)
    desk.run(1.5)
    desk.iris.armed = True
    desk.press(TAKEOFF_LAND)
    desk.run(1.0)
    assert "take-off refused" in said(desk) and "transmitter" in said(desk) and desk.counts["disarm"] == 1


# --- by its topics ----------------------------------------------------------------------------------------------------


def test_its_reports_say_so(monkeypatch):
    pytest.importorskip("roscopter.msg")
    from risc_maap_msgs.msg import PpmStatus
    from roscopter.msg import RC, State

    callbacks, told, now_s = {}, [], [50.0]
    monkeypatch.setattr(iris.time, "monotonic", lambda: now_s[0])
    monkeypatch.setattr(iris, "sender", lambda message: "/iris1/apm/roscopter")
    iris.Adapter.listen(
        "/iris1/", lambda status, who: told.append(status.state), lambda topic, _, call: callbacks.update({topic: call})
    )

    def hear(topic, message):
        callbacks["/iris1/" + topic](message)

    def run(duration_s, received):
        for step in range(round(duration_s / 0.1)):
            now_s[0] += 0.1
            hear("ppm_status", PpmStatus(channels_us=[1500, 1500, 1400, 1500]))
            hear("apm/rc", RC(channel=[*received, 1100, 0, 0, 0]))
            if step % 10 == 0:
                hear("apm/state", State(armed=True, mode="STABILIZE"))

    run(3.0, [1502, 1498, 1405, 1500])
    assert set(told) == {FlightState.FLYING}
    run(1.0, [1500, 1700, 1400, 1500])
    assert told[-1] == FlightState.PILOT
    hear("apm/state", State(armed=False, mode="STABILIZE"))
    assert told[-1] == FlightState.LANDED
