"""One pass over a bag for everything that the report shows."""

from types import SimpleNamespace

from data_extraction.bearing_errors import ANGLES
from data_extraction.flight_metrics import FlightCollector
from data_extraction.report.battery import BatteryCollector
from data_extraction.report.computers import ComputerCollector
from data_extraction.report.drops import DropCollector
from data_extraction.report.events import EventCollector
from data_extraction.report.faults import FaultCollector
from data_extraction.report.fence import FenceCollector
from data_extraction.report.gates import GateCollector
from data_extraction.report.ladder import LadderCollector
from data_extraction.report.recorded_topics import fits
from data_extraction.report.snapshots import SnapshotCollector
from data_extraction.report.types_in_bag import vehicle_types
from risc_control.safety import SafetyLimits, fence_of
from risc_lab.lab.arena import Arena


class ReportCollector:
    """Takes the messages of a bag one by one; memory does not grow with its pictures, and little with its length."""

    def __init__(self, bag, origin):
        """bag: an open Bag; origin: its Origin. Raises ValueError for a fleet whose calibrations are not usable."""
        self._bag, self._origin = bag, origin
        self.flight = FlightCollector(origin.fleet, with_bearings=bool(bag.topics.get(ANGLES)))
        arena = origin.fleet.arena if origin.fleet else Arena()
        types, limits = vehicle_types(bag, origin.fleet), SafetyLimits(**fence_of(arena))
        self._parts = {  # by their name in the material
            "drops": DropCollector(arena),
            "gates": GateCollector(),
            "computers": ComputerCollector(),
            "ladder": LadderCollector(),
            "batteries": BatteryCollector(),
            "margins": FenceCollector(origin.fences(), types, limits),
            "faults": FaultCollector(origin.fleet),
            "events": EventCollector(),
            "snapshots": SnapshotCollector(bag.types, bag.start_s, bag.duration_s),
        }
        parts = (self.flight, *self._parts.values())
        takers = {topic: [part for part in parts if part.wants(topic)] for topic in bag.topics}
        self._foreign = [topic for topic in takers if takers[topic] and not fits(topic, bag.types[topic])]
        self._takers = {topic: takers[topic] for topic in takers if takers[topic] and topic not in self._foreign}
        self.wanted = list(self._takers)  # the topics of the bag that the report uses

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are not needed are ignored."""
        for part in self._takers.get(topic, ()):
            part(topic, receipt_s, message)

    def material(self, flight=None):
        """All that a report is made of, by name. flight: the Flight, when it has been evaluated already.

        zero_s: ROS time that the report calls 0: the first reference, else the start of the bag.  is_simulated: the bag
        is from the virtual lab: only that has a ground truth.  foreign: topics with the lab's names but other types.
        """
        bag, flight = self._bag, flight or self.flight.flight(strict=False)
        found = {name: part.result(bag.start_s + bag.duration_s) for name, part in self._parts.items()}
        return SimpleNamespace(
            bag=bag,
            origin=self._origin,
            foreign=self._foreign,
            zero_s=bag.start_s if flight.start_s is None else flight.start_s,
            is_simulated=bool(self._origin.lab or bag.topics.get("/ground_truth")),
            flight=flight,
            parts=self._parts,
            **found,
        )
