"""Whole flights without ROS and as fast as the computer can: the same estimator, references, controller and vehicle
logic as in the nodes, around the virtual lab's physics, cameras and radio.

    python3 -m risc_experiments.offline --trajectory circle --vehicles 3 --seeds 5 --delay 0.1

A seed reproduces a flight bit for bit, and `fly_all` flies as many at once as there are cores. Not simulated are
processes, sockets and the scheduler's jitter; the time from exposure to the controller's answer is a constant.
"""

import argparse
import json
import math
import pathlib
import sys
import time
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np

from data_extraction.progress import Progress, bar
from risc_control.controllers import REGISTRY as CONTROLLERS
from risc_control.controllers import ControlLoop, default_params, own_params
from risc_control.feasibility import fleet_course, fleet_ways
from risc_control.plausibility import Plausibility
from risc_control.reference_buffer import ReferenceBuffer
from risc_control.safety import FailsafeLevel, Rule, fence_of
from risc_control.separation import ALONE, Separation
from risc_control.trajectories import YawProgram, find_course
from risc_control.trajectory_manager import Phase, make_manager
from risc_control.transitions import WayLimits
from risc_control.vehicle_pilot import VehicleNodeParams
from risc_estimation.filters import COMMAND, make_filter
from risc_estimation.pose_fit import PoseFitParams
from risc_estimation.state_estimator import StatesEstimator
from risc_experiments.estimators import add_option, estimator_of
from risc_experiments.faults_list import fault_option
from risc_experiments.fleets import default_fleet
from risc_experiments.offline_chain import FRAME_S, LATENCY_S, TICK_EVERY, Chain, step_chains
from risc_experiments.offline_outcome import breaches_of, contacts_of, judge_faults, left_course_s
from risc_experiments.offline_sensors import OnBoardReadings
from risc_experiments.option_types import add_set_option, numbers_of
from risc_experiments.option_types import course as course_option
from risc_experiments.option_types import speed as speed_option
from risc_experiments.workers import in_order
from risc_lab.lab import load_fleet, load_templates, load_vehicle_type
from risc_lab.lab.fleet import wider_m
from risc_lab.states import S, States
from risc_simulator.faults import FaultEvent
from risc_simulator.injector import Injector
from risc_simulator.models.gusts import Gusts
from risc_simulator.models.mocap_cameras import CameraParams, MocapCameras
from risc_simulator.wires import Wires
from risc_simulator.world import World

WARM_UP_S = 1.0  # hovering, before the operator presses the button
LONGEST_WAY_S = 120.0  # until all are on the course; ways take at most a third of it (WayLimits.longest_s)
SETTLE_S = 4.0  # on the course, before errors count
JUDGE_EVERY = 4  # frames
LANDING_S = 15.0  # after the end of the flight, for vehicles that are still landing
MAX_REPORTED_DELAY_S = 0.5  # stream_markers believes no longer ones
YAW_BY_SEED_DEG = 70.0  # the table flies another yaw with every seed
_CAMERA_STREAM, _RADIO_STREAM = 1000, 1001  # spawn keys beside those of the vehicles in the world


class Loss(NamedTuple):
    """What a vehicle loses for good."""

    vehicle: int  # its place in the fleet
    what: str  # "state": motion capture sees it no more; "controls": its controller is silent; "laptop": its node dies
    after_s: float  # on the course, settled


@dataclass(frozen=True)
class Flight:
    """What is flown."""

    trajectory: str = "circle"  # name of a course, or path of a file of waypoints
    vehicles: int = 3
    seed: int = 1
    duration_s: float = 20.0  # on the course after settling
    delay_s: float | None = None  # link delay, told to the controller as nominal; None = that of each vehicle
    psi_deg: float | None = None  # constant yaw instead of the course's own
    perturbed: bool = True
    plant: dict = field(default_factory=dict)  # PlantParams in which the true vehicles differ
    gusts: bool | Gusts = False  # moving air; True: the usual gusts
    noise: bool = True  # of the cameras, and of sensors on board
    controller: str = "differential_flatness"  # name of one, see risc_control.controllers
    estimator: str | None = None  # name of the velocity filter; None = the controller's, see `estimators`
    params: object = None  # the controller's PARAMS, or {key: number} that replace those of its YAML file
    fleet: str = ""  # fleet file, of which the first `vehicles` fly; "" = one of the shipped ones
    types: tuple = ()  # names of the vehicles' types, in the order of the fleet; () = those of the fleet file
    overrides: dict = field(default_factory=dict)  # numbers that replace those of the vehicles' types
    course: dict = field(default_factory=dict)  # numbers of the course, as `make_course` takes them
    speed: str | None = None  # of the course, as `speed_factor` takes it; None = by its numbers
    node: dict = field(default_factory=dict)  # parameters of the vehicle nodes
    loss: Loss | None = None
    faults: tuple[FaultEvent, ...] = ()  # which start when the course is reached, before the settling time
    # faults that start when the flight does, and are not reported in the Result. Channels are cortex/frames,
    # cortex/stream, NAMESPACE/commands and NAMESPACE/navdata; damaged messages without bytes are lost
    wire_faults: tuple[FaultEvent, ...] = ()


class Said(NamedTuple):
    """A report of a vehicle's ladder."""

    time_s: float
    vehicle: int  # its place in the fleet
    level: FailsafeLevel
    rule: Rule


class Result(NamedTuple):
    """Result of a flight. With faults a vehicle may land; its errors after it has left its course mean nothing."""

    names: tuple
    rmse_m: np.ndarray  # (n,) position against truth, on the course after settling
    max_m: np.ndarray  # (n,)
    closest_m: float  # smallest distance between two vehicles from take-over to the end
    saturated: float  # fraction of the commands that a limit cut
    flown_s: float
    took_s: float
    times_s: np.ndarray  # (k,)
    reference_m: np.ndarray  # (k, n, 3)
    actual_m: np.ndarray  # (k, n, 3)
    safety: tuple  # of (time [s], name, text): reports of the ladders, from the first level above OK on
    landed: tuple  # (n,) bool, at the end
    # see `offline_outcome`
    faults: tuple = ()  # FaultOutcome of each of Flight.faults, in their order
    breaches: tuple = ()  # Breach
    contacts: tuple = ()  # Contact
    # for statistics; vehicles are given by their place in the fleet, times are those of the nodes
    reached_s: float = 0.0  # when all were on the course
    judged: np.ndarray | None = None  # (k,) bool: settled
    namespaces: tuple = ()
    levels: tuple = ()  # of Said, from the first level above OK on
    unseen: tuple = ()  # of (time [s], vehicle): motion capture has lost it
    left_s: tuple = ()  # (n,) when each left its course for good, to land or by a crash; infinite: never


def fly(flight):
    """Fly a Flight. Returns its Result. Raises ValueError when it cannot be flown, and RuntimeError when it crashes
    (with faults: before they begin) or does not reach its course.
    """
    running = RunningFlight(flight)
    while not running.is_over:
        running.frame()
    return running.outcome()


def fly_all(flights, workers=None, on_progress=None):
    """Fly many Flights, each on a core. Yields their Results in their order; a RuntimeError for one that crashed.

    workers and on_progress as in `workers.in_order`. Results do not depend on the workers. Raises ValueError as `fly`
    and for no workers, and ChildProcessError when a worker dies.
    """
    return in_order(_outcome, flights, workers, on_progress)


def _outcome(flight):
    try:
        return fly(flight)
    except RuntimeError as error:
        return error


class RunningFlight:
    """A flight that runs frame by frame until it is over, and its outcome.

    Its parts are those of the ROS graph: world and cameras, estimator, references, controller, and a `Chain` of vehicle
    node, link and on-board logic for each vehicle. There are two times: `_time_s` of the world and its exposures, and
    `_now_s` of the nodes, LATENCY_S later.
    """

    def __init__(self, flight):
        """Raises ValueError when it cannot be flown."""
        self._flight, self._started = flight, time.perf_counter()
        fleet, types, vehicle_types = lab_of(flight)
        self._names = [vehicle.template for vehicle in fleet.vehicles]
        self._everyone, self._nobody = np.ones(len(self._names), dtype=bool), np.zeros(len(self._names), dtype=bool)
        self._frames, self._time_s, self._now_s = 0, 0.0, LATENCY_S
        self._set_up_lab(fleet, types, vehicle_types)
        self._set_up_references_and_control(fleet, vehicle_types)
        self._set_up_vehicles(fleet, vehicle_types)
        self._set_up_faults()
        self._times, self._references, self._truths, self._judged = [], [], [], []  # every JUDGE_EVERY frames
        self._saturated, self._settled_s = 0, math.inf
        self._unseen, self._seen_before = [], [False] * len(self._names)

    # --- set-up -------------------------------------------------------------------------------------------------

    def _set_up_lab(self, fleet, types, vehicle_types):
        """World, cameras, estimator, and the wires in between."""
        flight, templates = self._flight, load_templates(fleet=fleet)
        self._carriers = [i for i, vehicle in enumerate(fleet.vehicles) if vehicle.carries]
        bodies = [fleet.vehicles[i].carries for i in self._carriers]
        how = {"seed": flight.seed, "perturbed": flight.perturbed, "gusts": flight.gusts, "step_s": FRAME_S}
        self._world = World(fleet, types, templates, **how)
        for vehicle in self._world.vehicles.values():
            vehicle.change_plant(**flight.plant)
        self._cameras = MocapCameras(
            CameraParams.of_arena(fleet.arena) if flight.noise else CameraParams.ideal(),
            seed=np.random.SeedSequence(flight.seed, spawn_key=(_CAMERA_STREAM,)),
        )
        self._estimator = StatesEstimator(
            templates,
            replace(PoseFitParams().within(fleet.arena), **({} if flight.noise else {"frozen_frames": 0})),
            vehicles=self._names + bodies,
            velocity_filter=make_filter(estimator_of(flight.controller, flight.estimator)),
            vehicle_types=dict(zip(self._names, vehicle_types)),
        )
        self._wires = Wires(flight.seed)
        self._mocap = _Mocap(self._wires)
        vehicles = self._world.vehicles.values()
        self._on_board = OnBoardReadings(self._estimator, vehicles, self._wires, flight.seed, float(flight.noise))

    def _set_up_references_and_control(self, fleet, vehicle_types):
        flight = self._flight
        own = own_params(flight.controller, fleet.vehicles, flight.fleet or "fleet '%s'" % fleet.name)
        params = flight.params
        if isinstance(params, dict):
            params = replace(default_params(flight.controller), **params)
        self._loop = ControlLoop(flight.controller, vehicle_types, params, own)
        yaw = None if flight.psi_deg is None else YawProgram(math.radians(flight.psi_deg))
        chosen, speed = find_course(flight.trajectory), flight.speed or ""
        course, factor = fleet_course(chosen, fleet.vehicles, fleet.arena, speed, yaw, **flight.course)
        order = self._loop.controller.ORDER
        ways = fleet_ways(WayLimits(), fleet.vehicles, factor)
        self._manager = make_manager(fleet.vehicles, course, limits=ways, order=order)
        self._buffer = ReferenceBuffer(order)

    def _set_up_vehicles(self, fleet, vehicle_types):
        """Vehicle nodes, links and what the nodes know of each other; all vehicles hover where they start."""
        flight, names, noise = self._flight, self._names, float(self._flight.noise)
        exact = {} if flight.noise else {"state_least_step_m": 0.0}  # without noise, one at rest does not move
        params = VehicleNodeParams(**{"joystick_timeout": 0.0, **fence_of(fleet.arena), **exact, **flight.node})
        self._separation = Separation(names, params, names, wider_m(fleet.vehicles))
        self._plausibility = Plausibility(dict(zip(names, vehicle_types)), params)
        self._looks = [ALONE] * len(names), ()  # see `_look_around`
        rng = np.random.default_rng(np.random.SeedSequence(flight.seed, spawn_key=(_RADIO_STREAM,)))
        self._chains = []
        for i, (vehicle, start) in enumerate(zip(self._world.vehicles.values(), fleet.vehicles)):
            vehicle.fly_at(start.start.position_m[:2] + (1.0,), start.start.yaw_rad)
            told = partial(self._note_command, i), partial(self._loop.tell_battery, i)
            self._chains.append(Chain(vehicle, rng.random(), noise, params, self._wires, *told))

    def _note_command(self, i, time_s, command):
        """Tell the controller, and a filter that asks for it, that a command was sent."""
        self._loop.sent.append(i, time_s, command)
        self._estimator.on_board(self._estimator.names[i], time_s, COMMAND, command)

    def _set_up_faults(self):
        flight = self._flight
        self._injector = Injector(self._world, self._wires, flight.seed, {"cortex": self._mocap})
        self._records = []  # FaultRecord of each of Flight.faults, once the course is reached
        for event in flight.wire_faults:
            self._injector.add(event, 0.0)
        for event in flight.faults:
            self._injector.check(event)
            if not 0.0 <= event.start_s < SETTLE_S + flight.duration_s:
                text = "fault %s starts when the flight is over: it lasts %g s from when the course is reached"
                raise ValueError(text % (event, SETTLE_S + flight.duration_s))

    # --- one frame ----------------------------------------------------------------------------------------------

    def frame(self):
        """Fly a frame. Raises RuntimeError for a flight that crashes or does not reach its course, see `fly`."""
        self._time_s = self._frames * FRAME_S
        self._now_s = self._time_s + LATENCY_S
        self._let_lab_go_on()
        hears = self._estimate_states()
        states = self._states_for_nodes(hears)
        flying = self._time_s >= WARM_UP_S
        if flying and self._manager.watching:
            self._press_buttons()
        reference = self._manager.sample(self._time_s)
        self._buffer.push(self._time_s, reference.derivatives[: self._buffer.sample_orders])  # as on the topics
        output = self._control(states, flying) if hears else None
        looks, suspects = self._look_around(states, reference)
        controls = output.controls if hears else None
        step_chains(self._chains, self._frames, self._stamp_s, self._now_s, states, controls, looks, suspects)
        if flying:
            self._saturated += np.count_nonzero(output.saturated) if hears else 0
            self._note(reference)
        self._check_course(reference)
        self._frames += 1

    def _let_lab_go_on(self):
        """Advance world, wires and sensors to now, and send what the cameras have seen."""
        self._injector.step(self._now_s)
        self._world.step_to(self._time_s)
        self._wires.release(self._now_s)
        self._on_board.send(self._time_s)
        seen = self._cameras.observe(self._time_s, self._world.layout, self._world.markers_m())
        self._mocap.send(seen, self._now_s)

    def _estimate_states(self):
        """Give the estimator what has arrived. Returns whether there is a new estimate."""
        hears = False
        for seen in self._mocap.arrived:
            estimate = self._estimator.update(*seen)
            if estimate is not None:
                self._estimate, self._stamp_s, hears = estimate, seen.time_s, True
        self._mocap.arrived.clear()
        if not hears and (estimate := self._estimator.coast(self._time_s)) is not None:
            self._estimate, self._stamp_s, hears = estimate, self._time_s, True
        return hears

    def _states_for_nodes(self, hears):
        """States of the vehicles; those that are not seen, or lost for good (`Flight.loss`), are not visible."""
        n, loss = len(self._names), self._flight.loss
        states = States(self._estimate.visible[:n], self._estimate.states[:n])  # attached bodies come after
        if hears:
            seen = states.visible.tolist()
            if seen != self._seen_before:
                lost = [i for i, was_seen in enumerate(self._seen_before) if was_seen and not seen[i]]
                self._unseen += [(self._now_s, i) for i in lost]
                self._seen_before = seen
        else:
            states = states._replace(visible=self._nobody.copy())
        if loss is not None and self._time_s >= self._settled_s + loss.after_s:
            if loss.what == "state":
                states.visible[loss.vehicle] = False
            else:
                self._chains[loss.vehicle].lose(loss.what, self._now_s)
        return states

    def _bodies_for_controller(self):
        """`controllers.Bundle.bodies`; None when no vehicle carries anything."""
        if not self._carriers:
            return None
        n = len(self._names)
        bodies = States(np.zeros(n, dtype=bool), np.zeros((n, len(S))))
        bodies.visible[self._carriers], bodies.x[self._carriers] = self._estimate.visible[n:], self._estimate.states[n:]
        return bodies

    def _press_buttons(self):
        """Switch all vehicles to the controller, as the operator does; those that refuse are asked again."""
        for name, chain, state in zip(self._names, self._chains, self._estimate.states):
            if not chain.pilot.autonomous:
                self._manager.see(name, state[: S.U], state[S.U : S.PHI], state[S.PSI])
                chain.press_autonomous(self._now_s)
                self._manager.set_autonomous(name, chain.pilot.autonomous, self._now_s)

    def _control(self, states, flying):
        """`Output` of the controller."""
        times_s = self._loop.times_s(self._stamp_s, self._now_s)
        present, ahead = self._loop.pick(self._buffer.at(times_s))
        autonomous = self._everyone if flying else self._nobody
        covariances = self._estimator.covariances() if self._loop.controller.COVARIANCES else None
        if covariances is not None:
            covariances = covariances[: len(self._names)]  # attached bodies come after
        told = states, present, ahead, self._everyone, autonomous, self._bodies_for_controller(), covariances
        return self._loop.update(self._stamp_s, self._now_s, *told)

    def _look_around(self, states, reference):
        """What the vehicle nodes find at a tick: `separation.Look` and the doubt about its state, of each vehicle."""
        if self._frames % TICK_EVERY:
            return (), ()
        names, stamp_s, separation = self._estimate.names[: len(self._names)], self._stamp_s, self._separation
        believed, suspects = self._plausibility.look(names, states.visible, states.x, stamp_s), ()
        if believed is None:  # no new states: the last result
            return self._looks
        if False in believed.tolist():
            suspects = [self._plausibility.reason(name) for name in self._names]
        separation.see(names, believed, states.x, stamp_s)
        course_m = np.ascontiguousarray(reference.derivatives[:3].transpose(1, 0, 2))  # as on /trajectory
        separation.refer(names, course_m, self._time_s)
        pilots = {name: chain.pilot for name, chain in zip(self._names, self._chains)}
        holding = {name for name, pilot in pilots.items() if pilot.holds_alone}
        separation.tell(holding, {name for name, pilot in pilots.items() if pilot.stands})
        looks = separation.look(self._now_s)
        self._looks = [looks.get(name, ALONE) for name in self._names], suspects
        return self._looks

    def _note(self, reference):
        """Start the faults when all have reached the course; record the samples for the errors."""
        if self._settled_s == math.inf and all(phase is Phase.COURSE for phase in reference.phases):
            self._settled_s = self._time_s + SETTLE_S
            self._records = [self._injector.add(event, self._now_s) for event in self._flight.faults]
        if self._frames % JUDGE_EVERY == 0:
            self._times.append(self._time_s)
            self._references.append(reference.derivatives[0, :, :3])
            self._truths.append(self._world.positions_m())
            self._judged.append(self._time_s >= self._settled_s)

    def _check_course(self, reference):
        """Raises RuntimeError for a crash that no fault explains, or when the course is not reached in time."""
        if self._world.crashes and not self._records:
            crash = self._world.crashes[0]
            raise self._ended("%s %s after %.1f s" % (crash.namespace, crash.reason, crash.time_s))
        if self._settled_s == math.inf and self._time_s >= LONGEST_WAY_S:
            manual = [name for name, chain in zip(self._names, self._chains) if not chain.pilot.autonomous]
            phases = ["%s: %s" % (name, phase.name.lower()) for name, phase in zip(self._names, reference.phases)]
            told = self._time_s, ", ".join(phases), ", ".join(manual) or "none"
            raise self._ended("not on the course after %g s (%s; not autonomous: %s)" % told)

    def _ended(self, text):
        error = RuntimeError(text)
        error.add_note("in %r" % (self._flight,))  # for repeating it
        return error

    # --- the end ------------------------------------------------------------------------------------------------

    @property
    def is_over(self):
        """True when the time is over, and after faults no vehicle is landing any more; or all are down for good."""
        end_s = self._settled_s + self._flight.duration_s
        if self._time_s >= end_s:
            over = not self._records or self._time_s >= end_s + LANDING_S
            if over or not any(chain.lands for chain in self._chains):
                return True
        return bool(self._records) and all(chain.rests for chain in self._chains)

    def outcome(self):
        """The flight's Result."""
        chains, n = self._chains, len(self._names)
        references, truths, judged = np.array(self._references), np.array(self._truths), np.array(self._judged)
        errors = np.sqrt(((references - truths) ** 2).sum(axis=2))[judged]
        if not judged.any():  # all have landed before
            errors = np.full((1, n), math.nan)
        breaches, contacts = breaches_of(self._world, chains), contacts_of(self._world)
        between = [truths[:, i] - truths[:, j] for i, j in combinations(range(n), 2)]
        said = [(said_s, i, verdict) for i, chain in enumerate(chains) for said_s, verdict in chain.said]
        return Result(
            names=tuple(self._names),
            rmse_m=np.sqrt((errors**2).mean(axis=0)),
            max_m=errors.max(axis=0),
            closest_m=min((float(np.linalg.norm(way_m, axis=1).min()) for way_m in between), default=math.inf),
            saturated=self._saturated / (n * self._frames),
            flown_s=self._time_s,
            took_s=time.perf_counter() - self._started,
            times_s=np.array(self._times),
            reference_m=references,
            actual_m=truths,
            safety=tuple(sorted((said_s, self._names[i], verdict.text) for said_s, i, verdict in said)),
            landed=tuple(chain.landed for chain in chains),
            faults=tuple(judge_faults(self._records, chains, breaches, contacts)),
            breaches=breaches,
            contacts=contacts,
            reached_s=self._settled_s - SETTLE_S,
            judged=judged,
            namespaces=tuple(chain.name for chain in chains),
            levels=tuple(sorted(Said(said_s, i, verdict.level, verdict.rule) for said_s, i, verdict in said)),
            unseen=tuple(self._unseen),
            left_s=tuple(left_course_s(chain, breaches, contacts) for chain in chains),
        )


class _Mocap:
    """The path from the cameras to the estimator: Cortex and the network. It is also the host that faults stop."""

    def __init__(self, wires):
        self._frames, self._stream = wires.frames("cortex/frames"), wires.wire("cortex/stream")
        self._runs, self._first = True, True
        self.arrived = []  # Observations

    def stop(self):
        """End the program."""
        self._runs = False

    def start(self):
        """Start the program again; its clients find it at once."""
        self._runs = True

    def send(self, seen, now_s):
        """Send an observation of the cameras."""
        if self._first:  # the first is never lost
            self._first = False
            self.arrived.append(seen)
        elif self._runs:
            self._frames.carry(seen, None, now_s, self._say)

    def _say(self, seen, _, now_s):
        if not 0.0 <= now_s - seen.time_s <= MAX_REPORTED_DELAY_S:  # a delay that no client believes
            seen = seen._replace(time_s=now_s)
        self._stream.carry(seen, None, now_s, self._hear)

    def _hear(self, seen, *_):
        self.arrived.append(seen)


def lab_of(flight):
    """(Fleet, types by name, VehicleType of each vehicle) of a flight."""
    if flight.fleet:
        fleet = load_fleet(flight.fleet).with_vehicles(flight.vehicles)
    else:
        fleet = default_fleet(flight.vehicles, find_course(flight.trajectory))
    if flight.psi_deg is not None:
        turned = [replace(v, start=replace(v.start, yaw_deg=flight.psi_deg)) for v in fleet.vehicles]
        fleet = replace(fleet, vehicles=tuple(turned))
    if flight.types:
        fleet = replace(fleet, vehicles=tuple(replace(v, type=t) for v, t in zip(fleet.vehicles, flight.types)))
    fleet = fleet.with_overrides(**flight.overrides).with_overrides(command_delay_s=flight.delay_s)
    types = {name: load_vehicle_type(name) for name in {vehicle.type for vehicle in fleet.vehicles}}
    return fleet, types, [vehicle.vehicle_type for vehicle in fleet.vehicles]


def main(argv=None):
    """Print a table of accuracy over seeds. Returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python3 -m risc_experiments.offline",
        description="Accuracy of whole flights, offline: position RMSE against truth, on the course after settling.",
    )
    add = parser.add_argument
    add("--trajectory", nargs="+", type=course_option, default=["circle", "flat8", "slanted8"], metavar="NAME",
        help="courses by name, or files of waypoints (.yaml; default: circle, flat8, slanted8)")  # fmt: skip
    add("--speed", type=speed_option, metavar="M_S", help="largest speed on the course [m/s], or e.g. 2x: "
        "twice as fast as by its numbers (default: by its numbers)")  # fmt: skip
    add("--vehicles", type=int, default=3, metavar="N")
    add("--fleet", default="", metavar="FILE", help="fleet file (default: one of the shipped ones)")
    add("--seeds", type=int, default=5, metavar="N", help="seeds 1 to N (default: 5)")
    add("--delay", type=float, nargs="+", metavar="S", help="link delay (default: that of the type)")
    add("--duration", type=float, default=20.0, metavar="S", help="judged time (default: 20 s)", dest="duration_s")
    add("--psi", type=float, metavar="DEG", help="constant yaw (default: another for every seed)")
    add("--controller", choices=CONTROLLERS.names(), default=Flight.controller)
    add_option(add)
    add_set_option(add)
    add("--ideal", action="store_false", help="the plant is exactly the nominal model", dest="perturbed")
    add("--gusts", action="store_true")
    add("--fault", type=fault_option, action="append", default=[], metavar="NAME[:ARG][@SECONDS]", dest="faults",
        help="what goes wrong, so many seconds after the course is reached; may be given again; ./maap faults lists "
        "them")  # fmt: skip
    add("--json", type=pathlib.Path, metavar="FILE", help="also write the figures of each flight here")
    add("--workers", type=int, metavar="N", help="flights at the same time (default: a core each)")
    args = parser.parse_args(argv)
    common = ("vehicles", "fleet", "duration_s", "controller", "estimator", "perturbed", "gusts", "speed")
    common = {name: getattr(args, name) for name in common}
    try:
        common["params"] = numbers_of(args.controller, args.set)
    except ValueError as error:
        parser.error(str(error))
    flights = [
        Flight(course, seed=seed, delay_s=delay_s, psi_deg=YAW_BY_SEED_DEG * seed if args.psi is None else args.psi,
               faults=tuple(args.faults), **common)
        for course in args.trajectory for delay_s in args.delay or [None] for seed in range(1, args.seeds + 1)
    ]  # fmt: skip
    progress, rows, everyone, unsafe = Progress(), [], {}, False
    print("%-9s %6s %5s  %-28s %6s %6s %6s %7s %5s" % ("course", "delay", "seed", "RMSE of each vehicle [mm]", "median",
          "p95", "worst", "closest", "speed"))  # fmt: skip
    try:
        outcomes = fly_all(flights, args.workers, lambda over: progress.show("flying", bar(over / len(flights))))
        for flight, result in zip(flights, outcomes):
            name = pathlib.Path(flight.trajectory).stem
            group = "%-9s %6s" % (name, "type" if flight.delay_s is None else "%.2f" % flight.delay_s)
            progress.clear()
            if isinstance(result, RuntimeError):
                print("%s %5d  %s" % (group, flight.seed, result))
            elif flight.faults:
                rows.append({"course": name, "delay_s": flight.delay_s, "seed": flight.seed,
                             "faults": [fault._asdict() for fault in result.faults],
                             "breaches": len(result.breaches), "contacts": len(result.contacts)})  # fmt: skip
                print("%s %5d  %s" % (group, flight.seed, _told(result)), flush=True)
                unsafe |= not all(fault.safe for fault in result.faults)
            elif any(result.landed):  # an error from a course that was left on purpose says nothing
                said = "; ".join("%.1f s: %s: %s" % item for item in result.safety[:2])
                print("%s %5d  %d landed (%s)" % (group, flight.seed, sum(result.landed), said))
            else:
                rmse_mm, speed = 1e3 * result.rmse_m, result.flown_s / result.took_s
                everyone.setdefault(group, []).extend(rmse_mm)
                closest_m = result.closest_m if math.isfinite(result.closest_m) else None
                rows.append({"course": name, "delay_s": flight.delay_s, "seed": flight.seed,
                             "rmse_m": result.rmse_m.tolist(), "closest_m": closest_m,
                             "times_real_time": speed})  # fmt: skip
                print("%s %5d  %-28s %6.1f        %6.1f %5.2f m %4.1fx" % (
                    group, flight.seed, " ".join("%.1f" % value for value in rmse_mm), np.median(rmse_mm),
                    rmse_mm.max(), result.closest_m, speed), flush=True)  # fmt: skip
            if flight.seed == args.seeds and group in everyone:
                print("%s %5s  %-28s %6.1f %6.1f %6.1f" % (
                    group, "all", "", *np.percentile(everyone[group], (50, 95)), max(everyone[group])))  # fmt: skip
    except ValueError as error:
        parser.error(str(error))
    except (ChildProcessError, KeyboardInterrupt) as error:
        progress.say("offline: %s" % (error if str(error) else "interrupted"))
        return 130 if isinstance(error, KeyboardInterrupt) else 1
    if args.json:
        figures = {"controller": args.controller, "estimator": estimator_of(args.controller, args.estimator)}
        figures |= {"simulated": True, "perturbed": args.perturbed, "flights": rows}
        args.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0 if len(rows) == len(flights) and not unsafe else 1


def _told(result):
    """Text of how the faults of a flight ended, e.g. "mocap_blackout:3 landed after 105 ms"."""
    told = []
    for fault in result.faults:
        after = "" if fault.reaction_ms is None else " after %.0f ms" % fault.reaction_ms
        told.append("%s:%s %s%s%s" % (fault.name, fault.args, fault.outcome, after, "" if fault.safe else " (unsafe)"))
    return "; ".join(told)


if __name__ == "__main__":
    sys.exit(main())
