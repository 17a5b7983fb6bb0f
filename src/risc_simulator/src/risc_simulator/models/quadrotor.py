"""Quadrotor: equations 6.1-6.4 with the on-board loops, for any number of vehicles in one call.

State (12, n): one row per quantity (enum X), one column per vehicle. Position is North, East, Up; velocity is in body
axes (forward, right, down); angles are NED Euler angles (roll + right wing down, pitch + nose up, yaw + clockwise from
above). Input (9, n): enum U.

The equations stand below as text, as a reader would write them on paper, and are compiled once into index tables: the
right-hand side is then one gather, three products and one sum, whatever the number of vehicles. A numpy call costs far
more than the arithmetic of a few vehicles, so this is several times faster than one call for each operation.
"""

from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

import numpy as np

from risc_control.frames import GRAVITY_M_S2


class X(IntEnum):
    """Rows of the state."""

    P_N = 0  # [m] north
    P_E = 1  # [m] east
    H = 2  # [m] up
    U = 3  # [m/s] body forward
    V = 4  # [m/s] body right
    W = 5  # [m/s] body down
    PHI = 6  # [rad] roll
    THETA = 7  # [rad] pitch
    PSI = 8  # [rad] yaw, not wrapped
    P = 9  # [rad/s] body rates
    Q = 10
    R = 11


class U(IntEnum):
    """Rows of the input."""

    ROLL = 0  # [rad] commanded roll angle
    PITCH = 1  # [rad] commanded pitch angle
    YAW_RATE = 2  # [rad/s] commanded yaw rate, + clockwise from above
    CLIMB = 3  # [m/s] commanded vertical speed, + up
    CLIMB_TRIM = 4  # [m/s^2] what the slow on-board integral adds to the vertical acceleration
    MOTORS = 5  # 1: running, the loops are closed; 0: stopped, no thrust and no moments
    WIND_N = 6  # [m/s] velocity of the air
    WIND_E = 7
    WIND_UP = 8


@dataclass(frozen=True)
class QuadrotorParams:
    """What the equations need to know of each vehicle. Every field: (n,) array.

    The loops: commanded angle c gives angle'' = wn^2 (gain c - angle) - 2 zeta wn angle'; yaw rate and vertical speed
    follow their commands as first-order lags.
    """

    mass_kg: np.ndarray  # true mass
    nominal_mass_kg: np.ndarray  # mass that the on-board climb loop believes in
    thrust_scale: np.ndarray  # true thrust / demanded thrust
    inertia_x_kg_m2: np.ndarray
    inertia_y_kg_m2: np.ndarray
    inertia_z_kg_m2: np.ndarray
    roll_natural_frequency_rad_s: np.ndarray
    roll_damping_ratio: np.ndarray
    roll_gain: np.ndarray
    pitch_natural_frequency_rad_s: np.ndarray
    pitch_damping_ratio: np.ndarray
    pitch_gain: np.ndarray
    yaw_rate_time_constant_s: np.ndarray
    climb_time_constant_s: np.ndarray
    drag_n_s_m: np.ndarray  # linear drag force per velocity relative to the air
    thrust_min_n: np.ndarray  # range of the demanded thrust while the motors run
    thrust_max_n: np.ndarray
    tumble_damping_1_s: np.ndarray  # air damping of the body rates while the motors stand

    def __post_init__(self):
        shapes = {name: np.shape(value) for name, value in vars(self).items()}
        if len(set(shapes.values())) != 1 or len(np.shape(self.mass_kg)) != 1:
            raise ValueError("QuadrotorParams fields must all have one shape (n,), got %r" % (shapes,))
        for name in (
            "mass_kg",
            "nominal_mass_kg",
            "inertia_x_kg_m2",
            "inertia_y_kg_m2",
            "inertia_z_kg_m2",
            "yaw_rate_time_constant_s",
            "climb_time_constant_s",
        ):
            if not np.all(getattr(self, name) > 0.0):
                raise ValueError("%s must be positive, got %r" % (name, getattr(self, name)))


# Names that the equations may use, in the order of the rows of the work array:
# the state; sines and cosines of phi (f), theta (t), psi (ps); sec_t = 1/ct; then what is constant over a step.
_STATE = ["pn", "pe", "h", "u", "v", "w", "phi", "theta", "psi", "p", "q", "r"]
_TRIG = ["sf", "st", "sps", "cf", "ct", "cps", "sec_t"]
_CONSTANT = [
    "one",
    "g",
    "drag",
    "air_n",
    "air_e",
    "air_up",
    "j_x",
    "j_y",
    "j_z",
    "drive_p",
    "drive_q",
    "drive_r",
    "stiff_p",
    "stiff_q",
    "damp_p",
    "damp_q",
    "damp_r",
]
_ROW = {name: row for row, name in enumerate(_STATE + _TRIG + _CONSTANT)}

# Thrust is not in the table: it depends on h' and has limits; `- thrust/m` is added to w' afterwards.
# drag = drag_n_s_m/m; air_* = drag * wind; j_* = the inertia ratios of 6.4;
# drive, stiff, damp = the attitude loops' moments divided by the inertia (wn^2 gain c, wn^2, 2 zeta wn).
_EQUATIONS = """
pn    = + u ct cps + v sf st cps - v cf sps + w cf st cps + w sf sps                                      (6.1)
pe    = + u ct sps + v sf st sps + v cf cps + w cf st sps - w sf cps
h     = + u st - v sf ct - w cf ct
u     = + v r - w q - g st       - drag u + air_n ct cps + air_e ct sps + air_up st                       (6.2)
v     = + w p - u r + g ct sf    - drag v + air_n sf st cps - air_n cf sps + air_e sf st sps + air_e cf cps - air_up sf ct
w     = + u q - v p + g ct cf    - drag w + air_n cf st cps + air_n sf sps + air_e cf st sps - air_e sf cps - air_up cf ct
phi   = + p + q sf st sec_t + r cf st sec_t                                                               (6.3)
theta = + q cf - r sf
psi   = + q sf sec_t + r cf sec_t
p     = + j_x q r + drive_p - stiff_p phi   - damp_p p                                                    (6.4)
q     = + j_y p r + drive_q - stiff_q theta - damp_q q
r     = + j_z p q + drive_r                 - damp_r r
"""  # noqa: E501 (one equation per line reads better than 120 columns)
_MAX_FACTORS = 4


@lru_cache(maxsize=None)
def _compile_equations():
    """The text as tables: factors (4, k) rows of the work array for each of the k terms, signs (k,), and
    starts (12,), the first term of each equation. Shorter products are filled up with the row `one`."""
    factors, signs, starts = [], [], []
    lines = [line.split("(6.")[0] for line in _EQUATIONS.strip().splitlines()]
    for state, line in zip(_STATE, lines):
        left, right = line.split("=")
        if left.strip() != state:
            raise ValueError("equation %r stands where that of %r belongs" % (left.strip(), state))
        starts.append(len(signs))
        for word in right.split():
            if word in "+-":
                signs.append(1.0 if word == "+" else -1.0)
                factors.append([])
            else:
                factors[-1].append(_ROW[word])
    filled = [term + [_ROW["one"]] * (_MAX_FACTORS - len(term)) for term in factors]
    return np.array(filled, dtype=np.intp).T.copy(), np.array(signs), np.array(starts, dtype=np.intp)


class Quadrotors(object):
    """n vehicles: derivative and integration. Holds work arrays, so use one object per thread.

    load_inputs(u) is separate from advance(): most steps of a flight repeat the inputs of the step before.
    """

    def __init__(self, params):
        """params: QuadrotorParams of n vehicles."""
        self.params = params
        self.n = n = len(params.mass_kg)
        self._thrust_ratio = params.thrust_scale / params.mass_kg
        self._climb_stiffness = params.nominal_mass_kg / params.climb_time_constant_s
        roll_wn, pitch_wn = params.roll_natural_frequency_rad_s, params.pitch_natural_frequency_rad_s
        self._nominal_weight_n = params.nominal_mass_kg * GRAVITY_M_S2
        self._drive_gain = np.array(
            [roll_wn**2 * params.roll_gain, pitch_wn**2 * params.pitch_gain, 1.0 / params.yaw_rate_time_constant_s]
        )
        loops_closed = np.array(
            [
                roll_wn**2,
                pitch_wn**2,
                2.0 * params.roll_damping_ratio * roll_wn,
                2.0 * params.pitch_damping_ratio * pitch_wn,
                1.0 / params.yaw_rate_time_constant_s,
            ]
        )
        self._loops_open = np.array([np.zeros(n)] * 2 + [params.tumble_damping_1_s] * 3)
        self._loops_closed_minus_open = loops_closed - self._loops_open

        factors, signs, self._starts = _compile_equations()
        k = len(signs)
        self._factors = factors
        self._signs = np.repeat(signs[:, None], n, axis=1)  # full size: numpy broadcasts slowly
        self._gathered = np.empty((_MAX_FACTORS, k, n))
        self._factor_planes = tuple(self._gathered)
        self._terms = np.empty((k, n))

        self._work = work = np.zeros((len(_ROW), n))

        def rows(first, last):
            return work[_ROW[first] : _ROW[last] + 1]

        self._x = rows("pn", "r")
        self._angles = rows("phi", "psi")
        self._sines, self._cosines = rows("sf", "sps"), rows("cf", "cps")
        self._cos_phi, self._cos_theta, self._sec_theta = (work[_ROW[name]] for name in ("cf", "ct", "sec_t"))
        self._drive, self._loops = rows("drive_p", "drive_r"), rows("stiff_p", "damp_r")
        self._air = rows("air_n", "air_up")
        work[_ROW["one"]] = 1.0
        work[_ROW["g"]] = GRAVITY_M_S2
        work[_ROW["drag"]] = params.drag_n_s_m / params.mass_kg
        j_x, j_y, j_z = params.inertia_x_kg_m2, params.inertia_y_kg_m2, params.inertia_z_kg_m2
        work[_ROW["j_x"]] = (j_y - j_z) / j_x
        work[_ROW["j_y"]] = (j_z - j_x) / j_y
        work[_ROW["j_z"]] = (j_x - j_y) / j_z

        self._climb_force = np.empty(n)  # thrust demanded at h' = 0 and level
        self._motors_ratio = np.empty(n)
        self._climb_force_untrimmed = np.empty(n)
        self.demanded_thrust_n = np.empty(n)  # within the limits, at the last evaluation
        self._lean = np.empty(n)
        self._slope_rows = [(s, s[X.H], s[X.W]) for s in np.empty((4, 12, n))]
        self._change = np.empty((12, n))
        self._step_s = None
        self._fractions = np.empty((3, 12, n))  # of the step, full size: numpy is slow with scalars
        self._fraction_planes = tuple(self._fractions)
        self.load_inputs(np.zeros((len(U), n)))

    def load_inputs(self, u):
        """Use the inputs u (9, n), rows as in enum U, from now on."""
        motors = u[U.MOTORS]
        np.multiply(self._drive_gain, u[U.ROLL : U.YAW_RATE + 1], out=self._drive)
        self._drive *= motors
        np.multiply(self._loops_closed_minus_open, motors, out=self._loops)
        self._loops += self._loops_open
        np.multiply(u[U.WIND_N : U.WIND_UP + 1], self._work[_ROW["drag"]], out=self._air)
        np.multiply(self._climb_stiffness, u[U.CLIMB], out=self._climb_force_untrimmed)
        self._climb_force_untrimmed += self._nominal_weight_n
        self.load_climb_trim(u[U.CLIMB_TRIM])
        np.multiply(self._thrust_ratio, motors, out=self._motors_ratio)

    def load_climb_trim(self, trim_m_s2):
        """Use the climb trim (n,) from now on, all other inputs as before."""
        np.multiply(self.params.nominal_mass_kg, trim_m_s2, out=self._climb_force)
        self._climb_force += self._climb_force_untrimmed

    @property
    def climb_rate_m_s(self):
        """(n,) h' at the state that the last call of derivative() or advance() started from. A view: copy to keep."""
        return self._slope_rows[0][1]

    def _evaluate(self, out, out_h, out_w):
        """Derivative of the state in self._x, written to out (12, n); out_h, out_w are its rows H and W."""
        np.sin(self._angles, out=self._sines)
        np.cos(self._angles, out=self._cosines)
        np.reciprocal(self._cos_theta, out=self._sec_theta)
        first, second, third, fourth = self._factor_planes
        self._work.take(self._factors, axis=0, out=self._gathered, mode="clip")
        np.multiply(first, second, out=first)
        np.multiply(third, fourth, out=third)
        np.multiply(first, third, out=self._terms)
        np.multiply(self._terms, self._signs, out=self._terms)
        np.add.reduceat(self._terms, self._starts, axis=0, out=out)
        # climb loop: thrust = m_nominal ((climb_c - h')/tau + trim + g) / (cos phi cos theta), within the motors' range
        thrust, lean = self.demanded_thrust_n, self._lean
        np.multiply(self._climb_stiffness, out_h, out=thrust)
        np.subtract(self._climb_force, thrust, out=thrust)
        np.multiply(self._cos_phi, self._cos_theta, out=lean)
        np.divide(thrust, lean, out=thrust)
        np.maximum(thrust, self.params.thrust_min_n, out=thrust)
        np.minimum(thrust, self.params.thrust_max_n, out=thrust)
        np.multiply(thrust, self._motors_ratio, out=lean)
        np.subtract(out_w, lean, out=out_w)

    def derivative(self, x):
        """x_dot (12, n) of the state x (12, n) under the loaded inputs, units of X per second."""
        self._x[...] = x
        self._evaluate(*self._slope_rows[0])
        return self._slope_rows[0][0].copy()

    def advance(self, x, step_s):
        """One step of the classical fourth-order Runge-Kutta method, inputs held. x (12, n) is changed in place."""
        if step_s != self._step_s:
            self._step_s = step_s
            self._fractions[...] = np.array([0.5, 1.0, 1.0 / 6.0])[:, None, None] * step_s
        half, whole, sixth = self._fraction_planes
        rows_1, rows_2, rows_3, rows_4 = self._slope_rows
        k1, k2, k3, k4 = rows_1[0], rows_2[0], rows_3[0], rows_4[0]
        work_x, change, evaluate = self._x, self._change, self._evaluate
        work_x[...] = x
        evaluate(*rows_1)
        for slope, reach_s, rows in ((k1, half, rows_2), (k2, half, rows_3), (k3, whole, rows_4)):
            np.multiply(slope, reach_s, out=change)
            np.add(x, change, out=work_x)
            evaluate(*rows)
        np.add(k2, k3, out=change)  # elementwise on purpose: a BLAS product may round by the number of vehicles
        change += change
        change += k1
        change += k4
        change *= sixth
        x += change


def derivative(x, u, params):
    """x_dot = f(x, u, params): equations 6.1-6.4 (corrected products in 6.4) with the on-board loops.

    x: (12, n) state, rows X. u: (9, n) inputs, rows U. params: QuadrotorParams of n vehicles. Returns (12, n).
    """
    vehicles = Quadrotors(params)
    vehicles.load_inputs(np.asarray(u, dtype=float))
    return vehicles.derivative(x)
