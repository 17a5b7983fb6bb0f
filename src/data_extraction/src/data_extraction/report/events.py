"""Events of a flight: what the operator did and was told (phases, joystick buttons, modes, warnings of the nodes), what
the drivers of the vehicles' types report (`risc_control.vehicles.EventTopic`), and injected faults.
"""

import re
from dataclasses import dataclass

from data_extraction.report.faults import FAULT_TOPICS, fault_text
from data_extraction.report.recorded_topics import Collector, vehicle_of
from risc_control.vehicles import event_topics
from risc_lab.phases import OperatorPhase, OperatorResult, phase_words

_MOST = 400  # events that are kept; twice as many while the bag is read
_AGAIN_S = 3.0  # the same event within this time is a repetition
_TOGETHER_S = 0.5  # the same event of several vehicles within this time counts as one event of all of them
_WARN = 4  # rosgraph_msgs/Log


@dataclass
class Event:
    """Something that happened."""

    time_s: float  # receipt
    source: str  # vehicles' namespaces or names, or a node
    text: str
    count: int = 1  # how often in a row
    is_minor: bool = False  # a warning or a button: the first to be left out


def head_and_tail(events, most):
    """At most `most` of a list of events, in their order: minor ones are left out first, then those in the middle."""
    kept = _ends([place for place, event in enumerate(events) if not event.is_minor], most)
    kept += _ends([place for place, event in enumerate(events) if event.is_minor], most - len(kept))
    return [events[place] for place in sorted(kept)]


def _ends(items, most):
    """The first and the last items of a list, `most` of them."""
    tail = most // 2
    return items if len(items) <= most else items[: most - tail] + items[len(items) - tail :]


class EventCollector(Collector):
    """Collects Events: what changed."""

    topics = ("/operator/phase", "/operator/result", "/trajectory_phase", "/rosout", *FAULT_TOPICS)

    def __init__(self):
        self._event_topics = {"/" + name: topic for name, topic in event_topics().items()}
        self.ends = ("/joy", "/controller_status", *self._event_topics)
        self._events = []
        self._count = 0  # of all events, including those that were not kept
        self._newest = {}  # key -> (its newest event, {source: when that last came})
        self._pressed = {}  # source -> buttons held
        self._said = {}  # (source, what, topic) -> its last word: modes, phases
        self._acting = set()  # (topic, id) of faults

    def result(self, _end_s=None):
        """[Event, ...] in the order of time: those that were kept."""
        return head_and_tail(self._events, _MOST)

    @property
    def left_out(self):
        """How many events there were beyond those that were kept."""
        return self._count - len(self.result())

    def __call__(self, topic, receipt_s, message):
        last, source = topic.rpartition("/")[2], vehicle_of(topic)
        if topic == "/rosout":
            if message.level >= _WARN:
                # the numbers in a repeated warning differ
                key = re.sub(r"\d+", "#", message.msg)
                self._add(receipt_s, message.name.strip("/"), message.msg, key, is_minor=True)
        elif topic == "/operator/phase":  # it is repeated as a heartbeat
            self._note_change(receipt_s, "operator", "", _joined(OperatorPhase(message.phase), message.text))
        elif topic == "/operator/result":
            self._add(receipt_s, "operator", "result: " + _joined(OperatorResult(message.result), message.reason))
        elif topic in FAULT_TOPICS:
            self._note_faults(receipt_s, topic, message.faults)
        elif topic == "/trajectory_phase":
            for name, word in phase_words(message.vehicles).items():
                self._note_change(receipt_s, name, "trajectory: ", word)
        elif last == "joy":
            held = {index for index, value in enumerate(message.buttons) if value}
            for index in sorted(held - self._pressed.get(source, set())):
                self._add(receipt_s, source, "joystick button %d" % index, is_minor=True)
            self._pressed[source] = held
        elif last == "controller_status":
            if message.data or (source, "mode: ", "") in self._said:  # the initial mode is manual
                self._note_change(receipt_s, source, "mode: ", "autonomous" if message.data else "manual")
        else:
            self._note_event(receipt_s, topic, message)

    def _note_event(self, time_s, topic, message):
        end, event_topic = next(item for item in self._event_topics.items() if ("/" + topic).endswith(item[0]))
        source, words = vehicle_of(topic, levels=end.count("/")), event_topic.words(message)
        if event_topic.each:
            self._add(time_s, source, words)
        else:
            self._note_change(time_s, source, "", words, end)

    def _note_faults(self, time_s, topic, records):
        for record in records:
            key = topic, record.id
            if record.active != (key in self._acting):
                self._acting ^= {key}
                word = "begins" if record.active else "ends"
                text = "fault %s %s" % (fault_text(record.name, record.args), word)
                source = "virtual lab" if topic.startswith("/virtual_lab/") else "maap fly"
                self._add(time_s, source, text, (key, word))

    def _note_change(self, time_s, source, what, word, topic=""):
        if self._said.get((source, what, topic)) != word:
            self._said[source, what, topic] = word
            self._add(time_s, source, what + word)

    def _add(self, time_s, source, text, key=None, is_minor=False):
        """Enter an event. key: what makes it the same as another one; None = its text."""
        key = key or text
        event, times_s = self._newest.get(key, (None, {}))
        is_again = source in times_s and time_s - times_s[source] < _AGAIN_S
        is_shared = event is not None and source not in times_s and time_s - event.time_s < _TOGETHER_S
        if is_again and source == event.source.partition(",")[0]:
            event.count += 1
        elif is_shared:
            event.source = "%s, %s" % (event.source, source)
        elif not is_again:
            self._count += 1
            self._events.append(Event(time_s, source, text, is_minor=is_minor))
            self._newest[key] = (self._events[-1], times_s := {})
            if len(self._events) > 2 * _MOST:
                self._events = self.result()
                kept = {id(event) for event in self._events}
                self._newest = {key: newest for key, newest in self._newest.items() if id(newest[0]) in kept}
        times_s[source] = time_s


def _joined(word, text):
    return ": ".join(filter(None, (word.name.lower(), text)))
