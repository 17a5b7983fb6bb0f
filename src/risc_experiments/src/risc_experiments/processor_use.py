"""Processor time and memory that the programs of a flight use, and the load of all other programs."""

import contextlib
import os
import time
from collections import Counter
from typing import NamedTuple

import psutil

from risc_lab.ros.launching import MARK, argument_of, program_of

_LEAST_S = 1.0  # shorter spans say nothing


class _Look(NamedTuple):
    time_s: float
    machine: dict  # {as in psutil.cpu_times: seconds} of the cores that the flight may use
    programs: dict  # {(process id, time of its start): (name, of the flight?, processor seconds)}; ended ones stay


class ProcessorUse:
    """Processor time of every program from the first to the last call of `look`, and its memory at the second call."""

    def __init__(self, identity):
        """identity: of the flight's processes, as in `launching.Launch`."""
        self._identity = identity
        self._first = self._last = None
        self._memory_mb = Counter()

    def look(self):
        """Note what has been used so far. Costs some milliseconds."""
        known = self._last.programs if self._last else {}
        programs = dict(known)
        weighs = self._first is not None and not self._memory_mb
        for process in psutil.process_iter():
            with contextlib.suppress(psutil.Error):
                key = process.pid, process.create_time()
                name, is_ours = known[key][:2] if key in known else (program_name(process), self._is_ours(process))
                times = process.cpu_times()
                programs[key] = name, is_ours, times.user + times.system
                if weighs and is_ours:
                    self._memory_mb[name] += process.memory_full_info().pss / 1e6
        self._last = _Look(time.monotonic(), _machine_times(), programs)
        if self._first is None:
            self._first = self._last

    def figures(self):
        """{"cpu_cores": {program of the flight: mean}, "memory_mb": {program of the flight: MB}, "computer": {...}}.

        {} when the observed time is too short. memory_mb: shared memory (code, numba) is divided among the programs.
        cores: that the flight may use; idle, steal (given to others by the host of a virtual machine): fractions of
        their time. others: mean of all programs outside the flight; busiest_other, busiest_other_cores: the largest.
        """
        first, last = self._first, self._last
        if first is None or last.time_s - first.time_s < _LEAST_S:
            return {}
        span_s = last.time_s - first.time_s
        ours, others = Counter(), Counter()
        for key, (name, of_the_flight, used_s) in last.programs.items():
            before_s = first.programs[key][2] if key in first.programs else 0.0
            (ours if of_the_flight else others)[name] += (used_s - before_s) / span_s
        machine = {name: last.machine[name] - first.machine[name] for name in last.machine}
        total_s = max(sum(machine.values()) - machine.get("guest", 0.0) - machine.get("guest_nice", 0.0), 1e-9)
        busiest, cores = max(others.items(), key=lambda item: item[1], default=("", 0.0))
        return {
            "cpu_cores": {name: round(value, 4) for name, value in ours.most_common()},
            "memory_mb": {name: round(value, 1) for name, value in self._memory_mb.most_common()},
            "computer": {
                "cores": len(os.sched_getaffinity(0)),
                "idle": round((machine["idle"] + machine.get("iowait", 0.0)) / total_s, 4),
                "steal": round(machine.get("steal", 0.0) / total_s, 4),
                "others": round(sum(others.values()), 4),
                "busiest_other": busiest,
                "busiest_other_cores": round(cores, 4),
            },
        }

    def _is_ours(self, process):
        if process.pid == os.getpid():
            return True
        with contextlib.suppress(psutil.AccessDenied):
            return process.environ().get(MARK) == self._identity
        return False


def _machine_times():
    cores = psutil.cpu_times(percpu=True)
    ours = [cores[k] for k in os.sched_getaffinity(0) if k < len(cores)] or cores
    return {name: sum(getattr(core, name) for core in ours) for name in ours[0]._fields}


def program_name(process):
    """Name of a node with its namespace, else of the program. Raises psutil.Error when the process has ended."""
    words = process.cmdline()
    node = argument_of(words, "__name")
    if not node:
        return program_of(words) or process.name()
    with contextlib.suppress(psutil.AccessDenied):
        node = "/".join(filter(None, (process.environ().get("ROS_NAMESPACE", "").strip("/"), node)))
    return node
