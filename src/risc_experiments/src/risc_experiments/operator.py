"""The virtual operator: flies an experiment by pressing the buttons of joysticks. No ROS.

Each vehicle has a joystick. The operator looks at what a person would look at (is it seen by mocap, what does the
vehicle report, what does its joystick node say) and presses two buttons: take-off/land and manual/autonomous. Only a
silent vehicle is asked to land by its service: it may have landed already, and the button would mean take-off.

    waiting -> takeoff -> settle -> fly -> home -> land -> done | aborted

After the end it waits; `fly_again` starts another flight with all vehicles.

A phase that takes too long, and a request to land, lead to `land`. A vehicle that lands by itself (its safety ladder),
falls silent or loses its joystick node has failed: it is told to land, again and again until it reports that it
stands, and is left alone from then on; the others fly on. Times are seconds of a monotonic clock.
"""

import math
from dataclasses import dataclass

from risc_control.safety import FailsafeLevel
from risc_control.vehicles import NO_EVIDENCE, ON_GROUND, TAKES_COMMANDS, FlightState
from risc_lab.phases import OperatorPhase as Phase
from risc_lab.phases import OperatorResult, OutCause
from risc_lab.phases import TrajectoryPhase as Trajectory
from risc_lab.settings import Count, NotNegative, Settings

JOY_RATE_HZ = 10.0  # of its joysticks; one `Operator.step` for each message
_PRESS_MESSAGES = 2  # a button is down in so many messages, then up in at least as many: a late message loses no edge
_LAND_AGAIN_S = 2.0
_LISTEN_S = 1.0  # to find out which vehicles fly already
_SURE_S = 0.5  # a vehicle whose newest report is older may have landed meanwhile: the button could be a take-off
_TAKEOFF_AGAIN_S = 2.0
_TOGGLE_AGAIN_S = 1.0
_TAKEOFF_PENDING_S = 3.0  # a take-off may show in the reports that late: until then "landed" proves nothing


@dataclass(frozen=True)
class OperatorParams(Settings):
    """Buttons (defaults: Appendix C), durations and time-outs."""

    JoytoWay: Count = 0  # button: manual/autonomous
    TakeoffLand: Count = 6  # button: take-off/land
    bumper: Count = 5  # button: next figure (DF_experiment_joy.py)
    bumper_steps: Count = 0  # how often the bumper is pressed on the course; 0 = the course needs none
    duration: NotNegative = 40.0  # [s] on the course; with bumper steps: on each figure
    rest: NotNegative = 8.0  # [s] at the origin before each figure, with bumper steps; never longer than a figure
    settle: NotNegative = 2.0  # [s] hovering before the course
    ready: NotNegative = 0.5  # [s] everything must have been ready for so long before take-off
    seen_timeout: NotNegative = 0.3  # [s] mocap
    report_timeout: NotNegative = 3.0  # [s] navdata, controller_status; ladders must act first, and wait up to 2.5 s
    waiting_timeout: NotNegative = 60.0  # [s] until all is ready
    takeoff_timeout: NotNegative = 20.0  # [s] until all hover
    autonomous_timeout: NotNegative = 10.0  # [s] until all are in autonomous mode
    course_timeout: NotNegative = 40.0  # [s] until all are on their course
    home_timeout: NotNegative = 40.0  # [s] until all are home
    land_timeout: NotNegative = 30.0  # [s] until all stand

    @property
    def rest_s(self):
        """Time at the origin before each figure [s]."""
        return min(self.rest, self.duration)

    def __post_init__(self):
        super().__post_init__()
        if len({self.JoytoWay, self.TakeoffLand, self.bumper}) < 3:
            raise ValueError("JoytoWay, TakeoffLand and bumper must be three different buttons")


def course_s(params):
    """Time on the course [s]; with bumper steps: on all figures, and at the origin before each of them."""
    steps = params.bumper_steps
    figures = (steps + 1) // 2  # every other stay, the origin is the first
    return figures * params.duration + (steps + 1 - figures) * params.rest_s if steps else params.duration


def time_limit_s(params):
    """How long a flight takes at most [s], all phases and their time-outs together.

    Not included: a few periods of `step`, one for each phase.
    """
    # both time-outs before the course count from the start of the phase
    fly_s = max(params.autonomous_timeout, params.course_timeout) + course_s(params)
    before_s = params.waiting_timeout + params.ready + params.takeoff_timeout + params.settle
    presses_s = params.bumper_steps * 2.0 * _PRESS_MESSAGES / JOY_RATE_HZ
    return before_s + fly_s + presses_s + params.home_timeout + params.land_timeout


class Joypad:
    """One virtual joystick: a press lasts some messages, and presses do not run into each other."""

    def __init__(self):
        self._button = None
        self._messages = 2 * _PRESS_MESSAGES  # since it went down

    def press(self, button):
        """Press a button; True when it goes down, False while the last press is not over."""
        if not self.is_free:
            return False
        self._button, self._messages = button, 0
        return True

    @property
    def is_free(self):
        return self._messages >= 2 * _PRESS_MESSAGES

    def next_buttons(self, count):
        """The buttons of the next Joy message: list of `count` zeros and ones."""
        down = self._button if self._messages < _PRESS_MESSAGES else None
        self._messages += 1
        return [1 if index == down else 0 for index in range(count)]


class Watched:
    """What the operator knows of one vehicle, and its joystick."""

    def __init__(self):
        self.pad = Joypad()
        self.flight_state = None
        self.autonomous = False
        self.trajectory_phase = None
        self.safety, self.safety_reason = FailsafeLevel.OK, ""
        self.refusals = ()  # why it refused the last order to take off
        self.seen_s = self.reported_s = self.status_s = -math.inf
        self._in_air = False  # by the newest report that says anything about it
        self._ground_s = -math.inf  # when it reported last that it stands
        self.take_part()

    def take_part(self):
        """Take part in a new flight."""
        self.failure, self.cause = "", None  # why it is out, as text and as OutCause; "" while it takes part
        self.takeoff_s = self.toggle_s = self.land_s = -math.inf  # when it was last told to do that

    def note_report(self, state, now_s):
        """Take a report of its state number."""
        self.flight_state, self.reported_s = int(state), now_s
        if state in ON_GROUND:
            self._in_air, self._ground_s = False, now_s
        elif state not in NO_EVIDENCE:
            self._in_air = True

    def may_fly(self):
        """True until it has reported that it stands, late enough after the last take-off that was pressed."""
        return self._in_air or self._ground_s < self.takeoff_s + _TAKEOFF_PENDING_S

    def flies(self, params, now_s):
        """True when its newest report is that it is in the air."""
        return self._in_air and not self.is_silent(params, now_s)

    def is_silent(self, params, now_s):
        """True when its newest report is too old."""
        return now_s - self.reported_s > params.report_timeout

    def leave(self, cause, failure):
        """Take it out of the flight."""
        self.cause, self.failure = cause, failure

    def not_ready(self, params, now_s):
        """What is missing for a take-off, "" when nothing is."""
        if self.is_silent(params, now_s):
            return "no report of the vehicle (is its driver connected?)"
        if self.flight_state != FlightState.LANDED:
            return "does not report landed (state %s)" % self.flight_state
        if self.safety == FailsafeLevel.LAND:
            return "is still being landed by its safety ladder (%s)" % self.safety_reason
        if now_s - self.status_s > params.report_timeout:
            return "no controller_status (is the joystick node running?)"
        if now_s - self.seen_s > params.seen_timeout:
            return "not seen by mocap"
        return ""


class Operator:
    """The sequence for all vehicles. Update `vehicles` with what is received; call `step` at the rate of the joysticks.

    vehicles: their namespaces.  go_home: function that asks the trajectory node to bring all home (or to hold, when
    there is no such node) and gives the result to `home_called`.  land: function of a namespace that calls its landing
    service.  Neither of them blocks.  started_again: an earlier operator has taken off, and died: vehicles in the air
    are landed, and none takes off.
    """

    def __init__(self, vehicles, params, now_s, go_home, land, started_again=False):
        self.vehicles = {name: Watched() for name in vehicles}
        self._params, self._call_home, self._call_land = params, go_home, land
        self._begin(now_s)
        self._found_flight = started_again  # vehicles fly that this operator did not start

    def _begin(self, now_s):
        self.phase = Phase.WAITING
        self.text = ""  # detail of the phase
        self.result, self.reason = OperatorResult.RUNNING, ""  # reason: why it failed
        self.flight_failed = False  # as a whole, not only single vehicles
        self._since_s = now_s  # start of the phase
        self._ready_since_s = None
        self._course_since_s = None
        self._step_since_s = None
        self._steps_left = 0
        self._failure = ""  # why the flight failed
        self._found_flight = False

    def fly_again(self, now_s):
        """Begin another flight, with all vehicles. Returns why not; "" when it begins."""
        if not self.finished:
            return "a flight is under way (%s)" % self.phase_text
        for watched in self.vehicles.values():
            watched.take_part()
        self._begin(now_s)
        return ""

    def request_landing(self, reason, now_s):
        """Land everything now; the flight counts as failed."""
        if self.phase not in (Phase.LAND, Phase.DONE, Phase.ABORTED):
            self._fail(reason, now_s)

    def home_called(self, problem, now_s):
        """The trajectory node was asked to bring all home; problem: why that failed, "" when it did not."""
        if problem and self.phase == Phase.HOME:
            self._fail("cannot fly home: " + problem, now_s)

    @property
    def on_course(self):
        """Whether all have reached their course; stays true."""
        return self._course_since_s is not None

    @property
    def out(self):
        """[(namespace, OutCause, text)] of the vehicles that are out of the flight."""
        return [(name, w.cause, w.failure) for name, w in self.vehicles.items() if w.failure]

    @property
    def finished(self):
        return self.phase in (Phase.DONE, Phase.ABORTED)

    @property
    def phase_text(self):
        """Phase for people, e.g. "waiting: risc2 not seen by mocap"."""
        return self.phase.name.lower() + (": " + self.text if self.text else "")

    def step(self, now_s):
        """Evaluate the reports, decide, and press buttons."""
        if self.phase in (Phase.TAKEOFF, Phase.SETTLE, Phase.FLY, Phase.HOME):
            self._note_failures(now_s)
            # a dead joystick node or a lost link may lose an order: repeat it for those that are out until they stand
            self._order_landings([name for name, w in self.vehicles.items() if w.failure], now_s)
            if not self._taking_part():
                self._land_all("no vehicle flies any more", now_s)
        getattr(self, "_" + self.phase.name.lower())(now_s)

    def _waiting(self, now_s):
        flying = [w for w in self.vehicles.values() if w.flies(self._params, now_s)]
        self._found_flight = self._found_flight or bool(flying)
        if self._found_flight:
            if now_s - self._since_s > _LISTEN_S:
                for w in flying:
                    cause = OutCause.LADDER if w.safety == FailsafeLevel.LAND else OutCause.MANUAL
                    w.leave(cause, "was in flight when the operator was started")
                self._land_all("the operator was started in flight", now_s)
            return
        missing = {name: w.not_ready(self._params, now_s) for name, w in self.vehicles.items()}
        self.text = "; ".join("%s %s" % item for item in missing.items() if item[1])
        if self.text:
            self._ready_since_s = None
            self._give_up_after(self._params.waiting_timeout, "not ready", self.text, now_s)
            return
        self._ready_since_s = now_s if self._ready_since_s is None else self._ready_since_s
        if now_s - self._ready_since_s >= self._params.ready:
            self._enter(Phase.TAKEOFF, now_s)

    def _takeoff(self, now_s):
        waiting = [name for name, w in self._taking_part() if w.flight_state not in TAKES_COMMANDS]
        if not waiting:
            self._enter(Phase.SETTLE, now_s)
            return
        self.text = ", ".join(map(self._refused, waiting))
        for _, w in self._taking_part():
            stands = w.flight_state == FlightState.LANDED and now_s - w.reported_s <= _SURE_S
            if stands and now_s - w.takeoff_s > _TAKEOFF_AGAIN_S:
                if w.pad.press(self._params.TakeoffLand):
                    w.takeoff_s = now_s
        self._give_up_after(self._params.takeoff_timeout, "no hover", self.text, now_s)

    def _refused(self, name):
        refusals = "; ".join(self.vehicles[name].refusals)
        return "%s (take-off refused: %s)" % (name, refusals) if refusals else name

    def _settle(self, now_s):
        if now_s - self._since_s > self._params.settle:
            self._enter(Phase.FLY, now_s)

    def _fly(self, now_s):
        if self._course_since_s is None:
            self._start_course(now_s)
        elif self._params.bumper_steps:
            self._step_through(now_s)
        elif now_s - self._course_since_s >= self._params.duration:
            self._enter(Phase.HOME, now_s)

    def _start_course(self, now_s):
        """Switch to autonomous mode and wait until all are on their course."""
        params = self._params
        manual = [name for name, w in self._taking_part() if not w.autonomous]
        if manual:
            self.text = "switching %s to autonomous" % ", ".join(manual)
            for name in manual:
                w = self.vehicles[name]
                if now_s - w.toggle_s > _TOGGLE_AGAIN_S and w.pad.press(params.JoytoWay):
                    w.toggle_s = now_s
            self._give_up_after(params.autonomous_timeout, "no autonomous mode", ", ".join(manual), now_s)
            return
        away = [name for name, w in self._taking_part() if w.trajectory_phase != Trajectory.COURSE]
        if away and not params.bumper_steps:
            self.text = "%s on the way to the course" % ", ".join(away)
            self._give_up_after(params.course_timeout, "not on course", ", ".join(away), now_s)
            return
        self._course_since_s = self._step_since_s = now_s
        self._steps_left = params.bumper_steps
        self.text = "on course for %g s" % params.duration if not params.bumper_steps else "at the origin"

    def _step_through(self, now_s):
        """Figures of DF_experiment_joy: origin, figure, origin, figure, ...; the bumper leads to the next one."""
        params = self._params
        done = params.bumper_steps - self._steps_left
        on_figure = done % 2 == 1
        if now_s - self._step_since_s < (params.duration if on_figure else params.rest_s):
            return
        if not self._steps_left:
            self._enter(Phase.HOME, now_s)
            return
        pads = [w.pad for _, w in self._taking_part()]
        if all(pad.is_free for pad in pads):
            for pad in pads:
                pad.press(params.bumper)
            self._steps_left -= 1
            self._step_since_s = now_s
            self.text = "figure %d" % (done // 2 + 1) if not on_figure else "at the origin"

    def _home(self, now_s):
        away = [name for name, w in self._taking_part() if w.trajectory_phase != Trajectory.HOMED]
        if not away:
            self._enter(Phase.LAND, now_s)
            return
        self.text = ", ".join(away)
        self._give_up_after(self._params.home_timeout, "not home", self.text, now_s)

    def _land(self, now_s):
        flying = [w for w in self.vehicles.values() if w.may_fly()]
        self._order_landings(self.vehicles, now_s)
        overdue = now_s - self._since_s > self._params.land_timeout
        for w in flying if overdue else ():
            if not w.failure:
                w.leave(OutCause.OVERDUE, "did not land within %g s" % self._params.land_timeout)
        if overdue or not flying:
            self._finish(now_s)

    def _done(self, now_s):
        """Vehicles that did not land in time are still told to."""
        self._order_landings(self.vehicles, now_s)

    _aborted = _done

    def _order_landings(self, names, now_s):
        """Tell vehicles to land, repeatedly; press the button only if one is known to fly: else it means take-off.

        After an outage, old reports arrive first and look new. So a vehicle that is out, or was told already, is told
        by its service, which never means take-off.
        """
        for name in names:
            w = self.vehicles[name]
            if not w.may_fly() or now_s - w.land_s <= _LAND_AGAIN_S:
                continue
            heard = now_s - w.reported_s <= _SURE_S
            if heard and (w.flight_state in ON_GROUND or w.flight_state == FlightState.LANDING):
                continue
            if not heard or w.failure or w.land_s > -math.inf:
                w.land_s = now_s
                self._call_land(name)
            elif w.pad.press(self._params.TakeoffLand):
                w.land_s = now_s

    def _note_failures(self, now_s):
        """Take out the vehicles that land, fall silent or fall back to manual mode without being told to."""
        started = self.phase != Phase.TAKEOFF
        limit_s = self._params.report_timeout
        flew = self.phase == Phase.HOME or self._course_since_s is not None
        for name, w in self._taking_part():
            if w.safety == FailsafeLevel.LAND:
                w.leave(OutCause.LADDER, "landed by its safety ladder (%s)" % w.safety_reason)
            elif started and w.flight_state in (FlightState.LANDED, FlightState.LANDING):
                w.leave(OutCause.LANDED, "landed by itself")
            elif w.is_silent(self._params, now_s):
                w.leave(OutCause.SILENT, "silent: no report for %g s" % limit_s)
            elif now_s - w.status_s > limit_s:
                w.leave(OutCause.NODE, "lost its joystick node: no controller_status for %g s" % limit_s)
            elif flew and not w.autonomous and now_s - w.toggle_s > _TOGGLE_AGAIN_S:
                w.leave(OutCause.MANUAL, "fell back to manual mode")
            if w.failure:
                self.text = "%s: %s; the others fly on" % (name, w.failure)

    def _taking_part(self):
        return [(name, w) for name, w in self.vehicles.items() if not w.failure]

    def _give_up_after(self, limit_s, what, details, now_s):
        """Land all when the phase has lasted longer than its limit."""
        if now_s - self._since_s > limit_s:
            self._fail("%s within %g s: %s" % (what, limit_s, details), now_s)

    def _enter(self, phase, now_s):
        self.phase, self._since_s, self.text = phase, now_s, ""
        if phase == Phase.HOME:
            self._call_home()

    def _fail(self, reason, now_s):
        self.flight_failed = True
        self._land_all(reason, now_s)

    def _land_all(self, reason, now_s):
        self._failure = self._failure or reason
        self._enter(Phase.LAND, now_s)
        self.text = reason

    def _finish(self, now_s):
        reasons = [self._failure] if self._failure else []
        reasons += ["%s %s" % (name, failure) for name, _, failure in self.out]
        self.result = OperatorResult.FAILED if reasons else OperatorResult.OK
        self.reason = "; ".join(reasons)
        self._enter(Phase.ABORTED if reasons else Phase.DONE, now_s)
        self.text = self.reason
