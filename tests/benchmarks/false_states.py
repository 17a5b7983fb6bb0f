"""What false motion capture does to the states that a fleet flies by, over the wire: `./maap bench false_states`.

Whole graph in real time, simulated: a fleet on its course, one event a second, of one frame to 0.2 s. The states of the
bag are compared with the virtual lab's truth of the same frame: a state is wrong when it is off by more than 30 mm, 5
degrees of tilt or 10 degrees of yaw. A state is harmful when it says `visible` and is wrong.

Only states that were published count.

- false: frames while a fault acts.  harmful: those of them with a harmful state of any vehicle.  after: frames with a
  harmful state from the end of an event to the next event.
- settled: from the end of an event until all vehicles are visible and right.
- noticed: in events of ten frames or more, frames until a vehicle is not visible (only for `freeze`, where the frames
  do not contradict themselves).
"""

import argparse
import datetime
import json
import math
import pathlib
import sys

import numpy as np
from faults import ROOT, fly
from gate import WRONG_M, WRONG_TILT_RAD, WRONG_YAW_RAD, errors_of

from data_extraction.bags import Bag
from data_extraction.flatten import seconds
from risc_lab.states import S

FAULTS = "marker_swap", "ghost_marker", "nan_markers", "freeze", "flip", "jump", "name_exchange"
FIRST_S, APART_S, SHIFT_S = 2.0, 1.0, 0.2  # of events: start of the first, from one to the next, random shift (+-)
LONGEST_S = 0.2
LONG_FRAMES = 10  # least length of an event for `noticed`
MOST_HARMFUL = 0.005  # fraction of the false frames
SETTLED_MS, NOTICED_FRAMES = 50.0, 3.0  # limits of half of the events, and of 99 % of the frozen ones
STATES, TRUTH, EVENTS = "/cortex_raw", "/ground_truth", "/virtual_lab/faults"
COLUMNS = "x", "y", "z", "u", "v", "w", "phi", "theta", "psi", "p", "q", "r"  # of `S`
UNCONTRADICTED = ("freeze",)


def script(fault, count, frame_s, seed):
    """Content of a file of `count` events of a fault."""
    rng = np.random.default_rng([seed, count])
    starts_s = FIRST_S + APART_S * np.arange(count) + rng.uniform(-SHIFT_S, SHIFT_S, count)
    durations_s = rng.uniform(frame_s, LONGEST_S, count)
    events = zip(starts_s.tolist(), durations_s.tolist())
    return {"faults": [{"fault": fault, "start_s": start_s, "duration_s": lasts_s} for start_s, lasts_s in events]}


def read(path):
    """(stamps (k,) [s], visible (k, n) bool, wrong (k, n) bool, [(begins, ends) [s], ...]) of a bag; n: vehicles.

    Frames without a known truth are left out.
    """
    told, events, names = {STATES: {}, TRUTH: {}}, {}, ()
    with Bag(path) as bag:
        for topic, _, message in bag.messages((*told, EVENTS)):
            if topic == EVENTS:
                began = [fault for fault in message.faults if fault.active]
                events.update((fault.id, (seconds(fault.begins), seconds(fault.ends))) for fault in began)
                continue
            bodies = {body.name: body for body in message.Obj}
            names = names or tuple(bodies)
            rows = [[bodies[name].visible, *(getattr(bodies[name], column) for column in COLUMNS)] for name in names]
            told[topic][seconds(message.header.stamp)] = rows
    stamps_s, times_s = (np.array(sorted(told[topic])) for topic in told)
    states, truths = (np.array([told[topic][time_s] for time_s in sorted(told[topic])]) for topic in told)
    near_s = 0.5 * np.median(np.diff(times_s))
    frame_of = np.minimum(np.searchsorted(times_s, stamps_s - near_s), len(times_s) - 1)
    known = np.abs(times_s[frame_of] - stamps_s) < near_s
    states, truths = states[known], truths[frame_of[known]]
    states[..., 1 + S.PHI :] *= np.pi / 180.0
    truths[..., 1 + S.PHI :] *= np.pi / 180.0
    flat, flat_truth = states[..., 1:].reshape(-1, len(COLUMNS)), truths[..., 1:].reshape(-1, len(COLUMNS))
    errors = errors_of(flat[:, S.X : S.U], flat[:, S.PHI : S.P], flat_truth)
    wrong = (errors > (WRONG_M, WRONG_TILT_RAD, WRONG_YAW_RAD)).any(axis=1).reshape(states.shape[:2])
    return stamps_s[known], states[..., 0] > 0.0, wrong, sorted(events.values())


def judge(stamps_s, visible, wrong, events):
    """{figure: number, or list with a number per event} of a flight: see above. Arguments: as `read` returns them."""
    harmful, well = (visible & wrong).any(axis=1), (visible & ~wrong).all(axis=1)
    figures = {"events": len(events), "false": 0, "harmful": 0, "after": 0, "settled_ms": [], "noticed_frames": []}
    nexts_s = [begins_s for begins_s, _ in events[1:]] + [events[-1][1] + APART_S] if events else []
    for (begins_s, ends_s), next_s in zip(events, nexts_s):
        false = (stamps_s >= begins_s) & (stamps_s < ends_s)
        after = np.flatnonzero((stamps_s >= ends_s) & (stamps_s < next_s))
        figures["false"] += int(false.sum())
        figures["harmful"] += int(harmful[false].sum())
        figures["after"] += int(harmful[after].sum())
        settled = after[well[after]]
        figures["settled_ms"].append(1e3 * (stamps_s[settled[0]] - ends_s) if settled.size else math.inf)
        if false.sum() >= LONG_FRAMES:
            unseen = np.flatnonzero(~visible[false].all(axis=1))
            figures["noticed_frames"].append(float(unseen[0]) if unseen.size else math.inf)
    return figures


def row_of(fault, flights):
    """Figures of a fault. flights: of `judge`."""
    row = {"fault": fault, "flights": len(flights)}
    row |= {key: sum(flight[key] for flight in flights) for key in ("events", "false", "harmful", "after")}
    for key in "settled_ms", "noticed_frames":
        values = [value for flight in flights for value in flight[key]]
        if values and (key == "settled_ms" or fault in UNCONTRADICTED):
            for percent in (50, 99):
                value = float(np.percentile(values, percent, method="inverted_cdf"))
                row["%s_p%d" % (key, percent)] = value if value < math.inf else None
    row["share"] = row["harmful"] / row["false"] if row["false"] else None
    late = (row.get(key, 0.0) for key in ("settled_ms_p50", "noticed_frames_p99"))
    in_time = all(value is not None and value <= most for value, most in zip(late, (SETTLED_MS, NOTICED_FRAMES)))
    row["ok"] = row["share"] is not None and row["share"] <= MOST_HARMFUL and row["after"] == 0 and in_time
    return row


def measure(fault, folder, args):
    """Row of a fault."""
    flights, count = [], int((args.duration - FIRST_S - LONGEST_S - SHIFT_S) / APART_S)
    for seed in range(1, args.seeds + 1):
        flight = folder / ("%s_seed%d" % (fault, seed))
        options = ["--trajectory", args.trajectory]
        options += ["--estimator", args.estimator] if args.estimator else []
        fly(flight, script(fault, count, 1.0 / args.mocap_rate, seed), seed, args, options)
        flights.append(judge(*read(flight / "flight.bag")))
    return row_of(fault, flights)


def main(arguments=None):
    """Command line. Returns 1 when more than 0.5 % of the false frames of a fault were harmful, or any after an event,
    half of the events took longer than 50 ms to settle, or a frozen stream was noticed after more than 3 frames.
    """
    parser = argparse.ArgumentParser(prog="maap bench false_states", description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--faults", nargs="+", default=FAULTS, metavar="NAME")
    add("--estimator", metavar="NAME", help="velocity filter (default: that of the controller)")
    add("--trajectory", default="quadrants", metavar="NAME")
    add("--seeds", type=int, default=1, metavar="N", help="flights of each fault (default: 1)")
    add("--vehicles", type=int, default=3)
    add("--duration", type=float, default=60.0, help="[s] on the course (default: 60)")
    add("--mocap-rate", type=float, default=200.0, help="[Hz]")
    add("--out", type=pathlib.Path, help="folder for the flights (default: flights/false_states_DATE)")
    add("--json", type=pathlib.Path, help="write the rows here, after each one")
    parser.set_defaults(fleet=None)  # that of circles3, see faults.fly
    args = parser.parse_args(arguments)
    out = args.out or ROOT / "flights" / datetime.datetime.now().strftime("false_states_%Y%m%d-%H%M%S")
    print("%-14s %7s %7s %8s %8s %7s %15s %15s" % ("fault", "events", "false", "harmful", "share", "after",
                                                   "settled p50", "noticed p99"), flush=True)  # fmt: skip
    rows = []
    for fault in args.faults:
        rows.append(measure(fault, out, args))
        show(rows[-1])
        if args.json:
            args.json.write_text(json.dumps({"simulated": True, "rows": rows}, indent=2) + "\n", encoding="utf-8")
    return 0 if all(row["ok"] for row in rows) else 1


def show(row):
    """Print a row."""
    share = "-" if row["share"] is None else "%.2f %%" % (100.0 * row["share"])
    settled, noticed = (row.get(key) for key in ("settled_ms_p50", "noticed_frames_p99"))
    told = ["-" if settled is None else "%.0f ms" % settled, "-" if noticed is None else "%.0f frames" % noticed]
    numbers = row["events"], row["false"], row["harmful"], share, row["after"], *told
    print(
        "%-14s %7d %7d %8d %8s %7d %15s %15s" % (row["fault"], *numbers) + ("" if row["ok"] else "  missed"), flush=True
    )


if __name__ == "__main__":
    sys.exit(main())
