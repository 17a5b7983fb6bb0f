"""Build a bag, export it, read it back; and flight figures with known answers."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest
import rosbag
import rospy
from geometry_msgs.msg import TwistStamped

from data_extraction import plots, summary
from data_extraction.bags import Bag, BagError
from data_extraction.csv_export import export, file_name
from data_extraction.flight_metrics import FlightCollector, best_fit_lag, evaluate, settling_time
from data_extraction.recording import Series
from risc_lab.phases import OperatorPhase, OperatorResult, TrajectoryPhase
from risc_maap_msgs.msg import MocapTime, OperatorState, TrajectoryPhases, VehiclePhase
from risc_msgs.msg import Controls, Cortex, Mocap_data, States, Trajectories, Trajectory

T0_S = 1000.0
LAG_S = 0.05
RADIUS_M = 0.8


def circle(t_s):
    return RADIUS_M * np.cos(0.8 * t_s), RADIUS_M * np.sin(0.8 * t_s), 1.0


def stamped(message, t_s):
    message.header.stamp = rospy.Time.from_sec(t_s)
    return message


def states(name, t_s):
    x, y, z = circle(t_s - T0_S - LAG_S)
    return States(name=name, visible=True, x=x, y=y, z=z, psi=179.0 + 2.0 * (int(200 * t_s) % 2))


@pytest.fixture(scope="module")
def flight_bag(tmp_path_factory):
    """30 s at 200 Hz: a vehicle follows a circle 50 ms late; frame 100 is lost; each hop takes a known time."""
    path = tmp_path_factory.mktemp("bag") / "flight.bag"
    with rosbag.Bag(str(path), "w") as bag:

        def write(topic, message, t_s):
            bag.write(topic, message, rospy.Time.from_sec(t_s))

        def tell(phase, t_s):
            write("/trajectory_phase", TrajectoryPhases(vehicles=[VehiclePhase("fluffy_II", phase)]), t_s)

        tell(TrajectoryPhase.APPROACH, T0_S)
        tell(TrajectoryPhase.COURSE, T0_S + 5.0)
        for k in range(6000):
            t_s = T0_S + 0.005 * k
            reference = Trajectory(name="fluffy_II", psi=np.pi)
            reference.x, reference.y, reference.z = circle(t_s - T0_S)
            write("/trajectory", stamped(Trajectories(Obj=[reference]), t_s), t_s)
            write("/ground_truth", stamped(Cortex(Obj=[states("fluffy_II", t_s)]), t_s), t_s)
            if k == 100:
                continue
            receipt_s = t_s + 0.003
            time = stamped(MocapTime(receipt=rospy.Time.from_sec(receipt_s), frame=5000 + k), t_s)
            write("/mocap_time", time, receipt_s + 0.0002)
            write("/mocap_data", stamped(Mocap_data(), t_s), receipt_s + 0.0005)
            write("/cortex_raw", stamped(Cortex(Obj=[states("fluffy_II", t_s)]), t_s), receipt_s + 0.002)
            write("/controls", stamped(Controls(), t_s), receipt_s + 0.003)
            if k % 7 == 0:
                write("/risc1/cmd_vel_stamped", stamped(TwistStamped(), t_s), receipt_s + 0.004)
        tell(TrajectoryPhase.HOME, T0_S + 30.0)
    return path


@pytest.fixture(scope="module")
def flight(flight_bag):
    collector = FlightCollector()
    with Bag(flight_bag) as bag:
        for message in bag.messages():
            collector(*message)
    return collector.flight()


def test_lag_and_error_are_those_of_the_flight(flight):
    vehicle = flight.vehicles["fluffy_II"]
    assert flight.judged_against == "ground truth"
    assert vehicle.lag_s == pytest.approx(LAG_S, abs=1e-3)
    chord_m = 2 * RADIUS_M * np.sin(0.8 * LAG_S / 2)
    assert vehicle.settle_s == 0.0
    assert vehicle.position_rmse_m == pytest.approx(chord_m, rel=1e-3)
    assert vehicle.position_max_m == pytest.approx(chord_m, rel=1e-3)
    assert vehicle.t_s[vehicle.judged][0] == pytest.approx(5.0, abs=0.01)


def test_latency_of_every_hop(flight):
    expected_ms = [3.0, 0.5, 2.0, 3.0, 4.0]
    for (hop, values), expected in zip(flight.latency_s.items(), expected_ms):
        assert 1e3 * np.median(values) == pytest.approx(expected, abs=1e-3), hop


@pytest.mark.parametrize("count", [114, 135, 149, 40_000])
def test_the_time_grid_ends_with_the_flight_and_does_not_drift(count):
    """Present-day stamps have ten digits of seconds, which leaves few digits for a step of 5 ms."""
    t_s = 1.5e9 + np.array([k // 200 + 0.005 * (k % 200) for k in range(count)])
    zeros = np.zeros(count)
    series = Series(t_s, np.column_stack((t_s - t_s[0], zeros, zeros, zeros)))
    vehicle = evaluate(series, series, None, t_s[0])
    assert np.isfinite(vehicle.actual_m).all() and len(vehicle.t_s) >= count - 1
    assert vehicle.t_s[-1] == pytest.approx(t_s[-1] - t_s[0], abs=0.0051)
    assert np.diff(vehicle.t_s).mean() == pytest.approx(0.005, rel=1e-6)


def test_lost_frame_is_counted(flight):
    assert (flight.mocap.frames_sent, flight.mocap.frames_received) == (6000, 5999)
    assert flight.mocap.frames_estimated == 5999
    assert flight.mocap.rate_hz == pytest.approx(200.0, rel=1e-6)


@pytest.mark.parametrize("phases", [(), (OperatorPhase.WAITING, OperatorPhase.TAKEOFF, OperatorPhase.FLY)])
def test_frames_that_are_lost_before_and_after_the_flight_do_not_count(tmp_path, phases):
    """While programs start and end, the computer is busy. A bag without phases begins with its first states."""
    begins = 41 if phases else 0
    with rosbag.Bag(str(tmp_path / "flight.bag"), "w") as bag:
        for k in range(120):
            t_s = T0_S + 0.005 * k
            now = rospy.Time.from_sec(t_s)
            if k % 41 == 0 and k // 41 < len(phases):
                bag.write("/operator/phase", stamped(OperatorState(phase=phases[k // 41]), t_s), now)
            if k == 3 and phases:  # of the flight before, latched for later subscribers
                before = stamped(OperatorState(result=OperatorResult.FAILED), T0_S - 9.0)
                bag.write("/operator/result", before, now)
            if k == 101:
                bag.write("/operator/result", stamped(OperatorState(result=OperatorResult.OK), t_s), now)
            bag.write("/mocap_time", stamped(MocapTime(frame=k), t_s), now)
            if begins <= k < 101 and k != 60 or k % 4 == 1:
                bag.write("/cortex_raw", stamped(Cortex(Obj=[states("fluffy_II", t_s)]), t_s), now)
    collector = FlightCollector()
    with Bag(tmp_path / "flight.bag") as bag:
        for message in bag.messages():
            collector(*message)
    mocap = collector.flight(strict=False).mocap
    sent = 101 - begins
    assert (mocap.frames_sent, mocap.frames_received, mocap.frames_estimated) == (sent, sent, sent - 1)


def test_yaw_at_the_seam_is_no_error(flight):
    vehicle = flight.vehicles["fluffy_II"]
    difference = np.angle(np.exp(1j * (vehicle.actual_psi_rad - vehicle.desired_psi_rad)))
    assert np.abs(difference).max() < np.radians(1.1)


def test_export_and_read_back(flight_bag, tmp_path):
    with Bag(flight_bag) as bag:
        files = export(bag, tmp_path)
    assert set(files) == {"/trajectory", "/trajectory_phase", "/ground_truth", "/mocap_time", "/mocap_data",
                          "/cortex_raw", "/controls", "/risc1/cmd_vel_stamped"}  # fmt: skip
    with files["/trajectory_phase"][0].open() as file:
        assert list(csv.DictReader(file).fieldnames)[-2:] == ["course", "fluffy_II.phase"], "no constants"
    path, rows = files["/cortex_raw"]
    with path.open() as file:
        table = list(csv.DictReader(file))
    assert len(table) == rows == 5999
    x, y, _ = circle(0.005 - LAG_S)
    assert float(table[1]["stamp"]) == pytest.approx(T0_S + 0.005, abs=1e-6)
    assert float(table[1]["receipt"]) == pytest.approx(T0_S + 0.010, abs=1e-6)
    assert [float(table[1]["fluffy_II." + axis]) for axis in "xy"] == pytest.approx([x, y], abs=1e-9)
    assert table[1]["fluffy_II.visible"] == "True"


def test_columns_that_appear_late_are_completed(tmp_path):
    path = tmp_path / "late.bag"
    with rosbag.Bag(str(path), "w") as bag:
        for k, names in enumerate((["a"], ["a", "b"], ["b", "a"], ["b", "b"])):
            bag.write("/cortex_raw", stamped(Cortex(Obj=[States(name=n, x=k) for n in names]), k), rospy.Time(k + 1))
    with Bag(path) as bag:
        file, _ = export(bag, tmp_path / "csv")["/cortex_raw"]
    with file.open() as stream:
        table = list(csv.DictReader(stream))
    assert [row["a.x"] for row in table] == ["0.0", "1.0", "2.0", ""]
    assert [row["b.x"] for row in table] == ["", "1.0", "2.0", "3.0"]
    assert [row["b[1].x"] for row in table] == ["", "", "", "3.0"]
    assert not any(None in row for row in table), "every row is as long as the header"


def test_what_is_wrong_with_a_bag_is_said(flight_bag, tmp_path):
    with pytest.raises(BagError, match="none.bag"), Bag(tmp_path / "none.bag"):
        pass
    broken = tmp_path / "broken.bag"
    broken.write_bytes(flight_bag.read_bytes()[:5000])
    with pytest.raises(BagError, match="rosbag reindex"), Bag(broken):
        pass
    text = tmp_path / "text.bag"
    text.write_text("no bag at all")
    with pytest.raises(BagError, match="text.bag.*rosbag reindex"), Bag(text):
        pass
    with Bag(flight_bag) as bag, pytest.raises(BagError, match="/nothing.*/cortex_raw"):
        list(bag.messages(["/nothing"]))


def test_the_order_of_places_is_that_of_cortex_raw():
    stamp = SimpleNamespace(sec=1000, nanosec=0)
    collector = FlightCollector(with_bearings=False)
    for topic, names in (("/cortex_raw", ["a", "b"]), ("/ground_truth", ["c", "b", "a"]), ("/trajectory", ["Circle"])):
        items = [SimpleNamespace(name=name, visible=True, x=0.0, y=0.0, z=0.0, psi=0.0) for name in names]
        for k in range(2):
            stamp = SimpleNamespace(sec=1000 + k, nanosec=0)
            collector(topic, 1000.0 + k, SimpleNamespace(header=SimpleNamespace(stamp=stamp), Obj=items))
    assert set(collector.flight(strict=False).vehicles) == {"a"}


def test_a_bag_without_a_flight_is_said():
    with pytest.raises(ValueError, match="no /trajectory"):
        FlightCollector().flight()


def test_file_names():
    assert file_name("/risc1/ardrone/navdata") == "risc1_ardrone_navdata.csv"


def test_settling_time():
    t_s = np.arange(0.0, 10.0, 0.01)
    assert settling_time(t_s, np.where(t_s < 2.0, 1.0, 0.01)) == pytest.approx(2.0, abs=0.011)
    assert settling_time(t_s, np.full(len(t_s), 0.01)) == 0.0
    assert settling_time(t_s, np.full(len(t_s), 0.06)) is None
    blink = np.where((t_s > 5.0) & (t_s < 5.1), 1.0, 0.01)
    assert settling_time(t_s, np.where(t_s < 4.5, 1.0, blink)) == pytest.approx(5.1, abs=0.011)


@pytest.mark.parametrize("lag_s", [-0.2, 0.0, 0.033, 0.31])
def test_best_fit_lag_finds_the_lag(lag_s):
    t_s = np.arange(0.0, 20.0, 0.005)
    desired = np.column_stack((np.cos(t_s), np.sin(2 * t_s)))
    actual = np.column_stack((np.cos(t_s - lag_s), np.sin(2 * (t_s - lag_s))))
    assert best_fit_lag(t_s, desired, actual) == pytest.approx(lag_s, abs=1e-3)
    assert best_fit_lag(t_s, np.zeros((len(t_s), 3)), actual[:, :1] * np.ones(3)) is None


def test_summary_is_json_and_the_plots_are_drawn(flight, tmp_path):
    files = plots.draw_all(flight, tmp_path, "test")
    assert {file.name for file in files} == {"paths.png", "axes_fluffy_II.png", "errors.png", "latency.png"}
    assert all(file.stat().st_size > 10000 for file in files)
    result = summary.summarise(flight, "test", {"noise_m": 0.002}, {"plots": [str(file) for file in files]})
    summary.write(result, tmp_path / "summary.json")
    assert json.loads((tmp_path / "summary.json").read_text()) == result
    assert "5999 received" in summary.table(result)
