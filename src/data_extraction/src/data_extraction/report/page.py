"""The report as one HTML page that needs nothing but itself."""

import pathlib
from itertools import count

import jinja2

from data_extraction import summary as summaries
from data_extraction.report.sections import Missing, Section, all_sections
from risc_lab.lab.yaml_reader import package_file

TEMPLATE = "templates/report.html"
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
    processors = material.origin.processors
    result = summaries.summarise(material.flight, experiment, material.is_simulated and {}, {}, processors)
    result.update({key: beside[key] for key in JUDGED if key in beside})
    result["mocap"].update({key: beside["mocap"][key] for key in ASKED if key in beside.get("mocap", {})})
    return result


def write(path, material, summary):
    """Write the page. summary: of `summary_of`, or of a flight that has just been judged. Returns the path."""
    path = pathlib.Path(path)
    path.write_text(render(all_sections(material, summary), material, summary), encoding="utf-8")
    return path


def render(sections, material, summary):
    """Text of the page."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(package_file("data_extraction", TEMPLATE).read_text(encoding="utf-8"))
    numbers = {"figure": count(1), "table": count(1)}
    return template.render(
        title=_title(material, summary),
        summary=summary,
        simulated=material.is_simulated or bool(summary.get("simulated")),
        glance=_glance(material, summary),
        sections=[section for section in sections if isinstance(section, Section)],
        missing=[section for section in sections if isinstance(section, Missing)],
        bag=material.bag_path.name,
        number=lambda what: next(numbers[what]),
    )


def _title(material, summary):
    """Experiment and, when it was chosen, the course; the bag's name when nobody knows."""
    course = material.origin.flight.get("arguments", {}).get("trajectory")
    return ", ".join(filter(None, (summary.get("experiment"), course))) or material.bag_path.stem


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
        found.append(
            ("%d of %d" % (mocap["frames_sent"] - mocap["frames_received"], mocap["frames_sent"]), "frames lost")
        )
    if material.margins:
        found.append(("%.2f m" % min(item.least_m for item in material.margins.values()), "nearest to the net"))
    return found
