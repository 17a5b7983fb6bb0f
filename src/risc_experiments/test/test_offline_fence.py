"""Whatever a controller commands, no vehicle flies into the net: simulated flights with perturbed plant, link, node."""

import numpy as np
import pytest

from risc_control.plausibility import Plausibility
from risc_control.separation import ALONE
from risc_control.vehicle_pilot import VehicleNodeParams
from risc_control.vehicles import Command, ControlsConverter, greatest_command
from risc_experiments import offline
from risc_lab.frames import GRAVITY_M_S2
from risc_lab.lab import load_templates
from risc_lab.states import States
from risc_simulator.wires import Wires
from risc_simulator.world import World

ONE = np.ones(1, dtype=bool)
NOISE = np.repeat((0.0005, 0.01, 0.005, 0.0), 3)  # of states, as the default estimator has it


def fly(kind, seed, delay_s, duration_s=20.0, wild=True, **node):
    """Fly by full tilts that change once or twice a second; wild=False: always to the same side. Returns (crashes,
    what the ladder said, least distance of the centre from the net).
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
    hover_n, tilts, up = vehicle_type.mass_kg * GRAVITY_M_S2, np.zeros(2), 1.0
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
            change_s = time_s + rng.uniform(0.4, 1.2) if wild else np.inf
            tilts, up = rng.choice((-1.0, 0.0, 1.0), 2) if wild else np.array([1.0, 0.0]), rng.uniform(0.9, 1.1)
        command = Command(most.roll_rad * tilts[:1], most.pitch_rad * tilts[1:], np.zeros(1), np.full(1, hover_n * up))
        controls, _ = converter(command, ONE, ~ONE)
        suspects = () if judge.look(("v",), ONE, x, time_s).all() else [judge.reason("v")]
        offline.step_chains([chain], frame, time_s, now_s, States(ONE, x), controls, [ALONE], suspects)
        if world.crashes:
            break
    return list(world.crashes), chain.said, least_m


@pytest.mark.parametrize(("kind", "delay_s"), [("ardrone", 0.1), ("ardrone", 0.3), ("iris", 0.05)])
@pytest.mark.parametrize("wild", [True, False])
def test_a_wild_controller_never_leaves_the_net(kind, delay_s, wild, inputs):
    for seed in range(inputs(1, 3)):
        crashes, said, least_m = fly(kind, seed, delay_s, wild=wild)
        assert not crashes and least_m > 0.0, (crashes, said)
        assert said
    crashes, *_ = fly(kind, 0, delay_s, wild=wild, ladder=False)
    assert crashes and "net" in crashes[0].reason
