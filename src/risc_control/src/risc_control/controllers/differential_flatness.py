"""Trajectory tracking by flatness and LQR: the default controller (thesis 6, 7.3.4).

LQR with integral on [integral, position, velocity, tilt acceleration, its rate] of each horizontal axis, i.e. with the
on-board attitude loop as part of the plant; acts on the state predicted to the moment the command takes effect; feeds
forward the reference's jerk and snap through the attitude loop. Unmodelled effects (level, gain and lag of tilt and
climb, drag, an external acceleration or "push") are estimated (`disturbance_observer`), predicted and compensated in
the command.

Errors are reference - actual and feedback is +K (errata 6, 7). Positions are north, east and up (cortex x, -y, z);
north and east turned by the yaw are forward and right (vehicle-1 axes).
"""

import math
from dataclasses import dataclass

import numpy as np

from risc_control import controllers
from risc_control.delay_prediction import Motion, fill_in_force, loops, plants, predicted, steps_of
from risc_control.disturbance_observer import LAG_S, LAG_STEPS, driven, forget, observe, observer, unseen
from risc_control.flatness import Acceleration, flat_inputs, limit_tilt, thrust_at_tilt
from risc_control.lqr import lqi_gain, lqr_gain
from risc_control.reference_buffer import Axis, Order
from risc_control.vehicles import Command, climb_acceleration, climb_command, clipped, floats, greatest_command
from risc_lab.command_history import CHANNELS, Channel, CommandHistory, append_command
from risc_lab.compiled import compiled, record
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.settings import NotNegative, Positive, Settings
from risc_lab.states import S

_LONGEST_STEP_S = 0.1  # of the integrators: a gap in the states must not count as error


@dataclass(frozen=True)
class Params(Settings):
    """Diagonals of Q and R, and limits. An integral weight of 0 switches that integrator off."""

    q_integral: NotNegative = 0.0  # horizontal [1/(m s)^2]
    q_position: NotNegative = 200.0  # [1/m^2]
    q_velocity: NotNegative = 25.0  # [1/(m/s)^2]
    q_tilt: NotNegative = 3.0  # on the acceleration by tilt [1/(m/s^2)^2]
    q_tilt_rate: NotNegative = 0.15
    r_horizontal: Positive = 1.0  # [1/(m/s^2)^2]
    q_height_integral: NotNegative = 40.0  # vertical [1/(m s)^2]
    q_height: NotNegative = 70.0
    q_climb: NotNegative = 8.0
    r_vertical: Positive = 1.0
    q_yaw: NotNegative = 4.0  # [1/rad^2]
    q_yaw_rate: NotNegative = 0.0
    r_yaw: Positive = 1.0
    error_max_m: Positive = 0.4  # larger position errors are shortened to this: bounds the speed of a return
    integral_max_m_s: Positive = 0.3  # [m s] limit of each integrator
    integral_min_height_m: Positive = 0.3  # no integration lower than this, and nothing is learnt below half of it
    angle_noise_rad: Positive = 0.015  # of a measured roll or pitch, for the observer; see `disturbance_observer`
    tilt_disturbance_rad_s2: Positive = 0.5  # [rad/s^2/sqrt(Hz)] unmodelled acceleration of the attitude loop
    level_rad_s: NotNegative = 0.006  # [rad/s/sqrt(Hz)] how the level changes; 0: it is not learnt
    height_noise_m: Positive = 0.005  # of a measured height
    climb_disturbance_m_s2: Positive = 0.15  # [m/s^2/sqrt(Hz)] unmodelled acceleration of the climb loop
    climb_level_m_s2: NotNegative = 0.02  # [m/s^2/sqrt(Hz)] how the climb rate's zero changes; 0: it is not learnt
    gain_spread: NotNegative = 0.2  # of angles and climb rates over commanded ones; 0: it is not learnt
    lag_spread_s: NotNegative = 0.05  # of how late they follow; 0: it is not learnt
    position_noise_m: Positive = 0.02  # of a measured position
    push_m_s3: NotNegative = 1.0  # [m/s^3/sqrt(Hz)] how the external acceleration changes; 0: it is not learnt
    drag_spread_1_s: NotNegative = 1.5  # of drag over mass; 0: it is not learnt


# What bounds the commands of a vehicle; see `Params`.
_OF_PARAMS = ("error_max_m", "integral_max_m_s", "integral_min_height_m")
_LIMITS = record("roll_rad pitch_rad tilt_rad yaw_rate_rad_s", " ".join(_OF_PARAMS))

# Feedback gains of a horizontal axis; and feed-forward gains, through the attitude loop, on the first and second
# derivative of the reference's acceleration.
_AXIS_GAINS = record("integral position velocity tilt tilt_rate", "forward_rate_s forward_second_rate_s2")
_GAINS = record(("pitch", _AXIS_GAINS), ("roll", _AXIS_GAINS), "height_integral height climb yaw yaw_rate")
# What is remembered of a vehicle: integrals of its position error, and whether a limit cut its last command.
_INTEGRALS = record("north_m_s east_m_s up_m_s", ("tilt_was_cut", bool), ("climb_was_cut", bool))


class Controller(controllers.Controller):
    """See the module."""

    PARAMS = Params
    ORDER = Order.SNAP

    def __init__(self, vehicle_types, params):
        super().__init__(vehicle_types, params)
        self._types = list(dict.fromkeys(vehicle_types))
        self._kinds = np.array([self._types.index(vehicle_type) for vehicle_type in vehicle_types])
        self._plants = plants(self._types)
        self.delay_s = self._plants["delay_s"][self._kinds]
        self._computed = CommandHistory(len(vehicle_types))
        self._observed = unseen(len(vehicle_types))
        self._integrals = np.zeros(len(vehicle_types), _INTEGRALS)
        self._stamp_s = -np.inf

    def design(self, params):
        """((k,) _GAINS, (k,) _LIMITS, *results of `observer`) of the k vehicle types. Raises ValueError when there is
        no solution.
        """
        limits = np.array([_limits(t, params) for t in self._types], _LIMITS)
        return _gains(self._types, params), limits, *observer(self._types, params)

    def reset(self):
        """Forget what was learnt and the commands under way."""
        self._integrals[:] = np.zeros((), _INTEGRALS)
        self._observed[:] = unseen(len(self._observed))
        self.forget_times()

    def forget_times(self):
        """As `controllers.Controller`. The integrals are kept."""
        self._computed.clear()
        self._stamp_s = -np.inf

    def step(self, t, states, reference, params):
        """As `controllers.Controller`. Where a vehicle is not autonomous, integrators rest at 0, level, gain,
        lag and drag are forgotten, and nothing counts as sent.
        """
        commands = np.zeros((len(Command._fields), len(self._integrals)))
        step_s, self._stamp_s = t.stamp_s - self._stamp_s, t.stamp_s
        gains, limits, steps, unknown = self.designed
        _step(
            float(t.stamp_s),
            float(t.now_s),
            float(step_s),
            self._kinds,
            self._plants,
            limits,
            gains,
            steps,
            unknown,
            self._observed,
            self._integrals,
            states.sent.vehicles,
            self._computed.vehicles,
            floats(states.vehicles.x),
            states.vehicles.visible & reference.usable,
            np.array(states.autonomous, dtype=bool),
            floats(reference.present),
            floats(reference.ahead),
            commands,
            self.saturated,
        )
        return Command(commands[0], commands[1], commands[2], commands[3])


def _limits(vehicle_type, params):
    """_LIMITS of a type, as a tuple."""
    most = greatest_command(vehicle_type)
    # on the total tilt, so that a saturated command keeps its direction
    tilt_rad = min(most.roll_rad, most.pitch_rad)
    of_params = (getattr(params, name) for name in _OF_PARAMS)
    return (most.roll_rad, most.pitch_rad, tilt_rad, most.yaw_rate_rad_s, *of_params)


@compiled
def _step(
    stamp_s, now_s, step_s, kinds, plants, limits, gains, tables, unknowns, observed, integrals, sent, computed, x,
    usable, autonomous, present, ahead, commands, saturated
):  # fmt: skip
    """See `Controller.step`: fills commands (4, n), NaN for a vehicle of which a number is not finite, and saturated
    (n,).

    step_s: since the last state.  sent, computed: see `fill_in_force`.
    """
    age_s = max(0.0, now_s - stamp_s)
    steps = np.empty(len(plants), dtype=np.int64)
    for k in range(len(plants)):
        steps[k] = steps_of(age_s + plants[k].delay_s)
    in_force = np.empty((LAG_STEPS + 1 + steps.max(), CHANNELS))
    applied = np.zeros((len(kinds), CHANNELS))  # what our commands make the vehicles settle at
    for i in range(len(kinds)):
        kind, integral, seen = kinds[i], integrals[i], observed[i]
        unknown = unknowns[kind]
        plant, limit, gain = plants[kind], limits[kind], gains[kind]
        saturated[i] = False
        if not autonomous[i]:
            # not autonomous: what was learnt of this vehicle's trim may not hold when we take over
            integral.north_m_s = integral.east_m_s = integral.up_m_s = 0.0
            forget(seen, unknown)
        if not usable[i]:
            # a vehicle that is out of sight for a moment keeps its trim
            integral.tilt_was_cut = integral.climb_was_cut = False
            continue
        under_way = in_force[: LAG_STEPS + 1 + steps[kind]]
        fill_in_force(sent[i], computed[i], plant, stamp_s, under_way, LAG_STEPS)
        tilt = x[i, S.PHI], x[i, S.THETA], x[i, S.P], x[i, S.Q]
        way = x[i, S.X], -x[i, S.Y], x[i, S.Z], x[i, S.U], -x[i, S.V], x[i, S.W]
        wanted_m = present[Order.POSITION, i, Axis.X] + present[Order.POSITION, i, Axis.Y]
        wanted_m += present[Order.POSITION, i, Axis.Z]
        if not math.isfinite(sum(tilt) + sum(way) + wanted_m):  # it must not enter the stored states
            commands[:, i] = math.nan
            continue
        now, before = under_way[LAG_STEPS], under_way[0]
        observe(seen, stamp_s, tilt, way, now, before, x[i, S.PSI], plant, tables[kind], unknown)
        if not x[i, S.Z] > 0.5 * limit.integral_min_height_m:  # it may stand; low flight above that forgets nothing
            forget(seen, unknown)
            seen.north.push_m_s2 = seen.east.push_m_s2 = 0.0
        for k in range(len(under_way) - 1, LAG_STEPS - 1, -1):
            now, before = under_way[k], under_way[k - LAG_STEPS]
            now[Channel.PHI] = driven(seen.phi, now[Channel.PHI], before[Channel.PHI])
            now[Channel.THETA] = driven(seen.theta, now[Channel.THETA], before[Channel.THETA])
            now[Channel.CLIMB] = driven(seen.height, now[Channel.CLIMB], before[Channel.CLIMB])
        ahead_s, push = age_s + plant.delay_s, (seen.north.push_m_s2, seen.east.push_m_s2)
        motion = predicted(_motion(x[i], seen), plant, ahead_s, under_way[LAG_STEPS:], *push, seen.drag_1_s)
        if autonomous[i] and 0.0 < step_s <= _LONGEST_STEP_S:
            _integrate(integral, step_s, x[i], present[:, i], limit)

        up, climb_cut = _up(motion, ahead[:, i], plant, limit, gain, integral)
        lags_s = LAG_S * seen.theta.lag, LAG_S * seen.phi.lag
        drag_1_s = plant.drag_1_s + seen.drag_1_s
        forward, right = _horizontal(motion, ahead[:, i], drag_1_s, limit, gain, integral, push, lags_s)
        wanted_rate = _yaw_rate(motion, ahead[:, i], plant, gain)
        # `told` is asked of the climb loop so that it makes `up`
        told, told_cut = _told_up(up, motion.up_m_s, ahead[:, i], plant.climb, seen.height)
        # squares, as the norm in `flat_inputs` must be finite
        if not math.isfinite(forward * forward + right * right + up * up + wanted_rate + told):
            commands[:, i] = math.nan
            continue
        f, shortened = limit_tilt(Acceleration(forward, right, GRAVITY_M_S2 + up), limit.tilt_rad)
        wanted = flat_inputs(f, 0.0, wanted_rate, plant.mass_kg)
        wanted_roll = (wanted.roll_rad - seen.phi.level) / (1.0 + seen.phi.gain)
        wanted_pitch = (wanted.pitch_rad - seen.theta.level) / (1.0 + seen.theta.gain)
        roll, pitch = clipped(wanted_roll, limit.roll_rad), clipped(wanted_pitch, limit.pitch_rad)
        yaw_rate = clipped(wanted_rate, limit.yaw_rate_rad_s)
        commands[0, i], commands[1, i], commands[2, i] = roll, pitch, yaw_rate
        commands[3, i] = thrust_at_tilt(f.up + told - up, motion.phi_rad, motion.theta_rad, plant.mass_kg)
        integral.tilt_was_cut = shortened or roll != wanted_roll or pitch != wanted_pitch
        integral.climb_was_cut = climb_cut or told_cut
        saturated[i] = integral.tilt_was_cut or integral.climb_was_cut or yaw_rate != wanted_rate
        if autonomous[i]:
            applied[i, Channel.PHI], applied[i, Channel.THETA], applied[i, Channel.YAW_RATE] = roll, pitch, yaw_rate
            applied[i, Channel.CLIMB] = climb_command(told, motion.up_m_s, plant.climb)
    for i in range(len(kinds)):
        append_command(computed[i], now_s, applied[i])


@compiled
def _motion(x, seen):
    """Motion of a vehicle from its state; roll, pitch and velocity are those of the observer."""
    return Motion(
        x[S.X], -x[S.Y], x[S.Z], seen.north.m_s, seen.east.m_s, seen.height.rate,
        seen.phi.value, seen.theta.value, x[S.PSI], seen.phi.rate, seen.theta.rate, x[S.R], 0.0,
    )  # fmt: skip


@compiled
def _integrate(integral, step_s, x, reference, limit):
    """Add a step of the position error to a vehicle's integrals."""
    if not x[S.Z] > limit.integral_min_height_m:
        return
    position = reference[Order.POSITION]
    north, east = _shortened(position[Axis.X] - x[S.X], x[S.Y] - position[Axis.Y], limit.error_max_m)
    # a saturated command cannot use more integral: let it only shrink (anti-windup)
    grows = north * integral.north_m_s + east * integral.east_m_s > 0.0
    if not (integral.tilt_was_cut and grows):
        integral.north_m_s, integral.east_m_s = _shortened(
            integral.north_m_s + step_s * north, integral.east_m_s + step_s * east, limit.integral_max_m_s
        )
    up = clipped(position[Axis.Z] - x[S.Z], limit.error_max_m)
    if not (integral.climb_was_cut and up * integral.up_m_s > 0.0):
        integral.up_m_s = clipped(integral.up_m_s + step_s * up, limit.integral_max_m_s)


@compiled
def _horizontal(motion, reference, drag_1_s, limit, gain, integral, push, lags_s):
    """Acceleration [m/s^2] to make by tilt: (forward, by pitch; right, by roll).

    drag_1_s: over mass.  push: north and east, see `predicted`.  lags_s: additional lags of pitch and roll, beyond
    those of the type's loops.
    """
    cos_psi, sin_psi = math.cos(motion.psi_rad), math.sin(motion.psi_rad)
    # the tilt acceleration that the reference needs, and its first two derivatives, in non-rotating axes ...
    a_forward, a_right = _tilt_reference(reference, Order.ACCELERATION, drag_1_s, cos_psi, sin_psi)
    j_forward, j_right = _tilt_reference(reference, Order.JERK, drag_1_s, cos_psi, sin_psi)
    s_forward, s_right = _tilt_reference(reference, Order.SNAP, drag_1_s, cos_psi, sin_psi)
    push_forward, push_right = _turned(push[0], push[1], cos_psi, sin_psi)
    a_forward, a_right = a_forward - push_forward, a_right - push_right
    # ... and in the vehicle's axes, which rotate at psi' (the yaw acceleration is neglected)
    turn = motion.psi_rate_rad_s
    s_forward, s_right = (
        s_forward + turn * (2.0 * j_right - turn * a_forward),
        s_right - turn * (2.0 * j_forward + turn * a_right),
    )
    j_forward, j_right = j_forward + turn * a_right, j_right - turn * a_forward

    # the tilt acceleration that the vehicle has: (g + a_up) tan(tilt), and d tan(y)/dt = (1 + tan(y)^2) y'
    lift = GRAVITY_M_S2 + motion.up_m_s2
    tan_phi, tan_theta = math.tan(motion.phi_rad), math.tan(motion.theta_rad)
    tilt_forward, tilt_right = -lift * tan_theta, lift * tan_phi / math.cos(motion.theta_rad)
    tilt_rate_forward = -lift * (1.0 + tan_theta * tan_theta) * motion.theta_rate_rad_s
    tilt_rate_right = lift * (1.0 + tan_phi * tan_phi) * motion.phi_rate_rad_s

    position, velocity = reference[Order.POSITION], reference[Order.VELOCITY]
    north, east = _shortened(position[Axis.X] - motion.north_m, -position[Axis.Y] - motion.east_m, limit.error_max_m)
    p_forward, p_right = _turned(north, east, cos_psi, sin_psi)
    v_forward, v_right = _turned(
        velocity[Axis.X] - motion.north_m_s, -velocity[Axis.Y] - motion.east_m_s, cos_psi, sin_psi
    )
    i_forward, i_right = _turned(integral.north_m_s, integral.east_m_s, cos_psi, sin_psi)
    return (
        _axis(gain.pitch, i_forward, p_forward, v_forward, tilt_forward, tilt_rate_forward, a_forward, j_forward,
              s_forward, lags_s[0]),
        _axis(gain.roll, i_right, p_right, v_right, tilt_right, tilt_rate_right, a_right, j_right, s_right, lags_s[1]),
    )  # fmt: skip


@compiled
def _axis(gain, integral, position, velocity, tilt, tilt_rate, a, j, s, lag_s):
    """Acceleration to command on one axis: feedback of the errors, and feed-forward of the reference's a.

    integral, position, velocity: errors.  tilt, tilt_rate: the vehicle's acceleration by tilt, and its rate.  a, j, s:
    the acceleration that the reference needs, and its first two derivatives. The attitude loop is
    a'' = wn^2 (u - a) - 2 zeta wn a'; the input that it needs is commanded lag_s earlier.
    """
    feedback = gain.integral * integral + gain.position * position + gain.velocity * velocity
    feedback += gain.tilt * (a - tilt) + gain.tilt_rate * (j - tilt_rate)
    first_s = gain.forward_rate_s + lag_s
    second_s2 = gain.forward_second_rate_s2 + lag_s * (gain.forward_rate_s + 0.5 * lag_s)
    return feedback + a + first_s * j + second_s2 * s


@compiled
def _tilt_reference(reference, order, drag_1_s, cos_psi, sin_psi):
    """(forward, right) of a derivative of the reference that the tilt must make, drag compensation included."""
    now, before = reference[order], reference[order - 1]
    north = now[Axis.X] + drag_1_s * before[Axis.X]
    east = -now[Axis.Y] - drag_1_s * before[Axis.Y]
    return _turned(north, east, cos_psi, sin_psi)


@compiled
def _up(motion, reference, plant, limit, gain, integral):
    """(upward acceleration [m/s^2], whether a limit of the climb loop cut it).

    It is converted to the input of the vehicle's climb loop later, so the plant is a double integrator.
    """
    height_error = clipped(reference[Order.POSITION, Axis.Z] - motion.up_m, limit.error_max_m)
    climb_error = reference[Order.VELOCITY, Axis.Z] - motion.up_m_s
    wanted = gain.height_integral * integral.up_m_s + gain.height * height_error + gain.climb * climb_error
    wanted += reference[Order.ACCELERATION, Axis.Z]
    most = climb_acceleration(plant.climb.most, motion.up_m_s, plant.climb)
    least = climb_acceleration(-plant.climb.most, motion.up_m_s, plant.climb)
    up = most if wanted > most else (least if wanted < least else wanted)
    return up, up != wanted


@compiled
def _told_up(up, climb_m_s, reference, climb, height):
    """(upward acceleration to ask of the climb loop, with its learnt level, gain and lag, so that it makes `up`;
    whether a limit of the loop cut it).
    """
    a, j = reference[Order.ACCELERATION, Axis.Z], reference[Order.JERK, Axis.Z]
    command = climb_command(up, climb_m_s, climb) + LAG_S * height.lag * climb_command(j, a, climb)
    command = (command - height.level) / (1.0 + height.gain)
    cut = clipped(command, climb.most)
    return climb_acceleration(cut, climb_m_s, climb), cut != command


@compiled
def _yaw_rate(motion, reference, plant, gain):
    """Yaw rate to command [rad/s]."""
    yaw, rate = reference[Order.POSITION, Axis.PSI], reference[Order.VELOCITY, Axis.PSI]
    forward = rate + plant.yaw_time_constant_s * reference[Order.ACCELERATION, Axis.PSI]
    return forward + gain.yaw * wrapped(yaw - motion.psi_rad) + gain.yaw_rate * (rate - motion.psi_rate_rad_s)


def _gains(vehicle_types, weights):
    """(k,) _GAINS of VehicleTypes."""
    A, B = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]]
    height = [weights.q_height, weights.q_climb]
    vertical = lqi_gain(A, B, weights.q_height_integral, height, [weights.r_vertical])[0]
    gains = np.zeros(len(vehicle_types), _GAINS)
    for gain, vehicle_type in zip(gains, vehicle_types):
        A, b = loops(vehicle_type)
        drag_1_s = vehicle_type.drag_n_s_m / vehicle_type.mass_kg
        gain.roll, gain.pitch = (_horizontal_gain(A[axis], b[axis], drag_1_s, weights) for axis in (0, 1))
        gain.height_integral, gain.height, gain.climb = vertical
        yaw = [weights.q_yaw, weights.q_yaw_rate]
        gain.yaw, gain.yaw_rate = lqr_gain(A[Channel.YAW_RATE], b[Channel.YAW_RATE, :, None], yaw, [weights.r_yaw])[0]
    return gains


def _horizontal_gain(A_loop, b_loop, drag_1_s, weights):
    """_AXIS_GAINS of one axis, as a tuple."""
    A, B = np.zeros((4, 4)), np.zeros((4, 1))
    A[0, 1] = A[1, 2] = 1.0
    A[1, 1] = -drag_1_s
    A[2:, 2:], B[2:, 0] = A_loop, b_loop
    Q = [weights.q_position, weights.q_velocity, weights.q_tilt, weights.q_tilt_rate]
    feedback = lqi_gain(A, B, weights.q_integral, Q, [weights.r_horizontal])[0]
    # the command that makes the loop a'' = wn^2 (u - a) - 2 zeta wn a' follow a given a(t)
    return (*feedback, -A_loop[1, 1] / b_loop[1], 1.0 / b_loop[1])


@compiled
def _turned(north, east, cos_psi, sin_psi):
    """(forward, right) of a horizontal vector: R(v to v1)."""
    return cos_psi * north + sin_psi * east, cos_psi * east - sin_psi * north


@compiled
def _shortened(north, east, longest):
    """The horizontal vector, shortened to `longest` if it is longer."""
    length = math.hypot(north, east)
    if length > longest:
        north, east = north * longest / length, east * longest / length
    return north, east


@compiled
def wrapped(angle_rad):
    """The angle wrapped to +-pi."""
    return angle_rad - 2.0 * math.pi * np.rint(angle_rad / (2.0 * math.pi))
