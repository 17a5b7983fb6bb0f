"""Delay compensation of a fleet: states one command delay later, compared to integrated motion."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from risc_control.delay_prediction import STEP_S
from risc_control.lag_compensator import LagCompensator
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab import load_vehicle_type
from risc_lab.states import S, States

ARDRONE = replace(load_vehicle_type("ardrone"), drag_n_s_m=0.0)  # the prediction keeps the initial drag
LATER = replace(ARDRONE, command_delay_s=0.3)
TYPES = [ARDRONE, LATER]
STAMP_S = 10.0
PERIOD_S = 1.0 / ARDRONE.command_rate_hz


def behind_s(kind):
    """Mean time [s] from a command to its effect: it waits for the next send to the vehicle."""
    return kind.command_delay_s + 0.5 * PERIOD_S


def states(visible=(True, True)):
    rng = np.random.default_rng(1)
    x = np.hstack([rng.uniform(-1, 1, (2, 3)), rng.uniform(-0.5, 0.5, (2, 3)), rng.uniform(-0.15, 0.15, (2, 6))])
    x[:, S.Z] += 1.5
    x[:, S.PSI] = 2.0, -3.1
    return States(np.array(visible), x)


def filled(compensator, i=None, until_s=STAMP_S):
    """Fill in commands up to a time, of all vehicles or of one; return them as a function of time.

    They take effect at grid points of the prediction.
    """
    rng = np.random.default_rng(2)
    times_s = np.arange(STAMP_S - behind_s(ARDRONE) - 200 * STEP_S, until_s, 7 * STEP_S)
    commands = rng.uniform(-0.15, 0.15, (len(times_s), 4))
    for k in range(2) if i is None else [i]:
        for time_s, command in zip(times_s, commands):
            compensator.sent.append(k, time_s, command)
    return lambda time_s: commands[np.searchsorted(times_s, time_s, side="right") - 1]


def integrated(x, kind, horizon_s, command_at):
    """State after a time by the equations of motion in cortex axes: x forward, y left, z up, NED angles."""

    def slope(t, y):
        u, v, w, phi, theta, psi, p, q, r = y[3:]
        c = command_at(t)
        up = (c[2] - w) / kind.climb_time_constant_s
        forward, right = -(GRAVITY_M_S2 + up) * math.tan(theta), (GRAVITY_M_S2 + up) * math.tan(phi) / math.cos(theta)
        a = math.cos(psi) * forward - math.sin(psi) * right, -math.sin(psi) * forward - math.cos(psi) * right, up
        angular = []
        for value, rate, wanted, loop in ((phi, p, c[0], kind.roll), (theta, q, c[1], kind.pitch)):
            wn = loop.natural_frequency_rad_s
            angular.append(wn**2 * (wanted - value) - 2.0 * loop.damping_ratio * wn * rate)
        angular.append((c[3] - r) / kind.yaw_rate_time_constant_s)
        return [u, v, w, *a, p, q, r, *angular]

    return solve_ivp(slope, (0.0, horizon_s), x, max_step=0.002, rtol=1e-8).y[:, -1]


def test_a_vehicle_is_where_its_commands_take_it():
    """Commands up to now; age of the states 10 ms; from now on the last command is assumed to hold."""
    compensator, age_s = LagCompensator(TYPES), 0.01
    command_at, given = filled(compensator, until_s=STAMP_S + age_s), states()
    found = compensator.ahead(STAMP_S, STAMP_S + age_s, given)
    for i, kind in enumerate(TYPES):
        delay_s = compensator.delay_s[i]
        assert delay_s == pytest.approx(kind.command_delay_s + PERIOD_S)
        begin_s = STAMP_S - behind_s(kind)
        expected = integrated(given.x[i], kind, age_s + delay_s, lambda t, begin_s=begin_s: command_at(begin_s + t))
        off = found.x[i] - expected
        off[S.PSI] = math.remainder(off[S.PSI], 2.0 * math.pi)
        np.testing.assert_allclose(off[: S.P], 0.0, atol=2e-4)
        np.testing.assert_allclose(off[S.P :], 0.0, atol=1e-2)
        assert np.linalg.norm((found.x[i] - given.x[i])[:3]) > 0.02, "it does move"
    assert (np.abs(found.x[:, S.PSI]) <= math.pi).all()
    assert found.visible.all()


def test_who_is_not_seen_or_not_commanded_stays_as_he_is():
    compensator, given = LagCompensator(TYPES), states((False, True))
    np.testing.assert_array_equal(compensator.ahead(STAMP_S, STAMP_S, given).x, given.x)
    filled(compensator, 1, STAMP_S - 0.6)
    np.testing.assert_array_equal(compensator.ahead(STAMP_S, STAMP_S, given).x, given.x)
    filled(compensator)
    found = compensator.ahead(STAMP_S, STAMP_S, given)
    np.testing.assert_array_equal(found.x[0], given.x[0])
    assert found.visible.tolist() == [False, True] and not np.allclose(found.x[1], given.x[1], atol=1e-3)


def test_too_far_ahead_is_refused():
    with pytest.raises(ValueError, match="0.9 s"):
        LagCompensator(TYPES).ahead(STAMP_S, STAMP_S + 0.9, states())
    with pytest.raises(ValueError, match="command_delay_s"):
        LagCompensator([replace(ARDRONE, command_delay_s=0.79)])
