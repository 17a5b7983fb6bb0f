"""Trajectory tracking by flatness and LQR: states and references in, inputs of the vehicles out (thesis 6, 7.3.4).

Two controllers with the same calls:

`FlatnessController`   what flies. LQR with integral on [integral, position, velocity, tilt acceleration, its rate]
    of each horizontal axis, i.e. with the on-board attitude loop as part of the plant; acts on the state predicted to
    the moment the command takes effect; feeds forward the reference's jerk and snap through the attitude loop.
`DoubleIntegratorController`   what the thesis describes (7.7-7.10): LQR on a double integrator, feed-forward of the
    acceleration, the present state. For teaching, and to measure what the rest is worth.

Errors are reference - actual and feedback is +K (errata 6, 7). Horizontal vectors are complex numbers
north + i east; times exp(-i psi) they are forward + i right (vehicle-1 axes).
"""

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from risc_control.flatness import flat_inputs, limit_tilt, thrust_at_tilt
from risc_control.frames import GRAVITY_M_S2
from risc_control.lqr import lqr_gain, with_integral
from risc_control.mappings.ardrone import ArdroneMapping, Fractions
from risc_control.prediction import (
    STEP_S,
    Channel,
    CommandHistory,
    Motion,
    NominalModel,
    Predictor,
    TiltObserver,
    effective_delay_s,
)

_ROLL, _PITCH = 0, 1
_LONGEST_STEP_S = 0.1  # of the integrators: a gap in the states must not count as error


class States(NamedTuple):
    """What is known of n vehicles at one time. SI units, cortex axes, angles in the NED sense."""

    visible: np.ndarray  # (n,) bool; the other rows mean nothing where False
    position_m: np.ndarray  # (n, 3)
    velocity_m_s: np.ndarray  # (n, 3)
    angles_rad: np.ndarray  # (n, 3) phi, theta, psi
    rates_rad_s: np.ndarray  # (n, 3) Euler rates


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

    fractions: Fractions
    saturated: np.ndarray  # (n,) bool: a limit of the vehicle cut the command


class _Tracker:
    """What both controllers share."""

    WEIGHTS = LqrWeights()  # when none are given
    delay_s = 0.0  # [s] from sending a command to the effect that the controller counts on

    def __init__(self, vehicle_types, weights=None, params=None):
        self.params = params or TrackingParams()
        self.model = NominalModel.of(vehicle_types)
        self._n = len(vehicle_types)
        self._mapping = ArdroneMapping(
            vehicle_types, _override(self.params.tilt_max_rad), _override(self.params.yaw_rate_max_rad_s)
        )
        # the limit is on the total tilt, so that a saturated command keeps its direction
        gains = np.array([min(t.roll.gain, t.pitch.gain) for t in vehicle_types])
        self._tilt_max_rad = self._mapping.tilt_max_rad * gains
        self._climb_max_m_s = np.array([_override(self.params.climb_max_m_s) or t.climb_max_m_s for t in vehicle_types])
        self.set_weights(weights or self.WEIGHTS)

    def set_weights(self, weights):
        """Other weights. Raises ValueError, and keeps the old ones, when there is no solution."""
        self.use(weights, self.design(weights))

    def use(self, weights, gains):
        """Fly with the gains that `design` has found for these weights."""
        self.weights, self._gains = weights, gains

    def horizon_s(self, stamp_s, now_s):
        """How far [s] after the state's stamp the controller wants to know the reference."""
        return max(0.0, now_s - stamp_s) + self.delay_s

    def _hover(self, fractions, usable):
        """The fractions with zero acceleration (thesis 7.7) where no command can be computed."""
        level = np.where(usable, fractions[:3], 0.0)
        return Fractions(*level, np.where(usable, fractions.thrust_n, self.model.mass_kg * GRAVITY_M_S2))


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
        self._history = CommandHistory(self._n)
        self._predictor = Predictor(self.model)
        self._predictor.prepare(self.delay_s + STEP_S)
        self._observer = TiltObserver(self.model, self.params.angle_noise_rad, self.params.tilt_disturbance_rad_s2)
        self._integral = np.zeros(self._n, dtype=complex)
        self._height_integral = np.zeros(self._n)
        self._frozen = np.zeros(self._n, dtype=bool)
        self._height_frozen = np.zeros(self._n, dtype=bool)
        self._stamp_s = -np.inf

    def design(self, weights):
        """Gains for these weights; changes nothing. Raises ValueError when there is no solution."""
        return _full_gains(self.model, weights)

    def reset(self):
        """Forget the integrals and the commands under way."""
        self._integral[:], self._height_integral[:] = 0.0, 0.0
        self._history.clear()

    def update(self, stamp_s, now_s, states, present, ahead, usable, autonomous):
        """Output for the states at stamp_s, to be sent at now_s.

        states: States.  present: (5, n, 4) reference at stamp_s.  ahead: (5, n, 4) reference at
        stamp_s + horizon_s(stamp_s, now_s); orders position to snap, axes x, y, z, psi of the cortex frame.
        usable: (n,) bool, False where there is no fresh reference.  autonomous: (n,) bool, False where somebody else
        flies the vehicle: its integrators rest at 0 and our commands do not count as sent.
        """
        usable = usable & states.visible
        if not usable.all():
            states, present, ahead = _harmless(states, usable), _rows(present, usable), _rows(ahead, usable)
        motion = self._motion(stamp_s, states)
        horizon_s = self.horizon_s(stamp_s, now_s)
        motion, a_up = self._predictor.ahead(motion, stamp_s, horizon_s, self._history, self.delay_s)
        self._integrate(stamp_s, states, present, usable, autonomous)

        f = np.empty((self._n, 3))
        self._horizontal(motion, a_up, ahead, f)
        climb_m_s, climb_cut = self._vertical(motion, ahead, f)
        f, shortened = limit_tilt(f, self._tilt_max_rad)
        inputs = flat_inputs(f, 0.0, self._yaw_rate(motion, ahead), self.model.mass_kg)
        thrust_n = thrust_at_tilt(f[:, 2], motion.phi_rad, motion.theta_rad, self.model.mass_kg)
        fractions, cut = self._mapping.to_fractions(inputs._replace(thrust_n=thrust_n))
        self._frozen = shortened | cut[0] | cut[1]
        self._height_frozen = climb_cut
        if not usable.all():
            fractions = self._hover(fractions, usable)

        applied = self._mapping.to_inputs(fractions)
        command = np.array([applied.phi_rad, applied.theta_rad, climb_m_s, applied.yaw_rate_rad_s]).T
        flown = usable & autonomous
        if not flown.all():
            command[~flown] = 0.0
        self._history.append(now_s, command)
        return Output(fractions, self._frozen | cut[2] | climb_cut)

    def _horizontal(self, motion, a_up, ahead, f):
        """Wanted acceleration by tilt into f[:, :2]: forward, which is pitch, and right, which is roll."""
        reference = _turned(_neu(ahead), motion.psi_rad, motion.psi_rate_rad_s, self.model.drag_1_s)
        turn = np.exp(-1j * motion.psi_rad)
        position_error = _shortened(_neu(ahead[0]) - motion.position_m, self.params.error_max_m)
        velocity_error = _neu(ahead[1]) - motion.velocity_m_s
        tilt = np.tan([motion.theta_rad, motion.phi_rad])
        cos_theta = np.cos(motion.theta_rad)
        lift = GRAVITY_M_S2 + a_up
        tilt_acceleration = lift * (1j * tilt[1] / cos_theta - tilt[0])
        # d tan(x)/dt = (1 + tan(x)^2) x'
        slope = lift * (1.0 + tilt * tilt)
        tilt_rate = 1j * slope[1] * motion.phi_rate_rad_s - slope[0] * motion.theta_rate_rad_s
        terms = np.array(
            [
                turn * self._integral,
                turn * position_error,
                turn * velocity_error,
                reference[0] - tilt_acceleration,
                reference[1] - tilt_rate,
                *reference,
            ]
        )
        np.einsum("kn,kn->n", self._gains.pitch, terms.real, out=f[:, 0])
        np.einsum("kn,kn->n", self._gains.roll, terms.imag, out=f[:, 1])

    def _vertical(self, motion, ahead, f):
        """Wanted upward acceleration with gravity into f[:, 2]; (climb rate [m/s] that this commands, whether cut).

        Eq. 5.4 cancels the climb loop, so the plant is a double integrator.
        """
        height_error = _clipped(ahead[0, :, 2] - motion.height_m, self.params.error_max_m)
        k_integral, k_height, k_climb = self._gains.vertical
        up = ahead[2, :, 2] + k_integral * self._height_integral + k_height * height_error
        up += k_climb * (ahead[1, :, 2] - motion.climb_m_s)
        tau = self.model.climb_time_constant_s
        wanted = motion.climb_m_s + tau * up
        climb = _clipped(wanted, self._climb_max_m_s)
        f[:, 2] = GRAVITY_M_S2 + (climb - motion.climb_m_s) / tau
        return climb, climb != wanted

    def _yaw_rate(self, motion, ahead):
        """Yaw rate to command [rad/s]."""
        yaw, rate, acceleration = ahead[:3, :, 3]
        error = yaw - motion.psi_rad
        error -= 2.0 * np.pi * np.rint(error / (2.0 * np.pi))
        k_yaw, k_rate = self._gains.yaw
        forward = rate + self.model.yaw_time_constant_s * acceleration
        return forward + k_yaw * error + k_rate * (rate - motion.psi_rate_rad_s)

    def _motion(self, stamp_s, states):
        command = self._history.at(np.array([stamp_s - self.delay_s - 0.5 * STEP_S]))[0]
        angles, rates = self._observer.update(
            stamp_s,
            states.angles_rad[:, :2],
            states.rates_rad_s[:, :2],
            command[:, [Channel.PHI, Channel.THETA]],
            states.visible,
        )
        return Motion(
            _neu(states.position_m),
            _neu(states.velocity_m_s),
            states.position_m[:, 2],
            states.velocity_m_s[:, 2],
            angles[:, _ROLL],
            angles[:, _PITCH],
            states.angles_rad[:, 2],
            rates[:, _ROLL],
            rates[:, _PITCH],
            states.rates_rad_s[:, 2],
        )

    def _integrate(self, stamp_s, states, present, usable, autonomous):
        step_s = stamp_s - self._stamp_s
        self._stamp_s = stamp_s
        if not autonomous.all():
            # somebody else flies it: what was learnt of this vehicle's trim may not hold when we take over
            self._integral[~autonomous], self._height_integral[~autonomous] = 0.0, 0.0
        if not 0.0 < step_s <= _LONGEST_STEP_S:
            return
        # a vehicle that is out of sight for a moment keeps its trim
        active = usable & autonomous & (states.position_m[:, 2] > self.params.integral_min_height_m)
        limit = self.params.integral_max_m_s
        error = _shortened(_neu(present[0]) - _neu(states.position_m), self.params.error_max_m)
        # a saturated command cannot use more integral: let it only shrink (anti-windup)
        grows = (error * self._integral.conjugate()).real > 0.0
        error *= step_s * (active & ~(self._frozen & grows))
        self._integral = _shortened(self._integral + error, limit)
        error = _clipped(present[0, :, 2] - states.position_m[:, 2], self.params.error_max_m)
        grows = error * self._height_integral > 0.0
        error *= step_s * (active & ~(self._height_frozen & grows))
        self._height_integral = _clipped(self._height_integral + error, limit)


class DoubleIntegratorController(_Tracker):
    """The thesis' controller; the same calls as `FlatnessController`."""

    # about the best without prediction; the original's gains (17.22, 1.62) oscillate at 0.1 s of command delay
    WEIGHTS = LqrWeights(q_position=2.0, q_velocity=4.0, q_height=2.0, q_climb=1.0, q_yaw=1.0)

    def design(self, weights):
        """Gains from position, velocity, height, climb and yaw weights; changes nothing. Raises ValueError."""
        A, B = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]]
        horizontal = lqr_gain(A, B, [weights.q_position, weights.q_velocity], [weights.r_horizontal])[0]
        vertical = lqr_gain(A, B, [weights.q_height, weights.q_climb], [weights.r_vertical])[0]
        yaw = lqr_gain([[0.0]], [[1.0]], [weights.q_yaw], [weights.r_yaw])[0, 0]
        k_position, k_velocity = (np.array([horizontal[i], horizontal[i], vertical[i]]) for i in (0, 1))
        return k_position, k_velocity, yaw

    def reset(self):
        """Nothing is remembered."""

    def update(self, stamp_s, now_s, states, present, ahead, usable, autonomous):
        """As `FlatnessController.update`; `ahead`, `now_s` and `autonomous` are not used."""
        usable = usable & states.visible
        if not usable.all():
            states, present = _harmless(states, usable), _rows(present, usable)
        error = present[:2, :, :3] - np.array([states.position_m, states.velocity_m_s])
        error[0] *= np.minimum(1.0, self.params.error_max_m / np.maximum(np.sqrt((error[0] ** 2).sum(axis=1)), 1e-9))[
            :, None
        ]
        k_position, k_velocity, k_yaw = self._gains
        u = k_position * error[0] + k_velocity * error[1] + present[2, :, :3]
        f = u * (1.0, -1.0, 1.0) + (0.0, 0.0, GRAVITY_M_S2)  # (7.10) in north, east, up
        f, shortened = limit_tilt(f, self._tilt_max_rad)
        yaw_error = present[0, :, 3] - states.angles_rad[:, 2]
        yaw_error -= 2.0 * np.pi * np.rint(yaw_error / (2.0 * np.pi))
        yaw_rate = present[1, :, 3] + k_yaw * yaw_error
        inputs = flat_inputs(f, states.angles_rad[:, 2], yaw_rate, self.model.mass_kg)
        fractions, cut = self._mapping.to_fractions(inputs)
        if not usable.all():
            fractions = self._hover(fractions, usable)
        return Output(fractions, shortened | cut.any(axis=0))


class _Gains(NamedTuple):
    # (8, n) on the errors of [integral, position, velocity, tilt acceleration, its rate] and, forward through the
    # attitude loop, on the reference's [tilt acceleration, its rate, its second rate]
    pitch: np.ndarray
    roll: np.ndarray
    vertical: np.ndarray  # (3, n) on [integral, height, climb rate]
    yaw: np.ndarray  # (2, n) on [yaw, yaw rate]


def _full_gains(model, weights):
    n = len(model.mass_kg)
    wn, zeta = model.natural_frequency_rad_s, model.damping_ratio
    axes = [
        np.array([_horizontal_gain(wn[i, k], zeta[i, k], model.drag_1_s[i], weights) for i in range(n)]).T
        for k in (_ROLL, _PITCH)
    ]
    A, B = [[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]]
    height = [weights.q_height, weights.q_climb]
    vertical = _gain_with_integral(A, B, weights.q_height_integral, height, weights.r_vertical)
    yaw = [
        lqr_gain(
            [[0.0, 1.0], [0.0, -1.0 / tau]], [[0.0], [1.0 / tau]], [weights.q_yaw, weights.q_yaw_rate], [weights.r_yaw]
        )
        for tau in model.yaw_time_constant_s
    ]
    return _Gains(
        pitch=axes[_PITCH],
        roll=axes[_ROLL],
        vertical=np.repeat(vertical[:, None], n, axis=1),
        yaw=np.array(yaw)[:, 0].T,
    )


def _horizontal_gain(wn, zeta, drag_1_s, weights):
    """(8,) row of `_Gains.pitch` or `.roll` of one vehicle."""
    A = np.zeros((4, 4))
    A[0, 1] = A[1, 2] = A[2, 3] = 1.0
    A[1, 1], A[3, 2], A[3, 3] = -drag_1_s, -(wn**2), -2.0 * zeta * wn
    B = np.array([[0.0], [0.0], [0.0], [wn**2]])
    Q = [weights.q_position, weights.q_velocity, weights.q_tilt, weights.q_tilt_rate]
    feedback = _gain_with_integral(A, B, weights.q_integral, Q, weights.r_horizontal)
    # the command that makes the loop a'' = wn^2 (u - a) - 2 zeta wn a' follow a given a(t)
    return np.concatenate([feedback, [1.0, 2.0 * zeta / wn, wn**-2.0]])


def _gain_with_integral(A, B, q_integral, Q, r):
    """Gain on [integral of the first state, states]; the integral's is 0 when its weight is."""
    if q_integral == 0.0:
        return np.concatenate([[0.0], lqr_gain(A, B, Q, [r])[0]])
    A, B = with_integral(A, B, np.eye(1, len(A)))
    return lqr_gain(A, B, [q_integral] + list(Q), [r])[0]


def _turned(derivatives, psi_rad, psi_rate_rad_s, drag_1_s):
    """(3, n) tilt acceleration that the reference needs, and its first two rates, in the turning yaw frame.

    derivatives: (5, n) complex.  The tilt carries the acceleration and the drag; in a frame that turns at psi' the
    derivative of z exp(-i psi) is (z' - i psi' z) exp(-i psi). The yaw acceleration is neglected.
    """
    a = derivatives[2:] + drag_1_s * derivatives[1:4]
    w = 1j * psi_rate_rad_s
    return np.array([a[0], a[1] - w * a[0], a[2] - w * (2.0 * a[1] - w * a[0])]) * np.exp(-1j * psi_rad)


def _shortened(vector, longest):
    """Complex vectors (n,) no longer than this."""
    return vector * np.minimum(1.0, longest / np.maximum(np.abs(vector), 1e-9))


def _clipped(value, limit):
    """Value within +-limit."""
    return np.minimum(np.maximum(value, -limit), limit)


def _neu(xy):
    """Complex north + i east of cortex vectors (..., 2 or 3)."""
    return xy[..., 0] - 1j * xy[..., 1]


def _harmless(states, usable):
    """The states with zeros in the rows that mean nothing: their results are replaced, but must be finite."""
    keep = usable[:, None]
    return States(usable, *(np.where(keep, array, 0.0) for array in states[1:]))


def _rows(reference, usable):
    return np.where(usable[:, None], reference, 0.0)


def _override(value, zero_is_valid=False):
    """The value, or None when it is negative: the vehicle type's is meant. Raises ValueError for no number."""
    if not np.isfinite(value) or (value == 0.0 and not zero_is_valid):
        raise ValueError("a limit must be positive (negative: that of the vehicle type), got %r" % (value,))
    return None if value < 0.0 else float(value)
