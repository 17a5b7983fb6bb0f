"""AR.Drone mapping: signs against NED, gain of the loops, saturation, eq. 5.4 and its inverse."""

import numpy as np
import pytest

from risc_control.flatness import FlatInputs
from risc_control.mappings.ardrone import full_scales, to_fractions, to_inputs
from risc_control.mappings.climb_rate import climb_rate_command
from risc_lab.frames import GRAVITY_M_S2 as G
from risc_lab.lab import load_vehicle_type

ARDRONE = load_vehicle_type("ardrone")


SCALE = full_scales([ARDRONE])[0]


def inputs(phi=0.0, theta=0.0, yaw_rate=0.0, thrust=4.4):
    return FlatInputs(thrust, phi, theta, yaw_rate)


@pytest.mark.parametrize(
    ("moves", "field"), [({"phi": -0.1}, "phi"), ({"theta": -0.1}, "theta"), ({"yaw_rate": -0.1}, "psi")]
)
def test_left_forward_and_left_turn_are_positive(moves, field):
    """/controls: + left, + forward, + counter-clockwise; the angles: + right, + nose up, + clockwise."""
    fractions = to_fractions(inputs(**moves), SCALE)[0]
    assert getattr(fractions, field) > 0.0
    others = {"phi", "theta", "psi"} - {field}
    assert all(getattr(fractions, other) == 0.0 for other in others)


def test_the_gain_of_the_loops_is_divided_out():
    fractions, *cut = to_fractions(inputs(phi=0.1, theta=0.1, yaw_rate=0.1), SCALE)
    assert fractions.phi * ARDRONE.tilt_max_rad * ARDRONE.roll.gain == pytest.approx(-0.1)
    assert fractions.theta * ARDRONE.tilt_max_rad * ARDRONE.pitch.gain == pytest.approx(-0.1)
    assert fractions.psi * ARDRONE.yaw_rate_max_rad_s == pytest.approx(-0.1)
    assert cut == [False, False]


def test_limits_clip_and_are_reported():
    fractions, *cut = to_fractions(inputs(phi=1.0, yaw_rate=-2.0), SCALE)
    assert fractions[:3] == (-1.0, 0.0, 1.0) and cut == [True, True]
    fractions, *cut = to_fractions(inputs(phi=0.1, theta=-1.0), SCALE)
    assert fractions.theta == 1.0 and cut == [True, False]


def test_inverse_inside_the_limits():
    scale = full_scales([ARDRONE], tilt_max_rad=0.2, yaw_rate_max_rad_s=0.7)[0]
    rng = np.random.default_rng(1)
    for _ in range(3):
        wanted = FlatInputs(rng.uniform(3, 6), *rng.uniform(-0.2, 0.2, 3))
        fractions, *cut = to_fractions(wanted, scale)
        assert cut == [False, False]
        assert to_inputs(fractions, scale) == pytest.approx(wanted)


@pytest.mark.parametrize("broken", [{"phi": np.nan}, {"thrust": np.inf}, {"yaw_rate": -np.inf}])
def test_what_is_not_finite_is_refused(broken):
    with pytest.raises(ValueError, match="not finite"):
        to_fractions(inputs(**broken), SCALE)


def test_wrong_limit_is_refused():
    with pytest.raises(ValueError, match="tilt_max_rad"):
        full_scales([ARDRONE], tilt_max_rad=0.0)


def test_hover_thrust_keeps_the_climb_rate():
    assert climb_rate_command(0.45 * G, 0.0, 0.0, -0.2, 0.3, 0.45) == pytest.approx(-0.2)
    # eq. 5.4 with numbers: 10 % more thrust
    assert climb_rate_command(1.1 * 0.45 * G, 0.0, 0.0, 0.0, 0.3, 0.45) == pytest.approx(0.03 * G)


def test_both_tilts_enter():
    """The original used phi twice (D-29)."""
    level = climb_rate_command(4.6, 0.0, 0.0, 0.1, 0.3, 0.45)
    for phi, theta in ((0.3, 0.0), (0.0, 0.3)):
        assert climb_rate_command(4.6, phi, theta, 0.1, 0.3, 0.45) < level - 0.1


def test_it_inverts_the_climb_loop():
    """With delay = time constant the vehicle's loop makes exactly the wanted acceleration."""
    a_up, climb, tau = 0.7, 0.2, ARDRONE.climb_time_constant_s
    command = climb_rate_command(ARDRONE.mass_kg * (G + a_up), 0.0, 0.0, climb, tau, ARDRONE.mass_kg)
    assert (command - climb) / tau == pytest.approx(a_up)
