"""`./maap machines`: see `./maap machines --help`."""

import argparse
import os
import pathlib
import signal
import subprocess
import sys

from risc_doctor.findings import collect, count_text, exit_code, print_findings
from risc_doctor.machines import check, deploy, setup
from risc_doctor.machines.experiment import ExperimentError, load_experiment

DEFAULT_FILE = "launch/Multi_Machine_Experiment.launch"
ACTIONS = {"check": check.begin, "setup": setup.begin, "deploy": deploy.begin}
_ABOUT = """The computers of a launch file with <machine> tags, as roslaunch sees them.

  check   is every one of them ready? Says what is not, why, and what to do; changes nothing
  setup   make the logins ready: host keys (asks), an ssh key, quick detection of dead connections
  deploy  bring the workspace, as it is built here, to every one of them
"""
_ADDRESSES = " ".join("risc%d_address:=192.168.0.%d" % (number, 9 + number) for number in range(1, 5))
_EXAMPLES = (
    """examples:
  ./maap machines check %s fleet:=$PWD/my_fleet.yaml
  ./maap machines setup launch/my_laboratory.launch --only risc2
  ./maap machines deploy launch/my_laboratory.launch user:=pilot --only risc2,risc3

my_laboratory.launch: docs/many_machines.md.
Exit code: 0 all is well, 1 something is not, 2 wrong usage."""
    % _ADDRESSES
)


def arguments(argv):
    """Command line -> argparse namespace, with `file` and `arguments` apart."""
    parser = argparse.ArgumentParser(
        prog="maap machines",
        usage="./maap machines check|setup|deploy [FILE] [ARG:=VALUE ...] [--only NAME,NAME] [--yes]",
        description=_ABOUT,
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("action", choices=ACTIONS, help="see above")
    parser.add_argument(
        "file", nargs="*", metavar="FILE ARG:=VALUE", help="launch file and its arguments (default: %s)" % DEFAULT_FILE
    )
    parser.add_argument("--only", metavar="NAME,NAME", help="these machines alone")
    parser.add_argument("--yes", action="store_true", help="setup: write host keys without asking")
    args = parser.parse_intermixed_args(argv)
    args.arguments = [word for word in args.file if ":=" in word]
    files = [word for word in args.file if ":=" not in word]
    if len(files) > 1:
        parser.error("one launch file, please: found %s (arguments are written NAME:=VALUE)" % " and ".join(files))
    if args.yes and args.action != "setup":
        parser.error("--yes is for setup")
    args.file = files[0] if files else None
    return args


def run(experiment, action, root, yes=False):
    """Do an action with every computer and print what was found, in the order of the file. Returns the exit code."""
    computers = [c for c in experiment.computers if action == "check" or c.needs_login]
    if not computers:
        print("nothing to do: no node of %s runs on another computer" % experiment.path)
        return 0
    findings, work = ACTIONS[action](experiment, root, yes)
    if findings:
        print("this computer")
        print_findings(findings)
        print()
    for computer in computers:
        print("%s (%s)" % (computer.name, "this computer" if computer.local else computer.login), flush=True)
        found = collect(work(computer))
        print_findings(found)
        print(flush=True)
        findings += found
    print("%d machines: %s" % (len(computers), count_text(findings)))
    if action == "check" and exit_code(findings) == 0:
        print("start it with\n  " + check.launch_line(experiment))
    return exit_code(findings)


def main(argv=None):
    """Command line. Returns the exit code."""
    args = arguments(argv)
    root = pathlib.Path(os.environ.get("RISC_MAAP_ROOT", ".")).resolve()
    try:
        experiment = load_experiment(args.file or str(root / DEFAULT_FILE), args.arguments, args.only)
        return run(experiment, args.action, root, args.yes)
    except (ExperimentError, OSError, RuntimeError, subprocess.CalledProcessError) as problem:
        # the others: something is missing here, no file to write, no rosmaster, no rsync, no ssh-keygen
        print("maap machines: %s" % problem, file=sys.stderr)
        return 2 if isinstance(problem, ExperimentError) else 1


if __name__ == "__main__":
    for number in (signal.SIGTERM, signal.SIGHUP):  # as Ctrl-C: what was started here ends, too
        signal.signal(number, signal.default_int_handler)
    try:
        sys.exit(main())
    except (KeyboardInterrupt, EOFError):
        print("\nmaap machines: interrupted", file=sys.stderr, flush=True)
        os._exit(1)  # not waiting for what still asks; what runs on the other computers ends by its own limits
