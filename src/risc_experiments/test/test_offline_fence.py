"""No command of a controller makes a vehicle fly into the net: simulations with perturbed plant, link and node."""

from itertools import product

import numpy as np
import pytest

from risc_control.plausibility import Plausibility
from risc_control.separation import ALONE
from risc_control.vehicle_pilot import VehicleNodeParams
from risc_control.vehicles import Command, ControlsConverter, greatest_command, iris
from risc_experiments import offline
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab import load_templates
from risc_lab.states import States
from risc_simulator.wires import Wires
from risc_simulator.world import World

ONE = np.ones(1, dtype=bool)
NOISE = np.repeat((0.0005, 0.01, 0.005, 0.0), 3)  # of states, as the default estimator has it


SIDE = ((1.0, 0.0),)  # always to the same side
ANY = (-1.0, 0.0, 1.0)


def fly(kind, seed, delay_s, duration_s=8.0, tilts=tuple(product(ANY, ANY)), weights=(0.9, 1.1), **node):
    """Fly by commands that change once or twice a second: roll and pitch, drawn from `tilts` (fractions of full tilt),
    and thrust, drawn between `weights`. Returns (crashes, what the ladder said, least distance of the centre from the
    net [m]).
    """
    rng = np.random.default_rng(seed)
    flight = offline.Flight(vehicles=1, seed=seed, delay_s=delay_s, types=(kind,))
    fleet, types, (vehicle_type,) = offline.lab_of(flight)
    world = World(fleet, types, load_templates(), seed=seed, perturbed=True, gusts=True, step_s=offline.FRAME_S)
    (vehicle,), converter = world.vehicles.values(), ControlsConverter([vehicle_type])
    vehicle.fly_at((0.0, 0.0, 1.2), rng.uniform(-3.0, 3.0))
    params = VehicleNodeParams(joystick_timeout=0.0, **node)
    wires = Wires(seed)
    chain = offline.Chain(vehicle, rng.random(), 1.0, params, wires, lambda *_: None, lambda *_: None)
    judge, most, change_s, least_m = Plausibility({"v": vehicle_type}, params), greatest_command(vehicle_type), 1.0, 9.0
    hover_n, tilt, up = vehicle_type.mass_kg * GRAVITY_M_S2, (0.0, 0.0), 1.0
    for frame in range(round(duration_s / offline.FRAME_S)):
        time_s = frame * offline.FRAME_S
        now_s = time_s + offline.LATENCY_S
        world.step_to(time_s)
        wires.release(now_s)
        x = world.truth() + NOISE * rng.standard_normal((1, 12))
        least_m = min(least_m, np.min(world._net_m[:2] - np.abs(x[0, :2])), world._net_m[2] - x[0, 2])
        if time_s >= 1.0 and not chain.pilot.autonomous and not chain.said:
            chain.press_autonomous(now_s)
        if time_s >= change_s:
            change_s = time_s + rng.uniform(0.4, 1.2)
            tilt, up = rng.choice(tilts), rng.uniform(*weights)
        command = Command(*np.array([[most.roll_rad * tilt[0], most.pitch_rad * tilt[1], 0.0, hover_n * up]]).T)
        controls, _ = converter(command, ONE, ~ONE)
        suspects = () if judge.look(("v",), ONE, x, time_s).all() else [judge.reason("v")]
        offline.step_chains([chain], frame, time_s, now_s, States(ONE, x), controls, [ALONE], suspects)
        if world.crashes:
            break
    return list(world.crashes), chain.said, least_m


@pytest.mark.parametrize(("kind", "delay_s", "seeds"), [("ardrone", 0.1, 4), ("ardrone", 0.3, 4), ("iris", 0.05, 30)])
def test_a_wild_controller_never_leaves_the_net(kind, delay_s, seeds, inputs):
    for seed in range(inputs(seeds, 100)):
        crashes, said, least_m = fly(kind, seed, delay_s)
        assert not crashes and least_m > 0.0, (seed, crashes, said)
        assert said
    crashes, *_ = fly(kind, 0, delay_s, duration_s=20.0, ladder=False)
    assert crashes and "net" in crashes[0].reason


@pytest.mark.parametrize(("kind", "delay_s"), [("ardrone", 0.1), ("ardrone", 0.3), ("iris", 0.05)])
def test_nor_does_one_that_pushes_to_one_side(kind, delay_s, inputs):
    for seed in range(inputs(2, 20)):
        crashes, said, least_m = fly(kind, seed, delay_s, tilts=SIDE)
        assert not crashes and least_m > 0.0, (seed, crashes, said)
        assert said
    crashes, *_ = fly(kind, 0, delay_s, duration_s=20.0, tilts=SIDE, ladder=False)
    assert crashes and "net" in crashes[0].reason


@pytest.mark.parametrize("weights", [0.0, 0.5, 0.7, 1.2, 1.5, 2.0])
def test_no_thrust_brings_an_iris_to_net_or_floor(weights, inputs, monkeypatch):
    for seed in range(inputs(2, 20)):
        crashes, said, _ = fly("iris", seed, 0.05, tilts=((0.0, 0.0),), weights=(weights, weights))
        assert not crashes and said, (seed, crashes, said)
    # the control arm: without the ladder, and without the limit of its climb rate
    monkeypatch.setattr(iris, "_CLIMB_SHARE", np.inf)
    crashes, *_ = fly("iris", 0, 0.05, tilts=((0.0, 0.0),), weights=(weights, weights), ladder=False)
    assert crashes


def test_nor_does_an_iris_with_a_wild_thrust(inputs):
    for seed in range(inputs(10, 100)):
        crashes, said, _ = fly("iris", seed, 0.05, weights=(0.0, 2.0))
        assert not crashes and said, (seed, crashes, said)
    crashes, *_ = fly("iris", 0, 0.05, duration_s=20.0, weights=(0.0, 2.0), ladder=False)
    assert crashes and "net" in crashes[0].reason
