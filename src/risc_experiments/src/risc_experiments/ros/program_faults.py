"""Injects faults into the programs of a flight, and reports them as the virtual lab reports its own."""

import heapq
import itertools
import math
import threading
import time

import numpy as np
import rospy

from risc_experiments.programs import find, successor
from risc_maap_msgs.msg import FaultRecord, Faults
from risc_simulator.faults import REGISTRY

TOPIC = "/program_faults"
_AGAIN_S = 0.3  # how often to look for a program that has not started (again) yet


class _Act:
    """A fault, from when it was asked for until it is over."""

    def __init__(self, record, event):
        self.record, self.event = record, event
        self.member = REGISTRY.module(event.fault).make(event.severity, np.random.default_rng(0))
        self.program = None  # from its begin on
        self.over = False

    def call(self, what):
        """Call begin or end of the member, if it has it."""
        function = getattr(self.member, what, None)
        if function is not None:
            function(self.program, rospy.get_time())


class ProgramFaults:
    """Carries out faults on programs, in one thread. A kill ends when the program's node runs again."""

    def __init__(self, identity):
        """identity: of the flight's `launching.Launch`."""
        self._identity = identity
        self._publisher = rospy.Publisher(TOPIC, Faults, queue_size=100, latch=True)
        self._acts, self._due = [], []  # all; heap of (monotonic time, number, what to do)
        self._numbers, self._ids = itertools.count(), itertools.count(1)
        self._killed = set()  # process ids
        self._changed = threading.Condition()
        threading.Thread(target=self._run, name="program faults", daemon=True).start()

    def check(self, events):
        """Raises LookupError, which names the cause and the cure, when one of these FaultEvents cannot happen."""
        for event in events:
            find(self._identity, event.program, event.vehicle)

    def start(self, events):
        """Schedule FaultEvents, counted from now."""
        now_s, now = time.monotonic(), rospy.Time.now()
        with self._changed:
            self._acts = [act for act in self._acts if not act.over]  # earlier ones are not reported any more
            for event in events:
                begins = now + rospy.Duration.from_sec(event.start_s)
                safe = list(event.settings.safe)
                number, ends = next(self._ids), rospy.Time()  # without end, until it is known
                record = FaultRecord(number, event.fault, event.args, "", begins, ends, False, safe)
                self._acts.append(_Act(record, event))
                self._plan(now_s + event.start_s, self._begin, self._acts[-1])
            self._tell()

    def end_all(self):
        """Continue programs that hang, and cancel faults that have not begun. Returns when that is done."""
        with self._changed:
            self._due.clear()
            for act in self._acts:
                act.over = True
                if act.record.active:
                    self._end(act)

    @property
    def acting(self):
        """FaultEvents that act now."""
        with self._changed:
            return [act.event for act in self._acts if act.record.active]

    @property
    def killed(self):
        """Process ids of the programs that were killed."""
        with self._changed:
            return frozenset(self._killed)

    def _plan(self, time_s, work, act):
        heapq.heappush(self._due, (time_s, next(self._numbers), work, act))
        self._changed.notify()

    def _run(self):
        with self._changed:
            while True:
                wait_s = self._due[0][0] - time.monotonic() if self._due else None
                if wait_s is not None and wait_s <= 0.0:
                    _, _, work, act = heapq.heappop(self._due)
                    work(act)
                else:
                    self._changed.wait(wait_s)

    def _begin(self, act):
        event = act.event
        try:
            act.program = find(self._identity, event.program, event.vehicle)
        except LookupError:  # it has just died of another fault, and may come back
            self._plan(time.monotonic() + _AGAIN_S, self._begin, act)
            return
        now_s = time.monotonic()  # after the search, which may take long: a hang must last as long as asked for
        of_one = event.vehicle and act.program.node.startswith("/%s/" % event.vehicle)
        act.record.vehicle = event.vehicle if of_one else ""
        act.record.begins, act.record.active = rospy.Time.now(), True
        act.call("begin")
        self._tell()
        if act.program.killed:
            self._killed.add(act.program.process.pid)
            self._plan(now_s + _AGAIN_S, self._look_for_successor, act)
        elif event.duration_s < math.inf:
            act.record.ends = act.record.begins + rospy.Duration.from_sec(event.duration_s)
            self._plan(now_s + event.duration_s, self._end, act)

    def _look_for_successor(self, act):
        other = successor(self._identity, act.program)
        if other is None:
            self._plan(time.monotonic() + _AGAIN_S, self._look_for_successor, act)
        else:
            self._end(act, rospy.Time.now() - rospy.Duration.from_sec(other.age_s))

    def _end(self, act, at=None):
        act.call("end")
        act.over = True
        act.record.ends, act.record.active = at or rospy.Time.now(), False
        self._tell()

    def _tell(self):
        message = Faults(faults=[act.record for act in self._acts])
        message.header.stamp = rospy.Time.now()
        self._publisher.publish(message)
