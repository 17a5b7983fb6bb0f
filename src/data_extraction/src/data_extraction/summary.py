"""summary.json and the table that is printed after a flight."""

import json
import pathlib

import numpy as np

from data_extraction.flight_metrics import HOPS, percentiles_ms

FIGURES = ("position_rmse_m", "position_max_m", "yaw_rmse_rad", "settle_s", "lag_s")  # of each vehicle
_MOST_PROGRAMS = 5  # that are named in the table


def summarise(flight, experiment, simulated, artefacts, origin=None):
    """The summary of a flight as a dict ready for JSON; README of this package explains the keys.

    experiment: name; simulated: False, or a dict that says the noise and delay model;
    artefacts: {'bag': path, 'csv_dir': path, 'plots': [paths], 'report': path}; origin: report.origin.Origin.
    `passed` is None until somebody has judged.
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
        "bearings": flight.bearings.figures() if flight.bearings is not None else None,
        "artefacts": artefacts,
    }


def write(summary, path):
    """Write the summary as JSON; NaN is not JSON, so a number that does not exist must be None."""
    pathlib.Path(path).write_text(json.dumps(summary, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def table(summary):
    """The summary as text for a terminal."""
    row, hop_row = "%-14s" + 5 * " %10s", "%-26s" + 3 * " %10s"
    lines = [row % ("vehicle", "RMSE", "max", "yaw RMSE", "settled", "lag")]
    units = ((1e3, "mm"), (1e3, "mm"), (np.degrees(1.0), "deg"), (1.0, "s"), (1e3, "ms"))
    for name, figures in summary["vehicles"].items():
        lines.append(row % (name, *(_unit(figures[key], *unit) for key, unit in zip(FIGURES, units))))
    lines += ["", hop_row % ("latency", "p50", "p99", "max")]
    for hop, figures in summary["latency_ms"].items():
        cells = (_unit(figures[key], 1.0, "ms", 2) for key in ("p50", "p99", "max"))
        lines.append(hop_row % (hop.replace("_", " "), *cells))
    mocap = summary["mocap"]
    counts = (mocap["frames_sent"], mocap["frames_received"], mocap["frames_passed_over"], mocap["rate_hz"])
    lines += ["", "mocap: %d frames sent, %d received, %d of them passed over, %.2f Hz" % counts]
    cores = summary["cpu_cores"]
    if cores:
        largest = ", ".join("%s %.2f" % item for item in list(cores.items())[:_MOST_PROGRAMS])
        lines.append("processor cores: %.2f in all; %s" % (sum(cores.values()), largest))
    lines.append("positions judged against %s" % summary["judged_against"])
    if summary["bearings"] is not None:
        lines += ["", *_bearing_lines(summary["bearings"])]
    return "\n".join(lines)


def _bearing_lines(bearings):
    heading = ("bearing", "count", "azimuth", "elevation", "az. RMS", "el. RMS", "/ sigma", "found", "false")
    yield "%-26s %7s %11s %11s %10s %10s %8s %8s %6s" % heading
    for vehicle, targets in bearings["vehicles"].items():
        for name, figures in targets.items():
            keys = ("azimuth_bias_deg", "elevation_bias_deg", "azimuth_rms_deg", "elevation_rms_deg")
            yield "%-26s %7d %11s %11s %10s %10s %8s %8s %6d" % (
                "%s: %s" % (vehicle, name),
                figures["count"],
                *(_unit(figures[key], 1.0, "deg", 3) for key in keys),
                _unit(figures["normalised_rms"], 1.0, "", 2).strip(),
                _unit(figures["seen_percent"], 1.0, "%", 0),
                figures["false_alarms"],
            )
    sources = bearings["truth"], bearings["landmarks_from"]
    yield "bearings of what is fully seen, against %s, landmarks from %s" % sources
    yield from bearings["notes"]


def _unit(value, factor, unit, digits=1):
    return "-" if value is None else "%.*f %s" % (digits, factor * value, unit)
