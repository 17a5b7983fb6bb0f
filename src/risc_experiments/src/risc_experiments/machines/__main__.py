"""`./maap machines`: see `./maap machines --help`."""

import argparse
import os
import pathlib
import signal
import subprocess
import sys

from rosgraph.network import get_local_addresses

from risc_experiments.doctor.interfaces import interface_towards, read_interfaces
from risc_experiments.machines import check, deploy, setup
from risc_experiments.machines.experiment import ExperimentError, default_addresses, load_experiment

DEFAULT_FILE = "launch/Multi_Machine_Experiment.launch"
_ABOUT = """The computers of a launch file with <machine> tags, as roslaunch sees them.

  check   is every one of them ready? Says what is not, why, and what to do; changes nothing
  setup   make the logins ready: host keys (asks), an ssh key, quick detection of dead connections
  deploy  bring the workspace, as it is built here, to every one of them
"""
_ADDRESSES = " ".join("risc%d_address:=192.168.0.%d" % (number, 9 + number) for number in range(1, 5))
_EXAMPLES = (
    """examples:
  ./maap machines check %s fleet:=$PWD/my_fleet.yaml
  ./maap machines setup risc2_address:=192.168.0.11 --only risc2
  ./maap machines deploy launch/my_laboratory.launch user:=pilot --only risc2,risc3

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
    parser.add_argument("action", choices=("check", "setup", "deploy"), help="see above")
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


def refuse_strangers(experiment, root, action):
    """Raise ExperimentError for addresses that are only the defaults of the shipped files, not this laboratory's.

    They are if this computer has one of them. Elsewhere they may belong to anybody, and nothing must knock there:
    neither ssh nor, by `check` and by the line that it prints, the Cortex client.
    """
    shipped_file = root / DEFAULT_FILE
    if not shipped_file.exists():
        return
    shipped = default_addresses(str(shipped_file))
    if shipped.intersection(get_local_addresses()):
        return
    strangers = [computer for computer in experiment.computers if computer.address in shipped]
    if strangers and any(map(check.needs_login, experiment.computers)):
        raise ExperimentError(
            "%s has an address of the thesis' laboratory, and this computer has none of them: say your addresses, e.g. "
            "./maap machines %s %s"
            % (", ".join("%s (%s)" % (computer.name, computer.address) for computer in strangers), action, _ADDRESSES)
        )
    # by the network: people put their own host into the shipped fleet files, too
    networks, cards = set(map(_network, shipped)) - {""}, read_interfaces()
    for host in experiment.cortex if action == "check" else ():
        if _network(host) in networks and interface_towards(cards, host) is None:
            raise ExperimentError(
                "the Cortex host %s is in the thesis' laboratory, and this computer is not: copy %s, set mocap host to "
                "your own in the copy, and add fleet:=$PWD/COPY" % (host, experiment.computers[0].fleet)
            )


def _network(address):
    """The first three bytes of an address, "" of a name without a dot."""
    return address.rpartition(".")[0]


def main(argv=None):
    """Command line. Returns the exit code."""
    args = arguments(argv)
    root = pathlib.Path(os.environ.get("RISC_MAAP_ROOT", "."))
    try:
        experiment = load_experiment(args.file or str(root / DEFAULT_FILE), args.arguments)
        if args.only:
            experiment = experiment.only(args.only.split(","))
        refuse_strangers(experiment, root, args.action)
    except ExperimentError as problem:
        print("maap machines: %s" % problem, file=sys.stderr)
        return 2
    try:
        if args.action == "check":
            return check.run(experiment, root)
        if args.action == "setup":
            return setup.run(experiment, args.yes)
        return deploy.run(experiment, root)
    except (OSError, RuntimeError, subprocess.CalledProcessError) as problem:
        # something is missing here: no file to write, no rosmaster, no rsync, no ssh-keygen
        print("maap machines: %s" % problem, file=sys.stderr)
        return 1


if __name__ == "__main__":
    for number in (signal.SIGTERM, signal.SIGHUP):  # as Ctrl-C: what was started here ends, too
        signal.signal(number, signal.default_int_handler)
    try:
        sys.exit(main())
    except (KeyboardInterrupt, EOFError):
        sys.exit("\nmaap machines: interrupted")
