"""Whole flights of the whole graph over the real wire protocols, as `./maap fly` makes them."""

import bisect
import contextlib
import csv
import json
import os
import pathlib
import re
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor

import psutil
import pytest
import yaml
from flying import ROOT, end, finish, fly, judged, left_behind, output_of, start, try_to_fly, wait_for_line

from data_extraction.bags import Bag
from data_extraction.flatten import seconds
from data_extraction.report.origin import parameter_hash
from risc_estimation.ros.params import NodeParams
from risc_experiments.stop import end_flight
from risc_lab.phases import OperatorPhase
from risc_lab.ros.launching import MARK, marked_processes

pytestmark = pytest.mark.alone
RMSE_LIMIT_M = 0.05  # a gate for accidents; the accuracy that README states is measured by `./maap bench flights`
HELD_UP_MS = 1e3 * (NodeParams().queue_s - 1.0 / 200.0)  # age of the first frame that waits when the last comes
ENDED_S = 60.0  # until all programs of a flight have landed their vehicles and ended
PAIR_RATE_HZ = 100.0  # of two flights at the same time: two cores have no time for two at 200 Hz and a busy neighbour


def frames_passed_over(path):
    """{stamp [s] of a frame of the bag that has no states: age [ms] of the states that came next}.

    If more frames wait than may (queue_s), an estimator skips the oldest: its next estimate is as old as the frames
    that still wait. Only from take-off to the operator's result: before and after, all programs start and end.
    """
    frames_s, age_ms, begun = set(), {}, False
    with Bag(path) as bag:
        for topic, receipt_s, message in bag.messages(
            ["/mocap_data", "/cortex_raw", "/operator/phase", "/operator/result"]
        ):
            if topic == "/operator/result":
                break
            if topic == "/operator/phase":
                begun |= message.phase == OperatorPhase.TAKEOFF
                continue
            if not begun:
                continue
            stamp_s = seconds(message.header.stamp)
            if topic == "/mocap_data":
                frames_s.add(stamp_s)
            else:
                age_ms.setdefault(stamp_s, 1e3 * (receipt_s - stamp_s))
    states_s = sorted(age_ms)
    missing = [stamp_s for stamp_s in sorted(frames_s - set(age_ms)) if states_s[0] < stamp_s < states_s[-1]]
    return {stamp_s: age_ms[states_s[bisect.bisect(states_s, stamp_s)]] for stamp_s in missing}


@pytest.fixture(scope="module")
def circles(tmp_path_factory):
    """The default experiment, shorter: (exit code, output, summary, folder). Its programs log what numba did."""
    environment = dict(os.environ, RISC_MAAP_ROOT=str(ROOT), NUMBA_DEBUG_CACHE="1")
    return fly(tmp_path_factory.mktemp("flight"), "--duration", "10", env=environment)


def test_nothing_is_compiled_in_flight(circles):
    """Each compiled function comes out of the caches that `./maap build` wrote."""
    _, output, _, folder = circles
    told = output + (folder / "roslaunch.log").read_text(errors="replace")
    loaded = re.findall(r"\[cache\] data loaded from '.*/(\w+\.\w+)-", told)
    assert {"differential_flatness._step", "least_squares._update", "quadrotor.level_motion"} <= set(loaded)
    assert re.findall(r"\[cache\] .* saved to .*", told) == []


def test_three_vehicles_fly_their_circles_and_land(circles):
    code, output, summary, _ = circles
    assert code == 0 and summary["passed"], output
    assert set(summary["vehicles"]) == {"fluffy_II", "albatross", "Raven"}
    for name, figures in summary["vehicles"].items():
        assert figures["position_rmse_m"] < RMSE_LIMIT_M, name
        assert figures["settle_s"] < 5.0, name


def test_summary_has_every_key_of_the_design(circles):
    summary = circles[2]
    assert summary["experiment"] == "circles3" and summary["simulated"]["plant"] == "perturbed"
    assert summary["duration_s"] > 10.0
    for figures in summary["vehicles"].values():
        assert {"position_rmse_m", "position_max_m", "settle_s", "lag_s"} <= set(figures)
    for hop, figures in summary["latency_ms"].items():
        assert set(figures) == {"p50", "p99", "max"}, hop
        assert figures["p50"] is not None and figures["p50"] < 50.0, hop
    assert {"bag", "csv_dir", "plots", "report"} == set(summary["artefacts"])


def test_every_frame_is_received_and_estimated(circles):
    mocap = circles[2]["mocap"]
    assert mocap["frames_sent"] > 4000
    assert mocap["frames_received"] == mocap["frames_sent"]
    passed_over = frames_passed_over(circles[2]["artefacts"]["bag"])
    assert mocap["frames_received"] - mocap["frames_estimated"] == len(passed_over) < 0.02 * mocap["frames_sent"]
    assert all(age_ms > HELD_UP_MS for age_ms in passed_over.values()), "lost, though it was not held up"
    assert mocap["rate_hz"] == pytest.approx(200.0, abs=0.2)


def test_artefacts_are_there(circles):
    artefacts, folder = circles[2]["artefacts"], circles[3]
    assert pathlib.Path(artefacts["bag"]).stat().st_size > 1e6
    assert {pathlib.Path(plot).name for plot in artefacts["plots"]} >= {"paths.png", "errors.png", "latency.png"}
    with (folder / "csv" / "cortex_raw.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 3000
    assert {"stamp", "fluffy_II.x", "albatross.psi", "Raven.visible"} <= set(rows[0])


def test_the_report_says_what_was_flown_with_what(circles):
    _, output, summary, folder = circles
    assert summary["artefacts"]["report"] == str(folder / "report.html") and "report.html" in output
    text = (folder / "report.html").read_text(encoding="utf-8")
    sections = ("result", "map", "tracking", "latency", "mocap", "gates", "ladder", "fence", "battery", "events")
    assert [name for name in sections if 'id="%s"' % name not in text] == []
    assert "PASSED" in text and "simulated" in text
    assert parameter_hash(yaml.safe_load((folder / "parameters.yaml").read_text())) in text
    flight = yaml.safe_load((folder / "flight.yaml").read_text())
    assert flight["seed"] == 1 and flight["versions"]["ROS"] and flight["versions"]["Python"]


def test_nothing_is_left_running(circles):
    assert left_behind(circles[3]) == []


# ---------------------------------------------------------------- two at the same time

# What each flies: a heading, also one that the original never flew.
COURSES = {"interrupted": ("flat8", 135.0), "killed": ("slanted8", -70.0)}
ON_COURSE_S = 4.0


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """{name: (folder, exit code)} of COURSES, flown at the same time beside a foreign master on the default port.

    One is interrupted on its course; then ./maap fly and roslaunch of the other one are killed, as when memory runs
    out, and ./maap stop ends what is left.
    """
    root = tmp_path_factory.mktemp("pair")
    fleet = yaml.safe_load((ROOT / "launch/fleets/ardrones3.yaml").read_text())
    fleet["mocap"]["rate_hz"] = PAIR_RATE_HZ
    (root / "fleet.yaml").write_text(yaml.safe_dump(fleet))
    options = ("--fleet", root / "fleet.yaml", "--vehicles", "1", "--duration", "120")
    folders = {name: root / name for name in COURSES}
    with contextlib.ExitStack() as ending:
        master = subprocess.Popen(
            ["rosmaster", "--core", "-p", "11311"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        ending.callback(master.wait)
        ending.callback(master.terminate)
        flights = {}
        for name, (course, psi_deg) in COURSES.items():
            own = ("--trajectory", course, "--psi", "%g" % psi_deg)
            flights[name] = start(folders[name], *options, *own)
            ending.callback(end, flights[name], folders[name])
        for name, flight in flights.items():
            wait_for_line(flight, folders[name], "on course for")
        time.sleep(ON_COURSE_S)
        flights["interrupted"].send_signal(signal.SIGINT)
        finish(flights["interrupted"], folders["interrupted"])
        kill_and_stop(flights["killed"])
        return {name: (folders[name], flight.returncode) for name, flight in flights.items()}


def kill_and_stop(flight):
    """Kill ./maap fly and roslaunch of a flight; end the rest as ./maap stop does."""
    children = psutil.Process(flight.pid).children()
    launch = next(child for child in children if "roslaunch" in " ".join(child.cmdline()))
    identity = launch.environ()[MARK]
    launch.suspend()  # it would end its nodes when its parent dies
    flight.kill()
    launch.kill()
    flight.wait()
    assert len(marked_processes(identity)) > 5
    end_flight(identity)
    assert marked_processes(identity) == {}


def time_at_heading(path, vehicle, psi_deg):
    """How long [s] the vehicle's nose pointed there, within 8 degrees."""
    count = 0
    with Bag(path) as bag:
        for _, _, message in bag.messages(["/ground_truth"]):
            (psi,) = (entry.psi for entry in message.Obj if entry.name == vehicle)
            count += abs((psi - psi_deg + 180.0) % 360.0 - 180.0) < 8.0
    return count / PAIR_RATE_HZ


def bag_of(folder):
    """The bag of a flight; it is completed here if the flight had no time to."""
    path = folder / "flight.bag"
    if not path.exists():
        path.with_name("flight.bag.active").rename(path)
        subprocess.run(["rosbag", "reindex", str(path)], stdout=subprocess.DEVNULL, check=True)
    return path


@pytest.mark.parametrize("name", COURSES)
def test_two_flights_at_the_same_time_beside_another_master(pair, name):
    """One vehicle each; a course and a heading of the caller's."""
    folder, _ = pair[name]
    assert time_at_heading(bag_of(folder), "fluffy_II", COURSES[name][1]) > 0.8 * ON_COURSE_S
    assert left_behind(folder) == []


def test_interrupt_lands_and_leaves_nothing(pair):
    folder, code = pair["interrupted"]
    told = output_of(folder)
    assert code == 1 and "failed: landing was requested" in told, told
    with (folder / "csv" / "ground_truth.csv").open() as file:
        last = list(csv.DictReader(file))[-1]
    assert float(last["fluffy_II.z"]) < 0.1, "it does not stand on the floor:\n" + told


def test_what_a_killed_flight_leaves_is_landed_and_ended(pair):
    folder, _ = pair["killed"]
    vehicle = json.loads((folder / "virtual_lab.json").read_text())["vehicles"]["risc1"]
    assert (vehicle["phase"], vehicle["host"]["landings"]) == ("landed", 1)


@pytest.mark.release
def test_a_flight_whose_command_is_killed_leaves_nothing(tmp_path):
    """roslaunch gets a signal when its parent dies. The virtual lab ends with the nodes, so nothing sees them land."""
    process = start(tmp_path, "--vehicles", "1", "--duration", "120")
    try:
        wait_for_line(process, tmp_path, "on course for")
        process.kill()
        process.wait()
        end_s = time.monotonic() + ENDED_S
        while left_behind(tmp_path) and time.monotonic() < end_s:
            time.sleep(0.2)
        assert left_behind(tmp_path) == []
    finally:
        end(process, tmp_path)
    assert (tmp_path / "flight.bag").exists(), "the recorder had no time to complete it"


@pytest.mark.release
def test_two_flights_at_the_same_time_pass(tmp_path):
    """To their end, one vehicle each."""
    fleet = yaml.safe_load((ROOT / "launch/fleets/ardrones3.yaml").read_text())
    fleet["mocap"]["rate_hz"] = PAIR_RATE_HZ
    (tmp_path / "fleet.yaml").write_text(yaml.safe_dump(fleet))
    options = ("--fleet", tmp_path / "fleet.yaml", "--vehicles", "1", "--duration", "10")
    with ThreadPoolExecutor() as pool:
        flights = [
            pool.submit(try_to_fly, tmp_path / name, *options, "--trajectory", name) for name in ("circle", "flat8")
        ]
    for flight in flights:
        code, output, _, folder = judged(flight.result())
        assert code == 0, output
        assert left_behind(folder) == []


@pytest.mark.release  # test_iris_flight.py flies the same figures, by the same nodes
def test_df_demo_flies_its_figures(tmp_path):
    code, output, _, _ = fly(tmp_path, "df_demo", "--duration", "10")
    assert code == 0, output


def test_coop_measures_bearings_and_records_what_the_experiment_needs(tmp_path):
    """Thesis 7.12: cameras, navdata, bearings, regions, inputs, transforms, trajectories, truth, landmarks."""
    code, output, summary, folder = fly(
        tmp_path, "coop", "--vehicles", "2", "--duration", "8", "--fps", "8", "--mocap-rate", "100"
    )
    assert code == 0, output
    bearings = summary["bearings"]["vehicles"]
    assert set(bearings) == {"fluffy_II", "albatross"}
    for vehicle, targets in bearings.items():
        measured = [figures for figures in targets.values() if figures["count"]]
        assert measured, "%s saw nothing" % vehicle
        azimuth_deg, elevation_deg = (
            max(f[angle + "_rms_deg"] for f in measured) for angle in ("azimuth", "elevation")
        )
        assert elevation_deg < 0.01, "a third of what whole pixels give, 0.03"
        assert azimuth_deg < 0.015, "the vehicle turns: a stamp that is late by 1 ms is 0.04 deg"
    with Bag(folder / "flight.bag") as bag:
        recorded = {topic for topic, count in bag.topics.items() if count}
    own = ("image_rect_color/compressed", "camera_info", "navdata")
    assert recorded >= {"/%s/ardrone/%s" % (name, topic) for name in ("risc1", "risc2") for topic in own}
    assert recorded >= {"/risc1/cmd_vel", "/risc2/cmd_vel", "/controls", "/trajectory", "/cortex_raw", "/ground_truth"}
    assert recorded >= {"/angles", "/land_rois", "/states3", "/tf", "/tf_static"}
    assert recorded >= {"/mocap_status", "/estimator_status", "/controller_report", "/risc1/node_status"}
    assert "/risc1/vehicle_status" in recorded
    assert recorded >= {"/trajectory_phase", "/risc1/safety", "/operator/phase", "/operator/result"}
    assert pathlib.Path(folder, "plots", "bearings.png").stat().st_size > 10000
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert 'id="bearings"' in page and page.count("data:image/jpeg") >= 2, "pictures of each camera"
    assert left_behind(folder) == []
