"""Where the processor time of a flight goes: every program, milliseconds per mocap frame, by what it does.

On the course of a flight, the kernel's processor times of all programs are read, undisturbed; then one program after
the other is sampled by py-spy (threads that hold Python's lock), and its time is divided in proportion to the samples.
Programs without Python are sampled by perf, where the kernel allows it: what it cannot tell apart is "the rest".
"""

import argparse
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter

import psutil

from risc_experiments.processor_use import program_name
from risc_lab.ros.launching import MARK

ROOT = pathlib.Path(__file__).resolve().parents[2]
FRAME_RATE_HZ = 200.0
SECONDS = 8.0  # of samples of each program
SAMPLES_HZ = 250
SETTLE_S = 12.0  # from take-off to the course
LEAST_CORES = 0.003  # programs that use less are left out

# Kinds of work. A stack is searched from its innermost frame outwards: the first that fits counts.
KINDS = (
    ("receiving", r"recv|receive_once|deserialize|decode|unpack|_from_wire|parse_datagram|on_navdata|on_readable"),
    ("sending", r"publish\b|serialize|encode|send|write_data|_pack\b|sendto|post\b|NavdataWriter"),
    ("maths", r"risc_control/(controllers|delay_prediction|reference|pursuit|trajector|transitions|motions|flatness|lqr"
              r"|separation|vehicles)|risc_lab/command_history|risc_estimation/"
              r"|risc_simulator/(world|models)|vehicle_pilot|failsafe\.py|link\.py"),
    ("waking threads", r"threading\.py|rospy/timer|ticker\.py|paced_subscriber\.py|select|poll\b|sleep|queue\.py"),
)  # fmt: skip
COLUMNS = ["receiving", "maths", "sending", "waking threads", "kernel", "the rest"]
NATIVE = (
    ("kernel", r"\[k\]|\[kernel"),
    ("receiving", r"recv|read|deserial|decode"),
    ("sending", r"send|write|serial|publish"),
    ("waking threads", r"futex|pthread|poll|cond"),
)


def kind_of(stack):
    """Kind of work of a stack: texts "function (file:line)", the outermost first."""
    for frame in reversed(stack):
        for kind, pattern in KINDS:
            if re.search(pattern, frame):
                return kind
    return "the rest"


def sampled(pid, folder):
    """Counter of a Python program's samples, by kind; empty for any other program."""
    raw = folder / ("%d.txt" % pid)
    command = ["py-spy", "record", "--gil", "--nonblocking", "--format", "raw", "--pid", str(pid)]
    command += ["--duration", "%d" % SECONDS, "--rate", "%d" % SAMPLES_HZ, "--output", str(raw)]
    subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
    counts = Counter()
    for line in raw.read_text(encoding="utf-8").splitlines() if raw.exists() else ():
        stack, _, count = line.rpartition(" ")
        counts[kind_of(stack.split(";"))] += int(count)
    return counts


def sampled_natively(pid, folder):
    """Counter of samples by perf, by kind, of symbols of program and kernel; empty when perf is not allowed."""
    data = folder / ("%d.perf" % pid)
    if shutil.which("perf") is None:
        return Counter()
    record = ["perf", "record", "-q", "-F", "2000", "-o", str(data), "-p", str(pid), "--", "sleep", str(SECONDS)]
    report = ["perf", "report", "-q", "-i", str(data), "--stdio", "--no-children", "-g", "none", "--sort", "symbol"]
    if subprocess.run(record, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False).returncode != 0:
        return Counter()
    counts = Counter()
    for line in subprocess.run(report, capture_output=True, text=True, check=False).stdout.splitlines():
        share, _, symbol = line.strip().partition("%")
        if symbol:
            found = (kind for kind, pattern in NATIVE if re.search(pattern, symbol))
            counts[next(found, "the rest")] += round(1000 * float(share))
    return counts


def programs(folder):
    """{name: psutil.Process} of the flight that writes to this folder."""
    found = {}
    for process in psutil.process_iter():
        try:
            environment = process.environ()
        except psutil.Error:
            continue
        if MARK in environment and environment.get("ROS_HOME") == str(folder):
            found[program_name(process)] = process
    return found


def use_of(processes):
    """{name: (cores in programs, cores in the kernel)} of processes {name: psutil.Process}, undisturbed."""
    before = {name: process.cpu_times() for name, process in processes.items()}
    time.sleep(SECONDS)
    after = {name: process.cpu_times() for name, process in processes.items()}
    return {
        name: tuple((getattr(after[name], kind) - getattr(before[name], kind)) / SECONDS for kind in ("user", "system"))
        for name in processes
    }


def look(process, user, system, folder):
    """{column: milliseconds per frame} and {"cores": ...} of a program. user, system: cores that it uses."""
    counts = sampled(process.pid, folder)
    row = dict.fromkeys(COLUMNS, 0.0)
    shared = user
    if counts:
        row["kernel"] = system
    else:
        counts = sampled_natively(process.pid, folder) or Counter({"the rest": 1})
        shared += system
    for kind, count in counts.items():
        row[kind] += shared * count / sum(counts.values())
    return dict({kind: 1e3 * cores / FRAME_RATE_HZ for kind, cores in row.items()}, cores=user + system)


def main():
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vehicles", type=int, default=3, metavar="N")
    parser.add_argument("--json", type=pathlib.Path, metavar="FILE")
    args = parser.parse_args()
    if shutil.which("py-spy") is None:
        sys.exit("py-spy is missing: ./maap setup installs it")
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        out = folder / "flight"
        command = [sys.executable, "-m", "risc_experiments.fly", "--vehicles", str(args.vehicles), "--duration", "300",
                   "--out", str(out)]  # fmt: skip
        with (folder / "fly.txt").open("w") as log:
            flight = subprocess.Popen(command, stdout=log, stderr=log, env=dict(os.environ, RISC_MAAP_ROOT=str(ROOT)))
        try:
            while not (out / "processors.json").exists():
                if flight.poll() is not None:
                    sys.exit("the flight ended:\n" + (folder / "fly.txt").read_text()[-2000:])
                time.sleep(0.5)
            time.sleep(SETTLE_S)
            processes = dict(programs(out), **{"maap fly": psutil.Process(flight.pid)})
            used = {name: use for name, use in use_of(processes).items() if sum(use) >= LEAST_CORES}
            rows = {name: look(processes[name], *use, folder) for name, use in used.items()}
        finally:
            flight.terminate()  # it lands, and evaluates what it has
            time.sleep(1.0)
            flight.wait(120.0)
    print("%d vehicles, milliseconds of processor time per frame at %g Hz" % (args.vehicles, FRAME_RATE_HZ))
    print("%-24s" % "program" + "".join("%16s" % column for column in COLUMNS) + "%10s" % "cores")
    for name, row in sorted(rows.items(), key=lambda item: -item[1]["cores"]):
        print("%-24s" % name + "".join("%16.3f" % row[column] for column in COLUMNS) + "%10.3f" % row["cores"])
    print("%-24s" % "all" + "".join("%16.3f" % sum(row[c] for row in rows.values()) for c in COLUMNS)
          + "%10.3f" % sum(row["cores"] for row in rows.values()))  # fmt: skip
    if args.json:
        args.json.write_text(
            json.dumps({"vehicles": args.vehicles, "programs": rows}, indent=2) + "\n", encoding="utf-8"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
