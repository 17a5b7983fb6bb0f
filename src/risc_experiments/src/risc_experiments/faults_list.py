"""Faults on command lines: the option --fault, and `./maap faults`, which lists them."""

import argparse
import math
import sys
import textwrap

from risc_experiments.programs import roles
from risc_simulator.faults import REGISTRY, fault_settings, parse_fault

_HEAD = """Faults, as --fault takes them: NAME[:ARG,...][@SECONDS]
ARG: a number (the argument), a grade, a vehicle, or severity=, duration_s=, vehicle=, channel=, program=; several with
commas.

    --fault mocap_blackout:0.3@2    no frame for 0.3 s, 2 s after the course is reached
    --fault jump:severe,risc2       by 1 m, of one vehicle; docs/faults.md tells the rest
    --fault node_stop:controller,3  a program of the flight hangs for 3 s. Programs: nodes by their names, and
%s
"""


def fault_option(text):
    """Type of an option: faults.FaultEvent."""
    try:
        return parse_fault(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def describe(name):
    """Yield the lines that describe a fault. Raises ValueError for an unknown one."""
    settings = fault_settings(name)
    low, high = settings.argument_range
    if low == high:
        argument = "%g" % low
    else:
        argument = "%g to %g" % (low, high) if math.isfinite(high) else "any, from %g" % low
    yield "%s: %s" % (name, settings.summary)
    yield "    argument  %s" % " ".join(filter(None, (settings.argument + ",", argument, settings.argument_unit)))
    default = "severity %g" % settings.default_severity if settings.severity[0] != settings.severity[1] else ""
    lasts_s = settings.default.duration_s
    lasts = "for %g s" % lasts_s if math.isfinite(lasts_s) else "until the end"
    lasts = lasts if lasts_s else "at once"
    yield "    default   %s" % " ".join(filter(None, (default, lasts)))
    if settings.grades:
        yield "    grades    %s" % ", ".join("%s %g" % item for item in settings.grades.items())
    where = "a program" if settings.on_programs else settings.channel or ", ".join(settings.acts_on)
    where = "one vehicle" if settings.per_vehicle else where
    yield "    acts on   %s" % where
    yield "    safe      %s" % ", ".join(settings.safe)


def main(argv=None):
    """Print the catalogue. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="./maap faults", description="List the faults that --fault takes.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="only these (default: all)")
    args = parser.parse_args(argv)
    try:
        told = ["\n".join(describe(name)) for name in args.names or REGISTRY.names()]
    except ValueError as error:
        parser.error(str(error))
    if not args.names:
        print(_HEAD % textwrap.fill(", ".join(roles()), 110, initial_indent=" " * 36, subsequent_indent=" " * 36))
    print("\n\n".join(told))
    return 0


if __name__ == "__main__":
    sys.exit(main())
