"""Equations 6.1-6.4 and the on-board loops against independent longhand, closed forms and conservation laws."""

import dataclasses

import numpy as np
import pytest

from risc_lab.compiled import record
from risc_lab.frames import GRAVITY_M_S2, euler_rates_from_body_rates, rotation_body_to_ned
from risc_lab.lab import AttitudeLoop, VehicleType
from risc_simulator.models.integrator import integrator
from risc_simulator.models.perturbed_plant import fill_records, nominal_plant
from risc_simulator.models.quadrotor import QUADROTOR_FIELDS, U, X

ARDRONE = VehicleType(
    name="ardrone",
    mass_kg=0.45,
    inertia_kg_m2=(0.0022, 0.0030, 0.0048),
    radius_m=0.25,
    roll=AttitudeLoop(5.8, 0.74, 1.17),
    pitch=AttitudeLoop(5.6, 0.61, 1.11),
    yaw_rate_time_constant_s=0.1,
    climb_time_constant_s=0.3,
    tilt_max_rad=0.35,
    yaw_rate_max_rad_s=0.35,
    climb_max_m_s=1.0,
    command_delay_s=0.1,
    command_rate_hz=30.0,
    drag_n_s_m=0.1,
    battery_life_s=720.0,
)
PLANT = nominal_plant(ARDRONE)
NO_DRAG = dataclasses.replace(PLANT, drag_n_s_m=0.0)


def inputs(n=1, **rows):
    u = np.zeros((len(U), n))
    u[U.MOTORS] = 1.0
    for name, value in rows.items():
        u[U[name]] = value
    return u


def stack_plants(plants):
    bodies = np.zeros(len(plants), dtype=record(*QUADROTOR_FIELDS))
    fill_records(bodies, plants)
    return bodies


def advance(x, u, bodies, step_s):
    """Advance all vehicles by one step, in the air, without floor or net."""
    n, nowhere = x.shape[1], (1e9, 1e9, 2e9)
    flags, columns = np.ones((2, n), dtype=bool), np.arange(n, dtype=np.uintp)
    integrator().advance(x, u, flags, columns, bodies, step_s, nowhere)


def derivative(x, u, bodies):
    """x_dot (12, n)."""
    return evaluate(x, u, bodies)[0]


def evaluate(x, u, bodies):
    """x_dot (12, n) and the demanded thrusts (n,)."""
    x_dot, thrust_n = np.empty_like(x), np.empty(x.shape[1])
    integrator().differentiate(x, u, np.arange(x.shape[1], dtype=np.uintp), bodies, x_dot, thrust_n)
    return x_dot, thrust_n


def fly(plant, x, u, duration_s, step_s=0.005):
    """Fly from x (12,) with constant inputs u. Returns the final state and the history (steps + 1, 12)."""
    bodies = stack_plants([plant])
    state = np.array(x, dtype=float)[:, None]
    history = [state[:, 0].copy()]
    for _ in range(int(round(duration_s / step_s))):
        advance(state, u, bodies, step_s)
        history.append(state[:, 0].copy())
    return state[:, 0], np.array(history)


def longhand(x, u, plant):
    """The same right-hand side in vector form: Newton and Euler in a rotating frame, written independently."""
    angles, omega, velocity = x[X.PHI : X.PSI + 1], x[X.P : X.R + 1], x[X.U : X.W + 1]
    R = rotation_body_to_ned(*angles)
    velocity_ned = R @ velocity
    wind_ned = np.array([u[U.WIND_N], u[U.WIND_E], -u[U.WIND_UP]])
    climb = -velocity_ned[2]
    thrust = (
        plant.nominal_mass_kg
        * ((u[U.CLIMB] - climb) / plant.climb_time_constant_s + u[U.CLIMB_TRIM] + GRAVITY_M_S2)
        / R[2, 2]
    )
    thrust = np.clip(thrust, plant.thrust_min_n, plant.thrust_max_n) * plant.thrust_scale * u[U.MOTORS]
    force = (
        np.array([0.0, 0.0, -thrust])
        + R.T @ [0, 0, plant.mass_kg * GRAVITY_M_S2]
        - plant.drag_n_s_m * (velocity - R.T @ wind_ned)
    )
    inertia = np.diag(plant.inertia_kg_m2)
    moment = -np.cross(omega, inertia @ omega)
    if u[U.MOTORS]:
        wanted = [
            plant.roll.natural_frequency_rad_s**2 * (plant.roll.gain * u[U.ROLL] - angles[0])
            - 2 * plant.roll.damping_ratio * plant.roll.natural_frequency_rad_s * omega[0],
            plant.pitch.natural_frequency_rad_s**2 * (plant.pitch.gain * u[U.PITCH] - angles[1])
            - 2 * plant.pitch.damping_ratio * plant.pitch.natural_frequency_rad_s * omega[1],
            (u[U.YAW_RATE] - omega[2]) / plant.yaw_rate_time_constant_s,
        ]
    else:
        wanted = -6.0 * omega
    moment = moment + inertia @ np.array(wanted)
    north, east, down = velocity_ned
    return np.concatenate(
        [
            [north, east, -down],
            force / plant.mass_kg - np.cross(omega, velocity),
            euler_rates_from_body_rates(angles[0], angles[1], *omega),
            np.linalg.solve(inertia, moment),
        ]
    )


def random_case(rng, n):
    x = rng.normal(size=(12, n))
    x[X.PHI : X.PSI + 1] = rng.uniform(-1.2, 1.2, (3, n))
    u = rng.normal(size=(len(U), n)) * 0.4
    u[U.MOTORS] = rng.integers(0, 2, n)
    return x, u


def random_plants(rng, n):
    return [
        dataclasses.replace(
            PLANT,
            mass_kg=rng.uniform(0.3, 2),
            inertia_kg_m2=tuple(rng.uniform(0.001, 0.01, 3)),
            thrust_scale=rng.uniform(0.9, 1.1),
            drag_n_s_m=rng.uniform(0, 0.5),
            roll=AttitudeLoop(*rng.uniform(0.5, 5, 3)),
            pitch=AttitudeLoop(*rng.uniform(0.5, 5, 3)),
        )
        for _ in range(n)
    ]


def test_derivative_equals_longhand():
    rng = np.random.default_rng(1)
    plants = random_plants(rng, 200)
    x, u = random_case(rng, 200)
    x_dot = derivative(x, u, stack_plants(plants))
    expected = np.stack([longhand(x[:, i], u[:, i], plants[i]) for i in range(200)], axis=1)
    np.testing.assert_allclose(x_dot, expected, rtol=1e-10, atol=1e-10)


def test_hover_is_an_equilibrium_at_any_heading():
    for psi in np.linspace(-3, 3, 7):
        x = np.zeros((12, 1))
        x[X.H], x[X.PSI] = 1.0, psi
        assert np.abs(derivative(x, inputs(), stack_plants([PLANT]))).max() < 1e-12


def test_gyroscopic_terms_have_the_products_of_euler():
    """6.4: p' from q r, q' from p r, r' from p q (the print has q r three times)."""
    j_x, j_y, j_z = PLANT.inertia_kg_m2
    stopped = inputs(MOTORS=0.0)
    for rates, row, expected in (
        ((0, 2, 3), X.P, (j_y - j_z) / j_x * 6),
        ((2, 0, 3), X.Q, (j_z - j_x) / j_y * 6),
        ((2, 3, 0), X.R, (j_x - j_y) / j_z * 6),
    ):
        x = np.zeros((12, 1))
        x[X.P : X.R + 1, 0] = rates
        assert derivative(x, stopped, stack_plants([PLANT]))[row, 0] == pytest.approx(expected, rel=1e-12)


def test_free_fall_and_energy():
    x = np.zeros(12)
    x[X.H], x[X.U], x[X.V], x[X.THETA], x[X.PSI] = 2.0, 1.0, -0.5, 0.2, 0.7
    _, history = fly(NO_DRAG, x, inputs(MOTORS=0.0), 0.5)
    velocities = history[:, X.U : X.W + 1]
    energy = 0.5 * (velocities**2).sum(axis=1) + GRAVITY_M_S2 * history[:, X.H]
    assert np.ptp(energy) < 1e-9
    climb_0 = -(rotation_body_to_ned(*x[X.PHI : X.PSI + 1]) @ x[X.U : X.W + 1])[2]
    assert history[-1, X.H] == pytest.approx(2.0 + climb_0 * 0.5 - 0.5 * GRAVITY_M_S2 * 0.25, abs=1e-9)


def test_angular_momentum_of_a_free_body_is_kept():
    """Without loops and damping the inertial angular momentum is constant: 6.3 and 6.4 together."""
    bodies = stack_plants([NO_DRAG])
    bodies["tumble_damping_1_s"] = 0.0
    x = np.zeros((12, 1))
    x[X.P : X.R + 1, 0] = 1.0, -0.7, 2.0

    def momentum():
        omega = x[X.P : X.R + 1, 0]
        return rotation_body_to_ned(*x[X.PHI : X.PSI + 1, 0]) @ (np.array(PLANT.inertia_kg_m2) * omega)

    before = momentum()
    for _ in range(200):
        advance(x, inputs(MOTORS=0.0), bodies, 0.002)
    np.testing.assert_allclose(momentum(), before, rtol=1e-7)


def second_order_step(loop, command, t):
    """Closed form of angle'' = wn^2 (gain c - angle) - 2 zeta wn angle' from rest (zeta < 1)."""
    wn, zeta = loop.natural_frequency_rad_s, loop.damping_ratio
    wd = wn * np.sqrt(1 - zeta**2)
    return loop.gain * command * (1 - np.exp(-zeta * wn * t) * (np.cos(wd * t) + zeta * wn / wd * np.sin(wd * t)))


@pytest.mark.parametrize("row, angle, loop", [("ROLL", X.PHI, ARDRONE.roll), ("PITCH", X.THETA, ARDRONE.pitch)])
def test_attitude_step_follows_the_loop(row, angle, loop):
    _, history = fly(PLANT, np.zeros(12), inputs(**{row: 0.1}), 2.0)
    t = np.arange(len(history)) * 0.005
    np.testing.assert_allclose(history[:, angle], second_order_step(loop, 0.1, t), atol=1e-7)


def test_yaw_rate_and_climb_are_first_order_lags():
    x, history = fly(PLANT, np.zeros(12), inputs(YAW_RATE=0.3), 1.0)
    t = np.arange(len(history)) * 0.005
    np.testing.assert_allclose(history[:, X.R], 0.3 * (1 - np.exp(-t / 0.1)), atol=1e-7)
    assert x[X.PSI] > 0.2  # + is clockwise seen from above
    _, history = fly(NO_DRAG, np.zeros(12), inputs(CLIMB=0.5), 2.0)
    np.testing.assert_allclose(-history[:, X.W], 0.5 * (1 - np.exp(-np.arange(401) * 0.005 / 0.3)), atol=1e-7)


def test_climb_is_held_while_tilted():
    """The climb loop divides by cos(phi) cos(theta): a tilt costs no height."""
    _, history = fly(NO_DRAG, np.zeros(12), inputs(PITCH=-0.3, ROLL=0.2), 1.5)
    assert np.abs(history[:, X.H]).max() < 1e-6


def test_trim_and_wrong_thrust():
    """A thrust 3 % too weak leaves climb = -0.03 g tau; the trim that makes up for it is exactly known."""
    weak = dataclasses.replace(NO_DRAG, thrust_scale=0.97)
    x, _ = fly(weak, np.zeros(12), inputs(), 4.0)
    assert -x[X.W] == pytest.approx(-0.03 / 0.97 * GRAVITY_M_S2 * 0.3, rel=1e-3)
    x, _ = fly(weak, np.zeros(12), inputs(CLIMB_TRIM=(1 / 0.97 - 1) * GRAVITY_M_S2), 4.0)
    assert abs(x[X.W]) < 1e-9


def test_thrust_has_limits():
    for climb, expected in ((100.0, PLANT.thrust_max_n), (-100.0, PLANT.thrust_min_n)):
        x_dot, thrust_n = evaluate(np.zeros((12, 1)), inputs(CLIMB=climb), stack_plants([PLANT]))
        assert x_dot[X.W, 0] == pytest.approx(GRAVITY_M_S2 - expected / PLANT.mass_kg)
        assert thrust_n[0] == pytest.approx(expected)


@pytest.mark.parametrize(
    "psi, north_east", [(0.0, (1, 0)), (np.pi / 2, (0, 1)), (np.pi, (-1, 0)), (-np.pi / 2, (0, -1))]
)
def test_nose_down_flies_along_the_heading_and_right_wing_down_to_the_right(psi, north_east):
    x = np.zeros(12)
    x[X.PSI] = psi
    end, _ = fly(PLANT, x, inputs(PITCH=-0.1), 1.0)
    move = end[:2] / np.linalg.norm(end[:2])
    np.testing.assert_allclose(move, north_east, atol=1e-6)
    end, _ = fly(PLANT, x, inputs(ROLL=0.1), 1.0)
    np.testing.assert_allclose(end[:2] / np.linalg.norm(end[:2]), (-north_east[1], north_east[0]), atol=1e-6)


def test_wind_carries_the_vehicle_to_its_own_speed():
    x, _ = fly(PLANT, np.zeros(12), inputs(WIND_N=0.5, WIND_E=-0.3), 60.0)
    ned = rotation_body_to_ned(*x[X.PHI : X.PSI + 1]) @ x[X.U : X.W + 1]
    np.testing.assert_allclose(ned[:2], (0.5, -0.3), atol=1e-4)


AGILE_START = np.array([0.3, -0.2, 1.0, 0.8, -0.5, 0.2, 0.25, -0.3, 1.0, 1.0, -1.2, 0.4])
AGILE_INPUT = inputs(ROLL=-0.35, PITCH=0.35, YAW_RATE=1.0, CLIMB=1.0, WIND_N=0.4)


def test_integration_is_of_fourth_order_and_the_step_is_small_enough():
    """Halving the step divides the error by 16; at 5 ms it is far below the 2 mm noise of motion capture."""
    reference, _ = fly(PLANT, AGILE_START, AGILE_INPUT, 1.0, 0.000625)
    errors = [
        np.abs(fly(PLANT, AGILE_START, AGILE_INPUT, 1.0, step)[0] - reference).max() for step in (0.02, 0.01, 0.005)
    ]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all((orders > 3.7) & (orders < 4.3)), (errors, orders)
    position_error_m = np.abs(fly(PLANT, AGILE_START, AGILE_INPUT, 1.0, 0.005)[0] - reference)[:3].max()
    assert position_error_m < 1e-7  # after a second of full deflection


def test_vehicles_do_not_see_each_other():
    """Order and number of columns change no bit of a vehicle's path."""
    rng = np.random.default_rng(5)
    plants = random_plants(rng, 7)
    x, u = random_case(rng, 7)
    u[U.MOTORS] = 1.0
    x[X.PHI : X.PSI + 1] *= 0.2

    def paths(columns):
        bodies = stack_plants([plants[i] for i in columns])
        inputs_of, state = np.ascontiguousarray(u[:, columns]), np.ascontiguousarray(x[:, columns])
        for _ in range(50):
            advance(state, inputs_of, bodies, 0.005)
        return state

    together = paths(list(range(7)))
    order = [3, 0, 6, 2, 5, 1, 4]
    np.testing.assert_array_equal(paths(order), together[:, order])
    np.testing.assert_array_equal(paths([4]), together[:, [4]])


def test_bad_parameters_are_refused():
    with pytest.raises(ValueError, match="mass_kg"):
        dataclasses.replace(PLANT, mass_kg=0.0)
