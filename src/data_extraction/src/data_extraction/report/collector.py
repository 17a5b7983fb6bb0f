"""One pass over a bag for everything that the report shows."""

from dataclasses import dataclass

from data_extraction.bags import Bag
from data_extraction.bearing_errors import ANGLES
from data_extraction.flight_metrics import Flight, FlightCollector
from data_extraction.report.battery import Battery, BatteryCollector
from data_extraction.report.computers import Computer, ComputerCollector
from data_extraction.report.drops import DropCollector, Drops
from data_extraction.report.events import Event, EventCollector
from data_extraction.report.fence import FenceCollector, FenceMargin
from data_extraction.report.gates import GateCollector, GateCounts
from data_extraction.report.ladder import LadderCollector, Span
from data_extraction.report.origin import Origin
from data_extraction.report.snapshots import Snapshot, SnapshotCollector
from data_extraction.report.topics import fits
from risc_control.failsafe import SafetyLimits, fence_of
from risc_lab.lab.arena import Arena


@dataclass
class Material:
    """Everything a report is made of."""

    bag: Bag  # closed
    foreign: list[str]  # topics that were not read: their names are the lab's, their types are not
    origin: Origin
    flight: Flight
    drops: Drops | None
    gates: dict[str, GateCounts]
    computers: dict[str, Computer]
    ladder: dict[str, list[Span]]
    ladder_left_out: int
    batteries: dict[str, Battery]
    margins: dict[str, FenceMargin]
    snapshots: list[Snapshot]
    snapshot_notes: list[str]
    events: list[Event]
    events_left_out: int

    @property
    def zero_s(self):
        """ROS time that the report calls 0: of the first reference, else of the bag."""
        return self.bag.start_s if self.flight.start_s is None else self.flight.start_s

    @property
    def is_simulated(self):
        """Whether the bag is of the virtual lab: nothing else knows a ground truth."""
        return bool(self.origin.lab or self.bag.topics.get("/ground_truth"))


class ReportCollector:
    """Takes the messages of a bag one by one; memory does not grow with its pictures, and little with its length."""

    def __init__(self, bag, origin):
        """bag: an open Bag; origin: its Origin. Raises ValueError for a fleet whose calibrations are not usable."""
        self._bag, self._origin = bag, origin
        self.flight = FlightCollector(origin.fleet, with_bearings=bool(bag.topics.get(ANGLES)))
        arena = origin.fleet.arena if origin.fleet else Arena()
        self._drops = DropCollector(arena)
        self._gates = GateCollector()
        self._computers = ComputerCollector()
        self._ladder = LadderCollector()
        self._batteries = BatteryCollector()
        self._fence = FenceCollector(origin.fence_limits(), SafetyLimits(**fence_of(arena)))
        self._events = EventCollector()
        self._snapshots = SnapshotCollector(bag.types, bag.start_s, bag.duration_s)
        parts = (
            self.flight, self._drops, self._gates, self._computers, self._ladder, self._batteries, self._fence,
            self._events, self._snapshots,
        )  # fmt: skip
        takers = {topic: [part for part in parts if part.wants(topic)] for topic in bag.topics}
        wanted = [topic for topic in takers if takers[topic]]
        self._foreign = [topic for topic in wanted if not fits(topic, bag.types[topic])]
        self._takers = {topic: takers[topic] for topic in wanted if topic not in self._foreign}
        self.wanted = list(self._takers)  # the topics of the bag that say anything to the report

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        for part in self._takers.get(topic, ()):
            part(topic, receipt_s, message)

    def fraction(self, receipt_s):
        """How much of the bag is done [0, 1] when a message of that time comes."""
        return (receipt_s - self._bag.start_s) / max(self._bag.duration_s, 1e-3)

    def material(self, flight=None):
        """Material of what was collected. flight: when it has been evaluated already."""
        snapshots, snapshot_notes = self._snapshots.snapshots()
        end_s = self._bag.start_s + self._bag.duration_s
        return Material(
            bag=self._bag,
            foreign=self._foreign,
            origin=self._origin,
            flight=flight or self.flight.overview(),
            drops=self._drops.drops(end_s),
            gates=self._gates.counts(),
            computers=self._computers.computers(),
            ladder=self._ladder.spans(end_s),
            ladder_left_out=self._ladder.left_out,
            batteries=self._batteries.batteries(),
            margins=self._fence.margins(),
            snapshots=snapshots,
            snapshot_notes=snapshot_notes,
            events=self._events.events,
            events_left_out=self._events.left_out,
        )
