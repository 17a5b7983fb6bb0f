"""Which messages on /controls of one sender a vehicle node answers, since it does not read every one. No ROS."""

import math

_LAY_S = 0.001  # a message that is older than a fresh one by more than this has waited in the socket


class ControllerStream:
    """Messages of one sender. The node reads when a command is due, and finds one that has waited up to a period.

    A message of a fast sender that has waited is skipped: the next one is on its way, and fresh. From a sender that is
    slower than the node reads (a student's controller at 30 Hz) every message is read on arrival, and answered.
    """

    def __init__(self, look_s):
        """look_s: period at which the node reads [s]; a sender with a longer period is slow."""
        self._look_s = look_s
        self._period_s = math.inf
        self._stamp_s = -math.inf
        self._fresh_s = math.inf  # age of a message that has not waited
        self._follows = False  # no message was left unread, so the next one is fresh when it is read

    def answers(self, stamp_s, age_s, is_due):
        """Whether to send the commands of a message.

        stamp_s: of the message [s].  age_s: by its stamp, when it is read [s].  is_due: a vehicle is due for a command.
        """
        if self._follows:
            self._period_s = stamp_s - self._stamp_s
            self._fresh_s = age_s
        self._stamp_s = stamp_s
        self._fresh_s = min(self._fresh_s, age_s)
        is_fast = self._period_s < self._look_s
        lay = is_due and is_fast and age_s > self._fresh_s + _LAY_S
        self._follows = lay or not is_fast
        return is_due and not lay

    @property
    def reads_on(self):
        """Whether to read the next message at once, not only when a command is due again."""
        return self._follows
