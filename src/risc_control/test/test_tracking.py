"""Controllers: equilibrium, signs at every yaw, limits, integrators, what cannot be used; closed loop on the nominal
vehicle."""

import math
from dataclasses import replace

import numpy as np
import pytest
from unlearnt import UNLEARNT

from risc_control.controllers import ControlLoop, differential_flatness, thesis_lqr
from risc_control.controllers.differential_flatness import Params
from risc_control.delay_prediction import discretised, loops
from risc_control.trajectories import YawProgram, make_course
from risc_control.vehicles import adapter_class
from risc_lab.frames import GRAVITY_M_S2 as G
from risc_lab.lab import load_vehicle_type
from risc_lab.states import S, States

ARDRONE = load_vehicle_type("ardrone")
HOVER_N = ARDRONE.mass_kg * G


def flatness(types, **params):
    return ControlLoop(differential_flatness.Controller, types, Params(**params))


def thesis(types, **params):
    return ControlLoop(thesis_lqr.Controller, types, thesis_lqr.Params(**params))


BOTH = [flatness, thesis]
YAWS_DEG = [0, 45, 90, 135, 180, -60, -120]
DT_S = 0.005


def states(position=(0, 0, 1), velocity=(0, 0, 0), angles=(0, 0, 0), rates=(0, 0, 0), n=1, visible=True):
    return States(
        np.full(n, visible), np.tile(np.concatenate([position, velocity, angles, rates], dtype=float), (n, 1))
    )


def standing(x=0.0, y=0.0, z=1.0, psi=0.0, n=1):
    reference = np.zeros((5, n, 4))
    reference[0] = x, y, z, psi
    return reference


def update(controller, state, reference, stamp_s=100.0, usable=True, autonomous=True):
    n = len(state.visible)
    return controller.update(
        stamp_s, stamp_s + 0.004, state, reference, reference, np.full(n, usable), np.full(n, autonomous)
    )


@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize("psi_deg", YAWS_DEG)
def test_hover_is_an_equilibrium(kind, psi_deg):
    psi = math.radians(psi_deg)
    output = update(kind([ARDRONE]), states(angles=(0, 0, psi)), standing(psi=psi))
    for fraction in output.controls[:3]:
        assert fraction[0] == pytest.approx(0.0, abs=1e-12)
    assert output.controls.thrust_n[0] == pytest.approx(HOVER_N)
    assert not output.saturated[0]


@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize("psi_deg", YAWS_DEG)
@pytest.mark.parametrize("direction_deg", [0, 90, 200])
def test_moves_toward_the_reference_at_every_yaw(kind, psi_deg, direction_deg):
    """The commanded tilt, turned into cortex axes by hand, points from the vehicle to its reference (D-23, D-25)."""
    psi, direction = math.radians(psi_deg), math.radians(direction_deg)
    error = 0.1 * np.array([math.cos(direction), math.sin(direction)])
    output = update(kind([ARDRONE]), states(angles=(0, 0, psi)), standing(*error, psi=psi))
    forward, left = (
        output.controls.theta[0] * ARDRONE.pitch.gain,
        output.controls.phi[0] * ARDRONE.roll.gain,
    )
    # cortex: at yaw psi the nose is (cos, -sin) and the left wing (sin, cos)
    moves = forward * np.array([math.cos(psi), -math.sin(psi)]) + left * np.array([math.sin(psi), math.cos(psi)])
    assert moves / np.linalg.norm(moves) == pytest.approx(error / 0.1, abs=0.06)
    assert output.controls.thrust_n[0] == pytest.approx(HOVER_N, rel=0.06)


@pytest.mark.parametrize("kind", BOTH)
def test_brakes_climbs_and_turns_the_right_way(kind):
    controller = kind([ARDRONE])
    assert update(controller, states(velocity=(0.3, 0, 0)), standing()).controls.theta[0] < -0.01
    assert update(kind([ARDRONE]), states(velocity=(0, 0.3, 0)), standing()).controls.phi[0] < -0.01
    assert update(kind([ARDRONE]), states(), standing(z=1.1)).controls.thrust_n[0] > 1.01 * HOVER_N
    assert update(kind([ARDRONE]), states(velocity=(0, 0, 0.2)), standing()).controls.thrust_n[0] < HOVER_N
    # clockwise is + in psi and - in the fraction
    assert update(kind([ARDRONE]), states(), standing(psi=0.1)).controls.psi[0] < -0.01


@pytest.mark.parametrize("kind", BOTH)
def test_turns_the_short_way_round(kind):
    near = states(angles=(0, 0, math.radians(175)))
    output = update(kind([ARDRONE]), near, standing(psi=math.radians(-175)))
    assert -1.0 < output.controls.psi[0] < -0.05, "10 degrees clockwise"


@pytest.mark.parametrize("kind", BOTH)
def test_far_away_is_bounded_and_said(kind):
    controller = kind([ARDRONE], error_max_m=5.0)
    output = update(controller, states(), standing(30.0, 40.0, 20.0, math.pi))
    assert all(np.abs(fraction[0]) <= 1.0 for fraction in output.controls[:3])
    assert output.saturated[0] and 0.0 < output.controls.thrust_n[0] < 10.0 * HOVER_N
    tilt = output.controls.theta[0] * ARDRONE.pitch.gain, output.controls.phi[0] * ARDRONE.roll.gain
    assert math.atan2(tilt[1], tilt[0]) == pytest.approx(math.atan2(40.0, 30.0), abs=0.1), "direction is kept"


@pytest.mark.parametrize("kind", BOTH)
def test_without_state_or_reference_it_is_level_with_hover_thrust(kind):
    """Thesis 7.7, and never a thrust of 0 (D-28); the other vehicle is not affected."""
    controller = kind([ARDRONE] * 2)
    state = states(position=(0.3, 0.1, 0.8), angles=(0.1, 0.1, 1.0), n=2)
    broken = States(np.array([False, True]), state.x.copy())
    broken.position_m[0] = np.nan, np.inf, 0.0
    output = update(controller, broken, standing(n=2))
    assert [part[0] for part in output.controls] == pytest.approx([0.0, 0.0, 0.0, HOVER_N])
    alone = update(kind([ARDRONE] * 2), state, standing(n=2))
    assert [part[1] for part in output.controls] == pytest.approx([part[1] for part in alone.controls])
    lost = kind([ARDRONE] * 2).update(
        100.0, 100.004, state, standing(n=2) * np.nan, standing(n=2) * np.nan, np.zeros(2, bool), np.ones(2, bool)
    )
    assert np.array(lost.controls) == pytest.approx(np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [HOVER_N] * 2]))


@pytest.mark.parametrize("kind", BOTH)
@pytest.mark.parametrize("value", [np.nan, -np.inf, 1e200, -1e200])
@pytest.mark.parametrize("is_first", [False, True])
def test_numbers_that_are_not_finite_never_leave_and_the_others_fly_on(kind, value, is_first):
    """In the first frame or later. What a limit cuts may be finite again, however large it is."""

    def flown(state, reference):
        controller = kind([ARDRONE] * 2)
        if not is_first:
            update(controller, states(n=2), standing(0.1, n=2), stamp_s=100.0 - DT_S)
        return controller, update(controller, state, reference)

    def check(state, reference):
        controller, output = flown(state, reference)
        assert output.finite[1] and not (np.isnan(value) and output.finite[0])
        own, others = np.array(output.controls).T
        assert np.isfinite(own).all() if output.finite[0] else np.isnan(own).all()
        assert np.array_equal(others, np.array(sound.controls)[:, 1])
        again = update(controller, states(n=2), standing(0.1, n=2), stamp_s=100.5)
        assert again.finite.all(), "nothing of it is remembered"

    _, sound = flown(states(n=2), standing(0.1, n=2))
    assert sound.finite.all()
    for order, axis in ((2, 1), (0, 0), (1, 2), (2, 2), (0, 3)):
        reference = standing(0.1, n=2)
        reference[order, 0, axis] = value
        check(states(n=2), reference)
    for column in (S.X, S.Z, S.V, S.W, S.PSI):
        state = states(n=2)
        state.x[0, column] = value
        check(state, standing(0.1, n=2))


def test_thrust_counts_the_tilt_that_the_vehicle_has():
    controller = flatness([replace(ARDRONE, command_delay_s=0.0)])
    output = update(controller, states(angles=(0.25, 0.0, 0.0)), standing())
    assert output.controls.thrust_n[0] > 1.01 * HOVER_N


def test_integral_grows_only_in_flight_and_starts_afresh():
    controller = flatness([ARDRONE], q_integral=100.0, **UNLEARNT)

    def integral():
        return math.hypot(controller.controller._integrals[0].north_m_s, controller.controller._integrals[0].east_m_s)

    def left_after(seconds, autonomous, height_m=1.0, begin_s=0.0):
        for k in range(int(seconds / DT_S)):
            stamp_s = begin_s + k * DT_S
            output = update(controller, states(position=(0, 0, height_m)), standing(y=0.05, z=height_m), stamp_s,
                            autonomous=autonomous)  # fmt: skip
        return output.controls.phi[0]

    first = left_after(0.005, True)
    assert left_after(2.0, False, begin_s=1.0) == pytest.approx(first, rel=1e-6), "manual: at rest"
    assert left_after(1.0, True, height_m=0.1, begin_s=3.0) < 1.5 * first, "on the floor: at rest"
    controller.controller.reset()
    grown = left_after(1.0, True, begin_s=6.0)
    assert integral() == pytest.approx(0.05, rel=0.02)
    left_after(60.0, True, begin_s=8.0)
    assert integral() <= controller.params.integral_max_m_s + 1e-9
    assert grown != first
    left_after(0.1, False, begin_s=70.0)
    assert integral() == 0.0, "it was not autonomous"


def test_integral_rests_while_the_command_is_cut():
    controller = flatness([ARDRONE], q_integral=100.0, **UNLEARNT, error_max_m=5.0, integral_max_m_s=50.0)
    for k in range(400):
        update(controller, states(), standing(x=5.0, z=3.0), k * DT_S)
    grown = controller.controller._integrals[0]
    assert math.hypot(grown.north_m_s, grown.east_m_s) < 0.1 and abs(grown.up_m_s) < 0.1


@pytest.mark.parametrize(
    ("axis", "field", "value", "command", "change"),
    [
        ("phi", "level", 0.05, "roll", -0.05),  # it leans right by itself: told to lean left
        ("theta", "level", 0.05, "pitch", -0.05),
        ("theta", "gain", 0.25, "pitch", 0.0057),  # a fifth less of 0.029, nose down
        ("north", "push_m_s2", 0.5, "pitch", 0.05),  # pushed ahead: nose up, and more, since it will be ahead
        ("east", "push_m_s2", 0.5, "roll", -0.05),
        ("height", "level", 0.1, "climb", -0.1),
    ],
)
def test_what_was_learnt_is_taken_out_of_the_command(axis, field, value, command, change):
    """The change of the first command after learning, before its effect is seen: its sign and rough size."""

    def commanded(value):
        controller = flatness([replace(ARDRONE, command_delay_s=0.0)])
        update(controller, states(), standing(x=0.02), 0.0)
        setattr(getattr(controller.controller._observed[0], axis), field, value)
        controls = update(controller, states(), standing(x=0.02), DT_S).controls
        unit = adapter_class(ARDRONE).units(ARDRONE)
        up_m_s2 = controls.thrust_n[0] / ARDRONE.mass_kg - G
        return {
            "roll": controls.phi[0] * unit.roll_rad,
            "pitch": controls.theta[0] * unit.pitch_rad,
            "climb": up_m_s2 * ARDRONE.climb_time_constant_s,
        }[command]

    changed = commanded(value) - commanded(0.0)
    assert 0.5 < changed / change < 5.0


def test_what_was_learnt_is_forgotten_where_it_may_not_hold():
    """In manual flight, low over the floor, and by `reset`. A push is not a trim: in manual flight it is kept."""

    def learnt(controller):
        o = controller.controller._observed[0]
        return [o.phi.level, o.theta.gain, o.height.lag, o.drag_1_s], o.north.push_m_s2

    def taught():
        controller = flatness([ARDRONE])
        update(controller, states(), standing(), 0.0)
        o = controller.controller._observed[0]
        o.phi.level, o.theta.gain, o.height.lag, o.drag_1_s, o.north.push_m_s2 = 0.02, 0.1, 0.5, 0.2, 0.3
        update(controller, states(), standing(), DT_S)
        assert all(learnt(controller)[0]) and learnt(controller)[1]
        return controller

    by_hand = taught()
    update(by_hand, states(), standing(), 2 * DT_S, autonomous=False)
    assert learnt(by_hand)[0] == pytest.approx([0.0, 0.0, 0.0, 0.0], abs=1e-4) and learnt(by_hand)[1] > 0.2
    low = taught()
    update(low, states(position=(0, 0, 0.1)), standing(), 2 * DT_S)
    assert learnt(low) == ([0.0, 0.0, 0.0, 0.0], 0.0)
    again = taught()
    again.controller.reset()
    assert learnt(again) == ([0.0, 0.0, 0.0, 0.0], 0.0)


def test_weights_can_change_and_wrong_ones_change_nothing():
    controller = flatness([ARDRONE])
    before = update(flatness([ARDRONE]), states(), standing(x=0.1)).controls.theta[0]
    with pytest.raises(ValueError, match="q_position"):
        controller.set_params(Params(q_position=-1.0))
    with pytest.raises(ValueError, match="weight in Q"):
        controller.set_params(Params(q_integral=0.0, q_position=0.0))
    assert update(controller, states(), standing(x=0.1), 1.0).controls.theta[0] == pytest.approx(before)
    controller.set_params(Params(q_position=20.0, q_integral=0.0))
    assert update(controller, states(), standing(x=0.1), 2.0).controls.theta[0] < 0.8 * before


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Params(error_max_m=0.0), "error_max_m"),
        (lambda: Params(r_yaw=0.0), "r_yaw"),
        (lambda: Params(q_yaw=math.nan), "q_yaw"),
        (lambda: flatness([replace(ARDRONE, command_delay_s=3.0)]), "command_delay_s"),
        (lambda: ControlLoop("zeppelin", [ARDRONE]), ": differential_flatness, guidance, thesis_lqr"),
    ],
)
def test_wrong_settings_say_why(make, message):
    with pytest.raises(ValueError, match=message):
        make()


class NominalVehicles:
    """Exactly the model of the controller: linear loops, thrust along the body, drag, a delay. No radio slots."""

    def __init__(self, n, position, psi):
        self.units = adapter_class(ARDRONE).units(ARDRONE)
        self._phi, self._gamma = discretised(*loops(ARDRONE), DT_S)
        self.x = np.zeros((n, 4, 2))  # (phi, theta, height, psi) and their rates
        self.x[:, 2, 0], self.x[:, 3, 0] = position[:, 2], psi
        self.p = position[:, 0] - 1j * position[:, 1]
        self.v = np.zeros(n, dtype=complex)

    def states(self):
        rows = np.zeros((len(self.p), len(S)))
        for z, value, height in ((self.p, S.X, self.x[:, 2, 0]), (self.v, S.U, self.x[:, 2, 1])):
            rows[:, value], rows[:, value + 1], rows[:, value + 2] = z.real, -z.imag, height
        rows[:, S.PHI : S.P], rows[:, S.P :] = self.x[:, [0, 1, 3], 0], self.x[:, [0, 1, 3], 1]
        return States(np.ones(len(self.p), bool), rows)

    def step(self, controls, climb_at_command_m_s):
        phi, theta, psi = self.x[:, 0, 0], self.x[:, 1, 0], self.x[:, 3, 0]
        a_up = controls.thrust_n * np.cos(phi) * np.cos(theta) / ARDRONE.mass_kg - G
        climb = climb_at_command_m_s + ARDRONE.climb_time_constant_s * a_up
        lift = G + (climb - self.x[:, 2, 1]) / ARDRONE.climb_time_constant_s
        a = lift * (-np.tan(theta) + 1j * np.tan(phi) / np.cos(theta)) * np.exp(1j * psi)
        a = a - ARDRONE.drag_n_s_m / ARDRONE.mass_kg * self.v
        command = np.empty((len(self.p), 4))
        command[:, 0], command[:, 1] = (
            controls.phi * self.units.roll_rad,
            controls.theta * self.units.pitch_rad,
        )
        command[:, 2], command[:, 3] = climb, controls.psi * self.units.yaw_rate_rad_s
        self.p, self.v = self.p + DT_S * self.v + 0.5 * DT_S**2 * a, self.v + DT_S * a
        self.x = np.matmul(self._phi, self.x[..., None])[..., 0] + self._gamma * command[..., None]


def fly(controller, course, psi, duration_s=13.0, steps_late=26):
    """Errors (k, n) of a flight from rest at the course's start; commands act steps_late frames later."""
    n = len(course.paths)
    reference = course.at
    vehicles = NominalVehicles(n, reference(0.0)[0, :, :3], psi)
    pending, errors, everyone = [], [], np.ones(n, dtype=bool)
    for k in range(int(duration_s / DT_S)):
        time_s = k * DT_S
        state = vehicles.states()
        ahead = reference(controller.times_s(time_s, time_s)[1])
        output = controller.update(time_s, time_s, state, reference(time_s), ahead, everyone, everyone)
        pending.append(output.controls)
        if k >= steps_late:
            # the vehicle node predicts its climb rate to this moment; with the nominal loop it is the true one
            vehicles.step(pending[k - steps_late], vehicles.x[:, 2, 1].copy())
        errors.append(np.linalg.norm(reference(time_s)[0, :, :3] - state.position_m, axis=1))
    return np.array(errors)


@pytest.mark.parametrize(
    ("name", "psi_deg"),
    [
        ("circle", 0),
        ("flat8", 100),
        ("slanted8", -135),
        ("circles3", 100),
        *(
            pytest.param(name, psi_deg, marks=pytest.mark.release)
            for name, yaws_deg in (
                ("circle", (100, -135)),
                ("flat8", (0, -135)),
                ("slanted8", (0, 100)),
                ("circles3", (0, -135)),
            )
            for psi_deg in yaws_deg
        ),
    ],
)
def test_follows_courses_at_any_yaw_to_millimetres_on_the_nominal_vehicle(name, psi_deg):
    psi = math.radians(psi_deg)
    course = make_course(name, 2).with_yaw(YawProgram(psi, 0.2 if psi_deg == 100 else 0.0))
    controller = flatness([ARDRONE] * 2)
    errors = fly(controller, course, psi, steps_late=round(controller.controller.delay_s[0] / DT_S))
    assert errors[-1000:].max() < 0.006
    assert errors.max() < 0.35


def test_prediction_is_worth_it():
    """The thesis' controller on the same vehicle, with weights that suit the delay."""
    course = make_course("circle", 1)
    late = fly(thesis([ARDRONE]), course, 0.0, steps_late=27)[-1000:].max()
    full = fly(flatness([ARDRONE]), course, 0.0, steps_late=27)[-1000:].max()
    assert full < 0.3 * late < 0.1


def test_stable_with_three_times_the_delay_and_with_a_wrong_one():
    course = make_course("circle", 1)
    told = flatness([replace(ARDRONE, command_delay_s=0.3)])
    assert fly(told, course, 0.0, steps_late=67)[-1000:].max() < 0.01
    for steps_late in (17, 37):  # 50 ms less and more than nominal
        assert fly(flatness([ARDRONE]), course, 0.0, steps_late=steps_late)[-1000:].max() < 0.05
