"""Types of command-line options."""

import argparse
import math


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
