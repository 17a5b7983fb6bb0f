"""The course's plots: a page and a table for each segment of a flight, live or from its bag. Needs no ROS."""

import csv
import re
import time

import matplotlib.pyplot as plt
import numpy as np

from data_extraction import plots
from data_extraction.bags import Bag, BagError
from data_extraction.command_line import bag_parser, fleet_of, folder_beside, run
from data_extraction.flatten import seconds
from data_extraction.progress import Progress, bar
from data_extraction.recording import REFERENCES, STATES
from data_extraction.report.recorded_topics import fits
from data_extraction.segments import COLUMNS, TOPICS, PlotParams, Recorder

_SHOW_EVERY = 2000  # messages
_COLLECT_EVERY = 100_000  # messages, so that memory does not grow with the bag


class PageWriter:
    """Keeps a folder of pages and tables up to date with the segments of a flight."""

    def __init__(self, folder, pdf=True):
        """folder: pathlib.Path that exists.  pdf: write each page as PDF, too."""
        self.folder = folder
        self._suffixes = (".png", ".pdf") if pdf else (".png",)
        self._written = {}  # path without suffix -> rows

    def write(self, segments):
        """Write the segments that are new or have grown. Returns the list of files, tables before the first page."""
        new = {self.folder / file_stem(segment): segment for segment in segments}
        new = {path: segment for path, segment in new.items() if self._written.get(path) != len(segment.table)}
        self._written.update({path: len(segment.table) for path, segment in new.items()})
        files = [write_table(segment, path.with_name(path.name + ".csv")) for path, segment in new.items()]
        for path, segment in new.items():
            with plots.style():
                figure = plots.course_page(segment)
                for suffix in self._suffixes:
                    files.append(path.with_name(path.name + suffix))
                    figure.savefig(files[-1])
                plt.close(figure)
        return files


def file_stem(segment):
    """Name of a segment's files without suffix: vehicle, time of day at its start, what is flown."""
    text = "_".join((segment.vehicle, time.strftime("%H%M%S", segment.clock), segment.label))
    return re.sub(r"[^\w.+-]+", "_", text)


def write_table(segment, path):
    """The 16 columns as CSV, with their names. Returns the path."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        writer.writerows(["" if np.isnan(value) else "%.6f" % value for value in row] for row in segment.table)
    return path


def record(bag, recorder, rate_hz, progress):
    """Feed the messages of an open Bag to a Recorder, the states at most at `rate_hz` [Hz].

    Raises BagError when the bag lacks a topic that the plots need.
    """
    missing = [topic for topic in (STATES, REFERENCES) if not bag.topics.get(topic)]
    if missing:
        raise BagError(
            "%s holds nothing on %s, so there is nothing to plot: record /cortex_raw, /trajectory and /controls "
            "(launch/record.launch does); %s" % (bag.path, " and ".join(missing), bag.contents)
        )
    due_s = None
    topics = [topic for topic in TOPICS if topic in bag.topics and fits(topic, bag.types[topic])]
    for count, (topic, receipt_s, message) in enumerate(bag.messages(topics)):
        if count % _SHOW_EVERY == 0:
            progress.show("reading", bar(bag.fraction(receipt_s)))
        if count % _COLLECT_EVERY == _COLLECT_EVERY - 1:
            recorder.ended()
        due_s = receipt_s if due_s is None else due_s
        if topic == STATES:
            if receipt_s < due_s:
                continue
            due_s = max(due_s + 1.0 / rate_hz, receipt_s - 1.0 / rate_hz)
        recorder.take(topic, receipt_s, message, seconds)
    recorder.finish()


def plot_bag(path, folder, params, fleet=None, progress=None):
    """Pages and tables of a bag into a folder. Returns (segments, files). Raises BagError, ValueError, OSError."""
    recorder = Recorder(params, fleet.vehicles if fleet else ())
    with Bag(path) as bag:
        record(bag, recorder, params.rate_hz, progress or Progress())
    shown = ", ".join(recorder.vehicles) or "nothing"
    if recorder.unknown_vehicles:
        unknown = ", ".join(recorder.unknown_vehicles)
        raise BagError("%s: /cortex_raw never shows %s; it shows %s" % (path, unknown, shown))
    segments = recorder.segments()
    if not segments:
        raise BagError(
            "%s: no vehicle was seen for %g s while /trajectory said where it should be; /cortex_raw shows %s"
            % (path, params.min_s, shown)
        )
    folder.mkdir(parents=True, exist_ok=True)
    return segments, PageWriter(folder, params.pdf).write(segments)


def main(arguments):
    """Command line of DF_Plots.py with a bag. Returns the exit code."""
    parser = bag_parser(
        "DF_Plots.py",
        "The course's plots of a flight from its bag: a page (PNG, PDF) and a table (CSV) for each segment."
        " Without a bag it is a ROS node that logs the flight under way.",
    )
    parser.add_argument("--vehicle", dest="vehicles", action="append", default=[],
                        help="only this one, by its name on /cortex_raw or its namespace (default: all)")  # fmt: skip
    parser.add_argument("--euler-angle-max", type=float, default=PlotParams.euler_angle_max, metavar="RAD",
                        help="tilt at a fraction of 1 on /controls (default: that of the vehicle's type)")  # fmt: skip
    parser.add_argument("--type", dest="vehicle_type", default="",
                        help="of the vehicles: ardrone or iris (default: the fleet's, else ardrone)")  # fmt: skip
    parser.add_argument("--all", dest="skip_phases", action="store_const", const=(), default=PlotParams.skip_phases,
                        help="also the phase hold, in which nothing is to be flown")  # fmt: skip
    args = parser.parse_args(arguments)
    folder = args.out or folder_beside(args.bag, "plots")

    def work(progress):
        settings = ("euler_angle_max", "vehicle_type", "vehicles", "skip_phases")
        params = PlotParams(**{name: getattr(args, name) for name in settings})
        segments, files = plot_bag(args.bag, folder, params, fleet_of(args.bag, args.fleet), progress)
        progress.clear()
        for segment in segments:
            print("%-12s %-24s %6.1f s  position RMSE %6.1f mm"
                  % (segment.vehicle, segment.label, segment.duration_s, 1e3 * segment.position_rmse_m))  # fmt: skip
        print("%d files in %s" % (len(files), folder))

    return run(parser.prog, work)
