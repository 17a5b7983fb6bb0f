"""Decisions of the vehicle node for one vehicle: mode, commands, take-off and landing. No ROS.

The node feeds in what arrives and carries out the `Orders` that are returned. Times `now_s` are seconds of a monotonic
clock; `age_s` is the age of a message by its stamp when it arrived.
"""

import math
from collections import defaultdict, deque
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from risc_control import preflight
from risc_control.braking import Braking
from risc_control.failsafe import SafetyLadder
from risc_control.fence import pushed_m_s2
from risc_control.hover import HAND_M_S, HAS_PILOT, Hover
from risc_control.joystick import CENTRED, Button, Joystick, JoystickParams, Sticks
from risc_control.safety import FailsafeLevel, Rule, SafetyLimits
from risc_control.separation import ALONE
from risc_control.vehicles import (
    NO_EVIDENCE,
    ON_GROUND,
    TAKES_COMMANDS,
    FlightState,
    adapter_class,
    greatest_command,
    state_text,
)
from risc_lab.command_history import Channel, CommandHistory
from risc_lab.settings import Count, NotNegative, Positive

# members of enumerations are slow to look up, and these are asked for in every frame
_OK, _LAND, _LANDING = FailsafeLevel.OK, FailsafeLevel.LAND, FlightState.LANDING
# INIT: armed on the ground, but not by us; TAKING_OFF: told to arm
_ARMED_OR_SOON = frozenset((FlightState.INIT, FlightState.TAKING_OFF))
_TILT_MAX_RAD = math.radians(40.0)  # a vehicle that seems to hover at more is seen wrongly, e.g. y and z exchanged
_AVOID_RAD_PER_M_S = 0.15  # while avoiding others: tilt per velocity error; stops it as well as its own position hold,
_AVOID_TILT_MAX_RAD = 0.2  # which ends with the first command to climb
_STOPS_S = 1.0  # longest time for stopping before it lands
_WAITS_S = 0.05  # a state that is only late comes within this time: until then the vehicle is level, not braked
_TILTS_S = 0.1  # time constant of the commanded tilt that the fence uses
_NEARLY_FULL = 0.999
# above this a vehicle never measures the same velocity twice; a model without noise at rest does
_REST_M_S = 1e-3
_SLOWER = 59.0 / 60.0  # of the rate at which the vehicle takes commands, see `VehicleNodeParams.command_rate_hz`


@dataclass(frozen=True)
class VehicleNodeParams(JoystickParams, SafetyLimits):
    """All parameters of the vehicle node, by their names on the parameter server: here its own; those of the joystick
    mapping and of the ladder are inherited.

    Those of `vehicle_types.LEGACY_PARAMETERS` are the vehicle type's (`told_vehicle_type`).
    """

    Simulation: bool = False  # send commands without navdata, for simulators that have none
    # [Hz] 0 or negative: a sixtieth slower than the vehicle takes them (29.5 of 30). At the same rate, commands that
    # come close to the channel's slot would fall now before, now after it for the whole flight (one vehicle in seven),
    # be lost in pairs, and double its tracking error
    command_rate_hz: float = -1.0
    status_rate_hz: Positive = 30.0  # [Hz] how often controller_status is published; a change is published at once
    land_repeat_s: Positive = 0.2  # [s] interval at which the ladder repeats a landing order until the vehicle stands
    takeoff_grace_s: NotNegative = 3.0  # [s] longest time until a take-off is reported: until then "landed" is no proof
    # HOLD, True: the bottom camera sees the floor: an AR.Drone's own velocity is used, and zero commands are sent, on
    # which it holds its place; False (a floor without texture): its velocity is that of the model, and it is kept level
    hold_auto_hover: bool = True
    preflight: bool = True  # refuse a take-off until motion capture and the surroundings are fit for flight
    preflight_controller: bool = False  # and until a controller was heard; False: it may be flown by hand alone
    preflight_markers: Count = 0  # number of its markers that must be seen before a take-off; 0: all of its template
    hold_brakes: bool = True  # HOLD first brakes the vehicle by its model; False: it is level, and coasts
    # HOLD: the model is corrected by its earlier errors, and by the tilt and the height that the vehicle reports;
    # False: the model alone
    hold_corrects: bool = True

    def rate_hz(self, vehicle_type):
        """Rate of the commands to a vehicle of a type [Hz]."""
        return self.command_rate_hz if self.command_rate_hz > 0.0 else _SLOWER * vehicle_type.command_rate_hz


class OwnState(NamedTuple):
    """What the node needs of the vehicle's entry of /cortex_raw; cortex frame (z up)."""

    position_m: tuple
    velocity_m_s: tuple
    phi_rad: float
    theta_rad: float
    psi_rad: float


class SentCommand(NamedTuple):
    """A command to send."""

    sticks: Sticks
    answers: object  # the stamp of the /controls that it answers, as `on_controls` was given it; None = it answers none
    settles_at: np.ndarray  # (4,) what the vehicle settles at: see `command_history.Channel`


class Orders:
    """What the node has to do now, in this order. By default (class attributes) nothing."""

    reset = False
    takeoff = False
    land = False
    disarm = False  # it seems to stand; only for a type that does not fly itself
    command = None  # SentCommand
    level_only = False  # the command must not start the vehicle's own position hold
    status = None  # autonomous?, when its publication is due
    mode = None  # autonomous?, when that has just changed
    simulator_reset = None  # value for the parameter RESET of simulators
    safety = None  # Verdict, when it has just changed
    shut_down = False
    refusals = None  # [reason why it does not take off], empty if it does; None: no take-off was requested
    answer = None  # (done, what happens in a sentence) for the caller of the landing service
    log = ()  # of (level "info" | "warn" | "error", sentence)

    def say(self, level, sentence):
        """Add to the log."""
        self.log = (*self.log, (level, sentence))


class SlotClock:
    """Lets one of many ticks through per slot, so that the average rate is exact whatever the ticks' rate."""

    def __init__(self, rate_hz, begin_s=0.0):
        """begin_s: start of a slot; clocks with equal begin_s let the same tick through."""
        self._period_s = 1.0 / rate_hz
        self.next_s = begin_s  # start of the next unused slot

    def due(self, now_s):
        """True if an unused slot has begun; it then counts as used."""
        if now_s < self.next_s:
            return False
        self.next_s += self._period_s * (1 + (now_s - self.next_s) // self._period_s)
        return True

    def restart(self, now_s):
        """A slot was used out of turn: the next one is half a period away or more."""
        self.next_s += self._period_s * math.ceil((now_s - self.next_s) / self._period_s + 0.5)


class VehiclePilot:
    """Joystick state machine, input mapping and safety ladder of one vehicle."""

    def __init__(
        self, params, vehicle_type, now_s, slot_s=0.0, before=None, nearest=lambda: None, listens_since_s=-math.inf
    ):
        """params: VehicleNodeParams.  slot_s: when a slot for commands begins, see `SlotClock`.

        before: VehiclePilot that this one replaces, or None; a button that is still down is not pressed again.
        nearest: function that returns `preflight.Facts.nearest`.  listens_since_s: see `joystick.ButtonEdges`.
        """
        self._params = params
        rate_hz = params.rate_hz(vehicle_type)
        self._adapter = adapter_class(vehicle_type)(vehicle_type, rate_hz)
        most, unit = greatest_command(vehicle_type), self._adapter.units(vehicle_type)
        full = most.roll_rad / unit.roll_rad, most.pitch_rad / unit.pitch_rad, self._adapter.THRUST_MOST
        self._full = [_NEARLY_FULL * abs(value) for value in full]  # of an entry of /controls
        self._sent = CommandHistory(1)
        self._braking = Braking(vehicle_type, self._sent.vehicles[0], params.hold_brakes)
        self._stopped = False  # it was braked to a stop in this HOLD
        self._risen_s = -math.inf  # when the level rose last
        self._told_of, self._told_s = [0.0, 0.0, 1.0], now_s  # see _told_push
        # roll and pitch [rad] at which it settles by the newest command, and its vertical thrust then [weights]
        self._newest_push = [0.0, 0.0, 1.0]
        # takes off, holds and lands a vehicle that does not fly itself; None: it does
        self._hover = None
        if not self._adapter.FLIES_ITSELF:
            self._hover = Hover(vehicle_type, self._sent.vehicles[0], params.state_hold_s, self._braking)
        # why the controller is not obeyed: it or the vehicle has other full scales
        self.disagreement = before.disagreement if before is not None else ""
        # By sender: a person's joystick beside a virtual operator has buttons, sticks and a clock of its own.
        joysticks = defaultdict(lambda: Joystick(params, listens_since_s))
        self._joysticks = before._joysticks if before is not None else joysticks
        limits = params
        if 0.0 < params.navdata_timeout_s < self._adapter.SILENT_S:
            limits = replace(params, navdata_timeout_s=self._adapter.SILENT_S)
        # a simulator's vehicle is always airborne: there, silence counts from the first joystick message
        self.ladder = SafetyLadder(limits, vehicle_type, math.inf if params.Simulation else now_s)
        self.ladder.reports = self._adapter.REPORTS
        self.autonomous = False
        self.flight_state = None  # the newest FlightState number, None before the first
        self.airborne = params.Simulation  # may be in the air; simulators without navdata always fly
        self._takeoff_s = None  # when a take-off was ordered that the vehicle has not confirmed yet
        self._state = None
        self._state_s = 0.0  # time of the state [s]
        self._felt, self._repeats = None, False  # velocity that it measured last; whether its last reports are the same
        self._unseen = False  # it is not seen in a newer frame of motion capture
        self._told = None  # the newest Verdict that was published
        self._nearest, self._looks_s = nearest, deque(maxlen=preflight.LOOKS)
        self._markers = deque(maxlen=preflight.COUNTS)  # (used, of its template)
        self._simulator_reset = False
        self._ended = False
        self._land_s = self._land_itself_s = -math.inf
        self._slots = SlotClock(rate_hz, slot_s)
        self._status_slots = SlotClock(params.status_rate_hz, slot_s)

    # --- what arrives -------------------------------------------------------------------------------------------

    def on_joy(self, buttons, axes, now_s, age_s=0.0, sender=""):
        """A joystick message. age_s: by its stamp [s]; 0 when it has none. sender: which node it is from.

        A message that was delayed on its way is neither obeyed nor a sign of life: the vehicle may have landed
        meanwhile, and the button pressed to land it would order a take-off. A button that went down in such a message
        and is still down in one that is in time then counts, but only to stop, to land or to end autonomous mode.
        """
        orders = Orders()
        joystick = self._joysticks[sender]
        joy = joystick.update(buttons, axes, now_s, age_s)
        if joy.late:
            text = "a joystick message came %.1f s late and is not obeyed: look at the network, and at the clocks"
            orders.say("warn", text % joy.age_s)
            return orders
        self.ladder.note_joystick(now_s, sender)
        for problem in joystick.problems:
            orders.say("warn", problem)
        down = joy.pressed | joy.belated
        if Button.EMERGENCY in down:
            orders.reset = True
            orders.say("warn", "emergency button: reset sent")
            if self._hover is not None:
                self._hover.stop(now_s)
                self._note_hover(orders)
                self._fly_hover(orders, now_s)
        if self._ended:
            return orders
        if Button.TAKEOFF_LAND in down and not self._params.Simulation:
            self._takeoff_or_land(orders, now_s, may_take_off=Button.TAKEOFF_LAND in joy.pressed)
        reset = Button.TAKEOFF_LAND in joy.held
        if self._params.Simulation and reset != self._simulator_reset:
            self._simulator_reset = orders.simulator_reset = reset
        # a belated press was meant to end autonomous mode, not to cancel a landing that the ladder began meanwhile
        ends_it = self.autonomous and self.ladder.verdict.level < _LAND and Button.TOGGLE_AUTONOMOUS in joy.belated
        if Button.TOGGLE_AUTONOMOUS in joy.pressed or ends_it:
            self._toggle(orders, now_s)
        if Button.SHUT_DOWN in down:
            orders.shut_down = True
            orders.say("info", "shut-down button: landing and ending")
        self._judge(orders, now_s)
        return orders

    def on_status(self, status, now_s):
        """The vehicle reported its `vehicles.Status`."""
        orders = Orders()
        if self.ladder.verdict.level == _LAND and not self.ladder.navdata_is_fresh(now_s):
            self._risen_s = now_s  # it hears us again
        felt = status.velocity_m_s
        if felt is not None:
            moves = self.airborne and math.hypot(*felt) > _REST_M_S
            self._repeats, self._felt = moves and felt == self._felt, felt
        self.ladder.note_navdata(status.battery_pct, now_s, self._repeats)
        if status.velocity_m_s is not None and self._params.hold_auto_hover and not self._repeats:
            self._braking.feel(status.velocity_m_s, now_s)
        corrects, measured_s = self._params.hold_corrects, now_s - self._adapter.type.report_delay_s
        if corrects and status.tilt_rad is not None:
            self._braking.feel_tilt(status.tilt_rad, measured_s)
        if self._hover is None:
            self._note_state(status.state, orders, now_s)
            return orders
        if status.battery_pct is not None:
            self._adapter.tell_battery(status.battery_pct, now_s)
        self._hover.on_status(status, now_s)
        if corrects and status.height_m is not None:
            self._hover.feel_height(status.height_m, status.climb_m_s, measured_s, now_s)
            self._adapter.trim_m_s2 = self._hover.observer.trim_m_s2
        self._note_hover(orders)
        return orders

    def on_wire(self, now_s):
        """The board of the transmitter of a vehicle that does not fly itself reports that it sends our commands."""
        self._hover.on_wire(now_s)

    def on_refusal(self, why, now_s):
        """A vehicle that does not fly itself refuses to arm for the take-off."""
        orders = Orders()
        if self._hover is not None:
            self._hover.refuse(why, now_s, orders)
            self._note_hover(orders)
        return orders

    def _note_state(self, state, orders, now_s):
        """Take the flight state that the vehicle reports."""
        self.flight_state = state
        if not self._params.Simulation:
            if state in ON_GROUND:
                if self._takeoff_s is None or now_s - self._takeoff_s > self._params.takeoff_grace_s:
                    self.airborne, self._takeoff_s = False, None
            elif state not in NO_EVIDENCE:
                self.airborne, self._takeoff_s = True, None
        self._end_on_the_ground(orders)

    def _note_hover(self, orders):
        """Take the flight state that `Hover` works out."""
        before, state = self.flight_state, self._hover.flight_state(self.autonomous)
        self.flight_state, self.airborne = state, self._hover.airborne
        given_back = before == _LANDING and state == FlightState.FLYING  # its own landing was ended
        if state == FlightState.PILOT != before:
            self.ladder.take_over()
            orders.say("warn", "%s: it receives other sticks than we send" % HAS_PILOT)
        if self.autonomous and (given_back or state in (FlightState.OTHER_MODE, FlightState.PILOT)):
            changed = HAS_PILOT if state == FlightState.PILOT else "the mode of its autopilot was changed"
            self._set_mode(False, orders, changed)
        self._end_on_the_ground(orders)

    def _end_on_the_ground(self, orders):
        if self.flight_state in ON_GROUND and self.autonomous and not self.airborne:
            self._set_mode(False, orders, "landed")

    def on_state(self, own, age_s, now_s, look=ALONE):
        """The vehicle was seen (`OwnState`); do not call for entries that are not visible.

        look: `separation.Look` at the other vehicles at that time.
        """
        position_m, velocity_m_s, phi_rad, theta_rad, psi_rad = own
        if not math.isfinite(sum(position_m) + sum(velocity_m_s) + phi_rad + theta_rad + psi_rad):
            return
        self.ladder.note_look(look, now_s)
        *told, up = self._told_push(now_s)
        pushes = [pushed_m_s2(*tilt, psi_rad, up) for tilt in ((phi_rad, theta_rad), told)]
        self.ladder.note_state(position_m, velocity_m_s, age_s, now_s, pushes, self.flight_state == _LANDING)
        self._looks_s.append(now_s)
        self._state, self._unseen = own, False
        self._state_s = now_s - max(age_s, 0.0)
        self._braking.see(own, self._state_s, self._params.hold_corrects and self._obeys)
        if self._hover is not None:
            self._hover.on_state(own, self._state_s)
            self._adapter.trim_m_s2 = self._hover.observer.trim_m_s2

    def on_unseen(self):
        """The vehicle is not seen in a new frame of motion capture."""
        self._unseen = True

    def on_markers(self, used, known):
        """Take the number of markers that its pose is from, and the number in its template."""
        self._markers.append((used, known))

    def on_suspect(self, reason, now_s):
        """The vehicle was seen with a state that cannot be true. reason: what it contradicts, see `plausibility`."""
        if not self.ladder.suspect:
            self._stopped = False
        self.ladder.note_suspect(reason, now_s)

    def _told_push(self, now_s):
        """(roll, pitch [rad], vertical thrust [weights]) by the latest commands, low-pass filtered."""
        part = -math.expm1((self._told_s - now_s) / _TILTS_S)
        told = [old + part * (newest - old) for old, newest in zip(self._told_of, self._newest_push)]
        self._told_of, self._told_s = told, now_s
        return told

    def hear_controls(self, own, age_s, now_s):
        """Take a command as a sign of life of the controller only. Returns False for one that is not finite.

        While full scales differ (`disagreement`) it is not a sign of life: the ladder lands.
        """
        is_finite = math.isfinite(sum(own))
        if is_finite and not self.disagreement:
            self.ladder.controls.note(age_s, now_s)
        # a full yaw rate takes it nowhere, and half a turn lasts seconds; a climb is bounded by the fence
        most_phi, most_theta, most_thrust = self._full
        saturated = abs(own.phi) >= most_phi or abs(own.theta) >= most_theta or abs(own.thrust_n) >= most_thrust
        self.ladder.note_command(is_finite, saturated and self.autonomous, now_s)
        return is_finite

    def on_controls(self, own, stamp, age_s, now_s):
        """A command of the controller (`vehicles.Controls`). stamp: of the state that it answers, of any type."""
        orders = Orders()
        if not self.hear_controls(own, age_s, now_s):
            orders.say("warn", "the controller sent a command that is not finite: ignored")
            return orders
        if not self.autonomous or self._ended or self.disagreement:
            return orders
        self._judge(orders, now_s)
        if not self._holds() and self._takes_commands() and self._slots.due(now_s):
            sent = self._sent.vehicles[0]
            self._send(self._adapter.answer(own, self._state, self._state_s, now_s, sent), stamp, orders, now_s)
        return orders

    def tick(self, now_s):
        """To be called at twice the command rate or more: manual commands, the ladder, the status."""
        orders = Orders()
        if self._ended:
            return orders
        self._centre_silent_sticks(orders, now_s)
        if self._hover is not None:
            self._hover.step(now_s, orders)
            self._note_hover(orders)
        self._judge(orders, now_s)
        if self._status_slots.due(now_s):
            orders.status = self.autonomous
        safe = not self.autonomous or self._holds()
        if self._hover is not None:  # which commands a vehicle that stands or lands, too
            if orders.command is None and (safe or not self._takes_commands()) and self._slots.due(now_s):
                self._fly_hover(orders, now_s)
            lands = self._hover.landing and self._hover.must_land_itself(now_s)
            if lands and now_s - self._land_itself_s >= self._params.land_repeat_s:
                self._land_itself_s, orders.land = now_s, True
        elif orders.command is None and safe and self._takes_commands() and self._slots.due(now_s):
            self._send_safe(orders, now_s)
        return orders

    def on_land_request(self, now_s):
        """A landing is requested without a joystick.

        The ladder lands the vehicle, in manual and in autonomous mode, until it reports that it stands or the operator
        takes over.
        """
        orders = Orders()
        silent = not self.ladder.navdata_is_fresh(now_s)
        if self._ended:
            orders.answer = False, "the vehicle node is ending; it has ordered a landing itself"
        elif self._has_pilot:
            orders.answer = False, "%s, who lands it" % HAS_PILOT
        elif self.airborne:
            self._judge(orders, now_s, land=True)
            unsure = ", but the vehicle is silent" if silent else ""
            orders.answer = not silent, "landing (%s)%s" % (self.ladder.verdict.reason, unsure)
        elif silent or self.flight_state not in ON_GROUND:
            # Nothing says that it stands, and an order to land does no harm to one that does.
            self._order_landing(orders, now_s)
            orders.land = True
            why = "the vehicle is silent" if silent else "it does not say that it stands (%s)" % self._state_text()
            orders.say("warn", "landing was requested: ordered once, but %s" % why)
            orders.answer = False, "landing ordered once, but %s: whether it flies is not known" % why
        else:
            orders.answer = True, "it stands: not airborne (%s)" % self._state_text()
        return orders

    def on_shutdown(self, now_s):
        """One round of the last orders: level and land, whatever its state. After that only a reset is obeyed."""
        self._ended = True
        orders = Orders()
        orders.land = True
        if self._hover is not None:
            stands = self.flight_state == FlightState.LANDED and self.ladder.navdata_is_fresh(now_s)
            orders.land = not (
                stands or self._has_pilot
            )  # it would not obey, and the next take-off would find another mode
            self._hover.land(now_s)
            self._hover.step(now_s, orders)
            self._fly_hover(orders, now_s)
            return orders
        level = CENTRED if self._adapter.HOLDS_POSITION else self._adapter.move(0.0, 0.0, 0.0, self._state)
        self._send(level, None, orders, now_s)
        return orders

    def needs_landing(self, now_s):
        """True while the vehicle may be in the air, is not flown by its pilot, and does not report that it lands."""
        if self._has_pilot:
            return False
        lands = self.flight_state == _LANDING if self._hover is None else self._hover.lands_itself
        return self.airborne and not (lands and self.ladder.navdata_is_fresh(now_s))

    @property
    def holds_alone(self):
        """Whether it holds or lands for another reason than other vehicles."""
        verdict = self.ladder.verdict
        return verdict.level > _OK and verdict.rule != Rule.SEPARATION

    @property
    def stands(self):
        """Whether its newest report is that it stands."""
        return self.flight_state in ON_GROUND and not self.airborne

    @property
    def next_command_s(self):
        """When a command of the controller is needed next [s]; infinite in manual mode and on the ground."""
        return self._slots.next_s if self.autonomous and not self._ended and self._takes_commands() else math.inf

    # --- what is decided ----------------------------------------------------------------------------------------

    @property
    def _obeys(self):
        """True if it is in the air and does only what it is sent. An AR.Drone brakes by itself now and then."""
        return self._hover is not None and self.flight_state in (FlightState.FLYING, FlightState.HOVERING)

    @property
    def _has_pilot(self):
        """True if its pilot flies it by the transmitter."""
        return self._hover is not None and self._hover.has_pilot and self.airborne

    def _holds(self):
        """True if the ladder flies, or if the newest state is suspect, so that the controller's answer is not sent."""
        return self.ladder.verdict.level > _OK or (self.autonomous and self.ladder.suspect != "")

    def _takes_commands(self):
        return self._params.Simulation or self.flight_state in TAKES_COMMANDS

    def _centre_silent_sticks(self, orders, now_s):
        """A deflection holds only as long as the joystick repeats it: it may be unplugged, or its node dead."""
        limit_s = self._params.stick_timeout
        for name, joystick in self._joysticks.items():
            if 0.0 < limit_s < now_s - joystick.heard_s and joystick.sticks != CENTRED:
                joystick.sticks = CENTRED
                orders.say(
                    "warn",
                    "joystick '%s' silent for %g s with its sticks deflected: taken as centred (joy_node must "
                    "repeat: set its autorepeat_rate, e.g. 20)" % (name, limit_s),
                )

    def _sticks(self):
        """Sticks of all joysticks together: the larger deflection of each axis, so that none cancels another's command.

        Without stick_timeout a deflection may be that of a dead joystick: only the newest message counts.
        """
        joysticks = list(self._joysticks.values())
        if self._params.stick_timeout == 0.0:
            joysticks = sorted(joysticks, key=lambda joystick: joystick.heard_s)[-1:]
        return Sticks(*(max(axis, key=abs) for axis in zip(CENTRED, *(joystick.sticks for joystick in joysticks))))

    def _takeoff_or_land(self, orders, now_s, may_take_off):
        """The vehicle's own report decides, not what was pressed before (D-31); an old report decides nothing."""
        fresh = self.ladder.navdata_is_fresh(now_s)
        if self.flight_state != FlightState.LANDED or not fresh:
            if may_take_off and not fresh and not self.airborne:  # probably meant as a take-off
                text = "nothing is heard of the vehicle, it is told to land: is it on? Look at its %s and its driver"
                self._refuse([text % self._adapter.LINK], orders)
            self._order_landing(orders, now_s)
            unsure = "" if fresh else " (the vehicle is silent, so the button means land)"
            if self.flight_state is None:
                unsure = " (nothing was heard of the vehicle)"
            orders.say("info", "landing" + unsure)
            if self.autonomous:
                self._set_mode(False, orders, "landing")
        elif not may_take_off:
            orders.say("info", "no take-off: the button was pressed a while ago; release it and press again")
        else:
            self._refuse(list(self._refusals(now_s)), orders)
            if not orders.refusals:
                self._take_off(orders, now_s)

    def _refuse(self, refusals, orders):
        """A take-off was requested. refusals: reasons against it; empty if there are none."""
        orders.refusals = refusals
        for refusal in refusals:
            orders.say("warn", "take-off refused: %s" % refusal)

    def _take_off(self, orders, now_s):
        orders.takeoff = True
        orders.say("info", "taking off")
        if self._hover is None:
            self.airborne, self._takeoff_s = True, now_s
        else:
            self._hover.take_off(now_s)
            self._note_hover(orders)

    def _refusals(self, now_s):
        """Reasons why it must not take off."""
        joystick = self.ladder.lost_joystick(now_s)
        if joystick is not None:
            text = "the joystick %s has fallen silent, and with it its emergency stop; see to it, or wait a minute to "
            yield text % joystick + "fly without it"
        if self.ladder.battery_is_low():
            text = "the battery is at or below %g %%: charge it, or lower battery_min_pct"
            yield text % self.ladder.limits.battery_min_pct
        if self._params.preflight:
            yield from self._preflight(now_s)
        if self._hover is not None and self._hover.no_take_off(now_s):
            yield self._hover.no_take_off(now_s)

    def _preflight(self, now_s):
        """Reasons of `preflight` why it must not take off; () if none."""
        ladder, own, looks_s = self.ladder, self._state, self._looks_s
        full, markers = len(looks_s) == looks_s.maxlen, max(self._markers, default=None)
        return preflight.refusals(
            preflight.Facts(
                ladder.state.age_s(now_s),
                ladder.state.late_s,
                ladder.limits.state_hold_s,
                ladder.suspect,
                (len(looks_s) - 1) / (now_s - looks_s[0]) if full else 0.0,
                own and tuple(own.position_m),
                own is not None and ladder.fence.is_outside(own.position_m),
                math.acos(math.cos(own.phi_rad) * math.cos(own.theta_rad)) if own else 0.0,
                ladder.controls.age_s(now_s),
                self._params.preflight_controller,
                self.disagreement,
                ladder.limits.controls_hold_s,
                markers and (markers[0], self._params.preflight_markers or markers[1], markers[1]),
                self._nearest(),
                ladder.limits.separation_m,
            )
        )

    def _order_landing(self, orders, now_s):
        """Order a landing; one that does not fly itself is told to land by itself only where we cannot land it."""
        if self._hover is None:
            orders.land = True
            return
        if self.flight_state in _ARMED_OR_SOON and not self.airborne:
            orders.disarm = True
        self._hover.land(now_s)
        self._note_hover(orders)

    def _toggle(self, orders, now_s):
        if self._hover is not None and self.flight_state == FlightState.PILOT:
            if self._hover.take_back():
                orders.say("info", "taken back from its pilot: held where it is, manual mode")
                self._note_hover(orders)
            else:
                orders.say("warn", "%s: have the switch held first, then press again" % HAS_PILOT)
            return
        if self._hover is not None and (self.autonomous or self.ladder.verdict.level > _OK):
            self._hover.hold(now_s)
        if self.autonomous:
            self.ladder.take_over()
            self._set_mode(False, orders, "joystick")
            return
        if self.ladder.verdict.level > _OK:
            self.ladder.take_over()
            orders.say("info", "operator takes over, manual")
            return
        problem = self.disagreement or self._lies() or self.ladder.autonomy_problem(now_s, not self._params.Simulation)
        if not problem and self._hover is not None and self.flight_state == FlightState.OTHER_MODE:
            problem = "its autopilot is in a mode in which it does not take our commands: %s" % self._adapter.MODE_CURE
        if not problem and not self._takes_commands():
            # The reference would leave at once, and no command would follow it.
            problem = "the vehicle does not fly yet (%s): take off and wait until it hovers" % self._state_text()
        if problem:
            orders.say("warn", "autonomous mode refused: %s" % problem)
            return
        self._set_mode(True, orders, "joystick")

    def _lies(self):
        """What is wrong with its measured tilt; "" when nothing is."""
        if self._state is None:
            return ""
        cosine = math.cos(self._state.phi_rad) * math.cos(self._state.theta_rad)
        if cosine >= math.cos(_TILT_MAX_RAD):
            return ""
        tilt_deg = math.degrees(math.acos(cosine))
        return "it is seen tilted by %.0f deg: does z point up in Cortex, is its template right?" % tilt_deg

    def _state_text(self):
        """E.g. "state 6, taking off"."""
        state = self.flight_state
        return "no state yet" if state is None else "state %d, %s" % (state, state_text(state))

    def _set_mode(self, autonomous, orders, why):
        self.autonomous = orders.mode = orders.status = autonomous
        orders.say("info", "%s mode (%s)" % ("autonomous" if autonomous else "manual", why))

    def _judge(self, orders, now_s, land=False):
        """Run the ladder; a new level is acted on at once, not at the next slot. land: a landing is requested."""
        ladder = self.ladder
        before = ladder.verdict
        if land:
            ladder.request_landing(now_s)
        hover, trouble = self._hover, ""
        if hover is None:
            obeys = self.flight_state == _LANDING
        else:
            obeys = hover.obeys_landing(now_s, ladder.navdata_is_fresh(now_s))
            trouble = hover.trouble(now_s) if self.airborne else ""
        needs_navdata = not self._params.Simulation
        verdict = ladder.verdict
        if not self._has_pilot:
            held = hover is not None
            verdict = ladder.update(now_s, self.autonomous, self.airborne, obeys, needs_navdata, held, trouble)
        if verdict is not self._told and verdict != self._told:
            self._told = orders.safety = verdict
            if verdict.level > before.level or verdict.operator:
                orders.say("error" if verdict.operator else "warn", verdict.text)
            elif before.level > _OK:
                orders.say("info", "safety: %s" % verdict.text)
        if verdict.level > before.level:
            self._risen_s = now_s
        if verdict.level > before.level and (self._hover is not None or self._takes_commands()):
            self._stopped = False
            self._slots.restart(now_s)
            self._send_safe(orders, now_s)
        if verdict.level == _LAND and now_s - self._land_s >= self._params.land_repeat_s and not self._brakes(now_s):
            self._land_s = now_s
            self._order_landing(orders, now_s)

    def _brakes(self, now_s):
        """Whether it is to stop before it lands: in its own landing an AR.Drone needs a metre to stop."""
        takes = self._hover is None and self._takes_commands()
        brake = self._braking.command(now_s) if takes and now_s - self._risen_s < _STOPS_S else None
        if brake is None or brake.stopped:
            return False
        self._stopped = False
        return True

    def _send_safe(self, orders, now_s):
        """The command when the controller does not fly: the operator's sticks, or level and hold altitude."""
        if self._hover is not None:
            self._fly_hover(orders, now_s)
            return
        holds, look, waits = self._holds(), self.ladder.apart(now_s), self._waits(now_s)
        itself = self._adapter.HOLDS_POSITION and self._params.hold_auto_hover and not waits
        orders.level_only = holds and not itself
        if look is not None and (look.climb or any(look.aside) or orders.level_only):
            sticks = self._avoid(look, now_s)
        elif not holds:
            sticks = self._adapter.by_hand(self._sticks(), self._state)
        else:
            sticks = self._stop(now_s, itself, waits)
        self._send(sticks, None, orders, now_s)

    def _waits(self, now_s):
        """True if it holds for a missing state that may only be late: no newer frame came without the vehicle. Braking
        at each such moment would make it fall behind its reference, for which others hold.
        """
        verdict = self.ladder.verdict
        is_state = verdict.level == FailsafeLevel.HOLD and verdict.rule == Rule.STATE
        return is_state and not self._unseen and now_s - self._risen_s < _WAITS_S

    def _stop(self, now_s, itself, waits):
        """Sticks of a vehicle that is to hold its place. itself: it can hold its place by itself, but stops slowly.
        waits: it is not braked yet.
        """
        brake = None if itself and self._stopped else self._braking.command(now_s)
        if waits:
            return self._adapter.move(0.0, 0.0, 0.0, self._state)
        if brake is not None and not (itself and brake.stopped):
            return self._adapter.move(-brake.pitch_rad, -brake.roll_rad, 0.0, self._state)
        self._stopped = True
        return CENTRED if itself else self._adapter.move(0.0, 0.0, 0.0, self._state)

    def _fly_hover(self, orders, now_s):
        """Send the command of a vehicle that does not fly itself, while the controller does not fly it; none before it
        has reported its state and was seen: it may be in the air.
        """
        if self._hover.reported is None or self._state is None or self._hover.must_be_silent(now_s):
            return
        holds, look, psi_rad = self.autonomous or self.ladder.verdict.level > _OK, self.ladder.apart(now_s), 0.0
        if self._state is not None:
            psi_rad = self._state.psi_rad
        x, y, z, turn_rad_s = 0.0, 0.0, 0.0, 0.0
        if look is not None:
            x, y, z = (self.ladder.limits.separation_speed_m_s * part for part in (*look.aside, look.climb))
        elif not holds:
            sticks, kind = self._sticks(), self._adapter.type
            forward, left, cosine, sine = sticks.forward, sticks.left, math.cos(psi_rad), math.sin(psi_rad)
            x, y = HAND_M_S * (forward * cosine + left * sine), HAND_M_S * (left * cosine - forward * sine)
            z, turn_rad_s = kind.climb_max_m_s * sticks.up, -kind.yaw_rate_max_rad_s * sticks.turn_left
        command = self._hover.command(now_s, (x, y, z), turn_rad_s, waits=self._waits(now_s))
        self._send(self._adapter.fly(command), None, orders, now_s, self._hover.own)

    def _avoid(self, look, now_s):
        """Sticks that stop the vehicle where it is, except where a `separation.Look` sends it."""
        speed_m_s, psi_rad = self.ladder.limits.separation_speed_m_s, self._state.psi_rad
        brake = None if any(look.aside) else self._braking.command(now_s)
        if brake is not None:
            return self._adapter.move(-brake.pitch_rad, -brake.roll_rad, look.climb * speed_m_s, self._state)
        x, y = (speed_m_s * part - velocity for part, velocity in zip(look.aside, self._state.velocity_m_s))
        forward_m_s = x * math.cos(psi_rad) - y * math.sin(psi_rad)
        left_m_s = x * math.sin(psi_rad) + y * math.cos(psi_rad)
        forward_rad, left_rad = (
            max(-_AVOID_TILT_MAX_RAD, min(_AVOID_TILT_MAX_RAD, _AVOID_RAD_PER_M_S * wanted_m_s))
            for wanted_m_s in (forward_m_s, left_m_s)
        )
        return self._adapter.move(forward_rad, left_rad, look.climb * speed_m_s, self._state)

    def _send(self, sticks, answers, orders, now_s, own=None):
        """own: OwnState that the sticks are for, if not the newest one."""
        sticks = self._adapter.sendable(sticks, now_s)
        orders.command = SentCommand(sticks, answers, self._adapter.settles_at(sticks, own or self._state))
        self._sent.append(0, now_s, orders.command.settles_at)
        settles_at = orders.command.settles_at
        up = 1.0 if self._hover is None else 1.0 + settles_at[Channel.CLIMB]
        self._newest_push = [settles_at[Channel.PHI], settles_at[Channel.THETA], up]
