"""Hows_controller.py and virtual_target.py without ROS: estimator, references, guidance, pilot, perturbed vehicle."""

import math

import numpy as np
import pytest

from risc_control.controllers import ControlLoop, guidance
from risc_control.pursuit_reference import TargetParams, VirtualTarget
from risc_control.reference_buffer import ReferenceBuffer
from risc_control.separation import ALONE
from risc_control.trajectory_manager import Phase, make_manager
from risc_control.vehicle_pilot import VehicleNodeParams
from risc_estimation.state_estimator import StatesEstimator
from risc_experiments import offline
from risc_lab.lab import load_templates
from risc_lab.states import S, States
from risc_simulator.models.mocap_cameras import CameraParams, MocapCameras
from risc_simulator.wires import Wires
from risc_simulator.world import World

PURSUIT_S, SETTLED_S = 22.0, 14.0  # the pursuit, and when it has settled
PSI_DEG = 60.0  # at which a mirrored yaw sense would not fly (D-25)
LOST_EVERY = 97  # frames: one in which motion capture does not see the vehicle
NOW = np.ones(1, dtype=bool)


def test_it_ends_up_on_the_targets_circle_behind_it_and_flies_home_from_where_it_is():
    flight = offline.Flight(vehicles=1, psi_deg=PSI_DEG)
    fleet, types, vehicle_types = offline.lab_of(flight)
    templates = load_templates()
    world = World(fleet, types, templates, seed=flight.seed, perturbed=True, step_s=offline.FRAME_S)
    cameras = MocapCameras(CameraParams(), seed=np.random.SeedSequence(flight.seed))
    name, place = fleet.vehicles[0].template, fleet.vehicles[0]
    estimator = StatesEstimator(templates, vehicles=[name])
    params = TargetParams(psi_deg=PSI_DEG)
    target = make_manager(fleet.vehicles, params.waiting_place(), kind=VirtualTarget)
    target.target = params.target_course()
    controller = ControlLoop("guidance", vehicle_types)
    vehicle = world.vehicles[place.namespace]
    vehicle.fly_at(place.start.position_m[:2] + (1.0,), place.start.yaw_rad)
    node = VehicleNodeParams(joystick_timeout=0.0)

    def nobody(*_):
        pass

    chain, buffer = offline.Chain(vehicle, 0.3, 1.0, node, Wires(flight.seed), nobody, nobody), ReferenceBuffer()

    let_go_s = home_s = math.inf
    ranges, radii, homing = [], [], []
    for frame in range(int(90.0 / offline.FRAME_S)):
        time_s = frame * offline.FRAME_S
        now_s = time_s + offline.LATENCY_S
        world.step_to(time_s)
        seen = cameras.observe(time_s, world.layout, world.markers_m())
        estimate = estimator.update(time_s, seen.layout, seen.markers_m)
        state = estimate.states[0]
        target.see(name, state[: S.U], state[S.U : S.PHI], state[S.PSI])
        if time_s >= 1.0 and not chain.pilot.autonomous:
            chain.press_autonomous(now_s)
            target.set_autonomous(name, True, now_s)
        reference = target.sample(time_s)
        if reference.phases[0] is Phase.COURSE and let_go_s == math.inf:
            let_go_s = time_s
            assert target.let_go(time_s)
        if time_s >= let_go_s + PURSUIT_S and home_s == math.inf:
            home_s = time_s
            assert target.go_home(time_s) == [name]
            reference = target.sample(time_s)
        if reference.phases[0] is Phase.HOMED:
            break
        buffer.push(time_s, reference.derivatives[:3])
        controller.controller.target_speed_m_s = target.target_speed_m_s(time_s)
        present, ahead = controller.pick(buffer.at(controller.times_s(time_s, now_s)))
        states = States(estimate.visible, estimate.states)
        if frame % LOST_EVERY == 0:  # as states_from_msg returns a vehicle that is not seen
            states = States(~NOW, np.zeros_like(states.x))
        output = controller.update(time_s, now_s, states, present, ahead, NOW, NOW & chain.pilot.autonomous)
        offline.step_chains([chain], frame, time_s, now_s, states, output.controls, [ALONE])
        assert not world.crashes
        truth = vehicle.state.position_m
        if let_go_s + SETTLED_S <= time_s < home_s:
            ranges.append(np.hypot(*(present[0, 0, :2] - truth[:2])))
            radii.append(np.hypot(*truth[:2]))
        elif time_s >= home_s:
            homing.append(np.linalg.norm(present[0, 0, :3] - truth))
    assert reference.phases == (Phase.HOMED,)
    assert np.abs(np.array(ranges) - guidance.Params().range_m).max() < 0.04
    assert np.abs(np.array(radii) - params.radius_m).max() < 0.04
    assert max(homing) < 0.1, "home begins where the vehicle is"
    assert truth[:2] == pytest.approx(place.start.position_m[:2], abs=0.05)
