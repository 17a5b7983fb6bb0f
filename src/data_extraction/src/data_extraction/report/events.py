"""What the operator did and was told: phases, joystick buttons, take-off and landing, modes, warnings of the nodes."""

import re
from dataclasses import dataclass

from data_extraction.report.naming import vehicle_of
from risc_lab.phases import OperatorPhase, OperatorResult, TrajectoryPhase

_MOST = 400  # events that are kept; twice as many while the bag is read
_AGAIN_S = 3.0  # the same event within so long is the same one, repeated
_TOGETHER_S = 0.5  # the same event of several vehicles within so long is one of all of them
_WARN = 4  # rosgraph_msgs/Log
_ORDERS = {"takeoff": "take-off ordered", "land": "landing ordered", "reset": "reset ordered (emergency)"}
_LAB = ("/operator/phase", "/operator/result", "/trajectory_phase", "/rosout")


@dataclass
class Event:
    """Something that happened."""

    time_s: float  # receipt
    source: str  # vehicles' namespaces or names, or a node
    text: str
    count: int = 1  # how often in a row
    is_minor: bool = False  # a warning or a button: the first to be left out


def head_and_tail(events, most):
    """Of a list of events `most`, in their order: minor ones are left out first, then those in the middle."""
    places = {False: [], True: []}
    for place, event in enumerate(events):
        places[event.is_minor].append(place)
    kept = _ends(places[False], most)
    kept += _ends(places[True], most - len(kept))
    return [events[place] for place in sorted(kept)]


def _ends(items, most):
    """The first and the last items of a list, `most` of them."""
    tail = most // 2
    return items if len(items) <= most else items[: most - tail] + items[len(items) - tail :]


class EventCollector:
    """Takes the messages of a bag one by one, keeps what changed."""

    def __init__(self):
        self._events = []
        self._count = 0  # of all, also of those that were not kept
        self._newest = {}  # key -> (its newest event, {source: when that last came})
        self._pressed = {}  # source -> buttons held
        self._modes = {}
        self._phases, self._operator = {}, None

    @property
    def events(self):
        """[Event, ...] in the order of time: those that were kept."""
        return head_and_tail(self._events, _MOST)

    @property
    def left_out(self):
        """How many events there were beyond those that were kept."""
        return self._count - len(self.events)

    def wants(self, topic):
        """Whether messages of this topic say anything here."""
        return topic in _LAB or topic.rpartition("/")[2] in (*_ORDERS, "joy", "controller_status")

    def __call__(self, topic, receipt_s, message):
        """Take one message; topics that are of no interest are passed over."""
        if not self.wants(topic):
            return
        last = topic.rpartition("/")[2]
        source = vehicle_of(topic)
        if topic == "/rosout":
            if message.level >= _WARN:
                # numbers in a warning are those of the moment
                key = re.sub(r"\d+", "#", message.msg)
                self._add(receipt_s, message.name.strip("/"), message.msg, key, is_minor=True)
        elif topic == "/operator/phase":
            said = OperatorPhase(message.phase).name.lower(), message.text
            if said != self._operator:  # it is repeated as a sign of life
                self._operator = said
                self._add(receipt_s, "operator", ": ".join(filter(None, said)))
        elif topic == "/operator/result":
            said = OperatorResult(message.result).name.lower(), message.reason
            self._add(receipt_s, "operator", "result: " + ": ".join(filter(None, said)))
        elif topic == "/trajectory_phase":
            self._note_phases(receipt_s, message.vehicles)
        elif last == "joy":
            held = {index for index, value in enumerate(message.buttons) if value}
            for index in sorted(held - self._pressed.get(source, set())):
                self._add(receipt_s, source, "joystick button %d" % index, is_minor=True)
            self._pressed[source] = held
        elif last == "controller_status":
            if self._modes.get(source, False) != message.data:
                self._add(receipt_s, source, "mode: autonomous" if message.data else "mode: manual")
            self._modes[source] = message.data
        else:
            self._add(receipt_s, vehicle_of(topic, levels=2), _ORDERS[last])  # of RISC/ardrone/land

    def _note_phases(self, receipt_s, vehicles):
        for vehicle in vehicles:
            if self._phases.get(vehicle.name) != vehicle.phase:
                self._phases[vehicle.name] = vehicle.phase
                self._add(receipt_s, vehicle.name, "trajectory: " + TrajectoryPhase(vehicle.phase).name.lower())

    def _add(self, time_s, source, text, key=None, is_minor=False):
        """Enter an event. key: what makes it the same as another one; None = its text."""
        key = key or text
        event, times_s = self._newest.get(key, (None, {}))
        if event is not None:
            if source in times_s and time_s - times_s[source] < _AGAIN_S:
                times_s[source] = time_s
                if source == event.source.partition(",")[0]:
                    event.count += 1
                return
            if source not in times_s and time_s - event.time_s < _TOGETHER_S:
                times_s[source] = time_s
                event.source = "%s, %s" % (event.source, source)
                return
        event = Event(time_s, source, text, is_minor=is_minor)
        self._count += 1
        self._events.append(event)
        self._newest[key] = (event, {source: time_s})
        if len(self._events) > 2 * _MOST:
            self._events = self.events
            kept = {id(event) for event in self._events}
            self._newest = {key: newest for key, newest in self._newest.items() if id(newest[0]) in kept}
