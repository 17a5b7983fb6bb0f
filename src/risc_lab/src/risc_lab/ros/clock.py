"""ROS time as a number."""

import time

import rospy

_SLOW_READING_S = 2e-4  # the thread was held up between two readings: the difference is not reliable
_SET_S = 1e-3  # a larger change: the clock was set; adjustments of its rate act on the monotonic clock, too


def ros_time_s():
    """As rospy.get_time(), which is slower: it makes two objects of each reading, and this is called in every frame."""
    return time.time() if rospy.rostime.is_wallclock() else rospy.get_time()


class SteadyClock:
    """A time that goes on evenly when the computer's clock is set, and the ROS time of the same instant.

    With /use_sim_time both are ROS time: they go back with a bag that is played again.
    """

    def __init__(self):
        self._ahead_s = self._begun_ahead_s = time.time() - time.monotonic()  # of the wall clock

    def now(self):
        """(steady time [s], ROS time [s]): the first for courses and intervals, the second for stamps."""
        if not rospy.rostime.is_wallclock():
            now_s = rospy.get_time()
            return now_s, now_s
        before_s, wall_s, after_s = time.monotonic(), time.time(), time.monotonic()
        ahead_s = wall_s - 0.5 * (before_s + after_s)
        if after_s - before_s < _SLOW_READING_S and abs(ahead_s - self._ahead_s) > _SET_S:
            self._ahead_s = ahead_s
        return after_s + self._begun_ahead_s, after_s + self._ahead_s

    def now_s(self):
        """Steady time [s]."""
        return self.now()[0]
