"""Resources that the processes of a soak use: memory, descriptors, threads, processor time."""

import contextlib
import os
from typing import NamedTuple

import psutil

from risc_experiments.processor_use import program_name
from risc_experiments.soak.drift import Track
from risc_lab.ros.launching import marked_processes

OURSELVES = "maap soak"


class Look(NamedTuple):
    """One process at one time."""

    rss_mb: float  # resident memory
    pss_mb: float  # the same, with shared memory divided among the processes that share it
    own_mb: float  # the same, without shared memory
    descriptors: int
    threads: int
    cpu_s: float  # processor time since it began


class Process:
    """A process, and how it has changed."""

    def __init__(self, name, program, process, time_s):
        """program: a name that several processes may have.  name: unique among the processes that live."""
        self.name, self.program, self.since_s = name, program, time_s
        self.parent = process.ppid()
        self.key = process.pid, process.create_time()
        self.track = Track(*Look._fields, "cpu_cores")
        self.newest = None
        self.cpu_cores = float("nan")  # between the last two looks
        self._process, self._newest_s = process, None

    @property
    def alive(self):
        """Whether it runs; a zombie does not."""
        with contextlib.suppress(psutil.Error):
            return self._process.is_running() and self._process.status() != psutil.STATUS_ZOMBIE
        return False

    def look(self, time_s):
        """Sample it now. Returns the Look; None when it has ended."""
        try:
            with self._process.oneshot():
                memory, times = self._process.memory_full_info(), self._process.cpu_times()
                new = Look(
                    *(memory.rss / 1e6, memory.pss / 1e6, memory.uss / 1e6),
                    *(self._process.num_fds(), self._process.num_threads(), times.user + times.system),
                )
        except psutil.Error:
            return None
        if self.newest is not None and time_s > self._newest_s:
            self.cpu_cores = (new.cpu_s - self.newest.cpu_s) / (time_s - self._newest_s)
        self.newest, self._newest_s = new, time_s
        self.track.add(time_s, *new, self.cpu_cores)
        return new


class Processes:
    """The processes of one launch, and this one."""

    def __init__(self, identity):
        """identity: of `launching.Launch`."""
        self._identity = identity
        self._known = {}  # {(process id, when it was started): Process}
        self.expected = {}  # {name: (process id, when it was started)} of those that have to live

    @property
    def known(self):
        """All processes that were ever seen, by name."""
        return sorted(self._known.values(), key=lambda item: item.name)

    @property
    def living(self):
        """Processes that live, by name."""
        return [process for process in self.known if process.alive]

    def find(self, time_s):
        """Find new processes."""
        for pid in (os.getpid(), *marked_processes(self._identity)):
            with contextlib.suppress(psutil.Error):
                process = psutil.Process(pid)
                key = pid, process.create_time()
                if key not in self._known:
                    name = OURSELVES if pid == os.getpid() else program_name(process)
                    self._known[key] = Process(self._new_name(name), name, process, time_s)

    def _new_name(self, name):
        """A name that no living process has: the second process is called "NAME 2"."""
        taken, number = {process.name for process in self.living}, 2
        wanted = name
        while name in taken:
            name, number = "%s %d" % (wanted, number), number + 1
        return name

    def look(self, time_s):
        """Sample all that live. Returns {name: Look}."""
        self.find(time_s)
        found = {process.name: process.look(time_s) for process in self.living}
        return {name: look for name, look in found.items() if look is not None}

    def expect(self):
        """Require those that live now to live until the end."""
        self.expected = {process.name: process.key for process in self.living}

    def ended(self, killed):
        """[(name, process id, whether it was killed)] of those that had to live and do not.

        killed: process ids of those that were killed on purpose; their children end with them.
        """
        alive = self.alive
        gone = [(name, self._known[key]) for name, key in self.expected.items() if key not in alive]
        return [(name, process.key[0], not killed.isdisjoint((process.key[0], process.parent)))
                for name, process in gone]  # fmt: skip

    def replace(self, name):
        """Require the successor of a killed process to live from now on. Returns False if there is none yet."""
        program, taken = self._known[self.expected[name]].program, set(self.expected.values())
        successor = next((item for item in self.living if item.program == program and item.key not in taken), None)
        if successor is None:
            return False
        del self.expected[name]
        self.expected[successor.name] = successor.key
        return True

    @property
    def alive(self):
        """Keys of those that live."""
        return {process.key for process in self.living}
