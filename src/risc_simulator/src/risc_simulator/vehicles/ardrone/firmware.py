"""On-board logic of an AR.Drone 2.0: flight phases, hover by optical flow, height hold, battery.

It turns actions and setpoints into the commands of the on-board loops (attitude, yaw rate, climb), whose dynamics are
part of models/quadrotor.py, or lets the vehicle hold by itself (on_board.py).
"""

import math
from collections import namedtuple

import numpy as np

from risc_simulator.models.battery import GROUND_LOAD, Battery
from risc_simulator.models.flight import Firmware, FlightAction, FlightPhase, Setpoint
from risc_simulator.vehicles.ardrone.sensors import Flow

SPIN_UP_S = 0.8  # motors turn, vehicle still stands
TAKE_OFF_HEIGHT_M = 0.9  # above the floor
TAKE_OFF_TIME_S = 4.5  # from the order until it hovers and obeys setpoints
TAKE_OFF_CLIMB_M_S = 0.6
LANDING_DESCENT_M_S = 0.4
HARD_LANDING_M_S = 1.5  # hitting the floor faster than this breaks something

HEIGHT_HOLD_CLIMB_M_S = 0.5
STOPPING_TIME_S = 0.3  # height is held where the climb loop can stop, not where hover was asked for
FLOW_SCALE_SPREAD = 0.05  # the height that scales the flow is not exact,
FLOW_BIAS_SPREAD_M_S = 0.01  # nor is the camera exactly level: a hover creeps

# What the firmware accepts at most, whatever is configured.
TILT_LIMIT_RAD = 0.52
CLIMB_LIMIT_M_S = 2.0
YAW_RATE_LIMIT_RAD_S = 6.11

LOW_BATTERY_PCT = 15.0  # refuses to take off
EMPTY_BATTERY_PCT = 3.0  # lands by itself
LOST_HOVER_S = 2.0  # from the loss of the link until it lands

# Go to a height with a climb rate within these limits. brakes: brake by optical flow and keep the heading, instead of
# obeying the commanded tilt and yaw rate. See on_board.py.
Hold = namedtuple("Hold", "height_m climb_min_m_s climb_max_m_s brakes")
_DESCEND = Hold(0.0, -LANDING_DESCENT_M_S, -LANDING_DESCENT_M_S, brakes=True)
_WAKE_EARLY_S = 1e-6  # rounding error of a time on the grid of steps

_IN_FLIGHT = (FlightPhase.TAKING_OFF, FlightPhase.HOVERING, FlightPhase.FLYING, FlightPhase.LANDING)


class ArdroneFirmware(Firmware):
    """One AR.Drone's on-board logic.

    command: (roll_rad, pitch_rad, yaw_rate_rad_s, climb_m_s), for the loops, as far as hold does not replace it.
    hold: Hold while the vehicle keeps its height by itself: hovering, landing, or flying with a climb rate of exactly 0
        (gaz at rest), where the rest of the command is still obeyed. Else None.
    flow: Flow of its bottom camera, by which it brakes.
    """

    STOPS_WITH_A_MOTOR = True

    def __init__(self, vehicle_type, rng, perturbed, rest_height_m):
        super().__init__(vehicle_type, rng, perturbed, rest_height_m)
        self.hold = None
        self._take_off_height_m = max(TAKE_OFF_HEIGHT_M, rest_height_m + 0.5)
        self._battery = Battery(vehicle_type.battery_life_s)
        self._setpoint = Setpoint(hover=True)
        self._phase_start_s = 0.0
        scale, bias_forward, bias_right = (
            np.clip(rng.standard_normal(3), -2.0, 2.0).tolist() if perturbed else (0, 0, 0)
        )
        self._textured = self.flow = Flow(
            1.0 + FLOW_SCALE_SPREAD * scale,
            FLOW_BIAS_SPREAD_M_S * bias_forward,
            FLOW_BIAS_SPREAD_M_S * bias_right,
        )

    def configure(self, record):
        """Write the constants of this vehicle into its record (1,), on_board.FIELDS; `tell` writes the rest."""
        self._flow_cells = [record["flow_" + name] for name in Flow._fields]
        self.see_floor(True)
        self._holds, self._hold_values = record["holds"], [record[name] for name in Hold._fields]

    def see_floor(self, sees):
        """Without texture, the optical flow is 0."""
        self.flow = self._textured if sees else Flow(0.0)
        for cell, value in zip(self._flow_cells, self.flow):
            cell[0] = value

    def tell(self):
        """Write hold into the record. Returns the command to be obeyed; None while it brakes by itself."""
        held = self.hold
        self._holds[0] = held is not None
        if held is None:
            return self.command
        for cell, value in zip(self._hold_values, held):
            cell[0] = value
        return None if held.brakes else self.command

    # ------------------------------------------------------------------ battery

    def battery_pct(self, time_s):
        return self._battery.pct(time_s)

    def set_battery_pct(self, pct, time_s):
        self._battery.set_pct(pct, time_s)

    # ------------------------------------------------------------------ events

    def apply(self, action, time_s, vertical_motion):
        if isinstance(action, Setpoint):
            self._setpoint = action
            if self.phase in (FlightPhase.HOVERING, FlightPhase.FLYING):
                self._follow_setpoint(time_s, vertical_motion)
        elif action is FlightAction.TAKE_OFF:
            if self.phase is FlightPhase.LANDED and self.battery_pct(time_s) > LOW_BATTERY_PCT:
                self._setpoint = Setpoint(hover=True)
                self._enter(FlightPhase.TAKING_OFF, time_s)
        elif action is FlightAction.LAND:
            if self.phase is FlightPhase.TAKING_OFF and not self.lifted:
                self._enter(FlightPhase.LANDED, time_s)
            elif self.phase in (FlightPhase.TAKING_OFF, FlightPhase.HOVERING, FlightPhase.FLYING):
                self._enter(FlightPhase.LANDING, time_s)
        elif action is FlightAction.CUT_MOTORS:
            self._enter(FlightPhase.EMERGENCY, time_s)
        elif action is FlightAction.CLEAR_EMERGENCY:
            if self.phase is FlightPhase.EMERGENCY and not self.lifted:
                self._enter(FlightPhase.LANDED, time_s)
        else:
            raise TypeError("expected a Setpoint or a FlightAction, got %r" % (action,))

    def touch_down(self, time_s, impact_m_s):
        if self.phase is FlightPhase.EMERGENCY:
            self.lifted = False
            return ""
        if impact_m_s > HARD_LANDING_M_S:
            self._enter(FlightPhase.EMERGENCY, time_s)
            self.lifted = False
            return "hit the floor at %.1f m/s" % impact_m_s
        if self.phase is FlightPhase.LANDING:
            self._enter(FlightPhase.LANDED, time_s)
        return ""

    def crash(self, time_s):
        self._enter(FlightPhase.EMERGENCY, time_s)

    def fly_at(self, time_s, height_m):
        self.lifted = True
        self._setpoint = Setpoint(hover=True)
        self._hover(time_s, height_m)

    def power_cycle(self, time_s):
        self._setpoint = Setpoint(hover=True)
        self._enter(FlightPhase.LANDED, time_s)
        self.set_battery_pct(100.0, time_s)

    def check_battery(self, time_s):
        if self.battery_pct(time_s) <= EMPTY_BATTERY_PCT:
            self.apply(FlightAction.LAND, time_s, None)

    # ------------------------------------------------------------------ motion

    def wake(self, time_s, vertical_motion):
        """Go on with the take-off: lift off once the rotors are fast enough, hover once it is up."""
        elapsed_s = time_s - self._phase_start_s
        if elapsed_s < SPIN_UP_S:
            return
        if not self.lifted:
            self.lifted = True
            self.hold = Hold(self._take_off_height_m, -HEIGHT_HOLD_CLIMB_M_S, TAKE_OFF_CLIMB_M_S, brakes=True)
            self.wake_s = self._phase_start_s + TAKE_OFF_TIME_S - _WAKE_EARLY_S
        if elapsed_s >= TAKE_OFF_TIME_S:
            self._hover(time_s, self._take_off_height_m)
            if not self._setpoint.hover:
                self._follow_setpoint(time_s, vertical_motion)

    def _follow_setpoint(self, time_s, vertical_motion):
        wanted = self._setpoint
        if wanted.hover:
            if self.phase is not FlightPhase.HOVERING:
                self._hover(time_s, self._height_to_hold_m(vertical_motion))
            return
        height_m = self._height_to_hold_m(vertical_motion) if wanted.climb_m_s == 0.0 else None
        if self.phase is not FlightPhase.FLYING:
            self._enter(FlightPhase.FLYING, time_s)
        if height_m is None:
            self.hold = None
        elif self.hold is None:
            self.hold = Hold(height_m, -HEIGHT_HOLD_CLIMB_M_S, HEIGHT_HOLD_CLIMB_M_S, brakes=False)
        self.command = (
            min(TILT_LIMIT_RAD, max(-TILT_LIMIT_RAD, wanted.roll_rad)),
            min(TILT_LIMIT_RAD, max(-TILT_LIMIT_RAD, wanted.pitch_rad)),
            min(YAW_RATE_LIMIT_RAD_S, max(-YAW_RATE_LIMIT_RAD_S, wanted.yaw_rate_rad_s)),
            min(CLIMB_LIMIT_M_S, max(-CLIMB_LIMIT_M_S, wanted.climb_m_s)),
        )

    def _height_to_hold_m(self, vertical_motion):
        """The height that is held already, else the one at which the climb loop can stop."""
        if self.hold is not None:
            return self.hold.height_m
        height_m, climb_m_s = vertical_motion()
        return height_m + STOPPING_TIME_S * climb_m_s

    def _hover(self, time_s, height_m):
        self._enter(FlightPhase.HOVERING, time_s)
        self.hold = Hold(height_m, -HEIGHT_HOLD_CLIMB_M_S, HEIGHT_HOLD_CLIMB_M_S, brakes=True)

    def _enter(self, phase, time_s):
        self.phase, self._phase_start_s = phase, time_s
        self.motors_on = phase in _IN_FLIGHT
        self._battery.set_load(1.0 if self.motors_on else GROUND_LOAD, time_s)
        self.hold = _DESCEND if phase is FlightPhase.LANDING else None
        self.wake_s = time_s + SPIN_UP_S - _WAKE_EARLY_S if phase is FlightPhase.TAKING_OFF else math.inf
        self.command = (0.0, 0.0, 0.0, 0.0)
        if phase is FlightPhase.LANDED:
            self.lifted = False
