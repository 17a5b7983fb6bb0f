"""`./maap stop`: land and end every flight on this computer, even if its `./maap fly` was killed."""

import argparse
import signal
import sys
import time

import psutil

from risc_lab.ros.launching import all_marked_processes, end_processes, marked_processes, send_signal, wait_until

FLIGHTS = {"risc_experiments.fly": "./maap fly", "risc_experiments.soak": "./maap soak"}  # programs that fly
VEHICLE_NODE = "controller.py __name:=joystick_controller"  # flies a vehicle; lands it when interrupted
FLIGHT_S = 90.0  # for `./maap fly` to land all, end the nodes and write the report
LAUNCH_S = 60.0  # for roslaunch and its nodes
LANDING_S = 6.0  # of a vehicle that was told to land


def end_flight(identity):
    """Land and end one flight by interrupting the topmost program that is left. Returns a sentence that says how."""
    left = marked_processes(identity)
    if not left:
        return "it has ended meanwhile"
    launch = next((pid for pid, command in left.items() if "/roslaunch " in command), None)
    program = 0 if launch is None else _parent(launch)
    if launch is None:
        pilots = [pid for pid, command in left.items() if VEHICLE_NODE in command]
        for pid in pilots:
            send_signal(pid, signal.SIGINT)
        how = "roslaunch had died: the vehicle nodes that were left (%d) were interrupted, and land" % len(pilots)
        wait_until(lambda: not any(map(_command, pilots)), LAUNCH_S)
        if pilots:  # the other nodes are needed until the vehicles stand
            time.sleep(LANDING_S)
        for pid in marked_processes(identity):
            send_signal(pid, signal.SIGINT)
        wait_until(lambda: not marked_processes(identity), LANDING_S)
    elif command := next((FLIGHTS[name] for name in FLIGHTS if name in _command(program)), ""):
        send_signal(program, signal.SIGINT)
        how = "%s was interrupted: it lands the vehicles and reports" % command
        wait_until(lambda: not _command(program), FLIGHT_S)
    else:
        send_signal(launch, signal.SIGINT)
        how = "roslaunch was interrupted: its vehicle nodes land the vehicles"
        wait_until(lambda: not marked_processes(identity), LAUNCH_S)
    killed = end_processes(identity)
    return how + ("; these had to be killed: " + "; ".join(sorted(killed.values())) if killed else "")


def _command(pid):
    """Command line of a process, "" when it has ended."""
    try:
        return " ".join(psutil.Process(pid).cmdline())
    except psutil.Error:
        return ""


def _parent(pid):
    try:
        return psutil.Process(pid).ppid()
    except psutil.Error:
        return 0


def main(argv=None):
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="maap stop", description=__doc__.partition(": ")[2])
    parser.parse_args(argv)
    flights = all_marked_processes()
    if not flights:
        print("no flight of this user is under way")
    for identity, processes in flights.items():
        print("ending a flight of %d processes ..." % len(processes), flush=True)
        print(end_flight(identity), flush=True)
    return 1 if all_marked_processes() else 0


if __name__ == "__main__":
    sys.exit(main())
