"""`./maap screenshot`: pictures of an experiment or of a bag as rviz shows it, without a screen."""

import argparse
import pathlib
import signal
import sys
import threading

from data_extraction.bags import Bag
from data_extraction.progress import Progress
from risc_experiments import fly
from risc_experiments.option_types import name_list
from risc_lab.lab import load_fleet
from risc_visual.pictures.rviz_pictures import VIEWS, moment_of, standard_views, take_pictures, views_from
from risc_visual.pictures.virtual_screen import ScreenError, missing_programs

FLIGHT_S = 20.0  # on the course, unless the caller says otherwise: long enough to see it


def arguments(argv):
    """Command line -> (argparse namespace, what is left: arguments of `fly`)."""
    parser = argparse.ArgumentParser(
        prog="maap screenshot",
        description="Pictures of an experiment or of a bag as rviz shows it; needs no screen.",
        epilog="The options of ./maap fly may follow the name of an experiment: screenshot circles3 --trajectory flat8",
        allow_abbrev=False,
    )
    add = parser.add_argument
    add("what", metavar="EXPERIMENT|BAG", help="%s, or a bag" % ", ".join(fly.EXPERIMENTS))
    add(
        "--at",
        type=float,
        metavar="S",
        help="time in the bag (default: late on the course; with bearings, when most landmarks are seen)",
    )
    views_help = "%s, or FILE.rviz[:SAVED VIEW] (default: all that the bag has something for)" % ", ".join(VIEWS)
    add("--views", type=name_list, metavar="A,B", help=views_help)
    add("--size", type=_size, default=(1280, 900), metavar="WxH", help="in pixels (default: 1280x900)")
    add("--light", action="store_true", help="on white, for print (default: on black)")
    add("--fleet", type=pathlib.Path, metavar="YAML", help="fleet of the bag (default: fleet.yaml beside it)")
    add("--out", type=pathlib.Path, metavar="DIR", help="folder for the pictures (default: beside the bag)")
    args, rest = parser.parse_known_args(argv)
    if args.what not in fly.EXPERIMENTS:
        if not args.what.endswith(".bag"):
            parser.error("'%s' is neither a bag (*.bag) nor one of %s" % (args.what, ", ".join(fly.EXPERIMENTS)))
        if rest:
            parser.error("a bag has been flown already: leave out %s" % " ".join(rest))
    if args.at is not None and not args.at > 0.0:
        parser.error("--at must be a time after the start of the bag [s]")
    return args, rest


def _size(text):
    width, _, height = text.partition("x")
    size = int(width), int(height)
    if not all(100 <= side <= 4000 for side in size):
        raise ValueError("from 100x100 to 4000x4000")
    return size


def flown(args, rest, progress, argv):
    """Fly the experiment. Returns the folder with its bag. Raises FlightError when there is none.

    argv: the whole command line, to start over with on a computer that is too slow.
    """
    fleet = ["--fleet", str(args.fleet)] if args.fleet else []
    flight = fly.arguments([args.what, "--duration", "%g" % FLIGHT_S, *fleet, *rest])  # the caller's options override
    folder = fly.prepare_folder(flight)
    progress.say("flying %s first, results in %s" % (args.what, folder))
    interrupted = threading.Event()
    fly.handle_signals(lambda *_: interrupted.set())  # then the vehicles land
    try:
        result = fly.fly(flight, folder, progress, interrupted)
        if isinstance(result, fly.TooSlow):
            result = fly.fly_slower("risc_experiments.screenshot", argv, folder, result, progress, interrupted)
    finally:
        fly.handle_signals(signal.default_int_handler)
    if result:
        raise fly.FlightError(
            "no pictures of a flight that failed: %s (./maap screenshot %s/flight.bag makes them all the same)"
            % (result, folder)
        )
    return folder


def main(argv=None):
    """Command line. Returns the exit code: 0 when every picture was taken."""
    argv = sys.argv[1:] if argv is None else argv
    args, rest = arguments(argv)
    progress = Progress()
    try:
        fly.handle_signals(signal.default_int_handler)
        missing = missing_programs("rviz")
        if missing:
            raise ScreenError(
                "%s not installed: './maap screenshot' installs what pictures need" % " and ".join(missing)
            )
        experiment = args.what if args.what in fly.EXPERIMENTS else ""
        if args.views:
            views_from(args.views, args.size)  # reports wrong names before anything flies
        bag_path = flown(args, rest, progress, argv) / "flight.bag" if experiment else pathlib.Path(args.what)
        fleet = bag_path.parent / "fleet.yaml"
        fleet = args.fleet if args.fleet and not experiment else fleet if fleet.exists() else None
        arena = load_fleet(fleet).arena if fleet else None  # an error in it is one line here, a dead node later
        with Bag(bag_path) as bag:
            at_s = moment_of(bag) if args.at is None else args.at
            names = args.views or standard_views(bag, fleet)
        out = args.out or bag_path.parent / "screenshots"
        views = views_from(names, args.size, args.light, arena)
        for path in take_pictures(bag_path, views, at_s, out, fleet, experiment, progress):
            print(path)
    except KeyboardInterrupt:
        progress.say("interrupted")
        return 1
    except (fly.FlightError, ValueError, OSError, RuntimeError) as error:
        progress.say("maap screenshot: %s" % error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
