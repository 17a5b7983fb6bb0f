#!/usr/bin/env python3
"""Hover throttle as a function of the battery charge, from a recorded flight (thesis 5.2.2). Needs no ROS master."""

import sys
from dataclasses import fields

import numpy as np

from data_extraction import plots
from data_extraction.command_line import bag_parser, folder_beside, run
from data_extraction.throttle_fit import FitParams, fit_bag
from risc_lab.lab import load_vehicle_type
from risc_lab.lab.vehicle_types import own_numbers
from risc_lab.radio_sticks import RadioSticks
from risc_lab.settings import settings_from

OPTIONS = {  # option -> (setting, help text)
    "--order": ("order", "of the polynomial"),
    "--window": ("window_s", "[s] over which throttle and acceleration are averaged"),
    "--min-height": ("min_height_m", "[m] lower, it may be on the ground"),
    "--max-speed": ("max_speed_m_s", "[m/s] faster, it is left out"),
    "--max-climb": ("max_climb_m_s", "[m/s] the same, up or down"),
    "--max-acceleration": ("max_acceleration_m_s2", "[m/s^2] the same, up or down"),
}


def main():
    """Command line. Returns the exit code."""
    parser = bag_parser("fit_throttle.py", __doc__, fleet=False)
    parser.add_argument("-v", "--vehicle", metavar="NAME", help="namespace or template (default: the only one)")
    parser.add_argument("--type", default="iris", help="vehicle type to compare with (default: %(default)s)")
    for option, (field, text) in OPTIONS.items():
        default = getattr(FitParams, field)
        text += " (default: %(default)s)"
        parser.add_argument(option, dest=field, type=type(default), default=default, help=text)
    args = parser.parse_args()

    def work(progress):
        params = settings_from(FitParams, {item.name: getattr(args, item.name) for item in fields(FitParams)})
        shipped = own_numbers(load_vehicle_type(args.type), RadioSticks).hover_throttle
        name, fit = fit_bag(args.bag, args.vehicle, params, progress)
        progress.clear()
        print(text_of(name, fit, args.type, shipped))
        folder = args.out or folder_beside(args.bag, "throttle")
        folder.mkdir(parents=True, exist_ok=True)
        line = "hover_throttle: [%s]" % ", ".join("%.12g" % value for value in fit.coefficients)
        snippet, picture = folder / "hover_throttle.yaml", folder / "hover_throttle.png"
        points = fit.points.pct
        snippet.write_text(
            "# %s in %s, %.0f to %.0f %%: for `own` in the YAML file of its vehicle type\n%s\n"
            % (name, args.bag.name, points[-1], points[0], line),
            encoding="utf-8",
        )
        with plots.style():
            compared = "that of type '%s'" % args.type, shipped
            plots.save_png(plots.hover_throttle(fit, "%s: throttle that hovers" % name, compared), picture)
        print("%s\n%s\n%s" % (line, snippet, picture))

    return run("fit_throttle", work)


def text_of(name, fit, kind, shipped):
    """Text of the result, for the terminal."""
    points, residuals = fit.points, fit.residuals
    worst = np.abs(residuals).argmax()
    lines = ["%s: %.0f s of hover and slow flight, battery %.0f to %.0f %%"
             % (name, points.seconds.sum(), points.pct[-1], points.pct[0])]  # fmt: skip
    lines += ["  c%d %16.9g +- %.2g" % (i, *both) for i, both in enumerate(zip(fit.coefficients, fit.intervals))]
    lines.append("  curve +- %.4f (95 %%)" % fit.interval(points.pct).max())
    lines.append("  residuals: rms %.4f, largest %+.4f at %.0f %%" % (fit.rms, residuals[worst], points.pct[worst]))
    off = fit.scaled(points.pct) - np.polynomial.polynomial.polyval(points.pct, shipped)
    worst = np.abs(off).argmax()
    lines.append("  from the curve of type '%s': up to %+.4f, at %.0f %%" % (kind, off[worst], points.pct[worst]))
    lines.append("  outside this range of charge the curve is a guess")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
