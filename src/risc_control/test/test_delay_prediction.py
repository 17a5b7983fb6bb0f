"""Prediction ahead: against the exact loops, against the nonlinear equations of motion, what pushes the vehicle."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from risc_control.delay_prediction import (
    MAX_HORIZON_S,
    STEP_S,
    Motion,
    effective_delay_s,
    fill_in_force,
    plants,
    predicted,
    steps_of,
)
from risc_lab.command_history import CHANNELS, Channel, CommandHistory
from risc_lab.frames import GRAVITY_M_S2 as G
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab import load_vehicle_type

ARDRONE = load_vehicle_type("ardrone")
OTHER = replace(ARDRONE, roll=replace(ARDRONE.roll, natural_frequency_rad_s=9.0), drag_n_s_m=0.0)
TYPES = [ARDRONE, OTHER]
PLANTS = plants(TYPES)
NOTHING = CommandHistory(2)
REST = Motion(*[0.0] * len(Motion._fields))


def random_motion(rng):
    north, east, v_north, v_east = *rng.uniform(-1, 1, 2), *rng.uniform(-0.7, 0.7, 2)
    return Motion(
        north,
        east,
        rng.uniform(0.5, 1.5),
        v_north,
        v_east,
        rng.uniform(-0.3, 0.3),
        *rng.uniform(-0.15, 0.15, 2),
        rng.uniform(-3, 3),
        *rng.uniform(-0.5, 0.5, 2),
        rng.uniform(-0.3, 0.3),
        0.0,
    )


def ahead(motion, time_s, horizon_s, history, delay_s, i=0):
    """Motion of vehicle i after horizon_s; a command acts delay_s after it was sent."""
    plant, commands = PLANTS[i].copy(), np.empty((1 + steps_of(horizon_s), CHANNELS))
    plant.delay_s, plant.period_s = delay_s, 0.0
    fill_in_force(NOTHING.vehicles[i], history.vehicles[i], plant, time_s, commands)
    return predicted(motion, plant, horizon_s, commands)


def random_history(rng, start_s, end_s, n=2, step_s=1.0 / 30.0):
    history, commands = CommandHistory(n), []
    for time_s in np.arange(start_s, end_s, step_s):
        command = rng.uniform(-1.0, 1.0, (n, 4)) * (0.2, 0.2, 0.5, 0.3)
        for i in range(n):
            history.append(i, time_s, command[i])
        commands.append((time_s, command))
    return history, commands


def integrate(motion, i, time_s, horizon_s, delay_s, commands):
    """One vehicle by the full equations: thrust along the body axis from the climb loop, rotation matrix, drag."""
    wn = [loop.natural_frequency_rad_s for loop in (TYPES[i].roll, TYPES[i].pitch)]
    zeta = [loop.damping_ratio for loop in (TYPES[i].roll, TYPES[i].pitch)]
    climb, tau_yaw, drag = PLANTS[i].climb, PLANTS[i].yaw_time_constant_s, PLANTS[i].drag_1_s

    def command_at(t):
        held = [command for sent_s, command in commands if sent_s <= t - delay_s]
        return held[-1][i] if held else np.zeros(4)

    def slope(t, x, command):
        v, phi, phi_rate, theta, theta_rate, psi, psi_rate = x[3:6], *x[6:]
        up = rotation_body_to_cortex(phi, theta, psi) @ [0.0, 0.0, -1.0]
        climb_acceleration = climb["gain"] * command[Channel.CLIMB] - climb["damping_1_s"] * v[2]
        specific_thrust = (G + climb_acceleration) / up[2]
        a = specific_thrust * up - [drag * v[0], drag * v[1], G]
        return [
            *v,
            *a,
            phi_rate,
            wn[0] ** 2 * (command[Channel.PHI] - phi) - 2.0 * zeta[0] * wn[0] * phi_rate,
            theta_rate,
            wn[1] ** 2 * (command[Channel.THETA] - theta) - 2.0 * zeta[1] * wn[1] * theta_rate,
            psi_rate,
            (command[Channel.YAW_RATE] - psi_rate) / tau_yaw,
        ]

    m = motion
    x = [m.north_m, -m.east_m, m.up_m, m.north_m_s, -m.east_m_s, m.up_m_s]
    x += [m.phi_rad, m.phi_rate_rad_s, m.theta_rad, m.theta_rate_rad_s, m.psi_rad, m.psi_rate_rad_s]
    switches = sorted({s + delay_s for s, _ in commands if time_s < s + delay_s < time_s + horizon_s})
    edges = [time_s] + switches + [time_s + horizon_s]
    for begin, end in zip(edges, edges[1:]):
        command = command_at(0.5 * (begin + end))
        x = solve_ivp(slope, (begin, end), x, args=(command,), rtol=1e-9, atol=1e-11).y[:, -1]
    return x


@pytest.mark.parametrize(("horizon_s", "tolerance_m"), [(0.137, 2e-3), (0.34, 8e-3)])
def test_predicts_what_the_nonlinear_model_does(horizon_s, tolerance_m):
    delay_s, now_s = horizon_s - 0.006, 100.0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        motions = [random_motion(rng) for _ in range(2)]
        history, commands = random_history(rng, now_s - 0.6, now_s)
        for i, motion in enumerate(motions):
            found = ahead(motion, now_s, horizon_s, history, delay_s, i)
            x = integrate(motion, i, now_s, horizon_s, delay_s, commands)
            assert (found.north_m, -found.east_m, found.up_m) == pytest.approx(x[:3], abs=tolerance_m)
            assert (found.north_m_s, -found.east_m_s, found.up_m_s) == pytest.approx(x[3:6], abs=10 * tolerance_m)
            # the only error of the angles: commands act up to half a grid step early or late
            assert (found.phi_rad, found.theta_rad) == pytest.approx((x[6], x[8]), abs=5e-3)
            assert found.psi_rad == pytest.approx(x[10], abs=5e-3)


def test_loops_are_exact_on_the_grid():
    """Step response of the attitude loop against its closed form, after any number of whole steps."""
    wn, zeta = ARDRONE.roll.natural_frequency_rad_s, ARDRONE.roll.damping_ratio
    history = CommandHistory(2)
    history.append(0, 0.0, np.full(4, 0.1))
    for horizon_s in (0.1, 0.35, 0.8):
        found = ahead(REST, 0.2, horizon_s, history, 0.2)
        damped = wn * math.sqrt(1.0 - zeta**2)
        decay = math.exp(-zeta * wn * horizon_s)
        step = 1.0 - decay * (math.cos(damped * horizon_s) + zeta * wn / damped * math.sin(damped * horizon_s))
        assert found.phi_rad == pytest.approx(0.1 * step, abs=1e-12)
        assert found.up_m_s == pytest.approx(0.1 * (1 - math.exp(-horizon_s / ARDRONE.climb_time_constant_s)))


@pytest.mark.parametrize(
    ("psi_deg", "channel", "north", "east"),
    [
        (0, Channel.THETA, -1, 0),
        (0, Channel.PHI, 0, 1),
        (90, Channel.THETA, 0, -1),
        (90, Channel.PHI, -1, 0),
        (180, Channel.PHI, 0, -1),
        (-135, Channel.THETA, math.sqrt(0.5), math.sqrt(0.5)),
    ],
)
def test_where_a_positive_angle_goes(psi_deg, channel, north, east):
    """Nose up goes backwards, right wing down goes right, at any yaw."""
    command = np.zeros(4)
    command[channel] = 0.1
    history = CommandHistory(2)
    history.append(0, 0.0, command)
    found = ahead(REST._replace(psi_rad=math.radians(psi_deg)), 1.0, 0.3, history, 0.1)
    speed_m_s = math.hypot(found.north_m_s, found.east_m_s)
    assert (found.north_m_s / speed_m_s, found.east_m_s / speed_m_s) == pytest.approx((north, east), abs=1e-9)


def test_hover_stays():
    hover = REST._replace(north_m=0.3, east_m=-0.2, up_m=1.0)
    assert ahead(hover, 5.0, 0.2, NOTHING, 0.13) == pytest.approx(hover, abs=1e-15)


def test_a_push_that_stays_is_a_parabola_beside_it():
    commands = np.zeros((1 + steps_of(0.2), CHANNELS))
    found = predicted(REST, PLANTS[1], 0.2, commands, 0.3, -0.2)
    assert (found.north_m, found.east_m) == pytest.approx((0.5 * 0.3 * 0.04, -0.5 * 0.2 * 0.04), rel=1e-6)
    assert (found.north_m_s, found.east_m_s) == pytest.approx((0.06, -0.04), rel=1e-6)


def test_commands_count_from_when_they_act():
    history = CommandHistory(2)
    history.append(0, 1.0, np.full(4, 0.1))
    before, after = (ahead(REST, 1.0, horizon_s, history, 0.1) for horizon_s in (0.1, 0.15))
    assert before.phi_rad == 0.0 < after.phi_rad


def test_horizon_between_grid_points_is_smooth():
    rng = np.random.default_rng(5)
    motion, (history, _) = random_motion(rng), random_history(rng, 0.0, 1.0)
    positions = [ahead(motion, 1.0, h, history, 0.13)[:3] for h in np.arange(0.1, 0.2, 0.0005)]
    assert np.abs(np.diff(positions, 2, axis=0)).max() < 2e-5


@pytest.mark.parametrize("horizon_s", [-0.01, MAX_HORIZON_S + 0.1, math.nan])
def test_impossible_horizons(horizon_s):
    with pytest.raises(ValueError, match="prediction horizon"):
        ahead(REST, 0.0, horizon_s, NOTHING, 0.1)


def in_force(sent, computed, stamp_s, steps=30):
    """(1 + steps, 4) commands by which an AR.Drone is predicted from stamp_s on."""
    commands = np.empty((1 + steps, CHANNELS))
    fill_in_force(sent.vehicles[0], computed.vehicles[0], PLANTS[0], stamp_s, commands)
    return commands


def test_what_was_really_sent_counts_up_to_a_period_after_the_newest_then_what_was_computed():
    """A link of 0.1 s, on average half a period until the next send, and half a period for which a command holds."""
    sent, computed, period_s = CommandHistory(1), CommandHistory(1), 1.0 / ARDRONE.command_rate_hz
    for k in range(200):  # up to 10.0
        computed.append(0, 9.005 + 0.005 * k, np.full(4, 9.005 + 0.005 * k))
    sent_s = (9.88, 9.915, 9.95)
    for time_s in sent_s:
        sent.append(0, time_s, np.full(4, -time_s))
    now_s = 10.0
    found = in_force(sent, computed, now_s)[:, 0]
    for step, value in enumerate(found):
        time_s = now_s + STEP_S * (step - 0.5) - 0.1 - 0.5 * period_s  # when what is in force was sent
        if time_s < sent_s[-1] + period_s:
            assert value == -max(s for s in sent_s if s <= time_s)
        else:
            latest_s = time_s - 0.5 * period_s
            assert value == pytest.approx(min(10.0, 0.005 * math.floor(latest_s / 0.005 + 1e-6)))


def test_without_word_of_what_was_sent_each_command_that_was_computed_counts_after_the_mean_delay():
    rng, computed = np.random.default_rng(3), CommandHistory(1)
    for k in range(100):
        computed.append(0, 0.005 * k, rng.standard_normal(4))
    found = in_force(NOTHING, computed, 0.5)
    delay_s = effective_delay_s(ARDRONE)
    wanted = [computed.at(0, 0.5 + STEP_S * (step - 0.5) - delay_s) for step in range(len(found))]
    assert found.tolist() == np.array(wanted).tolist()


def test_effective_delay():
    assert effective_delay_s(ARDRONE) == pytest.approx(0.1 + 1.0 / 30.0)
    assert effective_delay_s(replace(ARDRONE, command_delay_s=0.3)) == pytest.approx(0.3 + 1.0 / 30.0)
    for wrong in (-0.1, 2.0, math.nan):
        with pytest.raises(ValueError, match="command.delay"):
            effective_delay_s(replace(ARDRONE, command_delay_s=wrong))
