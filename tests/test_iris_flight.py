"""Whole flights of an IRIS+ over its two wires: its figures, and what becomes of it when a part of the chain fails."""

import json
import os
import signal
import subprocess
import time

import psutil
import pytest
from flying import ROOT, end, finish, fly, left_behind, start, wait_for_line

from data_extraction.bags import Bag
from data_extraction.flatten import seconds
from risc_control.vehicles import FlightState
from risc_maap_msgs.msg import PpmStatus, Safety, VehiclePhase

pytestmark = pytest.mark.alone
RMSE_LIMIT_M = 0.008  # the requirement; docs/performance.md measures what is reached
ACCIDENT_M = 0.05  # a gate for a fleet of which the requirement says nothing
PILOT_S = 4.0  # until it is noticed that the pilot flies: the sticks may equal ours at first
GONE_S = 60.0  # longer than the rest of the flight
LATE_S = 0.3  # what a busy computer may add to the limits of the ladder


def process_of(folder, word):
    """The process of a flight whose command line has this word."""
    found = [psutil.Process(pid) for pid in left_behind(folder)]
    (process,) = [process for process in found if any(word in part for part in process.cmdline()[:4])]
    return process


def cut_off(channel, fault="blackhole", duration_s=GONE_S):
    """Function (folder) that injects a fault on a wire of the vehicle."""
    request = "{fault: %s, duration_s: [%g], channel: %s}" % (fault, duration_s, channel)

    def inject(folder):
        master = process_of(folder, "/rosmaster").environ()
        environment = dict(os.environ, ROS_MASTER_URI=master["ROS_MASTER_URI"], ROS_IP="127.0.0.1")
        command = ["rosservice", "call", "/virtual_lab/inject", request]
        answer = subprocess.run(command, env=environment, check=True, capture_output=True, text=True, timeout=60.0)
        assert "success: True" in answer.stdout, answer.stdout

    return inject


def kill(word):
    """Function (folder) that kills a program."""
    return lambda folder: process_of(folder, word).send_signal(signal.SIGKILL)


# {what fails: (how, the ladder's rule that lands the vehicle, its limit [s], topics whose silence triggers the rule)}.
# Without a rule: the board, whose failsafe the autopilot takes for a lost radio, or a node that came back.
BOARD, TELEMETRY = ("/iris1/ppm_status",), ("/iris1/apm/state", "/iris1/apm/status", "/iris1/apm/rc")
FAILURES = {
    "board reset": (cut_off("iris1/arduino", "cut", 0.05), Safety.NAVDATA, 0.5, BOARD),
    "board resets": (cut_off("iris1/arduino", "cut"), Safety.NAVDATA, 0.5, BOARD),
    "serial line": (cut_off("iris1/arduino"), Safety.NAVDATA, 0.5, BOARD),
    "telemetry": (cut_off("iris1/mavlink"), Safety.NAVDATA, 2.5, TELEMETRY),
    "controller": (kill("IRIS_DF_Demo.py"), Safety.CONTROLS, 0.5, ("/controls",)),
    "roscopter": (kill("roscopter"), None, None, None),
    "vehicle node": (kill("risc_controller.py"), None, 0.5, ("/iris1/controls",)),
}


def landing_of(path, after_s):
    """(time [s], Safety) of the first order of the ladder to land after a time; receipt times."""
    with Bag(path) as bag:
        for _, receipt_s, message in bag.messages(["/iris1/safety"]):
            if receipt_s > after_s and message.level == Safety.LAND:
                return receipt_s, message
    return None


def failsafe_of(path, after_s):
    """Receipt time [s] of the board's first report of its failsafe after a time."""
    with Bag(path) as bag:
        reports = [(receipt_s, message.state) for _, receipt_s, message in bag.messages(BOARD)]
    return min(receipt_s for receipt_s, state in reports if receipt_s > after_s and state == PpmStatus.FAILSAFE)


def last_before(path, topics, before_s):
    """Receipt time [s] of the last message before a time; of the board's reports, the last one in which it flies."""
    with Bag(path) as bag:
        return max(
            receipt_s
            for topic, receipt_s, message in bag.messages(topics)
            if receipt_s < before_s and not (topic in BOARD and message.state != PpmStatus.FLYING)
        )


def test_the_figures_of_chapter_6(tmp_path):
    """The way to a figure takes 5 s of its time."""
    code, output, summary, folder = fly(tmp_path, "iris", "--duration", "9", "--mocap-rate", "100")
    assert code == 0, output
    assert summary["vehicles"]["IRIS"]["position_rmse_m"] < RMSE_LIMIT_M
    with Bag(folder / "flight.bag") as bag:
        counts = bag.topics
        phases = [message for _, _, message in bag.messages(["/trajectory_phase"])]
    flown = {told.course for told in phases if any(it.phase == VehiclePhase.COURSE for it in told.vehicles)}
    assert flown == {"origin", "slanted8", "flat8", "circle"}
    assert all(counts["/iris1/" + topic] > 20 for topic in ("controls", "ppm_status", "apm/state", "apm/status"))
    assert left_behind(folder) == []


@pytest.mark.release
def test_two_ardrones_and_an_iris_fly_by_one_controller(tmp_path):
    fleet = ROOT / "launch" / "fleets" / "mixed3.yaml"
    code, output, summary, folder = fly(tmp_path, "circles3", "--fleet", fleet, "--duration", "10")
    assert code == 0, output
    flown = summary["vehicles"]
    assert set(flown) == {"fluffy_II", "albatross", "IRIS"}
    assert max(vehicle["position_rmse_m"] for vehicle in flown.values()) < ACCIDENT_M
    with Bag(folder / "flight.bag") as bag:
        assert all(bag.topics[topic] > 200 for topic in ("/risc1/cmd_vel", "/risc2/cmd_vel", "/iris1/controls"))
    assert left_behind(folder) == []


@pytest.mark.release
def test_its_pilot_takes_over_and_gives_it_back(tmp_path):
    code, output, _, folder = fly(tmp_path, "iris", "--duration", "10", "--fault", "pilot_takeover:6,iris1@2")
    assert code == 0 and left_behind(folder) == [], output
    told, modes, begin_s = [], set(), None
    with Bag(folder / "flight.bag") as bag:
        topics = "/iris1/vehicle_status", "/iris1/apm/state", "/virtual_lab/faults"
        for topic, receipt_s, message in bag.messages(topics):
            if topic.endswith("faults"):
                begin_s = next((seconds(fault.begins) for fault in message.faults), begin_s)
            elif topic.endswith("state"):
                modes.add(message.mode)
            else:
                told.append((receipt_s, message.state))
    noticed_s = next(receipt_s for receipt_s, state in told if state == FlightState.PILOT) - begin_s
    print("noticed after %.2f s" % noticed_s)
    assert 0.0 < noticed_s < PILOT_S and told[-1][1] == FlightState.LANDED, output
    assert modes == {"STABILIZE"}, "it was not taken from its pilot"
    lab = json.loads((folder / "virtual_lab.json").read_text())
    assert (lab["vehicles"]["iris1"]["phase"], lab["crashes"]) == ("landed", [])


@pytest.mark.release
@pytest.mark.parametrize("name", FAILURES)
def test_what_fails_in_flight_lands_the_vehicle(tmp_path, name):
    let_fail, rule, limit_s, topics = FAILURES[name]
    process = start(tmp_path, "iris", "--duration", "5")
    try:
        wait_for_line(process, tmp_path, "at the origin")
        failed_s = time.time()
        let_fail(tmp_path)
        code, output = finish(process, tmp_path)
    finally:
        end(process, tmp_path)
    lab = json.loads((tmp_path / "virtual_lab.json").read_text())
    assert (lab["vehicles"]["iris1"]["phase"], lab["crashes"]) == ("landed", []), output
    assert left_behind(tmp_path) == []
    if limit_s is None:
        return
    bag = tmp_path / "flight.bag"
    if topics is BOARD or rule is None:
        with Bag(bag) as messages:
            modes = {message.mode for _, _, message in messages.messages(["/iris1/apm/state"])}
        assert "LAND" in modes, output
    if rule is None:
        noticed_s, told = failsafe_of(bag, failed_s), "failsafe"
    else:
        noticed_s, order = landing_of(bag, failed_s)
        told = order.reason
        assert code == 1 and order.rule == rule, told
    silent_s = noticed_s - last_before(bag, topics, noticed_s)
    print("%s: noticed after %.2f s: %s" % (name, silent_s, told))
    assert silent_s < limit_s + LATE_S
