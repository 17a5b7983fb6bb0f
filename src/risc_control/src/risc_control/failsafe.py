"""The loss ladder of one vehicle: what happens when what it flies on goes silent, or it leaves the room. No ROS.

Levels, from the bottom:
    OK    nothing to do.
    HOLD  level and hold altitude (zero acceleration, thesis 7.7). Ends at once when everything is fresh again.
    LAND  land, ordered again and again until the vehicle reports that it stands. Stays, even when everything is fresh
          again, until then or until the operator takes over.
A vehicle that must hold because of others (`separation`) moves up or down while that is not enough, and
lands when it has held for `separation_land_s`; beside one that is straight below, or after `separation_wait_s`.
The top level, the emergency stop, is the operator's: the ladder only says when it is time to think of it.

In manual mode the operator's eyes fly: mocap, controls, fence, the other vehicles, battery and telemetry do not act
then, only the loss of the joystick does. A vehicle that does not fly itself (`hover`) is held by mocap and telemetry in
manual mode, too, whose loss acts then. A landing may be asked for in any mode (`request_landing`): a LAND like any
other.

Times are seconds of a clock that never steps (monotonic); a message's age is what its stamp said when it arrived (by
the wall clock, which all computers must share; small differences make nothing younger, see `message_age`) plus the
time since.
"""

import math
from dataclasses import dataclass, replace

from risc_control.fence import Fence
from risc_control.safety import LOSSES, FailsafeLevel, Rule, SafetyLimits, Verdict
from risc_control.separation import ALONE
from risc_lab.message_age import MessageAges

_OK, _HOLD, _LAND = FailsafeLevel  # the members of an enumeration are slow to look up, and this is asked in every frame
_FENCE_CLEAR_S = 0.3  # the fence lets go of a vehicle that could stop in time for so long;
_FENCE_FORGETS_S = 3.0  # one that it must hold again within so long it holds until it lands
_JOYSTICK_MEMORY_S = 60.0  # on the ground a joystick is missed for so long
# behind the reason of a message that has been long on its way
_LATE = ", %.0f ms when it came: shorten the delays of motion capture, network and computer, or set the clocks"
_FINE = (_OK, Rule.NONE, "", None)  # what `SafetyLadder._judge` says of a flight without trouble


class Freshness:
    """Age of the newest good message of one kind, by its stamp and by its arrival."""

    def __init__(self, what, clock_tolerance_s):
        self._what = what
        self._tolerance_s = clock_tolerance_s
        self._arrival_s = -math.inf
        self._age_at_arrival_s = 0.0
        self.ages = MessageAges()
        self._clock_error_s = 0.0  # how far the newest stamp was in the future, when too far

    def note(self, age_at_arrival_s, now_s):
        """A good message: its age by its stamp when it arrived, and the time of arrival."""
        if age_at_arrival_s < -self._tolerance_s:
            self._clock_error_s = -age_at_arrival_s
            return
        self._clock_error_s = 0.0
        self._arrival_s = now_s
        self._age_at_arrival_s = self.ages.corrected(age_at_arrival_s, now_s)

    @property
    def late_s(self):
        """Age of the newest good message when it arrived."""
        return self._age_at_arrival_s

    def age_s(self, now_s):
        """Age now; infinite before the first good message."""
        return now_s - self._arrival_s + self._age_at_arrival_s

    def describe(self, now_s):
        """Why it is not fresh, in a few words."""
        if self._clock_error_s:
            text = "%s stamped %.0f ms in the future: set the computers' clocks"
            return text % (self._what, 1e3 * self._clock_error_s)
        age_s = self.age_s(now_s)
        if math.isinf(age_s):
            return "no %s yet" % self._what
        text = "%s %.0f ms old" % (self._what, 1e3 * age_s)
        return text + _LATE % (1e3 * self.late_s) if self.late_s > 0.5 * age_s else text


class Lasting:
    """For how long something was seen to be so, without a break; silence adds nothing."""

    def __init__(self):
        self._since_s = None
        self._last_s = None

    def note(self, is_so, now_s):
        """It was looked at."""
        if not is_so:
            self._since_s = None
            return
        self._last_s = now_s
        if self._since_s is None:
            self._since_s = now_s

    def lasts(self, limit_s):
        """True when it was seen to be so for that long, up to the newest look."""
        return self._since_s is not None and self._last_s - self._since_s >= limit_s


@dataclass(frozen=True)
class Reaction:
    """How fast a level was entered: age of the newest good message, and the part of it beyond the threshold."""

    level: FailsafeLevel
    age_s: float
    beyond_s: float


class SafetyLadder:
    """One vehicle's ladder. Feed it what arrives, ask `update` often (at 50 Hz or more)."""

    def __init__(self, limits, vehicle_type, now_s):
        """limits: SafetyLimits.  vehicle_type: VehicleType."""
        self.limits = limits
        self.reports = "navdata"  # what people call the vehicle's reports
        self.state = Freshness("state", limits.clock_tolerance_s)
        self.controls = Freshness("controls", limits.clock_tolerance_s)
        self.suspect = ""  # what the newest state contradicts; "" when nothing
        self._suspect_s = -math.inf  # when it came
        self._not_finite_s = -math.inf  # when the controller sent a command that was not finite, last
        self._saturated = Lasting()
        self._losses = (  # what it flies on, and how old that may be
            (Rule.STATE, self.state, limits.state_hold_s, limits.state_land_s),
            (Rule.CONTROLS, self.controls, limits.controls_hold_s, limits.controls_land_s),
        )
        self.verdict = Verdict(_OK, "")
        self.reactions = []  # the newest Reaction of each level that was entered for age, oldest first
        self._navdata_s = None
        self._joystick_s = now_s  # newest message of any joystick; silence counts from the start
        self._joysticks_once = set()  # senders that were heard once: beside others, they owe no second message
        self._joysticks_s = {}  # {sender that was heard again: when it was last}
        self._airborne = False
        self._battery_pct = None
        self._battery_low = Lasting()
        self.fence = Fence(limits, vehicle_type)
        self._outside, self._leaves = Lasting(), Lasting()
        self._left_s = -math.inf  # when it could not stop in time last
        self._fence_since_s = self._fence_ended_s = -math.inf  # when the fence held it
        self._fence_again = False  # shortly before it did so, too
        self._look = ALONE
        self._near = Lasting()
        self._apart_since_s, self._apart_reason = None, ""  # it holds or lands because of other vehicles
        self._lost_since_s = math.inf  # since when it holds without a break for what it flies on
        self._position_m = None
        self._land_since_s = None

    def note_state(self, position_m, velocity_m_s, age_at_arrival_s, now_s, pushes=(), lands=False):
        """The vehicle was seen: its position (3,) [m] and velocity (3,) [m/s], cortex frame.

        pushes: accelerations (3,) [m/s^2] that its tilt makes, or will make.  lands: by itself; nobody can hold it.
        """
        self.state.note(age_at_arrival_s, now_s)
        self.suspect = ""
        self._position_m = position_m
        self._outside.note(self.fence.is_outside(position_m), now_s)
        self._leaves.note(not lands and self.fence.leaves(position_m, velocity_m_s, pushes), now_s)
        if self._leaves.lasts(self.limits.fence_delay_s):
            self._left_s = now_s

    def note_suspect(self, reason, now_s):
        """The vehicle was seen with a state that cannot be true. reason: what it contradicts."""
        self.suspect, self._suspect_s = reason, now_s

    def note_command(self, finite, saturated, now_s):
        """The controller has sent a command. finite: of numbers.  saturated: of a full scale of tilt or thrust."""
        if not finite:
            self._not_finite_s = now_s
        # while another rule holds the vehicle its reference goes on, and full tilt is to be expected
        counts = self.verdict.level == _OK or self.verdict.rule == Rule.CONTROLS
        self._saturated.note(finite and saturated and counts, now_s)

    def note_look(self, look, now_s):
        """What it has to do about the other vehicles (`separation.Look`) by what was seen now."""
        self._look = look
        # Those that hold because of the same loss go on together: that the others still hold counts from then on.
        is_lost = self.verdict.level == _HOLD and self.verdict.rule in LOSSES
        self._near.note(look.holds and not (is_lost and look.joins), now_s)

    def apart(self, now_s):
        """The newest `separation.Look` while it holds because of other vehicles, else None. Nobody is sent aside before
        it is time to land: first all come to a stop.
        """
        if self.verdict.level != _HOLD or self.verdict.rule != Rule.SEPARATION:
            return None
        stops = now_s - self._apart_since_s < self.limits.separation_land_s
        return self._look._replace(aside=ALONE.aside) if stops else self._look

    def note_navdata(self, battery_pct, now_s):
        """The vehicle reported itself; battery_pct: None when the report holds none."""
        self._navdata_s = now_s
        if battery_pct is not None:
            self._battery_pct = battery_pct
            self._battery_low.note(self.battery_is_low(), now_s)

    def note_joystick(self, now_s, sender=""):
        """A joystick said something; sender: which node it is from. Each that speaks must go on: one of them may be
        the hand on the emergency stop.
        """
        self._joystick_s = now_s
        if sender in self._joysticks_once:
            self._joysticks_s[sender] = now_s
        else:
            self._joysticks_once.add(sender)

    def lost_joystick(self, now_s):
        """Name of a joystick that spoke within the last minute, and is silent; None when there is none."""
        for name, heard_s in self._joysticks_s.items():
            if self._is_silent(heard_s, now_s) and now_s - heard_s < _JOYSTICK_MEMORY_S:
                return name
        return None

    def _is_silent(self, heard_s, now_s):
        return 0.0 < self.limits.joystick_timeout < now_s - heard_s

    def navdata_is_fresh(self, now_s):
        """True when the vehicle's newest report still tells what it does.

        Switching the rule off does not make an old report true: the default limit counts then.
        """
        limit_s = self.limits.navdata_timeout_s or SafetyLimits.navdata_timeout_s
        return self._navdata_s is not None and now_s - self._navdata_s <= limit_s

    def battery_is_low(self):
        """True when the newest battery reported is at or below the limit."""
        return self._battery_pct is not None and 0.0 < self.limits.battery_min_pct >= self._battery_pct

    def autonomy_problem(self, now_s, needs_navdata=True):
        """Why the vehicle must not fly by itself now, in a few words; "" when it may."""
        level, _, reason, _ = self._judge(now_s, True, needs_navdata)
        return reason if level > _OK else ""

    def request_landing(self, now_s):
        """Somebody wants it down: LAND, in every mode. One that lands already keeps its reason."""
        if self.verdict.level != _LAND:
            self._set(_LAND, Rule.REQUEST, "landing was requested", None, now_s)

    def take_over(self):
        """The operator flies: whatever was decided is taken back, and joysticks that are silent are missed no more."""
        self._joysticks_s.clear()
        self._set(*_FINE, 0.0)

    def update(self, now_s, autonomous, airborne, obeys=False, needs_navdata=True, held=False, trouble=""):
        """Judge the situation. Returns the `Verdict`, which is also kept in `self.verdict`.

        autonomous: the controller flies.  airborne: the vehicle does not stand on the ground.  obeys: its newest
        report is that it lands; counts while that report is fresh.  needs_navdata: False for simulators that report
        nothing.  held: of a vehicle that does not fly itself, which is held by what is seen and heard of it in manual
        mode, too; it may obey by what is seen of it.  trouble: why our commands do not reach it.
        """
        if airborne and not self._airborne:  # whatever took off: these were known to be silent
            self._joysticks_s = {name: s for name, s in self._joysticks_s.items() if not self._is_silent(s, now_s)}
        self._airborne = airborne
        if not airborne:
            if self.verdict.level != _OK:
                self.take_over()
            return self.verdict
        if self.verdict.level == _LAND:
            if obeys and (held or self.navdata_is_fresh(now_s)):
                self._land_since_s = now_s
            without_effect = now_s - self._land_since_s > self.limits.operator_after_s
            if without_effect != self.verdict.operator:
                self.verdict = replace(self.verdict, operator=without_effect)
            return self.verdict
        if not self.limits.ladder:
            return self.verdict
        level, rule, reason, age = self._judge(now_s, autonomous, needs_navdata, held, trouble)
        if level != self.verdict.level or rule != self.verdict.rule:
            self._set(level, rule, reason, age, now_s)
        return self.verdict

    def _set(self, level, rule, reason, age, now_s):
        if level == _OK or rule not in LOSSES:
            self._lost_since_s = math.inf
        elif self._lost_since_s == math.inf:
            self._lost_since_s = now_s
        if level == _OK:
            self._apart_since_s = None
        elif rule == Rule.SEPARATION and self._apart_since_s is None:
            self._apart_since_s, self._apart_reason = now_s, reason
        if rule == Rule.FENCE and self.verdict.rule != Rule.FENCE:
            self._fence_since_s, self._fence_again = now_s, now_s - self._fence_ended_s < _FENCE_FORGETS_S
        elif self.verdict.rule == Rule.FENCE and rule != Rule.FENCE:
            self._fence_ended_s = now_s
        self._land_since_s = now_s if level == _LAND else None
        entered = level > self.verdict.level
        age_s, limit_s = age or (None, None)
        self.verdict = Verdict(level, reason, rule=rule, age_s=age_s, limit_s=limit_s)
        if entered and age is not None and math.isfinite(age_s):
            reaction = Reaction(level, age_s, age_s - limit_s)
            self.reactions = [old for old in self.reactions if old.level != level] + [reaction]

    def _judge(self, now_s, autonomous, needs_navdata, held=False, trouble=""):
        """(level, rule, reason, (age, its threshold) or None) by the first rule of the highest level."""
        limits = self.limits
        age_s = now_s - (min(self._joysticks_s.values()) if self._joysticks_s else self._joystick_s)
        if 0.0 < limits.joystick_timeout < age_s:
            name = min(self._joysticks_s, key=self._joysticks_s.get, default="")
            reason = "joystick%s silent for %.1f s" % (" " + name if name else "", age_s)
            return _LAND, Rule.JOYSTICK, reason, (age_s, limits.joystick_timeout)
        if trouble:
            return _LAND, Rule.NAVDATA, trouble, None
        if not autonomous and not held:
            return _FINE
        hold = _FINE
        for rule, fresh, hold_s, land_s in self._losses[: None if autonomous else 1]:
            age_s = fresh.age_s(now_s)
            if age_s <= hold_s or (age_s <= land_s and hold is not _FINE):
                continue
            reason = fresh.describe(now_s)
            if rule == Rule.STATE and self.suspect and now_s - self._suspect_s <= hold_s:
                rule, reason = Rule.SUSPECT, "%s: %s" % (reason, self.suspect)
            elif rule == Rule.CONTROLS and now_s - self._not_finite_s <= hold_s:
                reason += ": the controller sends commands that are not finite"
            # one that is always a little too late is as good as none: its reference goes on, through the others
            if age_s > land_s or now_s - self._lost_since_s >= land_s - hold_s > 0.0:
                return _LAND, rule, reason, (age_s, min(age_s, land_s))
            hold = _HOLD, rule, reason, (age_s, hold_s)
        age_s = math.inf if self._navdata_s is None else now_s - self._navdata_s
        if needs_navdata and 0.0 < limits.navdata_timeout_s < age_s:
            silent = self.reports + " silent for %.1f s"
            reason = silent % age_s if self._navdata_s is not None else "no %s yet" % self.reports
            return _LAND, Rule.NAVDATA, reason, (age_s, limits.navdata_timeout_s)
        if not autonomous:
            return hold
        if limits.saturated_land_s and self._saturated.lasts(0.5 * limits.saturated_land_s):
            level = _LAND if self._saturated.lasts(limits.saturated_land_s) else _HOLD
            if level > hold[0]:
                reason = "the controller commands full tilt or thrust for more than %.2g s"
                hold = level, Rule.CONTROLS, reason % (0.5 * level * limits.saturated_land_s), None
            if level == _LAND:
                return hold
        # Seen outside for that long: one false position followed by silence is a loss, not an escape.
        if self._outside.lasts(limits.fence_delay_s):
            return _LAND, Rule.FENCE, "outside of the fence at (%.2f, %.2f, %.2f) m" % tuple(self._position_m), None
        if self._battery_low.lasts(limits.battery_delay_s):
            return _LAND, Rule.BATTERY, "battery at %.0f %%" % self._battery_pct, None
        leaves = self._leaves.lasts(limits.fence_delay_s)
        if self.verdict.rule == Rule.FENCE:
            leaves = self._fence_again or now_s - self._left_s < _FENCE_CLEAR_S
        if leaves:
            reason = "it could not stop inside the fence much later, at (%.2f, %.2f, %.2f) m" % tuple(self._position_m)
            if self.verdict.rule == Rule.FENCE and now_s - self._fence_since_s >= limits.fence_land_s:
                return _LAND, Rule.FENCE, reason, None
            hold = (_HOLD, Rule.FENCE, reason, None) if hold is _FINE else hold
        if self._apart_since_s is None and not self._near.lasts(limits.separation_delay_s):
            return hold
        # It stays: its reference has gone on, and it would follow that through the others.
        held_s = 0.0 if self._apart_since_s is None else now_s - self._apart_since_s
        waits = self._look.above and held_s < limits.separation_wait_s
        level = _LAND if held_s >= limits.separation_land_s and not waits else _HOLD
        if level <= hold[0] and hold[1] != Rule.FENCE:  # which has no way out of the others'
            return hold
        return level, Rule.SEPARATION, self._look.reason or self._apart_reason, None
