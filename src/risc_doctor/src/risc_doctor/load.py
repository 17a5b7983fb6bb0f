"""Has this computer time for a flight? Late states and commands look like a bad network or a wrong clock."""

import os

from risc_doctor.findings import green, yellow

_BUSY = 1.0  # processes that want to run, for each core: more means waiting


def check(situation):
    """How many processes want to run."""
    return [judge(os.getloadavg()[0], len(os.sched_getaffinity(0)))]


def judge(load, cores):
    """Finding. load: mean number of processes that want to run, of the last minute."""
    text = "%.1f processes want to run at a time, on %d cores" % (load, cores)
    if load > _BUSY * cores:
        cure = "end what is not needed (top shows it); fly with one computer a vehicle, and pictures on another one"
        return yellow("load", text, cure, load=load, cores=cores)
    return green("load", text, load=load, cores=cores)
