"""Base of the nodes with a filter. Publishes states with every frame, between frames and once when frames stop, and how
they were obtained. Subscribes to on-board measurements and to commands that were sent.
"""

import math
import threading
import time
from typing import NamedTuple

import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from roslib.message import get_message_class
from std_msgs.msg import Header

from risc_estimation import sensors
from risc_estimation.filters import COMMAND, REGISTRY, Status
from risc_estimation.ros.conversions import EstimateMessages, statuses_to_msg
from risc_lab.command_history import command_of
from risc_lab.lab.fleet import MocapEndpoint
from risc_lab.ros.diagnostics import Growth, add_all, summarise, ticking_updater
from risc_lab.ros.fleet_messages import CortexArrays
from risc_lab.ros.guard import subscribe
from risc_lab.ros.paced_subscriber import BUFFER_BYTES
from risc_lab.ros.ticker import Ticker
from risc_maap_msgs.msg import BodyStatuses, CommandsSent

_GAP_PERIODS = 1.5  # of frames; after this long without one, one is missing

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Report(NamedTuple):
    """What an estimator did so far. `new`, `rate_hz`: since the last report."""

    counts: object  # EstimatorCounts
    names: tuple[str, ...]
    visible: int
    passed_over: int  # frames
    new: dict
    rate_hz: float  # of frames
    age_s: float  # of the newest frame; NaN: none yet
    states: dict  # {name: status in words}


def filter_kind(default):
    """(name, class) of the filter that ~filter names. Raises ValueError when there is none of that name."""
    name = rospy.get_param("~filter", default)
    return name, REGISTRY.module(name).Filter


class EstimatorNode:
    """Estimates frames in order; none is skipped unless the node was held up for longer than queue_s.

    Subclasses make the estimator and pass its estimate of each frame to `estimated`, with `lock` held.
    """

    INPUT = ""  # what frames hold, in words

    def __init__(self, estimator, kind, params, fleet, states_topic):
        """kind: class of the filter.  params: NodeParams.  fleet: Fleet or None.  states_topic: where states go."""
        self.estimator = estimator
        self.lock = threading.Condition()  # frames, the silence timer and diagnostics have a thread each
        self._vehicles = fleet.vehicles if fleet else ()
        self._rate_hz = fleet.mocap.rate_hz if fleet else MocapEndpoint.rate_hz
        self.period_s, self._silence_s = 1.0 / self._rate_hz, params.silence_s  # between frames; without any
        self._queue_frames = params.queue_frames(self._rate_hz)
        self._frames = 0  # number estimated
        self._last_receipt_s = None  # of the newest of them; monotonic clock
        self._last_said_s = -math.inf  # when states were published, except `lost` ones; monotonic clock
        self._delay_s = 0.0  # from exposure to estimate, of the newest frame
        self._last_estimate, self._silent = None, True
        self._header = Header()  # of the newest states
        self._last_seq = None  # of the newest frame; publishers number their messages
        self._passed_over = 0  # frames
        self._told_unknown, self._told_status = set(), None
        self._growth = Growth()
        self._messages = EstimateMessages()
        # Queues outlast a hiccup: a subscriber that was held up gets every frame, and judges its age by the stamp.
        self._states_pub = rospy.Publisher(states_topic, CortexArrays, queue_size=100, tcp_nodelay=True)
        self._status_pub = rospy.Publisher(states_topic + "_status", BodyStatuses, queue_size=100, tcp_nodelay=True)
        self._coasts = kind.COASTS

    def listen(self, topic, kind):
        """Start: `_on_frame` is called with each message of a topic."""
        ticking_updater("mocap").add("states estimation", self._diagnose)
        if self._silence_s > 0.0:
            Ticker(0.25 * self._silence_s, self._on_check, "the watch for silence")
        if self._coasts:
            Ticker(self.period_s, self._on_gap, "states between frames")
        self._listen_on_board(self.estimator.on_board_wanted)
        subscribe(topic, kind, self._on_frame, queue_size=self._queue_frames, buff_size=BUFFER_BYTES)

    def _on_frame(self, message):
        """Handle the message of a frame, in a thread of its own."""
        raise NotImplementedError

    def _listen_on_board(self, wanted):
        """Subscribe to what the filter wants, and to nothing else."""
        if COMMAND in wanted:
            subscribe("/commands_sent", CommandsSent, self._on_commands, queue_size=100)
        if wanted <= {COMMAND}:
            return
        for vehicle in self._vehicles:
            kind = sensors.of_type(vehicle.type)
            if kind is not None:
                topic, its_class = "/%s/%s" % (vehicle.namespace, kind.TOPIC), get_message_class(kind.TYPE)
                subscribe(topic, its_class, self._on_readings, (vehicle.template, kind), queue_size=10)

    def _on_commands(self, message):
        with self.lock:
            for sent in message.commands:
                self.estimator.on_board(sent.name, sent.sent.to_sec(), COMMAND, command_of(sent))

    def _on_readings(self, message, arguments):
        with self.lock:
            sensors.give(self.estimator, *arguments, message)

    def count(self, header):
        """Count frames that were skipped, by the sequence number."""
        if self._last_seq is not None:
            self._passed_over += max(header.seq - self._last_seq - 1, 0)
        self._last_seq = header.seq

    def estimated(self, header, estimate):
        """Publish the estimate of a frame, FrameEstimate or None. True if there is one."""
        if self.estimator.frames == self._frames:
            return False  # refused frames count as silence
        self._frames, self._last_receipt_s = self.estimator.frames, time.monotonic()
        if estimate is None:
            return False  # later states have been published already
        self._delay_s = max(0.0, rospy.get_time() - estimate.stamp_s)
        self._give(header, estimate)
        return True

    def _give(self, header, estimate):
        self._last_estimate, self._silent, self._last_said_s = estimate, False, time.monotonic()
        stamp, self._header.frame_id = self._header.stamp, header.frame_id
        stamp.secs, stamp.nsecs = header.stamp.secs, header.stamp.nsecs  # a copy: the frame's header is reused
        self._states_pub.publish(self._messages.states(header, estimate))
        self._tell_status()

    def _on_gap(self):
        """If a frame is missing, publish states that the filter predicts, with the same delay as those of frames."""
        with self.lock:
            stamp_s, last = rospy.get_time() - self._delay_s, self._last_estimate
            if last is None or stamp_s - last.stamp_s < _GAP_PERIODS * self.period_s:
                return
            estimate = self.estimator.coast(stamp_s)
            if estimate is not None:
                self._give(Header(stamp=rospy.Time.from_sec(stamp_s), frame_id=self._header.frame_id), estimate)

    def _on_check(self):
        """Once per silence: publish the last states again, with nothing visible. The stamp is unchanged."""
        with self.lock:
            if self._silent or time.monotonic() - self._last_said_s < self._silence_s:
                return
            self._silent = True
            self._last_estimate = lost = self.estimator.lost()
            self._states_pub.publish(self._messages.states(None, lost))
            self._tell_status()
        rospy.logwarn("no %s for %.0f ms: every vehicle is invisible", self.INPUT, 1e3 * self._silence_s)

    def _statuses(self):
        """[Status] of the bodies in the newest states."""
        return [Status.LOST] * len(self.estimator.names) if self._silent else self.estimator.status()

    def _tell_status(self, anyway=False):
        """Publish it while there is a subscriber, if a status or a counter of resets has changed, or anyway."""
        if not self._status_pub.get_num_connections():
            return
        statuses, counters = self._statuses(), self.estimator.counters()
        told = statuses, None if counters is None else counters["resets"].tolist()
        if anyway or told != self._told_status:
            self._told_status = told
            self._status_pub.publish(statuses_to_msg(self._header, self.estimator.names, statuses, counters))

    def _report(self):
        """The current Report."""
        with self.lock:
            counts, names, passed_over = self.estimator.counts, self.estimator.names, self._passed_over
            last_s, silent, counters = self._last_receipt_s, self._silent, self.estimator.counters()
            visible = 0 if self._last_estimate is None else int(self._last_estimate.visible.sum())
            statuses = self._statuses()
            self._tell_status(anyway=True)
        words = ["no frames" if silent else status.name.lower() for status in statuses]
        if counters is not None:
            words = [word + _in_words(row) for word, row in zip(words, counters)]
        refused = counts.duplicate_stamps + counts.backward_stamps
        new, rates_hz = self._growth({"frames": counts.frames, "refused": refused, "passed over": passed_over})
        age_s = math.nan if last_s is None else time.monotonic() - last_s
        return Report(counts, names, visible, passed_over, new, rates_hz["frames"], age_s, dict(zip(names, words)))

    def tell(self, report):
        """For subclasses: publish what programs need of a Report."""

    def _diagnose(self, status):
        """Diagnostics for people."""
        report = self._report()
        counts, new, known = report.counts, report.new, len(report.names)
        self.tell(report)
        unknown = sorted(counts.unknown)
        for name in unknown:
            if name not in self._told_unknown:
                self._told_unknown.add(name)
                rospy.logwarn("no template for body '%s': it is not estimated. Add it to the templates file", name)
        silence = not report.age_s <= 1.0
        summarise(
            status,
            (silence and new["refused"], ERROR, "all %s are refused: their stamps do not advance" % self.INPUT),
            (silence, ERROR, "no %s" % self.INPUT),
            (new["refused"], WARN, "%d frames refused: stamp does not advance" % new["refused"]),
            (report.visible < known, WARN, "%d of %d vehicles visible" % (report.visible, known)),
            (new["passed over"], WARN, "%d frames passed over: no time for them" % new["passed over"]),
            (unknown, WARN, "bodies without a template: " + ", ".join(unknown)),
            (True, OK, "%d vehicles visible" % report.visible),
        )
        add_all(
            status,
            {
                "rate [Hz]": "%.1f" % report.rate_hz,
                "age of last frame [s]": "none yet" if math.isnan(report.age_s) else "%.3f" % report.age_s,
                "vehicles visible": "%d of %d" % (report.visible, known),
                "frames passed over": report.passed_over,
                "unknown bodies": ", ".join(unknown) or "none",
                **report.states,
                "frames": counts.frames,
                **refusals(counts),
            },
        )
        return status


def refusals(counts):
    """{cause: how often} of EstimatorCounts."""
    return {key: value for key, value in sorted(vars(counts).items()) if key not in ("unknown", "exchanged", "frames")}


def _in_words(counters):
    """Refused poses and resets of a body, as text; counters: `filters.COUNTS`, a record."""
    refused = [
        "%d %s refused" % (counters[key], key.partition("_")[0])
        for key in ("positions_refused", "attitudes_refused")
        if counters[key]
    ]
    return ", ".join(["", *refused, *(["%d resets" % counters.resets] if counters.resets else [])])
