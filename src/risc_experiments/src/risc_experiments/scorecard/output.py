"""A scorecard as text, tables, pictures and a page. It is a dict, as in its JSON file; see `__main__.scorecard_of`."""

import csv
import json
import math
import operator

import matplotlib.pyplot as plt
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, NullFormatter

from data_extraction import plots
from data_extraction.report import page
from risc_control.safety import SafetyLimits
from risc_experiments.scorecard.figures import COUNTED, KEY
from risc_experiments.scorecard.plan import GRADES
from risc_experiments.soak import table
from risc_lab.lab.yaml_reader import package_file

_SCALARS = (
    *KEY, "minutes", "vehicle_minutes", "flights", "failed", "rmse_m", "worst_m", "net_m", "events", "detected",
    "detect_p50_ms", "detect_p99_ms", "unsafe", *COUNTED,
)  # fmt: skip
_COLOURS = {grade: plots.COLOURS[k] for grade, k in zip(GRADES, (2, 4, 1))}
_OTHER = plots.COLOURS[0]
_SHIFT = dict(zip(GRADES, (-0.22, 0.0, 0.22)))  # of a line of the picture, for each grade
_LINE = operator.itemgetter("fault", "estimator", "controller")  # identifies a line of the picture
_CONDITIONS = ("ladder", "trajectories", "vehicles", "flight_s", "events", "random")
_MARKERS = {"breaches": "X", "contacts": "P", "false_alarms": "v"}
# factor, unit, digits of a figure in a comparison
_UNITS = {"rmse_m": (1e3, "mm", 1), "detect_p50_ms": (1.0, "ms", 0), "detected": (100.0, "%", 0)}
_PER_MINUTE = (1.0, "per minute", 2)
WORDS = {
    "rmse_m": "RMSE", "detect_p50_ms": "detection, p50", "detected": "events detected", "false_alarms": "false alarms",
    "breaches": "breaches", "contacts": "contacts",
}  # fmt: skip


def write_all(scorecard, folder):
    """Write it in every form. Returns {form: path}."""
    paths = {form: folder / ("scorecard." + form) for form in ("md", "csv", "json", "png", "html")}
    write_json(scorecard, paths["json"])
    paths["md"].write_text(markdown(scorecard), encoding="utf-8")
    with paths["csv"].open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, _SCALARS, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(scorecard["rows"])
    with plots.style():
        figure = draw(scorecard)
        figure.savefig(paths["png"])
        plt.close(figure)
    templates = package_file("risc_experiments", "templates")
    text = page.render("scorecard.html", templates, **page_values(scorecard))
    paths["html"].write_text(text, encoding="utf-8")
    return paths


def page_values(scorecard):
    """Variables of the page's template."""
    return {
        "card": {"against": None} | scorecard, "pairs": _pairs(scorecard["rows"]), "head": HEAD, "meaning": MEANING,
        "most_named": MOST_NAMED, "draw": draw, "cells": cells, "compared": compared, "rate": rate,
        "minutes_text": minutes_text, "net_text": net_text, "otherwise": OTHERWISE,
    }  # fmt: skip


def read(path):
    """A scorecard from its JSON file. Raises ValueError for any other file, OSError."""
    try:
        scorecard = json.loads(path.read_text(encoding="utf-8"))
        if all(set(KEY) | {"flight_rmse_m", "detect_ms"} <= row.keys() for row in scorecard["rows"]):
            return scorecard
    except (ValueError, TypeError, KeyError, AttributeError):
        pass
    raise ValueError("%s is not a scorecard: give the JSON file of another ./maap scorecard" % path)


def differing_conditions(scorecard, other):
    """Names of the conditions in which two scorecards differ: a difference of figures may come from them."""
    here, there = ({"ladder": card.get("ladder"), **card.get("settings", {})} for card in (scorecard, other))
    as_read = json.dumps  # one may not have been read from a file
    return [name for name in _CONDITIONS if as_read(here.get(name)) != as_read(there.get(name))]


def write_json(scorecard, path):
    """Write the JSON file."""
    path.write_text(json.dumps(scorecard, indent=1, allow_nan=False) + "\n", encoding="utf-8")


HEAD = (
    "fault", "severity", "estimator", "controller", "minutes", "RMSE [mm]", "worst [mm]", "detected", "p50 [ms]",
    "p99 [ms]", "false alarms (per minute)", "breaches (per minute)", "contacts (per minute)",
)  # fmt: skip


def cells(row):
    """Texts of a row, under HEAD."""
    share = "–"
    if row["events"]:
        low, high = row["detected_bounds"]
        share = "%d of %d (%.0f–%.0f %%)" % (row["detected"], row["events"], 100.0 * low, 100.0 * high)
    counted = ["%d (%s)" % (row[what], rate(row, what)) for what in COUNTED]
    return [*(row[key] for key in KEY), minutes_text(row["minutes"]), table.number(row["rmse_m"], 1, 1e3),
            table.number(row["worst_m"], 0, 1e3), share, table.number(row["detect_p50_ms"], 0),
            table.number(row["detect_p99_ms"], 0), *counted]  # fmt: skip


def minutes_text(minutes):
    """E.g. 2.0; 10,000."""
    return "{:,.0f}".format(minutes) if minutes >= 1000.0 else "%.1f" % minutes


def net_text(row):
    """Least distance of a vehicle's centre to the net's sides and ceiling, e.g. 0.41 m."""
    return table.number(row["net_m"], 2) + " m"


def rate(row, what):
    """95 % bounds of a rate per minute, as text: "< 3e-4" for what has never happened."""
    bounds = row[what + "_per_minute_bounds"]
    if bounds is None:
        return "–"
    low, high = bounds
    if row[what] == 0:
        return "< %s" % _short(high)
    return "%s to %s" % (_short(low, up=False), _short(high))


def _short(value, up=True):
    """A number to two digits, rounded outwards: 3e-4, 0.025."""
    exponent = math.floor(math.log10(value) + 1e-9)
    digits = value / 10.0**exponent * 10.0
    digits = math.ceil(digits - 1e-6) if up else math.floor(digits + 1e-6)
    value = digits / 10.0 * 10.0**exponent
    if exponent >= -2:
        return "%g" % value
    return ("%.1e" % value).replace(".0e", "e").replace("e-0", "e-")


def markdown(scorecard):
    """The scorecard as Markdown, which is also printed on the terminal."""
    totals = scorecard["totals"]
    ladder = "" if scorecard["ladder"] else ", without the safety ladder"
    revision = scorecard["revision"] or "unknown"
    lines = ["# Scorecard (simulated)" + ladder, ""]
    lines += ["%s, revision %s: `%s`" % (scorecard["date"], revision, scorecard["command"]), ""]
    lines += table.markdown(HEAD, map(cells, scorecard["rows"]), range(len(KEY)))
    counted = ["%d %s (%s per minute)" % (totals[what], WORDS[what], rate(totals, what)) for what in COUNTED]
    times = [minutes_text(totals[what]) for what in ("minutes", "vehicle_minutes")]
    flown = *times, totals["flights"], totals["events"], ", ".join(counted)
    lines += ["", "In all %s minutes (%s of single vehicles) in %d flights, %d faults: %s." % flown]
    lines += ["Nearest to the net: %s from a vehicle's centre." % net_text(totals)]
    lines += ["In brackets: bounds of 95 %. " + MEANING, ""]
    if not scorecard["complete"]:
        lines += ["It is not complete: it was interrupted.", ""]
    for failure in scorecard["failures"][:MOST_NAMED]:
        lines.append("- not flown: %s, seed %d: %s" % (_of(failure), failure["seed"], failure["error"]))
    for finding in scorecard["findings"][:MOST_NAMED]:
        lines.append("- %s: %s, seed %d: %s" % (finding["what"], _of(finding), finding["seed"], finding["text"]))
    left = len(scorecard["failures"][MOST_NAMED:]) + len(scorecard["findings"][MOST_NAMED:])
    if left:
        lines.append("- and %d more, see the JSON file" % left)
    if "against" in scorecard:
        lines += [""] * bool(lines[-1]) + ["## Against %s" % scorecard["against"]["file"], ""]
        if scorecard["against"]["conditions"]:
            lines += [OTHERWISE % ", ".join(scorecard["against"]["conditions"]), ""]
        items = [item for item in scorecard["against"]["differences"] if item["significant"]]
        if items:
            lines += [*table.markdown((*KEY, "figure", "here", "there", "p"), map(compared, items), range(5)), ""]
        lines += ["%d of %d figures of the same rows differ significantly (5 %% in all, Holm)." % (
            len(items), len(scorecard["against"]["differences"]))]  # fmt: skip
    return "\n".join(lines).rstrip() + "\n"


MOST_NAMED = 20
OTHERWISE = "The two were not flown under the same conditions (%s): differences may come from that."
MEANING = (
    "Errors: against truth, while on the course. Detected: from the start of a fault to the first failsafe level above "
    "OK, or until a vehicle is not seen any more, whichever is first; the p99 of fewer than 100 is the largest. False "
    "alarms: levels above OK that no fault explains. Breaches: the centre of a vehicle reached the net, or it fell or "
    "landed hard. Contacts: two vehicles touched. A minute counts once for the whole fleet, on the course, until all "
    "of it has landed; minutes of single vehicles are those that each was up."
)


def _of(item):
    return " ".join(str(item[key]) for key in KEY)


def compared(item):
    """Texts of a difference."""
    factor, unit, digits = _UNITS.get(item["figure"], _PER_MINUTE)
    values = ["%s %s" % (table.number(item[key], digits, factor), unit) for key in ("here", "there")]
    p = "–" if item["p"] is None else "%.2g" % item["p"]
    return [*(item[key] for key in KEY), WORDS[item["figure"]], *values, p]


def _pairs(rows):
    """(estimator, controller) of all rows."""
    return list(dict.fromkeys((row["estimator"], row["controller"]) for row in rows))


def draw(scorecard):
    """The figure of all rows: errors, delays until detection, and what should not have happened."""
    rows = scorecard["rows"]
    pairs = _pairs(rows)
    names = list(dict.fromkeys(map(_LINE, rows)))
    places = {name: len(names) - 1 - place for place, name in enumerate(names)}
    figure, (error, delay, bad) = plt.subplots(1, 3, sharey=True, figsize=(10.0, 1.6 + 0.27 * len(names)))
    for row in rows:
        y = places[_LINE(row)] - _SHIFT.get(row["severity"], 0.0)
        colour = _COLOURS.get(row["severity"], _OTHER)
        if row["rmse_m"] is not None:
            error.plot([1e3 * row["rmse_m"], 1e3 * row["worst_m"]], [y, y], color=colour, linewidth=1.0)
            error.plot(1e3 * row["rmse_m"], y, "o", color=colour, markersize=4)
        if row["detect_p50_ms"] is not None:
            delay.plot([row["detect_p50_ms"], row["detect_p99_ms"]], [y, y], color=colour, linewidth=1.0)
            delay.plot(row["detect_p50_ms"], y, "o", color=colour, markersize=4,
                       markerfacecolor=colour if 2 * row["detected"] >= row["events"] else "white")  # fmt: skip
        low, high = row["breaches_per_minute_bounds"] or (0.0, 0.0)
        bad.plot([low, high], [y, y], color=colour, linewidth=1.0)
        for what, marker in _MARKERS.items():
            if row[what]:
                bad.plot(row[what] / row["minutes"], y, marker, color=colour, markersize=6, clip_on=False)
    error.set_yticks(list(places.values()), [", ".join(name[:1] if len(pairs) == 1 else name) for name in names])
    error.set_ylim(-0.6, len(names) - 0.4)
    error.set_xscale("log")
    delay.set_xscale("log")
    bad.set_xscale("symlog", linthresh=0.01)
    bad.set_xlim(0.0, max(bad.get_xlim()[1], 0.1))
    error.set_title("error [mm]: RMSE (dot) to worst")
    delay.set_title("detection [ms]: p50 (dot) to p99")
    bad.set_title("per minute; line: bounds of breaches")
    for axes in (error, delay):
        low, high = axes.dataLim.intervalx
        margin = 1.3 if high > 5.0 * low else 2.0  # a narrow axis would have a single number
        axes.set_xlim(*((low / margin, high * margin) if 0.0 < low <= high < math.inf else (10.0, 1000.0)))
        axes.xaxis.set_major_locator(LogLocator(subs=_ticks_of(*axes.get_xlim())))
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter(NullFormatter())
    delay.axvline(1e3 * SafetyLimits.state_hold_s, color="#888888", linewidth=0.8, linestyle=":")
    known = {row["severity"] for row in rows}
    handles = [_dot(_COLOURS[grade], grade) for grade in GRADES if grade in known]
    if known - set(GRADES):
        handles.append(_dot(_OTHER, "without grades"))
    handles.append(_dot("#444444", "less than half detected", markerfacecolor="white"))
    handles += [Line2D([], [], marker=marker, linestyle="", color="#444444", label=WORDS[what])
                for what, marker in _MARKERS.items()]  # fmt: skip
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
    ladder = "" if scorecard["ladder"] else ", without the safety ladder"
    figure.suptitle("Scorecard of %s min (simulated)%s" % (minutes_text(scorecard["totals"]["minutes"]), ladder))
    return figure


def _dot(colour, label, **style):
    """An entry of the legend."""
    return Line2D([], [], marker="o", linestyle="", markersize=4, color=colour, label=label, **style)


def _ticks_of(low, high):
    """Multiples of powers of ten whose labels have room on a logarithmic axis."""
    decades = math.log10(high / low)
    return (1.0, 2.0, 5.0) if decades < 2.0 else (1.0, 3.0) if decades < 3.5 else (1.0,)
