"""Braking without being seen: the velocity of a vehicle by its model, and the tilt that stops it. No ROS.

Motion capture gives the motion of a vehicle when it was seen last. From then on the model follows the commands that it
was sent (`delay_prediction`), which gives a good velocity for the second or two that a stop takes. It is corrected by:

- The acceleration that the commands do not explain, while a vehicle that does nothing by itself is seen: its level is
  not exact, the air moves. It is learnt along the vehicle's axes, and added from then on (`see`).
- Its own velocity, where it measures one, as an AR.Drone by its bottom camera: slowly, for wind and for a velocity that
  was wrong when it was seen last (`feel`).
- The tilt that it reports, as an IRIS+, where its difference from the commanded one is no longer that of the time when
  the vehicle was seen (`feel_tilt`). Reports are too few, and too late by a time that is not known exactly, to be
  compared while the tilt changes; they count while model and reports are both steady.

What is far from the model, or repeats itself, is not believed.

The tilt is commanded by a state feedback on the predicted state when the command takes effect: velocity v, tilt a and
its rate along each axis of its heading, v' = g a and a'' = wn^2 (command - a) - 2 zeta wn a'. Its three poles are those
of a Butterworth filter, as fast as the attitude loop allows; the limit of the tilt makes a stop from speed longer.
"""

import math
from typing import NamedTuple

import numpy as np

from risc_control.delay_prediction import MAX_HORIZON_S, STEP_S, Motion, fill_in_force, plants, predicted, steps_of
from risc_control.vehicles import clipped, greatest_command
from risc_lab.command_history import ROWS, Channel
from risc_lab.compiled import compiled, record
from risc_lab.frames import GRAVITY_M_S2

TILT_RAD = math.radians(20.0)
STOPPED_M_S = 0.05  # slower than this it holds its place, or is left to hold it by itself,
_MEANWHILE_M_S = 0.1  # which brakes it, too: if it is faster than this meanwhile, that would add to our braking
_TILT_RAD_S = 6.0  # greatest rate of a command
_BANDWIDTH = 1.5  # of the feedback, relative to that of the attitude loop
_CORRECTS, _BELIEVED_M_S = 0.3, 0.3  # share of a velocity error that one report corrects; larger errors are ignored
_LOOPS_S = 0.6  # older commands no longer affect the attitude loops
_WINDOW_S = 0.5  # the model is advanced for good when it is behind by more than this
_LEARN_S, _LEARNS_S, _PUSH_M_S2 = 0.2, 1.5, 0.8  # learning the external acceleration: interval, time constant, limit
_TILT_S, _OFFSET_S = 0.25, 2.0  # longest gap between tilt reports; time constant of their offset while it is seen
_STILL_RAD, _STILL_RAD_S = math.radians(1.0), 0.1  # it is steady: change between reports, rate of the model;
_STILL_S = 0.4  # for this long before it counts, as reports may be later than usual by that much
_SHIFTS, _BELIEVED_RAD = 0.3, math.radians(3.0)  # share of a difference that is kept; larger ones are ignored

# Gains of the feedback on one axis; speed gained from a tilt and its rate until it is level.
_GAIN = record("velocity tilt rate most_rad levels_m_s_rad levels_m_rad")


class Brake(NamedTuple):
    """Command that brakes a vehicle."""

    roll_rad: float  # as in `vehicles.Command`
    pitch_rad: float
    then: object  # `vehicle_pilot.OwnState` when the command takes effect
    stopped: bool  # it would be slow if it was commanded level now, and is not fast when that takes effect


class Braking:
    """One vehicle. Times: those of `sent`."""

    def __init__(self, vehicle_type, sent, brakes=True):
        """sent: HISTORY of what it is sent.  brakes: False for one that is only levelled."""
        self._sent = sent
        self._seen = self._own = None  # newest state that the model has not started from yet; newest state
        self._felt_m_s, self._felt_s = (0.0, 0.0), -math.inf
        self._mark, self._push_m_s2 = None, (0.0, 0.0)  # (own, when) at which learning began; forward, right
        self._tilt_rad, self._tilt_s = (math.nan, math.nan), -math.inf  # newest that it reported; when it had it
        self._model_rad = (math.nan, math.nan)  # tilt of the model at that time
        self._still_s = self._counted_s = -math.inf  # since when both are steady; until when that was counted
        self._waits = False  # the newest report has not been compared yet, while it is not seen
        self._offset_rad, self._offset_s = (0.0, 0.0), 0.0  # reported tilt - model's, while it is seen; over how long
        self._shift_rad = (0.0, 0.0)  # by which the tilt has come to differ from the model's since it was seen
        self._motion, self._at_s = _STANDING, -math.inf
        self._plant = None  # None: it is not braked
        if not brakes:
            return
        try:
            self._plant = plants([vehicle_type])[0]
        except ValueError:  # its delay is too long for a prediction
            return
        self._delay_s = self._plant.delay_s - 0.5 * self._plant.period_s  # the last half period is that of the hold
        self._gains = np.zeros(2, _GAIN)
        most = greatest_command(vehicle_type)
        for gain, loop, most_rad in zip(self._gains, (vehicle_type.roll, vehicle_type.pitch), most):
            wn, damping_1_s = loop.natural_frequency_rad_s, 2.0 * loop.damping_ratio * loop.natural_frequency_rad_s
            r = _BANDWIDTH * wn
            gain.velocity = r**3 / (GRAVITY_M_S2 * wn**2)
            gain.tilt = 2.0 * (r / wn) ** 2 - 1.0
            gain.rate = (2.0 * r - damping_1_s) / wn**2
            gain.most_rad = min(most_rad, TILT_RAD)
            gain.levels_m_s_rad = GRAVITY_M_S2 * damping_1_s / wn**2
            gain.levels_m_rad = GRAVITY_M_S2 / wn**2
        self._commands = np.zeros((2 + round(MAX_HORIZON_S / STEP_S), 4))
        self._ahead(self._motion, 0.0, 0.1)  # loads the compiled code
        _feedback(self._motion, self._gains, sent, 0.0)
        _corrected(self._motion, 0.0, 0.0)
        _pushed(self._motion, 0.0, 0.0, 0.0)

    def see(self, own, measured_s, learns=False):
        """It was seen (`vehicle_pilot.OwnState`). learns: only the commands that it was sent move it."""
        self._seen = self._own = own
        self._own_s = measured_s
        if self._plant is None:
            return
        if not learns:
            self._mark, self._push_m_s2, self._offset_s = None, (0.0, 0.0), 0.0
        elif self._mark is None or not 0.0 <= measured_s - self._mark[1] < 2.0 * _LEARN_S:
            self._mark = own, measured_s
        elif measured_s - self._mark[1] >= _LEARN_S:
            self._learn(own, measured_s)
            self._mark = own, measured_s

    def feel(self, velocity_m_s, now_s):
        """It reports its own velocity, horizontal: forward, right [m/s]."""
        self._felt_m_s, self._felt_s = velocity_m_s, now_s

    def feel_tilt(self, tilt_rad, measured_s):
        """It reports its roll and pitch [rad] of the time measured_s."""
        if self._plant is None or tilt_rad == self._tilt_rad or not math.isfinite(sum(tilt_rad)):
            return
        if not 0.0 < measured_s - self._tilt_s < _TILT_S or _differ(tilt_rad, self._tilt_rad):
            self._still_s = measured_s
        self._tilt_rad, self._tilt_s = tilt_rad, measured_s
        if self._seen is None:
            self._waits = True
        elif self._mark is not None and self._keeps_still(self._made(measured_s)):
            lasts_s = measured_s - self._counted_s
            self._offset_s = min(_OFFSET_S, self._offset_s + lasts_s)
            differs_rad = tuple(tilt - model for tilt, model in zip(tilt_rad, self._model_rad))
            self._offset_rad = _nearer(self._offset_rad, differs_rad, lasts_s / self._offset_s)
            self._counted_s = measured_s

    def command(self, now_s):
        """`Brake` to command now; None for a vehicle that was never or too long ago seen, or is not braked."""
        if self._plant is None:
            return None
        if self._seen is not None:
            self._begin()
        until_s = now_s + self._delay_s
        if not 0.0 <= until_s - self._at_s <= MAX_HORIZON_S:
            self._at_s = -math.inf
            return None
        if self._felt_s > self._at_s:
            self._go_on(self._felt_s)
            self._motion = _corrected(self._motion, *self._felt_m_s)
        if self._waits:
            self._waits = False
            self._compare()
        if until_s - self._at_s > _WINDOW_S:
            self._go_on(until_s - 0.5 * _WINDOW_S)
        then = self._later(until_s)
        roll_rad, pitch_rad, meanwhile_m_s, level_m_s = _feedback(then, self._gains, self._sent, now_s)
        own = self._own._replace(
            position_m=(then.north_m, -then.east_m, then.up_m),
            velocity_m_s=(then.north_m_s, -then.east_m_s, then.up_m_s),
            phi_rad=then.phi_rad,
            theta_rad=then.theta_rad,
            psi_rad=then.psi_rad,
        )
        stopped = level_m_s < STOPPED_M_S and meanwhile_m_s < _MEANWHILE_M_S
        return Brake(roll_rad, pitch_rad, own, stopped)

    def _begin(self):
        """Start the model from the newest state, with the angular rates that the commands until then have caused."""
        own, self._at_s, self._seen = self._seen, self._own_s, None
        (x, y, z), (u, v, w) = own.position_m, own.velocity_m_s  # cortex frame: north, west, up
        seen = Motion(x, -y, z, u, -v, w, own.phi_rad, own.theta_rad, own.psi_rad, 0.0, 0.0, 0.0, 0.0)
        made = self._ahead(seen, self._at_s - _LOOPS_S, _LOOPS_S)
        self._motion = seen._replace(
            phi_rate_rad_s=made.phi_rate_rad_s,
            theta_rate_rad_s=made.theta_rate_rad_s,
            psi_rate_rad_s=made.psi_rate_rad_s,
        )
        self._shift_rad, self._waits = (0.0, 0.0), False

    def _learn(self, own, measured_s):
        """Learn the external acceleration from the change of velocity since the mark that commands do not explain."""
        (was, was_s), (u, v, _) = self._mark, own.velocity_m_s
        (was_u, was_v, was_w), made, lasts_s = was.velocity_m_s, self._made(was_s), measured_s - was_s
        then = made._replace(north_m_s=was_u, east_m_s=-was_v, up_m_s=was_w, psi_rad=was.psi_rad)
        then = self._ahead(then, was_s, lasts_s)
        north_m_s2, east_m_s2 = (u - then.north_m_s) / lasts_s, (-v - then.east_m_s) / lasts_s
        cosine, sine = math.cos(own.psi_rad), math.sin(own.psi_rad)
        wrong_m_s2 = cosine * north_m_s2 + sine * east_m_s2, cosine * east_m_s2 - sine * north_m_s2
        believed_m_s2 = (clipped(wrong, _PUSH_M_S2) for wrong in wrong_m_s2)  # limits the effect of a false position
        self._push_m_s2 = _nearer(self._push_m_s2, believed_m_s2, -math.expm1(-lasts_s / _LEARNS_S))

    def _compare(self):
        """Compare the reported tilt with the model's; the difference counts from when both became steady."""
        if self._tilt_s <= self._at_s or self._offset_s < _OFFSET_S:
            return
        self._go_on(self._tilt_s)
        if not self._keeps_still(self._motion):
            return
        lasts_s, self._counted_s = self._tilt_s - max(self._counted_s, self._own_s), self._tilt_s
        parts = zip(self._tilt_rad, self._offset_rad, self._model_rad, self._shift_rad)
        roll_rad, pitch_rad = (tilt - offset - model - shift for tilt, offset, model, shift in parts)
        if max(abs(roll_rad), abs(pitch_rad)) < _BELIEVED_RAD:
            self._motion = _pushed(self._motion, -GRAVITY_M_S2 * pitch_rad, GRAVITY_M_S2 * roll_rad, lasts_s)
            roll_was, pitch_was = self._shift_rad
            self._shift_rad = roll_was + _SHIFTS * roll_rad, pitch_was + _SHIFTS * pitch_rad

    def _keeps_still(self, model):
        """Whether the reports and the model have long been steady. model: Motion at the time of the newest report."""
        turns_rad_s = max(abs(model.phi_rate_rad_s), abs(model.theta_rate_rad_s))
        model_rad = model.phi_rad, model.theta_rad
        if turns_rad_s > _STILL_RAD_S or _differ(model_rad, self._model_rad):
            self._still_s = self._tilt_s
        self._model_rad, self._counted_s = model_rad, max(self._counted_s, self._still_s)
        return self._tilt_s - self._still_s >= _STILL_S

    def _go_on(self, to_s):
        self._motion, self._at_s = self._later(to_s), to_s

    def _later(self, to_s):
        """Motion at to_s."""
        lasts_s, (forward_m_s2, right_m_s2), (roll_rad, pitch_rad) = to_s - self._at_s, self._push_m_s2, self._shift_rad
        forward_m_s2, right_m_s2 = forward_m_s2 - GRAVITY_M_S2 * pitch_rad, right_m_s2 + GRAVITY_M_S2 * roll_rad
        return _pushed(self._ahead(self._motion, self._at_s, lasts_s), forward_m_s2, right_m_s2, lasts_s)

    def _made(self, now_s):
        """Motion whose tilt and rates are those that the commands until now_s have caused."""
        return self._ahead(_STANDING, now_s - _LOOPS_S, _LOOPS_S)

    def _ahead(self, motion, from_s, horizon_s):
        """Motion horizon_s later by the commands."""
        commands = self._commands[: 1 + steps_of(horizon_s)]
        fill_in_force(self._sent, self._sent, self._plant, from_s, commands)
        return predicted(motion, self._plant, horizon_s, commands)


_STANDING = Motion(*[0.0] * len(Motion._fields))


def _differ(tilt_rad, other_rad):
    return not all(abs(tilt - other) < _STILL_RAD for tilt, other in zip(tilt_rad, other_rad))


def _nearer(values, to, share):
    """Values, moved by this share towards others."""
    return tuple(value + share * (other - value) for value, other in zip(values, to))


@compiled
def _corrected(motion, forward_m_s, right_m_s):
    """Motion with its velocity corrected towards the horizontal one that the vehicle measured."""
    cosine, sine = math.cos(motion.psi_rad), math.sin(motion.psi_rad)
    north_m_s = cosine * forward_m_s - sine * right_m_s - motion.north_m_s
    east_m_s = sine * forward_m_s + cosine * right_m_s - motion.east_m_s
    if not math.hypot(north_m_s, east_m_s) < _BELIEVED_M_S:
        return motion
    return _changed(motion, 0.0, 0.0, _CORRECTS * north_m_s, _CORRECTS * east_m_s)


@compiled
def _pushed(motion, forward_m_s2, right_m_s2, lasts_s):
    """Motion with the effect of an additional horizontal acceleration for lasts_s."""
    cosine, sine = math.cos(motion.psi_rad), math.sin(motion.psi_rad)
    north_m_s = lasts_s * (cosine * forward_m_s2 - sine * right_m_s2)
    east_m_s = lasts_s * (sine * forward_m_s2 + cosine * right_m_s2)
    return _changed(motion, 0.5 * lasts_s * north_m_s, 0.5 * lasts_s * east_m_s, north_m_s, east_m_s)


@compiled
def _changed(motion, north_m, east_m, north_m_s, east_m_s):
    """Motion with these added to its position and velocity."""
    return Motion(
        motion.north_m + north_m,
        motion.east_m + east_m,
        motion.up_m,
        motion.north_m_s + north_m_s,
        motion.east_m_s + east_m_s,
        motion.up_m_s,
        motion.phi_rad,
        motion.theta_rad,
        motion.psi_rad,
        motion.phi_rate_rad_s,
        motion.theta_rate_rad_s,
        motion.psi_rate_rad_s,
        motion.up_m_s2,
    )


@compiled
def _feedback(motion, gains, sent, now_s):
    """(roll, pitch, speed, speed): the command, the speed of `motion`, and its speed once level if levelled instead."""
    cosine, sine = math.cos(motion.psi_rad), math.sin(motion.psi_rad)
    forward_m_s = cosine * motion.north_m_s + sine * motion.east_m_s
    right_m_s = cosine * motion.east_m_s - sine * motion.north_m_s
    meanwhile_m_s = math.hypot(forward_m_s, right_m_s)
    gain = gains[0]  # a tilt to the right is + roll,
    roll_rad = gain.velocity * right_m_s + gain.tilt * motion.phi_rad + gain.rate * motion.phi_rate_rad_s
    roll_rad = -clipped(roll_rad, gain.most_rad)
    right_m_s += gain.levels_m_s_rad * motion.phi_rad + gain.levels_m_rad * motion.phi_rate_rad_s
    gain = gains[1]  # and forward it is - pitch
    pitch_rad = gain.velocity * forward_m_s - gain.tilt * motion.theta_rad - gain.rate * motion.theta_rate_rad_s
    pitch_rad = clipped(pitch_rad, gain.most_rad)
    forward_m_s -= gain.levels_m_s_rad * motion.theta_rad + gain.levels_m_rad * motion.theta_rate_rad_s
    last = sent.newest % ROWS
    change_rad = _TILT_RAD_S * (now_s - sent.times_s[last])
    was_rad = sent.commands[last, Channel.PHI]
    roll_rad = was_rad + clipped(roll_rad - was_rad, change_rad)
    was_rad = sent.commands[last, Channel.THETA]
    pitch_rad = was_rad + clipped(pitch_rad - was_rad, change_rad)
    return roll_rad, pitch_rad, meanwhile_m_s, math.hypot(forward_m_s, right_m_s)
