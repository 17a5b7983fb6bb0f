"""Table of how faults ended, a row for each, over one or more soaks. No input or output but `read`."""

import json
from collections import Counter

import numpy as np

RECORD = "soak.jsonl"
HEAD = ("fault", "events", "reactions", "p50 [ms]", "p99 [ms]", "max [ms]", "outcomes", "not safe")


def read(folder):
    """Faults of a soak's folder, as its flights' `faults`. Raises ValueError when it is not such a folder, OSError."""
    faults = []
    path = folder / RECORD
    with path.open(encoding="utf-8") as lines:
        for number, line in enumerate(lines, 1):
            try:
                entry = json.loads(line)
            except ValueError:
                if line.endswith("\n"):  # else a line that was not finished when the power failed
                    raise ValueError("%s, line %d: not a line of a soak" % (path, number)) from None
                break
            if entry["kind"] == "fault":
                faults.append(entry)
    return counted(faults)


def counted(faults):
    """The faults that began while a vehicle flew."""
    return [fault for fault in faults if fault["flying"]]


def rows_of(faults):
    """Rows of dicts, one for each fault and program, by name. Reactions: of every vehicle, as its commands tell."""
    by_name = {}
    for fault in faults:
        by_name.setdefault(":".join(filter(None, (fault["name"], fault["program"]))), []).append(fault)
    return [row_of(name, by_name[name]) for name in sorted(by_name)]


def percentiles(values, percents):
    """Percentiles that were measured (nearest rank): the p99 of fewer than 100 is the largest; None of no values."""
    return np.percentile(values, percents, method="inverted_cdf").tolist() if values else [None] * len(percents)


def row_of(name, faults):
    """One row, with `percentiles` of the reactions."""
    reactions_ms = [ms for fault in faults for ms in fault["reactions_ms"].values()]
    return {
        "fault": name,
        "events": len(faults),
        "reactions": len(reactions_ms),
        **dict(zip(("p50_ms", "p99_ms", "max_ms"), percentiles(reactions_ms, [50, 99, 100]))),
        "outcomes": dict(sorted(Counter(fault["outcome"] for fault in faults).items())),
        "unsafe": sum(not fault["safe"] for fault in faults),
    }


def number(value, digits, factor=1.0):
    """Text of a figure; None: not known."""
    return "–" if value is None else "%.*f" % (digits, factor * value)


def events_text(row):
    """How many faults, and how they ended, as text."""
    told = ", ".join("%d %s" % (count, outcome) for outcome, count in row["outcomes"].items())
    return "%d%s" % (row["events"], " (%s)" % told if told else "")


def cells(row):
    """Texts of a row, under HEAD."""
    times = [number(row[key], 1) for key in ("p50_ms", "p99_ms", "max_ms")]
    outcomes = ", ".join("%s %d" % item for item in row["outcomes"].items())
    return [row["fault"], str(row["events"]), str(row["reactions"]), *times, outcomes, str(row["unsafe"])]


def markdown(head, rows, texts=(0,)):
    """Lines of a table. texts: columns that hold words."""
    lines = [head, ["---" if column in texts else "---:" for column in range(len(head))], *rows]
    return ["| %s |" % " | ".join(map(str, line)) for line in lines]


def faults_table(faults):
    """Lines of a table: a row for each fault, and one for all together."""
    rows = rows_of(faults)
    if len(rows) > 1:
        rows.append(row_of("all", faults))
    return markdown(HEAD, map(cells, rows), (0, 6))
