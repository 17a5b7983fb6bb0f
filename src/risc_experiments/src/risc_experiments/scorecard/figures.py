"""The figures of a scorecard, each probability with its 95 % bounds, and how two scorecards differ. No input or output.

Bounds are exact: Poisson for rates, Clopper-Pearson for shares. A rate of events that never happened has only an upper
bound, by the rule of three: 3 divided by the time flown.
"""

import math
import pathlib
from collections import Counter

from scipy import stats

from risc_experiments.soak.table import percentiles

CONFIDENCE = 0.95
RULE_OF_THREE = 3.0
COUNTED = ("false_alarms", "breaches", "contacts")
KEY = ("fault", "severity", "estimator", "controller")
_LEAST_PAIRS = 6  # of flights: fewer cannot differ significantly
_DETECT = {"detect_p50_ms": 50, "detect_p99_ms": 99}


def key_of(cell):
    """The KEY of a row as a dict, with the name of a file of faults in place of its path."""
    return dict(zip(KEY, cell)) | {"fault": pathlib.PurePath(cell.fault).name}


def row_of(cell, flights):
    """A row of the scorecard. cell: plan.Cell.  flights: {seed: figures}, see `flights.score`."""
    flown = {seed: figures for seed, figures in flights.items() if "error" not in figures}
    events = [event for figures in flown.values() for event in figures["events"]]
    delays_ms = [delay_ms for *_, delay_ms, _ in events if delay_ms is not None]
    minutes, vehicle_minutes = (
        sum(figures[what] for figures in flown.values()) for what in ("minutes", "vehicle_minutes")
    )
    samples = sum(figures["samples"] for figures in flown.values())
    square_m2 = sum(figures["square_m2"] for figures in flown.values())
    row = key_of(cell) | {
        "minutes": round(minutes, 4),
        "vehicle_minutes": round(vehicle_minutes, 4),
        "flights": len(flown),
        "failed": len(flights) - len(flown),
    }
    row["rmse_m"] = round(math.sqrt(square_m2 / samples), 6) if samples else None
    row["worst_m"] = max((figures["worst_m"] for figures in flown.values() if figures["samples"]), default=None)
    row["net_m"] = min((figures["net_m"] for figures in flown.values()), default=None)
    row |= dict(zip(_DETECT, percentiles(delays_ms, list(_DETECT.values()))))
    row |= {"events": len(events), "detected": len(delays_ms)}
    row["detected_bounds"] = share_bounds(len(delays_ms), len(events))
    row["detected_by"] = dict(Counter(how for *_, how in events if how is not None))
    row["outcomes"] = dict(Counter(outcome for _, _, outcome, *_ in events))
    row["unsafe"] = sum(not safe for _, _, _, safe, *_ in events)
    row["false_alarms"] = sum(figures["false_alarms"] for figures in flown.values())
    for what, key in (("breaches", "breach"), ("contacts", "contact")):
        row[what] = sum(len(figures[key]) for figures in flown.values())
    for what in COUNTED:
        row[what + "_per_minute_bounds"] = rate_bounds(row[what], minutes)
    row["flight_rmse_m"] = {
        str(seed): round(math.sqrt(figures["square_m2"] / figures["samples"]), 6)
        for seed, figures in flown.items()
        if figures["samples"]
    }
    row["detect_ms"] = delays_ms
    return row


def totals_of(rows):
    """The sums of all rows."""
    summed = ("minutes", "vehicle_minutes", "flights", "failed", "events", "unsafe", *COUNTED)
    sums = {key: sum(row[key] for row in rows) for key in summed}
    sums |= {what: round(sums[what], 4) for what in ("minutes", "vehicle_minutes")}
    sums["net_m"] = min((row["net_m"] for row in rows if row["net_m"] is not None), default=None)
    for what in COUNTED:
        sums[what + "_per_minute_bounds"] = rate_bounds(sums[what], sums["minutes"])
    return sums


def rate_bounds(count, minutes):
    """[least, greatest] rate per minute; None without any minute."""
    if minutes <= 0.0:
        return None
    if count == 0:
        return [0.0, RULE_OF_THREE / minutes]
    tail = 0.5 * (1.0 - CONFIDENCE)
    low = stats.chi2.ppf(tail, 2 * count) / 2.0
    return [low / minutes, stats.chi2.isf(tail, 2 * count + 2) / 2.0 / minutes]


def share_bounds(hits, of):
    """[least, greatest] share; None when `of` is 0."""
    if of == 0:
        return None
    if hits in (0, of):
        chance = (1.0 - CONFIDENCE) ** (1.0 / of)  # with which `of` hits in a row are 5 % likely; about 1 - 3 / of
        return [0.0, 1.0 - chance] if hits == 0 else [chance, 1.0]
    return list(map(float, stats.binomtest(hits, of).proportion_ci(CONFIDENCE, "exact")))


def compare(rows, others):
    """Differences between matching rows of two scorecards: dicts with `here`, `there`, the p-value p, and whether the
    difference is significant (5 % for all together, Holm).

    Errors: Wilcoxon's signed-rank test, on flights with the same seed.  Delays: Mann-Whitney test, on all events.
    Shares: Fisher's exact test.  Rates per minute: conditional binomial test.
    """
    by_key = {tuple(row[key] for key in KEY): row for row in others}
    found = []
    for row in rows:
        other = by_key.get(tuple(row[key] for key in KEY))
        if other is not None:
            found += [
                {key: row[key] for key in KEY} | {"figure": what, "here": here, "there": there, "p": p}
                for what, here, there, p in _differences(row, other)
            ]
    ranked = sorted((item for item in found if item["p"] is not None), key=lambda item: item["p"])
    holds = True
    for rank, item in enumerate(ranked):
        holds = holds and item["p"] <= (1.0 - CONFIDENCE) / (len(ranked) - rank)
        item["significant"] = holds
    return [item | {"significant": item.get("significant", False)} for item in found]


def _differences(row, other):
    """Yields (figure, here, there, p) of two rows; p None: too little data."""
    both = row, other
    seeds = sorted(row["flight_rmse_m"].keys() & other["flight_rmse_m"].keys())
    steps_m = [row["flight_rmse_m"][seed] - other["flight_rmse_m"][seed] for seed in seeds]
    p = None
    if len(seeds) >= _LEAST_PAIRS:
        p = float(stats.wilcoxon(steps_m).pvalue) if any(steps_m) else 1.0
    yield "rmse_m", *(part["rmse_m"] for part in both), p
    p = None
    if row["detect_ms"] and other["detect_ms"]:
        p = float(stats.mannwhitneyu(row["detect_ms"], other["detect_ms"]).pvalue)
    yield "detect_p50_ms", *(part["detect_p50_ms"] for part in both), p
    p = None
    if row["events"] and other["events"]:
        table = [[part["detected"], part["events"] - part["detected"]] for part in both]
        p = float(stats.fisher_exact(table).pvalue)
    yield "detected", *(_ratio(part["detected"], part["events"]) for part in both), p
    for what in COUNTED:
        in_all, minutes = (sum(part[key] for part in both) for key in (what, "minutes"))
        p = None
        if row["minutes"] and other["minutes"]:
            p = float(stats.binomtest(row[what], in_all, row["minutes"] / minutes).pvalue) if in_all else 1.0
        yield what, *(_ratio(part[what], part["minutes"]) for part in both), p


def _ratio(count, of):
    return count / of if of else None
