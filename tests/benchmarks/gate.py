"""What the estimator refuses, and whether its covariances are consistent: `./maap bench gate`.

Simulated: fleets of three AR.Drones, and of two and an IRIS+, on perturbed plants and in gusts fly real courses
offline; the virtual lab's cameras see each flight repeatedly, with other noise, and the frames go to the state
estimator with the filter `ekf`, or `--estimator NAME`. Everything is seeded; every seed flies another course and
heading. Control arms: `--gate off`, where no gate of the pose fit and of the filter refuses anything, and
`--set KEY=NUMBER`.

- false_reject_rate: share of the poses of clean frames (a body in a frame, with three visible markers or more) that
  the pose fit or the filter refuses, or takes only in part; with the upper 95 % bound of Clopper and Pearson.
- detected_first_frame: share of single false frames, by kind, that do no harm: the false pose is not taken, and no
  state of the frame is visible and wrong by more than 30 mm, 5 degrees of tilt or 10 degrees of yaw. A pose that was
  repaired, so that its error is below half of that (half of a jump), is not false; nor is the attitude of a vehicle
  with the heading and tilt of the one whose name it has.
  swap: two markers of a vehicle; flip: it faces the other way; exchange: two vehicles; jump: horizontal, log-uniform
  from 5 sigma of a marker's noise (10 mm) to 1 m.
- lockouts: outages of a vehicle, log-uniform from 0.02 to 5 s, after which it is not both visible and right within a
  second. readmission_ms_p99: from the first frame that sees it again to the first state that is both; null: never.
- nees, nis: mean over all vehicles of the squared errors of the twelve states, normalised by their covariances, and of
  the squared innovations (position and attitude), normalised by theirs, at one instant of each seed; low95 and high95:
  95 % band of the mean for a consistent filter.  nees_of: NEES of position, velocity, angles and rates alone, 3 degrees
  of freedom each.  null for a filter without covariances.
"""

import argparse
import json
import math
import pathlib
import sys
from collections import Counter
from typing import NamedTuple

import numpy as np
from flight_tape import record, replay
from scipy import stats

from data_extraction.progress import Progress, bar
from risc_estimation.filters import REGISTRY as FILTERS
from risc_estimation.filters import make_filter
from risc_estimation.pose_fit import PoseFitParams
from risc_experiments.offline import YAW_BY_SEED_DEG, Flight
from risc_experiments.offline_chain import FRAME_S
from risc_experiments.workers import in_order
from risc_lab.states import S
from risc_simulator.faults import REGISTRY as FAULTS
from risc_simulator.faults import fault_settings
from risc_simulator.models.mocap_cameras import CameraParams

COURSES = "circle", "flat8", "slanted8"
FLEETS = "ardrones3", "mixed3"
FLIGHT_S = 14.0  # on the course: an outage fits in
SETTLE_S = 2.0  # of a replay, before anything counts
REST_S = 0.3  # of a vehicle between two events
WRONG_M, WRONG_TILT_RAD, WRONG_YAW_RAD = 0.03, math.radians(5.0), math.radians(10.0)
FAULT_OF = {"swap": "marker_swap", "flip": "flip", "exchange": "name_exchange", "jump": "jump"}
JUMP_SIGMAS, JUMP_MOST_M = 5.0, 1.0
OUTAGE_S = 0.02, 5.0
LOCKED_OUT_S = 1.0
BLOCKS = {"position": S.X, "velocity": S.U, "angles": S.PHI, "rates": S.P}  # of three states each
# PoseFitParams with which nothing that can be fitted is refused
NO_GATES = {
    "residual_max_m": 1e3, "frozen_frames": 0, "tilt_max_rad": 4.0, "min_spread_m": 1e-9, "memory_s": 0.0,
    "false_reject_probability": 0.0,
}  # fmt: skip
_CLEAN, _FALSE, _OUTAGES = range(3)  # purposes of a seed's replays


class Task(NamedTuple):
    """Work of one process on one flight."""

    seed: int
    filter: str
    settings: dict  # of the filter, that differ from the defaults
    pose_fit: dict  # PoseFitParams that differ from the defaults
    poses: int  # of clean frames, at least
    injections: int  # of each kind
    outages: int


class Tally(NamedTuple):
    """Results of a Task."""

    poses: int
    refused: int
    tried: Counter  # {kind: injections}
    detected: Counter  # {kind: those that were detected}
    readmissions_s: list  # infinite: locked out
    nees: list  # of (12 states, position, velocity, angles, rates), a vehicle each
    nis: list


def judge(task):
    """Tally of a Task."""
    tape = record(flight_of(task.seed), FILTERS.module(task.filter).Filter.ON_BOARD)
    poses, refused, nees, nis = look_at_clean_frames(tape, task)
    return Tally(poses, refused, *inject(tape, task), let_out(tape, task), nees, nis)


def flight_of(seed):
    """The Flight of a seed: each is another course, fleet and heading."""
    fleet = pathlib.Path(__file__).resolve().parents[2] / "launch" / "fleets" / (FLEETS[seed % len(FLEETS)] + ".yaml")
    heading = {"psi_deg": YAW_BY_SEED_DEG * seed, "fleet": str(fleet)}
    return Flight(COURSES[seed // len(FLEETS) % len(COURSES)], seed=seed, duration_s=FLIGHT_S, gusts=True, **heading)


def new_estimator(tape, task):
    """StatesEstimator of a replay."""
    return tape.estimator(make_filter(task.filter, task.settings), **task.pose_fit)


def taken_of(estimator, n):
    """(n, 2) bool: the filter has taken the position, the attitude; a filter that does not tell takes every pose."""
    present, innovations = estimator.poses.present[:n, None], estimator.innovations()
    return np.repeat(present, 2, axis=1) if innovations is None else innovations.taken[:n] & present


def seed_of(task, purpose, number):
    """SeedSequence of the cameras, or of other random numbers, in the replay of that number."""
    return np.random.SeedSequence(task.seed, spawn_key=(purpose, number))


def errors_of(position_m, angles_rad, truth):
    """(n, 3): position [m], tilt and yaw [rad] off a truth (n, 12)."""
    off = angles_rad - truth[:, S.PHI : S.P]
    off -= 2.0 * math.pi * np.rint(off / (2.0 * math.pi))
    off_m = np.linalg.norm(position_m - truth[:, S.X : S.U], axis=1)
    return np.column_stack((off_m, np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])))


def right_of(estimate, truth):
    """(n,) bool: visible, and not wrong; (n,) bool: visible, but wrong."""
    n = len(truth)
    x, visible = estimate.states[:n], estimate.visible[:n]
    errors = errors_of(x[:, S.X : S.U], x[:, S.PHI : S.P], truth)
    wrong = (errors > (WRONG_M, WRONG_TILT_RAD, WRONG_YAW_RAD)).any(axis=1)
    return visible & ~wrong, visible & wrong


def rows_of(tape):
    """[slice of the markers] of each vehicle."""
    ends = np.cumsum([count for _, count in tape.layout])[: len(tape.names)].tolist()
    return [slice(first, end) for first, end in zip([0, *ends], ends)]


# --- clean frames


def look_at_clean_frames(tape, task):
    """(poses, refused, [NEES], [NIS]): replays until there were enough poses; NEES and NIS at the end of the first."""
    rows, n = rows_of(tape), len(tape.names)
    poses = refused = number = 0
    nees, nis = [], []
    while not number or poses < task.poses:
        estimator, cameras = new_estimator(tape, task), tape.cameras(seed_of(task, _CLEAN, number))
        for k, seen, estimate in replay(tape, estimator, cameras):
            if tape.times_s[k] - tape.times_s[0] < SETTLE_S:
                continue
            enough = np.array([np.isfinite(seen.markers_m[part, 0]).sum() >= 3 for part in rows])
            poses += np.count_nonzero(enough)
            refused += np.count_nonzero(enough & ~taken_of(estimator, n).all(axis=1))
            if number and poses >= task.poses:
                break
            if not number and k == len(tape.times_s) - 1:
                nees, nis = consistency(estimator, estimate, tape.truths[k])
        number += 1
    return poses, refused, nees, nis


def consistency(estimator, estimate, truth):
    """([NEES], [NIS]) of the visible vehicles: squares of errors, of innovations, normalised by their covariances."""
    nees, nis, P, innovations = [], [], estimator.covariances(), estimator.innovations()
    if P is None or innovations is None:
        return nees, nis
    errors = estimate.states[: len(truth)] - truth
    errors[:, S.PHI : S.P] -= 2.0 * math.pi * np.rint(errors[:, S.PHI : S.P] / (2.0 * math.pi))
    for i in np.flatnonzero(estimate.visible[: len(truth)]).tolist():
        parts = [slice(None), *(slice(first, first + 3) for first in BLOCKS.values())]
        nees.append([float(errors[i, part] @ np.linalg.solve(P[i, part, part], errors[i, part])) for part in parts])
        if np.isfinite(innovations.squares[i, 2]):
            nis.append(float(innovations.squares[i, 2]))
    return nees, nis


# --- false frames


def false_frame(kind, tape, seen, i, rng):
    """(Observation, names concerned, largest position error [m] that is not false) of a false frame of vehicle i."""
    names = (tape.names[i],)
    severity, allowed_m = fault_settings(FAULT_OF[kind]).default_severity, 0.5 * WRONG_M
    if kind == "exchange":
        names = tape.names[i], tape.names[(i + 1) % len(tape.names)]
    elif kind == "jump":
        least_m = JUMP_SIGMAS * CameraParams().noise_std_m
        severity = math.exp(rng.uniform(math.log(least_m), math.log(JUMP_MOST_M)))
        allowed_m = min(allowed_m, 0.5 * severity)
    act = FAULTS.module(FAULT_OF[kind]).make(severity, rng, tape.bodies(*names))
    ((_, false),) = act(seen, seen.time_s)
    return false, names, allowed_m


class _FalseFrames:
    """Injects single false frames, kinds and vehicles in turn, so rarely that a vehicle is right again in between."""

    EVERY = round(REST_S / FRAME_S)  # frames, of a vehicle

    def __init__(self, tape, wanted):
        """wanted: number of each kind."""
        self.tried, self.detected = Counter(), Counter()
        self._tape, self._wanted = tape, wanted

    @property
    def are_enough(self):
        return self.tried.total() >= len(FAULT_OF) * self._wanted

    def begin(self, rng):
        """Begin a replay."""
        self._rng, self._turns, self._injected = rng, 0, None
        self._right = np.zeros(len(self._tape.names), dtype=bool)

    def see(self, k, seen):
        """What reaches the estimator in frame k."""
        self._injected, names = None, self._tape.names
        if k < SETTLE_S / FRAME_S or k % (self.EVERY // len(names)) or self.are_enough:
            return seen
        i, kind = self._turns % len(names), list(FAULT_OF)[self.tried.total() % len(FAULT_OF)]
        self._turns += 1
        false, meant, allowed_m = false_frame(kind, self._tape, seen, i, self._rng)
        rows = [names.index(name) for name in meant]
        if not self._right[rows].all():
            return seen
        self._injected = kind, rows, allowed_m
        return false

    def look(self, k, estimator, estimate):
        """Judge what came of frame k."""
        truth = self._tape.truths[k]
        self._right, wrong = right_of(estimate, truth)
        if self._injected is not None:
            kind, rows, allowed_m = self._injected
            self.tried[kind] += 1
            self.detected[kind] += not (wrong | takes_what_is_false(estimator, truth, allowed_m))[rows].any()


def inject(tape, task):
    """(tried, detected), a Counter of kinds each."""
    frames, number = _FalseFrames(tape, task.injections), 0
    while not frames.are_enough:
        before, estimator = frames.tried.total(), new_estimator(tape, task)
        frames.begin(np.random.default_rng(seed_of(task, _FALSE, 2 * number)))
        for k, _, estimate in replay(tape, estimator, tape.cameras(seed_of(task, _FALSE, 2 * number + 1)), frames.see):
            frames.look(k, estimator, estimate)
        number += 1
        if frames.tried.total() == before:
            raise RuntimeError("seed %d: no vehicle was visible and right in a whole flight" % task.seed)
    return frames.tried, frames.detected


def takes_what_is_false(estimator, truth, allowed_m):
    """(n,) bool: the filter has taken a position, or an attitude, that is not the truth's."""
    n, poses = len(truth), estimator.poses
    errors = errors_of(poses.position_m[:n], poses.angles_rad[:n], truth)
    false = errors > (allowed_m, 0.5 * WRONG_TILT_RAD, 0.5 * WRONG_YAW_RAD)
    return (taken_of(estimator, n) & np.column_stack((false[:, 0], false[:, 1:].any(axis=1)))).any(axis=1)


# --- outages


def let_out(tape, task):
    """[s] after each outage until the vehicle was visible and right; infinite: it was locked out."""
    found, number, n, end_s = [], 0, len(tape.names), tape.times_s[-1] - LOCKED_OUT_S - REST_S
    rng = np.random.default_rng(seed_of(task, _OUTAGES, 0))
    lengths_s = np.exp(rng.uniform(*np.log(OUTAGE_S), n))  # of the next outage of each vehicle
    while len(found) < task.outages:
        number, before = number + 1, len(found)
        estimator, cameras = new_estimator(tape, task), tape.cameras(seed_of(task, _OUTAGES, number))
        due_s, until_s, seen_s = np.full(n, tape.times_s[0] + SETTLE_S), np.full(n, math.inf), np.full(n, math.inf)
        for k, _, estimate in replay(tape, estimator, cameras):
            time_s, (right, _) = float(tape.times_s[k]), right_of(estimate, tape.truths[k])
            for i in np.flatnonzero(time_s >= np.where(until_s < math.inf, until_s, due_s)).tolist():
                if until_s[i] == math.inf:
                    if right[i] and time_s + lengths_s[i] < end_s:  # else in the next replay
                        until_s[i] = time_s + lengths_s[i]
                        cameras.hide(tape.names[i], until_s[i])
                        lengths_s[i] = math.exp(rng.uniform(*np.log(OUTAGE_S)))
                    continue
                seen_s[i] = min(seen_s[i], time_s)
                if right[i] or time_s - seen_s[i] > LOCKED_OUT_S:
                    found.append(time_s - seen_s[i] if right[i] else math.inf)
                    due_s[i], until_s[i], seen_s[i] = time_s + REST_S, math.inf, math.inf
        if len(found) == before:
            raise RuntimeError("seed %d: no vehicle was visible and right in a whole flight" % task.seed)
    return found[: task.outages]


# --- all together


def figures_of(tallies, arm):
    """What --json writes. arm: {option: value} of what was judged."""
    poses, refused = sum(tally.poses for tally in tallies), sum(tally.refused for tally in tallies)
    tried, detected = (sum((tally[k] for tally in tallies), Counter()) for k in (2, 3))
    back_s = np.array([after_s for tally in tallies for after_s in tally.readmissions_s])
    p99_s = np.percentile(back_s, 99.0, method="higher") if len(back_s) else math.nan
    nees = np.array([row for tally in tallies for row in tally.nees]).reshape(-1, 1 + len(BLOCKS))
    return {
        "simulated": True,
        **arm,
        "seeds": len(tallies),
        "clean_poses": poses,
        "refused": refused,
        "false_reject_rate": refused / poses,
        "false_reject_upper95": stats.binomtest(refused, poses, alternative="less").proportion_ci(0.95, "exact").high,
        "injections": {kind: tried[kind] for kind in FAULT_OF},
        "detected_first_frame": {kind: detected[kind] / tried[kind] if tried[kind] else None for kind in FAULT_OF},
        "outages": len(back_s),
        "lockouts": int(np.isinf(back_s).sum()),
        "readmission_ms_p99": 1e3 * float(p99_s) if math.isfinite(p99_s) else None,
        "nees": within(nees[:, 0], 12),
        "nees_of": {name: within(nees[:, 1 + k], 3) for k, name in enumerate(BLOCKS)},
        "nis": within([square for tally in tallies for square in tally.nis], 6),
    }


def within(squares, freedom):
    """{mean, low95, high95}: band of the mean of as many chi-square variables. freedom: degrees of freedom of each."""
    count = len(squares)
    if not count:
        return {"mean": None, "low95": None, "high95": None}
    low, high = stats.chi2.ppf((0.025, 0.975), freedom * count) / count
    return {"mean": float(np.mean(squares)), "low95": float(low), "high95": float(high)}


def share(total, seeds, k):
    """The k-th seed's part of a total. seeds: how many there are."""
    return total // seeds + (k < total % seeds)


def settings_of(args):
    """(settings of the filter, PoseFitParams) that the command line changes. Raises ValueError."""
    settings, pose_fit = {}, dict(NO_GATES) if args.gate == "off" else {}
    if args.gate == "off" and "gate_probability" in FILTERS.settings(args.estimator):
        settings["gate_probability"] = 0.0
    for change in args.set:
        key, _, value = change.partition("=")
        try:
            (pose_fit if key in PoseFitParams.__dataclass_fields__ else settings)[key] = float(value)
        except ValueError:
            raise ValueError("--set %s: give KEY=NUMBER" % change) from None
    make_filter(args.estimator, settings)  # checks them
    PoseFitParams(**pose_fit)
    return settings, pose_fit


def main(arguments=None):
    """Print the figures; with --json also write them. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="maap bench gate", description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--frames", type=int, default=400_000, metavar="N", help="clean frames, those of each body counted "
        "(default: 400000; a long run: 10000000)")  # fmt: skip
    add("--injections", type=int, default=3000, metavar="N", help="false frames of each kind (default: 3000; a long "
        "run: 100000)")  # fmt: skip
    add("--outages", type=int, default=1000, metavar="N", help="of a vehicle (default: 1000; a long run: 100000)")
    add("--seeds", type=int, default=24, metavar="N", help="flights (default: 24; a long run: 200)")
    add("--estimator", choices=FILTERS.names(), default="ekf", metavar="NAME", help="filter: %s (default: ekf)"
        % ", ".join(FILTERS.names()))  # fmt: skip
    add("--gate", choices=("on", "off"), default="on", help="off: every pose that can be fitted is taken")
    add("--set", action="append", default=[], metavar="KEY=NUMBER", help="another setting of the filter or of the pose "
        "fit (`PoseFitParams`), e.g. gate_probability=1e-2; may be given again")  # fmt: skip
    add("--workers", type=int, metavar="N", help="flights at the same time (default: a core each)")
    add("--json", type=argparse.FileType("w"), metavar="FILE", help="also write the figures here")
    args = parser.parse_args(arguments)
    if min(args.frames, args.seeds) < 1 or min(args.injections, args.outages) < 0:
        parser.error("--frames and --seeds are 1 or more, --injections and --outages 0 or more")
    arm = {key: getattr(args, key) for key in ("estimator", "gate", "set")}
    wanted = args.frames, args.injections, args.outages
    progress = Progress()
    try:
        how = args.estimator, *settings_of(args)
        tasks = [Task(k + 1, *how, *(share(total, args.seeds, k) for total in wanted)) for k in range(args.seeds)]
        tallies = in_order(judge, tasks, args.workers, lambda over: progress.show("seeds", bar(over / args.seeds)))
        figures = figures_of(list(tallies), arm)
    except ValueError as error:
        parser.error(str(error))
    except (RuntimeError, ChildProcessError, KeyboardInterrupt) as error:
        progress.say("gate: %s" % (error if str(error) else "interrupted"))
        return 130 if isinstance(error, KeyboardInterrupt) else 1
    progress.clear()
    show(figures)
    if args.json:
        with args.json:
            json.dump(figures, args.json, indent=2)
    return 0


def show(figures):
    """Print a table."""
    arm = ", ".join([figures["estimator"], "gate " + figures["gate"], *figures["set"]])
    print("%s, %d seeds, simulated" % (arm, figures["seeds"]))
    rate = figures["false_reject_rate"], figures["false_reject_upper95"], figures["refused"], figures["clean_poses"]
    print("clean poses refused     %.1e (at most %.1e with 95 %%; %d of %d)" % rate)
    for kind, found in figures["detected_first_frame"].items():
        if found is not None:
            print("%-9s in 1st frame  %8.3f %% of %d" % (kind, 100.0 * found, figures["injections"][kind]))
    p99_ms = figures["readmission_ms_p99"]
    p99 = "" if p99_ms is None else ", visible and right again after %.0f ms (p99)" % p99_ms
    print("outages                 %d lock-outs of %d%s" % (figures["lockouts"], figures["outages"], p99))
    blocks = {"NEES of %s" % name: band for name, band in figures["nees_of"].items()}
    for name, band in {"NEES": figures["nees"], **blocks, "NIS": figures["nis"]}.items():
        if band["mean"] is not None:
            outside = "" if band["low95"] <= band["mean"] <= band["high95"] else ", outside"
            print("%-23s %6.2f (95 %%: %.2f to %.2f%s)" % (name, band["mean"], band["low95"], band["high95"], outside))


if __name__ == "__main__":
    sys.exit(main())
