"""Whole graph in real time: how long after the start of a fault the virtual vehicles receive a command of a higher
failsafe level, by the clock of the computer that flies.

A flight has as many events of one fault as fit, at seeded times; every vehicle counts. When vehicles have landed, the
next flight continues. Vehicles whose ladder had no reason to leave its level have no reaction.
--programs: the programs of a flight are killed, and stopped for a short and for a long time. For programs between the
ladder and the vehicle, what counts is the order that the vehicle receives: hover, or land. Only some flights have a
transmitter (IRIS+: --fleet) or the filter EKF (--states cortex_ekf).
--out: a flight whose summary.json is there is not flown again. So the same command continues an interrupted run, and
several commands may fly parts of the faults into one folder, each with a --json of its own; then the command for all
faults flies nothing, and writes the whole table.
"""

import argparse
import datetime
import json
import math
import pathlib
import re
import shlex
import shutil
import subprocess
import sys

import numpy as np
import yaml

from risc_control.vehicle_pilot import VehicleNodeParams
from risc_control.vehicles import adapter_class
from risc_experiments.fly import STATES
from risc_experiments.soak import table
from risc_lab.lab import load_fleet
from risc_simulator.faults import parse_fault

ROOT = pathlib.Path(__file__).resolve().parents[2]
FAULTS = ("mocap_blackout:0.3",)
PROGRAMS = ("mocap_client", "states_estimation", "EKF", "controller", "trajectory", "vehicle_node", "driver",
            "transmitter", "joystick", "master")  # fmt: skip
OF_PROGRAMS = "node_kill:%s", "node_stop:%s,0.3", "node_stop:%s,3"
# programs whose silence the ladder has to notice as soon as that of motion capture
AS_MOCAP = ("mocap_client", "states_estimation", "controller", "EKF")
STATE_HOLD_MS = 120.0  # limit to hold when motion capture is lost; a period of the vehicle's commands is added
FIRST_S, APART_S, SHIFT_S = 3.0, 3.0, 0.5  # of events: start of the first, from one to the next, random shift (+-)
MOST_FLIGHTS = 20  # of one fault, or as many as events are wanted


def script(text, count, seed):
    """Content of a file of `count` events of a fault."""
    event, rng = parse_fault(text), np.random.default_rng([seed, count])
    starts_s = FIRST_S + APART_S * np.arange(count) + rng.uniform(-SHIFT_S, SHIFT_S, count)
    names = "fault", "vehicle", "severity", "channel", "program"
    fields = {name: getattr(event, name) for name in names}
    return {"faults": [dict(fields, duration_s=event.duration_s, start_s=start_s) for start_s in starts_s.tolist()]}


def fly(folder, events, seed, args, options=()):
    """Fly one flight with a file of faults, unless it is there. Returns its summary, or None when there is none (its
    folder says why). Raises ValueError when another flight is there.
    """
    path, asked, faults = folder / "summary.json", folder / "options.txt", folder / "faults.yaml"
    words = ["--seed", str(seed), "--vehicles", str(args.vehicles), "--duration", str(args.duration)]
    words += ["--mocap-rate", str(args.mocap_rate), *options, *(["--fleet", str(args.fleet)] if args.fleet else [])]
    texts = {asked: shlex.join(words) + "\n", faults: yaml.safe_dump(events)}
    if not path.exists():
        shutil.rmtree(folder, ignore_errors=True)  # it was interrupted
        folder.mkdir(parents=True)
        for file, text in texts.items():
            file.write_text(text, encoding="utf-8")
        command = [sys.executable, "-m", "risc_experiments.fly", *words, "--out", str(folder), "--faults", str(faults)]
        with (folder / "fly.txt").open("w") as output:
            subprocess.call(command, stdout=output, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
    elif any(not file.exists() or file.read_text(encoding="utf-8") != text for file, text in texts.items()):
        raise ValueError("%s holds a flight with other options: choose another --out" % folder)
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def measure(text, folder, args):
    """Row of a fault: events until there are enough of them."""
    events, passed, late_ms, seed = [], 0, [], 0
    while len(events) < args.events and seed < max(MOST_FLIGHTS, args.events):
        seed += 1
        count = int((args.duration - FIRST_S - SHIFT_S) / APART_S)
        name = "%s_seed%d" % (re.sub(r"\W", "_", text), seed)
        summary = fly(folder / name, script(text, count, seed), seed, args, ("--states", args.states))
        if summary is not None:
            events += table.counted(summary["faults"])
            passed += summary["passed"]
            late_ms.append(summary["lab_late_ms"]["p99"])
    return table.row_of(text, events) | {
        "never": sum(event["flying"] - len(event["reactions_ms"]) for event in events),
        "flights": seed,
        "passed": passed,
        "lab_late_p99_ms": max(late_ms, default=None),
    }


def is_limited(text):
    """Whether vehicles have to hold within `limit_ms` of the start of a fault."""
    event = parse_fault(text)
    lasts = event.fault == "node_kill" or 1e3 * event.duration_s > STATE_HOLD_MS
    return lasts and (event.fault == "mocap_blackout" or event.program in AS_MOCAP)


def programs_of(vehicle_types, states):
    """([those of PROGRAMS that flights of such vehicles have], [why others are left out])."""
    roles = {role for vehicle_type in vehicle_types for role in adapter_class(vehicle_type).NODES}
    missing = {}
    if "transmitter" not in roles:
        missing["transmitter"] = "no transmitter: it is of an IRIS+ (--fleet launch/fleets/mixed3.yaml)"
    if states != "cortex_ekf":
        missing["EKF"] = "no EKF: it is of flights with --states cortex_ekf"
    return [name for name in PROGRAMS if name not in missing], list(missing.values())


def limit_ms(fleet, vehicles=None):
    """Time [ms] within which the first vehicles of a fleet must be told to hold when states or commands stop."""
    types = [vehicle.vehicle_type for vehicle in load_fleet(fleet).vehicles[:vehicles]]
    return STATE_HOLD_MS + max(1e3 / VehicleNodeParams().rate_hz(vehicle_type) for vehicle_type in types)


def is_late(row, hold_ms):
    """Whether vehicles had to hold within `limit_ms`, and the p99 is later, or one that flew never did."""
    return is_limited(row["fault"]) and (row["never"] > 0 or not (row["p99_ms"] or math.inf) <= hold_ms)


def main(arguments=None):
    """Command line. Returns 1 when an outcome was not safe, a flight failed, or vehicles held late, see `is_late`."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=pathlib.Path, help="write the rows here, after each one")
    parser.add_argument("--out", type=pathlib.Path, help="folder for the flights (default: flights/faults_DATE)")
    parser.add_argument("--faults", nargs="+", default=FAULTS, metavar="NAME[:ARG]")
    parser.add_argument("--programs", action="store_true", help="programs that die or hang, instead of --faults")
    parser.add_argument("--events", type=int, default=100, help="of each fault, at least")
    parser.add_argument("--vehicles", type=int, default=3)
    parser.add_argument("--fleet", type=pathlib.Path, help="fleet file (default: that of circles3)")
    parser.add_argument("--states", choices=STATES, default=STATES[0], help="as for ./maap fly")
    parser.add_argument("--duration", type=float, default=110.0, help="[s] on the course")
    parser.add_argument("--mocap-rate", type=float, default=200.0, help="[Hz]")
    args = parser.parse_args(arguments)
    fleet, left_out = args.fleet or ROOT / "launch/fleets/ardrones3.yaml", []
    if args.programs:
        vehicles = load_fleet(fleet).vehicles[: args.vehicles]
        programs, left_out = programs_of([vehicle.vehicle_type for vehicle in vehicles], args.states)
        args.faults = [text % program for program in programs for text in OF_PROGRAMS]
    hold_ms = limit_ms(fleet, args.vehicles)
    out = args.out or ROOT / "flights" / datetime.datetime.now().strftime("faults_%Y%m%d-%H%M%S")
    print("%d vehicles, perturbed plant (simulated); states or commands stop: p99 at most %.0f ms"
          % (args.vehicles, hold_ms))  # fmt: skip
    print("".join(reason + "\n" for reason in left_out), end="")
    print("%-28s %7s %7s %9s %9s %9s %9s  %s"
          % ("fault", "flights", "events", "reactions", "p50", "p99", "max", "outcomes"), flush=True)  # fmt: skip
    rows = []
    for text in args.faults:
        try:
            row = measure(text, out, args)
        except ValueError as error:
            parser.error(str(error))
        rows.append(row)
        told = ["-" if row[key] is None else "%.1f ms" % row[key] for key in ("p50_ms", "p99_ms", "max_ms")]
        outcomes = ", ".join("%s %d" % item for item in sorted(row["outcomes"].items()))
        unsafe = "; %d not safe" % row["unsafe"] if row["unsafe"] else ""
        unsafe += "; late, or never (%d)" % row["never"] if is_late(row, hold_ms) else ""
        print("%-28s %3d/%3d %7d %9d %9s %9s %9s  %s%s; lab late %.1f ms (p99)"
              % (text, row["passed"], row["flights"], row["events"], row["reactions"], *told, outcomes, unsafe,
                 row["lab_late_p99_ms"] or math.nan), flush=True)  # fmt: skip
        if args.json:
            args.json.write_text(json.dumps({"rows": rows}, indent=2) + "\n", encoding="utf-8")
    bad = [row for row in rows if is_late(row, hold_ms) or row["unsafe"] or row["passed"] < row["flights"]]
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
