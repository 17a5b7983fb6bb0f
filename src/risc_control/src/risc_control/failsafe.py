"""The safety ladder of one vehicle: what happens when its inputs go silent or it leaves the fence. No ROS.

Levels, from the bottom:
    OK    nothing to do.
    HOLD  level and hold altitude (zero acceleration, thesis 7.7). Ends at once when everything is fresh again.
    LAND  land, ordered again and again until the vehicle reports that it stands. Stays, even when everything is fresh
          again, until then or until the operator takes over.
A vehicle that must hold because of others (`separation`) moves up or down while holding is not enough, and lands when
it has held for `separation_land_s`. Above another vehicle it first goes aside; it lands anyway after
`separation_wait_s`. The top level, the emergency stop, is the operator's: the ladder only says when it is needed.

In manual mode the operator watches the vehicle: mocap, controls, fence, the other vehicles, battery and telemetry have
no effect then, only the loss of the joystick has. A vehicle that does not fly itself (`hover`) is held by mocap and
telemetry in manual mode, too, so their loss counts. A landing may be requested in any mode (`request_landing`): a LAND
like any other.

Times are seconds of a monotonic clock; a message's age is its age by its stamp when it arrived (by the wall clock,
which all computers must share; small differences make no message younger, see `message_age`) plus the time since.
"""

import math
from dataclasses import dataclass, replace

from risc_control.fence import Fence
from risc_control.safety import LOSSES, FailsafeLevel, Rule, SafetyLimits, Verdict
from risc_control.separation import ALONE
from risc_lab.message_age import MessageAges

_OK, _HOLD, _LAND = FailsafeLevel  # the members of an enumeration are slow to look up, and this is asked in every frame
_FENCE_CLEAR_S = 0.3  # the fence releases a vehicle that could have stopped in time for this long;
_FENCE_FORGETS_S = 3.0  # one that it must hold again within this time it holds until it lands
_JOYSTICK_MEMORY_S = 60.0  # how long a lost joystick keeps the vehicle on the ground
# appended to the reason for a message that arrived late
_LATE = ", %.0f ms when it came: shorten the delays of motion capture, network and computer, or set the clocks"
_FINE = (_OK, Rule.NONE, "", None)  # what `SafetyLadder._judge` returns when nothing is wrong


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
    """For how long a condition was seen to hold without a break; silence adds nothing."""

    def __init__(self):
        self._since_s = None
        self._last_s = None

    def note(self, is_so, now_s):
        """The condition was checked."""
        if not is_so:
            self._since_s = None
            return
        self._last_s = now_s
        if self._since_s is None:
            self._since_s = now_s

    def lasts(self, limit_s):
        """True if it was seen to hold for limit_s, up to the newest check."""
        return self._since_s is not None and self._last_s - self._since_s >= limit_s


@dataclass(frozen=True)
class Reaction:
    """How fast a level was entered: age of the newest good message, and the part of it beyond the threshold."""

    level: FailsafeLevel
    age_s: float
    beyond_s: float


class SafetyLadder:
    """One vehicle's ladder. Feed it what arrives, call `update` often (at 50 Hz or more)."""

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
        self._losses = (  # inputs that it flies on, and how old they may be
            (Rule.STATE, self.state, limits.state_hold_s, limits.state_land_s),
            (Rule.CONTROLS, self.controls, limits.controls_hold_s, limits.controls_land_s),
        )
        self.verdict = Verdict(_OK, "")
        self.reactions = []  # the newest Reaction of each level that was entered for age, oldest first
        self._navdata_s, self._navdata_repeats = None, False
        self._joystick_s = now_s  # newest message of any joystick; silence counts from the start
        self._joysticks_once = set()  # senders heard at least once: a second message is not expected of them
        self._joysticks_s = {}  # {sender heard more than once: when it was heard last}
        self._airborne = False
        self._battery_pct = None
        self._battery_low = Lasting()
        self.fence = Fence(limits, vehicle_type)
        self._outside, self._leaves = Lasting(), Lasting()
        self._left_s = -math.inf  # when it could not stop in time last
        self._fence_since_s = self._fence_ended_s = -math.inf  # when the fence began and ceased to hold it
        self._fence_again = False  # the fence had held it shortly before, too
        self._look = ALONE
        self._near = Lasting()
        self._apart_since_s, self._apart_reason = None, ""  # since when and why it holds because of other vehicles
        self._lost_since_s = math.inf  # since when it has held without a break because of `LOSSES`
        self._position_m = None
        self._land_since_s = None

    def note_state(self, position_m, velocity_m_s, age_at_arrival_s, now_s, pushes=(), lands=False):
        """The vehicle was seen: its position (3,) [m] and velocity (3,) [m/s], cortex frame.

        pushes: accelerations (3,) [m/s^2] that its tilt makes, or will make.  lands: it lands by itself and cannot be
        held.
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
        """The controller has sent a command. finite: all numbers are.  saturated: at full scale of tilt or thrust."""
        if not finite:
            self._not_finite_s = now_s
        # while another rule holds the vehicle its reference goes on, and full tilt is to be expected
        counts = self.verdict.level == _OK or self.verdict.rule == Rule.CONTROLS
        self._saturated.note(finite and saturated and counts, now_s)

    def note_look(self, look, now_s):
        """Take the newest `separation.Look`: what it has to do about the other vehicles."""
        self._look = look
        # Vehicles that hold because of the same loss resume together: until then it does not count that others hold.
        is_lost = self.verdict.level == _HOLD and self.verdict.rule in LOSSES
        self._near.note(look.holds and not (is_lost and look.joins), now_s)

    def apart(self, now_s):
        """The newest `separation.Look` while it holds because of other vehicles, else None. No vehicle is sent aside
        before it is time to land: first all come to a stop.
        """
        if self.verdict.level != _HOLD or self.verdict.rule != Rule.SEPARATION:
            return None
        stops = now_s - self._apart_since_s < self.limits.separation_land_s
        return self._look._replace(aside=ALONE.aside) if stops else self._look

    def note_navdata(self, battery_pct, now_s, repeats=False):
        """A report of the vehicle arrived; battery_pct: None when it has none.  repeats: it is an old one."""
        self._navdata_repeats = repeats
        if repeats:
            return
        self._navdata_s = now_s
        if battery_pct is not None:
            self._battery_pct = battery_pct
            self._battery_low.note(self.battery_is_low(), now_s)

    def note_joystick(self, now_s, sender=""):
        """A joystick message arrived; sender: which node it is from. Every joystick that sends must keep sending: any
        of them may be the one for the emergency stop.
        """
        self._joystick_s = now_s
        if sender in self._joysticks_once:
            self._joysticks_s[sender] = now_s
        else:
            self._joysticks_once.add(sender)

    def lost_joystick(self, now_s):
        """Name of a joystick that is silent, but was heard within the last minute; None when there is none."""
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
        """A landing was requested: LAND, in every mode. One that lands already keeps its reason."""
        if self.verdict.level != _LAND:
            self._set(_LAND, Rule.REQUEST, "landing was requested", None, now_s)

    def take_over(self):
        """The operator takes over: the level is OK again, and joysticks that are silent are no longer expected."""
        self._joysticks_s.clear()
        self._set(*_FINE, 0.0)

    def update(self, now_s, autonomous, airborne, obeys=False, needs_navdata=True, held=False, trouble=""):
        """Judge the situation. Returns the `Verdict`, which is also kept in `self.verdict`.

        autonomous: the controller flies.  airborne: the vehicle does not stand on the ground.  obeys: its newest
        report is that it lands; counts while that report is fresh.  needs_navdata: False for simulators that report
        nothing.  held: it does not fly itself: states and reports count in manual mode, too, and `obeys` may come from
        its states.  trouble: why our commands do not reach it.
        """
        if airborne and not self._airborne:  # it took off although these were known to be silent
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
            # an input that is always a little too late counts as lost: the reference moves on, through other vehicles
            if age_s > land_s or now_s - self._lost_since_s >= land_s - hold_s > 0.0:
                return _LAND, rule, reason, (age_s, min(age_s, land_s))
            hold = _HOLD, rule, reason, (age_s, hold_s)
        age_s = math.inf if self._navdata_s is None else now_s - self._navdata_s
        if needs_navdata and 0.0 < limits.navdata_timeout_s < age_s:
            silent = self.reports + (" the same for %.1f s" if self._navdata_repeats else " silent for %.1f s")
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
            reason = "soon it could not stop inside the fence, at (%.2f, %.2f, %.2f) m" % tuple(self._position_m)
            if self.verdict.rule == Rule.FENCE and now_s - self._fence_since_s >= limits.fence_land_s:
                return _LAND, Rule.FENCE, reason, None
            hold = (_HOLD, Rule.FENCE, reason, None) if hold is _FINE else hold
        if self._apart_since_s is None and not self._near.lasts(limits.separation_delay_s):
            return hold
        # It keeps holding: its reference has moved on, and it would follow it through the others.
        held_s = 0.0 if self._apart_since_s is None else now_s - self._apart_since_s
        waits = self._look.above and held_s < limits.separation_wait_s
        level = _LAND if held_s >= limits.separation_land_s and not waits else _HOLD
        if level <= hold[0] and hold[1] != Rule.FENCE:  # a HOLD of the fence moves it out of no other's way
            return hold
        return level, Rule.SEPARATION, self._look.reason or self._apart_reason, None
