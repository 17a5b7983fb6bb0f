#!/usr/bin/env python3
"""Calibrate a camera from pictures of a checkerboard: a bag or a folder. Needs no screen and no ROS master."""

import argparse
import pathlib
import sys

import cv2

from data_extraction.command_line import run
from risc_lab.lab.calibration import save_calibration
from risc_visual.vision.checkerboard import MIN_VIEWS, Checkerboard, View, calibrate, find_board, shown_board
from risc_visual.vision.picture_source import open_pictures

_HINT_PICTURES = 12  # pictures that are searched for another board when the right one is in none


def find_views(source, count, pictures, board):
    """Look for the board in all pictures. Returns (views, (width, height)). Raises ValueError."""
    views, sample, size_px, size_of, unreadable = [], [], None, None, 0
    for number, (name, grey) in enumerate(pictures, 1):
        show_progress("%d of %d pictures, board in %d" % (number, count, len(views)))
        if grey is None:
            unreadable += 1
            continue
        if size_px is None:
            size_px, size_of = grey.shape[::-1], name
        if grey.shape[::-1] != size_px:
            raise ValueError(
                "%s is %d x %d, but %s is %d x %d: one calibration is for one camera in one mode"
                % ((name,) + grey.shape[::-1] + (size_of,) + size_px)
            )
        corners = find_board(grey, board)
        if corners is not None:
            views.append(View(name, corners))
        elif len(sample) < _HINT_PICTURES:
            sample.append(grey)
    show_progress("")
    if unreadable:
        print("calibrate.py: %d of %d pictures cannot be read" % (unreadable, count), file=sys.stderr)
    if size_px is None:
        raise ValueError("none of the %d pictures of %s can be read" % (count, source))
    if len(views) < MIN_VIEWS:
        raise ValueError(_too_few(len(views), count, sample, board))
    return views, size_px


def _too_few(found, count, sample, board):
    text = "the board (%dx%d inner corners) was found in %d of %d pictures, at least %d are needed: "
    text %= board.columns, board.rows, found, count, MIN_VIEWS
    for other in filter(None, map(shown_board, sample)):
        if sorted(other) != sorted((board.columns, board.rows)):
            return text + "they show a board of %dx%d, try --size %dx%d" % (other + other)
    return text + (
        "--size counts the corners between squares, not the squares; the whole board with its white margin must be in "
        "view, sharp and evenly lit"
    )


def report(result, source, found, count, all_views):
    """Print the result."""
    calibration = result.calibration
    values = dict(zip(("fx", "fy", "cx", "cy"), (calibration.K[i] for i in (0, 4, 2, 5))))
    values.update(zip(("k1", "k2", "p1", "p2", "k3"), calibration.D))
    print("%s: board found in %d of %d pictures" % (source, found, count))
    for key, value in values.items():
        deviation = result.sigma[key]
        print("  %-3s %12.6g  %s" % (key, value, "+- %.2g" % deviation if deviation > 0.0 else "(not estimated)"))
    print("reprojection error: %.3f px RMS over %d views" % (result.rms_px, len(result.used)))
    worst = sorted(result.used, key=lambda view: view.rms_px, reverse=True)
    for view in worst if all_views else worst[:3]:
        print("  %6.3f px  tilt %2.0f deg  %s" % (view.rms_px, view.tilt_deg, view.name))
    if len(worst) > 3 and not all_views:
        print("  ... (all of them: --views)")
    for view in result.dropped:
        print("  dropped as an outlier: %.2f px  %s" % (view.rms_px, view.name))
    for warning in result.warnings:
        print("warning: %s" % warning)


def show_progress(text):
    """Print a line that the next one overwrites."""
    if sys.stderr.isatty():
        print("\r\033[K%s" % text, end="", file=sys.stderr, flush=True)


def main():
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="calibrate.py", description=__doc__)
    parser.add_argument("source", help="a bag, or a folder of pictures")
    parser.add_argument("--size", default="8x6", help="inner corners of the board (default: %(default)s)")
    parser.add_argument(
        "--square", type=float, default=0.025, metavar="M", help="side of a square (default: %(default)s)"
    )
    parser.add_argument("--topic", help="picture topic of the bag (default: its only one)")
    parser.add_argument("--name", default="ardrone_front", help="name of the camera (default: %(default)s)")
    parser.add_argument("--out", type=pathlib.Path, metavar="FILE.yaml", help="default: NAME.yaml, in this folder")
    parser.add_argument("--max-pictures", type=int, default=200, help="read at most this many (default: %(default)s)")
    parser.add_argument("--radial", type=int, choices=(2, 3), default=2, help="3: k3 too, for very wide lenses")
    parser.add_argument("--views", action="store_true", help="print the error of every view")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    return run(parser.prog, lambda _progress: work(args))


def work(args):
    """Calibrate. Raises OSError, ValueError."""
    out = args.out or pathlib.Path(args.name + ".yaml")
    if args.max_pictures < 1:
        raise ValueError("--max-pictures must be 1 or more, found %d" % args.max_pictures)
    board = Checkerboard.from_text(args.size, args.square)
    if not out.absolute().parent.is_dir():
        raise ValueError("cannot write %s: there is no folder %s, create it" % (out, out.parent))
    source, count, pictures = open_pictures(args.source, args.topic, args.max_pictures)
    views, size_px = find_views(source, count, pictures, board)
    show_progress("calibrating with %d views ..." % len(views))
    result = calibrate(views, board, size_px, args.name, args.radial)
    show_progress("")
    save_calibration(result.calibration, out)
    report(result, source, len(views), count, args.views)
    print("wrote %s" % out)
    print(
        "Put it where the driver reads it: what `calibration` of the fleet file names (a bare name is a file in\n"
        "risc_lab/config/cameras), without a fleet file ~/.ros/camera_info/%s.yaml" % args.name
    )


if __name__ == "__main__":
    sys.exit(main())
