"""Reads the pictures of a topic, and reports on /diagnostics."""

import threading
import time

import cv2
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import Image

from risc_lab.images import picture_from_msg
from risc_lab.ros.diagnostics import Growth, add_all, age_text, is_silent, summarise
from risc_lab.ros.paced_subscriber import PICTURES_BYTES
from risc_lab.ros.until_shutdown import until_shutdown

_TOLD_S = 10.0  # between two reports of the same trouble


class PictureReader:
    """Hands the newest picture of a topic to `work`, while it is open."""

    def __init__(self, topic, work, updater, name, rate_hz=0.0, more=dict):
        """work(picture, header): picture is (h, w, 3), blue green red, and may be drawn on; ValueError refuses it.

        updater, name: of diagnostics; more(): {key: text} to report there, too. rate_hz: greatest; 0 = every picture.
        """
        self.topic = rospy.resolve_name(topic)
        self._work, self._more = work, more
        self._period_s = 1.0 / rate_hz if rate_hz > 0.0 else 0.0
        self._next_s = 0.0  # when the next picture is taken; monotonic clock
        self._subscriber = None
        self._lock = threading.Lock()
        self._counts, self._growth = {"pictures": 0, "refused": 0}, Growth()
        self._took_s = []  # of the pictures since the last report
        self._last_s = self._age_s = None
        updater.add(name, self._diagnose)

    @property
    def is_open(self):
        """Whether pictures are taken."""
        return self._subscriber is not None

    def open(self):
        """Start taking pictures."""
        self._last_s = None
        self._subscriber = rospy.Subscriber(
            self.topic, Image, self._on_image, queue_size=1, buff_size=PICTURES_BYTES, tcp_nodelay=True
        )

    def close(self):
        """Stop taking pictures."""
        self._subscriber.unregister()
        self._subscriber = None

    @until_shutdown
    def _on_image(self, message):
        start_s = time.monotonic()
        if start_s < self._next_s:  # skipped instead of waiting: unread pictures would grow old in the socket
            return
        self._next_s = max(self._next_s, start_s - self._period_s) + self._period_s
        try:
            self._work(picture_from_msg(message), message.header)
        except (ValueError, cv2.error) as error:
            with self._lock:
                self._counts["refused"] += 1
            rospy.logerr_throttle_identical(_TOLD_S, "a picture on %s was rejected: %s" % (self.topic, error))
            return
        with self._lock:
            self._last_s = time.monotonic()
            self._age_s = (rospy.Time.now() - message.header.stamp).to_sec()
            self._counts["pictures"] += 1
            self._took_s.append(self._last_s - start_s)

    def _diagnose(self, status):
        with self._lock:
            new, rates_hz = self._growth(self._counts)
            took_s, self._took_s = self._took_s, []
        summarise(
            status,
            (not self.is_open, DiagnosticStatus.OK, "waiting: no result has a subscriber"),
            (new["refused"], DiagnosticStatus.ERROR, "pictures are rejected: the log says why"),
            (is_silent(self._last_s), DiagnosticStatus.WARN, "no pictures on " + self.topic),
            (True, DiagnosticStatus.OK, "working"),
        )
        told = {
            "rate [Hz]": "%.1f" % rates_hz["pictures"],
            "age of last picture [s]": age_text(self._last_s),
            "stamp to result [s]": "none yet" if self._age_s is None else "%.3f" % self._age_s,
            "work on a picture [ms]": "%.2f" % (1e3 * sum(took_s) / max(1, len(took_s))),
            "longest work on a picture [ms]": "%.2f" % (1e3 * max(took_s, default=0.0)),
        }
        add_all(status, {**told, **self._counts, **self._more()})
        return status
