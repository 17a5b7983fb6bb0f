"""Whether the states that motion capture gives of a vehicle are physically possible. No ROS.

Swapped markers, exchanged names, a template that is fitted turned by 180 degrees and repeated frames all give states
that look like any other. Here each state is judged against the one before, by what the type of the vehicle can do in
the time T between them. For a vehicle whose acceleration is at most A

    |step of its velocity| <= A T,    |step of its position - T * mean of both velocities| <= A T^2 / 4,

the second one with equality when it accelerates one way for T/2 and the other way for the rest. Roll and pitch turn no
faster than its attitude loops do, yaw no faster than full scale (`reach_of`), and no vehicle flies tilted by more than
`_TILT_MAX_RAD`, however long it was not seen. An allowance for the noise of motion capture and estimator is added
(`suspect_position_m` and others of `SafetyLimits`). A position exactly equal to that of the state before is not a
measurement: even at rest, the markers of a vehicle are measured anew.

A state that contradicts these limits is suspect, and so are those after it. They are believed again after `_AGREEING`
steps in a row that do not contradict (`_SLOWLY` where their velocity has changed), if that track began where the
vehicle can have come since the last state that was believed, or has returned near to where that state leads. A track
that continues elsewhere stays suspect until the vehicle must have landed (`separation_forget_s`); then it is believed,
or the vehicle could never be flown again.

Times are stamps. A message whose stamp is older than one before it is ignored. When the clock of the stamps was set,
earlier states keep their true age, so that a set clock hides no contradiction.
"""

import enum
import math

import numpy as np

from risc_control.vehicles import adapter_class, greatest_command
from risc_lab.clock_guard import AGREEING, ClockGuard, Step
from risc_lab.compiled import compiled, record
from risc_lab.frames import GRAVITY_M_S2, wrap_one_angle
from risc_lab.states import S


class Doubt(enum.IntEnum):
    """What a suspect state contradicts."""

    NONE, POSITION, VELOCITY, TILT, YAW, FROZEN, EXCHANGED, STEEP = range(8)


_TEXTS = {
    Doubt.POSITION: "seen {misfit:.2f} m from where it can be (limit {most:.2f} m)",
    Doubt.VELOCITY: "its velocity jumped by {misfit:.1f} m/s (limit {most:.1f} m/s)",
    Doubt.TILT: "its roll or pitch jumped by {misfit:.0f} deg (limit {most:.0f} deg)",
    Doubt.YAW: "its yaw jumped by {misfit:.0f} deg (limit {most:.0f} deg)",
    Doubt.FROZEN: "motion capture repeats the same position",
    Doubt.STEEP: "seen tilted by {misfit:.0f} deg, which none can fly (limit {most:.0f} deg)",
    Doubt.EXCHANGED: "seen where {other} was, and {other} where it was: motion capture has exchanged their names",
}
_POSITION, _VELOCITY, _TILT, _YAW, _FROZEN, _EXCHANGED, _STEEP = map(int, list(Doubt)[1:])  # for compiled code
_AGREEING = 4  # steps: 67 ms at 60 looks a second,
_SLOWLY = 12  # where its velocity has changed: for this long it may come from false positions
_GROW_S = 0.05  # the limits around where the last good state leads grow for this long only
_COMES_S = 0.5  # a suspect vehicle counts as accelerating for this long only: else all places would be in its reach
_NEAR_OTHER = 0.35  # of their distance: names were exchanged if both are seen this near to each other's position
_TILT_MAX_RAD = 1.2
_STATE = S.PSI + 1  # columns that are judged

# Limits of a type of vehicle, and the allowance for noise.
_REACH = record("level_m_s2 up_m_s2 tilt_rad_s yaw_rad_s")
_NOISE = record("position_m velocity_m_s angle_rad least_m")
_VEHICLE = record(
    ("reach", _REACH),
    ("good_s", float),  # -inf: never seen
    ("good", float, (_STATE,)),  # the newest state that was believed
    ("newest_s", float),
    ("newest", float, (_STATE,)),  # the newest one
    ("doubt", int),  # Doubt, from the first suspect state on
    ("unseen_s", float),  # from the last good state to the first suspect one
    ("agreeing", int),  # steps in a row,
    ("began_well", bool),  # and the first was from a place where it can have been
    ("other", int),  # row of the vehicle with which its name was exchanged
    ("misfit", float),  # by how much it contradicts,
    ("most", float),  # and the limit of that
)


def reach_of(vehicle_type):
    """Row of _REACH: greatest accelerations of a VehicleType, horizontal and vertical, and rates of its angles.

    An attitude loop that is stepped from one full scale to the other turns at natural frequency * full scale.
    """
    most = greatest_command(vehicle_type)
    tilt_rad = min(max(most.roll_rad, most.pitch_rad), _TILT_MAX_RAD)
    loop_rad_s = max(vehicle_type.roll.natural_frequency_rad_s, vehicle_type.pitch.natural_frequency_rad_s)
    gain, damping_1_s, climb = adapter_class(vehicle_type).climb_loop(vehicle_type)
    up_m_s2 = gain * climb + damping_1_s * vehicle_type.climb_max_m_s
    return (
        GRAVITY_M_S2 * math.tan(tilt_rad),
        max(GRAVITY_M_S2, up_m_s2),
        loop_rad_s * tilt_rad,
        most.yaw_rate_rad_s,
    )


class Plausibility:
    """The states of a fleet, as one node sees them. One thread at a time."""

    def __init__(self, vehicle_types, limits):
        """vehicle_types: {name: VehicleType}; the states of others are believed.  limits: SafetyLimits."""
        self._give_up_s = limits.separation_forget_s
        noise = limits.suspect_position_m, limits.suspect_velocity_m_s, math.radians(limits.suspect_angle_deg)
        self._noise = np.array([(*noise, limits.state_least_step_m)], _NOISE)  # a record would take longer to pass
        self._names = tuple(vehicle_types)
        self._index = {name: row for row, name in enumerate(self._names)}
        self._vehicles = np.zeros(len(self._names), _VEHICLE)
        self._vehicles["reach"] = [reach_of(vehicle_type) for vehicle_type in vehicle_types.values()]
        self._vehicles["good_s"] = -math.inf
        self._on = limits.ladder
        self._rows = {}  # {names of a message: row of each}
        self._stamps = ClockGuard(math.inf)  # a node may hear nothing for long
        self._heard_s = self._refused_s = -math.inf  # the newest stamp that was accepted, and that was not
        self._look(np.zeros(0, np.int64), np.zeros(0, bool), np.zeros((0, len(S))), 0.0)  # loads the compiled code

    def look(self, names, visible, states, stamp_s):
        """(n,) bool: visible with a plausible state; None: the message is older than one before, or its clock is new.

        visible: (n,) bool.  states: (n, 12), columns `S`.
        """
        if not self._on:
            return visible
        rows = self._rows.get(names)
        if rows is None:
            if len(self._rows) > 64:  # names that change all the time are not of one flight
                self._rows.clear()
            rows = self._rows[names] = np.array([self._index.get(name, -1) for name in names], np.int64)
        step = self._stamps.look(stamp_s)
        if step is Step.REFUSED:
            self._refused_s = stamp_s
            if stamp_s == self._heard_s:  # the same message again
                return visible & ((rows < 0) | (self._vehicles["doubt"][rows] == 0))
            return None
        if step is Step.NEW_CLOCK:
            set_s = stamp_s - AGREEING * (stamp_s - self._refused_s) - self._heard_s
            self._vehicles["good_s"] += set_s
            self._vehicles["newest_s"] += set_s
        self._heard_s = stamp_s
        return self._look(rows, visible, states, stamp_s)

    def _look(self, rows, visible, states, stamp_s):
        believed = np.array(visible)
        _judge(self._vehicles, rows, believed, states, stamp_s, self._noise, self._give_up_s)
        return believed

    def doubt(self, name):
        """`Doubt` about the newest state of a vehicle."""
        row = self._index.get(name)
        return Doubt.NONE if row is None else Doubt(self._vehicles[row].doubt)

    def reason(self, name):
        """What the newest state of a vehicle contradicts, in a few words; "" when nothing."""
        doubt = self.doubt(name)
        if doubt is Doubt.NONE:
            return ""
        vehicle = self._vehicles[self._index[name]]
        angle = doubt in (Doubt.TILT, Doubt.YAW, Doubt.STEEP)
        misfit, most = (math.degrees(value) if angle else value for value in (vehicle.misfit, vehicle.most))
        return _TEXTS[doubt].format(misfit=misfit, most=most, other=self._names[vehicle.other])


@compiled
def _judge(vehicles, rows, believed, states, stamp_s, noise_of_all, give_up_s):
    """Judge the states (n, 12) of a message; take those out of believed (n,) that are suspect.  noise_of_all: (1,)."""
    suspects = 0
    for k in range(len(rows)):
        if rows[k] < 0 or not believed[k] or not math.isfinite(states[k, :_STATE].sum()):
            continue
        vehicle = vehicles[rows[k]]
        _note(vehicle, states[k], stamp_s, noise_of_all[0], give_up_s)
        if vehicle.doubt:
            believed[k] = False
            suspects += 1
    if suspects > 1:
        for k in range(len(rows)):
            for j in range(k):
                if rows[k] >= 0 and rows[j] >= 0:
                    _note_exchange(vehicles, rows[k], rows[j], stamp_s)


@compiled
def _note(vehicle, state, stamp_s, noise, give_up_s):
    """Judge one more state of a vehicle."""
    step_s = stamp_s - vehicle.newest_s
    if vehicle.good_s == -math.inf:
        _believe(vehicle, state, stamp_s)
        return
    moved_m = 0.0
    for axis in range(3):
        moved_m = max(moved_m, abs(state[axis] - vehicle.newest[axis]))
    if moved_m < noise.least_m:  # not the newest one: where it was at that time is not known
        if not vehicle.doubt:
            vehicle.doubt = _FROZEN
        return
    contradicts, misfit, most = _contradicts(vehicle.reach, vehicle.newest, state, step_s, step_s, noise)
    vehicle.newest[:], vehicle.newest_s = state[:_STATE], stamp_s
    if vehicle.doubt in (0, _FROZEN):
        if not contradicts:
            _believe(vehicle, state, stamp_s)
            return
        vehicle.doubt, vehicle.misfit, vehicle.most = contradicts, misfit, most
        vehicle.unseen_s, vehicle.agreeing, vehicle.began_well = step_s, 0, False
        return
    since_s = stamp_s - vehicle.good_s
    if contradicts:
        vehicle.agreeing = 0
        comes_s = min(since_s, _COMES_S)
        vehicle.began_well = not _contradicts(vehicle.reach, vehicle.good, state, since_s, comes_s, noise)[0]
    else:
        vehicle.agreeing += 1
    reach_s = min(since_s, vehicle.unseen_s + _GROW_S)
    elsewhere, misfit, most = _contradicts(vehicle.reach, vehicle.good, state, since_s, reach_s, noise)
    faster_m_s = 0.0
    for axis in range(3):
        faster_m_s = max(faster_m_s, abs(state[S.U + axis] - vehicle.good[S.U + axis]))
    wanted = _AGREEING if faster_m_s < noise.velocity_m_s else _SLOWLY
    if vehicle.agreeing >= wanted and (vehicle.began_well or not elsewhere or since_s > give_up_s):
        _believe(vehicle, state, stamp_s)
    elif elsewhere and vehicle.doubt != _EXCHANGED:
        vehicle.doubt, vehicle.misfit, vehicle.most = elsewhere, misfit, most


@compiled
def _believe(vehicle, state, stamp_s):
    vehicle.good[:], vehicle.newest[:] = state[:_STATE], state[:_STATE]
    vehicle.good_s = vehicle.newest_s = stamp_s
    vehicle.doubt = 0


@compiled
def _contradicts(reach, before, state, step_s, reach_s, noise):
    """(Doubt, misfit, limit) of the step between two states, by the limit that is exceeded most; Doubt 0: possible.

    reach_s: time for which the vehicle may have moved unobserved.
    """
    square, square_m_s, doubt, worst, its_most = 0.0, 0.0, 0, 0.0, 1.0
    for axis in range(2):
        faster_m_s = state[S.U + axis] - before[S.U + axis]
        off_m = state[axis] - before[axis] - 0.5 * step_s * (state[S.U + axis] + before[S.U + axis])
        square, square_m_s = square + off_m * off_m, square_m_s + faster_m_s * faster_m_s
    off_up_m = abs(state[S.Z] - before[S.Z] - 0.5 * step_s * (state[S.W] + before[S.W]))
    blur_m = noise.position_m + noise.velocity_m_s * reach_s
    blur_m_s, turn_rad = noise.velocity_m_s, reach.tilt_rad_s * reach_s + noise.angle_rad
    tilt_rad = max(abs(state[S.PHI] - before[S.PHI]), abs(state[S.THETA] - before[S.THETA]))
    yaw_rad = abs(wrap_one_angle(state[S.PSI] - before[S.PSI]))
    for what, misfit, most in (
        (_POSITION, math.sqrt(square), blur_m + 0.25 * reach.level_m_s2 * reach_s * reach_s),
        (_POSITION, off_up_m, blur_m + 0.25 * reach.up_m_s2 * reach_s * reach_s),
        (_VELOCITY, math.sqrt(square_m_s), blur_m_s + reach.level_m_s2 * reach_s),
        (_VELOCITY, abs(state[S.W] - before[S.W]), blur_m_s + reach.up_m_s2 * reach_s),
        (_TILT, tilt_rad, turn_rad),
        (_YAW, yaw_rad, reach.yaw_rad_s * reach_s + noise.angle_rad),
        (_STEEP, math.acos(math.cos(state[S.PHI]) * math.cos(state[S.THETA])), _TILT_MAX_RAD),
    ):
        if misfit > most and misfit * its_most > worst * most:
            doubt, worst, its_most = what, misfit, most
    return doubt, worst, its_most


@compiled
def _note_exchange(vehicles, i, j, stamp_s):
    """Note if two suspects are each seen where the other was."""
    one, other = vehicles[i], vehicles[j]
    if not one.doubt or not other.doubt or one.newest_s != stamp_s or other.newest_s != stamp_s:
        return
    apart, one_off, other_off = 0.0, 0.0, 0.0
    for axis in range(3):
        one_m = one.good[axis] + (stamp_s - one.good_s) * one.good[S.U + axis]
        other_m = other.good[axis] + (stamp_s - other.good_s) * other.good[S.U + axis]
        apart += (one_m - other_m) ** 2
        one_off += (one.newest[axis] - other_m) ** 2
        other_off += (other.newest[axis] - one_m) ** 2
    if max(one_off, other_off) < _NEAR_OTHER * _NEAR_OTHER * apart:
        one.doubt = other.doubt = _EXCHANGED
        one.other, other.other = j, i
