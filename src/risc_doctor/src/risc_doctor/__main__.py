"""`./maap doctor`: everything that can keep the vehicles on the ground, in one command."""

import argparse
import os
import pathlib
import sys
import threading

from risc_doctor import by_hand
from risc_doctor.checks import CHECKS, run
from risc_doctor.findings import GREEN, RED, count_text, exit_code, print_findings, to_json, worst
from risc_doctor.situation import DEFAULT_FLEET, look_around

WRONG_USE = 2
_GOODBYE_S = 2.0
_ALIASES = {"drone": "vehicles", "drones": "vehicles", "clocks": "clock"}
_LAST_LINE = {
    GREEN: "Ready to fly",
    "yellow": "Ready to fly; check what is yellow",
    RED: "Not ready to fly: start with the first red line",
}


def arguments(argv):
    """Command line -> argparse namespace."""
    width = max(map(len, CHECKS))
    parser = argparse.ArgumentParser(
        prog="maap doctor",
        description="Why does it not fly? Checks everything that can be the reason and says how to fix it.",
        epilog="checks:\n" + "\n".join("  %s  %s" % (name.ljust(width), what) for name, (what, _) in CHECKS.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    fleet_help = "fleet file (default: the fleet of the running graph, else %s)" % DEFAULT_FLEET
    add("fleet", nargs="?", type=pathlib.Path, metavar="FLEET.yaml", help=fleet_help)
    add("--only", metavar="CHECK,...", help="these checks only")
    add("--json", action="store_true", help="findings as JSON: a list, in one line")
    add("--bag-folder", type=pathlib.Path, metavar="DIR", help="where bags go (default: flights/)")
    joystick_help = "devices that must be present, e.g. /dev/input/js0"
    add("--joystick", nargs="+", action="extend", default=[], metavar="DEVICE", help=joystick_help)
    vehicle_help = "vehicles that this computer flies, by name or address (default: all that it can reach)"
    add("--vehicle", "--drone", nargs="+", action="extend", default=[], metavar="VEHICLE", help=vehicle_help)
    add("--live", action="store_true", help="ask Cortex for its live mode first, as stream_markers does")
    add("--axes", metavar="VEHICLE", help="move a vehicle along +x, +y, +z by hand: does motion capture see the same?")
    args = parser.parse_args(argv)
    names = list(CHECKS) if args.only is None else args.only.replace(",", " ").split()
    args.only = [_ALIASES.get(name, name) for name in names]
    unknown = [name for name in args.only if name not in CHECKS]
    if unknown or not args.only:
        parser.error("--only: no check '%s'; choose from %s" % (", ".join(unknown), ", ".join(CHECKS)))
    if args.axes and args.json:
        parser.error("--axes asks you to move things: leave out --json")
    if args.axes and not sys.stdin.isatty():
        parser.error("--axes waits for your Enter: start it in a terminal")
    return args


def main(argv=None):
    """Returns the exit code: 0 it can fly, 1 it cannot, 2 wrong use."""
    args = arguments(argv)
    options = {"joysticks": tuple(args.joystick), "wanted": tuple(args.vehicle), "live": args.live}
    try:
        situation = look_around(args.fleet, dict(os.environ), bag_folder=args.bag_folder, **options)
        situation.vehicles()  # names that the fleet does not have are wrong use
    except ValueError as error:
        print("maap doctor: %s" % error, file=sys.stderr)
        return WRONG_USE
    if args.axes:
        findings = by_hand.look(situation.fleet, args.axes, input)
    else:
        if not args.json:
            _say("fleet '%s' (%s)" % (situation.fleet.name, situation.fleet_source))
        findings = run(situation, [name for name in CHECKS if name in args.only])
    if args.json:
        _say(to_json(findings))
    else:
        _say(findings)
        if not args.axes:
            _say("\n%s (%s)." % (_LAST_LINE[worst(findings)], count_text(findings)))
    return exit_code(findings)


def _say(what):
    """Print a text, or findings, at once; a reader that has gone is not an error: `maap doctor | head`."""
    try:
        (print if isinstance(what, str) else print_findings)(what)
        sys.stdout.flush()
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # takes what is left, now and at exit


def leave(code):
    """End the program. At exit rospy unregisters from its master, and would wait forever for one that hangs."""
    sys.stdout.flush()
    watchdog = threading.Timer(_GOODBYE_S, os._exit, [code])
    watchdog.daemon = True
    watchdog.start()
    sys.exit(code)


if __name__ == "__main__":
    try:
        exit_status = main()
    except (KeyboardInterrupt, EOFError):
        print("\nmaap doctor: interrupted", file=sys.stderr)
        exit_status = 1
    leave(exit_status)
