"""Types of command-line options."""

import argparse
import math
import pathlib
from dataclasses import replace

from risc_control.controllers import default_params
from risc_control.trajectories import COURSES, find_course, parse_speed


def number(least, most=math.inf):
    """Type of an option: a finite number of the type of `least`, within limits."""
    kind = type(least)

    def parse(text):
        value = kind(text)
        if not (least <= value <= most and math.isfinite(value)):
            limits = "" if least == -math.inf else " from %g" % least + (" to %g" % most if most < math.inf else " on")
            raise argparse.ArgumentTypeError("must be a number%s, found %s" % (limits, text))
        return value

    parse.__name__ = "number"  # for "invalid number value"
    return parse


def name_list(text):
    """Type of an option: names separated by commas; repeated names count once."""
    found = list(dict.fromkeys(filter(None, (name.strip() for name in text.split(",")))))
    if not found:
        raise argparse.ArgumentTypeError("needs at least one name")
    return found


def course(text):
    """Type of an option: the name of a course, or the path of a file of waypoints, which is absolute afterwards."""
    if text in COURSES:
        return text
    try:
        if text.endswith(".yaml"):
            find_course(text)
            return str(pathlib.Path(text).resolve())
        raise ValueError("choose from %s, or a file of waypoints (.yaml)" % ", ".join(sorted(COURSES)))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def speed(text):
    """Type of an option: what `speed_factor` takes."""
    try:
        parse_speed(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
    return text


def add_set_option(add):
    """Add the option --set to a parser; `numbers_of` evaluates it. add: the parser's add_argument."""
    help_text = "another parameter of the controller, e.g. q_tilt=3; may be given again"
    add("--set", action="append", default=[], metavar="KEY=NUMBER", help=help_text)


def numbers_of(controller, changes):
    """{key: number} of texts "KEY=NUMBER", where KEY is a parameter of a controller. Raises ValueError."""
    params, numbers = default_params(controller), {}
    for change in changes:
        key, _, value = change.partition("=")
        if key not in vars(params):
            raise ValueError("--set %s: give KEY=NUMBER with a parameter of %s" % (change, controller))
        try:
            numbers[key] = float(value)
        except ValueError:
            raise ValueError("--set %s: %r is not a number" % (change, value)) from None
    replace(params, **numbers)  # checks limits
    return numbers
