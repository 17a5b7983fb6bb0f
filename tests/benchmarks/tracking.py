"""How accurately courses are flown, beside the least error that any controller could have: `./maap bench tracking`.

Simulated, offline: three AR.Drones with the default controller, every seed with another heading. `--gust A`: moving air
gives each vehicle an acceleration of A m/s^2 (1 sigma along each axis, correlation time 0.5 s). `--loss P`, `--swap P`:
in each frame, with this probability, the frame is lost, or two markers of a vehicle exchange their labels.
`--jitter S`: each frame is late by a random time of up to S. Gusts are not part of a perturbed plant.

Without gusts each course has limits (`most_m`): 5 mm of RMSE in the median of all vehicles, 12 mm for 95 % and 20 mm
for all of them; 8 mm in the median with lost, late or swapped frames, 10 mm with a delay of more than 0.1 s.

limit_m is that of `h2_limit.py`: a controller that knows the nominal plant, the delay, the noise of a pose
and the spectrum of the gusts, and loses no frame. It is 0 without gusts. Its commands may be of any size; for
limit_in_scale_m, three times their RMS is within the full scale of the type. Both have almost no margins; `trade` gives
the cost of margins: the least RMSE of such controllers, with two tuning parameters, for each largest |S|. `--plot`
draws it, and the controller that was flown beside it, with the max|S| that `loop_margins.py` finds.
"""

import argparse
import json
import math
import pathlib
import sys
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
from h2_limit import gust_limit_m, trade

from data_extraction.plots import COLOURS
from data_extraction.progress import Progress, bar
from risc_control.controllers import REGISTRY as CONTROLLERS
from risc_estimation.pose_fit import PoseFit, PoseFitParams
from risc_experiments import loop_margins
from risc_experiments.estimators import add_option, estimator_of
from risc_experiments.offline import YAW_BY_SEED_DEG, Flight, fly_all, lab_of
from risc_experiments.offline_chain import FRAME_S, LATENCY_S
from risc_lab.frames import rotation_body_to_cortex
from risc_lab.lab import load_templates
from risc_simulator.faults import EVERYONE, FaultEvent
from risc_simulator.models.gusts import Gusts
from risc_simulator.models.mocap_cameras import CameraParams

COURSES = "circle", "flat8", "slanted8"
GUST_TIME_S = 0.5
SIGMAS_IN_SCALE = 3.0
CALM_MOST_M = {"rmse_median_m": 0.005, "rmse_p95_m": 0.012, "rmse_worst_m": 0.020}
FRAMES_MOST_M, LATE_MOST_M = {"rmse_median_m": 0.008}, {"rmse_median_m": 0.010}
HARDEST = {"gust": 0.0, "delay": 0.3, "loss": 0.05, "swap": 0.01, "jitter": 0.02}  # up to these, there are limits


def flight_of(args):
    """The Flight that all others are variants of. args: of the command line."""
    lasting = {"duration_s": math.inf}
    faults = [FaultEvent("loss", severity=args.loss, **lasting)] if args.loss else []
    faults += [FaultEvent("jitter", severity=args.jitter, **lasting)] if args.jitter else []
    faults += [FaultEvent("marker_swap", EVERYONE, severity=args.swap, **lasting)] if args.swap else []
    return Flight(
        duration_s=args.duration,
        delay_s=args.delay,
        perturbed=args.plant == "perturbed",
        gusts=Gusts(push_m_s2=args.gust, time_s=GUST_TIME_S) if args.gust else False,
        controller=args.controller,
        estimator=args.estimator,
        wire_faults=tuple(faults),
    )


def limits_of(flight, gust_m_s2):
    """{limit_m, limit_in_scale_m, trade} of the first vehicle of a Flight in gusts, with the plant of its type."""
    fleet, _, (vehicle_type, *_) = lab_of(flight)
    covariance = pose_covariance(load_templates(fleet=fleet)[fleet.vehicles[0].template])
    case = vehicle_type, covariance, gust_m_s2, GUST_TIME_S, LATENCY_S, FRAME_S
    return {
        "limit_m": gust_limit_m(*case),
        "limit_in_scale_m": gust_limit_m(*case, sigmas=SIGMAS_IN_SCALE),
        "trade": [{"max_s": most, "rmse_m": rmse} for most, rmse in trade(*case) if rmse < math.inf]
        if gust_m_s2
        else [],
    }


def own_max_s(flight):
    """Largest |S| of roll and pitch of the loop that flies a Flight, here with a nominal plant."""
    hovering = replace(flight, perturbed=False, gusts=False, wire_faults=())
    answers = loop_margins.responses(hovering).T
    return max(loop_margins.margins(loop_margins.sensitivity(answer)).max_s for answer in answers[:2])


def draw_trade(path, limits, flown, max_s, title):
    """Draw the cost of margins. flown: {name: RMSE [m]} of courses by the controller, which has this max|S|."""
    figure, axes = plt.subplots(figsize=(7.0, 4.5), layout="constrained")
    points = [(point["max_s"], 1e3 * point["rmse_m"]) for point in limits["trade"]]
    axes.plot(*zip(*points), "o-", color=COLOURS[0], label="knows plant, delay, noise and gusts; max|S| bounded")
    for key, style, label in ("limit_m", ":", "any commands"), ("limit_in_scale_m", "--", "commands in the full scale"):
        axes.axhline(1e3 * limits[key], color=COLOURS[5], ls=style, label="H2 limit, %s" % label)
    for name, colour in zip(flown, COLOURS[1:]):
        axes.plot(max_s, 1e3 * flown[name], "D", color=colour, label="flown: %s" % name)
    axes.axvline(2.0, color="0.7", lw=1.0)
    axes.set(xlabel="largest |S|", ylabel="position RMSE [mm]", title=title, ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def pose_covariance(template):
    """(6, 6) of the pose of a vehicle that is level and heads along x, with the noise of the cameras."""
    fit = PoseFit({template.name: template}, PoseFitParams(marker_noise_m=CameraParams().noise_std_m))
    markers_m = np.array([0.0, 0.0, 1.0]) + template.markers_m @ rotation_body_to_cortex(0.0, 0.0, 0.0).T
    fit.update(0.0, ((template.name, len(markers_m)),), markers_m)
    return fit.poses.covariances()[0]


def accuracy_of(results):
    """Figures of flights; p95 and worst are None when one of them did not come to its end."""
    flown = [result for result in results if not isinstance(result, RuntimeError) and not any(result.landed)]
    errors_m, failed = [error_m for result in flown for error_m in result.rmse_m.tolist()], len(results) - len(flown)
    return {
        "rmse_median_m": float(np.median(errors_m)) if flown else None,
        "rmse_p95_m": None if failed else float(np.percentile(errors_m, 95.0)),
        "rmse_worst_m": None if failed else max(errors_m),
        "vehicles": len(errors_m),
        "failed": failed,
    }


def most_m(args):
    """{figure: its limit [m]}; {} for conditions harder than HARDEST."""
    if any(getattr(args, option) > most for option, most in HARDEST.items()):
        return {}
    if args.delay > 0.1:
        return LATE_MOST_M
    return FRAMES_MOST_M if args.loss or args.swap or args.jitter else CALM_MOST_M


def is_met(row):
    """Whether all flights of a row have come to their end, with no larger errors than its `most_m`."""
    return not row["failed"] and all(row[figure] <= most for figure, most in row["most_m"].items())


def main(arguments=None):
    """Print a table; with --json also write it. Returns 1 when a limit is missed, or a flight did not finish."""
    parser = argparse.ArgumentParser(prog="maap bench tracking", description=__doc__.splitlines()[0])
    add = parser.add_argument
    add("--plant", choices=("nominal", "perturbed"), default="perturbed", help="vehicles as their type is, or drawn "
        "around it (default)")  # fmt: skip
    add("--delay", type=float, default=0.1, metavar="S", help="of the link (default: 0.1)")
    add("--gust", type=float, default=0.0, metavar="A", help="1 sigma of what gusts do [m/s^2] (default: 0)")
    add("--loss", type=float, default=0.0, metavar="P", help="probability of a frame to be lost (default: 0)")
    add("--swap", type=float, default=0.0, metavar="P", help="of two markers, of each vehicle in each frame, to have "
        "each other's label (default: 0)")  # fmt: skip
    add("--jitter", type=float, default=0.0, metavar="S", help="most that a frame is late by chance [s] (default: 0)")
    add("--seeds", type=int, default=10, metavar="N", help="seeds 1 to N (default: 10)")
    add("--duration", type=float, default=20.0, metavar="S", help="judged time of each flight (default: 20 s)")
    add("--controller", choices=CONTROLLERS.names(), default=Flight.controller)
    add_option(add)
    add("--workers", type=int, metavar="N", help="flights at the same time (default: a core each)")
    add("--json", type=argparse.FileType("w"), metavar="FILE", help="also write the figures here")
    add("--plot", type=pathlib.Path, metavar="FILE", help="with --gust: draw what margins cost (.png, .pdf)")
    args = parser.parse_args(arguments)
    progress = Progress()
    try:
        if args.seeds < 1 or not args.duration > 0.0 or args.gust < 0.0:
            raise ValueError("--seeds is 1 or more, --duration more than 0, --gust 0 or more")
        if args.plot and not args.gust:
            raise ValueError("--plot draws what margins cost in gusts: it needs --gust")
        flight, rows = flight_of(args), []
        limits = limits_of(flight, args.gust)
        seeds = [replace(flight, seed=seed, psi_deg=YAW_BY_SEED_DEG * seed) for seed in range(1, args.seeds + 1)]
        flights = [replace(one, trajectory=course) for course in COURSES for one in seeds]
        outcomes = fly_all(flights, args.workers, lambda over: progress.show("flying", bar(over / len(flights))))
        print("%-9s %9s %9s %9s %9s %12s" % ("course", "median", "p95", "worst", "H2 limit", "in scale"))
        for course in COURSES:
            accuracy = accuracy_of([next(outcomes) for _ in seeds])
            bounds = {key: limits[key] for key in ("limit_m", "limit_in_scale_m")}
            rows.append({"course": course, **accuracy, **bounds, "most_m": most_m(args)})
            progress.clear()
            show(rows[-1])
        for point in limits["trade"]:
            print("limit with max|S| up to %.1f: %5.1f mm" % (point["max_s"], 1e3 * point["rmse_m"]))
    except ValueError as error:
        parser.error(str(error))
    except (ChildProcessError, KeyboardInterrupt) as error:
        progress.say("tracking: %s" % (error if str(error) else "interrupted"))
        return 130 if isinstance(error, KeyboardInterrupt) else 1
    if args.json:
        figures = {"simulated": True, "estimator": estimator_of(args.controller, args.estimator)}
        options = ("plant", "delay", "gust", "loss", "swap", "jitter", "seeds", "duration", "controller")
        figures |= {name: getattr(args, name) for name in options}
        with args.json:
            json.dump({**figures, "rows": rows, "trade": limits["trade"]}, args.json, indent=2)
    if args.plot:
        flown = {row["course"]: row["rmse_median_m"] for row in rows if row["rmse_median_m"] is not None}
        title = "Gusts of %g m/s$^2$, link delay %g s, %s plant" % (args.gust, args.delay, args.plant)
        try:
            draw_trade(args.plot, limits, flown, own_max_s(flight), title)
        except (RuntimeError, OSError) as error:
            progress.say("tracking: no picture: %s" % error)
            return 1
    return 0 if all(map(is_met, rows)) else 1


def show(row):
    """Print a row."""
    numbers = ["%6.1f mm" % (1e3 * row[key]) if row[key] is not None else "-" for key in
               ("rmse_median_m", "rmse_p95_m", "rmse_worst_m", "limit_m", "limit_in_scale_m")]  # fmt: skip
    failed = "  %d flights did not come to their end" % row["failed"] if row["failed"] else ""
    missed = (
        ""
        if is_met(row) or failed
        else "  missed: at most %s mm" % ", ".join("%g" % (1e3 * most) for most in row["most_m"].values())
    )
    print("%-9s %9s %9s %9s %9s %12s%s" % (row["course"], *numbers, failed + missed), flush=True)


if __name__ == "__main__":
    sys.exit(main())
