"""How accurately the default controller flies plants that it does not know: `./maap bench plants`.

Simulated, offline: three AR.Drones, every seed with another heading, whose plant is that of their type except for what
the row says. The controller assumes a link delay of 0.1 s. `loops` are those of roll and pitch.

With one change of 30 % of the attitude loops, of 50 ms, or of 10 % of mass or thrust, the RMSE of each vehicle of each
seed may be at most 15 mm; with several together, 50 mm. Returns 1 when one is larger, or a flight does not finish.
"""

import argparse
import json
import sys
from dataclasses import replace

from tracking import COURSES, accuracy_of

from data_extraction.progress import Progress, bar
from risc_experiments.estimators import add_option
from risc_experiments.offline import YAW_BY_SEED_DEG, Flight, fly_all
from risc_lab.lab import load_vehicle_type
from risc_simulator.models.perturbed_plant import nominal_plant

TYPE = "ardrone"
DELAY_S = 0.1
ONE_MM, SEVERAL_MM = 15.0, 50.0


def changes():
    """{name: (PlantParams that differ, most RMSE [mm])}."""
    nominal = nominal_plant(load_vehicle_type(TYPE))

    def loops(name, scale):
        return {axis: scaled(getattr(nominal, axis), name, scale) for axis in ("roll", "pitch")}

    def later(by_s):
        return {"command_delay_s": DELAY_S + by_s}

    def times(name, scale):
        return {name: scale * getattr(nominal, name)}

    slow = loops("natural_frequency_rad_s", 0.7)
    one = {"as the type": {}}
    for text, name in (("loops", "natural_frequency_rad_s"), ("damping", "damping_ratio"), ("tilt gain", "gain")):
        one |= {"%s x %.1f" % (text, scale): loops(name, scale) for scale in (0.7, 1.3)}
    one |= {"link %+.0f ms" % (1e3 * by_s): later(by_s) for by_s in (-0.05, 0.05)}
    for text, name in (("mass", "mass_kg"), ("thrust", "thrust_scale")):
        one |= {"%s x %.1f" % (text, scale): times(name, scale) for scale in (0.9, 1.1)}
    several = {
        "loops x 0.7, link +40 ms": slow | later(0.04),
        "loops x 0.7, link +50 ms, mass x 1.1": slow | later(0.05) | times("mass_kg", 1.1),
    }
    return {name: (plant, ONE_MM if name in one else SEVERAL_MM) for name, plant in (one | several).items()}


def scaled(loop, name, scale):
    """An AttitudeLoop with a number of it scaled."""
    return replace(loop, **{name: scale * getattr(loop, name)})


def row_of(name, limit_mm, results):
    """Figures of a change. results: {course: of its flights}."""
    row = {"plant": name, "limit_mm": limit_mm, **{course: accuracy_of(flown) for course, flown in results.items()}}
    worst_m = [row[course]["rmse_worst_m"] for course in results]
    return {**row, "ok": all(error_m is not None and 1e3 * error_m <= limit_mm for error_m in worst_m)}


def main(arguments=None):
    """Print a table; with --json also write it."""
    parser = argparse.ArgumentParser(prog="maap bench plants", description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--seeds", type=int, default=9, metavar="N", help="seeds 1 to N (default: 9)")
    add("--duration", type=float, default=20.0, metavar="S", help="judged time of each flight (default: 20 s)")
    add_option(add)
    add("--workers", type=int, metavar="N", help="flights at the same time (default: a core each)")
    add("--json", type=argparse.FileType("w"), metavar="FILE", help="also write the figures here")
    args = parser.parse_args(arguments)
    if args.seeds < 1 or not args.duration > 0.0:
        parser.error("--seeds is 1 or more, --duration more than 0")
    plants, seeds, progress, rows = changes(), range(1, args.seeds + 1), Progress(), []
    base = Flight(
        types=(TYPE,) * 3, delay_s=DELAY_S, duration_s=args.duration, perturbed=False, estimator=args.estimator
    )
    flights = [
        replace(base, trajectory=course, seed=seed, psi_deg=YAW_BY_SEED_DEG * seed, plant=plant)
        for plant, _ in plants.values() for course in COURSES for seed in seeds
    ]  # fmt: skip
    outcomes = fly_all(flights, args.workers, lambda over: progress.show("flying", bar(over / len(flights))))
    print("%-38s" % "median, worst RMSE [mm]" + "".join("%16s" % course for course in COURSES) + "%8s" % "limit")
    for name, (_, limit_mm) in plants.items():
        rows.append(row_of(name, limit_mm, {course: [next(outcomes) for _ in seeds] for course in COURSES}))
        progress.clear()
        show(rows[-1])
    if args.json:
        with args.json:
            json.dump({"simulated": True, "seeds": args.seeds, "rows": rows}, args.json, indent=2)
    return 0 if all(row["ok"] for row in rows) else 1


def show(row):
    """Print a row."""
    both = [[row[course][key] for key in ("rmse_median_m", "rmse_worst_m")] for course in COURSES]
    cells = [", ".join("-" if error_m is None else "%.1f" % (1e3 * error_m) for error_m in pair) for pair in both]
    text = "%-38s" % row["plant"] + "".join("%16s" % cell for cell in cells) + "%8.0f" % row["limit_mm"]
    print(text + ("" if row["ok"] else "  missed"), flush=True)


if __name__ == "__main__":
    sys.exit(main())
