"""Faults that were injected into the virtual lab and the programs of a flight: outcome and reaction of each.

What happens from the start of a fault to the start of the next one is attributed to the first.
"""

import bisect
import math
from collections import defaultdict
from dataclasses import dataclass
from typing import NamedTuple

from data_extraction.flatten import seconds
from data_extraction.report.recorded_topics import Collector, vehicle_of
from risc_control.safety import FailsafeLevel, Rule
from risc_lab.lab.arena import Arena
from risc_lab.lab.fleet import laboratory_vehicles
from risc_lab.phases import OperatorPhase, OperatorResult, OutCause

LANDED_HEIGHT_M = 0.15  # a vehicle on the ground is not higher
FALL_M_S = 2.0  # no vehicle descends this fast on purpose
_NEVER_S = math.inf
TOLD, INPUTS = "/virtual_lab/told", "/virtual_lab/inputs"
_SOONER_S = 0.001  # a command may reach the vehicle before its node has noted when it sent it
FAULT_TOPICS = "/virtual_lab/faults", "/program_faults"


def fault_text(name, args):
    """A fault as on the command line."""
    return ":".join(filter(None, (name, args)))


@dataclass(frozen=True)
class FaultOutcome:
    """A fault and its outcome."""

    name: str
    args: str  # as on the command line
    vehicle: str  # namespace; "" = none in particular, "*" = each
    begin_s: float  # ROS time, like the others
    end_s: float | None  # None = it lasted until the end
    outcome: str  # completed, held, landed or breach
    is_safe: bool  # its record lists that outcome as safe, and no two vehicles touched
    # namespace -> time from its begin to the first command with a higher failsafe level than before, or to the first
    # order to hover or to land, e.g. by its driver: when it reached a virtual vehicle, else when it was sent
    reactions_s: dict[str, float]
    flying: int  # how many vehicles flew when it began

    @property
    def reaction_s(self):
        """The shortest one; None without any."""
        return min(self.reactions_s.values(), default=None)

    @property
    def text(self):
        """As on the command line."""
        return fault_text(self.name, self.args)

    def is_of(self, namespace):
        """Whether it may concern this vehicle."""
        return self.vehicle in ("", "*", namespace)


class Out(NamedTuple):
    """A vehicle that dropped out of the flight."""

    time_s: float
    cause: OutCause
    reason: str


@dataclass
class Faults:
    """All faults of a flight."""

    outcomes: list[FaultOutcome]  # by their begins
    waiting: int  # number of faults that never began
    course_s: float | None  # when all were on the course
    out: dict[str, Out]  # by namespace
    left_ok_s: dict[str, float]  # namespace -> when the level of its ladder last rose
    kept_apart: set[str]  # namespaces of those that landed because others were too near

    def __bool__(self):
        return bool(self.outcomes)

    def marks(self, zero_s):
        """[(begin [s], end [s]; infinite: none)] of each fault, for plots whose times count from zero_s."""
        ends_s = (math.inf if fault.end_s is None else fault.end_s for fault in self.outcomes)
        return [(fault.begin_s - zero_s, end_s - zero_s) for fault, end_s in zip(self.outcomes, ends_s)]

    def figures(self):
        """List of dicts ready for JSON: `faults` of summary.json."""
        return [
            {
                "name": fault.name,
                "args": fault.args,
                "vehicle": fault.vehicle,
                "start_s": _rounded(fault.begin_s, self.course_s),
                "end_s": _rounded(fault.end_s, self.course_s),
                "outcome": fault.outcome,
                "safe": fault.is_safe,
                "reaction_ms": None if fault.reaction_s is None else round(1e3 * fault.reaction_s, 3),
                "reactions_ms": {name: round(1e3 * time_s, 3) for name, time_s in sorted(fault.reactions_s.items())},
                "flying": fault.flying,
            }
            for fault in self.outcomes
        ]


# level for each order of risc_maap_msgs/Told: nothing, fly, hover, land
_LEVELS = FailsafeLevel.OK, FailsafeLevel.OK, FailsafeLevel.HOLD, FailsafeLevel.LAND


class _Change(NamedTuple):
    """A change of a vehicle's failsafe level."""

    time_s: float
    vehicle: str
    level: FailsafeLevel
    is_rise: bool


class FaultCollector(Collector):
    """Keeps faults, changes of failsafe levels, crashes; its memory grows with their number only."""

    topics = (
        *FAULT_TOPICS, "/virtual_lab/crash", TOLD, INPUTS, "/ground_truth", "/commands_sent", "/operator/phase",
        "/operator/result",
    )  # fmt: skip
    ends = ("/safety",)

    def __init__(self, fleet=None):
        """fleet: risc_lab.lab.Fleet, None = the original laboratory's."""
        self._arena = fleet.arena if fleet else Arena()
        vehicles = fleet.vehicles if fleet else laboratory_vehicles()
        self._namespaces = {vehicle.template: vehicle.namespace for vehicle in vehicles}
        self._faults = {}  # (topic, id) -> its newest FaultRecord
        self._began = {}  # (topic, id) -> when it began
        self._levels = {}  # (topic, vehicle) -> its level
        self._changes = {"/safety": [], "/commands_sent": [], TOLD: []}  # levels reported, sent, received
        self._inputs_s = defaultdict(list)  # vehicle -> when it received other inputs than before
        self._hurt_s = []  # when a vehicle touched something, left the net, or fell
        self._contacts_s = []  # when two touched each other
        self._hurt = set()  # vehicles that are outside, or falling
        self._heights_m = {}
        self._kept_apart = set()
        self._begin_flight(-_NEVER_S)

    def _begin_flight(self, time_s):
        """The operator waits for take-off; its earlier messages are of another flight."""
        self._waited_s = time_s
        self._course_s, self._landing_s, self._over_s = None, _NEVER_S, _NEVER_S
        self._out = {}

    def __call__(self, topic, receipt_s, message):
        if topic in FAULT_TOPICS:
            for record in message.faults:
                self._faults[topic, record.id] = record
                if record.active:
                    self._began.setdefault((topic, record.id), seconds(record.begins))
        elif topic == "/ground_truth":
            if self._faults:
                self._look(message)
        elif topic == "/commands_sent":
            for command in message.commands:
                vehicle = self._namespaces.get(command.name, command.name)
                self._note_level(topic, vehicle, getattr(command, "level", 0), seconds(command.sent))
        elif topic == TOLD:
            self._note_level(topic, message.vehicle, _LEVELS[message.order], seconds(message.header.stamp))
        elif topic == INPUTS:
            self._inputs_s[message.vehicle].append(seconds(message.header.stamp))
        elif topic == "/virtual_lab/crash":
            self._hurt_s.append(seconds(message.header.stamp))
            if message.other:
                self._contacts_s.append(seconds(message.header.stamp))
        elif topic.startswith("/operator/"):
            self._hear_operator(message)
        else:
            vehicle = vehicle_of(topic)
            self._note_level("/safety", vehicle, message.level, seconds(message.header.stamp))
            if message.level == FailsafeLevel.LAND and message.rule == Rule.SEPARATION:
                self._kept_apart.add(vehicle)

    def _look(self, message):
        arena, stamp_s = self._arena, seconds(message.header.stamp)
        for state in message.Obj:
            self._heights_m[self._namespaces.get(state.name, state.name)] = state.z
            # the net holds it where it is
            inside = abs(state.x) < arena.half_x_m and abs(state.y) < arena.half_y_m and state.z < arena.height_m
            if inside and state.w > -FALL_M_S:
                self._hurt.discard(state.name)
            elif state.name not in self._hurt:
                self._hurt.add(state.name)
                self._hurt_s.append(stamp_s)

    def _note_level(self, topic, vehicle, level, time_s):
        before = self._levels.get((topic, vehicle), FailsafeLevel.OK)
        if level != before:
            self._changes[topic].append(_Change(time_s, vehicle, FailsafeLevel(level), level > before))
            self._levels[topic, vehicle] = level

    def _hear_operator(self, message):
        stamp_s = seconds(message.header.stamp)
        if stamp_s < self._waited_s:
            return  # a latched message of the flight before
        is_flying = self._course_s is not None and self._landing_s == _NEVER_S  # then a restarted operator waits
        if message.phase == OperatorPhase.WAITING and message.result == OperatorResult.RUNNING and not is_flying:
            self._begin_flight(stamp_s)
        if self._course_s is None and getattr(message, "on_course", False):
            self._course_s = stamp_s
        if message.phase >= OperatorPhase.LAND:
            self._landing_s = min(self._landing_s, stamp_s)
        if message.phase > OperatorPhase.LAND:
            self._over_s = min(self._over_s, stamp_s)
        for vehicle in getattr(message, "out", ()):
            self._out.setdefault(vehicle.name, Out(stamp_s, OutCause(vehicle.cause), vehicle.reason))

    def result(self, end_s):
        """The Faults of the flight."""
        end_s = min(end_s, self._over_s)
        begins_s = {key: begin_s for key, begin_s in self._began.items() if begin_s < end_s}
        outcomes = [
            self._judge(self._faults[key], begin_s, begins_s.values())
            for key, begin_s in sorted(begins_s.items(), key=lambda item: item[1])
        ]
        left_ok_s = {change.vehicle: change.time_s for change in self._changes["/safety"] if change.is_rise}
        waiting = len(self._faults) - len(outcomes)
        return Faults(outcomes, waiting, self._course_s, dict(self._out), left_ok_s, set(self._kept_apart))

    def _received(self, sent):
        """A _Change of the commands sent, with the time at which it reached a virtual vehicle; infinite: it did not."""
        inputs_s = self._inputs_s.get(sent.vehicle)
        if not inputs_s:
            return sent
        index = bisect.bisect_left(inputs_s, sent.time_s - _SOONER_S)
        return sent._replace(time_s=inputs_s[index] if index < len(inputs_s) else _NEVER_S)

    def _judge(self, record, begin_s, begins_s):
        """FaultOutcome of a FaultRecord. begins_s: of all faults."""
        until_s = min((other_s for other_s in begins_s if other_s > begin_s), default=_NEVER_S)
        # after that, vehicles land because the operator lands them
        said_until_s = min(until_s, max(self._landing_s, begin_s))
        said = [change for change in self._changes["/safety"] if begin_s <= change.time_s < said_until_s]
        landed = {change.vehicle for change in said if change.level >= FailsafeLevel.LAND}
        landed |= {vehicle for vehicle, out in self._out.items() if begin_s <= out.time_s < until_s}
        at_last = {change.vehicle: change.level for change in said}
        is_hurt, is_contact = (
            any(begin_s <= time_s < until_s for time_s in times_s) for times_s in (self._hurt_s, self._contacts_s)
        )
        if is_hurt or any(self._heights_m.get(vehicle, 0.0) > LANDED_HEIGHT_M for vehicle in landed):
            outcome = "breach"
        elif landed:
            outcome = "landed"
        else:
            outcome = "held" if any(at_last.values()) else "completed"
        reactions_s = {}
        came = [change for change in self._changes[TOLD] if change.time_s < said_until_s]
        came += map(self._received, self._changes["/commands_sent"])
        for change in sorted(came):
            if change.is_rise and begin_s <= change.time_s < until_s:
                reactions_s.setdefault(change.vehicle, change.time_s - begin_s)
        return FaultOutcome(
            name=record.name,
            args=record.args,
            vehicle=record.vehicle,
            begin_s=begin_s,
            end_s=seconds(record.ends) or None,
            outcome=outcome,
            is_safe=outcome in list(record.safe) and not is_contact,
            reactions_s=reactions_s,
            flying=sum(name not in self._out or self._out[name].time_s > begin_s for name in self._namespaces.values()),
        )


def _rounded(time_s, zero_s):
    return None if time_s is None or zero_s is None else round(time_s - zero_s, 3)
