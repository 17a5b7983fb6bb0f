"""risc_experiments.operator: the whole sequence with model vehicles and a simulated clock."""

import pytest

from risc_control.safety import FailsafeLevel
from risc_control.vehicle_pilot import FlightState
from risc_experiments.operator import JOY_RATE_HZ, Joypad, Operator, OperatorParams, time_limit_s
from risc_lab.phases import OperatorPhase as Phase
from risc_lab.phases import OperatorResult, OutCause
from risc_lab.phases import TrajectoryPhase as Trajectory

TOGGLE, TAKEOFF_LAND, BUMPER = 0, 6, 5
STEP_S = 1.0 / JOY_RATE_HZ
OK = (FailsafeLevel.OK, "")  # of the safety ladder


class ModelVehicle:
    """Vehicle and joystick node in a few lines: reacts to edges of the two buttons as the real ones do.

    connected: its reports arrive; with `held_up`, no message passes either way, and all arrive when that is over.
    """

    def __init__(self):
        self.state = FlightState.LANDED
        self.autonomous = False
        self.safety = OK
        self.course = Trajectory.HOLD
        self.seen = self.connected = self.node_alive = True
        self.obeys = {"takeoff", "land", "toggle"}
        self.presses = []
        self.calls = []  # when its service to land was called
        self.held_up = False
        self._on_the_way = []
        self._down = None
        self._timer_s = 0.0

    def receive(self, buttons, called, now_s):
        self._on_the_way.append((buttons, called))
        if called:
            self.calls.append(now_s)
        while self._on_the_way and not self.held_up:
            buttons, called = self._on_the_way.pop(0)
            self.joy(buttons, now_s)
            if called and self.node_alive and self.state != FlightState.LANDED and "land" in self.obeys:
                self.land(now_s)

    def joy(self, buttons, now_s):
        down = buttons.index(1) if 1 in buttons else None
        assert sum(buttons) <= 1
        if down is not None and down != self._down:
            self.presses.append((now_s, down))
            if not self.node_alive:
                pass
            elif down == TAKEOFF_LAND and self.state == FlightState.LANDED and self.connected:
                if "takeoff" in self.obeys:
                    self.state, self._timer_s = FlightState.TAKING_OFF, now_s + 4.0
            elif down == TAKEOFF_LAND and "land" in self.obeys:
                self.land(now_s)
            elif down == TOGGLE and "toggle" in self.obeys and self.state == FlightState.HOVERING:
                self.autonomous = not self.autonomous
                self.course, self._course_s = Trajectory.APPROACH, now_s + 3.0
        self._down = down

    def land(self, now_s):
        self.autonomous = False
        if self.state != FlightState.LANDING:
            self.state, self._timer_s = FlightState.LANDING, now_s + 2.5

    def go(self, now_s):
        if self.state == FlightState.TAKING_OFF and now_s >= self._timer_s:
            self.state = FlightState.HOVERING
        if self.state == FlightState.LANDING and now_s >= self._timer_s:
            self.state, self.safety = FlightState.LANDED, OK
        if self.autonomous and self.course == Trajectory.APPROACH and now_s >= self._course_s:
            self.course = Trajectory.COURSE
        if self.course == Trajectory.HOME and now_s >= self._course_s:
            self.course = Trajectory.HOMED

    def home(self, now_s):
        self.course, self._course_s = Trajectory.HOME, now_s + 3.0

    def count(self, button):
        return sum(pressed == button for _, pressed in self.presses)


class Flight:
    """An operator with model vehicles."""

    def __init__(self, count=3, **params):
        params = dict({"duration": 10.0}, **params)
        self.now_s = 100.0
        self.vehicles = {"risc%d" % (k + 1): ModelVehicle() for k in range(count)}
        self.landings = []
        self.operator = Operator(
            list(self.vehicles), OperatorParams(**params), self.now_s, self.go_home, self.landings.append
        )
        self.home_problem = ""
        self.home_calls = 0
        self.phases = []

    def step(self):
        self.now_s += STEP_S
        for name, vehicle in self.vehicles.items():
            vehicle.go(self.now_s)
            watched = self.operator.vehicles[name]
            if vehicle.seen:
                watched.seen_s = self.now_s
            if vehicle.connected and not vehicle.held_up:
                watched.note_report(vehicle.state, self.now_s)
            if vehicle.node_alive and not vehicle.held_up:
                watched.autonomous, watched.status_s = vehicle.autonomous, self.now_s
            watched.safety, watched.safety_reason = vehicle.safety
            watched.trajectory_phase = vehicle.course
        self.operator.step(self.now_s)
        for name, vehicle in self.vehicles.items():
            buttons = self.operator.vehicles[name].pad.next_buttons(11)
            vehicle.receive(buttons, name in self.landings, self.now_s)
        self.landings.clear()
        if not self.phases or self.phases[-1] != self.operator.phase:
            self.phases.append(self.operator.phase)

    def go_home(self):
        self.home_calls += 1
        self.operator.home_called(self.home_problem, self.now_s)
        if not self.home_problem:
            for vehicle in self.vehicles.values():
                vehicle.home(self.now_s)

    def run(self, until, limit_s=300.0):
        """Go on until a Phase is reached or a condition holds."""
        end_s = self.now_s + limit_s
        while not (self.operator.phase == until if isinstance(until, Phase) else until()):
            assert self.now_s < end_s, "stuck in " + self.operator.phase_text
            self.step()
        return self

    def finish(self):
        return self.run(lambda: self.operator.finished)

    def on_course(self):
        return self.run(lambda: self.operator.text.startswith("on course"))


def test_a_whole_flight():
    flight = Flight().finish()
    assert flight.operator.result is OperatorResult.OK
    assert flight.operator.phase_text == "done"
    assert flight.phases == [Phase.WAITING, Phase.TAKEOFF, Phase.SETTLE, Phase.FLY, Phase.HOME, Phase.LAND, Phase.DONE]
    assert flight.home_calls == 1
    for vehicle in flight.vehicles.values():
        assert [button for _, button in vehicle.presses] == [TAKEOFF_LAND, TOGGLE, TAKEOFF_LAND]
        assert vehicle.state == FlightState.LANDED


def test_fifty_vehicles():
    flight = Flight(50).finish()
    assert flight.operator.result is OperatorResult.OK and len(flight.vehicles) == 50


def test_duration_counts_from_when_all_are_on_course():
    flight = Flight(duration=10.0).run(Phase.FLY)
    assert not flight.operator.on_course
    flight.on_course()
    assert flight.operator.on_course
    assert all(vehicle.course == Trajectory.COURSE for vehicle in flight.vehicles.values())
    begin_s = flight.now_s
    flight.run(Phase.HOME)
    assert flight.now_s - begin_s == pytest.approx(10.0, abs=2 * STEP_S)


@pytest.mark.parametrize(
    ("spoil", "text"),
    [
        (lambda v: setattr(v, "seen", False), "risc2 not seen"),
        (lambda v: setattr(v, "connected", False), "risc2 no report"),
        (lambda v: setattr(v, "state", FlightState.UNKNOWN), "(state 0)"),
    ],
)
def test_waits_says_for_what_and_gives_up(spoil, text):
    flight = Flight(waiting_timeout=5.0)
    spoil(flight.vehicles["risc2"])
    flight.step()
    assert flight.operator.phase_text.startswith("waiting: ")
    assert text in flight.operator.phase_text
    flight.finish()
    assert flight.operator.phase == Phase.ABORTED
    assert text in flight.operator.reason
    for vehicle in flight.vehicles.values():
        assert TAKEOFF_LAND not in [button for _, button in vehicle.presses] or vehicle is flight.vehicles["risc2"]


def test_an_operator_that_is_started_again_in_flight_lands_all():
    """It must not wait until they have landed, and then take off again."""
    flight = Flight(3).on_course()
    flight.vehicles["risc2"].safety = (FailsafeLevel.LAND, "joystick silent")
    flight.vehicles["risc3"].state = FlightState.LANDED
    flight.vehicles["risc2"].land(flight.now_s - 2.0)  # it has landed before the operator has listened for long enough
    params = OperatorParams(duration=10.0)
    flight.operator = Operator(list(flight.vehicles), params, flight.now_s, flight.go_home, flight.landings.append)
    flight.phases.clear()
    flight.finish()
    assert flight.phases == [Phase.WAITING, Phase.LAND, Phase.ABORTED] and not flight.operator.flight_failed
    assert {name: cause for name, cause, _ in flight.operator.out} == {"risc1": OutCause.MANUAL}
    assert all(vehicle.state == FlightState.LANDED for vehicle in flight.vehicles.values())
    assert flight.vehicles["risc3"].count(TAKEOFF_LAND) == 1, "the take-off of before"


def test_an_operator_that_is_started_again_takes_nobody_off_again():
    """Also when the ladder has landed all before the operator's first reports."""
    flight = Flight()
    params = OperatorParams(duration=10.0)
    arguments = list(flight.vehicles), params, flight.now_s, flight.go_home, flight.landings.append
    flight.operator = Operator(*arguments, started_again=True)
    flight.finish()
    assert flight.phases == [Phase.WAITING, Phase.LAND, Phase.ABORTED]
    assert flight.operator.reason and not flight.operator.out
    assert not any(vehicle.presses for vehicle in flight.vehicles.values())


def test_starts_when_the_last_one_is_ready():
    flight = Flight()
    flight.vehicles["risc3"].seen = False
    for _ in range(100):
        flight.step()
    assert flight.operator.phase == Phase.WAITING
    flight.vehicles["risc3"].seen = True
    assert flight.finish().operator.result is OperatorResult.OK


def test_presses_again_when_a_takeoff_was_not_heard():
    flight = Flight()
    vehicle = flight.vehicles["risc1"]
    vehicle.obeys.remove("takeoff")
    flight.run(lambda: vehicle.count(TAKEOFF_LAND) == 2)
    vehicle.obeys.add("takeoff")
    assert flight.finish().operator.result is OperatorResult.OK


def test_why_a_take_off_was_refused_is_said():
    flight = Flight()
    flight.vehicles["risc2"].obeys.remove("takeoff")
    flight.run(lambda: flight.vehicles["risc2"].count(TAKEOFF_LAND) == 1)
    flight.operator.vehicles["risc2"].refusals = ["carry it inside", "battery low"]
    flight.step()
    assert "carry it inside; battery low" in flight.operator.phase_text
    flight.finish()
    assert "carry it inside" in flight.operator.reason


@pytest.mark.parametrize(
    ("order", "text"),
    [("takeoff", " 20 s: risc2"), ("toggle", " 10 s: risc2")],
)
def test_timeouts_land_all(order, text):
    flight = Flight()
    flight.vehicles["risc2"].obeys.remove(order)
    flight.finish()
    assert flight.operator.reason.endswith(text)
    assert flight.operator.phase_text == "aborted: " + flight.operator.reason
    assert all(vehicle.state == FlightState.LANDED for vehicle in flight.vehicles.values())


def test_never_on_course_and_never_home():
    flight = Flight()
    for vehicle in flight.vehicles.values():
        vehicle.go = lambda now_s, v=vehicle: ModelVehicle.go(v, now_s) if v.course != Trajectory.APPROACH else None
    flight.finish()
    assert " course within 40 s: risc1, risc2, risc3" in flight.operator.reason
    flight = Flight()
    flight.vehicles["risc3"].home = lambda now_s: None
    flight.finish()
    assert " home within 40 s: risc3" in flight.operator.reason
    assert flight.operator.flight_failed
    assert all(vehicle.state == FlightState.LANDED for vehicle in flight.vehicles.values())


def test_without_a_way_home_it_lands_where_it_is():
    flight = Flight()
    flight.home_problem = "no such service"
    flight.finish()
    assert "no such service" in flight.operator.reason
    assert flight.home_calls == 1


def test_a_vehicle_that_does_not_land_is_told_again():
    flight = Flight()
    flight.run(Phase.LAND)
    flight.vehicles["risc1"].obeys.remove("land")
    flight.finish()
    assert [out[:2] for out in flight.operator.out] == [("risc1", OutCause.OVERDUE)]
    assert flight.vehicles["risc1"].count(TAKEOFF_LAND) == 2, "the button was pressed once, then its service called"
    before = len(flight.vehicles["risc1"].calls)
    assert before > 9
    flight.run(lambda: len(flight.vehicles["risc1"].calls) > before)


@pytest.mark.parametrize("phase", [Phase.TAKEOFF, Phase.SETTLE, Phase.FLY, Phase.HOME])
def test_request_lands_everything(phase):
    flight = Flight().run(phase)
    for _ in range(10):
        flight.step()
    flight.operator.request_landing("landing was requested", flight.now_s)
    assert flight.operator.phase_text == "land: landing was requested"
    flight.finish()
    assert flight.operator.reason == "landing was requested"
    assert all(vehicle.state == FlightState.LANDED for vehicle in flight.vehicles.values())


def test_request_right_after_the_takeoff_was_pressed():
    """The vehicles still report landed then: pressing the button would do nothing, or the wrong thing."""
    flight = Flight().run(Phase.TAKEOFF)
    for vehicle in flight.vehicles.values():
        vehicle.obeys.remove("takeoff")  # reacts late
    flight.run(lambda: all(vehicle.presses for vehicle in flight.vehicles.values()))
    flight.operator.request_landing("landing was requested", flight.now_s)
    for _ in range(20):
        flight.step()
    for vehicle in flight.vehicles.values():
        vehicle.state, vehicle._timer_s = FlightState.TAKING_OFF, flight.now_s + 4.0
    flight.finish()
    assert all(vehicle.state == FlightState.LANDED for vehicle in flight.vehicles.values())
    assert all(vehicle.count(TAKEOFF_LAND) == 2 for vehicle in flight.vehicles.values())


def test_request_before_takeoff_ends_at_once():
    flight = Flight()
    flight.step()
    flight.operator.request_landing("landing was requested", flight.now_s)
    flight.finish()
    assert not any(vehicle.presses for vehicle in flight.vehicles.values())


def test_a_vehicle_landed_by_its_ladder_is_noted_and_the_others_fly_on():
    flight = Flight().on_course()
    vehicle = flight.vehicles["risc2"]
    vehicle.safety = (FailsafeLevel.LAND, "state 500 ms old")
    flight.step()
    vehicle.land(flight.now_s)
    flight.step()
    assert "(state 500 ms old)" in flight.operator.phase_text
    flight.run(Phase.HOME)
    assert flight.vehicles["risc1"].autonomous
    flight.finish()
    assert "(state 500 ms old)" in flight.operator.reason
    assert [out[:2] for out in flight.operator.out] == [("risc2", OutCause.LADDER)]
    assert not flight.operator.flight_failed
    for name in ("risc1", "risc3"):
        assert [button for _, button in flight.vehicles[name].presses] == [TAKEOFF_LAND, TOGGLE, TAKEOFF_LAND]
    assert vehicle.count(TAKEOFF_LAND) <= 2, "never pressed when it stands: that would be a take-off"
    assert vehicle.state == FlightState.LANDED


def test_a_short_hold_does_not_matter():
    flight = Flight().on_course()
    flight.vehicles["risc2"].safety = (FailsafeLevel.HOLD, "state 110 ms old")
    for _ in range(5):
        flight.step()
    flight.vehicles["risc2"].safety = OK
    assert flight.finish().operator.result is OperatorResult.OK


def test_when_nobody_flies_any_more_it_ends():
    flight = Flight(count=1, duration=1000.0).on_course()
    flight.vehicles["risc1"].safety = (FailsafeLevel.LAND, "battery at 9 %")
    flight.vehicles["risc1"].land(flight.now_s)
    flight.run(lambda: flight.operator.finished, 10.0)
    assert "(battery at 9 %)" in flight.operator.reason
    assert not flight.operator.flight_failed, "only its vehicles did"


@pytest.mark.parametrize("phase", [Phase.TAKEOFF, Phase.SETTLE, Phase.FLY, Phase.HOME])
def test_when_all_ladders_are_asked_to_land_the_flight_ends_with_all_on_the_ground(phase):
    """As with the button "land all" of the browser view."""
    flight = Flight().run(phase)
    flight.run(lambda: all(vehicle.state != FlightState.LANDED for vehicle in flight.vehicles.values()))
    for vehicle in flight.vehicles.values():
        vehicle.safety = (FailsafeLevel.LAND, "landing was requested")
        vehicle.land(flight.now_s)
    flight.run(lambda: flight.operator.finished, 10.0)
    assert [out[:2] for out in flight.operator.out] == [(name, OutCause.LADDER) for name in flight.vehicles]
    for _ in range(100):
        flight.step()
    assert all(vehicle.state == FlightState.LANDED for vehicle in flight.vehicles.values())
    assert all(vehicle.count(TAKEOFF_LAND) <= 2 for vehicle in flight.vehicles.values()), "no take-off by mistake"


def test_a_vehicle_that_falls_back_to_manual_mode_is_landed():
    flight = Flight().on_course()
    flight.vehicles["risc1"].autonomous = False
    flight.finish()
    assert [out[:2] for out in flight.operator.out] == [("risc1", OutCause.MANUAL)]
    assert all(vehicle.state == FlightState.LANDED for vehicle in flight.vehicles.values())


def test_a_silent_vehicle_is_noted():
    flight = Flight().on_course()
    flight.vehicles["risc1"].connected = False
    flight.run(lambda: "risc1: silent" in flight.operator.phase_text, 3.0)


def test_a_failed_vehicle_is_told_to_land_until_it_stands():
    """The first orders are lost: the link failed for a moment, or the joystick node comes back only later."""
    flight = Flight(duration=60.0).on_course()
    vehicle = flight.vehicles["risc2"]
    vehicle.obeys.remove("land")
    vehicle.autonomous = False
    flight.run(lambda: len(vehicle.calls) == 5, 15.0)
    assert min(b - a for a, b in zip(vehicle.calls, vehicle.calls[1:])) >= 2.0
    vehicle.obeys.add("land")
    flight.run(lambda: vehicle.state == FlightState.LANDED, 10.0)
    assert flight.operator.phase == Phase.FLY
    called = len(vehicle.calls)
    flight.finish()
    assert len(vehicle.calls) == called, "left alone once it stands"
    assert vehicle.count(TAKEOFF_LAND) == 1, "pressed for a vehicle that is out, the button may mean take-off"
    assert vehicle.state == FlightState.LANDED
    for name in ("risc1", "risc3"):
        assert [button for _, button in flight.vehicles[name].presses] == [TAKEOFF_LAND, TOGGLE, TAKEOFF_LAND]


def test_a_vehicle_whose_joystick_node_died_is_landed_when_it_is_back():
    flight = Flight(duration=60.0).on_course()
    vehicle = flight.vehicles["risc2"]
    vehicle.node_alive = False
    since_s = flight.now_s
    flight.run(lambda: "risc2: lost its joystick node" in flight.operator.phase_text, 4.0)
    assert flight.now_s - since_s == pytest.approx(3.0, abs=3 * STEP_S)
    flight.run(lambda: flight.now_s > since_s + 6.0)
    assert vehicle.state == FlightState.HOVERING
    vehicle.node_alive, vehicle.autonomous = True, False  # started again, in manual mode
    flight.run(lambda: vehicle.state == FlightState.LANDED, 10.0)
    assert flight.operator.phase == Phase.FLY
    flight.finish()
    assert [out[:2] for out in flight.operator.out] == [("risc2", OutCause.NODE)]
    assert vehicle.state == FlightState.LANDED


def test_a_vehicle_that_falls_silent_while_taking_off_is_landed():
    """Its last report is "landed", but take-off was pressed: it may be in the air."""
    flight = Flight()
    vehicle = flight.vehicles["risc2"]
    vehicle.obeys.remove("land")
    flight.run(lambda: vehicle.presses)
    vehicle.connected = False
    flight.run(lambda: vehicle.calls, 4.0)
    assert flight.operator.phase == Phase.TAKEOFF
    flight.run(lambda: len(vehicle.calls) == 2, 3.0)
    assert flight.operator.phase == Phase.SETTLE, "the others do not wait for it"
    assert vehicle.calls[1] - vehicle.calls[0] >= 2.0
    vehicle.obeys.add("land")
    flight.run(lambda: vehicle.state == FlightState.LANDED, 10.0)
    vehicle.connected = True
    flight.finish()
    assert [out[:2] for out in flight.operator.out] == [("risc2", OutCause.SILENT)]
    assert vehicle.state == FlightState.LANDED
    assert vehicle.count(TAKEOFF_LAND) == 1, "pressed when its state is unknown, the button may mean take-off"


@pytest.mark.parametrize("out_s, calls", [(1.5, 1), (3.0, 1), (10.0, 5)])
def test_a_vehicle_that_landed_while_its_computer_was_out_of_reach_stays_on_the_ground(out_s, calls):
    """Whatever was pressed meanwhile arrives when the network is back, and the button means take-off there by then."""
    flight = Flight(duration=60.0).on_course()
    vehicle = flight.vehicles["risc2"]
    vehicle.held_up = True
    begin_s = flight.now_s
    flight.run(lambda: flight.now_s >= begin_s + 1.0)
    vehicle.state = FlightState.LANDED
    # arrives: each topic has a connection, and this one is back first
    vehicle.safety = (FailsafeLevel.LAND, "no state for 500 ms")
    flight.run(lambda: flight.now_s >= begin_s + out_s)
    vehicle.held_up = False
    for _ in range(200):
        flight.step()
        assert vehicle.state == FlightState.LANDED
    assert len(vehicle.calls) == calls
    flight.finish()
    assert flight.operator.reason.startswith("risc2 ")
    assert vehicle.count(TAKEOFF_LAND) == 1


def test_old_reports_that_arrive_before_the_new_ones_make_no_takeoff():
    """After an outage: the first report that arrives says that it flies, but it has landed since."""
    flight = Flight(duration=60.0).on_course()
    vehicle = flight.vehicles["risc2"]
    vehicle.connected = False
    since_s = flight.now_s
    flight.run(lambda: vehicle.calls and flight.now_s > vehicle.calls[-1] + 1.9)
    assert flight.now_s > since_s + 2.0
    vehicle.state = FlightState.LANDED
    for _ in range(5):
        flight.operator.vehicles["risc2"].note_report(FlightState.HOVERING, flight.now_s)
        flight.step()
    vehicle.connected = True
    flight.finish()
    assert vehicle.count(TAKEOFF_LAND) == 1 and vehicle.state == FlightState.LANDED


def test_a_silent_vehicle_that_stood_is_not_pressed_into_the_air():
    flight = Flight(duration=30.0).on_course()
    vehicle = flight.vehicles["risc2"]
    vehicle.land(flight.now_s)
    flight.run(lambda: vehicle.state == FlightState.LANDED)
    flight.step()
    pressed = len(vehicle.presses)
    vehicle.connected = False
    for _ in range(200):
        flight.step()
    vehicle.connected, vehicle.state = True, FlightState.UNKNOWN  # a packet without a state
    flight.step()
    vehicle.state = FlightState.LANDED
    flight.finish()
    assert len(vehicle.presses) == pressed
    assert vehicle.state == FlightState.LANDED


def test_time_limit_is_the_sum_of_all_phases():
    assert time_limit_s(OperatorParams(duration=30.0)) == 60.0 + 0.5 + 20.0 + 2.0 + (40.0 + 30.0) + 40.0 + 30.0
    longer = time_limit_s(OperatorParams(autonomous_timeout=50.0, duration=30.0))
    assert longer == time_limit_s(OperatorParams(duration=30.0)) + 10.0
    figures = OperatorParams(duration=20.0, rest=8.0, bumper_steps=5)
    stays_s = 3 * 8.0 + 3 * 20.0 + 5 * 0.4
    assert time_limit_s(figures) == pytest.approx(time_limit_s(OperatorParams(duration=0.0)) + stays_s)


@pytest.mark.parametrize("stuck", ["nowhere", "waiting", "takeoff", "toggle", "course", "home", "land"])
@pytest.mark.parametrize("bumper_steps", [0, 5])
def test_no_flight_outlasts_the_time_limit(stuck, bumper_steps):
    """One phase never ends, with time-outs that are only just long enough."""
    params = {"waiting_timeout": 5.0, "takeoff_timeout": 4.5, "autonomous_timeout": 1.0, "course_timeout": 3.5}
    params.update(home_timeout=3.5, land_timeout=3.0, duration=10.0, rest=4.0, bumper_steps=bumper_steps)
    flight = Flight(**params)
    vehicle, begin_s = flight.vehicles["risc1"], flight.now_s
    vehicle.obeys.discard(stuck)
    vehicle.seen = False
    flight.run(lambda: flight.now_s > begin_s + 4.9)
    vehicle.seen = stuck != "waiting"
    if stuck == "course":
        vehicle.go = lambda now_s: ModelVehicle.go(vehicle, now_s) if vehicle.course != Trajectory.APPROACH else None
    elif stuck == "home":
        vehicle.home = lambda now_s: None
    flight.finish()
    fails = stuck != "nowhere" and not (stuck == "course" and bumper_steps)  # figures have no approach
    assert (flight.operator.result is OperatorResult.FAILED) == fails
    limit_s = time_limit_s(OperatorParams(**params))
    lasted_s = flight.now_s - begin_s
    assert lasted_s <= limit_s + len(Phase) * STEP_S
    if not fails or stuck == "land":
        assert lasted_s > limit_s - 6.0


def test_it_flies_again_and_again_with_all_vehicles():
    flight = Flight()
    assert "(waiting" in flight.operator.fly_again(flight.now_s)
    flight.finish()
    for vehicle in flight.vehicles.values():
        vehicle.safety = (FailsafeLevel.LAND, "battery")
    assert flight.operator.fly_again(flight.now_s) == ""
    flight.run(lambda: "safety ladder (battery)" in flight.operator.text)
    for vehicle in flight.vehicles.values():
        vehicle.safety = OK
    flight.on_course()
    assert (flight.operator.result, flight.operator.reason) == (OperatorResult.RUNNING, "")
    flight.vehicles["risc2"].land(flight.now_s)
    flight.finish()
    assert flight.operator.result == OperatorResult.FAILED and [name for name, *_ in flight.operator.out] == ["risc2"]
    assert flight.operator.fly_again(flight.now_s) == "" and not flight.operator.out
    flight.finish()
    assert (flight.operator.result, flight.operator.flight_failed) == (OperatorResult.OK, False)
    whole = [Phase.WAITING, Phase.TAKEOFF, Phase.SETTLE, Phase.FLY, Phase.HOME, Phase.LAND]
    assert flight.phases == [*whole, Phase.DONE, *whole, Phase.ABORTED, *whole, Phase.DONE]
    # the buttons were pressed as in a first flight: no landing by the service
    assert [vehicle.count(TAKEOFF_LAND) for vehicle in flight.vehicles.values()] == [6, 5, 6]
    assert not any(vehicle.calls for vehicle in flight.vehicles.values())


def test_after_a_flight_that_was_given_up_it_waits_until_all_are_ready():
    flight = Flight(waiting_timeout=20.0)
    flight.on_course()
    flight.vehicles["risc1"].connected = False
    flight.finish()
    assert flight.operator.fly_again(flight.now_s) == ""
    flight.run(Phase.ABORTED)
    assert "risc1 no report" in flight.operator.reason
    flight.vehicles["risc1"].connected = True
    assert flight.operator.fly_again(flight.now_s) == ""
    flight.finish()
    assert flight.operator.result == OperatorResult.OK


def test_bumpers_step_through_the_figures():
    flight = Flight(count=1, bumper_steps=5, duration=10.0, rest=4.0)
    vehicle = flight.vehicles["risc1"]
    vehicle.go = lambda now_s: ModelVehicle.go(vehicle, now_s) if vehicle.course != Trajectory.APPROACH else None
    flight.finish()
    assert flight.operator.result is OperatorResult.OK
    toggled_s = next(t for t, button in vehicle.presses if button == TOGGLE)
    times = [t for t, button in vehicle.presses if button == BUMPER]
    gaps = [b - a for a, b in zip([toggled_s, *times], times)]
    assert gaps == pytest.approx([4.0, 10.0, 4.0, 10.0, 4.0], abs=0.4)
    assert flight.home_calls == 1


def test_a_bumper_is_pressed_on_all_joysticks_or_on_none():
    """One that is pressed alone would be pressed again with the others: a figure further."""
    flight = Flight(count=2, bumper_steps=1, duration=10.0, rest=4.0).run(Phase.FLY)
    flight.run(lambda: flight.operator.text == "at the origin")
    pads = [flight.operator.vehicles[name].pad for name in flight.vehicles]
    down_s = flight.now_s + 3.9
    while flight.now_s < down_s:
        flight.step()
    assert pads[1].press(11)  # a button without meaning, when the bumper's time comes
    flight.finish()
    assert flight.operator.result is OperatorResult.OK
    presses = [[t for t, button in vehicle.presses if button == BUMPER] for vehicle in flight.vehicles.values()]
    assert len(presses[0]) == 1 and presses[0] == presses[1]


def test_presses_do_not_run_into_each_other():
    pad = Joypad()
    assert pad.press(3)
    assert [pad.next_buttons(5) for _ in range(2)] == [[0, 0, 0, 1, 0]] * 2
    assert not pad.press(4)
    assert [pad.next_buttons(5) for _ in range(2)] == [[0] * 5] * 2
    assert pad.press(4)
    assert pad.next_buttons(5) == [0, 0, 0, 0, 1]


@pytest.mark.parametrize("bad", [{"duration": -1.0}, {"bumper_steps": 1.5}, {"settle": "2"}, {"bumper": 6}])
def test_bad_parameters_are_named(bad):
    with pytest.raises(ValueError, match=next(iter(bad))):
        OperatorParams(**bad)
