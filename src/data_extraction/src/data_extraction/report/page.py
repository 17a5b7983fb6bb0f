"""The report as one HTML page that needs nothing but itself. What it says: templates/report.html, sections.html."""

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
from data_extraction.report.ladder import by_rule, raised
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
    return environment.get_template("report.html").render(
        material=material,
        summary=summary,
        zero_s=material.zero_s,
        raised=raised(material.ladder),
        most_changes=_MOST_CHANGES,
        number=lambda what: next(numbers[what]),
        plots=plots,
        hops=HOPS,
        cell_m=CELL_M,
        gap_s=GAP_S,
        pi=math.pi,
    )


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
    "by_rule": by_rule,
    "clock": lambda time_s, digits=1: _unit(round(time_s, digits) + 0.0, 1.0, "s", digits),
    "date": _date,
    "expected": expected,
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
