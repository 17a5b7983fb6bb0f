"""Record of a flight's arguments, versions and parameters, written beside its bag. The report reads it."""

import datetime
import pathlib
import platform

import msgspec
import yaml

from data_extraction.report.origin import FLIGHT, PARAMETERS
from risc_lab.revision import revision


def course_name(args):
    """Name of the flight's course, or of its experiment if no course was chosen."""
    return pathlib.Path(args.trajectory).stem if args.trajectory else args.experiment


def write_flight(args, fleet, root, folder, started=None):
    """Write flight.yaml into the flight's folder. Raises OSError.

    args: argparse namespace of `fly.arguments`; fleet: risc_lab.lab.Fleet; root: the workspace's folder.
    started: datetime, None = now.
    """
    started = (started or datetime.datetime.now()).astimezone()
    arguments = {**vars(args), "faults": " ".join(map(str, args.faults)) or None}
    content = {
        "experiment": args.experiment,
        "started": started.strftime("%Y-%m-%d %H:%M:%S %z"),
        "seed": args.seed,
        "fleet": fleet.name,
        "vehicles": [vehicle.namespace for vehicle in fleet.vehicles],
        "arguments": {name: plain(value) for name, value in sorted(arguments.items()) if name != "out"},
        "revision": revision(root),
        "versions": {"Python": platform.python_version(), "system": platform.platform(terse=True)},
    }
    _write(folder / FLIGHT, content, sort=False)


def write_parameters(parameters, folder):
    """Write the parameter server's content as parameters.yaml, and the versions of ROS in it into flight.yaml."""
    _write(folder / PARAMETERS, plain(parameters), sort=True)
    path = folder / FLIGHT
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    ros = [str(parameters[key]).strip() for key in ("rosdistro", "rosversion") if parameters.get(key)]
    if ros:
        content["versions"]["ROS"] = " ".join(ros)
    _write(path, content, sort=False)


def plain(value):
    """Convert a value to types that YAML knows; others become text."""
    return msgspec.to_builtins(value, str_keys=True, enc_hook=str)


def _write(path, content, sort):
    path.write_text(yaml.safe_dump(content, sort_keys=sort, allow_unicode=True), encoding="utf-8")
