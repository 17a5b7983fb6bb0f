"""summary.json and the table that is printed after a flight."""

import json
import math
import pathlib

import jinja2
import numpy as np

from data_extraction.flight_metrics import HOPS, percentiles_ms
from risc_lab.lab.yaml_reader import package_file

FIGURES = ("position_rmse_m", "position_max_m", "yaw_rmse_rad", "settle_s", "lag_s")  # of each vehicle


def summarise(flight, experiment, simulated, artefacts, origin=None, faults=None):
    """The summary of a flight as a dict ready for JSON; README of this package explains the keys.

    experiment: name; simulated: False, or a dict with the noise and delay model;
    artefacts: {'bag': path, 'csv_dir': path, 'plots': [paths], 'report': path}; origin: report.origin.Origin.
    faults: report.faults.Faults.
    `passed` is None until it has been judged.
    """
    duration_s = max((float(vehicle.t_s[-1]) for vehicle in flight.vehicles.values()), default=0.0)
    delays_s = origin.command_delays_s() if origin else {}
    mocap = flight.mocap
    return {
        "experiment": experiment,
        "simulated": simulated,
        "passed": None,
        "duration_s": round(duration_s, 3),
        "judged_against": flight.judged_against,
        "vehicles": {
            name: {key: getattr(vehicle, key) for key in FIGURES} | {"command_delay_s": delays_s.get(name)}
            for name, vehicle in flight.vehicles.items()
        },
        "latency_ms": {hop: percentiles_ms(flight.latency_s.get(hop, np.array([]))) for hop in HOPS},
        "mocap": {
            **vars(mocap),
            "frames_passed_over": mocap.frames_received - mocap.frames_estimated,
            "rate_hz": round(mocap.rate_hz, 3),
            "wanted_hz": None,
            "given_up": [],
        },
        "cpu_cores": {},
        "memory_mb": {},
        "computer": {},
        **(origin.processors if origin else {}),
        "faults": faults.figures() if faults else [],
        "bearings": flight.bearings.figures() if flight.bearings is not None else None,
        "artefacts": artefacts,
    }


def write(summary, path):
    """Write the summary as JSON; NaN is not JSON, so a number that does not exist must be None."""
    pathlib.Path(path).write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def table(summary):
    """The summary as text for a terminal."""
    return templates(autoescape=False).get_template("summary.txt").render(summary).rstrip("\n")


def templates(autoescape, folder=None):
    """Jinja environment with this package's templates, and those of another folder."""
    folders = [package_file("data_extraction", "templates"), *filter(None, [folder])]
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folders),
        autoescape=autoescape,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["pi"] = math.pi
    return environment
