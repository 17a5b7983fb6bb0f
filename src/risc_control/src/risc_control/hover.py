"""Take-off, position hold and landing for a vehicle that does none of them by itself. No ROS.

An AR.Drone takes off, hovers and lands when it is told to. A type that does not (`vehicles.Adapter.FLIES_ITSELF` is
False), such as an IRIS+ in STABILIZE, is flown through these phases by its vehicle node:

    STANDING -- take_off -> STARTING -- armed -> CLIMBING -- up -> HOLDING -- land -> LANDING -- disarmed -> STANDING
                                                                          stop: from anywhere in the air to STOPPED

Commands come from `PlaceHold`; when HOLDING, its place moves by an operator's sticks, or out of another vehicle's way.
While a controller flies, nothing here commands.

While the vehicle follows its pilot's transmitter (`FlightState.PILOT`) nothing is ordered; what is sent would bring it
to a stop. It stays the pilot's until an operator takes it back (`take_back`).

The hover throttle is known badly (battery, load, propellers). `ClimbObserver` learns the error in the air, in
manual and in autonomous mode, and the adapter adds it to every command: it is the integral action of this hold, and is
kept when control passes to a controller and back.

Without states it continues by the model of its climb (`BlindHeight`): HOLDING at the height at which it was seen last,
LANDING down to the floor.
"""

import math
from collections import deque
from enum import Enum, auto

from risc_control.blind_height import BlindHeight
from risc_control.climb_observer import ClimbObserver
from risc_control.flatness import thrust_at_tilt
from risc_control.place_hold import LEASH_M, PlaceHold, stops_m_s
from risc_control.vehicles import Command, FlightState
from risc_lab.frames import GRAVITY_M_S2

HEIGHT_M = 1.0  # of the hold after a take-off, cortex frame,
LEAST_CLIMB_M = 0.5  # but at least this far above where it stood
CLIMB_M_S, DESCENT_M_S = 0.5, 0.4
SLOW_DESCENT_M_S, SLOW_BELOW_M = 0.2, 0.3  # the last part of a landing
HAND_M_S = 0.6  # speed of the place at full stick
LEAST_HEIGHT_M = 0.3  # an operator's sticks bring it no lower: landing is a button
ARMED_WITHIN_S, UP_WITHIN_S = 6.0, 10.0
WIRE_S = 0.5  # no report of the transmitter's board for this long: it may not send our commands
STANDS_S = 0.3  # it does not sink although it should, for this long: it stands, or
STUCK_S = 1.5  # for this long away from the floor: its thrust is not ours
DISARM_AGAIN_S = 0.5
HAS_PILOT = "its pilot flies it by the transmitter (trainer switch)"
BLIND_BELOW_M = 0.3  # a landing without states is continued by the model to this far below the floor

_SPIN_UP_S, _SPIN_UP_FROM, _SPIN_UP_TO = 1.0, 0.2, 0.9  # thrust while it still stands, of the weight
_LIFTED_M, _FLOOR_M = 0.08, 0.2  # this far above where it stood it flies; lower than this the floor may stop it
_IN_AIR_M = 0.3  # an armed vehicle is taken to fly when it is higher, if nothing else is known
_STILL_M_S, _SINKS_M_S = 0.08, 0.1
_NEARLY_M, _THERE_M = 0.1, 0.03  # a take-off is done when vehicle and place are this near below its height

_NEW_S = 0.2  # after this time without a command the hold starts again


class Phase(Enum):
    STANDING = auto()  # motors off, or at rest
    STARTING = auto()  # a take-off was ordered; not armed yet
    CLIMBING = auto()
    HOLDING = auto()  # or a controller flies
    LANDING = auto()
    STOPPED = auto()  # motors off in the air


_IN_AIR = frozenset((Phase.CLIMBING, Phase.HOLDING, Phase.LANDING, Phase.STOPPED))


class Hover:
    """One vehicle. Times: seconds of a monotonic clock."""

    def __init__(self, vehicle_type, sent, hold_s, braking):
        """sent: HISTORY of what it was sent.  hold_s: an older state is not used.  braking: its Braking."""
        self.phase = Phase.STANDING
        self.reported = None  # FlightState that the vehicle reports, None before the first
        self.has_pilot = False  # its pilot flies it by the transmitter
        self._trims = deque(maxlen=12)  # of the last seconds: newer ones may be learnt from a pilot's throttle
        self.observer = ClimbObserver(vehicle_type, sent)
        self._mass_kg, self._hold_s = vehicle_type.mass_kg, hold_s
        self._own, self._own_s = None, -math.inf  # newest state that was seen, or the model's since
        self._braking = braking
        self._floor_m = None  # height at which it was seen to stand
        self._wire_s = -math.inf  # when the transmitter's board last reported that it sends our commands
        self._since_s = self._disarm_s = -math.inf  # start of the phase; when disarming was ordered
        self._still_s = None  # since when it does not sink although it should
        self._sinks_s = -math.inf  # when it sank last
        self._stands = False  # it is seen to have landed
        self._blind, self._hold = BlindHeight(self.observer), PlaceHold(vehicle_type.mass_kg)
        self._commanded_s = self._held_s = -math.inf  # when a command was asked for last; the same, while it was seen

    # --- what arrives -------------------------------------------------------------------------------------------

    def on_status(self, status, now_s):
        """The vehicle reported its `vehicles.Status`. States: LANDED (motors off), FLYING (takes our commands), LANDING
        (by itself) and others, in which it does not take them.
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
        """Take over a vehicle that is seen to fly already: this node has just started, or was handed it."""
        armed = self.reported not in (None, FlightState.LANDED)
        if self.phase is Phase.STANDING and armed and self._flies(now_s):
            self._enter(Phase.LANDING if self.reported == FlightState.LANDING else Phase.HOLDING, now_s)

    def on_wire(self, now_s):
        """The board of its transmitter reports that it sends our commands."""
        self._wire_s = now_s

    def on_state(self, own, measured_s):
        """The vehicle was seen (`vehicle_pilot.OwnState`)."""
        self._own, self._own_s = own, measured_s
        self._blind.see(self._height_m())
        climb_m_s = own.velocity_m_s[2]
        free = self.phase in _IN_AIR and self.reported == FlightState.FLYING and self._height_m() > _LIFTED_M
        self.observer.measure(climb_m_s, measured_s, free and not self._stands)
        if climb_m_s < -_SINKS_M_S:
            self._sinks_s = measured_s
        self._meet(measured_s)

    def feel_height(self, height_m, climb_m_s, measured_s, now_s):
        """It reports its height, above a zero of its own, and climb rate, both at measured_s."""
        seen = None
        if self._is_seen(now_s):
            rises_m_s = self._own.velocity_m_s[2]
            seen = self._height_m() + rises_m_s * (measured_s - self._own_s), rises_m_s
        self._blind.feel(height_m, climb_m_s, measured_s, seen, self.reported == FlightState.FLYING)

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
        """It refuses to arm."""
        if self.phase is Phase.STARTING:
            orders.say("warn", "take-off refused: %s" % why)
            orders.disarm = True  # the order to arm may still be under way
            self._enter(Phase.STANDING, now_s)

    def take_back(self):
        """An operator wants it back from its pilot. Returns whether it takes our commands again."""
        if not self.has_pilot:
            self.reported, self._held_s = FlightState.FLYING, -math.inf
        return not self.has_pilot

    def land(self, now_s):
        """Land; one that is not armed yet does not take off."""
        if self.phase in (Phase.CLIMBING, Phase.HOLDING):
            if self.reported == FlightState.PILOT:
                self.take_back()
            self._enter(Phase.LANDING, now_s)
        elif self.phase is Phase.STARTING:
            self._enter(Phase.STANDING, now_s)

    def hold(self, now_s):
        """Cancel a landing, unless the vehicle lands by itself."""
        if self.phase is Phase.LANDING and not self._stands and self.reported == FlightState.FLYING:
            self._enter(Phase.HOLDING, now_s)

    def stop(self, now_s):
        """Motors off."""
        self._enter(Phase.STOPPED if self.phase in _IN_AIR else Phase.STANDING, now_s)

    # --- what is so ---------------------------------------------------------------------------------------------

    @property
    def airborne(self):
        """True if it may be in the air."""
        return self.phase in _IN_AIR

    @property
    def own(self):
        """`vehicle_pilot.OwnState` that the last command is for; None before it was seen."""
        return self._own

    @property
    def landing(self):
        """True if it was told to land."""
        return self.phase is Phase.LANDING

    def flight_state(self, autonomous):
        """FlightState to report to others; None before the first report. autonomous: a controller may fly it."""
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
        """What is wrong with the board that transmits our commands, in a few words; "" when nothing is."""
        silent_s = now_s - self._wire_s
        if silent_s <= WIRE_S:
            return ""
        since = "nothing was heard of it" if math.isinf(silent_s) else "%.1f s ago it did" % silent_s
        return "the board of its transmitter does not say that it sends our commands (%s)" % since

    def must_be_silent(self, now_s):
        """True if it lands unseen and is down by the model: its own failsafe knows better, and lands or disarms it as
        soon as nothing is sent. Also if its pilot flies it and it is not seen: given back, it could not be flown.
        """
        if self.has_pilot and not self._is_seen(now_s):
            return True
        return self.phase is Phase.LANDING and not self._is_seen(now_s) and self._blind.height_m < -BLIND_BELOW_M

    @property
    def lands_itself(self):
        """True if it reports that it lands or stands."""
        return self.reported in (FlightState.LANDED, FlightState.LANDING)

    def obeys_landing(self, now_s, is_heard):
        """True if it lands by its own report, or is seen to sink or to stand; at the beginning it need not sink yet.

        is_heard: its newest report is still fresh.
        """
        sinks = now_s - max(self._sinks_s, self._since_s) < STUCK_S
        is_seen = self._is_seen(now_s) and (self._stands or sinks)
        return self.phase is Phase.LANDING and (is_seen or (is_heard and self.lands_itself))

    def must_land_itself(self, now_s):
        """True if we cannot land it: it is not seen, it does not take our commands, or they do not bring it down. If
        its pilot flies it, the pilot lands it.
        """
        if self.has_pilot:
            return False
        stuck = self._still_s is not None and now_s - self._still_s > STUCK_S and not self._stands
        elsewhere = self.reported == FlightState.OTHER_MODE
        return stuck or elsewhere or not self._is_seen(now_s) or self.trouble(now_s) != ""

    # --- what follows -------------------------------------------------------------------------------------------

    def step(self, now_s, orders):
        """Advance the phases by time. orders: vehicle_pilot.Orders, to add to."""
        lasts_s = now_s - self._since_s
        if self.phase is Phase.STARTING and self.has_pilot:
            self.refuse(HAS_PILOT, now_s, orders)
        elif self.phase is Phase.STARTING and lasts_s > ARMED_WITHIN_S:
            self.refuse("it is not armed within %g s" % ARMED_WITHIN_S, now_s, orders)
        elif self.phase is Phase.CLIMBING:
            is_m, place_m = self._own.position_m[2], self._hold.height_m
            if self._is_seen(now_s) and min(is_m + _NEARLY_M, place_m + _THERE_M) > self._top_m():
                self._enter(Phase.HOLDING, now_s)
            elif lasts_s > UP_WITHIN_S:
                orders.say("warn", "take-off aborted: it has not reached its height within %g s" % UP_WITHIN_S)
                self._enter(Phase.LANDING, now_s)
        elif self.phase is Phase.LANDING:
            self._look_for_the_floor(now_s)
            if self._stands and self._is_seen(now_s) and now_s - self._disarm_s >= DISARM_AGAIN_S:
                self._disarm_s, orders.disarm = now_s, True

    def command(self, now_s, velocity_m_s=(0.0, 0.0, 0.0), yaw_rate_rad_s=0.0, waits=False):
        """`Command` to send now; None: the throttle at its lowest.

        velocity_m_s: of the place that is held, cortex frame.  yaw_rate_rad_s: of its heading, + clockwise.
        waits: the next state may only be late: it is level, and not braked.
        """
        if self.phase not in _IN_AIR or self.phase is Phase.STOPPED or self._stands:
            return None
        step_s, self._commanded_s = now_s - self._commanded_s, now_s
        climb_m_s = self._climb_m_s(velocity_m_s[2])
        if not self._is_seen(now_s):
            return self._unseen(now_s, min(step_s, _NEW_S), climb_m_s, waits)
        if now_s - self._held_s > _NEW_S or self.has_pilot:
            self._hold.begin(self._own)
        self._held_s = now_s
        spun = (now_s - self._since_s) / _SPIN_UP_S
        if self.phase is Phase.CLIMBING and spun < 1.0:
            self._hold.begin(self._own)
            weights = _SPIN_UP_FROM + spun * (_SPIN_UP_TO - _SPIN_UP_FROM)
            return Command(0.0, 0.0, 0.0, weights * self._mass_kg * GRAVITY_M_S2)
        leash_m = math.inf if self.phase is Phase.HOLDING else LEASH_M
        velocity_m_s = *velocity_m_s[:2], climb_m_s
        return self._hold.command(self._own, min(step_s, _NEW_S), velocity_m_s, yaw_rate_rad_s, leash_m)

    def _climb_m_s(self, wanted_m_s):
        """Climb rate of the place that is held."""
        if self.phase is Phase.LANDING:
            return -SLOW_DESCENT_M_S if self._blind.height_m < SLOW_BELOW_M else -DESCENT_M_S
        if self.phase is Phase.CLIMBING:
            return min(CLIMB_M_S, stops_m_s(self._top_m() - self._hold.height_m))
        return max(wanted_m_s, -stops_m_s(self._hold.height_m - LEAST_HEIGHT_M))

    def _unseen(self, now_s, step_s, climb_m_s, waits):
        """`Command` without states, by the model: to a stop, at this climb rate or holding the height."""
        rates = {Phase.HOLDING: None, Phase.LANDING: climb_m_s}
        up_m_s2 = self._blind.advance(now_s, step_s, rates.get(self.phase, 0.0))
        brake = self._braking.command(now_s)
        if brake is None or waits:
            return Command(0.0, 0.0, 0.0, self._mass_kg * (GRAVITY_M_S2 + up_m_s2))
        self._own = brake.then
        thrust_n = thrust_at_tilt(GRAVITY_M_S2 + up_m_s2, self._own.phi_rad, self._own.theta_rad, self._mass_kg)
        return Command(brake.roll_rad, brake.pitch_rad, 0.0, thrust_n)

    # --- what is seen of it -------------------------------------------------------------------------------------

    def _is_seen(self, now_s):
        return now_s - self._own_s <= self._hold_s

    def _height_m(self):
        """Height above where it stood, or above z = 0 if that is not known."""
        return self._own.position_m[2] - (self._floor_m or 0.0)

    def _top_m(self):
        """Height of a take-off, cortex frame."""
        return max(HEIGHT_M, (self._floor_m or 0.0) + LEAST_CLIMB_M)

    def _flies(self, now_s):
        return self._is_seen(now_s) and min(self._own.position_m[2], self._height_m()) > _IN_AIR_M

    def _look_for_the_floor(self, now_s):
        """While it lands: find out whether it stands."""
        if not self._is_seen(now_s):
            self._still_s = None
            return
        lags = self._hold.height_m < self._own.position_m[2] - 0.7 * LEASH_M and self.reported == FlightState.FLYING
        if not lags or abs(self._own.velocity_m_s[2]) > _STILL_M_S:
            self._still_s = None
        elif self._still_s is None:
            self._still_s = now_s
        elif now_s - self._still_s > STANDS_S and self._height_m() < _FLOOR_M:
            self._stands = True

    def _enter(self, phase, now_s):
        self.phase, self._since_s = phase, now_s
        self._blind.hold_here()
        self._still_s, self._stands = None, False


_STATES = {  # FlightState of each Phase but those that depend on more
    Phase.STARTING: FlightState.TAKING_OFF,
    Phase.CLIMBING: FlightState.TAKING_OFF,
    Phase.LANDING: FlightState.LANDING,
    Phase.STOPPED: FlightState.UNKNOWN,
}
