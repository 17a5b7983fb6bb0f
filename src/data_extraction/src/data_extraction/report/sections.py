"""The sections of the report: what is said, tabled and drawn of each subject, or why there is nothing to say."""

import base64
import datetime
from dataclasses import dataclass, field

import numpy as np

from data_extraction import plots
from data_extraction.flight_metrics import HOPS, percentiles_ms
from data_extraction.report.drops import CELL_M, GAP_S, cell_edges
from data_extraction.report.events import head_and_tail
from data_extraction.report.gates import GATES, TITLES
from data_extraction.report.kinds import expected
from data_extraction.report.ladder import RULES
from data_extraction.report.naming import vehicle_of
from risc_control.failsafe import FailsafeLevel

UNKNOWN = "unknown"
_MOST_ROWS = 60  # of a table of events
_MOST_CHANGES = 25  # of a table of the loss ladder
_LEAST_CORES = 0.001  # that are worth a row
_TEXTS = 99  # columns that are numeric: none
_UNITS = {"m": "m", "s": "s", "rad": "rad", "deg": "°", "pct": "%", "ms": "ms", "hz": "Hz"}
HOP_TEXTS = {
    "exposure_to_datagram": "exposure to datagram (the camera system itself)",
    "datagram_to_mocap_data": "datagram to /mocap_data",
    "datagram_to_cortex_raw": "datagram to /cortex_raw",
    "datagram_to_controls": "datagram to /controls",
    "datagram_to_cmd_vel": "datagram to cmd_vel",
}


@dataclass
class Table:
    """Rows of texts under a heading."""

    caption: str
    columns: list[str]
    rows: list[list[str]]
    numeric: int = 1  # the columns from this one on are right-aligned


@dataclass
class Figure:
    """A picture that is part of the page."""

    caption: str
    uri: str  # data:
    small: bool = False  # several fit side by side
    plan: bool = False  # nearly square: needs not the page's whole width


@dataclass
class Section:
    """One subject."""

    key: str  # anchor
    title: str
    facts: list[tuple] = field(default_factory=list)  # (name, value)
    texts: list[str] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # after tables and figures


@dataclass
class Missing:
    """A subject of which the bag says nothing."""

    title: str
    reason: str


def all_sections(material, summary):
    """[Section or Missing, ...] in their order. summary: as data_extraction.summary makes it, judged or not."""
    with plots.style():
        return [
            make(material, summary)
            for make in (
                origin, result, arena, tracking, latency, processors, motion_capture, gates, ladder, fence, battery,
                cameras, bearings, events, contents,
            )
        ]  # fmt: skip


def origin(material, summary):
    """What was flown."""
    flight, about = material.origin.flight, material.origin
    simulated = summary.get("simulated") or {}
    arguments = flight.get("arguments", {})
    versions = flight.get("versions", {})
    facts = [
        ("experiment", summary.get("experiment") or UNKNOWN),
        ("begin", flight.get("started") or _date(material.start_s)),
        ("duration of the recording", "%.1f s" % material.duration_s),
        ("seed", _known(flight.get("seed", simulated.get("seed")))),
    ]
    if arguments:
        given = ("%s %s" % item for item in arguments.items() if item[1] is not None and item[1] is not False)
        facts.append(("arguments", ", ".join(given)))
    if material.is_simulated:
        model = ", ".join(_quantity(*item) for item in simulated.items())
        facts.append(("simulated: noise and delay model", model or UNKNOWN))
    facts += [
        ("revision", _known(flight.get("revision"))),
        ("versions", ", ".join("%s %s" % item for item in versions.items()) or UNKNOWN),
        ("parameters (SHA-256)", about.hash or UNKNOWN),
    ]
    section = Section("flown", "What was flown", facts)
    if about.fleet:
        rows = [
            [
                vehicle.namespace,
                vehicle.template,
                vehicle.type,
                vehicle.calibration or "none",
                "(%.2f, %.2f, %.2f) m, %.0f°" % (*vehicle.start.position_m, np.degrees(vehicle.start.yaw_rad)),
            ]
            for vehicle in about.fleet.vehicles
        ]
        columns = ["namespace", "template", "type", "camera calibration", "start"]
        section.tables.append(Table("The fleet %s." % about.fleet.name, columns, rows, numeric=_TEXTS))
    else:
        section.notes.append("There is no fleet file: the names are those of the original laboratory.")
    return section


def result(material, summary):
    """Whether it passed, and the figures of every vehicle."""
    section = Section("result", "Result")
    for reason in summary.get("reasons") or []:
        section.texts.append("Failed: %s." % reason)
    for rate in summary["mocap"]["given_up"]:
        text = "Motion capture at %g Hz was given up before take-off: %s."
        section.texts.append(text % (rate["rate_hz"], rate["reason"]))
    vehicles = summary["vehicles"]
    if not vehicles and not section.texts:
        return Missing("Result", "; ".join(material.flight.notes))
    if summary.get("passed") is None:
        section.texts.append("Nobody has judged this flight: the bag alone does not say whether it was a success.")
    section.notes += _sentences(material.flight.notes)
    if not vehicles:
        return section
    rows = [
        [
            name,
            _unit(item["position_rmse_m"], 1e3, "mm"),
            _unit(item["position_max_m"], 1e3, "mm"),
            _unit(item["yaw_rmse_rad"], np.degrees(1.0), "°", 2),
            _unit(item["settle_s"], 1.0, "s"),
            _unit(item["lag_s"], 1e3, "ms"),
        ]
        for name, item in vehicles.items()
    ]
    columns = ["vehicle", "RMSE", "largest error", "yaw RMSE", "settled after", "best-fit lag"]
    caption = (
        "Errors on the course after settling, judged against %s. The lag is the delay of the actual path that explains "
        "it best." % material.flight.judged_against
    )
    section.tables.append(Table(caption, columns, rows))
    if summary.get("limits"):
        limits = ", ".join(_quantity(*item) for item in summary["limits"].items())
        section.notes.append("Limits of a pass: %s." % limits)
    if summary.get("least_separation_m") is not None:
        section.notes.append("Vehicles came no closer than %.2f m to each other." % summary["least_separation_m"])
    if summary.get("on_schedule") is False:
        section.notes.append(
            "This computer had too little time: the virtual lab's frames were late by %.0f ms (p99), its pictures by "
            "%.0f ms, which is not fair to a controller or to bearings."
            % (summary["lab_late_ms"]["p99"], summary.get("video_late_ms") or 0.0)
        )
    return section


def arena(material, _summary):
    """The arena from above with all paths."""
    flight = material.flight
    if not flight.paths:
        return Missing("Map of the arena", "no position of a vehicle was recorded (/cortex_raw)")
    caption = "The arena from above, as one stands in it looking along x; positions from %s." % flight.judged_against
    if flight.vehicles:
        caption += " Bold: judged; dashed: desired, on the course."
    return Section("map", "Map of the arena", figures=[_figure(plots.arena_map(flight), caption, plan=True)])


def tracking(material, _summary):
    """Errors and axes over time."""
    flight = material.flight
    if not flight.vehicles:
        return Missing(
            "Desired and actual positions", "there is no reference (/trajectory) for a vehicle that was seen"
        )
    section = Section("tracking", "Desired and actual positions")
    section.figures.append(
        _figure(plots.errors(flight, None), "Position error of every vehicle; shaded: on the course and settled.")
    )
    for name, vehicle in flight.vehicles.items():
        caption = "%s: desired and actual position and yaw%s." % (
            name,
            "" if vehicle.lag_s is None else "; best-fit lag %.0f ms" % (1e3 * vehicle.lag_s),
        )
        section.figures.append(_figure(plots.axes_over_time(name, vehicle, None), caption))
    return section


def latency(material, _summary):
    """Time from the datagram to every hop."""
    hops = {hop: values for hop, values in material.flight.latency_s.items() if len(values)}
    if not hops:
        return Missing("Latency", "the times of the datagrams were not recorded (/mocap_time)")
    rows = [[HOP_TEXTS[hop], *_spread(hops.get(hop, np.zeros(0)))] for hop in HOPS]
    section = Section("latency", "Latency")
    columns = ["hop", "p50", "p95", "p99", "largest", "messages"]
    caption = "Time from the receipt of the mocap datagram to the arrival of the message that answers it."
    section.tables.append(Table(caption, columns, rows))
    rows = []
    for topic, values_s in material.flight.command_latency_s.items():
        vehicle = vehicle_of(topic)
        computer = material.computers.get(vehicle)
        there = (
            [_unit(value, 1.0, "ms", 1) for value in (computer.oldest_ms, computer.behind_ms)] if computer else ["", ""]
        )
        rows.append([vehicle, computer.name if computer else "not recorded", *_spread(values_s), *there])
    if rows:
        columns = ["vehicle", "flown by", *columns[1:], "oldest state answered there", "its clock is behind by"]
        caption = (
            "The commands of every vehicle, by the computer that flies it. The times hold the way back to the computer "
            "that records; the age of the oldest state that a command answered is by the flying computer's own clock."
        )
        section.tables.append(Table(caption, columns, rows))
    section.figures.append(_figure(plots.latency(material.flight, None), "How the latencies are spread (logarithmic)."))
    return section


def processors(material, _summary):
    """What the programs took of the computer that flew."""
    used = material.origin.processors
    if not used:
        return Missing("Processors", "what the programs took of the computer was not recorded (processors.json)")
    cores, computer, memory_mb = used["cpu_cores"], used["computer"], used.get("memory_mb", {})
    section = Section(
        "processors",
        "Processors",
        facts=[
            ("cores of the computer", "%d" % computer["cores"]),
            ("used by the flight", "%.2f cores" % sum(cores.values())),
            ("memory of the flight", _unit(sum(memory_mb.values()) or None, 1.0, "MB", 0)),
            ("used by other programs", "%.2f cores%s" % (computer["others"], _busiest(computer))),
            ("idle", _unit(computer["idle"], 100.0, "%", 0)),
            ("taken by the host of the virtual machine (steal)", _unit(computer["steal"], 100.0, "%", 1)),
        ],
    )
    rows = [
        [name, "%.3f" % value, _unit(memory_mb.get(name), 1.0, "MB", 0)]
        for name, value in cores.items()
        if value >= _LEAST_CORES
    ]
    caption = (
        "Programs of the flight: processor time, mean from take-off to landing; memory, each with its share of what "
        "several have in common."
    )
    section.tables.append(Table(caption, ["program", "cores", "memory"], rows))
    return section


def _busiest(computer):
    if computer["busiest_other_cores"] < _LEAST_CORES:
        return ""
    return ", most by %s (%.2f)" % (computer["busiest_other"], computer["busiest_other_cores"])


def _spread(values_s):
    """Cells p50, p95, p99, largest, number of latencies [s]."""
    figures = percentiles_ms(values_s)
    p95 = 1e3 * np.percentile(values_s, 95) if len(values_s) else None
    cells = [_unit(value, 1.0, "ms", 2) for value in (figures["p50"], p95, figures["p99"], figures["max"])]
    return [*cells, "%d" % len(values_s)]


def motion_capture(material, _summary):
    """Frames and markers that were lost, and where."""
    drops, frames = material.drops, material.flight.mocap
    if drops is None:
        return Missing("Motion capture", "neither /mocap_data nor /cortex_raw was recorded")
    section = Section("mocap", "Motion capture")
    if frames.frames_sent:
        section.texts.append(
            "Frames by their numbers on the wire: %d sent, %d received (%d lost), %d with states; %.2f Hz."
            % (
                frames.frames_sent,
                frames.frames_received,
                frames.frames_sent - frames.frames_received,
                frames.frames_estimated,
                frames.rate_hz,
            )
        )
    if drops.frames:
        gap = "" if drops.longest_gap_s is None else "; the longest time between two was %.0f ms" % (
            1e3 * drops.longest_gap_s
        )  # fmt: skip
        section.texts.append("%d frames in the bag, %d gaps of more than 100 ms%s." % (drops.frames, drops.gaps, gap))
        if drops.silent_end_s > GAP_S:
            section.texts.append(
                "The last frame came %.1f s before the end of the bag; that is counted as a gap." % drops.silent_end_s
            )
    if drops.markers:
        rows = [
            [name, "%d" % loss.frames, "%d" % loss.lost, _percent(loss.lost, loss.markers), "%d" % loss.blind_frames]
            for name, loss in drops.markers.items()
        ]
        columns = ["object", "frames", "markers lost", "of all its markers", "frames without a marker"]
        section.tables.append(Table("Markers that no camera saw.", columns, rows))
    if drops.vehicles:
        rows = [
            [name, "%d" % item.invisible, _percent(item.invisible, item.frames), "%d" % item.times, _unit(
                item.longest_s if item.times else None, 1e3, "ms", 0)]
            for name, item in drops.vehicles.items()
        ]  # fmt: skip
        columns = ["vehicle", "states invisible", "of all since first seen", "times lost", "longest"]
        section.tables.append(Table("Vehicles that the estimator did not see.", columns, rows))
    if drops.markers_lost or len(drops.lost_places_m):
        arena = material.flight.arena
        caption = (
            "Where markers were lost, in percent of those there (cells of %g m; white: fewer than %d markers)."
            % (CELL_M, max(1, drops.least_markers))
        )
        if drops.unplaced:
            caption += " %d lost markers of objects never seen before are not in it." % drops.unplaced
        section.figures.append(_figure(plots.drop_map(drops, *cell_edges(arena), arena), caption, plan=True))
    else:
        section.notes.append("Nothing was lost, so there is no map of losses.")
    return section


def gates(material, _summary):
    """What the estimator and the mocap client refused."""
    if not material.gates:
        return Missing("Gate decisions", "the estimator's counters were not recorded (/estimator_status)")
    section = Section("gates", "Gate decisions")
    for gate, counts in material.gates.items():
        rows = [
            [GATES[gate][key], "%d" % count, _percent(count, counts.frames)]
            for key, count in counts.refused.items()
            if count
        ]
        if rows:
            caption = "%s: what was refused, of %d frames." % (TITLES[gate].capitalize(), counts.frames)
            section.tables.append(Table(caption, ["decision", "times", "per frame"], rows))
        else:
            section.texts.append("%s: nothing was refused, of %d frames." % (TITLES[gate].capitalize(), counts.frames))
        never = [GATES[gate][key] for key, count in counts.refused.items() if not count]
        if never:
            section.notes.append("%s, never: %s." % (TITLES[gate].capitalize(), "; ".join(never)))
        if counts.unknown:
            section.notes.append("Bodies without a template, never estimated: %s." % counts.unknown)
    section.notes.append(
        "These are the nodes' own counters: they count from the start of the node, which may be before that of the bag."
    )
    return section


def ladder(material, _summary):
    """Where on the loss ladder every vehicle stood."""
    if not material.ladder:
        return Missing("Loss ladder", "no vehicle's safety topic was recorded")
    section = Section("ladder", "Loss ladder")
    caption = "Failsafe level of every vehicle over time: ok, hold (level, altitude held), land."
    if material.ladder_left_out:
        caption += " Nothing is drawn where there were more changes than are kept."
    section.figures.append(_figure(plots.ladder(material.ladder, material.zero_s), caption))
    left = [span for spans in material.ladder.values() for span in spans if span.level != FailsafeLevel.OK]
    if not left:
        section.texts.append("No vehicle left the lowest failsafe level.")
        return section
    rules = {}
    for span in left:
        rules.setdefault((span.vehicle, span.level, span.rule), []).append(span.end_s - span.begin_s)
    rows = [
        [
            vehicle, level.name.lower(), RULES[rule], "%d" % len(lengths_s), _clock(max(lengths_s), 2),
            _clock(sum(lengths_s), 2),
        ]
        for (vehicle, level, rule), lengths_s in sorted(rules.items())
    ]  # fmt: skip
    columns = ["vehicle", "level", "reason", "times", "longest", "altogether"]
    section.tables.append(
        Table("Why and for how long vehicles were on higher failsafe levels.", columns, rows, numeric=3)
    )
    left.sort(key=lambda span: (-span.level, span.begin_s))
    listed = sorted(left[:_MOST_CHANGES], key=lambda span: span.begin_s)
    rows = [
        [
            _clock(span.begin_s - material.zero_s, 2), span.vehicle, span.level.name.lower(), span.reason,
            _clock(span.end_s - span.begin_s, 2),
        ]
        for span in listed
    ]  # fmt: skip
    columns = ["time", "vehicle", "level", "reason", "lasted"]
    section.tables.append(Table("Ladder events.", columns, rows, numeric=4))
    left_out = len(left) - len(listed) + material.ladder_left_out
    if left_out:
        section.notes.append("%d further events are not listed; landings come first." % left_out)
    return section


def fence(material, _summary):
    """Distance from the net."""
    if not material.margins:
        return Missing("Fence margin", "no position of a vehicle was recorded (/cortex_raw)")
    rows = [
        [
            name,
            "%.2f m" % item.least_m,
            "(%.2f, %.2f, %.2f) m" % item.least_place_m,
            _clock(item.least_s - material.zero_s),
            "%.2f m" % item.least_ahead_m,
            "%g s" % item.limits.fence_lookahead_s,
            "%.2f m" % item.limits.fence_margin_m,
        ]
        for name, item in material.margins.items()
    ]
    columns = ["vehicle", "nearest to the net", "there", "at", "with look-ahead", "look-ahead", "limit"]
    caption = (
        "Distance from the net as the loss ladder sees it; with look-ahead: also of the place reached so much later."
    )
    section = Section("fence", "Fence margin", tables=[Table(caption, columns, rows)])
    if not material.origin.fence_limits():
        section.notes.append("The parameters of the flight are unknown: margins are those of the default fence.")
    section.figures.append(
        _figure(plots.fence_margin(material.margins, material.zero_s), "Distance from the net over time.")
    )
    return section


def battery(material, _summary):
    """Charge over time."""
    if not material.batteries:
        return Missing("Battery", "no vehicle's navdata with a charge was recorded")
    rows = [
        [name, "%.0f %%" % item.first_pct, "%.0f %%" % item.last_pct, "%.0f s" % item.air_s]
        for name, item in material.batteries.items()
    ]
    section = Section("battery", "Battery")
    section.tables.append(Table("Charge of the batteries.", ["vehicle", "at first", "at last", "in the air"], rows))
    section.figures.append(_figure(plots.battery(material.batteries, material.zero_s), "Charge over time."))
    return section


def cameras(material, _summary):
    """A few pictures with what was found in them."""
    if not material.snapshots:
        reason = "; ".join(material.snapshot_notes) or "no pictures were recorded (image_rect_color, image_raw)"
        return Missing("Camera pictures", reason)
    section = Section("cameras", "Camera pictures", notes=_sentences(material.snapshot_notes))
    for item in material.snapshots:
        found = ", ".join(item.found) or "nothing found"
        caption = "%s, %s camera, %s: %s." % (
            item.vehicle or "camera",
            item.camera,
            _clock(item.stamp_s - material.zero_s),
            found if item.has_regions else "nobody looked for anything",
        )
        section.figures.append(Figure(caption, _data_uri("image/jpeg", item.jpeg), small=True))
    return section


def bearings(material, _summary):
    """Errors of the bearings."""
    statistics = material.flight.bearings
    if statistics is None:
        return Missing("Bearings", "no bearings with something to compare them with were recorded (/angles)")
    rows = [
        [
            "%s: %s" % (vehicle, name),
            "%d" % figures["count"],
            *(
                _unit(figures[key + "_deg"], 1.0, "°", 3)
                for key in ("azimuth_bias", "elevation_bias", "azimuth_rms", "elevation_rms")
            ),
            _unit(figures["normalised_rms"], 1.0, "", 2).strip(),
            _unit(figures["seen_percent"], 1.0, "%", 0),
            "%d" % figures["false_alarms"],
        ]
        for vehicle, targets in statistics.figures()["vehicles"].items()
        for name, figures in targets.items()
    ]
    columns = ["bearing", "count", "azimuth bias", "elevation bias", "azimuth RMS", "elevation RMS"]
    columns += ["error / sigma", "found", "false"]
    caption = "Bearings of what was fully in the picture, against %s; landmarks from %s." % (
        statistics.truth,
        statistics.landmarks_from,
    )
    section = Section("bearings", "Bearings", tables=[Table(caption, columns, rows)])
    section.notes += _sentences(statistics.notes)
    if statistics.has_judged:
        text = "Errors of single bearings, and RMS of every vehicle and object."
        section.figures.append(_figure(plots.bearings(statistics, None), text))
    return section


def events(material, _summary):
    """What the operator did and was told."""
    if not material.events:
        return Missing("Events", "no phase, joystick, order, mode or warning was recorded")
    rows = [
        [
            _clock(event.time_s - material.zero_s),
            event.source,
            event.text + (" (%d times)" % event.count if event.count > 1 else ""),
        ]
        for event in head_and_tail(material.events, _MOST_ROWS)
    ]
    section = Section("events", "Events of the operator")
    section.tables.append(
        Table("Phases, buttons, orders, modes, warnings.", ["time", "who", "what"], rows, numeric=_TEXTS)
    )
    left_out = len(material.events) - len(rows) + material.events_left_out
    if left_out:
        section.notes.append(
            "%d further events are not listed: first warnings and buttons were left out, then what was in the middle."
            % left_out
        )
    return section


def contents(material, _summary):
    """What the bag holds."""
    size_mb = 1e-6 * material.bag_path.stat().st_size
    rows = [
        [topic, (material.types[topic] or "several types").replace("/msg/", "/"), "%d" % count,
         "%.1f Hz" % (count / max(material.duration_s, 1e-3))]
        for topic, count in sorted(material.topics.items())
    ]  # fmt: skip
    caption = "%s: %.1f MB, %.1f s from %s." % (
        material.bag_path.name,
        size_mb,
        material.duration_s,
        _date(material.start_s),
    )
    table = Table(caption, ["topic", "type", "messages", "rate"], rows, numeric=2)
    notes = [
        "%s was not read: it is of %s, the lab's is of type %s."
        % (topic, _type_text(material.types[topic]), expected(topic))
        for topic in sorted(material.foreign)
    ]
    return Section("contents", "What the bag holds", tables=[table], notes=notes)


def _type_text(kind):
    return "type " + kind.replace("/msg/", "/") if kind else "several types"


def _figure(figure, caption, plan=False):
    return Figure(caption, _data_uri("image/svg+xml", plots.as_svg(figure).encode("utf-8")), plan=plan)


def _data_uri(kind, data):
    return "data:%s;base64,%s" % (kind, base64.b64encode(data).decode("ascii"))


def _date(time_s):
    if time_s <= 0.0:
        return UNKNOWN
    return datetime.datetime.fromtimestamp(time_s).astimezone().strftime("%Y-%m-%d %H:%M:%S %Z")


def _known(value):
    return UNKNOWN if value is None else str(value)


def _unit(value, factor, unit, digits=1):
    if value is None:
        return "–"
    return "%.*f%s%s" % (digits, factor * value, "" if unit == "°" else "\u202f", unit)


def _quantity(key, value):
    """Words of a value that is named with its unit: net_margin_m, 0.05 -> net margin 0.05 m."""
    if isinstance(value, bool):
        return "%s: %s" % (key.replace("_", " "), "yes" if value else "no")
    name, _, unit = key.rpartition("_")
    if unit not in _UNITS:
        return "%s %s" % (key.replace("_", " "), value)
    name = name.replace("_", " ").replace("rmse", "RMSE").replace("rms", "RMS")
    return "%s %s%s%s" % (name, value, "" if unit == "deg" else "\u202f", _UNITS[unit])


def _clock(time_s, digits=1):
    """A time since the report's zero."""
    return "%.*f\u202fs" % (digits, round(time_s, digits) + 0.0)


def _percent(part, whole):
    return "–" if not whole else "%.2f\u202f%%" % (100.0 * part / whole)


def _sentences(notes):
    return [note[:1].upper() + note[1:] + ("" if note.endswith(".") else ".") for note in notes]
