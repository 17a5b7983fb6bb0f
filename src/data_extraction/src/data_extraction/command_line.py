"""Common parts of the commands that read a bag."""

import argparse
import pathlib

from data_extraction.progress import Progress
from risc_lab.lab import load_fleet


def bag_parser(prog, description, fleet=True, **options):
    """ArgumentParser with the bag, the folder of the results and, if `fleet`, the fleet file."""
    parser = argparse.ArgumentParser(prog=prog, description=description, **options)
    parser.add_argument("bag", type=pathlib.Path, metavar="BAG")
    parser.add_argument("-o", "--out", type=pathlib.Path, metavar="DIR", help="for the files (default: beside the bag)")
    if fleet:
        text = "fleet file (default: fleet.yaml beside the bag, if there)"
        parser.add_argument("-f", "--fleet", type=pathlib.Path, metavar="YAML", help=text)
    return parser


def folder_beside(bag_path, kind):
    """Folder beside a bag for what is made of it: flight.bag -> flight_KIND."""
    return bag_path.with_name("%s_%s" % (bag_path.stem, kind))


def fleet_of(bag_path, fleet_path=None):
    """Fleet of a bag: from the given file, else from fleet.yaml beside it; None without both. Raises ValueError."""
    beside = bag_path.parent / "fleet.yaml"
    return load_fleet(fleet_path or beside) if fleet_path or beside.exists() else None


def run(prog, work):
    """Call work(progress). Returns the exit code; prints an error as one line."""
    progress = Progress()
    try:
        work(progress)
        progress.clear()
    except (ValueError, OSError) as error:  # also BagError
        progress.say("%s: %s" % (prog, error))
        return 1
    except KeyboardInterrupt:
        progress.say("%s: interrupted" % prog)
        return 130
    return 0
