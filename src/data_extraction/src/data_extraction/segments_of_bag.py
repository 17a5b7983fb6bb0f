"""The course's plots from a bag: `rosrun risc_visual DF_Plots.py BAG`. Needs no ROS master."""

import argparse
import pathlib
import sys

from data_extraction.bags import Bag, BagError
from data_extraction.flatten import seconds
from data_extraction.report.kinds import fits
from data_extraction.segment_pages import PageWriter
from data_extraction.segments import PlotParams, Recorder
from risc_lab.lab import load_fleet

NEEDED = ("/cortex_raw", "/trajectory")
USEFUL = ("/controls", "/trajectory_phase", "/operator/phase")
_PROGRESS_EVERY = 2000  # messages


def record(bag, recorder, rate_hz, progress=lambda fraction: None):
    """Give an open Bag's messages to a Recorder; of the states `rate_hz` a second.

    Raises BagError when the bag lacks a topic without which there is nothing to plot.
    """
    topics = bag.topics
    missing = [topic for topic in NEEDED if not topics.get(topic)]
    if missing:
        raise BagError(
            "%s holds nothing on %s, so there is nothing to plot: record /cortex_raw, /trajectory and /controls "
            "(launch/record.launch does); it has %s"
            % (bag.path, " and ".join(missing), ", ".join(sorted(topics)) or "no topics")
        )
    phases = {"/trajectory_phase": recorder.phases, "/operator/phase": recorder.operator}
    wanted = NEEDED + tuple(topic for topic in USEFUL if topic in topics and fits(topic, bag.types[topic]))
    begin_s = due_s = None
    for count, (topic, receipt_s, message) in enumerate(bag.messages(wanted)):
        if begin_s is None:
            begin_s = due_s = receipt_s
        if count % _PROGRESS_EVERY == 0:
            progress((receipt_s - begin_s) / max(bag.duration_s, 1e-3))
        if topic in phases:
            phases[topic](receipt_s, message)
        elif topic == "/trajectory":
            recorder.references(receipt_s, seconds(message.header.stamp), message.Obj)
        elif topic == "/controls":
            recorder.commands(receipt_s, seconds(message.header.stamp), message.Obj)
        elif receipt_s >= due_s:
            due_s = max(due_s + 1.0 / rate_hz, receipt_s - 1.0 / rate_hz)
            recorder.states(receipt_s, seconds(message.header.stamp), message.Obj)
    recorder.finish()


def plot_bag(path, folder, params, fleet=None, progress=lambda fraction: None):
    """Pages and tables of a bag into a folder. Returns (segments, files). Raises BagError, ValueError, OSError."""
    recorder = Recorder(params, fleet.vehicles if fleet else ())
    with Bag(path) as bag:
        record(bag, recorder, params.rate_hz, progress)
    unknown = recorder.unknown_vehicles
    if unknown:
        raise BagError(
            "%s: /cortex_raw never shows %s; it shows %s"
            % (path, ", ".join(unknown), ", ".join(recorder.vehicles) or "nothing")
        )
    segments = recorder.segments()
    if not segments:
        raise BagError(
            "%s: no vehicle was seen for %g s while /trajectory said where it should be; /cortex_raw shows %s"
            % (path, params.min_s, ", ".join(recorder.vehicles) or "nothing")
        )
    folder.mkdir(parents=True, exist_ok=True)
    return segments, PageWriter(folder, params.pdf).write(segments)


def main(arguments):
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="DF_Plots.py",
        description="The course's plots of a flight from its bag: a page (PNG, PDF) and a table (CSV) for each segment."
        " Without a bag it is a ROS node that logs the flight under way.",
    )
    parser.add_argument("bag", type=pathlib.Path)
    parser.add_argument("-o", "--out", type=pathlib.Path, help="folder for the files (default: BAG_plots, beside it)")
    parser.add_argument("--vehicle", help="only this one, by its name on /cortex_raw or its namespace (default: all)")
    parser.add_argument("-f", "--fleet", type=pathlib.Path, help="fleet file (default: fleet.yaml beside the bag)")
    parser.add_argument(
        "--euler-angle-max",
        type=float,
        default=PlotParams.euler_angle_max,
        metavar="RAD",
        help="tilt at a fraction of 1 on /controls (default: that of the vehicle's type)",
    )
    parser.add_argument(
        "--type", default="", help="of the vehicles: ardrone or iris (default: the fleet's, else ardrone)"
    )
    parser.add_argument("--all", action="store_true", help="also the phase hold, in which nothing is to be flown")
    args = parser.parse_args(arguments)
    folder = args.out or args.bag.with_suffix("").with_name(args.bag.stem + "_plots")
    beside = args.bag.parent / "fleet.yaml"
    fleet_file = args.fleet or (beside if beside.exists() else None)
    try:
        params = PlotParams(
            euler_angle_max=args.euler_angle_max,
            vehicle_type=args.type,
            vehicles=(args.vehicle,) if args.vehicle else (),
            skip_phases=() if args.all else PlotParams.skip_phases,
        )
        fleet = load_fleet(fleet_file) if fleet_file else None
        segments, files = plot_bag(args.bag, folder, params, fleet, _show_progress)
    except (BagError, ValueError, OSError) as error:
        _show_progress(None)
        print("DF_Plots.py: %s" % error, file=sys.stderr)
        return 1
    _show_progress(None)
    for segment in segments:
        print(
            "%-12s %-24s %6.1f s  position RMSE %6.1f mm"
            % (segment.vehicle, segment.label, segment.duration_s, 1e3 * segment.position_rmse_m)
        )
    print("%d files in %s" % (len(files), folder))
    return 0


def _show_progress(fraction):
    if sys.stderr.isatty():
        text = "" if fraction is None else "reading ... %.0f %%" % (100.0 * fraction)
        print("\r\033[K" + text, end="", file=sys.stderr, flush=True)
