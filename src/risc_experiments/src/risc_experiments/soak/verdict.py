"""Judges a flight of a soak from its bag, in a separate process while the next one flies."""

import argparse
import json
import pathlib
import sys

import numpy as np

from data_extraction.bags import Bag
from data_extraction.flatten import seconds
from data_extraction.flight_metrics import FlightCollector, percentiles_ms
from data_extraction.report.faults import FaultCollector
from risc_experiments.judge import judge, never_began, unsafe
from risc_lab.lab import load_fleet
from risc_simulator.faults import parse_fault

BAG, JUDGED, FAULTS, FLEET = "flight.bag", "judged.json", "faults.yaml", "fleet.yaml"  # in the folder of a flight
_LEFT_OUT = ("/mocap_data", "/controls", "/cortex_raw")  # not needed here, and numerous


def judge_flight(folder, asked, failure):
    """Outcome of a flight, as a dict for JSON.

    folder: of the flight, with its bag and fleet file.  asked: how many faults were to happen.  failure: why the flight
    as a whole failed; "" = it did not; None = it was cut short, and only the outcomes of its faults count.
    Raises BagError.
    """
    fleet = load_fleet(folder / FLEET)
    flights, faults = FlightCollector(fleet, with_bearings=False), FaultCollector(fleet)
    late_s, stamps_s = [], []
    with Bag(folder / BAG) as bag:
        wanted = [
            topic for topic in bag.topics if topic not in _LEFT_OUT and (flights.wants(topic) or faults.wants(topic))
        ]
        for topic, receipt_s, message in bag.messages(wanted):
            flights(topic, receipt_s, message)
            if faults.wants(topic):
                faults(topic, receipt_s, message)
            if topic == "/ground_truth":
                stamps_s.append(seconds(message.header.stamp))
                late_s.append(receipt_s - stamps_s[-1] - fleet.mocap.reported_delay_s)
        found = faults.result(bag.start_s + bag.duration_s)
        size_mb, duration_s = (folder / BAG).stat().st_size / 1e6, bag.duration_s
    namespaces = {vehicle.template: vehicle.namespace for vehicle in fleet.vehicles}
    try:
        flight, problem = flights.flight(), ""
    except ValueError as error:
        flight, problem = flights.flight(strict=False), str(error)
    if failure is None:
        reasons = list(unsafe(found))
    elif problem:
        reasons = [failure or problem]
    else:
        reasons = judge(flight, failure, faults=found, namespaces=namespaces)
        reasons += [] if failure else [never_began(found, asked, len(namespaces))]
    return {
        "asked": asked,
        "faults": [
            {**figures, "program": parse_fault(outcome.text).program}
            for figures, outcome in zip(found.figures(), found.outcomes)
        ],
        "reasons": [reason for reason in reasons if reason],
        "out": {name: out.reason for name, out in sorted(found.out.items())},
        "latency_ms": percentiles_ms(flight.latency_s["datagram_to_cmd_vel"]),
        "lab_late_ms": percentiles_ms(np.array(late_s)),
        "lab_gap_ms": float(1e3 * np.diff(stamps_s).max()) if len(stamps_s) > 1 else None,
        "bag_mb": round(size_mb, 1),
        "bag_s": round(duration_s, 1),
    }


def main(argv=None):
    """Judge the flight in a folder. Returns the exit code."""
    parser = argparse.ArgumentParser(prog="risc_experiments.soak.verdict", description=__doc__)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--asked", type=int, default=0, help="number of faults that were planned")
    parser.add_argument("--failure", default="", help="why the flight as a whole failed")
    parser.add_argument("--cut-short", action="store_const", const=None, dest="failure", help="it was")
    args = parser.parse_args(argv)
    try:
        judged = judge_flight(args.folder, args.asked, args.failure)
    except (ValueError, OSError) as error:
        print(error)
        return 1
    (args.folder / JUDGED).write_text(json.dumps(judged, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
