"""The report as one HTML page that needs nothing but itself. What it says of each subject: templates/sections.html."""

import base64
import datetime
import math
import pathlib
from itertools import count

import jinja2
import numpy as np

from data_extraction import plots
from data_extraction import summary as summaries
from data_extraction.flight_metrics import HOPS, percentiles_ms
from data_extraction.report.drops import CELL_M, GAP_S
from data_extraction.report.events import head_and_tail
from data_extraction.report.gates import GATES, TITLES
from data_extraction.report.ladder import by_reason, raised
from data_extraction.report.topics import expected, vehicle_of
from risc_lab.lab.yaml_reader import package_file

_MOST_CHANGES = 25  # of a table of the loss ladder
_UNITS = {"m": "m", "s": "s", "rad": "rad", "deg": "°", "pct": "%", "ms": "ms", "hz": "Hz"}
_UNKNOWN = "unknown"
# What only the program that flew knows; a report that is made again takes it from the summary beside the bag.
JUDGED = (
    "experiment", "simulated", "passed", "reasons", "limits", "least_separation_m", "lab_late_ms", "video_late_ms",
    "on_schedule",
)  # fmt: skip
ASKED = ("wanted_hz", "given_up")  # of its motion capture, likewise


def summary_of(material):
    """The summary of a bag that nobody judges now: its figures, and what the summary beside it says."""
    beside = material.origin.summary
    experiment = material.origin.flight.get("experiment")
    result = summaries.summarise(material.flight, experiment, material.is_simulated and {}, {}, material.origin)
    result.update({key: beside[key] for key in JUDGED if key in beside})
    result["mocap"].update({key: beside["mocap"][key] for key in ASKED if key in beside.get("mocap", {})})
    return result


def write(path, material, summary):
    """Write the page. summary: of `summary_of`, or of a flight that has just been judged. Returns the path."""
    path = pathlib.Path(path)
    with plots.style():
        path.write_text(_render(material, summary), encoding="utf-8")
    return path


def _render(material, summary):
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(package_file("data_extraction", "templates")),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(_FILTERS)
    numbers = {"figure": count(1), "table": count(1)}
    subjects = list(_subjects(material, summary))
    return environment.get_template("report.html").render(
        title=_title(material, summary),
        material=material,
        summary=summary,
        zero_s=material.zero_s,
        simulated=material.is_simulated or bool(summary.get("simulated")),
        glance=_glance(material, summary),
        sections=[(key, title) for key, title, found, _ in subjects if found],
        missing=[(title, reason) for _, title, found, reason in subjects if not found],
        raised=raised(material.ladder),
        most_changes=_MOST_CHANGES,
        bag=material.bag.path.name,
        number=lambda what: next(numbers[what]),
        plots=plots,
        hops=HOPS,
        cell_m=CELL_M,
        gap_s=GAP_S,
        pi=math.pi,
    )


def _subjects(material, summary):
    """(macro of sections.html and anchor, title, whether there is anything to say, why not) in their order."""
    flight = material.flight
    said = summary["vehicles"] or summary.get("reasons") or summary["mocap"]["given_up"]
    pictures = "; ".join(material.snapshot_notes) or "no pictures were recorded (image_rect_color, image_raw)"
    timed = any(len(values) for values in flight.latency_s.values())
    yield "flown", "What was flown", True, ""
    yield "result", "Result", said, "; ".join(flight.notes)
    yield "map", "Map of the arena", flight.paths, "no position of a vehicle was recorded (/cortex_raw)"
    yield ("tracking", "Desired and actual positions", flight.vehicles,
           "there is no reference (/trajectory) for a vehicle that was seen")  # fmt: skip
    yield "latency", "Latency", timed, "the times of the datagrams were not recorded (/mocap_time)"
    yield ("processors", "Processors", material.origin.processors,
           "what the programs took of the computer was not recorded (processors.json)")  # fmt: skip
    yield "mocap", "Motion capture", material.drops, "neither /mocap_data nor /cortex_raw was recorded"
    yield ("gates", "Gate decisions", material.gates,
           "the estimator's counters were not recorded (/estimator_status)")  # fmt: skip
    yield "ladder", "Loss ladder", material.ladder, "no vehicle's safety topic was recorded"
    yield "fence", "Fence margin", material.margins, "no position of a vehicle was recorded (/cortex_raw)"
    yield "battery", "Battery", material.batteries, "no vehicle's navdata with a charge was recorded"
    yield "cameras", "Camera pictures", material.snapshots, pictures
    yield ("bearings", "Bearings", flight.bearings,
           "no bearings with something to compare them with were recorded (/angles)")  # fmt: skip
    yield ("events", "Events of the operator", material.events,
           "no phase, joystick, order, mode or warning was recorded")  # fmt: skip
    yield "contents", "What the bag holds", True, ""


def _title(material, summary):
    """Experiment and, when it was chosen, the course; the bag's name when nobody knows."""
    course = material.origin.flight.get("arguments", {}).get("trajectory")
    return ", ".join(filter(None, (summary.get("experiment"), course))) or material.bag.path.stem


def _glance(material, summary):
    """[(figure, what it is), ...]: the few numbers that one looks for first; what is not known is left out."""
    found = []
    errors_m = [item["position_rmse_m"] for item in summary["vehicles"].values() if item["position_rmse_m"] is not None]
    if errors_m:
        found.append(("%.1f mm" % (1e3 * max(errors_m)), "RMSE of the worst of %d vehicles" % len(summary["vehicles"])))
    p99_ms = summary["latency_ms"]["datagram_to_cmd_vel"]["p99"]
    if p99_ms is not None:
        found.append(("%.1f ms" % p99_ms, "datagram to command, p99"))
    mocap = summary["mocap"]
    if mocap["frames_sent"]:
        lost = mocap["frames_sent"] - mocap["frames_received"]
        found.append(("%d of %d" % (lost, mocap["frames_sent"]), "frames lost"))
    if material.margins:
        found.append(("%.2f m" % min(item.least_m for item in material.margins.values()), "nearest to the net"))
    return found


def _uri(kind, data):
    return "data:%s;base64,%s" % (kind, base64.b64encode(data).decode("ascii"))


def _date(time_s):
    if time_s <= 0.0:
        return _UNKNOWN
    return datetime.datetime.fromtimestamp(time_s).astimezone().strftime("%Y-%m-%d %H:%M:%S %Z")


def _unit(value, factor, unit, digits=1):
    """A number with its unit, - when there is none."""
    if value is None:
        return "–"
    return "%.*f%s%s" % (digits, factor * value, "\u202f" if unit not in ("", "°") else "", unit)


def _quantity(key, value):
    """Words of a value that is named with its unit: net_margin_m, 0.05 -> net margin 0.05 m."""
    if isinstance(value, bool):
        return "%s: %s" % (key.replace("_", " "), "yes" if value else "no")
    name, _, unit = key.rpartition("_")
    if unit not in _UNITS:
        return "%s %s" % (key.replace("_", " "), value)
    name = name.replace("_", " ").replace("rmse", "RMSE").replace("rms", "RMS")
    return "%s %s%s%s" % (name, value, "" if unit == "deg" else "\u202f", _UNITS[unit])


def _spread(values_s):
    """Cells p50, p95, p99, largest, number of latencies [s]."""
    figures = percentiles_ms(values_s)
    p95 = 1e3 * np.percentile(values_s, 95) if len(values_s) else None
    cells = [_unit(value, 1.0, "ms", 2) for value in (figures["p50"], p95, figures["p99"], figures["max"])]
    return [*cells, "%d" % len(values_s)]


_FILTERS = {
    "by_reason": by_reason,
    "clock": lambda time_s, digits=1: _unit(round(time_s, digits) + 0.0, 1.0, "s", digits),
    "date": _date,
    "decision": lambda counter, gate: GATES[gate][counter],
    "expected": expected,
    "gate_title": lambda gate: TITLES[gate].capitalize(),
    "head_and_tail": head_and_tail,
    "jpeg": lambda data: _uri("image/jpeg", data),
    "pairs": lambda items: ", ".join("%s %s" % (k, v) for k, v in items.items() if v is not None and v is not False),
    "percent": lambda part, whole: _unit(100.0 * part / whole if whole else None, 1.0, "%", 2),
    "quantities": lambda items: ", ".join(_quantity(*item) for item in items.items()),
    "sentences": lambda notes: [note[:1].upper() + note[1:] + ("" if note.endswith(".") else ".") for note in notes],
    "spread": _spread,
    "svg": lambda figure: _uri("image/svg+xml", plots.as_svg(figure).encode("utf-8")),
    "unit": _unit,
    "vehicle_of": vehicle_of,
}
