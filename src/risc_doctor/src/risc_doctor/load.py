"""Is this computer too busy for a flight? Late states and commands look like a bad network or a wrong clock."""

import os

from risc_doctor.findings import finding

_BUSY = 1.0  # load average for each core: more means waiting


def check(situation):
    """The load average."""
    return [judge(os.getloadavg()[0], len(os.sched_getaffinity(0)))]


def judge(load, cores):
    """Finding. load: load average of the last minute."""
    return finding("load", "busy" if load > _BUSY * cores else "time", load=load, cores=cores)
