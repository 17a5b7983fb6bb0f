"""Pictures of a topic, one after the other, and what is to be said of that on /diagnostics."""

import threading
import time

import cv2
import rospy
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import Image

from risc_lab.images import picture_from_msg
from risc_lab.ros.paced_subscriber import PICTURES_BYTES
from risc_lab.ros.until_shutdown import until_shutdown
from risc_visual.ros.node import SILENCE_S

_TOLD_S = 10.0  # between two reports of the same trouble


class PictureReader:
    """Hands the newest picture of a topic to whoever works on it, while it is open."""

    def __init__(self, topic, work, updater, name, rate_hz=0.0, more=dict):
        """work(picture, header): picture is (h, w, 3), blue green red, and may be drawn on; ValueError refuses it.

        updater, name: of diagnostics; more(): {key: text} to be told there, too. rate_hz: greatest; 0 = every picture.
        """
        self.topic = rospy.resolve_name(topic)
        self._work, self._more = work, more
        self._period_s = 1.0 / rate_hz if rate_hz > 0.0 else 0.0
        self._next_s = 0.0  # when the next picture is taken; monotonic clock
        self._subscriber = None
        self._lock = threading.Lock()
        self._pictures, self._refused, self._refused_before = 0, 0, 0
        self._took_s, self._reported_s = [], time.monotonic()  # of the pictures since the last report
        self._last_s = self._age_s = None
        updater.add(name, self._diagnose)

    @property
    def is_open(self):
        """Whether pictures are taken."""
        return self._subscriber is not None

    def open(self):
        """Begin to take pictures."""
        self._last_s = None
        self._subscriber = rospy.Subscriber(
            self.topic, Image, self._on_image, queue_size=1, buff_size=PICTURES_BYTES, tcp_nodelay=True
        )

    def close(self):
        """Take none any more."""
        self._subscriber.unregister()
        self._subscriber = None

    @until_shutdown
    def _on_image(self, message):
        start_s = time.monotonic()
        if start_s < self._next_s:  # not waited for: unread pictures would grow old in the socket
            return
        self._next_s = max(self._next_s, start_s - self._period_s) + self._period_s
        try:
            self._work(picture_from_msg(message), message.header)
        except (ValueError, cv2.error) as error:
            with self._lock:
                self._refused += 1
            rospy.logerr_throttle_identical(_TOLD_S, "a picture on %s is refused: %s" % (self.topic, error))
            return
        with self._lock:
            self._last_s = time.monotonic()
            self._age_s = (rospy.Time.now() - message.header.stamp).to_sec()
            self._pictures += 1
            self._took_s.append(self._last_s - start_s)

    def _diagnose(self, status):
        with self._lock:
            now_s = time.monotonic()
            took_s, self._took_s = self._took_s, []
            rate_hz, self._reported_s = len(took_s) / max(now_s - self._reported_s, 1e-3), now_s
            refused_now, self._refused_before = self._refused > self._refused_before, self._refused
            age_s = None if self._last_s is None else now_s - self._last_s
        if not self.is_open:
            status.summary(DiagnosticStatus.OK, "waiting: nobody listens to a result")
        elif refused_now:
            status.summary(DiagnosticStatus.ERROR, "pictures are refused: the log says why")
        elif age_s is None or age_s > SILENCE_S:
            status.summary(DiagnosticStatus.WARN, "no pictures on " + self.topic)
        else:
            status.summary(DiagnosticStatus.OK, "working")
        status.add("rate [Hz]", "%.1f" % rate_hz)
        status.add("age of last picture [s]", "none yet" if age_s is None else "%.2f" % age_s)
        status.add("stamp to result [s]", "none yet" if self._age_s is None else "%.3f" % self._age_s)
        status.add("work on a picture [ms]", "%.2f" % (1e3 * sum(took_s) / max(1, len(took_s))))
        status.add("longest work on a picture [ms]", "%.2f" % (1e3 * max(took_s, default=0.0)))
        status.add("pictures", str(self._pictures))
        status.add("refused", str(self._refused))
        for key, text in self._more().items():
            status.add(key, text)
        return status
