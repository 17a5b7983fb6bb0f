"""For tests: waiting for what a thread or another process does. With a graph see `risc_lab.ros.testing`."""

import time

LIMIT_S = 60.0  # for what happens within a second or two on a quiet computer


def wait_for(condition, what="", limit_s=LIMIT_S):
    """Raises AssertionError when the condition does not come true. what: the condition, in words, or a function that
    returns what there is instead.
    """
    deadline_s = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > deadline_s:
            words = what() if callable(what) else what
            raise AssertionError("not within %g s%s" % (limit_s, ": %s" % (words,) if words else ""))
        time.sleep(0.005)
