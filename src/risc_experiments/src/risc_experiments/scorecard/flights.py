"""Flights of the scorecard: the figures of each flight, saved in a file as soon as it is flown."""

import contextlib
import fcntl
import hashlib
import json
import math
import pathlib
import time
from typing import NamedTuple

import numpy as np

import cortex_ros
import risc_control
import risc_estimation
import risc_experiments
import risc_lab
import risc_simulator
from risc_control.safety import FailsafeLevel
from risc_experiments.offline import JUDGE_EVERY, fly, lab_of
from risc_experiments.offline_chain import FRAME_S, LATENCY_S
from risc_experiments.workers import in_order
from risc_lab.lab.yaml_reader import member_folders, package_file
from risc_simulator.faults import fault_settings
from risc_simulator.models.integrator import REST_HEIGHT_M

_SOURCES = (cortex_ros, risc_control, risc_estimation, risc_experiments, risc_lab, risc_simulator)
UNSEEN = "unseen"  # how an event was noticed; otherwise the name of a level
FILE = "flights.jsonl"


class Alarm(NamedTuple):
    """A sign of trouble with a vehicle: a level above OK, or motion capture lost it."""

    time_s: float
    vehicle: int
    how: str  # name of a FailsafeLevel, or UNSEEN
    until_s: float  # infinite: to the end


def score(item):
    """Figures of a flight as a dict for JSON. item: (Flight, settle_s: time after the end of a fault during which it
    still explains what happens).
    """
    flight, settle_s = item
    began_s = time.process_time()
    try:
        result = fly(flight)
    except RuntimeError as error:
        took_s = round(time.process_time() - began_s, 3)
        return {"minutes": 0.0, "vehicle_minutes": 0.0, "error": str(error), "took_s": took_s}
    alarms = _alarms(result)
    return {
        "minutes": round((result.flown_s - result.reached_s) / 60.0, 5),
        "vehicle_minutes": round(_vehicle_minutes(result), 5),
        **_errors(result),
        "net_m": round(_net_m(lab_of(flight)[0].arena, result), 4),
        "events": _events(flight, result, alarms, settle_s),
        "false_alarms": _false_alarms(flight, result, alarms, settle_s),
        "breach": ["%s %s %s" % (breach.name, breach.reason, _when(result, breach)) for breach in result.breaches],
        "contact": ["%s and %s %s" % (touch.name, touch.other, _when(result, touch)) for touch in result.contacts],
        "took_s": round(time.process_time() - began_s, 3),
    }


def _vehicle_minutes(result):
    """Time [min] that the vehicles were in the air since the course was reached, summed over the vehicles."""
    up = result.actual_m[result.times_s >= result.reached_s, :, 2] > REST_HEIGHT_M + 0.01
    return np.count_nonzero(up) * JUDGE_EVERY * FRAME_S / 60.0


def _net_m(arena, result):
    """Least distance [m] of the centre of a vehicle to the net's sides and ceiling since the course was reached."""
    places_m = np.abs(result.actual_m[result.times_s >= result.reached_s])
    return float((np.array([arena.half_x_m, arena.half_y_m, arena.height_m]) - places_m).min())


def _when(result, event):
    """E.g. "after 23.41 s, 0.30 s after the start of jump:0.3,risc2"."""
    before = [outcome for outcome in result.faults if outcome.start_s <= event.time_s]
    if not before:
        return "after %.2f s" % event.time_s
    last = max(before, key=lambda outcome: outcome.start_s)
    since_s = event.time_s - last.start_s
    return "after %.2f s, %.2f s after the start of %s:%s" % (event.time_s, since_s, last.name, last.args)


def _errors(result):
    """Errors of the vehicles as long as they were on their courses."""
    on = result.judged[:, None] & (result.times_s[:, None] < np.array(result.left_s))
    square_m2 = ((result.reference_m - result.actual_m) ** 2).sum(axis=2)[on]
    worst_m = round(float(math.sqrt(square_m2.max())), 6) if square_m2.size else None
    return {"square_m2": float(square_m2.sum()), "samples": int(square_m2.size), "worst_m": worst_m}


def _alarms(result):
    """Alarms in the order of their times: from a level above OK to the next OK, and each loss of sight."""
    alarms, open_at = [Alarm(time_s, vehicle, UNSEEN, time_s) for time_s, vehicle in result.unseen], {}
    for time_s, vehicle, level, _ in result.levels:
        if level is FailsafeLevel.OK:
            begin_s, first = open_at.pop(vehicle, (None, None))
            if first is not None:
                alarms.append(Alarm(begin_s, vehicle, first.name.lower(), time_s))
        elif vehicle not in open_at:
            open_at[vehicle] = time_s, level
    alarms += [Alarm(begin_s, vehicle, first.name.lower(), math.inf) for vehicle, (begin_s, first) in open_at.items()]
    return sorted(alarms)


def _events(flight, result, alarms, settle_s):
    """How each fault was detected: [text, begin [s], outcome, safe, delay [ms] or None, how]. Faults that could not be
    detected are left out: the vehicle was down, or above OK already.
    """
    rows, vehicles = [], {name: i for i, name in enumerate(result.namespaces)}
    begins_s = sorted(outcome.start_s + LATENCY_S for outcome in result.faults)
    for event, outcome in zip(flight.faults, result.faults):
        begin_s = outcome.start_s + LATENCY_S
        if begin_s >= result.flown_s:
            continue
        concerned = [vehicles[event.vehicle]] if event.vehicle in vehicles else range(len(vehicles))
        ready = [vehicle for vehicle in concerned if _is_ready(result, alarms, vehicle, begin_s)]
        if not ready:
            continue
        next_s = min((other_s for other_s in begins_s if other_s > begin_s), default=math.inf)
        until_s = min(next_s, (math.inf if outcome.end_s is None else outcome.end_s + LATENCY_S) + settle_s)
        first = next((alarm for alarm in alarms if begin_s <= alarm.time_s < until_s), None)
        delay_ms = None if first is None else round(1e3 * (first.time_s - begin_s), 3)
        text = "%s:%s" % (outcome.name, outcome.args)
        rows.append([text, round(begin_s, 3), outcome.outcome, outcome.safe, delay_ms, first and first.how])
    return rows


def _is_ready(result, alarms, vehicle, time_s):
    """Whether a vehicle is on its course, and has no alarm."""
    mine = (alarm for alarm in alarms if alarm.vehicle == vehicle)
    return result.left_s[vehicle] > time_s and not any(alarm.time_s < time_s < alarm.until_s for alarm in mine)


def _false_alarms(flight, result, alarms, settle_s):
    """Number of levels above OK that neither a fault explains, nor another level that a fault explains."""
    explained, lasting, vehicles = [], [], {name: i for i, name in enumerate(result.namespaces)}
    for event, outcome in zip(flight.faults, result.faults):
        end_s = math.inf if outcome.end_s is None else outcome.end_s
        explained.append((outcome.start_s, end_s + settle_s))
        if fault_settings(event.fault).lasts:
            lasting.append((outcome.start_s, vehicles.get(event.vehicle)))  # None: all
    count = 0
    for alarm in alarms:
        is_explained = any(begin_s <= alarm.time_s <= end_s for begin_s, end_s in explained)
        if is_explained or any(
            begin_s <= alarm.time_s and vehicle in (None, alarm.vehicle) for begin_s, vehicle in lasting
        ):
            explained.append((alarm.time_s, alarm.until_s + settle_s))
        elif alarm.how != UNSEEN:
            count += 1
    return count


class Record:
    """The file of the flights that a scorecard has flown: its identity, then a line for each flight."""

    def __init__(self, folder, identity):
        """identity: dict for JSON; a file with another identity is kept as FILE.old.

        flown: {(fault, severity, estimator, controller): {seed: figures}}.  notice: what became of an earlier file.
        Raises ValueError for a file that another scorecard writes, or that is damaged.
        """
        self.flown, self.notice = {}, ""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / FILE
        self._open(path)
        whole = path.read_bytes().split(b"\n")[:-1]  # a flight whose line is incomplete is flown again
        if whole and _loaded(whole[0]) == identity:
            for number, line in enumerate(whole[1:], 2):
                if not (loaded := _loaded(line)):
                    raise ValueError("%s, line %d is damaged: delete the line to repeat that flight" % (path, number))
                self._take(loaded)
            self._file.truncate(sum(len(line) + 1 for line in whole))
            self.notice = "going on with the flights in %s: %d" % (path, len(whole) - 1)
            return
        if whole:
            old = path.with_name(FILE + ".old")
            path.replace(old)
            self.notice = "starting over: %s; the earlier flights are in %s" % (
                _difference(_loaded(whole[0]), identity), old)  # fmt: skip
            self.close()
            self._open(path)
        self._file.truncate(0)
        self._write(identity)

    def _open(self, path):
        self._file = path.open("a", encoding="utf-8")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            text = "%s is being written by another scorecard: wait for its end, or give this one another --out"
            raise ValueError(text % path) from None

    def _write(self, line):
        self._file.write(json.dumps(line) + "\n")
        self._file.flush()

    def _take(self, line):
        self.flown.setdefault(tuple(line["cell"]), {})[line["seed"]] = line

    def add(self, cell, seed, figures):
        """Add a flight."""
        line = {"cell": list(cell), "seed": seed} | figures
        self._take(line)
        self._write(line)

    def minutes(self):
        """{cell: {seed: minutes}}"""
        return {
            cell: {seed: figures["minutes"] for seed, figures in flights.items()}
            for cell, flights in self.flown.items()
        }

    def close(self):
        """Close the file."""
        self._file.close()


def _loaded(line):
    """Content of a line; {} when it is damaged."""
    try:
        return json.loads(line)
    except ValueError:
        return {}


def _difference(before, now):
    """Text that names the parts of an identity that differ."""
    keys = [key for key in now if not isinstance(before, dict) or before.get(key) != now[key]]
    return "another " + ", ".join(key.replace("_", " ") for key in keys)


def code_version():
    """Digest of all that affects a flight: sources, settings and fleets of our packages, and external members."""
    folders = [pathlib.Path(folder) for package in _SOURCES for folder in package.__path__] + member_folders()
    for package in _SOURCES:
        with contextlib.suppress(ValueError):  # the package has none
            folders.append(package_file(package.__name__, "config"))
    digest = hashlib.sha256()
    for folder in folders:
        for path in sorted(path for suffix in ("*.py", "*.yaml") for path in folder.rglob(suffix)):
            digest.update(str(path.relative_to(folder)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def fly_plan(plan, record, workers, on_progress):
    """Fly the flights of a Plan that the Record does not have yet. on_progress: called with the fraction that is done.

    Raises as `workers.in_order`.
    """
    settle_s = plan.params.events.settle_s
    while items := list(plan.wanting(record.minutes())):
        flights = [(plan.flight(cell, seed), settle_s) for cell, seed in items]
        for (cell, seed), figures in zip(items, in_order(score, flights, workers)):
            record.add(cell, seed, figures)
            on_progress(plan.part(record.minutes()))
