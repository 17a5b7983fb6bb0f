"""The report as one self-contained HTML page. Its texts: templates/report.html, sections.html."""

import base64
import datetime
from itertools import count

from data_extraction import plots
from data_extraction import summary as summaries
from data_extraction.flight_metrics import HOPS, percentiles_ms
from data_extraction.report.drops import CELL_M, GAP_S
from data_extraction.report.events import head_and_tail
from data_extraction.report.ladder import by_rule, raised
from data_extraction.report.recorded_topics import expected, vehicle_of

_UNITS = {"m": "\u202fm", "s": "\u202fs", "rad": "\u202frad", "deg": "°", "pct": "\u202f%", "ms": "\u202fms",
          "hz": "\u202fHz"}  # fmt: skip
# Known to the flight's program only; a report that is made later takes it from the summary beside the bag.
JUDGED = (
    "experiment", "simulated", "passed", "reasons", "limits", "least_separation_m", "lab_late_ms", "video_late_ms",
    "on_schedule",
)  # fmt: skip
ASKED = ("wanted_hz", "given_up")  # of its motion capture, likewise


def summary_of(material):
    """The summary of a bag that is not judged now: its figures, and those of the summary beside it."""
    beside = material.origin.summary
    experiment = material.origin.flight.get("experiment")
    simulated = material.is_simulated and {}
    result = summaries.summarise(material.flight, experiment, simulated, {}, material.origin, material.faults)
    result.update({key: beside[key] for key in JUDGED if key in beside})
    result["mocap"].update({key: beside["mocap"][key] for key in ASKED if key in beside.get("mocap", {})})
    return result


def write(path, material, summary):
    """Write the page. summary: of `summary_of`, or of a flight that has just been judged. Returns the path."""
    path.write_text(render("report.html", material=material, summary=summary), encoding="utf-8")
    return path


def render(template, folder=None, **values):
    """Text of a page in the style of the reports. folder: where its template is; None = the reports' folder."""
    environment = summaries.templates(autoescape=True, folder=folder)
    environment.filters.update(_FILTERS)
    environment.globals.update(plots=plots, hops=HOPS, cell_m=CELL_M, gap_s=GAP_S)
    numbers = {"figure": count(1), "table": count(1)}
    with plots.style():
        return environment.get_template(template).render(number=lambda what: next(numbers[what]), **values)


def _uri(kind, data):
    return "data:%s;base64,%s" % (kind, base64.b64encode(data).decode("ascii"))


def _unit(value, factor, unit, digits=1):
    """A number with its unit, - when there is none."""
    if value is None:
        return "–"
    return "%.*f%s%s" % (digits, factor * value, "\u202f" if unit not in ("", "°") else "", unit)


def _quantity(key, value):
    """Text of a value whose name ends in its unit: net_margin_m, 0.05 -> net margin 0.05 m."""
    if isinstance(value, bool):
        return "%s: %s" % (key.replace("_", " "), "yes" if value else "no")
    name, _, unit = key.rpartition("_")
    if unit not in _UNITS:
        return "%s %s" % (key.replace("_", " "), value)
    return "%s %s%s" % (name.replace("_", " ").replace("rmse", "RMSE").replace("rms", "RMS"), value, _UNITS[unit])


def _spread(values_s):
    """Cells p50, p95, p99, largest, number of latencies [s]."""
    figures = percentiles_ms(values_s, {"p50": 50, "p95": 95, "p99": 99, "max": 100})
    return [_unit(value, 1.0, "ms", 2) for value in figures.values()] + [len(values_s)]


_FILTERS = {
    "by_rule": by_rule,
    "clock": lambda time_s, digits=1: _unit(round(time_s, digits) + 0.0, 1.0, "s", digits),
    "date": lambda time_s: datetime.datetime.fromtimestamp(time_s).astimezone().strftime("%Y-%m-%d %H:%M:%S %Z")
    if time_s > 0.0
    else "unknown",
    "expected": expected,
    "head_and_tail": head_and_tail,
    "jpeg": lambda data: _uri("image/jpeg", data),
    "pairs": lambda items: ", ".join("%s %s" % (k, v) for k, v in items.items() if v is not None and v is not False),
    "percent": lambda part, whole: _unit(100.0 * part / whole if whole else None, 1.0, "%", 2),
    "raised": raised,
    "quantities": lambda items: ", ".join(_quantity(*item) for item in items.items()),
    "sentences": lambda notes: [note[:1].upper() + note[1:] + ("" if note.endswith(".") else ".") for note in notes],
    "spread": _spread,
    "svg": lambda figure: _uri("image/svg+xml", plots.as_svg(figure).encode("utf-8")),
    "unit": _unit,
    "vehicle_of": vehicle_of,
}
