"""Callbacks and periodic work that go on after an exception.

rospy logs a traceback for every message that a callback fails on, 200 a second; the thread of a bare rospy.Timer ends
with the first exception.
"""

import functools
import math
import time
import traceback

import genpy
import rospy

from risc_lab.ros.until_shutdown import is_closing

_AGAIN_S = 10.0  # interval at which repeated failures are logged, with their number


class Failures:
    """Logs repeated failures: the first with its traceback, then how often."""

    def __init__(self, name):
        """name: what fails, in words."""
        self._name, self._count, self._trace, self._logged_s = name, 0, "", -math.inf

    def note(self, error):
        """Count an exception that is being handled. Returns whether to act on it: not while the node shuts down, when
        its topics are closed, nor for a message that could not be decoded, which counts as not received.
        """
        if is_closing():
            return False
        is_ours = not isinstance(error, genpy.DeserializationError)
        self._count += 1
        now_s = time.monotonic()
        if now_s - self._logged_s >= _AGAIN_S:
            self._log("%s: %s" % (type(error).__name__, error), traceback.format_exc(), is_ours)
            self._logged_s, self._count = now_s, 0
        return is_ours

    def _log(self, what, trace, is_ours):
        times = "" if self._count == 1 else " %d times" % self._count
        if not is_ours:
            rospy.logwarn("%s failed%s: a message could not be decoded (%s)" % (self._name, times, what))
        elif trace == self._trace:
            rospy.logerr("%s failed again%s (%s)" % (self._name, times, what))
        else:
            self._trace = trace
            rospy.logerr("%s failed%s, please report it (%s)\n%s" % (self._name, times, what, trace))


def guarded(work, name, on_error=None):
    """Wrap `work`: its exceptions are logged by `Failures`, and the call returns None.

    name: of the work, in words.  on_error: called with an exception that is to be acted on.
    """
    failures = Failures(name)

    @functools.wraps(work)
    def run(*arguments):
        try:
            return work(*arguments)
        except Exception as error:  # of any kind: the next call must come
            if failures.note(error) and on_error is not None:
                try:
                    on_error(error)
                except Exception as second:  # of any kind, too
                    failures.note(second)
        return None

    return run


def subscribe(topic, message_class, callback, callback_args=None, on_error=None, **options):
    """A rospy.Subscriber whose callback is guarded, and whose messages no publisher delays (TCP_NODELAY).

    on_error: see `guarded`.  options: those of rospy.Subscriber.
    """
    work = guarded(callback, "the callback of " + topic, on_error)
    return rospy.Subscriber(topic, message_class, work, callback_args=callback_args, tcp_nodelay=True, **options)
