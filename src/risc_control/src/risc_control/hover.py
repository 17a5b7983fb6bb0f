"""Take-off, position hold and landing for a vehicle that does none of them by itself. No ROS.

An AR.Drone takes off, hovers and lands when it is told to. A type whose adapter says that it does not
(`vehicles.Adapter.FLIES_ITSELF`), as an IRIS+ in STABILIZE, is flown through all that by its vehicle node:

    STANDING -- take_off -> STARTING -- armed -> CLIMBING -- up -> HOLDING -- land -> LANDING -- disarmed -> STANDING
                                                                          stop: from anywhere in the air to STOPPED

HOLDING is the thesis' "simple PID controller for position hold" by motion capture (5.2.2) about a place that moves with
limited acceleration: where an operator's sticks send it, or out of another vehicle's way. It begins with the motion
that the vehicle has. While a controller flies, nothing here commands.

While the vehicle follows its pilot's transmitter (`FlightState.PILOT`) nothing is ordered; what is sent would bring it
to a stop. It stays the pilot's until an operator takes it back (`take_back`).

The throttle that hovers is known badly (battery, load, propellers). `ClimbObserver` learns the error in the air,
whoever flies, and the adapter adds it to every command: it is the integral of this hold, and no change of hands
changes it.

Without states it goes on by the model of its climb (`_blind`): HOLDING at the height at which it was seen last, LANDING
down to the floor. The height and climb rate that it says to have correct that (`feel_height`): its barometer drifts, so
what counts is how they differ from what they were while it was seen.
"""

import math
from collections import deque
from enum import Enum, auto

from risc_control.flatness import Acceleration, flat_inputs, limit_tilt, thrust_at_tilt
from risc_control.vehicles import Command, FlightState, climb_loops
from risc_lab.command_history import ROWS, Channel, last_by
from risc_lab.frames import GRAVITY_M_S2

HEIGHT_M = 1.0  # of the hold after a take-off, cortex frame,
LEAST_CLIMB_M = 0.5  # and at least so far above the place where it stood
CLIMB_M_S, DESCENT_M_S = 0.5, 0.4
SLOW_DESCENT_M_S, SLOW_BELOW_M = 0.2, 0.3  # the last part of a landing
HAND_M_S = 0.6  # of the place, at full stick
LEAST_HEIGHT_M = 0.3  # an operator's sticks bring it no lower: landing is a button
ARMED_WITHIN_S, UP_WITHIN_S = 6.0, 10.0
WIRE_S = 0.5  # nothing heard of the wire that commands go through: nothing is known of it
STANDS_S = 0.3  # it does not sink although it should, for so long: it stands, or
STUCK_S = 1.5  # where no floor is, its thrust is not ours
DISARM_AGAIN_S = 0.5
HAS_PILOT = "its pilot flies it by the transmitter (trainer switch)"
BLIND_BELOW_M = 0.3  # a landing without states is reckoned to the floor, and so far on

_SPIN_UP_S, _SPIN_UP_FROM, _SPIN_UP_TO = 1.0, 0.2, 0.9  # thrust while it still stands, of the weight
_LIFTED_M, _FLOOR_M = 0.08, 0.2  # higher than it stood: it flies; lower: what stops it is the floor
_IN_AIR_M = 0.3  # an armed vehicle of which nothing else is known flies when it is higher
_STILL_M_S, _SINKS_M_S = 0.08, 0.1
_NEARLY_M, _THERE_M = 0.1, 0.03  # below the height of a take-off it is up, when the place that is held is as near

# The hold: acceleration by error, its rate and its integral.
_POSITION_1_S2, _VELOCITY_1_S, _INTEGRAL_1_S3, _INTEGRAL_M_S2 = 3.0, 2.8, 0.7, 0.8
_HEIGHT_1_S2, _CLIMB_1_S = 5.0, 3.5
_YAW_1_S, _YAW_RATE_RAD_S = 1.0, 0.5
_TILT_RAD, _UP_M_S2 = math.radians(20.0), 3.0
PLACE_M_S2, _PLACE_UP_M_S2 = 1.0, 0.8  # of the place that is held; on the former the fence counts
_STOP_M_S2 = 2.5  # when it slows down: others may be in its way, or the floor;
STOPS_UP_M_S2 = 1.4  # of that the fence counts on so much, up and down
_FAR_M = 0.5  # larger errors count as this one
_LEASH_M = 0.3  # the place is no farther above or below the vehicle on the way up or down
_BLIND_1_S, _BLIND_M_S2 = 2.0, 1.0  # of the climb rate that is reckoned, without states;
_BLIND_HEIGHT_1_S, _BLIND_M_S = 1.0, 0.3  # and of the height
_FEELS_S, _FELT_S = 0.5, 3.0  # of reports while it is seen: from so many on they count; time constant of their zeros
_FELT_GAP_S = 0.25  # between reports at most
_LATE_S = 0.3  # they may be late by so much more than they are as a rule:
_NOISE_M, _NOISE_M_S = 0.15, 0.1  # they count beyond all that was reckoned for then, and beyond their noise,
_FELT_M, _FELT_M_S = 0.8, 1.0  # and are not believed where they are so far from it
_FELT_1_S = 1.0  # of the height that is reckoned, by its error

_NEW_S = 0.2  # without a command of the hold: it begins anew
_MAX_GAP_S = 0.2  # between states: the observer begins anew
_OBSERVER_RAD_S, _TRIM_M_S2, _STEP_S = 2.0, 3.0, 0.02
_BLIND_S = 1.0  # a longer time without anything is not reckoned through


class Phase(Enum):
    STANDING = auto()  # motors off, or at rest
    STARTING = auto()  # a take-off was ordered; not armed yet
    CLIMBING = auto()
    HOLDING = auto()  # or a controller flies
    LANDING = auto()
    STOPPED = auto()  # motors off in the air


_IN_AIR = frozenset((Phase.CLIMBING, Phase.HOLDING, Phase.LANDING, Phase.STOPPED))


class ClimbObserver:
    """Climb rate by the model of the climb loop, and how far that is wrong: a slow observer of a constant error.

    trim_m_s2: what is to be added to each command, as an upward acceleration. Commands in `sent` are without it.
    """

    def __init__(self, vehicle_type, sent):
        """sent: HISTORY of what the vehicle was sent."""
        self.climb_m_s = self.trim_m_s2 = 0.0
        self._loop = climb_loops([vehicle_type])[0]
        self._delay_s = vehicle_type.command_delay_s + 0.5 / vehicle_type.command_rate_hz  # waits for the next slot
        self._sent, self._time_s = sent, -math.inf
        last_by(sent, 0.0, sent.newest)  # loads what is compiled

    def measure(self, climb_m_s, time_s, learns):
        """The vehicle climbed at this rate then. learns: nothing but the commands moves it."""
        step_s = time_s - self._time_s
        if not learns or not 0.0 <= step_s <= _MAX_GAP_S:
            self.climb_m_s, self._time_s = climb_m_s, time_s
            return
        self.advance(time_s)
        self.correct(climb_m_s - self.climb_m_s, step_s)

    def correct(self, error_m_s, step_s):
        """It climbs by so much faster than by the commands. step_s: since the last time."""
        self.climb_m_s += min(1.0, 2.0 * _OBSERVER_RAD_S * step_s) * error_m_s
        self.trim_m_s2 = _within(self.trim_m_s2 - _OBSERVER_RAD_S**2 * step_s * error_m_s, _TRIM_M_S2)

    def advance(self, until_s):
        """Go on to a time by the commands alone."""
        if until_s - self._time_s > _BLIND_S:
            self._time_s = until_s - _BLIND_S
        while self._time_s < until_s:
            step_s = min(_STEP_S, until_s - self._time_s)
            k = last_by(self._sent, self._time_s + 0.5 * step_s - self._delay_s, self._sent.newest)
            command = self._sent.commands[k % ROWS, Channel.CLIMB]
            up_m_s2 = self._loop.gain * command - self._loop.damping_1_s * self.climb_m_s
            self.climb_m_s += step_s * up_m_s2
            self._time_s += step_s


class Hover:
    """One vehicle. Times: seconds of a clock that never steps."""

    def __init__(self, vehicle_type, sent, hold_s, braking):
        """sent: HISTORY of what it was sent.  hold_s: an older state is not flown on.  braking: its Braking."""
        self.phase = Phase.STANDING
        self.reported = None  # FlightState by the vehicle's own word, None before the first
        self.has_pilot = False  # who flies it by its transmitter
        self._trims = deque(maxlen=12)  # of the last seconds: newer ones may be learnt from a pilot's throttle
        self.observer = ClimbObserver(vehicle_type, sent)
        self._mass_kg, self._hold_s = vehicle_type.mass_kg, hold_s
        self._own, self._own_s = None, -math.inf  # newest that was seen, or what the model says of it since
        self._braking = braking
        self._floor_m = None  # height at which it was seen to stand
        self._wire_s = -math.inf  # when its wire for commands worked last
        self._since_s = self._disarm_s = -math.inf  # begin of the phase; when disarming was ordered
        self._still_s = None  # since when it does not sink although it should
        self._sinks_s = -math.inf  # when it sank last
        self._stands = False  # it has landed, as far as can be seen
        self._reckoned_m = self._blind_m = 0.0  # height above the floor, without states; that is held
        self._reckoned = deque(maxlen=32)  # of late: (time, height, climb rate)
        self._felt, self._felt_s = None, -math.inf  # newest (height, climb rate) that it said to have, when it had them
        self._felt_zero, self._zeros_s = (0.0, 0.0), 0.0  # by which these were too large while it was seen; of how long
        self._place_m, self._place_m_s, self._psi_rad = [0.0] * 3, [0.0] * 3, 0.0  # that is held, and its motion
        self._integral_m_s2 = [0.0, 0.0]
        self._commanded_s = self._held_s = -math.inf  # when a command was asked for last; one with states
        flat_inputs(limit_tilt(Acceleration(0.0, 0.0, GRAVITY_M_S2), _TILT_RAD)[0], 0.0, 0.0, 1.0)  # loads what is
        thrust_at_tilt(GRAVITY_M_S2, 0.0, 0.0, 1.0)  # compiled

    # --- what arrives -------------------------------------------------------------------------------------------

    def on_status(self, status, now_s):
        """The vehicle reported its `vehicles.Status`; of states it knows LANDED (motors off), FLYING (takes our
        commands), LANDING (by itself) and others, in which it does not take them.
        """
        state = status.state
        if state == FlightState.UNKNOWN:
            return
        self.has_pilot = state == FlightState.PILOT
        if state == FlightState.FLYING:
            if self.reported == FlightState.PILOT and self.phase is not Phase.LANDING:
                state = FlightState.PILOT  # until it is taken back
            else:
                self._trims.append(self.observer.trim_m_s2)
        elif self.has_pilot and self.reported != FlightState.PILOT:
            self.observer.trim_m_s2 = self._trims[0] if self._trims else 0.0
            if self.phase in (Phase.CLIMBING, Phase.LANDING):
                self._enter(Phase.HOLDING, now_s)
        if state != self.reported:  # it may have been anywhere meanwhile
            self._held_s = -math.inf
        self.reported = state
        if state == FlightState.LANDED:
            if self.phase in _IN_AIR:
                self._enter(Phase.STANDING, now_s)
            if self._is_seen(now_s):
                self._floor_m = self._own.position_m[2]
        elif self.phase is Phase.STARTING and state == FlightState.FLYING:
            self._enter(Phase.CLIMBING, now_s)
        elif self.phase is Phase.CLIMBING and state == FlightState.LANDING:
            self._enter(Phase.LANDING, now_s)
        else:
            self._meet(now_s)

    def _meet(self, now_s):
        """Take over a vehicle that is seen to fly already: this node is new, or was given it."""
        armed = self.reported not in (None, FlightState.LANDED)
        if self.phase is Phase.STANDING and armed and self._flies(now_s):
            self._enter(Phase.LANDING if self.reported == FlightState.LANDING else Phase.HOLDING, now_s)

    def on_wire(self, now_s):
        """What sends our commands to it reports that it does."""
        self._wire_s = now_s

    def on_state(self, own, measured_s):
        """The vehicle was seen (`vehicle_pilot.OwnState`)."""
        self._own, self._own_s = own, measured_s
        self._reckoned_m = self._blind_m = self._height_m()
        self._reckoned.clear()
        climb_m_s = own.velocity_m_s[2]
        free = self.phase in _IN_AIR and self.reported == FlightState.FLYING and self._height_m() > _LIFTED_M
        self.observer.measure(climb_m_s, measured_s, free and not self._stands)
        if climb_m_s < -_SINKS_M_S:
            self._sinks_s = measured_s
        self._meet(measured_s)

    def feel_height(self, height_m, climb_m_s, measured_s, now_s):
        """It says that it had this height, by a zero of its own, and climb rate."""
        if (height_m, climb_m_s) == self._felt or not math.isfinite(height_m + climb_m_s):
            return
        step_s = measured_s - self._felt_s
        self._felt, self._felt_s = (height_m, climb_m_s), measured_s
        if not 0.0 < step_s < _FELT_GAP_S or self._own is None:
            return
        if self._is_seen(now_s):
            height_m -= self._height_m() + self._own.velocity_m_s[2] * (measured_s - self._own_s)
            self._zeros_s = min(_FELT_S, self._zeros_s + step_s)
            zeros, share = (height_m, climb_m_s - self._own.velocity_m_s[2]), step_s / self._zeros_s
            self._felt_zero = tuple(old + share * (new - old) for old, new in zip(self._felt_zero, zeros))
            return
        begins_s = measured_s - _LATE_S
        lately = [then for then in self._reckoned if then[0] >= begins_s]
        if self._zeros_s >= _FEELS_S and lately and self._reckoned[0][0] <= begins_s:
            _, heights_m, climbs_m_s = zip(*lately)
            error_m = _beyond(height_m - self._felt_zero[0], heights_m, _NOISE_M)
            if abs(error_m) < _FELT_M:
                self._reckoned_m += _FELT_1_S * step_s * error_m
            error_m_s = _beyond(climb_m_s - self._felt_zero[1], climbs_m_s, _NOISE_M_S)
            if abs(error_m_s) < _FELT_M_S and self.reported == FlightState.FLYING:
                self.observer.correct(error_m_s, step_s)

    # --- orders -------------------------------------------------------------------------------------------------

    def no_take_off(self, now_s):
        """Why it must not take off, in a few words; "" when it may."""
        if not self._is_seen(now_s):
            return "it is not seen by motion capture, which holds it in the air"
        return self.trouble(now_s)

    def take_off(self, now_s):
        """Its driver was told to arm it."""
        self._trims.clear()
        self.observer.trim_m_s2 = 0.0  # another battery, load or propellers; or learnt while something held it
        self._enter(Phase.STARTING, now_s)

    def refuse(self, why, now_s, orders):
        """It does not arm itself."""
        if self.phase is Phase.STARTING:
            orders.say("warn", "take-off refused: %s" % why)
            orders.disarm = True  # what told it to may be under way still
            self._enter(Phase.STANDING, now_s)

    def take_back(self):
        """An operator wants it back from its pilot. Returns whether it takes our commands again."""
        if not self.has_pilot:
            self.reported, self._held_s = FlightState.FLYING, -math.inf
        return not self.has_pilot

    def land(self, now_s):
        """Come down; one that is not armed yet does not take off."""
        if self.phase in (Phase.CLIMBING, Phase.HOLDING):
            if self.reported == FlightState.PILOT:
                self.take_back()
            self._enter(Phase.LANDING, now_s)
        elif self.phase is Phase.STARTING:
            self._enter(Phase.STANDING, now_s)

    def hold(self, now_s):
        """No landing any more, but one that the vehicle makes by itself."""
        if self.phase is Phase.LANDING and not self._stands and self.reported == FlightState.FLYING:
            self._enter(Phase.HOLDING, now_s)

    def stop(self, now_s):
        """Motors off."""
        self._enter(Phase.STOPPED if self.phase in _IN_AIR else Phase.STANDING, now_s)

    # --- what is so ---------------------------------------------------------------------------------------------

    @property
    def airborne(self):
        """It may be in the air."""
        return self.phase in _IN_AIR

    @property
    def own(self):
        """`vehicle_pilot.OwnState` for the command that was just asked for; None before it was seen."""
        return self._own

    @property
    def landing(self):
        """It was told to come down."""
        return self.phase is Phase.LANDING

    def flight_state(self, autonomous):
        """FlightState for everybody; None before the first report. autonomous: a controller flies where it may."""
        state, phase = self.reported, self.phase
        if state is None or (self.has_pilot and self.airborne):
            return state
        if phase is Phase.HOLDING:
            if state != FlightState.FLYING:
                return state
            return FlightState.FLYING if autonomous else FlightState.HOVERING
        if phase is Phase.STANDING:
            if state in (FlightState.LANDED, FlightState.LANDING):
                return state
            return FlightState.UNKNOWN if self._own is None else FlightState.INIT  # unseen, it may be anywhere
        return _STATES[phase]

    def trouble(self, now_s):
        """What is wrong with the wire that commands go through, in a few words; "" when nothing is."""
        silent_s = now_s - self._wire_s
        if silent_s <= WIRE_S:
            return ""
        since = "nothing was heard of it" if math.isinf(silent_s) else "%.1f s ago it did" % silent_s
        return "the board of its transmitter does not say that it sends our commands (%s)" % since

    def must_be_silent(self, now_s):
        """It lands unseen, and by reckoning it is down: who knows better is its own failsafe, which lands or disarms
        it as soon as nothing is sent. Or its pilot has it, and it is not seen: it is nobody's who gives it back.
        """
        if self.has_pilot and not self._is_seen(now_s):
            return True
        return self.phase is Phase.LANDING and not self._is_seen(now_s) and self._reckoned_m < -BLIND_BELOW_M

    @property
    def lands_itself(self):
        """By its own report it lands, or stands."""
        return self.reported in (FlightState.LANDED, FlightState.LANDING)

    def obeys_landing(self, now_s, is_heard):
        """It lands by its own report, or it is seen to sink, or to stand; in the beginning it need not yet.

        is_heard: its newest report still tells what it does.
        """
        sinks = now_s - max(self._sinks_s, self._since_s) < STUCK_S
        is_seen = self._is_seen(now_s) and (self._stands or sinks)
        return self.phase is Phase.LANDING and (is_seen or (is_heard and self.lands_itself))

    def must_land_itself(self, now_s):
        """We cannot land it: it is not seen, it does not take our commands, or they do not bring it down. What its
        pilot flies is the pilot's to land.
        """
        if self.has_pilot:
            return False
        stuck = self._still_s is not None and now_s - self._still_s > STUCK_S and not self._stands
        elsewhere = self.reported == FlightState.OTHER_MODE
        return stuck or elsewhere or not self._is_seen(now_s) or self.trouble(now_s) != ""

    # --- what follows -------------------------------------------------------------------------------------------

    def step(self, now_s, orders):
        """What time brings. orders: vehicle_pilot.Orders."""
        lasts_s = now_s - self._since_s
        if self.phase is Phase.STARTING and self.has_pilot:
            self.refuse(HAS_PILOT, now_s, orders)
        elif self.phase is Phase.STARTING and lasts_s > ARMED_WITHIN_S:
            self.refuse("it is not armed within %g s" % ARMED_WITHIN_S, now_s, orders)
        elif self.phase is Phase.CLIMBING:
            is_m, place_m = self._own.position_m[2], self._place_m[2]
            if self._is_seen(now_s) and min(is_m + _NEARLY_M, place_m + _THERE_M) > self._top_m():
                self._enter(Phase.HOLDING, now_s)
            elif lasts_s > UP_WITHIN_S:
                orders.say("warn", "take-off given up: it is not up within %g s" % UP_WITHIN_S)
                self._enter(Phase.LANDING, now_s)
        elif self.phase is Phase.LANDING:
            self._look_for_the_floor(now_s)
            if self._stands and self._is_seen(now_s) and now_s - self._disarm_s >= DISARM_AGAIN_S:
                self._disarm_s, orders.disarm = now_s, True

    def command(self, now_s, velocity_m_s=(0.0, 0.0, 0.0), yaw_rate_rad_s=0.0, waits=False):
        """`Command` of now; None: the throttle at its lowest.

        velocity_m_s: of the place that is held, cortex frame.  yaw_rate_rad_s: of its heading, + clockwise.
        waits: the next state may only be late: it is level, and not braked.
        """
        if self.phase not in _IN_AIR or self.phase is Phase.STOPPED or self._stands:
            return None
        step_s, self._commanded_s = now_s - self._commanded_s, now_s
        climb_m_s = self._climb_m_s(velocity_m_s[2])
        if not self._is_seen(now_s):
            return self._blind(now_s, step_s, climb_m_s if self.phase is Phase.LANDING else 0.0, waits)
        if now_s - self._held_s > _NEW_S or self.has_pilot:
            self._begin()
        self._held_s = now_s
        spun = (now_s - self._since_s) / _SPIN_UP_S
        if self.phase is Phase.CLIMBING and spun < 1.0:
            self._begin()
            weights = _SPIN_UP_FROM + spun * (_SPIN_UP_TO - _SPIN_UP_FROM)
            return Command(0.0, 0.0, 0.0, weights * self._mass_kg * GRAVITY_M_S2)
        return self._held(min(step_s, _NEW_S), (*velocity_m_s[:2], climb_m_s), yaw_rate_rad_s)

    def _climb_m_s(self, wanted_m_s):
        """At which the place that is held is to climb."""
        if self.phase is Phase.LANDING:
            return -SLOW_DESCENT_M_S if self._reckoned_m < SLOW_BELOW_M else -DESCENT_M_S
        if self.phase is Phase.CLIMBING:
            return min(CLIMB_M_S, _stops_m_s(self._top_m() - self._place_m[2]))
        return max(wanted_m_s, -_stops_m_s(self._place_m[2] - LEAST_HEIGHT_M))

    def _blind(self, now_s, step_s, climb_m_s, waits):
        """`Command` without states: to a stop, and this climb rate, by the model."""
        self.observer.advance(now_s)
        has_m_s = self.observer.climb_m_s
        self._reckoned_m += min(step_s, _NEW_S) * has_m_s
        self._reckoned.append((now_s, self._reckoned_m, has_m_s))
        if self.phase is Phase.HOLDING:
            climb_m_s += _within(_BLIND_HEIGHT_1_S * (self._blind_m - self._reckoned_m), _BLIND_M_S)
        up_m_s2 = _within(_BLIND_1_S * (climb_m_s - has_m_s), _BLIND_M_S2)
        brake = self._braking.command(now_s)
        if brake is None or waits:
            return Command(0.0, 0.0, 0.0, self._mass_kg * (GRAVITY_M_S2 + up_m_s2))
        self._own = brake.then
        thrust_n = thrust_at_tilt(GRAVITY_M_S2 + up_m_s2, self._own.phi_rad, self._own.theta_rad, self._mass_kg)
        return Command(brake.roll_rad, brake.pitch_rad, 0.0, thrust_n)

    def _begin(self):
        """Hold from the place and the motion that it has."""
        own = self._own
        self._place_m, self._place_m_s, self._psi_rad = list(own.position_m), list(own.velocity_m_s), own.psi_rad
        self._integral_m_s2 = [0.0, 0.0]

    def _held(self, step_s, velocity_m_s, yaw_rate_rad_s):
        """`Command` that holds the place, which comes to move at this velocity."""
        own, wanted_m_s2 = self._own, [0.0] * 3
        for axis, most_m_s2 in enumerate((PLACE_M_S2, PLACE_M_S2, _PLACE_UP_M_S2)):
            if abs(velocity_m_s[axis]) < abs(self._place_m_s[axis]):
                most_m_s2 = _STOP_M_S2
            change_m_s = _within(velocity_m_s[axis] - self._place_m_s[axis], most_m_s2 * step_s)
            self._place_m_s[axis] += change_m_s
            self._place_m[axis] += step_s * self._place_m_s[axis]
            wanted_m_s2[axis] = change_m_s / step_s if step_s > 0.0 else 0.0
        if self.phase is not Phase.HOLDING:  # the floor may stop it
            self._place_m[2] = own.position_m[2] + _within(self._place_m[2] - own.position_m[2], _LEASH_M)
        errors_m = [place - is_m for place, is_m in zip(self._place_m, own.position_m)]
        errors_m_s = [place - is_m_s for place, is_m_s in zip(self._place_m_s, own.velocity_m_s)]
        for axis in (0, 1):
            grown = self._integral_m_s2[axis] + step_s * _INTEGRAL_1_S3 * errors_m[axis]
            self._integral_m_s2[axis] = _within(grown, _INTEGRAL_M_S2)
            wanted_m_s2[axis] += _POSITION_1_S2 * _within(errors_m[axis], _FAR_M) + _VELOCITY_1_S * errors_m_s[axis]
            wanted_m_s2[axis] += self._integral_m_s2[axis]
        wanted_m_s2[2] += _HEIGHT_1_S2 * _within(errors_m[2], _FAR_M) + _CLIMB_1_S * errors_m_s[2]
        up_m_s2 = _within(wanted_m_s2[2], _UP_M_S2)
        self._psi_rad += step_s * yaw_rate_rad_s
        error_rad = math.remainder(self._psi_rad - own.psi_rad, math.tau)
        turn_rad_s = yaw_rate_rad_s + _within(_YAW_1_S * error_rad, _YAW_RATE_RAD_S)
        # cortex x, y, z are north, west, up
        f = limit_tilt(Acceleration(wanted_m_s2[0], -wanted_m_s2[1], GRAVITY_M_S2 + up_m_s2), _TILT_RAD)[0]
        roll_rad, pitch_rad, turn_rad_s, _ = flat_inputs(f, own.psi_rad, turn_rad_s, self._mass_kg)
        return Command(roll_rad, pitch_rad, turn_rad_s, thrust_at_tilt(f.up, own.phi_rad, own.theta_rad, self._mass_kg))

    # --- what is seen of it -------------------------------------------------------------------------------------

    def _is_seen(self, now_s):
        return now_s - self._own_s <= self._hold_s

    def _height_m(self):
        """Above the place where it stood, as far as that is known."""
        return self._own.position_m[2] - (self._floor_m or 0.0)

    def _top_m(self):
        """Height of a take-off, cortex frame."""
        return max(HEIGHT_M, (self._floor_m or 0.0) + LEAST_CLIMB_M)

    def _flies(self, now_s):
        return self._is_seen(now_s) and min(self._own.position_m[2], self._height_m()) > _IN_AIR_M

    def _look_for_the_floor(self, now_s):
        """While it lands: does it stand?"""
        if not self._is_seen(now_s):
            self._still_s = None
            return
        lags = self._place_m[2] < self._own.position_m[2] - 0.7 * _LEASH_M and self.reported == FlightState.FLYING
        if not lags or abs(self._own.velocity_m_s[2]) > _STILL_M_S:
            self._still_s = None
        elif self._still_s is None:
            self._still_s = now_s
        elif now_s - self._still_s > STANDS_S and self._height_m() < _FLOOR_M:
            self._stands = True

    def _enter(self, phase, now_s):
        self.phase, self._since_s, self._blind_m = phase, now_s, self._reckoned_m
        self._still_s, self._stands = None, False


_STATES = {  # FlightState of each Phase but those that depend on more
    Phase.STARTING: FlightState.TAKING_OFF,
    Phase.CLIMBING: FlightState.TAKING_OFF,
    Phase.LANDING: FlightState.LANDING,
    Phase.STOPPED: FlightState.UNKNOWN,
}


def _stops_m_s(way_m):
    """Speed at which the place that is held comes to a stop within this way, up or down."""
    return math.sqrt(_PLACE_UP_M_S2 * max(0.0, way_m))  # at half of its acceleration


def _beyond(value, known, noise):
    """By how much it is above or below all that is known, and the noise."""
    return value - min(max(value, min(known) - noise), max(known) + noise)


def _within(value, most):
    return min(max(value, -most), most)
