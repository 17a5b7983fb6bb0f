"""The flying side of a vehicle type: commands to /controls for a fleet, and what an AR.Drone is sent."""

import math
import pathlib
import re
import threading
from dataclasses import replace

import numpy as np
import pytest

from risc_control.joystick import Sticks
from risc_control.vehicle_pilot import OwnState
from risc_control.vehicles import (
    Charge,
    Command,
    Controls,
    ControlsConverter,
    adapter_class,
    climb_acceleration,
    climb_command,
    climb_loops,
)
from risc_control.vehicles.iris import NOMINAL_BATTERY_PCT, Calls, hover_throttle
from risc_lab.command_history import CommandHistory
from risc_lab.frames import GRAVITY_M_S2 as G
from risc_lab.lab import load_vehicle_type

ARDRONE, IRIS = load_vehicle_type("ardrone"), load_vehicle_type("iris")
HOVER_N = ARDRONE.mass_kg * G
NOTHING = CommandHistory(1).vehicles[0]  # nothing was sent


def converted(roll=0.0, pitch=0.0, yaw_rate=0.0, thrust=4.4, vehicle_type=ARDRONE, known=True):
    command = Command(*(np.array([value]) for value in (roll, pitch, yaw_rate, thrust)))
    controls, cut = ControlsConverter([vehicle_type])(command, np.array([known]), np.array([False]))
    return Controls(*(part[0] for part in controls)), cut[0]


@pytest.mark.parametrize(
    ("moves", "field"), [({"roll": -0.1}, "phi"), ({"pitch": -0.1}, "theta"), ({"yaw_rate": -0.1}, "psi")]
)
def test_left_forward_and_left_turn_are_positive(moves, field):
    """/controls: + left, + forward, + counter-clockwise; the angles: + right, + nose up, + clockwise."""
    controls, _ = converted(**moves)
    assert getattr(controls, field) > 0.0
    assert all(getattr(controls, other) == 0.0 for other in {"phi", "theta", "psi"} - {field})


def test_the_gain_of_the_loops_is_divided_out():
    controls, cut = converted(0.1, 0.1, 0.1)
    assert controls.phi * ARDRONE.tilt_max_rad * ARDRONE.roll.gain == pytest.approx(-0.1)
    assert controls.theta * ARDRONE.tilt_max_rad * ARDRONE.pitch.gain == pytest.approx(-0.1)
    assert controls.psi * ARDRONE.yaw_rate_max_rad_s == pytest.approx(-0.1)
    assert controls.thrust_n == 4.4 and not cut


def test_limits_clip_and_are_reported():
    assert converted(roll=1.0, yaw_rate=-2.0) == ((-1.0, 0.0, 1.0, 4.4), True)
    assert converted(pitch=-1.0) == ((0.0, 1.0, 0.0, 4.4), True)
    other = replace(ARDRONE, tilt_max_rad=0.2, yaw_rate_max_rad_s=0.7)
    assert converted(roll=0.2, yaw_rate=0.35, vehicle_type=other)[0].psi == pytest.approx(-0.5)


def test_what_is_not_known_hovers_and_what_is_not_finite_is_no_command():
    assert converted(math.nan, math.nan, known=False) == ((0.0, 0.0, 0.0, pytest.approx(HOVER_N)), False)
    for broken in ({"roll": math.nan}, {"thrust": math.inf}, {"yaw_rate": -math.inf}):
        controls, cut = converted(**broken)
        assert np.isnan(controls).all() and not cut


@pytest.mark.parametrize("row", [0, 1, 2])
def test_a_command_that_is_not_finite_changes_no_other_vehicles(row):
    sound = Command(*np.tile([[0.1], [-0.2], [0.3], [4.4]], 3))
    broken = Command(*(part.copy() for part in sound))
    broken.pitch_rad[row] = math.nan
    everyone, nobody = np.ones(3, bool), np.zeros(3, bool)
    (alone, _), (found, _) = (ControlsConverter([ARDRONE, IRIS, ARDRONE])(c, everyone, nobody) for c in (sound, broken))
    others = np.arange(3) != row
    assert np.array_equal(np.array(found)[:, others], np.array(alone)[:, others])
    assert np.isnan(np.array(found)[:, row]).all()


def climb_rate(thrust_n, phi=0.0, theta=0.0, climb_m_s=0.0):
    """What an AR.Drone is asked for [m/s]; the command takes effect at once."""
    adapter = adapter_class(ARDRONE)(replace(ARDRONE, command_delay_s=0.0), 1e9)
    own = OwnState((0.0, 0.0, 1.0), (0.0, 0.0, climb_m_s), phi, theta, 0.0)
    return adapter.answer(Controls(0.1, 0.2, 0.3, thrust_n), own, 5.0, 5.0, NOTHING).up * ARDRONE.climb_max_m_s


def test_thrust_becomes_a_climb_rate():
    """Eq. 5.4 with numbers."""
    assert climb_rate(HOVER_N, climb_m_s=-0.2) == pytest.approx(-0.2)
    assert climb_rate(1.1 * HOVER_N) == pytest.approx(0.03 * G)


def test_both_tilts_enter():
    """The original used phi twice (D-29)."""
    level = climb_rate(4.6, climb_m_s=0.1)
    for phi, theta in ((0.3, 0.0), (0.0, 0.3)):
        assert climb_rate(4.6, phi, theta, 0.1) < level - 0.1


def test_the_command_inverts_the_climb_loop():
    loop = climb_loops([ARDRONE])[0]
    command = climb_command(0.7, 0.2, loop)
    assert command == pytest.approx(0.2 + ARDRONE.climb_time_constant_s * 0.7)
    assert climb_acceleration(command, 0.2, loop) == pytest.approx(0.7)


def test_sticks_are_the_fractions_and_giving_way_is_in_radians():
    adapter = adapter_class(ARDRONE)(ARDRONE, 29.5)
    own = OwnState((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    assert adapter.answer(Controls(0.1, 2.0, -0.3, HOVER_N), own, 5.0, 5.0, NOTHING) == (1.0, 0.1, 0.0, -0.3)
    half = 0.5 * ARDRONE.tilt_max_rad
    assert adapter.move(half, -half, 0.25, own) == pytest.approx((0.5, -0.5, 0.25, 0.0))


def test_a_type_without_adapter_names_the_known_ones():
    with pytest.raises(ValueError, match="'zeppelin' .* vehicle_types; .* ardrone"):
        adapter_class(replace(ARDRONE, name="zeppelin"))


# --- IRIS+ ------------------------------------------------------------------------------------------------------------

HOVERS = {0.0: 0.492, 25.0: 0.171, 50.0: 0.099, 75.0: -0.018, 100.0: -0.153}  # eq. 5.5 with the right c4
OWN = OwnState((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("battery_pct", "throttle"), HOVERS.items())
def test_the_throttle_that_hovers_is_that_of_the_charge(battery_pct, throttle):
    converter = ControlsConverter([IRIS, ARDRONE])
    converter.tell_battery(0, battery_pct, 1.0)
    for g_more in (0.0, 0.1):
        thrust_n = np.array([(1.0 + g_more) * IRIS.mass_kg * G, HOVER_N])
        controls, cut = converter(Command(*np.zeros((3, 2)), thrust_n), np.ones(2, bool), np.zeros(2, bool))
        assert controls.thrust_n[0] == pytest.approx(throttle + g_more, abs=5e-4)
        assert controls.thrust_n[1] == HOVER_N and not cut.any()
    nobody, _ = converter(Command(*np.zeros((4, 2))), np.zeros(2, bool), np.zeros(2, bool))
    assert nobody.thrust_n[0] == pytest.approx(throttle, abs=5e-4)


def test_without_a_charge_the_throttle_is_that_of_an_average_one():
    nominal = hover_throttle(IRIS, NOMINAL_BATTERY_PCT)
    converter = ControlsConverter([IRIS])
    converter.tell_battery(0, math.nan, 1.0)
    controls, _ = converter(Command(*np.zeros((4, 1))), np.zeros(1, bool), np.zeros(1, bool))
    assert controls.thrust_n[0] == pytest.approx(nominal)


def test_a_step_of_the_charge_is_none_of_the_throttle():
    charge, before = Charge(), None
    for k in range(600):  # 5 Hz; a percent less after a minute
        charge.note(60.0 if k < 300 else 59.0, 0.2 * k)
        throttle = hover_throttle(IRIS, charge.pct)
        assert before is None or abs(throttle - before) * G < 0.004  # [m/s^2]; a whole percent: 0.04
        before = throttle
    assert charge.pct == pytest.approx(59.0, abs=1e-6)


def test_the_throttle_of_controls_has_limits():
    controls, cut = converted(thrust=30.0, vehicle_type=IRIS)
    assert controls.thrust_n == 1.0 and cut
    controls, cut = converted(thrust=-30.0, vehicle_type=IRIS)
    assert controls.thrust_n == -1.0 and cut


def test_signs_of_an_iris_are_those_of_the_angles():
    controls, _ = converted(roll=0.1, pitch=0.2, yaw_rate=0.3, vehicle_type=IRIS)
    full = IRIS.tilt_max_rad, IRIS.tilt_max_rad, IRIS.yaw_rate_max_rad_s
    assert controls[:3] == pytest.approx([part / whole for part, whole in zip((0.1, 0.2, 0.3), full)])


@pytest.mark.parametrize("fraction", [-1.0, -0.3, -1e-4, 0.0, 1e-4, 0.3, 1.0])
def test_sticks_are_past_the_autopilots_dead_zone(fraction):
    adapter, unit = adapter_class(IRIS)(IRIS, 44.0), adapter_class(IRIS).units(IRIS)
    sticks = adapter.answer(Controls(fraction, fraction, fraction, 0.1), OWN, 5.0, 5.0, NOTHING)
    stick = math.copysign(0.04 + 0.96 * abs(fraction), fraction) if fraction else 0.0
    assert sticks == pytest.approx((-stick, -stick, 0.1, -stick))
    settles = adapter.settles_at(sticks, OWN)
    assert settles[[0, 1, 3]] == pytest.approx([fraction * unit[0], fraction * unit[1], fraction * unit[2]])


def test_the_board_follows_at_once_what_an_iris_is_sent():
    """Faster changes come late or are refused, and a prediction from the commands would not know of it."""
    text = (pathlib.Path(__file__).resolve().parents[3] / "firmware/dueppm/configuration.h").read_text(encoding="utf-8")
    jump, slew_us_s, travel_us = (
        float(re.search(r"%s = ([\d.]+);" % name, text)[1]) for name in ("kJump", "kSlewUsPerS", "kRollTravelUs")
    )
    adapter, rng, now_s = adapter_class(IRIS)(IRIS, 45.0), np.random.default_rng(1), 0.0
    before = adapter.sendable(Sticks(*rng.uniform(-1.0, 1.0, 4)), now_s)
    for since_s in rng.uniform(0.005, 0.1, 200):
        now_s += since_s
        wanted = np.array(rng.uniform(-1.0, 1.0, 4))
        sent = adapter.sendable(Sticks(*wanted), now_s)
        changes, most = np.abs(np.subtract(sent, before)), min(jump, slew_us_s / travel_us * since_s)
        assert changes.max() <= most + 1e-9
        assert np.all((sent == wanted) | (changes > 0.99 * most)), "nearer to what is wanted it could not be"
        before = sent
    assert adapter.sendable(Sticks(0.0, 0.0, 1.0, 0.0), now_s + 0.5).up == 1.0, "the board is in its failsafe"


@pytest.mark.parametrize("tilt_rad", [0.0, 0.4])
def test_what_an_iris_settles_at_is_the_acceleration_that_was_asked_for(tilt_rad):
    """As the controller assumes, tilted or not: its climb loop, and the thrust for it."""
    own = OWN._replace(theta_rad=tilt_rad, velocity_m_s=(0.0, 0.0, 0.4))
    loop = climb_loops([IRIS])[0]
    wanted = 0.7  # [m/s^2]
    thrust_n = IRIS.mass_kg * (G + wanted + loop.damping_1_s * 0.4) / math.cos(tilt_rad)
    controls, _ = converted(thrust=thrust_n, vehicle_type=IRIS)
    adapter = adapter_class(IRIS)(IRIS, 44.0)
    sticks = adapter.answer(controls, own, 5.0, 5.0, NOTHING)
    command = adapter.settles_at(sticks, own)[2]
    assert climb_acceleration(command, 0.4, loop) == pytest.approx(wanted)
    assert command == pytest.approx(climb_command(wanted, 0.4, loop))
    assert loop.most == pytest.approx(1.0 - 0.4917, abs=1e-3)


def test_calls_that_never_come_back_hold_up_nobody():
    calls, hangs = Calls(0.05), threading.Event()
    assert calls(max, 1, 2) == 2
    with pytest.raises(ZeroDivisionError):
        calls(lambda: 1 / 0)
    for _ in range(4):
        with pytest.raises(TimeoutError, match="0.05 s"):
            calls(hangs.wait)
    with pytest.raises(TimeoutError, match="4 calls"):
        calls(max, 1, 2)
    hangs.set()
    patient = Calls(60.0)
    assert patient(hangs.wait)
