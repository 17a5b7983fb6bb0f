"""After the flight: the bag becomes CSV files, plots, summary.json, report.html and the table that is printed."""

import json

from data_extraction import plots, summary
from data_extraction.bags import Bag
from data_extraction.csv_export import export
from data_extraction.progress import bar
from data_extraction.report import page
from data_extraction.report.collector import ReportCollector
from data_extraction.report.origin import read_beside
from risc_experiments.flight_record import course_name
from risc_experiments.headroom import verdict
from risc_experiments.judge import Limits, judge, never_began
from risc_lab.lab import load_fleet
from risc_simulator.models.mocap_cameras import CameraParams

WITH_CAMERAS = ("coop",)  # experiments that have to measure bearings
LATE_LIMIT_MS = 10.0  # two frames at 200 Hz: a lab that is later than this (p99) had too slow a computer
VIDEO_LATE_LIMIT_MS = 5.0  # of the fastest pictures: stamps are based on them, and a vehicle may turn by 0.1 deg


def make_report(args, folder, failure, progress, interrupted, tried=()):
    """Evaluate the flight in `folder` and print what came out. Returns the exit code, 0 when it passed.

    args: of `fly.arguments`; failure: why it failed while it was carried out, "" = it did not.
    interrupted: threading.Event that stops it.
    tried: [{"rate_hz", "reason"}] of the rates of motion capture for which the computer was too slow.
    Raises ValueError for a useless bag, and when it is interrupted.
    """
    interrupted.clear()
    collector, files = _extract(folder, progress, interrupted)
    bag, page_path = folder / "flight.bag", folder / "report.html"
    artefacts = {"bag": str(bag), "csv_dir": str(folder / "csv"), "plots": [], "report": str(page_path)}
    try:
        flight, reasons = collector.flight.flight(), None
    except ValueError as error:  # no whole flight: summary and report say what there is
        flight, reasons = collector.flight.flight(strict=False), [failure, str(error)]
    material = collector.material(flight)
    model = simulation_model(args, folder)
    faults = material.faults
    unbegun = len(args.faults) - len(faults.outcomes)
    result = summary.summarise(flight, args.experiment, model, artefacts, material.origin, faults)
    lab = lab_statistics(folder)
    result["least_separation_m"] = lab.get("least_separation_m")
    result["lab_late_ms"] = lab.get("late_ms")
    result["video_late_ms"] = max(v["video"]["late_ms"] for v in lab["vehicles"].values()) if lab else None
    result["on_schedule"] = on_schedule(result) if lab else None
    result["mocap"]["wanted_hz"] = tried[0]["rate_hz"] if tried else material.origin.fleet.mocap.rate_hz
    result["mocap"]["given_up"] = list(tried)
    if reasons is None:
        progress.show("drawing")
        title = "%s, seed %d (simulated)" % (course_name(args), args.seed)
        pictures = plots.draw_all(flight, folder / "plots", title, faults.marks(material.zero_s))
        artefacts["plots"] = [str(picture) for picture in pictures]
        namespaces = {vehicle.template: vehicle.namespace for vehicle in material.origin.fleet.vehicles}
        reasons = judge(flight, failure, None, args.experiment in WITH_CAMERAS, faults, namespaces)
        if not failure:
            reasons.append(never_began(faults, len(args.faults), len(namespaces)))
    reasons = [reason for reason in reasons if reason]
    if reasons:
        reasons += filter(None, [verdict(result)])
    result.update(passed=not reasons, reasons=reasons, limits=dict(vars(Limits())))
    summary.write(result, folder / "summary.json")
    page.write(page_path, material, result)
    progress.say("")
    print(summary.table(result))
    print("simulated: %s" % ", ".join("%s %s" % item for item in result["simulated"].items()))
    if result["least_separation_m"] is not None:
        print("vehicles came no closer than %.2f m to each other" % result["least_separation_m"])
    for rate in tried:
        print("motion capture at %g Hz was given up before take-off: %s" % (rate["rate_hz"], rate["reason"]))
    if unbegun > 0 and result["passed"]:
        print("%d of %d faults never began: all vehicles had landed" % (unbegun, len(args.faults)))
    if result["on_schedule"] is False:
        print(
            "this computer had too little time: the virtual lab's frames were late (p99 %.0f ms; more than %.0f ms is "
            "not fair to a controller), or its pictures (%.0f ms; more than %.0f ms is not fair to bearings). Close "
            "other programs and fly again"
            % (lab["late_ms"]["p99"], LATE_LIMIT_MS, result["video_late_ms"], VIDEO_LATE_LIMIT_MS)
        )
    print()
    print("bag      %s" % bag)
    print("CSV      %s (%d files)" % (folder / "csv", len(files)))
    print("plots    %s" % (folder / "plots"))
    print("summary  %s" % (folder / "summary.json"))
    print("report   %s" % page_path)
    print()
    print("PASSED" if result["passed"] else "FAILED: " + "; ".join(reasons))
    return 0 if result["passed"] else 1


def on_schedule(result):
    """Whether the computer had time enough for the virtual lab. result: summary of a flight."""
    return result["lab_late_ms"]["p99"] <= LATE_LIMIT_MS and (result.get("video_late_ms") or 0.0) <= VIDEO_LATE_LIMIT_MS


def _extract(folder, progress, interrupted):
    """One pass over the bag. Returns (ReportCollector, {topic: (path of its CSV file, rows)})."""
    path = folder / "flight.bag"
    with Bag(path) as bag:
        collector = ReportCollector(bag, read_beside(path))

        def collect(topic, receipt_s, message):
            if interrupted.is_set():
                raise ValueError("interrupted while extracting; the bag is complete: %s" % path)
            collector(topic, receipt_s, message)
            progress.show("extracting", bar(bag.fraction(receipt_s)))

        return collector, export(bag, folder / "csv", on_message=collect)


def simulation_model(args, folder):
    """What the virtual lab simulated, for `summary.json`: its noise, delay and plant."""
    first = load_fleet(folder / "fleet.yaml").vehicles[0].vehicle_type
    delay_s = first.command_delay_s if args.delay is None else args.delay
    return {
        "plant": "ideal" if args.ideal else "perturbed",
        "gusts": args.gusts,
        "seed": args.seed,
        "marker_noise_m": CameraParams().noise_std_m,
        "command_delay_s": delay_s,
    }


def lab_statistics(folder):
    """Statistics of the virtual lab; empty when it wrote none."""
    path = folder / "virtual_lab.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
