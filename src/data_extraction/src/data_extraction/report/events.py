"""What the operator did and was told: phases, joystick buttons, take-off and landing, modes, warnings of the nodes."""

import re
from typing import NamedTuple

from data_extraction.report.naming import vehicle_of

_MOST = 400  # events that are kept
_AGAIN_S = 3.0  # the same event within so long is the same one, repeated
_TOGETHER_S = 0.5  # the same event of several vehicles within so long is one of all of them
_WARN = 4  # rosgraph_msgs/Log
_ORDERS = {"takeoff": "take-off ordered", "land": "landing ordered", "reset": "reset ordered (emergency)"}
_LAB = ("/operator/phase", "/operator/result", "/trajectory_phase", "/rosout")


class Event(NamedTuple):
    """Something that happened."""

    time_s: float  # receipt
    source: str  # vehicles' namespaces or names, or a node
    text: str
    count: int = 1  # how often in a row


class EventCollector:
    """Takes the messages of a bag one by one, keeps what changed."""

    def __init__(self):
        self.events = []
        self.left_out = 0  # events beyond those that were kept
        self._newest = {}  # key -> (index of its newest event, {source: when that last came})
        self._pressed = {}  # source -> buttons held
        self._modes = {}
        self._phases = {}

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
                self._add(receipt_s, message.name.strip("/"), message.msg, re.sub(r"\d+", "#", message.msg))
        elif topic.startswith("/operator/"):
            self._add(receipt_s, "operator", message.data if last == "phase" else "result: " + message.data)
        elif topic == "/trajectory_phase":
            self._note_phases(receipt_s, message.data)
        elif last == "joy":
            held = {index for index, value in enumerate(message.buttons) if value}
            for index in sorted(held - self._pressed.get(source, set())):
                self._add(receipt_s, source, "joystick button %d" % index)
            self._pressed[source] = held
        elif last == "controller_status":
            if self._modes.get(source, False) != message.data:
                self._add(receipt_s, source, "mode: autonomous" if message.data else "mode: manual")
            self._modes[source] = message.data
        else:
            self._add(receipt_s, source, _ORDERS[last])

    def _note_phases(self, receipt_s, text):
        for item in text.replace("\n", ";").split(";"):
            vehicle, _, phase = item.partition(":")
            vehicle, phase = vehicle.strip(), phase.strip()
            if phase and self._phases.get(vehicle) != phase:
                self._phases[vehicle] = phase
                self._add(receipt_s, vehicle, "trajectory: " + phase)

    def _add(self, time_s, source, text, key=None):
        """Enter an event. key: what makes it the same as another one; None = its text."""
        key = key or text
        index, times_s = self._newest.get(key, (None, {}))
        if index is not None:
            event = self.events[index]
            if source in times_s and time_s - times_s[source] < _AGAIN_S:
                times_s[source] = time_s
                if source == event.source.partition(",")[0]:
                    self.events[index] = event._replace(count=event.count + 1)
                return
            if source not in times_s and time_s - event.time_s < _TOGETHER_S:
                times_s[source] = time_s
                self.events[index] = event._replace(source="%s, %s" % (event.source, source))
                return
        if len(self.events) < _MOST:
            self._newest[key] = (len(self.events), {source: time_s})
            self.events.append(Event(time_s, source, text))
        else:
            self.left_out += 1
