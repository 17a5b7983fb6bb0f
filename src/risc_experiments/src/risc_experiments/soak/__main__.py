"""`./maap soak HOURS`: the graph flies for hours, with random faults, and is watched for what drifts or breaks."""

import argparse
import math
import pathlib
import shlex
import sys
import threading
from dataclasses import replace

from data_extraction.progress import Progress
from risc_experiments import fly
from risc_experiments.estimators import add_option
from risc_experiments.option_types import name_list
from risc_experiments.scorecard import plan
from risc_experiments.soak import output, script, table
from risc_experiments.soak.run import Soak
from risc_experiments.soak.settings import load_params

LONGEST_H = 1000.0


def arguments(argv):
    """(argparse namespace, its parser) of a command line."""
    parser = argparse.ArgumentParser(
        prog="maap soak",
        description="Let one graph fly in the virtual lab for hours: take off, fly a course with random faults, land, "
        "again and again. It ends at the first violated invariant, with all that is needed to repeat it (exit code 1).",
    )
    add = parser.add_argument
    add("hours", nargs="?", type=fly.number(1e-3, LONGEST_H), metavar="HOURS", help="how long, e.g. 0.1")
    add("--seed", type=fly.number(0), default=1, metavar="N", help="of the vehicles and of all faults (default: 1)")
    add("--faults", type=name_list, default=(), metavar="A,B", help="only these of ./maap faults (default: all that a "
        "flight can end safely with)")  # fmt: skip
    add("--vehicles", type=fly.number(1), metavar="N", help="how many (default: 3)")
    add("--trajectory", choices=sorted(fly.COURSES), help="course to fly (default: circles3)")
    add("--duration", type=fly.number(5.0, 600.0), metavar="S", help="of each flight on the course (default: 40 s)")
    add("--controller", metavar="NAME", help="as for ./maap fly")
    add_option(add)
    add("--mocap-rate", type=fly.number(fly.RATES_HZ[-1], 500.0), metavar="HZ", help="of motion capture (default: 200, "
        "less if it must be)")  # fmt: skip
    add("--gusts", action="store_true", help="with gusts of wind")
    add("--fleet", type=pathlib.Path, metavar="YAML", help="fleet file")
    add("--settings", type=pathlib.Path, metavar="YAML", help="in place of config/soak.yaml: limits and periods")
    add("--out", type=pathlib.Path, metavar="DIR", help="folder for the results (default: flights/DATE_soak)")
    add("--table", type=pathlib.Path, nargs="+", metavar="DIR", help="do not fly: print what became of the faults of "
        "these soaks, a line for each fault")  # fmt: skip
    args = parser.parse_args(argv)
    if (args.hours is None) == (args.table is None):
        parser.error("say how many HOURS, e.g. ./maap soak 0.1, or --table DIR")
    args.command = "./maap soak " + shlex.join(argv)
    return args, parser


def flight_of(args, params, error):
    """Options of the flights, as those of ./maap fly. error: see `fly.complete`."""
    flight = fly.options().parse_args([])
    for name in ("seed", "vehicles", "trajectory", "controller", "estimator", "mocap_rate", "gusts", "fleet"):
        setattr(flight, name, getattr(args, name))
    flight.duration = params.duration_s
    fly.complete(flight, error)
    return flight


def main(argv=None):
    """Command line. Returns the exit code: 0 when all invariants held to the end, 130 when it was interrupted."""
    argv = sys.argv[1:] if argv is None else argv
    args, parser = arguments(argv)
    progress, interrupted = Progress(plain_period_s=math.inf), threading.Event()
    try:
        if args.table is not None:
            faults = [fault for folder in args.table for fault in table.read(folder)]
            print("\n".join(table.faults_table(faults)))
            return 0
        params = load_params(args.settings)
        if args.duration is not None:
            params = replace(params, duration_s=args.duration)
        deck = script.deck_of(args.faults, params, plan.load_params())
        script.check(deck, params.duration_s)
        flight = flight_of(args, params, parser.error)
        folder = fly.prepare_folder(args, "soak", table.RECORD)
    except (fly.FlightError, ValueError, OSError) as error:
        parser.error(str(error))
    fly.handle_signals(lambda *_: interrupted.set())
    progress.say(
        "soak of %g h, seed %d, %d kinds of faults; results in %s"
        % (args.hours, args.seed, len(deck.names) + len(deck.of_programs), folder)
    )
    soak = Soak(args, flight, params, deck, folder, progress, interrupted)
    try:
        soak.carry_out()
        if soak.too_slow:
            soak.forget()
            words = [*argv, "--out", folder]
            problem = fly.fly_slower("risc_experiments.soak", words, folder, soak.too_slow, progress, interrupted)
            raise fly.FlightError(problem)
    except (fly.FlightError, ValueError, OSError, RuntimeError) as error:
        progress.say("maap soak: %s" % error)
        if soak.began_s is None:
            return 1
        raise
    result = output.write_all(soak)
    progress.clear()
    print(output.markdown(result))
    print("all of it: %s" % (soak.folder / "soak.html"))
    return 1 if soak.violation is not None else 130 if soak.interrupted else 0


if __name__ == "__main__":
    sys.exit(main())
