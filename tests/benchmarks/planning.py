#!/usr/bin/env python3
"""Times to plan ways and to sample references, by the number of vehicles, and the largest gap in the references."""

import argparse
import itertools
import json
import math
import pathlib
import sys
import threading
import time

import numpy as np

from risc_control.trajectories import course_for_fleet
from risc_control.trajectory_manager import make_manager
from risc_control.transitions import plan_ways
from risc_experiments.fleets import default_fleet

COURSES = ("circles3", "circle")  # with many vehicles: where they hover, and across each other's ways
VEHICLES = (1, 3, 5, 8, 14, 30, 50)
PERIOD_S = 0.005
REPEATS = 5
SWITCH_INTERVAL_S = 0.0005  # as the nodes set it
LEAD_S = 10.0  # more than planning takes


def manager_of(course, vehicles):
    """TrajectoryManager of vehicles that hover over their starts, about to fly a course."""
    fleet = default_fleet(vehicles, course)
    course = course_for_fleet(course, vehicles, fleet.arena)
    manager = make_manager(fleet.vehicles, course, lead_s=LEAD_S)
    for vehicle in fleet.vehicles:
        x, y, _ = vehicle.start.position_m
        manager.see(vehicle.template, (x, y, 0.9), np.zeros(3), 0.0)
        manager.set_autonomous(vehicle.template, True, 0.0)
    return manager


def planned(manager, now_s):
    """CPU time [s] to plan the manager's task; the manager accepts the plan."""
    task, started = manager.task, time.thread_time()
    plan = plan_ways(task)
    took_s = time.thread_time() - started
    manager.accept(task, plan, now_s)
    return took_s


def microseconds(sample, now_s):
    """CPU time of one sample, the least of many."""
    best_s = math.inf
    for _ in range(REPEATS):
        started = time.thread_time()
        for _ in range(200):
            sample(now_s)
        best_s = min(best_s, (time.thread_time() - started) / 200)
    return 1e6 * best_s


def largest_gap_s(manager):
    """Largest time [s] between two references of a 200 Hz thread while ways are planned in this one."""
    lock, ticks, done = threading.Lock(), [], threading.Event()
    epoch_s = time.monotonic()

    def publish():
        number = 0
        while not done.is_set():
            number += 1
            time.sleep(max(0.0, epoch_s + number * PERIOD_S - time.monotonic()))
            with lock:
                manager.sample(1.0 + time.monotonic() - epoch_s)
            ticks.append(time.monotonic())

    publisher = threading.Thread(target=publish)
    publisher.start()
    time.sleep(0.1)
    plan_ways(manager.task)
    done.set()
    publisher.join()
    return float(np.diff(ticks).max())


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE", help="also write the figures here")
    options = parser.parse_args()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    rows = []
    print("course    vehicles  to the course  closest  home     closest  sample: course  way       largest gap")
    for course, vehicles in itertools.product(COURSES, VEHICLES):
        out_s, home_s = [], []
        for _ in range(REPEATS):
            manager = manager_of(course, vehicles)
            manager.sample(1.0)
            out_s.append(planned(manager, 1.0))
            out_m, now_s = manager.closest_m, LEAD_S + 200.0
            manager.go_home(now_s)
            home_s.append(planned(manager, now_s))
        row = {
            "course": course,
            "vehicles": vehicles,
            "to_course_ms": 1e3 * min(out_s),
            "to_course_m": out_m if math.isfinite(out_m) else None,
            "home_ms": 1e3 * min(home_s),
            "home_m": manager.closest_m if math.isfinite(manager.closest_m) else None,
            "sample_course_us": microseconds(manager.sample, now_s),
            "sample_way_us": microseconds(manager.sample, now_s + LEAD_S + 1.0),
            "largest_gap_ms": 1e3 * min(largest_gap_s(manager_of(course, vehicles)) for _ in range(REPEATS)),
        }
        rows.append(row)
        print("%-8s  %8d  %8.1f ms    %5.2f m  %5.1f ms %5.2f m  %8.1f us     %6.1f us   %5.1f ms" % (
            course, vehicles, row["to_course_ms"], out_m, row["home_ms"], manager.closest_m, row["sample_course_us"],
            row["sample_way_us"], row["largest_gap_ms"]), flush=True)  # fmt: skip
    if options.json:
        options.json.write_text(json.dumps({"rows": rows}, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
