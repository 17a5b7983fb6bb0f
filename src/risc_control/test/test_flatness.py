"""Flatness (7.23)-(7.28): signs at every yaw, round trip, limits."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from risc_control.flatness import (
    MIN_UP_M_S2,
    Acceleration,
    flat_inputs,
    limit_tilt,
    thrust_at_tilt,
)
from risc_control.vehicles import Command
from risc_lab.frames import GRAVITY_M_S2 as G
from risc_lab.frames import rotation_body_to_cortex, rotation_body_to_ned

MASS_KG = 0.45
horizontal = st.floats(-9.0, 9.0)


def acceleration_of(inputs, psi_rad, mass_kg):
    """The inverse of `flat_inputs`: (3,) north, east, up with gravity, of a vehicle that has the attitude."""
    R = rotation_body_to_ned(inputs.roll_rad, inputs.pitch_rad, psi_rad)
    return R[:, 2] * (-inputs.thrust_n / mass_kg) * (1.0, 1.0, -1.0)


def test_hover_is_level_and_carries_the_weight():
    inputs = flat_inputs(Acceleration(0.0, 0.0, G), 0.7, 0.1, MASS_KG)
    assert inputs.thrust_n == pytest.approx(MASS_KG * G, rel=1e-15)
    assert (inputs.roll_rad, inputs.pitch_rad, inputs.yaw_rate_rad_s) == (0.0, 0.0, 0.1)


@given(horizontal, horizontal, st.floats(3.0, 15.0), st.floats(-10.0, 10.0))
def test_round_trip(north, east, up, psi):
    f = Acceleration(north, east, up)
    back = acceleration_of(flat_inputs(f, psi, 0.0, MASS_KG), psi, MASS_KG)
    assert np.abs(back - np.array(f)).max() < 1e-12 * 20.0


@pytest.mark.parametrize("psi_deg", [0, 30, 90, 135, 180, -45, -90, -170])
def test_thrust_along_the_body_axis_gives_the_acceleration_in_cortex_axes(psi_deg):
    """Independent of (7.25): turn the thrust of the commanded attitude into cortex axes."""
    wanted_cortex = np.array([0.8, -0.5, 0.3])
    psi = math.radians(psi_deg)
    north_east_up = wanted_cortex * (1.0, -1.0, 1.0) + (0.0, 0.0, G)
    inputs = flat_inputs(Acceleration(*north_east_up), psi, 0.0, MASS_KG)
    force = rotation_body_to_cortex(inputs.roll_rad, inputs.pitch_rad, psi) @ [0.0, 0.0, -inputs.thrust_n]
    assert force / MASS_KG - [0.0, 0.0, G] == pytest.approx(wanted_cortex, abs=1e-12)


@pytest.mark.parametrize(
    ("psi_deg", "f", "phi_sign", "theta_sign"),
    [
        (0, (1, 0), 0, -1),  # north with the nose north: nose down
        (0, (0, 1), 1, 0),  # east with the nose north: right wing down
        (90, (1, 0), -1, 0),  # nose east: north is left
        (90, (0, 1), 0, -1),
        (180, (1, 0), 0, 1),
        (-90, (0, 1), 0, 1),
    ],
)
def test_signs(psi_deg, f, phi_sign, theta_sign):
    inputs = flat_inputs(Acceleration(float(f[0]), float(f[1]), G), math.radians(psi_deg), 0.0, MASS_KG)
    tilt = math.atan(1.0 / G)
    assert inputs.roll_rad == pytest.approx(phi_sign * tilt, abs=1e-12)
    assert inputs.pitch_rad == pytest.approx(theta_sign * tilt, abs=1e-12)


def test_limit_keeps_direction_and_height():
    wanted = [Acceleration(6.0, -8.0, G), Acceleration(0.5, 0.5, G), Acceleration(2.0, 0.0, -2.0)]
    limited = [limit_tilt(f, math.radians(20)) for f in wanted]
    assert [shortened for _, shortened in limited] == [True, False, True]
    f = [limited_f for limited_f, _ in limited]
    inputs = [flat_inputs(limited_f, 0.3, 0.0, MASS_KG) for limited_f in f]
    tilt = [math.acos(math.cos(one.roll_rad) * math.cos(one.pitch_rad)) for one in inputs]
    assert tilt[0] == pytest.approx(math.radians(20)) and tilt[1] < math.radians(20)
    assert f[0].up == G
    assert f[0].north / f[0].east == pytest.approx(6.0 / -8.0)
    assert f[1] == (0.5, 0.5, G)
    assert f[2].up == MIN_UP_M_S2, "never asks for a fall"


def test_thrust_at_the_actual_tilt_lifts_what_was_asked_for():
    thrust_n = thrust_at_tilt(G + 0.5, 0.2, -0.3, MASS_KG)
    up = acceleration_of(Command(0.2, -0.3, 0.0, thrust_n), 1.0, MASS_KG)[2]
    assert up == pytest.approx(G + 0.5)
    assert thrust_at_tilt(G, 1.5, 0.0, MASS_KG) == pytest.approx(2.0 * MASS_KG * G), "guarded"


@pytest.mark.parametrize("f", [(0.0, 0.0, 0.0), (np.nan, 0.0, G), (0.0, np.inf, G), (0.0, 0.0, np.nan)])
def test_no_attitude_for_nonsense(f):
    with pytest.raises(ValueError, match="finite acceleration"):
        flat_inputs(Acceleration(*f), 0.0, 0.0, MASS_KG)


@pytest.mark.parametrize("f", [(np.nan, 0.0, G), (0.0, 0.0, np.nan), (0.0, 0.0, np.inf)])
def test_a_limit_makes_no_number_of_what_is_none(f):
    with pytest.raises(ValueError, match="finite acceleration"):
        flat_inputs(limit_tilt(Acceleration(*f), 0.3)[0], 0.0, 0.0, MASS_KG)
