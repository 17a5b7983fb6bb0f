"""Has this computer time for a flight? Late states and commands look like a bad network or a wrong clock."""

import os

from risc_doctor.findings import finding

_BUSY = 1.0  # processes that want to run, for each core: more means waiting


def check(situation):
    """How many processes want to run."""
    return [judge(os.getloadavg()[0], len(os.sched_getaffinity(0)))]


def judge(load, cores):
    """Finding. load: mean number of processes that want to run, of the last minute."""
    return finding("load", "busy" if load > _BUSY * cores else "time", load=load, cores=cores)
