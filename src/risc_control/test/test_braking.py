"""risc_control.braking: a vehicle that is not seen any more comes to a stop by its model."""

import math

import numpy as np
import pytest

from risc_control.braking import TILT_RAD, Braking
from risc_control.vehicle_pilot import OwnState
from risc_lab.command_history import CommandHistory
from risc_lab.frames import GRAVITY_M_S2 as G
from risc_lab.lab import load_vehicle_type

STEP_S = 0.001


class Body:
    """The level motion of a vehicle at a constant height: attitude loops, thrust and drag; cortex frame.

    quicker: factor on the bandwidth of the type's attitude loops.
    """

    def __init__(self, vehicle_type, velocity_m_s, psi_rad, quicker=1.0):
        self.type, self.quicker = vehicle_type, quicker
        self.position_m, self.velocity_m_s = np.zeros(2), np.array(velocity_m_s)
        self.angles_rad, self.rates_rad_s, self.psi_rad = np.zeros(2), np.zeros(2), psi_rad

    def step(self, roll_rad, pitch_rad):
        for axis, (command_rad, loop) in enumerate(((roll_rad, self.type.roll), (pitch_rad, self.type.pitch))):
            wn = self.quicker * loop.natural_frequency_rad_s
            bends = (
                wn**2 * (command_rad - self.angles_rad[axis]) - 2.0 * loop.damping_ratio * wn * self.rates_rad_s[axis]
            )
            self.rates_rad_s[axis] += STEP_S * bends
            self.angles_rad[axis] += STEP_S * self.rates_rad_s[axis]
        (phi, theta), sine, cosine = self.angles_rad, math.sin(self.psi_rad), math.cos(self.psi_rad)
        forward, right = -G * math.tan(theta), G * math.tan(phi)
        pushes = np.array((cosine * forward - sine * right, -sine * forward - cosine * right))
        self.velocity_m_s += STEP_S * (pushes - self.type.drag_n_s_m / self.type.mass_kg * self.velocity_m_s)
        self.position_m += STEP_S * self.velocity_m_s

    def own(self):
        return OwnState((*self.position_m, 1.0), (*self.velocity_m_s, 0.0), *self.angles_rad, self.psi_rad)


def flown(body, lean_rad=0.0, brakes=True, duration_s=2.0):
    """(Braking, [Brake]) of a vehicle that leans for half a second, is seen, and is braked from 0.1 s later on."""
    sent = CommandHistory(1)
    braking = Braking(body.type, sent.vehicles[0])
    delay_s, period_s = body.type.command_delay_s, 1.0 / body.type.command_rate_hz
    sent.append(0, 0.0, np.array((lean_rad, 0.0, 0.0, 0.0)))
    now_s, next_s, brakings = 0.0, 0.6, []
    while now_s < 0.6 + duration_s:
        if now_s <= 0.5:
            braking.see(body.own(), now_s)
            body.position_m[:] = 0.0
        if now_s >= next_s and brakes:
            brakings.append(braking.command(now_s))
            sent.append(0, now_s, np.array((*brakings[-1][:2], 0.0, 0.0)))
            next_s += period_s
        body.step(*sent.at(0, now_s - delay_s - 0.5 * period_s)[:2])
        now_s += STEP_S
    return braking, brakings


@pytest.mark.parametrize("type_name", ["ardrone", "iris"])
@pytest.mark.parametrize(("north", "west", "psi_deg"), [(0.6, 0.0, 0.0), (-0.2, 0.6, 70.0), (-0.4, -0.5, -130.0)])
@pytest.mark.parametrize("quicker", [0.85, 1.0, 1.15])
def test_it_stops(type_name, north, west, psi_deg, quicker):
    kind = load_vehicle_type(type_name)
    body = Body(kind, (north, west), math.radians(psi_deg), quicker)
    _, brakings = flown(body)
    assert np.linalg.norm(body.velocity_m_s) < 0.06 and np.abs(body.angles_rad).max() < math.radians(2.0)
    # 0.1 s unseen, the delay, and the way that no vehicle can shorten
    assert np.linalg.norm(body.position_m) < (0.38 if type_name == "ardrone" else 0.28)
    assert max(abs(angle) for brake in brakings for angle in brake[:2]) <= TILT_RAD
    assert not brakings[0].stopped and brakings[-1].stopped
    # the control arm
    body = Body(kind, (north, west), math.radians(psi_deg), quicker)
    flown(body, brakes=False)
    assert np.linalg.norm(body.velocity_m_s) > 0.3 and np.linalg.norm(body.position_m) > 0.8


@pytest.mark.parametrize("type_name", ["ardrone", "iris"])
def test_it_knows_what_its_last_commands_still_do(type_name):
    """It was last seen at rest, but tilted: it accelerates until the first brake takes effect."""
    body = Body(load_vehicle_type(type_name), (0.0, 0.0), 0.4)
    braking, brakings = flown(body, lean_rad=0.1)
    assert np.linalg.norm(body.velocity_m_s) < 0.06
    assert brakings[0].roll_rad < 0.0 and not brakings[0].stopped
    then = brakings[-1].then
    assert np.allclose(then.velocity_m_s[:2], body.velocity_m_s, atol=0.05)
    assert np.allclose(then.position_m[:2], body.position_m, atol=0.05)


@pytest.mark.parametrize(("wrong_m_s", "feels"), [(0.15, True), (0.15, False), (0.5, True)])
def test_a_velocity_of_its_own_corrects_one_that_was_seen_wrongly(wrong_m_s, feels):
    kind, sent = load_vehicle_type("ardrone"), CommandHistory(1)
    braking = Braking(kind, sent.vehicles[0])
    braking.see(OwnState((0.0, 0.0, 1.0), (wrong_m_s, 0.0, 0.0), 0.0, 0.0, 1.0), 10.0)
    for k in range(1, 5):
        if feels:
            braking.feel((0.0, 0.0), 10.0 + 0.06 * k)
        then = braking.command(10.0 + 0.06 * k).then
    corrected = feels and wrong_m_s == 0.15
    assert (then.velocity_m_s[0] < 0.3 * wrong_m_s) == corrected, "what is far from the model is not believed"


def test_a_state_that_is_new_counts_at_once():
    kind, sent = load_vehicle_type("ardrone"), CommandHistory(1)
    braking = Braking(kind, sent.vehicles[0])
    assert braking.command(1.0) is None, "it was never seen"
    still = OwnState((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0.0, 0.0, 0.0)
    braking.see(still, 10.0)
    assert braking.command(10.1).stopped
    braking.see(still._replace(velocity_m_s=(0.5, 0.0, 0.0)), 10.2)
    assert braking.command(10.3).pitch_rad > 0.1, "nose up against what it does"
    braking.see(still, 10.4)
    assert braking.command(10.5).stopped
    assert braking.command(14.0) is None, "it was not asked for so long"


def test_a_delay_that_nobody_can_predict():
    kind = load_vehicle_type("ardrone", {"command_delay_s": 1.5})
    braking = Braking(kind, CommandHistory(1).vehicles[0])
    braking.see(OwnState((0.0, 0.0, 1.0), (0.5, 0.0, 0.0), 0.0, 0.0, 0.0), 10.0)
    assert braking.command(10.1) is None
