"""Trajectory tracking by flatness and LQR: states and references in, inputs of the vehicles out (thesis 6, 7.3.4).

Two controllers with the same calls:

`FlatnessController`   what flies. LQR with integral on [integral, position, velocity, tilt acceleration, its rate]
    of each horizontal axis, i.e. with the on-board attitude loop as part of the plant; acts on the state predicted to
    the moment the command takes effect; feeds forward the reference's jerk and snap through the attitude loop.
`DoubleIntegratorController`   what the thesis describes (7.7-7.10): LQR on a double integrator, feed-forward of the
    acceleration, the present state. For teaching, and to measure what the rest is worth.

Errors are reference - actual and feedback is +K (errata 6, 7). Positions are north, east and up (cortex x, -y, z);
north and east turned by the yaw are forward and right (vehicle-1 axes).
"""

import math
from dataclasses import dataclass, fields
from functools import partial
from typing import NamedTuple

import numpy as np

from risc_control.delay_prediction import (
    Channel,
    CommandHistory,
    Motion,
    NominalModel,
    TiltObserver,
    append_command,
    effective_delay_s,
    observe,
    predicted,
    rows_in_force,
    steps_of,
)
from risc_control.flatness import Acceleration, FlatInputs, flat_inputs, limit_tilt, thrust_at_tilt
from risc_control.lqr import lqr_gain, with_integral
from risc_control.mappings.ardrone import FULL_SCALE, Fractions, clipped, full_scales, to_fractions, to_inputs
from risc_control.reference_buffer import ORDERS, Axis, Order
from risc_lab.compiled import compiled, record
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.states import S, States

_LONGEST_STEP_S = 0.1  # of the integrators: a gap in the states must not count as error


@dataclass(frozen=True)
class LqrWeights:
    """Diagonals of Q and R. An integral weight of 0 switches that integrator off."""

    q_integral: float = 100.0  # horizontal [1/(m s)^2]
    q_position: float = 200.0  # [1/m^2]
    q_velocity: float = 25.0  # [1/(m/s)^2]
    q_tilt: float = 0.0  # on the acceleration by tilt [1/(m/s^2)^2]
    q_tilt_rate: float = 0.0
    r_horizontal: float = 1.0  # [1/(m/s^2)^2]
    q_height_integral: float = 40.0  # vertical [1/(m s)^2]
    q_height: float = 70.0
    q_climb: float = 8.0
    r_vertical: float = 1.0
    q_yaw: float = 4.0  # [1/rad^2]
    q_yaw_rate: float = 0.0
    r_yaw: float = 1.0

    def __post_init__(self):
        for field in fields(self):
            value = getattr(self, field.name)
            positive = field.name.startswith("r_")
            if not np.isfinite(value) or value < 0.0 or (positive and value == 0.0):
                raise ValueError("weight %s must be %s 0, got %r" % (field.name, ">" if positive else ">=", value))


@dataclass(frozen=True)
class TrackingParams:
    """Settings of a controller beside its weights."""

    command_delay_s: float = -1.0  # [s] link delay; negative: that of the vehicle type
    tilt_max_rad: float = -1.0  # [rad] full scale of the tilt commands; negative: that of the vehicle type
    yaw_rate_max_rad_s: float = -1.0  # [rad/s] full scale of the yaw command; negative: that of the vehicle type
    climb_max_m_s: float = -1.0  # [m/s] full scale of the vertical command; negative: that of the vehicle type
    error_max_m: float = 0.4  # [m] larger position errors count as this long: bounds the speed of a return
    integral_max_m_s: float = 0.3  # [m s] limit of each integrator
    integral_min_height_m: float = 0.3  # [m] no integration lower than this: the vehicle may stand
    angle_noise_rad: float = 0.005  # [rad] of a measured roll or pitch, for the tilt observer
    tilt_disturbance_rad_s2: float = 0.6  # [rad/s^2/sqrt(Hz)] what the attitude model does not know

    def __post_init__(self):
        for name in ("error_max_m", "integral_max_m_s", "angle_noise_rad", "tilt_disturbance_rad_s2"):
            if not getattr(self, name) > 0.0:
                raise ValueError("%s must be > 0, got %r" % (name, getattr(self, name)))


class Output(NamedTuple):
    """Commands of n vehicles."""

    fractions: Fractions  # of arrays (n,)
    saturated: np.ndarray  # (n,) bool: a limit of the vehicle cut the command


# What bounds the commands of a vehicle type; see `TrackingParams`.
_LIMITS = record(
    ("full_scale", FULL_SCALE),
    ("tilt_max_rad", float),
    ("climb_max_m_s", float),
    ("error_max_m", float),
    ("integral_max_m_s", float),
    ("integral_min_height_m", float),
)


class _Tracker:
    """What both controllers share. Arrays with a row for each vehicle type are looked up by `model.kind`."""

    WEIGHTS = LqrWeights()  # when none are given
    delay_s = 0.0  # [s] from sending a command to the effect that the controller counts on

    def __init__(self, vehicle_types, weights=None, params=None):
        self.params = params or TrackingParams()
        self.model = NominalModel.of(vehicle_types)
        self._plants = self.model.plants()
        self._limits = _limits_of(list(dict.fromkeys(vehicle_types)), self.params)
        self.set_weights(weights or self.WEIGHTS)

    def set_weights(self, weights):
        """Other weights. Raises ValueError, and keeps the old ones, when there is no solution."""
        self.use(weights, self.design(weights))

    def use(self, weights, gains):
        """Fly with the gains that `design` has found for these weights."""
        self.weights, self._gains = weights, gains

    def forget_times(self):
        """The clock of stamps and commands was set: what was sent when means nothing now."""

    def horizon_s(self, stamp_s, now_s):
        """How far [s] after the state's stamp the controller wants to know the reference."""
        return max(0.0, now_s - stamp_s) + self.delay_s

    def _load(self):
        """Load what is compiled, by an update in which no vehicle is seen."""
        n = len(self.model.kind)
        none, nowhere = np.zeros(n, dtype=bool), np.zeros((ORDERS, n, len(Axis)))
        self.update(0.0, 0.0, States(none, np.zeros((n, len(S)))), nowhere, nowhere, none, none)
        self.reset()


def _limits_of(vehicle_types, params):
    """(k,) _LIMITS of vehicle types. Raises ValueError."""
    tilt_max_rad, yaw_rate_max_rad_s = _override(params.tilt_max_rad), _override(params.yaw_rate_max_rad_s)
    limits = np.zeros(len(vehicle_types), _LIMITS)
    limits["full_scale"] = full_scales(vehicle_types, tilt_max_rad, yaw_rate_max_rad_s)
    # on the total tilt, so that a saturated command keeps its direction
    limits["tilt_max_rad"] = [min(abs(limit.full_scale.phi_rad), abs(limit.full_scale.theta_rad)) for limit in limits]
    limits["climb_max_m_s"] = [_override(params.climb_max_m_s) or t.climb_max_m_s for t in vehicle_types]
    for name in ("error_max_m", "integral_max_m_s", "integral_min_height_m"):
        limits[name] = getattr(params, name)
    return limits


def _override(value, zero_is_valid=False):
    """The value, or None when it is negative: the vehicle type's is meant. Raises ValueError for no number."""
    if not np.isfinite(value) or (value == 0.0 and not zero_is_valid):
        raise ValueError("a limit must be positive (negative: that of the vehicle type), got %r" % (value,))
    return None if value < 0.0 else float(value)


# --- the flatness controller -------------------------------------------------------------------------------------

# On the errors of a horizontal axis; and, forward through the attitude loop, on the first and second rate of the
# reference's acceleration.
_AXIS_GAINS = record(
    ("integral", float),
    ("position", float),
    ("velocity", float),
    ("tilt", float),
    ("tilt_rate", float),
    ("forward_rate_s", float),
    ("forward_second_rate_s2", float),
)
_GAINS = record(
    ("pitch", _AXIS_GAINS),
    ("roll", _AXIS_GAINS),
    ("height_integral", float),
    ("height", float),
    ("climb", float),
    ("yaw", float),
    ("yaw_rate", float),
)
# What is remembered of a vehicle: integrals of its position error, and whether a limit cut its last command.
_INTEGRALS = record(
    ("north_m_s", float), ("east_m_s", float), ("up_m_s", float), ("tilt_was_cut", bool), ("climb_was_cut", bool)
)


class FlatnessController(_Tracker):
    """See the module. Call `update` for every state, in the order of time."""

    def __init__(self, vehicle_types, weights=None, params=None):
        """vehicle_types: VehicleType of each vehicle, in the order of all arrays. Their link delays must agree."""
        super().__init__(vehicle_types, weights, params)
        delay_s = _override(self.params.command_delay_s, zero_is_valid=True)
        delays_s = {effective_delay_s(vehicle_type, delay_s) for vehicle_type in vehicle_types}
        if len(delays_s) != 1:
            raise ValueError(
                "one controller needs vehicles of one command delay, got %s s: start one controller for each type, or "
                "give command_delay" % ", ".join("%.3g" % value for value in sorted(delays_s))
            )
        self.delay_s = delays_s.pop()
        self._history = CommandHistory(len(vehicle_types))
        self._observer = TiltObserver(self.model, self.params.angle_noise_rad, self.params.tilt_disturbance_rad_s2)
        self._integrals = np.zeros(len(vehicle_types), _INTEGRALS)
        self._stamp_s = -np.inf
        self._load()

    def design(self, weights):
        """Gains for these weights; changes nothing. Raises ValueError when there is no solution."""
        return _full_gains(self.model, weights)

    def reset(self):
        """Forget the integrals and the commands under way."""
        self._integrals[:] = np.zeros((), _INTEGRALS)
        self.forget_times()

    def forget_times(self):
        """See `_Tracker.forget_times`. The integrals are no times, and stay."""
        self._history.clear()
        self._stamp_s = -np.inf

    def update(self, stamp_s, now_s, states, present, ahead, usable, autonomous):
        """Output for the states at stamp_s, to be sent at now_s.

        states: States.  present: (5, n, 4) reference at stamp_s.  ahead: (5, n, 4) reference at
        stamp_s + horizon_s(stamp_s, now_s); orders position to snap, axes x, y, z, psi of the cortex frame.
        usable: (n,) bool, False where there is no fresh reference.  autonomous: (n,) bool, False where somebody else
        flies the vehicle: its integrators rest at 0 and our commands do not count as sent.
        Raises ValueError, and sends nothing, when a number of a vehicle that is seen is not finite.
        """
        n = len(self._integrals)
        fractions, saturated = np.empty((len(Fractions._fields), n)), np.empty(n, dtype=bool)
        step_s, self._stamp_s = stamp_s - self._stamp_s, stamp_s
        history, observer = self._history, self._observer
        is_finite = _update(
            float(stamp_s),
            float(now_s),
            self.horizon_s(stamp_s, now_s),
            self.delay_s,
            float(step_s),
            self.model.kind,
            self._plants,
            self._limits,
            self._gains,
            observer.steps,
            observer.gains,
            observer.tilts,
            self._integrals,
            history.sent_s,
            history.commands,
            history.ends,
            _floats(states.x),
            states.visible & usable,
            np.array(autonomous, dtype=bool),
            _floats(present),
            _floats(ahead),
            fractions,
            saturated,
        )
        return _output(is_finite, fractions, saturated)


@compiled
def _update(
    stamp_s, now_s, horizon_s, delay_s, step_s, kind, plants, limits, gains, observer_steps, observer_gains, tilts,
    integrals, sent_s, commands, ends, x, usable, autonomous, present, ahead, fractions, saturated
):  # fmt: skip
    """See `FlatnessController.update`: fills fractions (4, n) and saturated (n,). step_s: since the last state.

    Returns False, and counts nothing as sent, when a number of a vehicle is not finite.
    """
    rows = rows_in_force(stamp_s - delay_s, steps_of(horizon_s), sent_s, ends)
    applied = np.zeros(commands.shape[1:])  # what the vehicles settle at, at our commands
    for i in range(len(kind)):
        plant, limit, gain, integral = plants[kind[i]], limits[kind[i]], gains[kind[i]], integrals[i]
        if not autonomous[i]:
            # somebody else flies it: what was learnt of this vehicle's trim may not hold when we take over
            integral.north_m_s = integral.east_m_s = integral.up_m_s = 0.0
        if not usable[i]:
            # a vehicle that is out of sight for a moment keeps its trim
            integral.tilt_was_cut = integral.climb_was_cut = saturated[i] = False
            _hover(i, plant, fractions)
            continue
        measured = x[i, S.PHI], x[i, S.THETA], x[i, S.P], x[i, S.Q]
        in_force = commands[rows[0], i]
        observe(tilts[i], stamp_s, measured, in_force, observer_steps[kind[i]], observer_gains[kind[i]])
        motion = predicted(_motion(x[i], tilts[i]), plant, horizon_s, commands, rows, i)
        if autonomous[i] and 0.0 < step_s <= _LONGEST_STEP_S:
            _integrate(integral, step_s, x[i], present[:, i], limit)

        climb_m_s, climb_cut = _climb_rate(motion, ahead[:, i], plant, limit, gain, integral)
        forward, right = _horizontal(motion, ahead[:, i], plant, limit, gain, integral)
        up = GRAVITY_M_S2 + (climb_m_s - motion.up_m_s) / plant.climb_time_constant_s
        yaw_rate = _yaw_rate(motion, ahead[:, i], plant, gain)
        if not math.isfinite(forward + right + up + yaw_rate):
            return False
        f, shortened = limit_tilt(Acceleration(forward, right, up), limit.tilt_max_rad)
        inputs = flat_inputs(f, 0.0, yaw_rate, plant.mass_kg)
        thrust_n = thrust_at_tilt(f.up, motion.phi_rad, motion.theta_rad, plant.mass_kg)
        inputs = FlatInputs(thrust_n, inputs.phi_rad, inputs.theta_rad, inputs.yaw_rate_rad_s)
        command, tilt_cut, yaw_cut = to_fractions(inputs, limit.full_scale)
        _fill(i, command, fractions)
        integral.tilt_was_cut, integral.climb_was_cut = shortened or tilt_cut, climb_cut
        saturated[i] = shortened or tilt_cut or yaw_cut or climb_cut
        if autonomous[i]:
            reached = to_inputs(command, limit.full_scale)
            applied[i, Channel.PHI], applied[i, Channel.THETA] = reached.phi_rad, reached.theta_rad
            applied[i, Channel.CLIMB], applied[i, Channel.YAW_RATE] = climb_m_s, reached.yaw_rate_rad_s
    append_command(now_s, applied, sent_s, commands, ends)
    return True


@compiled
def _motion(x, tilt):
    """Motion of a vehicle by its state; roll and pitch as they are observed."""
    return Motion(
        x[S.X], -x[S.Y], x[S.Z], x[S.U], -x[S.V], x[S.W],
        tilt.phi_rad, tilt.theta_rad, x[S.PSI], tilt.phi_rate_rad_s, tilt.theta_rate_rad_s, x[S.R], 0.0,
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
def _horizontal(motion, reference, plant, limit, gain, integral):
    """Acceleration (forward, right) [m/s^2] to make by tilt: of pitch and of roll."""
    cos_psi, sin_psi = math.cos(motion.psi_rad), math.sin(motion.psi_rad)
    # the tilt acceleration that the reference needs, and its first two rates, in axes that stand still ...
    a_forward, a_right = _tilt_reference(reference, Order.ACCELERATION, plant, cos_psi, sin_psi)
    j_forward, j_right = _tilt_reference(reference, Order.JERK, plant, cos_psi, sin_psi)
    s_forward, s_right = _tilt_reference(reference, Order.SNAP, plant, cos_psi, sin_psi)
    # ... and in the vehicle's, which turn at psi' (the yaw acceleration is neglected)
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
              s_forward),
        _axis(gain.roll, i_right, p_right, v_right, tilt_right, tilt_rate_right, a_right, j_right, s_right),
    )  # fmt: skip


@compiled
def _axis(gain, integral, position, velocity, tilt, tilt_rate, a, j, s):
    """Acceleration to command on one axis: feedback of the errors, and what makes the loop follow the reference's a.

    integral, position, velocity: errors.  tilt, tilt_rate: accelerations that the vehicle has.  a, j, s: that the
    reference needs. The attitude loop is a'' = wn^2 (u - a) - 2 zeta wn a'.
    """
    feedback = gain.integral * integral + gain.position * position + gain.velocity * velocity
    feedback += gain.tilt * (a - tilt) + gain.tilt_rate * (j - tilt_rate)
    return feedback + a + gain.forward_rate_s * j + gain.forward_second_rate_s2 * s


@compiled
def _tilt_reference(reference, order, plant, cos_psi, sin_psi):
    """(forward, right) of a derivative of the reference that the tilt must make: with that of the drag."""
    now, before = reference[order], reference[order - 1]
    north = now[Axis.X] + plant.drag_1_s * before[Axis.X]
    east = -now[Axis.Y] - plant.drag_1_s * before[Axis.Y]
    return _turned(north, east, cos_psi, sin_psi)


@compiled
def _climb_rate(motion, reference, plant, limit, gain, integral):
    """(climb rate to command [m/s], whether a limit cut it).

    Eq. 5.4 cancels the climb loop, so the plant is a double integrator.
    """
    height_error = clipped(reference[Order.POSITION, Axis.Z] - motion.up_m, limit.error_max_m)
    climb_error = reference[Order.VELOCITY, Axis.Z] - motion.up_m_s
    up = gain.height_integral * integral.up_m_s + gain.height * height_error + gain.climb * climb_error
    up += reference[Order.ACCELERATION, Axis.Z]
    wanted = motion.up_m_s + plant.climb_time_constant_s * up
    climb_m_s = clipped(wanted, limit.climb_max_m_s)
    return climb_m_s, climb_m_s != wanted


@compiled
def _yaw_rate(motion, reference, plant, gain):
    """Yaw rate to command [rad/s]."""
    yaw, rate = reference[Order.POSITION, Axis.PSI], reference[Order.VELOCITY, Axis.PSI]
    forward = rate + plant.yaw_time_constant_s * reference[Order.ACCELERATION, Axis.PSI]
    return forward + gain.yaw * _short_way(yaw - motion.psi_rad) + gain.yaw_rate * (rate - motion.psi_rate_rad_s)


def _full_gains(model, weights):
    """(k,) _GAINS of the types of a NominalModel."""
    A, B = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]]
    height = [weights.q_height, weights.q_climb]
    vertical = _gain_with_integral(A, B, weights.q_height_integral, height, weights.r_vertical)
    gains = np.zeros(len(model.mass_kg), _GAINS)
    for kind, gain in enumerate(gains):
        for axis, name in enumerate(("roll", "pitch")):
            wn, zeta = model.natural_frequency_rad_s[kind, axis], model.damping_ratio[kind, axis]
            gain[name] = _horizontal_gain(wn, zeta, model.drag_1_s[kind], weights)
        gain.height_integral, gain.height, gain.climb = vertical
        tau = model.yaw_time_constant_s[kind]
        A_yaw, B_yaw = [[0.0, 1.0], [0.0, -1.0 / tau]], [[0.0], [1.0 / tau]]
        gain.yaw, gain.yaw_rate = lqr_gain(A_yaw, B_yaw, [weights.q_yaw, weights.q_yaw_rate], [weights.r_yaw])[0]
    return gains


def _horizontal_gain(wn, zeta, drag_1_s, weights):
    """_AXIS_GAINS of one axis, as a tuple."""
    A = np.zeros((4, 4))
    A[0, 1] = A[1, 2] = A[2, 3] = 1.0
    A[1, 1], A[3, 2], A[3, 3] = -drag_1_s, -(wn**2), -2.0 * zeta * wn
    B = np.array([[0.0], [0.0], [0.0], [wn**2]])
    Q = [weights.q_position, weights.q_velocity, weights.q_tilt, weights.q_tilt_rate]
    feedback = _gain_with_integral(A, B, weights.q_integral, Q, weights.r_horizontal)
    # the command that makes the loop a'' = wn^2 (u - a) - 2 zeta wn a' follow a given a(t)
    return (*feedback, 2.0 * zeta / wn, wn**-2.0)


def _gain_with_integral(A, B, q_integral, Q, r):
    """Gain on [integral of the first state, states]; the integral's is 0 when its weight is."""
    if q_integral == 0.0:
        return np.concatenate([[0.0], lqr_gain(A, B, Q, [r])[0]])
    A, B = with_integral(A, B, np.eye(1, len(A)))
    return lqr_gain(A, B, [q_integral] + list(Q), [r])[0]


# --- the thesis' controller --------------------------------------------------------------------------------------

_THESIS_GAINS = record(
    ("position", float), ("velocity", float), ("height", float), ("climb", float), ("yaw", float)
)  # fmt: skip


class DoubleIntegratorController(_Tracker):
    """The thesis' controller; the same calls as `FlatnessController`."""

    # about the best without prediction; the original's gains (17.22, 1.62) oscillate at 0.1 s of command delay
    WEIGHTS = LqrWeights(q_position=2.0, q_velocity=4.0, q_height=2.0, q_climb=1.0, q_yaw=1.0)

    def __init__(self, vehicle_types, weights=None, params=None):
        """As `FlatnessController`; the link delays do not matter."""
        super().__init__(vehicle_types, weights, params)
        self._load()

    def design(self, weights):
        """Gains from position, velocity, height, climb and yaw weights; changes nothing. Raises ValueError."""
        A, B = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]]
        horizontal = lqr_gain(A, B, [weights.q_position, weights.q_velocity], [weights.r_horizontal])[0]
        vertical = lqr_gain(A, B, [weights.q_height, weights.q_climb], [weights.r_vertical])[0]
        yaw = lqr_gain([[0.0]], [[1.0]], [weights.q_yaw], [weights.r_yaw])[0]
        return np.array([(*horizontal, *vertical, *yaw)], _THESIS_GAINS)

    def reset(self):
        """Nothing is remembered."""

    def update(self, stamp_s, now_s, states, present, ahead, usable, autonomous):
        """As `FlatnessController.update`; `ahead`, the times and `autonomous` are not used."""
        n = len(self.model.kind)
        fractions, saturated = np.empty((len(Fractions._fields), n)), np.empty(n, dtype=bool)
        is_finite = _update_thesis(
            self.model.kind,
            self._plants,
            self._limits,
            self._gains,
            _floats(states.x),
            states.visible & usable,
            _floats(present),
            fractions,
            saturated,
        )
        return _output(is_finite, fractions, saturated)


@compiled
def _update_thesis(kind, plants, limits, gains, x, usable, present, fractions, saturated):
    """See `DoubleIntegratorController.update`: fills fractions (4, n) and saturated (n,). False as `_update`."""
    K = gains[0]
    for i in range(len(kind)):
        plant, limit = plants[kind[i]], limits[kind[i]]
        if not usable[i]:
            saturated[i] = False
            _hover(i, plant, fractions)
            continue
        position, velocity, acceleration = present[0, i], present[1, i], present[2, i]
        # (7.7): u = K (x_r - x), with an error that is no longer than its limit
        e_x, e_y, e_z = position[Axis.X] - x[i, S.X], position[Axis.Y] - x[i, S.Y], position[Axis.Z] - x[i, S.Z]
        distance_m = math.sqrt(e_x * e_x + e_y * e_y + e_z * e_z)
        scale = limit.error_max_m / distance_m if distance_m > limit.error_max_m else 1.0
        u_x = K.position * scale * e_x + K.velocity * (velocity[Axis.X] - x[i, S.U])
        u_y = K.position * scale * e_y + K.velocity * (velocity[Axis.Y] - x[i, S.V])
        u_z = K.height * scale * e_z + K.climb * (velocity[Axis.Z] - x[i, S.W])
        # (7.8)-(7.10), from cortex axes to north, east and up
        f = Acceleration(
            u_x + acceleration[Axis.X], -(u_y + acceleration[Axis.Y]), u_z + acceleration[Axis.Z] + GRAVITY_M_S2
        )
        psi = x[i, S.PSI]
        yaw_rate = velocity[Axis.PSI] + K.yaw * _short_way(position[Axis.PSI] - psi)
        if not math.isfinite(f.north + f.east + f.up + yaw_rate):
            return False
        f, shortened = limit_tilt(f, limit.tilt_max_rad)
        command, tilt_cut, yaw_cut = to_fractions(flat_inputs(f, psi, yaw_rate, plant.mass_kg), limit.full_scale)
        _fill(i, command, fractions)
        saturated[i] = shortened or tilt_cut or yaw_cut
    return True


# --- parts of both -----------------------------------------------------------------------------------------------

# The arrays that compiled code was compiled for, so that nothing is compiled in flight.
_floats = partial(np.ascontiguousarray, dtype=float)


def _output(is_finite, fractions, saturated):
    # raised here: an exception out of compiled code leaves its arrays in memory for ever
    if not is_finite:
        raise ValueError("refusing to command: a state or a reference is not finite")
    return Output(Fractions(fractions[0], fractions[1], fractions[2], fractions[3]), saturated)


@compiled
def _hover(i, plant, fractions):
    """Zero acceleration (thesis 7.7), where no command can be computed."""
    _fill(i, Fractions(0.0, 0.0, 0.0, plant.mass_kg * GRAVITY_M_S2), fractions)


@compiled
def _fill(i, command, fractions):
    """One vehicle's Fractions into column i of all vehicles' (4, n)."""
    for part in range(len(command)):
        fractions[part, i] = command[part]


@compiled
def _turned(north, east, cos_psi, sin_psi):
    """(forward, right) of a horizontal vector: R(v to v1)."""
    return cos_psi * north + sin_psi * east, cos_psi * east - sin_psi * north


@compiled
def _shortened(north, east, longest):
    """The horizontal vector, no longer than this."""
    length = math.hypot(north, east)
    if length > longest:
        north, east = north * longest / length, east * longest / length
    return north, east


@compiled
def _short_way(angle_rad):
    """The angle less whole turns."""
    return angle_rad - 2.0 * math.pi * np.rint(angle_rad / (2.0 * math.pi))
