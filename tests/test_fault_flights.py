"""Whole flights of the whole graph in which something goes wrong, as `./maap fly --fault` makes them."""

import math

import pytest
from flying import fly

from risc_simulator.faults import REGISTRY, fault_settings

pytestmark = pytest.mark.alone
SHORT = ("--vehicles", "1", "--duration", "8", "--mocap-rate", "100")


def flown(folder, *faults, options=SHORT):
    """(exit code, output, summary) of a flight with faults."""
    words = [word for fault in faults for word in ("--fault", fault)]
    code, output, summary, _ = fly(folder, *options, *words)
    return code, output, summary


def test_a_short_blackout_of_motion_capture_is_flown_through_and_a_long_one_lands_it(tmp_path):
    code, output, summary = flown(tmp_path, "mocap_blackout:0.3@2", "mocap_blackout:3@6")
    assert code == 0, output
    (short, long), page = summary["faults"], (tmp_path / "report.html").read_text(encoding="utf-8")
    assert (short["name"], short["args"], short["outcome"]) == ("mocap_blackout", "0.3", "completed"), output
    assert short["start_s"] == pytest.approx(2.0, abs=1.0) and short["end_s"] - short["start_s"] == pytest.approx(0.3)
    assert short["reaction_ms"] > 50.0, "states may be 100 ms old, by their exposure"
    assert (long["args"], long["outcome"], long["safe"]) == ("3", "landed", True), output
    mocap = summary["mocap"]
    assert mocap["frames_sent"] - mocap["frames_received"] > 200, "no way round it: single frames are none either"
    assert 'id="faults"' in page and "fault mocap_blackout:0.3 begins" in page


@pytest.mark.release
def test_a_flight_with_a_short_blackout_ends_at_home(tmp_path):
    code, output, summary = flown(tmp_path, "mocap_blackout:0.3@2")
    assert code == 0 and [fault["outcome"] for fault in summary["faults"]] == ["completed"], output


A_FLIGHT = 4  # faults
APART_S, LASTS_S = 6.0, 2.0
GROUPS = [REGISTRY.names()[k : k + A_FLIGHT] for k in range(0, len(REGISTRY.names()), A_FLIGHT)]


def event(name, k):
    """The fault at its default, as the k-th of a flight of three; one that would last does so for a while."""
    settings, words = fault_settings(name), []
    if settings.per_vehicle:
        words.append("risc%d" % (k % 3 + 1))
    if settings.argument == "severity" or math.isinf(settings.default.duration_s):
        shortest_s, longest_s = settings.duration_s
        words.append("duration_s=%g" % min(max(LASTS_S, shortest_s), longest_s))
    return "%s:%s@%g" % (name, ",".join(words), 2.0 + APART_S * k)


@pytest.mark.release
@pytest.mark.parametrize("names", GROUPS, ids="-".join)
def test_every_fault_ends_safe(tmp_path, names):
    """Several in a flight of three; those that begin when all have landed are flown by no one."""
    faults = [event(name, k) for k, name in enumerate(names)]
    duration = "%g" % (2.0 + APART_S * len(names))
    code, output, summary = flown(tmp_path, *faults, options=("--duration", duration, "--mocap-rate", "100"))
    assert code == 0, output
    assert [fault["name"] for fault in summary["faults"]] == list(names)[: len(summary["faults"])] != []
    assert all(fault["safe"] for fault in summary["faults"])
