"""Periodic work. The thread of a bare rospy.Timer ends with the first exception of its callback."""

import threading
import time

import rospy

from risc_lab.ros.guard import guarded


def on_ros_time(period_s, work, name):
    """Call `work` every period_s of ROS time: not while the clock of a bag stands still."""
    call = guarded(work, name)
    timer = rospy.Timer(rospy.Duration(period_s), lambda _event: call(), reset=True)
    rospy.on_shutdown(timer.shutdown)


class Ticker:
    """Calls `work` every period_s, the first time after one, in a thread of its own, by the monotonic clock.

    The schedule is absolute. A call that takes too long, or a computer that stands still, makes the next one late;
    those that were missed are not made up for. An exception is logged and the next call comes all the same.
    """

    def __init__(self, period_s, work, name="ticker"):
        if not period_s > 0.0:
            raise ValueError("a period must be > 0 s, got %r" % (period_s,))
        self._period_s, self._work = period_s, guarded(work, name)
        self._over = threading.Event()
        rospy.on_shutdown(self.stop)
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def stop(self):
        """No further call begins."""
        self._over.set()

    def _run(self):
        time.sleep(self._period_s)
        next_s = time.monotonic()
        while not self._over.is_set():
            self._work()
            next_s += self._period_s
            now_s = time.monotonic()
            if next_s > now_s:
                time.sleep(next_s - now_s)
            elif next_s < now_s - self._period_s:
                next_s = now_s
