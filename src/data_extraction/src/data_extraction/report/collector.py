"""One pass over a bag for everything that the report shows."""

from types import SimpleNamespace

from data_extraction.bearing_errors import ANGLES
from data_extraction.flight_metrics import FlightCollector
from data_extraction.report.battery import BatteryCollector
from data_extraction.report.computers import ComputerCollector
from data_extraction.report.drops import DropCollector
from data_extraction.report.events import EventCollector
from data_extraction.report.fence import FenceCollector
from data_extraction.report.gates import GateCollector
from data_extraction.report.ladder import LadderCollector
from data_extraction.report.snapshots import SnapshotCollector
from data_extraction.report.topics import fits
from risc_control.failsafe import SafetyLimits, fence_of
from risc_lab.lab.arena import Arena


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

    def material(self, flight=None):
        """All that a report is made of, by name. flight: when it has been evaluated already.

        zero_s: ROS time that the report calls 0: of the first reference, else of the bag.  is_simulated: the bag is of
        the virtual lab: nothing else knows a ground truth.  foreign: topics with the lab's names and other types.
        """
        bag, flight = self._bag, flight or self.flight.flight(strict=False)
        snapshots, snapshot_notes = self._snapshots.snapshots()
        end_s = bag.start_s + bag.duration_s
        return SimpleNamespace(
            bag=bag,
            origin=self._origin,
            foreign=self._foreign,
            zero_s=bag.start_s if flight.start_s is None else flight.start_s,
            is_simulated=bool(self._origin.lab or bag.topics.get("/ground_truth")),
            flight=flight,
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
