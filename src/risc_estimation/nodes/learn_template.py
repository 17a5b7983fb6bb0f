#!/usr/bin/env python3
"""Record an object at rest from /mocap_data and write its template; see risc_estimation.template_geometry.

    rosrun risc_estimation learn_template.py Condor --out condor.yaml

The motion capture host must know the object by this name. The template gets the host's markers, in the host's order.
"""

import argparse
import math
import pathlib
import sys
import threading
import time

import numpy as np
import rospy

from risc_estimation import template_geometry as geometry
from risc_lab.lab.templates import KINDS, VEHICLE, load_templates
from risc_lab.ros.fleet_messages import MocapArrays
from risc_lab.ros.guard import subscribe
from risc_lab.ros.params import known_fleet
from risc_lab.ros.publisher_updates import init_node

_PATIENCE_S = 10.0  # in addition to the recording time


class Recording:
    """Records the frames of one object until they span some seconds."""

    def __init__(self, name, seconds):
        self._name, self._seconds = name, seconds
        self.over, self.problem = threading.Event(), "nothing comes on /mocap_data: is stream_markers running?"
        self._stamps_s, self._samples_m = [], []

    def on_frame(self, frame):
        """A message of /mocap_data."""
        if self.over.is_set():
            return
        first, counts = 0, dict(frame.layout.entries)
        for name, count in frame.layout.entries:
            if name == self._name:
                break
            first += count
        else:
            there = ", ".join(counts) or "no object"
            self.problem = "motion capture shows %s, and not '%s': correct the name" % (there, self._name)
            return
        self._stamps_s.append(frame.header.stamp.to_sec())
        self._samples_m.append(frame.markers_m[first : first + count].copy())
        self.problem = "only %d frames of '%s' came" % (len(self._stamps_s), self._name)
        if self._stamps_s[-1] - self._stamps_s[0] >= self._seconds and len(self._stamps_s) >= geometry.LEAST_FRAMES:
            self.over.set()

    def samples_m(self):
        """(frames, n, 3) [m], once the recording is over. Raises ValueError."""
        counts = sorted({len(sample) for sample in self._samples_m})
        if len(counts) > 1:
            text = "the number of markers of '%s' changes (%s): learn it with one body of that name"
            raise ValueError(text % (self._name, " or ".join(map(str, counts))))
        return np.array(self._samples_m)


def record(name, seconds):
    """(frames, n, 3) [m] of an object. Raises ValueError when it is not seen for long enough."""
    recording = Recording(name, seconds)
    subscribe("/mocap_data", MocapArrays, recording.on_frame, queue_size=1000)
    deadline_s = time.monotonic() + seconds + _PATIENCE_S
    while not recording.over.wait(0.1):
        if rospy.is_shutdown() or time.monotonic() > deadline_s:
            raise ValueError(recording.problem)
    return recording.samples_m()


def doubts(name, marker_names, markers_m, templates, limit_m):
    """Sentences on markers or templates that may be confused."""

    def swapped(match, names):
        pairs = ["%s on %s" % (names[i], names[k]) for i, k in enumerate(match.places) if i != k]
        return "%s, turned by %.0f degrees, fits within %.1f mm" % (
            ", ".join(pairs),
            math.degrees(match.angle_rad),
            1e3 * match.rms_m,
        )

    match = geometry.symmetry(markers_m, limit_m)
    if match is not None:
        yield "nearly symmetric: %s. Move a marker" % swapped(match, marker_names)
    else:
        for hidden, match in geometry.symmetries_when_hidden(markers_m, limit_m).items():
            names = [marker for k, marker in enumerate(marker_names) if k != hidden]
            yield "nearly symmetric while %s is hidden: %s" % (marker_names[hidden], swapped(match, names))
    others = {other: template for other, template in templates.items() if other != name}
    for other, match in geometry.resembling(markers_m, others, limit_m).items():
        yield "like %s: %d markers fit within %.1f mm. Move a marker" % (other, len(match.places), 1e3 * match.rms_m)


def learn(args):
    """Return the template's text; print what was measured to stderr. Raises ValueError."""
    templates = load_templates(fleet=known_fleet())
    like = templates.get(args.like) if args.like else None
    if args.like and like is None:
        raise ValueError("--like: no template '%s'; there are %s" % (args.like, ", ".join(templates)))
    rest = geometry.at_rest(record(args.name, args.seconds))
    if like is None:
        marker_names = ["marker_%d" % (k + 1) for k in range(len(rest.markers_m))]
        markers_m = geometry.in_own_axes(rest.markers_m, args.kind, args.origin, math.radians(args.nose))
        origin = "the mean of its markers" if args.origin is None else "(%g, %g, %g) m" % tuple(args.origin)
        axes = "nose at a yaw of %g degrees" % args.nose if args.kind == VEHICLE else "axes are the cortex axes"
        conventions = "origin: %s; recorded standing level, %s" % (origin, axes)
    else:
        markers_m, match = geometry.in_axes_of(rest.markers_m, like)
        marker_names = like.marker_names
        conventions = "origin and axes are those of %s, which it fits within %.1f mm" % (like.name, 1e3 * match.rms_m)
    for marker, row, noise_m, seen in zip(marker_names, markers_m, rest.noise_m, rest.seen):
        text = "%-14s %8.1f %8.1f %8.1f mm   noise %.2f mm   seen in %.0f %%"
        say(text % (marker, *(1e3 * row), 1e3 * noise_m, 100.0 * seen))
    for doubt in doubts(args.name, marker_names, markers_m, templates, 1e-3 * args.limit):
        say("warning: " + doubt)
    notes = (
        "%s, learnt by learn_template.py: noise of a marker %.2f mm." % (args.name, 1e3 * rest.noise_m.max()),
        "Markers [m] in the order of the host's template, %s"
        % ("body axes: x nose, y right wing, z belly." if args.kind == VEHICLE else "cortex axes as mounted."),
        conventions[0].upper() + conventions[1:] + ".",
    )
    return geometry.template_text(args.name, args.kind, marker_names, markers_m, notes)


def say(text):
    """Print to stderr: the template itself may go to stdout."""
    print(text, file=sys.stderr)


def main(argv):
    """Command line. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="learn_template.py", description="Learn the marker template of an object.")
    add = parser.add_argument
    add("name", metavar="NAME", help="of the object, as motion capture calls it")
    add("--seconds", type=float, default=3.0, metavar="S", help="of recording (default: 3)")
    add("--kind", choices=KINDS, default=VEHICLE, help="what it is (default: vehicle)")
    origin_help = "of the object in the cortex frame [m] (default: the mean of its markers)"
    add("--origin", type=float, nargs=3, metavar=("X", "Y", "Z"), help=origin_help)
    add(
        "--nose",
        type=float,
        default=0.0,
        metavar="DEG",
        help="yaw of a vehicle, + clockwise from cortex x (default: 0)",
    )
    add("--like", metavar="TEMPLATE", help="take origin, axes and names from a template with the same order of markers")
    add(
        "--limit", type=float, default=1e3 * geometry.ALIKE_M, metavar="MM", help="geometries are alike (default: 5 mm)"
    )
    add("--out", type=pathlib.Path, metavar="FILE.yaml", help="new file (default: printed)")
    args = parser.parse_args(argv[1:])
    try:
        if args.out is not None and args.out.exists():
            raise ValueError("%s is there already: choose another --out" % args.out)
        init_node("learn_template", anonymous=True)
        text = learn(args)
        if args.out is None:
            print(text, end="")
        else:
            args.out.write_text(text, encoding="utf-8")
            say("written: %s. Add it to the templates file, or to `templates` of the fleet file" % args.out)
    except (ValueError, OSError, rospy.ROSException) as error:
        say("learn_template.py: %s" % error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(rospy.myargv()))
