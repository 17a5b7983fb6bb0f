"""Whole flights without ROS and as fast as the computer can: the same estimator, references, controller and vehicle
logic as in the nodes, around the virtual lab's physics, cameras and radio.

    python3 -m risc_experiments.offline --trajectory circle --vehicles 3 --seeds 5 --delay 0.1

A seed reproduces a flight bit for bit, and `fly_all` flies as many at once as there are cores. What is not here:
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

from cortex_ros.wire import FrameEncoder
from data_extraction.progress import Progress, bar
from risc_control.controllers import REGISTRY as CONTROLLERS
from risc_control.controllers import ControlLoop, own_params
from risc_control.failsafe import FailsafeLevel, fence_of
from risc_control.feasibility import fleet_course, fleet_ways
from risc_control.plausibility import Plausibility
from risc_control.reference_buffer import ReferenceBuffer
from risc_control.separation import ALONE, Separation
from risc_control.trajectories import YawProgram, find_course
from risc_control.trajectory_manager import Phase, make_manager
from risc_control.transitions import WayLimits
from risc_control.vehicle_pilot import OwnState, VehicleNodeParams, VehiclePilot
from risc_control.vehicles import Controls, FlightState, Status, adapter_class
from risc_estimation.filters import COMMAND, make_filter
from risc_estimation.pose_fit import PoseFitParams
from risc_estimation.state_estimator import StatesEstimator
from risc_experiments.estimators import add_option, estimator_of
from risc_experiments.faults_list import fault_option
from risc_experiments.fleets import default_fleet
from risc_experiments.on_board import OnBoardReadings
from risc_experiments.option_types import course as course_option
from risc_experiments.option_types import speed as speed_option
from risc_experiments.workers import in_order
from risc_lab.lab import load_fleet, load_templates, load_vehicle_type
from risc_lab.lab.fleet import wider_m
from risc_lab.states import S, States
from risc_simulator.faults import FaultEvent
from risc_simulator.injector import Injector
from risc_simulator.models.flight import FlightAction, FlightPhase
from risc_simulator.models.mocap_cameras import CameraParams, MocapCameras
from risc_simulator.video.polygons import clip_polygons, coverage
from risc_simulator.wires import Wires
from risc_simulator.world import World

FRAME_S = 0.005
LATENCY_S = 0.006  # exposure to the controller's answer: 3 ms in the mocap host, 3 ms in the nodes
WARM_UP_S = 1.0  # hovering, before the operator presses the button
LONGEST_WAY_S = 120.0  # until all are on the course; ways take at most a third of it (WayLimits.longest_s)
SETTLE_S = 4.0  # on the course, before errors count
JUDGE_EVERY = 4  # frames
LANDING_S = 15.0  # longer than the flight, for vehicles that land
MAX_REPORTED_DELAY_S = 0.5  # as stream_markers believes
TICK_EVERY = 3  # frames: the clock of the vehicle nodes, twice the command rate
YAW_BY_SEED_DEG = 70.0  # the table flies another yaw with every seed

_REPORTS = {  # what a vehicle says of itself
    FlightPhase.LANDED: FlightState.LANDED,
    FlightPhase.TAKING_OFF: FlightState.TAKING_OFF,
    FlightPhase.HOVERING: FlightState.HOVERING,
    FlightPhase.FLYING: FlightState.FLYING,
    FlightPhase.LANDING: FlightState.LANDING,
    FlightPhase.EMERGENCY: FlightState.UNKNOWN,
}
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
    gusts: bool = False
    noise: bool = True  # of the cameras, and of sensors on board
    controller: str = "differential_flatness"  # name of one, see risc_control.controllers
    estimator: str | None = None  # name of the velocity filter; None = the controller's, see `estimators`
    params: object = None  # its PARAMS; None = those of its YAML file
    fleet: str = ""  # fleet file, of which the first so many fly; "" = one of the shipped ones
    types: tuple = ()  # names of the vehicles' types, in the order of the fleet; () = those of the fleet file
    overrides: dict = field(default_factory=dict)  # what the vehicles have otherwise than their types
    course: dict = field(default_factory=dict)  # numbers of the course, as `make_course` takes them
    speed: str | None = None  # of the course, as `speed_factor` takes it; None = by its numbers
    node: dict = field(default_factory=dict)  # parameters of the vehicle nodes
    loss: Loss | None = None
    faults: tuple[FaultEvent, ...] = ()  # which start when the course is reached, before the settling time
    # the same, but they start when the flight does, and nothing is told of them. Channels are cortex/frames,
    # cortex/stream, NAMESPACE/commands and NAMESPACE/navdata; what has no bytes is not corrupted
    wire_faults: tuple[FaultEvent, ...] = ()


class Breach(NamedTuple):
    """A vehicle flew into the net or onto the floor, or fell."""

    time_s: float
    name: str
    reason: str


class Contact(NamedTuple):
    """Two vehicles touched in the air."""

    time_s: float
    name: str
    other: str


class FaultOutcome(NamedTuple):
    """What became of a fault."""

    name: str
    args: str  # as on the command line, with the vehicle that the seed chose
    start_s: float  # of the flight
    end_s: float | None  # None: it had no end
    outcome: str  # completed, held, landed or breach: the worst of what a vehicle did until the next fault
    safe: bool  # its member calls that safe, and no two vehicles touched
    reaction_ms: float | None  # from its begin to the first ladder that left OK; None: none did


class Result(NamedTuple):
    """How it was flown. With faults a vehicle may land, and an error from a course that was left says nothing."""

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
    safety: tuple  # of (time [s], name, text): what the ladders said, from the first trouble on
    landed: tuple  # (n,) bool, at the end
    faults: tuple = ()  # FaultOutcome of each of Flight.faults, in their order
    breaches: tuple = ()  # Breach
    contacts: tuple = ()  # Contact
    # for statistics; vehicles as their places in the fleet, times those of what the nodes know
    reached_s: float = 0.0  # when all were on the course
    judged: np.ndarray | None = None  # (k,) bool: settled
    namespaces: tuple = ()
    levels: tuple = ()  # of (time [s], vehicle, FailsafeLevel): what the ladders said, from the first trouble on
    unseen: tuple = ()  # of (time [s], vehicle): motion capture has lost it
    left_s: tuple = ()  # (n,) when each has left its course for good: it was to land, or crashed; infinite: never


def fly(flight):
    """Fly a Flight. Returns its Result. Raises ValueError when it cannot be flown, and RuntimeError when it crashes
    (with faults: before they begin) or does not reach its course.
    """
    started = time.perf_counter()
    fleet, types, vehicle_types = _lab(flight)
    templates = load_templates(fleet=fleet)
    world = World(
        fleet, types, templates, seed=flight.seed, perturbed=flight.perturbed, gusts=flight.gusts, step_s=FRAME_S
    )
    cameras = MocapCameras(
        CameraParams.of_arena(fleet.arena) if flight.noise else CameraParams.ideal(),
        seed=np.random.SeedSequence(flight.seed, spawn_key=(_CAMERA_STREAM,)),
    )
    names = [vehicle.template for vehicle in fleet.vehicles]
    estimator = StatesEstimator(
        templates,
        replace(PoseFitParams().within(fleet.arena), **({} if flight.noise else {"frozen_frames": 0})),
        vehicles=names,
        velocity_filter=make_filter(estimator_of(flight.controller, flight.estimator)),
    )
    yaw = None if flight.psi_deg is None else YawProgram(math.radians(flight.psi_deg))
    chosen = find_course(flight.trajectory)
    course, factor = fleet_course(chosen, fleet.vehicles, fleet.arena, flight.speed or "", yaw, **flight.course)
    own = own_params(flight.controller, fleet.vehicles, flight.fleet or "fleet '%s'" % fleet.name)
    loop = ControlLoop(flight.controller, vehicle_types, flight.params, own)
    ways = fleet_ways(WayLimits(), fleet.vehicles, factor)
    manager = make_manager(fleet.vehicles, course, limits=ways, order=loop.controller.ORDER)
    buffer = ReferenceBuffer(loop.controller.ORDER)
    phases = np.random.default_rng(np.random.SeedSequence(flight.seed, spawn_key=(_RADIO_STREAM,))).random(len(names))
    exact = {} if flight.noise else {"state_least_step_m": 0.0}  # then one that is still is seen where it was
    params = VehicleNodeParams(**{"joystick_timeout": 0.0, **fence_of(fleet.arena), **exact, **flight.node})
    separation = Separation(names, params, names, wider_m(fleet.vehicles))
    plausibility = Plausibility(dict(zip(names, vehicle_types)), params)
    chains, loss = [], flight.loss
    wires = Wires(flight.seed)
    mocap = _Mocap(wires)
    on_board = OnBoardReadings(estimator, world.vehicles.values(), wires, flight.seed, float(flight.noise))
    for i, (vehicle, fleet_vehicle, phase) in enumerate(zip(world.vehicles.values(), fleet.vehicles, phases)):
        vehicle.fly_at(fleet_vehicle.start.position_m[:2] + (1.0,), fleet_vehicle.start.yaw_rad)
        on_sent, on_battery = partial(_record_command, loop.sent, estimator, i), partial(loop.tell_battery, i)
        chains.append(_Chain(vehicle, phase, float(flight.noise), params, wires, on_sent, on_battery))
    injector = Injector(world, wires, flight.seed, {"cortex": mocap})
    for event in flight.wire_faults:
        injector.add(event, 0.0)
    for event in flight.faults:
        injector.check(event)
        if not 0.0 <= event.start_s < SETTLE_S + flight.duration_s:
            text = "fault %s starts when the flight is over: it lasts %g s from when the course is reached"
            raise ValueError(text % (event, SETTLE_S + flight.duration_s))
    records, unseen, seen_before = [], [], [False] * len(names)  # records: of Flight.faults

    everyone, nobody = np.ones(len(names), dtype=bool), np.zeros(len(names), dtype=bool)
    judged, times, references, truths = [], [], [], []
    saturated, settled_s, frame = 0, math.inf, 0
    while True:
        time_s = frame * FRAME_S
        now_s = time_s + LATENCY_S
        injector.step(now_s)
        world.step_to(time_s)
        wires.release(now_s)
        on_board.send(time_s)
        mocap.send(cameras.observe(time_s, world.layout, world.markers_m()), now_s)
        hears = False
        for frame_seen in mocap.arrived:
            update = estimator.update(frame_seen.time_s, frame_seen.layout, frame_seen.markers_m)
            if update is not None:
                estimate, stamp_s, hears = update, frame_seen.time_s, True
        mocap.arrived.clear()
        states = States(estimate.visible[: len(names)], estimate.states[: len(names)])  # attached bodies come after
        if hears:
            seen = states.visible.tolist()
            if seen != seen_before:
                unseen += [(now_s, i) for i, was_seen in enumerate(seen_before) if was_seen and not seen[i]]
                seen_before = seen
        else:
            states = states._replace(visible=nobody.copy())
        if loss is not None and time_s >= settled_s + loss.after_s:
            if loss.what == "state":
                states.visible[loss.vehicle] = False
            else:
                chains[loss.vehicle].lose(loss.what, now_s)
        if time_s >= WARM_UP_S and manager.watching:
            for name, chain, state in zip(names, chains, estimate.states):
                if not chain.pilot.autonomous:
                    manager.see(name, state[: S.U], state[S.U : S.PHI], state[S.PSI])
                    chain.press_autonomous(now_s)
                    manager.set_autonomous(name, chain.pilot.autonomous, now_s)
        reference = manager.sample(time_s)
        buffer.push(time_s, reference.derivatives[: buffer.sample_orders])  # as on the topics
        flying = time_s >= WARM_UP_S
        present, ahead = loop.pick(buffer.at(loop.times_s(stamp_s, now_s)))
        if hears:
            output = loop.update(stamp_s, now_s, states, present, ahead, everyone, everyone if flying else nobody)
        looks, suspects = {}, ()  # {name: separation.Look}
        if frame % TICK_EVERY == 0:
            believed = plausibility.look(estimate.names[: len(names)], states.visible, states.x, stamp_s)
            suspects = [plausibility.reason(name) for name in names] if (believed != states.visible).any() else ()
            separation.see(estimate.names[: len(names)], believed, states.x, stamp_s)
            course_m = np.ascontiguousarray(reference.derivatives[:3].transpose(1, 0, 2))  # as on /trajectory
            separation.refer(estimate.names[: len(names)], course_m, time_s)
            if separation.asks:
                separation.tell({name for name, chain in zip(names, chains) if chain.pilot.holds_alone})
            looks = separation.look(now_s)
        controls, looks = output.controls if hears else None, [looks.get(name, ALONE) for name in names]
        step_chains(chains, frame, stamp_s, now_s, states, controls, looks, suspects)
        if flying:
            saturated += np.count_nonzero(output.saturated) if hears else 0
            if settled_s == math.inf and all(phase is Phase.COURSE for phase in reference.phases):
                settled_s = time_s + SETTLE_S
                records = [injector.add(event, now_s) for event in flight.faults]
            if frame % JUDGE_EVERY == 0:
                times.append(time_s)
                references.append(reference.derivatives[0, :, :3])
                truths.append(world.truth()[:, :3])
                judged.append(time_s >= settled_s)
        if world.crashes and not records:
            crash = world.crashes[0]
            raise RuntimeError("%s %s after %.1f s (%r)" % (crash.namespace, crash.reason, crash.time_s, flight))
        if settled_s == math.inf and time_s >= LONGEST_WAY_S:
            manual = ", ".join(name for name, chain in zip(names, chains) if not chain.pilot.autonomous) or "none"
            phases = ", ".join("%s: %s" % (name, phase.name.lower()) for name, phase in zip(names, reference.phases))
            raise RuntimeError(
                "not on the course after %g s (%s; not autonomous: %s; %r)" % (time_s, phases, manual, flight)
            )
        if time_s >= settled_s + flight.duration_s:
            over = not records or time_s >= settled_s + flight.duration_s + LANDING_S
            if over or not any(chain.lands for chain in chains):
                break
        if records and all(chain.rests for chain in chains):
            break
        frame += 1

    references, truths, judged = np.array(references), np.array(truths), np.array(judged)
    errors = np.sqrt(((references - truths) ** 2).sum(axis=2))[judged]
    if not judged.any():  # all have landed before
        errors = np.full((1, len(names)), math.nan)
    breaches, contacts = _breaches(world, chains), _contacts(world)
    between = [truths[:, i] - truths[:, j] for i, j in combinations(range(len(names)), 2)]
    return Result(
        names=tuple(names),
        rmse_m=np.sqrt((errors**2).mean(axis=0)),
        max_m=errors.max(axis=0),
        closest_m=min((float(np.linalg.norm(way_m, axis=1).min()) for way_m in between), default=math.inf),
        saturated=saturated / (len(names) * (frame + 1)),
        flown_s=time_s,
        safety=tuple(
            sorted((said_s, name, said.text) for name, chain in zip(names, chains) for said_s, said in chain.said)
        ),
        landed=tuple(chain.landed for chain in chains),
        faults=tuple(_judge_faults(records, chains, breaches, contacts)),
        breaches=breaches,
        contacts=contacts,
        reached_s=settled_s - SETTLE_S,
        judged=judged,
        namespaces=tuple(chain.name for chain in chains),
        levels=tuple(sorted((said_s, i, said.level) for i, chain in enumerate(chains) for said_s, said in chain.said)),
        unseen=tuple(unseen),
        left_s=tuple(_left_s(chain, breaches, contacts) for chain in chains),
        took_s=time.perf_counter() - started,
        times_s=np.array(times),
        reference_m=references,
        actual_m=truths,
    )


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


def _record_command(history, estimator, i, time_s, command):
    """A command was sent: for the controller, and for a filter that asks for it."""
    history.append(i, time_s, command)
    estimator.on_board(estimator.names[i], time_s, COMMAND, command)


def _breaches(world, chains):
    """Breaches in the order of their times; of one that fell without a crash: when its motors stood still."""
    found = [Breach(crash.time_s, crash.namespace, crash.reason) for crash in world.crashes if not crash.other]
    crashed = {crash.namespace for crash in world.crashes}
    found += [Breach(chain.fell_s, chain.name, "fell: its motors were cut") for chain in chains
              if chain.fell_s is not None and chain.name not in crashed]  # fmt: skip
    return tuple(sorted(found))


def _contacts(world):
    """Each pair that touched, once a touch."""
    pairs = {(crash.time_s, *sorted((crash.namespace, crash.other))) for crash in world.crashes if crash.other}
    return tuple(Contact(*pair) for pair in sorted(pairs))


def _left_s(chain, breaches, contacts):
    """When a vehicle has left its course for good; infinite: never."""
    times_s = [said_s for said_s, verdict in chain.said if verdict.level is FailsafeLevel.LAND]
    times_s += [breach.time_s for breach in breaches if breach.name == chain.name]
    times_s += [contact.time_s for contact in contacts if chain.name in (contact.name, contact.other)]
    return min(times_s + chain.descents_s, default=math.inf)


def _judge_faults(records, chains, breaches, contacts):
    """Yield a FaultOutcome of each FaultRecord: what happened from its begin to that of the next one counts."""
    begins_s = sorted(record.begins_s for record in records)
    for record in records:
        until_s = min((begin_s for begin_s in begins_s if begin_s > record.begins_s), default=math.inf)
        said = sorted(
            (said_s, verdict.level, chain.down)
            for chain in chains
            for said_s, verdict in chain.said
            if record.begins_s <= said_s < until_s and verdict.level > FailsafeLevel.OK
        )
        touched, hurt = (
            any(record.begins_s - LATENCY_S <= event.time_s < until_s for event in events)
            for events in (contacts, breaches)
        )
        landings = [down for _, level, down in said if level is FailsafeLevel.LAND]
        for chain in chains:
            landings += [chain.down for descent_s in chain.descents_s if record.begins_s <= descent_s < until_s]
        if hurt or touched or not all(landings):
            outcome = "breach"
        elif landings:
            outcome = "landed"
        else:
            levels = (chain.levels(record.begins_s, until_s) for chain in chains)
            outcome = "held" if any(own and own[-1] > FailsafeLevel.OK for own in levels) else "completed"
        yield FaultOutcome(
            record.event.fault,
            record.event.args,
            record.begins_s - LATENCY_S,
            None if record.ends_s == math.inf else record.ends_s - LATENCY_S,
            outcome,
            outcome in record.event.settings.safe and not touched,
            1e3 * (said[0][0] - record.begins_s) if said else None,
        )


class _Mocap:
    """From the cameras to what the estimator hears: Cortex and the network. It is also the host that faults stop."""

    def __init__(self, wires):
        self._frames, self._stream = wires.frames("cortex/frames"), wires.wire("cortex/stream")
        self._runs, self._first = True, True
        self.arrived = []  # Observations

    def stop(self):
        """The program ends."""
        self._runs = False

    def start(self):
        """It begins again, and its clients find it at once."""
        self._runs = True

    def send(self, seen, now_s):
        """The cameras have seen this."""
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


class _Chain:
    """From /controls to the vehicle's on-board logic: vehicle node, and the link of its type."""

    def __init__(self, vehicle, phase, noise, params, wires, on_sent, on_battery):
        """phase: of the radio's clock, a fraction.  noise: of its sensors, a factor.  params: VehicleNodeParams.
        on_sent: takes the time and the command, as `CommandHistory.append`, of whatever is sent.
        on_battery: takes the charge that the vehicle tells, and when.
        """
        self._on_sent, self._on_battery = on_sent, on_battery
        self._flies_itself = adapter_class(vehicle.type).FLIES_ITSELF
        self._link = vehicle.virtual.OfflineLink(vehicle, phase, noise)
        self._report_every = TICK_EVERY * round(self._link.REPORT_PERIOD_S / (TICK_EVERY * FRAME_S))  # frames
        self.pilot = VehiclePilot(params, vehicle.type, 0.0)
        self.name, self._vehicle, self._phase = vehicle.namespace, vehicle, None
        self.said = []  # (time [s], Verdict) of its ladder, from the first trouble on
        self.fell_s = None  # when its motors were cut in the air
        self.descents_s = []  # when it began to land, whoever wanted that
        self.lost = None  # "controls" or "laptop"
        self._wire = wires.wire("%s/commands" % vehicle.namespace)
        self._reports = wires.wire("%s/navdata" % vehicle.namespace)

    def press_autonomous(self, now_s):
        """The operator presses the button, and lets go."""
        buttons = [0] * 11
        self.pilot.on_joy(buttons, [0.0] * 8, now_s)
        buttons[VehicleNodeParams().JoytoWay] = 1
        self.pilot.on_joy(buttons, [0.0] * 8, now_s)

    def lose(self, what, now_s):
        """From now on it has no controller or no laptop; of the second the vehicle takes notice by itself."""
        if what == "laptop" and self.lost is None:
            self._link.lose(now_s)
        self.lost = what

    @property
    def landed(self):
        """Whether the vehicle stands on the floor by its own report."""
        return self._link.report()[0] is FlightPhase.LANDED

    def levels(self, begin_s, end_s):
        """Levels that its ladder entered in this time."""
        return [verdict.level for said_s, verdict in self.said if begin_s <= said_s < end_s]

    @property
    def lands(self):
        """Whether it is to land, and has not."""
        return self.pilot.ladder.verdict.level is FailsafeLevel.LAND and not self.down

    @property
    def down(self):
        """Whether the vehicle stands, or lies, on the floor."""
        return not self._vehicle.firmware.lifted

    @property
    def rests(self):
        """Whether it is down for good: its motors stand still."""
        return self.down and not self._vehicle.firmware.motors_on

    def see(self, visible, state, stamp_s, now_s, frame, look, suspect=""):
        """What the vehicle node looks at once a tick. state: list of 12, columns `S`.  suspect: what it contradicts."""
        pilot = self.pilot
        if frame % self._report_every == 0:
            self._reports.carry(self._link.report(), None, now_s, self._hear)
            self._watch(self._vehicle.phase, now_s)
            if not self._flies_itself:
                pilot.on_wire(now_s)
        if visible and suspect:
            pilot.on_suspect(suspect, now_s)
        elif visible:
            own = OwnState(state[: S.U], state[S.U : S.PHI], *state[S.PHI : S.P])
            pilot.on_state(own, now_s - stamp_s, now_s, look)

    def _watch(self, phase, now_s):
        if phase is FlightPhase.EMERGENCY and self.fell_s is None:
            self.fell_s = now_s - LATENCY_S
        if phase is FlightPhase.LANDING and self._phase is not phase:
            self.descents_s.append(now_s)
        self._phase = phase

    def _hear(self, report, _, now_s):
        """The vehicle's report has arrived."""
        phase, battery_pct, velocity_m_s = report
        self.pilot.on_status(Status(_REPORTS[phase], battery_pct, velocity_m_s), now_s)
        self._on_battery(battery_pct, now_s)

    def send(self, orders, now_s):
        """Hand what was ordered to the vehicle's link."""
        if orders.safety is not None and (self.said or self.pilot.ladder.verdict.level > FailsafeLevel.OK):
            self.said.append((now_s, orders.safety))
        if orders.land:
            self._wire.carry(FlightAction.LAND, None, now_s, self._order)
        if orders.disarm:
            self._wire.carry(FlightAction.CUT_MOTORS, None, now_s, self._order)
        if orders.command is not None:
            self._on_sent(now_s, orders.command.settles_at)
            send = partial(self._send, orders.level_only)
            self._wire.carry(orders.command.sticks, None, now_s, send)

    def _send(self, level_only, sticks, _, now_s):
        self._link.send(sticks, now_s, level_only)

    def _order(self, action, _, at_s):
        self._link.order(action, at_s)

    def deliver(self, now_s):
        """Give the vehicle what the radio brings."""
        self._link.deliver(now_s)


def step_chains(chains, frame, stamp_s, now_s, states, controls, looks, suspects=()):
    """One frame of the vehicle nodes: they answer it where a command is due, and look around once a tick.

    states: States at stamp_s.  controls: the controller's answer; None: no frame has come.
    looks: `separation.Look` of each vehicle.  suspects: what the state of each contradicts; () = none's does.
    """
    ticks, commands = frame % TICK_EVERY == 0, None
    if ticks:
        visible, x = states.visible.tolist(), states.x.tolist()
    for i, chain in enumerate(chains):
        pilot = chain.pilot
        if chain.lost == "laptop":
            continue
        if ticks:
            if controls is not None and not visible[i]:
                pilot.on_unseen()
            chain.see(visible[i], x[i], stamp_s, now_s, frame, looks[i], suspects[i] if suspects else "")
        sends = now_s >= pilot.next_command_s
        if (sends or ticks) and chain.lost is None and controls is not None:
            if commands is None:
                commands = list(zip(*[part.tolist() for part in controls]))
            own = Controls(*commands[i])
            if sends:
                chain.send(pilot.on_controls(own, stamp_s, now_s - stamp_s, now_s), now_s)
            else:
                pilot.hear_controls(own, now_s - stamp_s, now_s)
        if ticks:
            chain.send(pilot.tick(now_s), now_s)
        chain.deliver(now_s)


def _lab(flight):
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
    add("--ideal", action="store_false", help="the plant is exactly the nominal model", dest="perturbed")
    add("--gusts", action="store_true")
    add("--fault", type=fault_option, action="append", default=[], metavar="NAME[:ARG][@SECONDS]", dest="faults",
        help="what goes wrong, so many seconds after the course is reached; may be given again; ./maap faults lists "
        "them")  # fmt: skip
    add("--json", type=pathlib.Path, metavar="FILE", help="also write the figures of each flight here")
    add("--workers", type=int, metavar="N", help="flights at the same time (default: a core each)")
    add("--compile", action="store_true", help="only compile what flies (see risc_lab.compiled)")
    args = parser.parse_args(argv)
    if args.compile:
        _compile()
        return 0
    common = ("vehicles", "fleet", "duration_s", "controller", "estimator", "perturbed", "gusts", "speed")
    common = {name: getattr(args, name) for name in common}
    flights = [
        Flight(course, seed=seed, delay_s=delay_s, psi_deg=YAW_BY_SEED_DEG * seed if args.psi is None else args.psi,
               faults=tuple(args.faults), **common)
        for course in args.trajectory for delay_s in args.delay or [None] for seed in range(1, args.seeds + 1)
    ]  # fmt: skip
    progress, rows, everyone, unsafe = Progress(), [], {}, False
    print("%-9s %6s %5s  %-28s %6s %6s %7s %5s" % ("course", "delay", "seed", "RMSE of each vehicle [mm]", "median",
          "worst", "closest", "speed"))  # fmt: skip
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
                print("%s %5d  %-28s %6.1f %6.1f %5.2f m %4.1fx" % (
                    group, flight.seed, " ".join("%.1f" % value for value in rmse_mm), np.median(rmse_mm),
                    rmse_mm.max(), result.closest_m, speed), flush=True)  # fmt: skip
            if flight.seed == args.seeds and group in everyone:
                print("%s %5s  %-28s %6.1f %6.1f" % (
                    group, "all", "", np.median(everyone[group]), max(everyone[group])))  # fmt: skip
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
    """What became of the faults of a flight, e.g. "mocap_blackout:3 landed after 105 ms"."""
    told = []
    for fault in result.faults:
        after = "" if fault.reaction_ms is None else " after %.0f ms" % fault.reaction_ms
        told.append("%s:%s %s%s%s" % (fault.name, fault.args, fault.outcome, after, "" if fault.safe else " (unsafe)"))
    return "; ".join(told)


def _compile():
    """Have numba compile and keep all that runs in every frame of a flight."""
    from risc_control.ros.conversions import ControlsMessage, StatesReader  # the nodes', with ROS only
    from risc_estimation.ros.conversions import EstimateMessages

    fly(Flight(vehicles=2, gusts=True, duration_s=0.5))
    fly(Flight(vehicles=1, gusts=True, duration_s=0.5, types=("iris",)))
    for name in CONTROLLERS.names():
        ControlLoop(name, [load_vehicle_type("ardrone")])
    FrameEncoder((("body", 1),))  # the virtual lab's
    clip_polygons(np.zeros((3, 3)), np.array([3]), np.zeros((1, 4)))  # its cameras'
    coverage([np.zeros((3, 2))], (0, 0, 1, 1))
    StatesReader(())
    ControlsMessage(())
    EstimateMessages()


if __name__ == "__main__":
    sys.exit(main())
