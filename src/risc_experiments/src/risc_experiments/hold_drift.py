"""How far a vehicle drifts when it is not seen any more and has to hold its place: whole flights without ROS.

    python3 -m risc_experiments.hold_drift --types ardrone iris --seeds 20

Each flight has one vehicle with a perturbed plant. At a time on its course that the seed chooses, it loses its states
for good. The drift is the largest distance, within the next 2 s, from its true position when HOLD began; it includes
the effect of the speed at the loss. The landing, by default after 0.5 s, is disabled: the drift is that of the hold.
"""

import argparse
import math
import sys
from typing import NamedTuple

import numpy as np

from data_extraction.progress import Progress, bar
from risc_control.safety import FailsafeLevel
from risc_control.trajectories import COURSES, make_course
from risc_control.vehicles import REGISTRY
from risc_experiments.offline import YAW_BY_SEED_DEG, Flight, Loss, fly_all

WITHIN_S = 2.0
MOVING = ["circle", "circles3", "flat8", "knot", "slanted8"]  # courses without standstill
_REST_S, _NEVER_S = 3.0, 3600.0
_GOLDEN = 0.6180339887498949  # spreads the loss times evenly over the course, for any number of seeds


class Drift(NamedTuple):
    """Figures of one flight; all NaN when it ended in the net."""

    speed_m_s: float  # when HOLD began
    farthest_m: float  # within WITHIN_S
    level_m: float  # the same, horizontal part only
    height_m: float  # the same, vertical part only
    end_m: float  # at the end of WITHIN_S


def flight(type_name, course, seed, **options):
    """Flight whose vehicle is lost at a time on its course. options: other fields of a Flight."""
    after_s = seed * _GOLDEN % 1.0 * make_course(course, 1).period_s
    node = {"state_land_s": _NEVER_S, **options.pop("node", {})}
    given = {"vehicles": 1, "types": (type_name,), "psi_deg": YAW_BY_SEED_DEG * seed, **options}
    return Flight(course, seed=seed, duration_s=after_s + _REST_S, node=node, loss=Loss(0, "state", after_s), **given)


def drift(result):
    """Drift of the first vehicle of an `offline.Result`, or of the RuntimeError that it ended with."""
    if isinstance(result, RuntimeError):
        return Drift(*[math.nan] * len(Drift._fields))
    times_s, place_m = result.times_s, result.actual_m[:, 0]
    began_s = next(said.time_s for said in result.levels if said.level is FailsafeLevel.HOLD)
    went_m = place_m - [np.interp(began_s, times_s, axis) for axis in place_m.T]
    after = np.flatnonzero((times_s >= began_s) & (times_s <= began_s + WITHIN_S))
    before = after[0] - 1
    speed_m_s = math.dist(place_m[after[0]], place_m[before]) / (times_s[after[0]] - times_s[before])
    far_m, level_m = np.linalg.norm(went_m[after], axis=1), np.linalg.norm(went_m[after, :2], axis=1)
    return Drift(speed_m_s, far_m.max(), level_m.max(), np.abs(went_m[after, 2]).max(), far_m[-1])


def main(argv=None):
    """Print a table of drifts. Returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python3 -m risc_experiments.hold_drift",
        description="How far a vehicle goes within %g s after it was seen last and began to hold, offline." % WITHIN_S,
    )
    add = parser.add_argument
    add("--types", nargs="+", default=REGISTRY.names(), metavar="TYPE", help="of vehicles (default: all)")
    add("--trajectory", nargs="+", choices=sorted(COURSES), default=MOVING)
    add("--seeds", type=int, default=20, metavar="N", help="seeds 1 to N (default: 20)")
    add("--gusts", action="store_true", help="moving air")
    add("--delay", type=float, metavar="S", dest="delay_s", help="link delay (default: that of the type)")
    add("--coast", action="store_true", help="only level it, without braking")
    add("--alone", action="store_true", help="by its model alone, without what it learnt and its own tilt and height")
    add("--no-auto-hover", action="store_true", help="nor let it hold by itself (hold_auto_hover: false)")
    add("--workers", type=int, metavar="N", help="flights at the same time (default: a core each)")
    args = parser.parse_args(argv)
    node = {
        "hold_brakes": not args.coast,
        "hold_corrects": not args.alone,
        "hold_auto_hover": not args.no_auto_hover,
    }
    groups = [(kind, course) for kind in args.types for course in args.trajectory]
    flights = [
        flight(*group, seed, gusts=args.gusts, delay_s=args.delay_s, node=node)
        for group in groups
        for seed in range(1, args.seeds + 1)
    ]
    progress, drifts = Progress(), []
    columns = "farthest within %g s [m]" % WITHIN_S, "level", "height", "at the end"
    print("%-8s %-9s %10s   %-22s   %-20s   %-20s   %s" % ("type", "course", "speed", *columns))
    print("%-8s %-9s %10s%s   median" % ("", "", "[m/s]", 3 * ("   %6s %6s %6s" % ("median", "90 %", "worst"))))
    try:
        outcomes = fly_all(flights, args.workers, lambda over: progress.show("flying", bar(over / len(flights))))
        for over, result in enumerate(outcomes, 1):
            drifts.append(drift(result))
            if over % args.seeds == 0:
                progress.clear()
                print("%-8s %-9s %s" % (*groups[over // args.seeds - 1], _text(drifts[-args.seeds :])), flush=True)
            if over % (of_type := args.seeds * len(args.trajectory)) == 0:
                print("%-8s %-9s %s" % (groups[over // args.seeds - 1][0], "all", _text(drifts[-of_type:])), flush=True)
    except ValueError as error:
        parser.error(str(error))
    except (ChildProcessError, KeyboardInterrupt) as error:
        progress.say("hold_drift: %s" % (error if str(error) else "interrupted"))
        return 130 if isinstance(error, KeyboardInterrupt) else 1
    return 0


def _text(drifts):
    """A row of the table."""
    values = np.array(drifts)
    netted = np.isnan(values[:, 0])
    values[netted, 1:] = math.inf  # a vehicle in the net counts as infinitely far
    speed_m_s = np.nanmedian(values[:, 0]) if not netted.all() else math.nan
    text = "%10.2f" % speed_m_s
    for drift_m in values[:, 1:4].T:
        row = np.median(drift_m), np.quantile(drift_m, 0.9, method="nearest"), drift_m.max()
        text += "   %6.2f %6.2f %6.2f" % row
    text += "   %6.2f" % np.median(values[:, 4])
    return text + (", %d in the net" % netted.sum() if netted.any() else "")


if __name__ == "__main__":
    sys.exit(main())
