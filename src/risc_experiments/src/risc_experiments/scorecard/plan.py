"""What a scorecard flies: its cells, and the flights of each with their faults, generated from a seed."""

import math
import pathlib
from dataclasses import dataclass, replace
from typing import NamedTuple
from zlib import crc32

import numpy as np

from risc_experiments.fleets import default_fleet
from risc_experiments.offline import SETTLE_S, YAW_BY_SEED_DEG, Flight
from risc_lab.lab import load_vehicle_type
from risc_lab.lab.yaml_reader import load_yaml, package_file
from risc_lab.settings import Name, NotNegative, Positive, Settings, between, settings_from
from risc_simulator.faults import REGISTRY, FaultEvent, fault_settings, load_faults

NONE, RANDOM = "none", "random"  # not members: no fault; random members that can end safely
GRADES = ("mild", "medium", "severe")
WHOLE = "-"  # severity of what has no grades
_ENOUGH_MIN = 0.01
_MOST_FLIGHTS = 10  # of a cell: times the number that would be enough if each lasted to its end


@dataclass(frozen=True)
class EventParams(Settings):
    """When the faults of a flight act [s]."""

    first_s: NotNegative = SETTLE_S
    quiet_s: tuple[Positive, Positive] = (2.5, 4.0)
    longest_s: Positive = 3.0
    settle_s: Positive = 2.0

    def __post_init__(self):
        super().__post_init__()
        if self.quiet_s[0] > self.quiet_s[1] or self.quiet_s[0] < self.settle_s:
            raise ValueError("'quiet_s' is the least and the greatest, and at least 'settle_s'")


@dataclass(frozen=True)
class RandomParams(Settings):
    """How `random` draws."""

    duration_s: tuple[Positive, Positive] = (0.1, 3.0)


@dataclass(frozen=True)
class QuickParams(Settings):
    """What --quick changes."""

    faults: tuple[str, ...] = ()
    severities: tuple[str, ...] = GRADES
    minutes: Positive = 0.5
    flight_s: Positive = 30.0


@dataclass(frozen=True)
class ScorecardParams(Settings):
    """Content of config/scorecard.yaml."""

    trajectories: tuple[Name, ...] = ("circle",)
    vehicles: between(1, 50) = 3
    types: tuple[Name, ...] = ()
    flight_s: Positive = 60.0
    least_flight_s: Positive = 20.0
    minutes: Positive = 2.0
    leave_out: tuple[str, ...] = ()
    events: EventParams = EventParams()
    random: RandomParams = RandomParams()
    quick: QuickParams = QuickParams()

    def __post_init__(self):
        super().__post_init__()
        if len(self.types) not in (0, self.vehicles):
            raise ValueError("'types' has %d names, for %d vehicles" % (len(self.types), self.vehicles))
        for name in self.types:
            load_vehicle_type(name)


def load_params(path=None):
    """ScorecardParams of config/scorecard.yaml, with the values of another file in place of its own. Raises ValueError.

    The other file names only what differs: whole keys (`quick`, say, with all that it contains).
    """
    default = package_file("risc_experiments", "config/scorecard.yaml")
    values = load_yaml(default) | (load_yaml(path) if path else {})
    return settings_from(ScorecardParams, values, str(path or default))


class Cell(NamedTuple):
    """A row of the scorecard."""

    fault: str  # name of a member, NONE, RANDOM, or path of a file with a list of faults
    severity: str  # grade; WHOLE where there are none
    estimator: str
    controller: str


class Plan(NamedTuple):
    """A whole scorecard."""

    cells: tuple[Cell, ...]
    flight_s: float  # on the course
    minutes: float  # of each cell, where `seeds` is None
    seeds: tuple[int, ...] | None  # of the flights of each cell; None: 1, 2, ..., as many as the minutes take
    ladder: bool
    params: ScorecardParams

    def flight(self, cell, seed):
        """The Flight of a cell with this seed (1, 2, ...). Every estimator and controller gets the same faults."""
        trajectory = self.params.trajectories[seed % len(self.params.trajectories)]
        vehicles = list(vehicles_of(self.params, trajectory).values())
        key = crc32(pathlib.PurePath(cell.fault).name.encode()), crc32(cell.severity.encode())
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
        events = self._events(cell, vehicles, rng)
        ends_s = [event.start_s + event.duration_s for event in events if math.isfinite(event.duration_s)]
        flight_s = max([self.flight_s, *(end_s + self.params.events.settle_s for end_s in ends_s)])
        return Flight(
            trajectory,
            vehicles=self.params.vehicles,
            types=self.params.types,
            seed=seed,
            duration_s=flight_s - SETTLE_S,
            psi_deg=YAW_BY_SEED_DEG * seed % 360.0,
            controller=cell.controller,
            estimator=cell.estimator,
            node={} if self.ladder else {"ladder": False},
            faults=events,
        )

    def check(self, cell):
        """Raises ValueError when not one event of a cell fits into a flight."""
        if cell.fault != NONE and not self.flight(cell, 1).faults:
            text = "fault %s: flights of %.0f s on the course are too short for it: more --minutes"
            raise ValueError(text % (cell.fault, self.flight_s))

    def _events(self, cell, vehicles, rng):
        if cell.fault == NONE:
            return ()
        if is_file(cell.fault):
            return load_faults(cell.fault)
        return script(lambda: self._draw(cell, rng), self.params.events, vehicles, self.flight_s, rng)

    def _draw(self, cell, rng):
        """FaultEvent of a cell, without a time yet."""
        if cell.fault == RANDOM:
            return random_fault(safe_members(self.params), self.params.random, rng)
        settings = fault_settings(cell.fault)
        return _event(cell.fault, settings, settings.grades.get(cell.severity), self.params.events.longest_s)

    def wanting(self, flown):
        """Yields (cell, seed) of the flights that are still to be flown. flown: {cell: {seed: minutes}}."""
        for cell in self.cells:
            done = flown.get(cell, {})
            seeds = self.seeds
            if seeds is None:
                seeds = range(1, self._count(len(done), sum(done.values())) + 1)
            yield from ((cell, seed) for seed in seeds if seed not in done)

    def part(self, flown):
        """Fraction of the plan that is done."""
        if self.seeds is not None:
            return sum(map(len, flown.values())) / (len(self.seeds) * len(self.cells))
        return sum(min(sum(done.values()) / self.minutes, 1.0) for done in flown.values()) / len(self.cells)

    def _count(self, flights, minutes):
        """How many flights a cell needs, after this many flights of this many minutes in all: some end early."""
        whole = self.flight_s / 60.0
        missing = self.minutes - minutes
        if missing <= _ENOUGH_MIN:
            return flights
        mean = max(minutes / flights, whole / _MOST_FLIGHTS) if flights else whole
        return min(flights + math.ceil(missing / mean), _MOST_FLIGHTS * math.ceil(self.minutes / whole))


def script(draw, params, vehicles, flight_s, rng):
    """FaultEvents at random times, one after another with quiet between them, as many as fit into a flight.

    draw: function that gives the next FaultEvent, without a vehicle and a time.  params: EventParams.  vehicles: their
    namespaces.  flight_s: on the course.
    """
    events, begin_s = [], params.first_s
    while True:
        event = draw()
        begin_s += rng.uniform(0.0, params.quiet_s[1] - params.quiet_s[0])
        end_s = begin_s + event.duration_s
        if end_s + params.settle_s > flight_s:
            return tuple(events)
        vehicle = vehicles[rng.integers(len(vehicles))] if event.settings.per_vehicle else ""
        events.append(replace(event, vehicle=vehicle, start_s=round(begin_s, 3)))
        begin_s = end_s + params.quiet_s[0]


def random_fault(names, params, rng):
    """FaultEvent of a random member, with an argument in the range of its grades. params: RandomParams."""
    name = names[rng.integers(len(names))]
    settings = fault_settings(name)
    values = settings.grades.values()
    argument = between_log(min(values), max(values), rng)
    return _event(name, settings, argument, between_log(*params.duration_s, rng), always=True)


def _event(name, settings, argument, duration_s, always=False):
    """FaultEvent of a member. duration_s: is used if the member's default has no end, or always."""
    if settings.argument == "duration":
        return FaultEvent(name, duration_s=argument)
    low_s, high_s = settings.duration_s
    if not always and math.isfinite(settings.default.duration_s):
        duration_s = settings.default.duration_s
    return FaultEvent(name, severity=argument, duration_s=min(max(duration_s, low_s), high_s))


def between_log(low, high, rng):
    """Random number between low and high, log-uniform; uniform if low is not positive."""
    if low <= 0.0:
        return float(rng.uniform(low, high))
    return float(min(max(math.exp(rng.uniform(math.log(low), math.log(high))), low), high))


def vehicles_of(params, trajectory=None):
    """{template: namespace} of the vehicles that fly."""
    fleet = default_fleet(params.vehicles, trajectory or params.trajectories[0])
    return {vehicle.template: vehicle.namespace for vehicle in fleet.vehicles}


def severities_of(fault, severities):
    """The severities, of those given, that a fault of a cell has."""
    if fault in (NONE, RANDOM) or is_file(fault):
        return (WHOLE,)
    return tuple(grade for grade in severities if grade in fault_settings(fault).grades)


def is_file(fault):
    """Whether a fault is given as a file, not as the name of a member."""
    return pathlib.PurePath(fault).suffix in (".yaml", ".yml")


def members(params):
    """Names of the faults that are graded, sorted."""
    return [name for name in REGISTRY.names() if fault_settings(name).grades and name not in params.leave_out]


def safe_members(params):
    """Names of the graded faults with which a flight can end safely."""
    return [name for name in members(params) if "breach" not in fault_settings(name).safe]
