"""A soak as JSON, as text and as a page."""

import json
import shlex
from dataclasses import asdict

from data_extraction.report import page
from risc_experiments import fly
from risc_experiments.report import lab_statistics
from risc_experiments.soak import table
from risc_experiments.soak.verdict import BAG, FAULTS
from risc_lab.lab.yaml_reader import package_file
from risc_lab.revision import revision

FIGURES = {"own_mb": "own [MB]", "descriptors": "descriptors", "threads": "threads"}
HEAD = (
    "process", "RSS [MB]", "PSS [MB]", *(word for what in FIGURES.values() for word in (what, "per hour (95 %)")),
    "cores",
)  # fmt: skip


def result_of(soak):
    """All figures, as a dict for JSON."""
    lab = lab_statistics(soak.folder)
    processes = soak.processes.known if soak.processes else ()
    violation = None
    if soak.violation is not None:
        violation = {**soak.violation._asdict(), "flight": soak.violated, "repeat": repeat(soak)}
    return {
        "simulated": True,
        "date": soak.began.isoformat(timespec="seconds"),
        "command": soak.args.command,
        "revision": revision(fly.ROOT),
        "seed": soak.args.seed,
        "asked_h": soak.args.hours,
        "flown_h": round(soak.flown_s / 3600.0, 4),
        "completed": soak.violation is None and not soak.interrupted,
        "interrupted": soak.interrupted,
        "violation": violation,
        "flights": soak.flights,
        "faults": table.rows_of(soak.faults),
        "all_faults": table.row_of("all", soak.faults),
        "latency_ms": {name: _drift(soak.latencies, name + "_ms", soak.warm_s) for name in ("p50", "p99")},
        "put_back": dict(soak.put_back),
        "lab": {name: lab.get(name) for name in ("late_ms", "stalls", "frames_skipped", "least_separation_m")},
        "warm_up_s": round(soak.params.warm_up_of(soak.duration_s), 1),
        "processes": {process.name: _process(process, soak) for process in processes},
        "all_processes": {name: _drift(soak.totals, name, soak.warm_s) for name in ("pss_mb", *FIGURES, "cpu_cores")},
        "settings": asdict(soak.params),
    }


def _drift(track, name, warm_s):
    return {
        key: value if value is None else round(value, 4) for key, value in track.drift(name, warm_s)._asdict().items()
    }


def _process(process, soak):
    figures = ("rss_mb", "pss_mb", *FIGURES, "cpu_cores")
    warm_s = soak.warm_of(process)
    return {
        "pid": process.key[0],
        "alive": process.alive,
        **{name: _drift(process.track, name, warm_s) for name in figures},
    }


def repeat(soak):
    """What is needed to reproduce the violation: {what: path or command}."""
    number, told = soak.violated, {"seed": soak.args.seed, "log": str(soak.folder / "roslaunch.log"),
                                   "logs": str(soak.folder / "ros_log"), "all": soak.args.command}  # fmt: skip
    if number:
        folder = soak.folder_of(number)
        told |= {"flight": number, "faults": str(folder / FAULTS)}
        if (folder / BAG).exists():
            told["bag"] = str(folder / BAG)
        words = ["./maap", "fly", "--seed", soak.args.seed, "--duration", "%g" % soak.params.duration_s]
        for name in ("vehicles", "trajectory", "controller", "estimator", "mocap_rate", "fleet"):
            value = getattr(soak.args, name)
            words += ["--" + name.replace("_", "-"), value] if value is not None else []
        words += ["--gusts"] if soak.args.gusts else []
        told["command"] = shlex.join(map(str, [*words, "--faults", folder / FAULTS]))
    return told


def write_all(soak):
    """Write soak.json, soak.md and soak.html into its folder."""
    result = result_of(soak)
    soak.record.add("end", completed=result["completed"], flights=len(result["flights"]))
    soak.record.close()
    (soak.folder / "soak.json").write_text(json.dumps(result, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    (soak.folder / "soak.md").write_text(markdown(result), encoding="utf-8")
    templates = package_file("risc_experiments", "templates")
    text = page.render("soak.html", templates, soak=result, head=HEAD, cells=cells, faults_head=table.HEAD,
                       fault_cells=table.cells, verdict=verdict, facts=facts, meaning=MEANING)  # fmt: skip
    (soak.folder / "soak.html").write_text(text, encoding="utf-8")
    return result


def verdict(result):
    """The result in a few words."""
    if result["violation"] is not None:
        return "%(invariant)s: %(text)s" % result["violation"]
    return "interrupted; all invariants held" if result["interrupted"] else "all invariants held"


MEANING = (
    "Own memory is what a process shares with no other. Per hour: Theil and Sen's slope with its 95 % interval, since "
    "the warm-up; – where less than 8 looks were taken since then. What a soak compares with its limits is the lower "
    "end."
)


def cells(name, process):
    """Texts of a process, under HEAD."""
    texts = [name, table.number(process["rss_mb"]["last"], 0), table.number(process["pss_mb"]["last"], 0)]
    for figure in FIGURES:
        digits = 1 if figure == "own_mb" else 0
        texts += [table.number(process[figure]["last"], digits), slope(process[figure])]
    return [*texts, table.number(process["cpu_cores"]["last"], 2)]


def slope(drift):
    """Text of a drift."""
    if drift["slope"] is None:
        return "–"
    values = drift["slope"], drift["low"], drift["high"]
    return "%+.1f (%+.1f to %+.1f)" % values if any(values) else "0"


def facts(result):
    """[(what, text)] of the whole soak."""
    late_ms, latency_ms = result["lab"]["late_ms"], result["latency_ms"]
    newest = [table.number(latency_ms[name]["last"], 1) for name in ("p50", "p99")]
    first = [table.number(latency_ms[name]["first"], 1) for name in ("p50", "p99")]
    reactions = [table.number(result["all_faults"][name], 0) for name in ("p50_ms", "p99_ms", "max_ms")]
    put_back = sum(result["put_back"].values())
    told = [
        ("flown", "%.2f h of %g h, %d flights judged" % (result["flown_h"], result["asked_h"], len(result["flights"]))),
        ("faults", table.events_text(result["all_faults"])),
        ("put back", "vehicles %d times" % put_back),
        ("frame to command", "p50 %s ms, p99 %s ms; at first %s, %s" % (*newest, *first)),
        ("reactions", "p50 %s, p99 %s, largest %s ms" % tuple(reactions)),
    ]  # fmt: skip
    if latency_ms["p99"]["slope"] is not None:
        told.append(("frame to command, p99, per hour", "%s ms" % slope(latency_ms["p99"])))
    if late_ms is not None:
        text = "p50 %.1f, p99 %.1f, largest %.1f ms late; stalled %d times, %d frames left out"
        values = (
            *(late_ms[name] for name in ("p50", "p99", "max")),
            result["lab"]["stalls"],
            result["lab"]["frames_skipped"],
        )
        told.append(("virtual lab", text % values))
    return told


def markdown(result):
    """The result as Markdown, which is also printed on the terminal."""
    lines = ["# Soak of %.2f h (simulated): %s" % (result["flown_h"], verdict(result)), ""]
    lines += ["%s, revision %s: `%s`" % (result["date"], result["revision"] or "unknown", result["command"]), ""]
    lines += ["- %s: %s" % fact for fact in facts(result)]
    if result["violation"] is not None:
        lines += ["", "To see it again:", ""]
        lines += ["- %s: %s" % (what, "`%s`" % text if what in ("command", "all") else text)
                  for what, text in result["violation"]["repeat"].items()]  # fmt: skip
    if result["faults"]:
        lines += ["", *table.markdown(table.HEAD, map(table.cells, result["faults"]), (0, 6))]
    rows = [cells(name, process) for name, process in sorted(result["processes"].items())]
    if rows:
        rows.append(cells("all", result["all_processes"] | {"rss_mb": {"last": None}}))
        lines += ["", *table.markdown(HEAD, rows), "", "%s Warm-up: %.0f s." % (MEANING, result["warm_up_s"])]
    return "\n".join(lines) + "\n"
