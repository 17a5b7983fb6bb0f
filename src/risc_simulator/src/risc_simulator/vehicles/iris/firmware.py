"""The autopilot of an IRIS+: ArduCopter's modes, arming, failsafes and landing, as far as an indoor flight meets them.

Channels are times of the RC link in microseconds, in ArduCopter's order: roll, pitch, throttle, yaw. The loops that it
commands run in every step (on_board.py). Its own cycle runs some fifty times a second.

Its MAVLink side (mavlink.py) uses, beside Firmware: `vehicle`, `armed`, `mode`, `set_mode`, `arm`, `disarm` (each
returns why not, or ""), `arming_trouble`, `channels_us`, `override`, `radio_failsafe`, `texts`. Requests take effect
with the next step.
"""

import math
from collections import deque
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab.vehicle_types import own_numbers
from risc_lab.radio_sticks import RadioSticks
from risc_simulator.models.battery import GROUND_LOAD, Battery
from risc_simulator.models.flight import Firmware, FlightAction, FlightPhase
from risc_simulator.vehicles.iris.parameters import Parameters
from risc_simulator.vehicles.iris.sensors import CAPACITY_AH, GROUND_PRESSURE_PA, sensor_errors

CHANNELS = 8
ROLL, PITCH, THROTTLE, YAW = range(4)
CENTRE_US, HALF_RANGE_US = 1500, 500  # of a channel, with the parameters RCn_MIN ... at the start

LOOK_PERIOD_S = 0.025  # of its cycle without frames; otherwise it runs with each frame
GESTURE_S = 2.0  # throttle lowest and yaw at its end for this long: right arms, left disarms
GESTURE_YAW = 0.89  # of full yaw
LANDED_DISARM_S = 1.0  # on the ground in LAND
RADIO_LOST_S = 0.5  # without a frame,
OVERRIDE_LOST_S = 1.0  # or, while overrides are in force, with neither frame nor override
LOW_THROTTLE_FRAMES = 3  # below FS_THR_VALUE: the transmitter says that it has lost its own signal
RELEASE_US, LEAVE_US = 0, 65535  # of an override

STOPPING_TIME_S = 0.3  # height is held where the climb loop can stop
HARD_LANDING_M_S = 1.5  # hitting the floor faster than this breaks something
LOW_BATTERY_PCT = 15.0  # warns, and does not arm
CRITICAL_BATTERY_PCT = 8.0  # lands by itself
SAG_PCT_S = 10.0  # fastest change of the charge that determines the thrust of the rotors
_SILENT_US = (0,) * CHANNELS


class Mode(IntEnum):
    """Flight modes of ArduCopter, by its numbers, that need neither a position nor an acrobatic pilot."""

    STABILIZE = 0  # angles by the sticks, thrust by the throttle
    ALT_HOLD = 2  # angles by the sticks, climb rate by the throttle
    LAND = 9


class Severity(IntEnum):
    """Severity of a text, as in MAVLink."""

    CRITICAL = 2
    WARNING = 4
    INFO = 6


class Calibration(NamedTuple):
    """Calibration of a channel, from its parameters RCn_MIN, MAX, TRIM, DZ, REVERSED [us]."""

    trim_us: float
    dead_us: float
    below_us: float  # travel beyond the dead zone, on either side
    above_us: float
    sign: int

    @classmethod
    def of(cls, parameters, channel):
        """Calibration of a channel, numbered from 0."""
        name = "RC%d_" % (1 + channel)
        least, most, trim, dead = (parameters[name + what] for what in ("MIN", "MAX", "TRIM", "DZ"))
        sign = -1 if parameters[name + "REVERSED"] else 1
        return cls(trim, dead, max(1.0, trim - least - dead), max(1.0, most - trim - dead), sign)

    def deflection(self, us):
        """Deflection in [-1, 1]."""
        offset_us = us - self.trim_us
        if offset_us > self.dead_us:
            return self.sign * min(1.0, (offset_us - self.dead_us) / self.above_us)
        if offset_us < -self.dead_us:
            return self.sign * max(-1.0, (offset_us + self.dead_us) / self.below_us)
        return 0.0


class RcFrame(NamedTuple):
    """Channels that the receiver has decoded: an action, see world.Vehicle.schedule."""

    channels_us: tuple  # whole microseconds, 4 to CHANNELS of them


class IrisFirmware(Firmware):
    """One autopilot.

    command: (roll_rad, pitch_rad, yaw_rate_rad_s, thrust_n or climb_m_s).
    vehicle, sensors: world.Vehicle that it is in, and its IrisSensors; set by its host.
    parameters: ArduCopter's, by name; they take effect as soon as they are set.
    texts: (Severity, text) for ground stations, oldest first; its MAVLink side takes them out.
    telemetry_delay_s: from sending to reception.
    """

    vehicle = sensors = None

    def __init__(self, vehicle_type, rng, perturbed, rest_height_m):
        super().__init__(vehicle_type, rng, perturbed, rest_height_m)
        self.texts = deque(maxlen=100)
        self.parameters = _parameters_of(vehicle_type)
        self._take_parameters()
        errors = sensor_errors()
        delay = float(np.clip(rng.standard_normal(), -2.0, 2.0)) if perturbed else 0.0
        self.telemetry_delay_s = max(0.0, vehicle_type.report_delay_s + errors.delay_spread_s * delay)
        self._sticks = own_numbers(vehicle_type, RadioSticks)
        self._battery = Battery(vehicle_type.battery_life_s)
        self._switch_on(0.0)

    def _switch_on(self, time_s):
        self.mode = Mode.STABILIZE
        self.radio_failsafe = True  # until something is received
        self.wake_s = self._time_s = time_s
        self._battery_said = None
        self._felt_pct, self._felt_s = None, time_s
        self._received_us, self._received_s = (), -math.inf
        self._by_hand = False  # the trainer switch is off: what the board sends is not received
        self._overrides = {}  # channel -> (us, since when)
        self._override_s = -math.inf
        self._low_frames = 0
        self._gesture, self._gesture_s = 0, time_s  # yaw to this side since then
        self._grounded_s = time_s  # when the time on the ground began after which it disarms
        self._hold_m = None  # height that is held; None: none

    def configure(self, record):
        """Keep the record (1,), on_board.FIELDS: `tell` writes it."""
        self._record = record
        nominal_n = record["nominal_mass_kg"].item() * GRAVITY_M_S2
        self._nominal_n = nominal_n
        self._balance_n = record["mass_kg"].item() * GRAVITY_M_S2 / record["thrust_scale"].item()

    def tell(self):
        record = self._record
        record["climbs"] = self._climbs
        record["holds_height"] = self._hold_m is not None
        if self._hold_m is not None:
            record["height_m"] = self._hold_m
        return self.command

    # ------------------------------------------------------------------ what others see of it

    @property
    def armed(self):
        """Whether the rotors turn."""
        return self.motors_on

    @property
    def phase(self):
        """FlightPhase; armed on the ground it is still LANDED."""
        if not self.lifted:
            return FlightPhase.LANDED
        if not self.motors_on:
            return FlightPhase.EMERGENCY
        return FlightPhase.LANDING if self.mode is Mode.LAND else FlightPhase.FLYING

    @property
    def channels_us(self):
        """(CHANNELS,) channels in effect: the receiver's, with overrides; 0 for a channel that is not sent.

        () before anything was received.
        """
        if not self._received_us and not self._overrides:
            return ()
        channels = list(self._received_us) + [0] * (CHANNELS - len(self._received_us))
        for channel, (us, _) in self._overrides.items():
            channels[channel] = us
        return tuple(channels)

    def hover_throttle(self, battery_pct):
        """Throttle in [-1, 1] at which this vehicle, with its true plant, hovers with this charge."""
        return self._sticks.hovers_at(battery_pct) + self._balance_n / self._nominal_n - 1.0

    @property
    def drain_pct_s(self):
        """Discharge rate of its battery [%/s]."""
        return self._battery.drain_pct_s

    def battery_pct(self, time_s):
        return self._battery.pct(time_s)

    def set_battery_pct(self, pct, time_s):
        self._battery.set_pct(pct, time_s)
        self._felt_pct = None

    def weaken_battery(self, pct, time_s):
        """The rotors lose thrust gradually, by SAG_PCT_S: the battery sags, it is not exchanged for another one."""
        felt_pct = self._felt_pct
        self.set_battery_pct(pct, time_s)
        self._felt_pct = felt_pct

    @property
    def _channels(self):
        return self.channels_us or _SILENT_US

    # ------------------------------------------------------------------ what it is asked

    def set_mode(self, number):
        """Change the mode. Returns why not, or ""."""
        if number not in tuple(Mode):
            return self._refuse("Mode change to %d failed: requires position" % number)
        if number != self.mode:
            self._enter(Mode(number))
        return ""

    def arm(self, by_force=False):
        """Start the rotors. by_force: unchecked. Returns why not, or ""."""
        if not self.armed:
            trouble = "" if by_force else self.arming_trouble()
            if trouble:
                return self._refuse(trouble)
            self._start()
        return ""

    def arming_trouble(self):
        """Why it would not arm now, or ""."""
        if self.mode is Mode.LAND:
            return "Arm: Land mode not armable"
        if not self.parameters["ARMING_CHECK"]:
            return ""
        if self.radio_failsafe:
            return "PreArm: Radio failsafe on"
        if self._channels[THROTTLE] > self._idle_us:
            return "Arm: Throttle too high"
        if self.battery_pct(self._time_s) <= LOW_BATTERY_PCT:
            return "PreArm: Battery below minimum arming capacity"
        return "Arm: not landed" if self.lifted else ""

    def disarm(self, by_force=False):
        """Stop the rotors; by_force: in the air, too. Returns why not, or ""."""
        if self.armed:
            if self.lifted and not by_force:
                return self._refuse("Disarm: not landed")
            self._stop()
        return ""

    def override(self, channels_us, now_s):
        """Apply RC_CHANNELS_OVERRIDE, of a station that may override, at lab time now_s.

        channels_us: microseconds, RELEASE_US or LEAVE_US for each channel.
        """
        if self.parameters["RC_OVERRIDE_TIME"] == 0.0:
            return
        for channel, us in enumerate(channels_us[:CHANNELS]):
            if us == RELEASE_US:
                self._overrides.pop(channel, None)
            elif us != LEAVE_US:
                self._overrides[channel] = us, now_s
                self._override_s = now_s
        self._hurry()

    def _refuse(self, reason):
        self.texts.append((Severity.CRITICAL, reason))
        return reason

    def _hurry(self):
        self.wake_s = -math.inf

    # ------------------------------------------------------------------ what the world calls

    def apply(self, action, time_s, vertical_motion):
        if isinstance(action, RcFrame):
            if self._by_hand:
                return
            self._received_us, self._received_s = action.channels_us, time_s
            is_low = action.channels_us[THROTTLE] < self._lost_us
            self._low_frames = min(self._low_frames + 1, LOW_THROTTLE_FRAMES) if is_low else 0
            self.wake(time_s, vertical_motion)
        elif action is FlightAction.LAND:
            self.set_mode(Mode.LAND)
        elif action is FlightAction.CUT_MOTORS:
            self.disarm(by_force=True)
        elif action is FlightAction.TAKE_OFF:  # it does no more than that by itself
            self.set_mode(Mode.STABILIZE)
            self.arm()
        elif not isinstance(action, FlightAction):
            raise TypeError("expected an RcFrame or a FlightAction, got %r" % (action,))

    def wake(self, time_s, vertical_motion):
        """Run one cycle: check parameters, radio and gestures, and command the loops."""
        self._time_s, self.wake_s = time_s, time_s + LOOK_PERIOD_S
        if self._parameter_changes != self.parameters.changes:
            self._take_parameters()
        if self._overrides:
            self._end_overrides()
        channels = self._channels
        self._watch_radio()
        if not self.radio_failsafe:
            self._watch_gesture(channels)
        if self.armed and not self.lifted:
            self._watch_ground(channels)
        self._command(channels, vertical_motion)

    def touch_down(self, time_s, impact_m_s):
        if not self.motors_on:
            self.lifted = False
            return ""
        if impact_m_s > HARD_LANDING_M_S:
            self._stop()
            self.lifted = False
            return "hit the floor at %.1f m/s" % impact_m_s
        if not self._lifts():
            self.lifted, self._grounded_s = False, time_s
        return ""

    def crash(self, time_s):
        self._stop()

    def fly_at(self, time_s, height_m):
        self._time_s = time_s
        self.mode, self.lifted, self.radio_failsafe = Mode.STABILIZE, True, False
        self._start()
        throttle_us = CENTRE_US + round(HALF_RANGE_US * self.hover_throttle(self.battery_pct(time_s)))
        self._received_us, self._received_s = (CENTRE_US, CENTRE_US, throttle_us, CENTRE_US), time_s
        self._low_frames = 0
        self._command(self.channels_us, None)
        self._record["rotor_thrust_n"] = self._balance_n

    def fly_by_hand(self, sticks, time_s):
        self._by_hand = sticks is not None
        if self._by_hand:
            *turns, lift = sticks
            roll, pitch, yaw = (CENTRE_US + round(HALF_RANGE_US * stick) for stick in turns)
            throttle = self.hover_throttle(self.battery_pct(time_s)) + lift - 1.0
            throttle_us = CENTRE_US + round(HALF_RANGE_US * min(1.0, max(-1.0, throttle)))
            self._received_us, self._received_s = (roll, pitch, throttle_us, yaw), time_s
            self._low_frames = 0

    def power_cycle(self, time_s):
        """Parameters stay as they were set."""
        self.motors_on, self.lifted, self.command = False, False, (0.0, 0.0, 0.0, 0.0)
        self._battery.set_load(GROUND_LOAD, time_s)
        self.set_battery_pct(100.0, time_s)
        self.texts.clear()
        self._switch_on(time_s)

    def check_battery(self, time_s):
        pct = self.battery_pct(time_s)
        level = "critical" if pct <= CRITICAL_BATTERY_PCT else "low" if pct <= LOW_BATTERY_PCT else None
        if level != self._battery_said:
            self._battery_said = level
            if level is not None:
                self.texts.append((Severity.WARNING, "Battery failsafe: %s" % level))
        if level == "critical" and self.armed and self.parameters["BATT_FS_CRT_ACT"]:
            self._end_flight()

    # ------------------------------------------------------------------ what it watches

    def _end_overrides(self):
        life_s = self._override_s_most
        if life_s >= 0.0:
            fresh = {channel: item for channel, item in self._overrides.items() if self._time_s - item[1] <= life_s}
            self._overrides = fresh

    def _watch_radio(self):
        silent_s = self._time_s - max(self._received_s, self._override_s)
        lost = silent_s > (OVERRIDE_LOST_S if self._overrides else RADIO_LOST_S)
        enough = 1 if self.radio_failsafe else LOW_THROTTLE_FRAMES  # one is enough to stay in it
        is_low = THROTTLE not in self._overrides and self._low_frames >= enough
        lost |= is_low and self._radio_counts
        if lost == self.radio_failsafe:
            return
        self.radio_failsafe = lost
        if not lost:
            self.texts.append((Severity.INFO, "Radio Failsafe Cleared"))
        else:
            self.texts.append((Severity.WARNING, "Radio Failsafe"))
            if self.armed and self._radio_counts:
                self._end_flight()

    def _end_flight(self):
        """A failsafe: land, or stop on the ground."""
        if not self.lifted:
            self._stop()
        elif self.mode is not Mode.LAND:
            self._enter(Mode.LAND)

    def _watch_gesture(self, channels):
        side = 0
        if channels[THROTTLE] <= self._idle_us:
            yaw = self._calibrations[YAW].deflection(channels[YAW])
            side = (yaw > GESTURE_YAW) - (yaw < -GESTURE_YAW)
        if side != self._gesture:
            self._gesture, self._gesture_s = side, self._time_s
        if side and self._time_s - self._gesture_s >= GESTURE_S:
            self._gesture_s = math.inf  # once
            allowed = self.parameters["ARMING_RUDDER"]
            if side > 0 and allowed >= 1:
                self.arm()
            elif side < 0 and allowed >= 2 and not self.lifted:
                self.disarm()

    def _watch_ground(self, channels):
        if self.mode is Mode.LAND:
            if self._time_s - self._grounded_s >= LANDED_DISARM_S:
                self._stop()
        elif channels[THROTTLE] > self._idle_us:
            self._grounded_s = self._time_s
        elif 0.0 < self.parameters["DISARM_DELAY"] <= self._time_s - self._grounded_s:
            self._stop()

    # ------------------------------------------------------------------ what it does

    def _take_parameters(self):
        """Keep the parameters that every cycle needs."""
        values = self.parameters
        self._parameter_changes = values.changes
        self._calibrations = {channel: Calibration.of(values, channel) for channel in (ROLL, PITCH, YAW)}
        least_us, most_us = values["RC3_MIN"], values["RC3_MAX"]
        self._middle_us, self._half_us = 0.5 * (least_us + most_us), 0.5 * (most_us - least_us)
        self._idle_us, self._lost_us = least_us + values["RC3_DZ"], values["FS_THR_VALUE"]
        self._tilt_rad = math.radians(0.01 * values["ANGLE_MAX"])
        self._yaw_rate_rad_s = math.radians(values["PILOT_Y_RATE"])
        self._climb_m_s = 0.01 * values["PILOT_SPEED_UP"]
        self._descent_m_s = 0.01 * (values["PILOT_SPEED_DN"] or values["PILOT_SPEED_UP"])
        self._landing_m_s = 0.01 * values["LAND_SPEED"]
        self._climb_dead = values["THR_DZ"] / 500.0
        self._radio_counts = values["FS_THR_ENABLE"] != 0
        self._override_s_most = values["RC_OVERRIDE_TIME"]

    @property
    def _climbs(self):
        return self.mode is not Mode.STABILIZE

    def _enter(self, mode):
        self.mode, self._hold_m, self._grounded_s = mode, None, self._time_s
        self._hurry()

    def _start(self):
        self.motors_on, self._grounded_s = True, self._time_s
        self._battery.set_load(1.0, self._time_s)
        self.texts.append((Severity.INFO, "Arming motors"))
        self._hurry()

    def _stop(self):
        if self.motors_on:
            self.motors_on, self._hold_m = False, None
            self._battery.set_load(GROUND_LOAD, self._time_s)
            self.texts.append((Severity.INFO, "Disarming motors"))
            self._hurry()

    def _command(self, channels, vertical_motion):
        roll, pitch, yaw = 0.0, 0.0, 0.0
        if not self.radio_failsafe or not self._radio_counts:
            sticks = self._calibrations
            roll, pitch = sticks[ROLL].deflection(channels[ROLL]), sticks[PITCH].deflection(channels[PITCH])
            yaw = sticks[YAW].deflection(channels[YAW])
        throttle = min(1.0, max(-1.0, (channels[THROTTLE] - self._middle_us) / self._half_us))
        if self.mode is Mode.STABILIZE:
            idles = channels[THROTTLE] <= self._idle_us
            hover = self._sticks.hovers_at(self._felt_charge_pct())
            up = 0.0 if idles else self._nominal_n * (1.0 + throttle - hover)
        elif self.mode is Mode.LAND:
            up = -self._landing_m_s
        else:
            up = (self._climb_m_s if throttle > 0.0 else self._descent_m_s) * _beyond(throttle, self._climb_dead)
            self._choose_height(up, vertical_motion)
        self.command = (self._tilt_rad * roll, self._tilt_rad * pitch, self._yaw_rate_rad_s * yaw, up)
        if self.armed and not self.lifted and self._lifts():
            self.lifted = True
            self._record["rotor_thrust_n"] = self._balance_n  # it had to pass this to lift off

    def _felt_charge_pct(self):
        """The charge that determines the thrust of its rotors; see `weaken_battery`."""
        pct, before_s = self.battery_pct(self._time_s), self._felt_s
        self._felt_s = self._time_s
        if self._felt_pct is not None:
            most = SAG_PCT_S * (self._felt_s - before_s)
            pct = min(max(pct, self._felt_pct - most), self._felt_pct + most)
        self._felt_pct = pct
        return pct

    def _choose_height(self, climb_m_s, vertical_motion):
        if climb_m_s != 0.0 or not self.lifted:
            self._hold_m = None
        elif self._hold_m is None:
            height_m, rate_m_s = vertical_motion()
            self._hold_m = height_m + STOPPING_TIME_S * rate_m_s

    def _lifts(self):
        """Whether the command would lift it off the floor."""
        least = 0.0 if self._climbs else self._balance_n
        return self.command[3] > least


def _parameters_of(kind):
    """Parameters of a VehicleType. Raises ValueError if its autopilot cannot be set to its values."""
    dead_us = round(HALF_RANGE_US * own_numbers(kind, RadioSticks).stick_dead_zone)
    try:
        return Parameters(
            ANGLE_MAX=round(100.0 * math.degrees(kind.tilt_max_rad)),
            PILOT_Y_RATE=math.degrees(kind.yaw_rate_max_rad_s),
            PILOT_SPEED_UP=round(100.0 * kind.climb_max_m_s),
            BATT_CAPACITY=round(1e3 * CAPACITY_AH),
            BARO1_GND_PRESS=GROUND_PRESSURE_PA,
            **{"RC%d_DZ" % (1 + channel): dead_us for channel in (ROLL, PITCH, YAW)},
        )
    except ValueError as error:
        raise ValueError(
            "vehicle type '%s': tilt_max_rad, yaw_rate_max_rad_s, climb_max_m_s and stick_dead_zone must be what "
            "ArduCopter can be set to (10 to 80 degrees, 1 to 360 degrees a second, 0.5 to 5 m/s, 0 to 0.4): %s"
            % (kind.name, error)
        ) from error


def _beyond(deflection, dead):
    """Deflection beyond the dead zone: 0 within it, +-1 at the ends."""
    return math.copysign(min(1.0, max(0.0, (abs(deflection) - dead) / (1.0 - dead))), deflection)
