"""Bearings in a bag against truth: bias, noise, delay, what was in view; all with known answers."""

import csv
import json

import numpy as np
import pytest
import rosbag
import rospy
from sensor_msgs.msg import CameraInfo

from data_extraction import plots, summary
from data_extraction.bags import Bag
from data_extraction.bearing_errors import BearingCollector
from data_extraction.csv_export import export
from data_extraction.flight_metrics import FlightCollector
from data_extraction.surroundings import Surroundings
from risc_lab.lab import fleet_from_dict
from risc_maap_msgs.msg import Detection, Detections
from risc_msgs.msg import (
    Angle,
    Angles,
    Cortex,
    Landmark,
    Landmarks,
    Mocap_data,
    Mocap_marker,
    Mocap_markers,
    Observed_angles,
    States,
    Trajectories,
    Trajectory,
)

T0_S = 1000.0
NOSE_M = 0.21  # of the camera in front of the vehicle's centre
GREEN_M = (-2.3, 0.4, 1.2)  # behind the origin: seen at a yaw of +-180 degrees
ORANGE_M = (2.3, -0.3, 1.0)
BIAS_DEG = (0.3, -0.2)
NOISE_DEG = 0.05
DELAY_S = 0.06
FOCAL_PX = 600.0


def pose(t_s):
    """(x, y, z) [m] and yaw [deg] at a time: it sways, and its yaw swings across the wrap at 180 degrees."""
    t = t_s - T0_S
    yaw = 180.0 + 12.0 * np.sin(1.3 * t)
    return (0.3 * np.sin(0.9 * t), 0.2 * np.cos(0.7 * t), 1.1 + 0.1 * np.sin(t)), (yaw + 180.0) % 360.0 - 180.0


def true_deg(place_m, t_s):
    """Azimuth and elevation [deg] from a level vehicle, from first principles: nose along (cos yaw, -sin yaw)."""
    position, yaw = pose(t_s)
    nose = np.array([np.cos(np.radians(yaw)), -np.sin(np.radians(yaw)), 0.0])
    right = np.array([-np.sin(np.radians(yaw)), -np.cos(np.radians(yaw)), 0.0])
    line = np.subtract(place_m, position) - NOSE_M * nose
    return (
        np.degrees(np.arctan2(line @ right, line @ nose)),
        np.degrees(np.arctan2(line[2], np.hypot(line @ nose, line @ right))),
    )


def stamped(message, t_s):
    message.header.stamp = rospy.Time.from_sec(t_s)
    return message


def state(t_s):
    (x, y, z), yaw = pose(t_s)
    return States(name="fluffy_II", visible=True, x=x, y=y, z=z, psi=yaw)


def camera_info():
    return CameraInfo(
        width=640, height=360, distortion_model="plumb_bob", D=[0.0] * 5,
        K=[FOCAL_PX, 0, 320, 0, FOCAL_PX, 180, 0, 0, 1], R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=[FOCAL_PX, 0, 320, 0, 0, FOCAL_PX, 180, 0, 0, 0, 1, 0],
    )  # fmt: skip


def measured(place_m, t_s, random, name="green"):
    azimuth, elevation = np.array(true_deg(place_m, t_s)) + BIAS_DEG + NOISE_DEG * random.standard_normal(2)
    return Angle(name=name, visible=True, azim=azimuth, elev=elevation)


def lost(name):
    return Angle(name=name, visible=False, azim=np.nan, elev=np.nan)


@pytest.fixture(scope="module")
def bag_file(tmp_path_factory):
    """20 s: risc1 sees the green landmark, 60 ms late, except in every tenth picture; a wrong one now and then."""
    path = tmp_path_factory.mktemp("bearings") / "flight.bag"
    random = np.random.default_rng(7)
    with rosbag.Bag(str(path), "w") as bag:

        def write(topic, message, t_s):
            bag.write(topic, stamped(message, t_s), rospy.Time.from_sec(t_s))

        for k in range(4000):
            t_s = T0_S + 0.005 * k
            write("/ground_truth", Cortex(Obj=[state(t_s)]), t_s)
            write("/cortex_raw", Cortex(Obj=[state(t_s)]), t_s)
            if k % 20 == 0:
                x, y, z = pose(t_s)[0]
                write("/trajectory", Trajectories(Obj=[Trajectory(name="fluffy_II", x=x, y=y, z=z)]), t_s)
                places = (("Green_pink", GREEN_M), ("Orange_blue", ORANGE_M))
                write("/states3", Landmarks(Obj=[Landmark(name, *place) for name, place in places]), t_s)
        write("/risc1/ardrone/camera_info", camera_info(), T0_S)
        for k in range(3, 590):
            t_s = T0_S + k / 30.0
            green = lost("green") if k % 10 == 0 else measured(GREEN_M, t_s - DELAY_S, random)
            orange = Angle(name="Orange", visible=True, azim=3.0, elev=1.0) if k == 100 else lost("Orange")
            observed = Angles(name="risc1", landmarks=[green, orange], quads=[lost("Raven")])
            write("/angles", Observed_angles(Obj=[observed]), t_s)
            deviation_px = FOCAL_PX * np.radians(NOISE_DEG)
            exact = Detection(name="green", visible=green.visible, covariance=[deviation_px**2, 0, 0, deviation_px**2])
            write("/detections", Detections(name="risc1", landmarks=[exact]), t_s)
    return path


def statistics(path, delay_s, fleet=None):
    collector = BearingCollector(fleet)
    with Bag(path) as bag:
        for message in bag.messages():
            collector(*message)
    return collector.statistics(delay_s)


@pytest.fixture(scope="module")
def result(bag_file):
    """Statistics with the known delay."""
    return statistics(bag_file, DELAY_S)


def test_bias_and_noise_are_found_when_the_delay_is_known(result):
    assert (result.truth, result.landmarks_from) == ("ground truth", "/states3")
    green = result.figures()["vehicles"]["fluffy_II"]["Green_pink"]
    assert green["azimuth_bias_deg"] == pytest.approx(BIAS_DEG[0], abs=0.01)
    assert green["elevation_bias_deg"] == pytest.approx(BIAS_DEG[1], abs=0.01)
    assert green["azimuth_rms_deg"] == pytest.approx(np.hypot(BIAS_DEG[0], NOISE_DEG), abs=0.01)
    assert green["elevation_rms_deg"] == pytest.approx(np.hypot(BIAS_DEG[1], NOISE_DEG), abs=0.01)
    biased = np.sqrt(1.0 + (np.square(BIAS_DEG) / NOISE_DEG**2).sum() / 2.0)
    assert green["normalised_rms"] == pytest.approx(biased, rel=0.1), "1 without the bias"
    assert green["gross"] == 0 and green["false_alarms"] == 0
    assert green["count"] + green["partial_count"] == pytest.approx(0.9 * 587, abs=3)


def test_what_was_in_view_and_found(result):
    vehicles = result.figures()["vehicles"]
    green, orange = vehicles["fluffy_II"]["Green_pink"], vehicles["fluffy_II"]["Orange_blue"]
    assert 300 < green["in_view"] <= 587
    assert green["seen_percent"] == pytest.approx(90.0, abs=1.5)
    assert (orange["in_view"], orange["seen_percent"]) == (0, None), "it is behind the camera all the time"
    assert (orange["false_alarms"], orange["count"]) == (1, 0)


def test_an_unknown_delay_shows_in_the_errors_and_is_found(bag_file):
    result = statistics(bag_file, 0.0)
    green = result.figures()["vehicles"]["fluffy_II"]["Green_pink"]
    assert green["azimuth_rms_deg"] > 0.6, "the vehicle turns at up to 16 deg/s"
    assert result.best_delay_s == pytest.approx(DELAY_S, abs=0.003)
    assert result.best_delay_rms_deg == pytest.approx(np.sqrt((0.09 + 0.04) / 2 + NOISE_DEG**2), abs=0.01)


def test_what_nobody_knows_is_said(result):
    assert ["fluffy_II" in note and "Raven" in note for note in result.notes] == [True]
    json.dumps(result.figures(), allow_nan=False)


def test_a_bag_without_bearings_has_no_statistics(tmp_path):
    path = tmp_path / "none.bag"
    with rosbag.Bag(str(path), "w") as bag:
        bag.write("/cortex_raw", stamped(Cortex(Obj=[state(T0_S)]), T0_S), rospy.Time.from_sec(T0_S))
    assert statistics(path, 0.0) is None


def test_the_discs_plane_is_that_of_its_markers(tmp_path):
    turn = np.radians(60.0)
    across = np.array([-np.sin(turn), np.cos(turn), 0.0])  # the disc looks along (cos, sin) of the turn
    up = np.array([0.0, 0.0, 1.0])
    rim = [GREEN_M + 0.17 * offset for offset in (up, across, -up, -across)]
    body = Mocap_markers(name="Green_pink", marker=[Mocap_marker(*place) for place in rim])
    path = tmp_path / "turned.bag"
    with rosbag.Bag(str(path), "w") as bag:
        for topic, message in (
            ("/mocap_data", Mocap_data(Obj=[body])),
            ("/states3", Landmarks(Obj=[Landmark("Green_pink", *GREEN_M), Landmark("Orange_blue", *ORANGE_M)])),
        ):
            bag.write(topic, stamped(message, T0_S), rospy.Time.from_sec(T0_S))
    surroundings = Surroundings()
    with Bag(path) as bag:
        for message in bag.messages():
            surroundings(*message)
    green, orange = surroundings.discs()
    assert green.normal == pytest.approx((np.cos(turn), np.sin(turn), 0.0), abs=1e-6)
    assert orange.normal == pytest.approx((-1.0, 0.0, 0.0), abs=1e-6), "as in the template, towards the middle"


def test_nested_arrays_are_columns_by_name(bag_file, tmp_path):
    with Bag(bag_file) as bag:
        path, rows = export(bag, tmp_path, ["/angles"])["/angles"]
    header = path.read_text().splitlines()[0].split(",")
    assert rows == 587
    for column in ("risc1.green.azim", "risc1.green.elev", "risc1.green.visible", "risc1.Orange.azim"):
        assert column in header
    assert "risc1.Raven.azim" in header, "a quad"


def test_a_name_in_two_arrays_keeps_both_columns(tmp_path):
    path = tmp_path / "twice.bag"
    entry = Angles("risc1", [Angle("Raven", True, 1.0, 2.0)], [Angle("Raven", True, 3.0, 4.0)])
    with rosbag.Bag(str(path), "w") as bag:
        bag.write("/angles", stamped(Observed_angles(Obj=[entry]), T0_S), rospy.Time.from_sec(T0_S))
    with Bag(path) as bag:
        file, _ = export(bag, tmp_path / "csv")["/angles"]
    with file.open() as stream:
        row = next(csv.DictReader(stream))
    assert (row["risc1.Raven.azim"], row["risc1.quads.Raven.azim"]) == ("1.0", "3.0")


def test_bearings_are_in_the_summary_its_table_and_a_plot(bag_file, tmp_path):
    collector = FlightCollector(bearing_delay_s=DELAY_S)
    with Bag(bag_file) as bag:
        for message in bag.messages():
            collector(*message)
    flight = collector.flight()
    files = plots.draw_all(flight, tmp_path, "test")
    assert (tmp_path / "bearings.png") in files and (tmp_path / "bearings.png").stat().st_size > 20000
    result = summary.summarise(flight, "test", {"noise_m": 0.0}, {})
    summary.write(result, tmp_path / "summary.json")
    stored = json.loads((tmp_path / "summary.json").read_text())["bearings"]
    green = stored["vehicles"]["fluffy_II"]["Green_pink"]
    assert green["azimuth_bias_deg"] == pytest.approx(BIAS_DEG[0], abs=0.01)
    line = next(line for line in summary.table(result).splitlines() if "Green_pink" in line)
    assert "%d" % green["count"] in line and "90 %" in line and "0.30" in line
    assert "Raven" in summary.table(result)


def test_a_flight_without_cameras_has_no_bearings(tmp_path):
    path = tmp_path / "blind.bag"
    with rosbag.Bag(str(path), "w") as bag:
        for k in range(200):
            t_s = T0_S + 0.005 * k
            reference = Trajectories(Obj=[Trajectory(name="fluffy_II")])
            bag.write("/cortex_raw", stamped(Cortex(Obj=[state(t_s)]), t_s), rospy.Time.from_sec(t_s))
            bag.write("/trajectory", stamped(reference, t_s), rospy.Time.from_sec(t_s))
    collector = FlightCollector()
    with Bag(path) as bag:
        for message in bag.messages():
            collector(*message)
    flight = collector.flight()
    assert flight.bearings is None
    result = summary.summarise(flight, "test", False, {})
    assert result["bearings"] is None and "bearing" not in summary.table(result)
    assert "bearings.png" not in {file.name for file in plots.draw_all(flight, tmp_path, "test")}


def fleet(landmarks=()):
    start = {"position_m": [0, 0, 0]}
    vehicle = {"namespace": "risc1", "template": "fluffy_II", "type": "ardrone", "address": "127.0.0.1", "start": start}
    return fleet_from_dict(
        {"name": "one", "mocap": {"host": "127.0.0.1"}, "vehicles": [vehicle], "landmarks": list(landmarks)}
    )


def test_the_virtual_labs_landmarks_are_where_the_fleet_file_puts_them(bag_file):
    shifted = [GREEN_M[0], GREEN_M[1] + 0.1, GREEN_M[2]]
    result = statistics(bag_file, DELAY_S, fleet([{"name": "Green_pink", "position_m": shifted, "facing_deg": 0.0}]))
    assert result.landmarks_from == "fleet"
    green = result.figures()["vehicles"]["fluffy_II"]["Green_pink"]
    # the vehicle looks along -x, so cortex +y is to its right: the true azimuth is greater by about 0.1 m / 2.1 m
    assert green["azimuth_bias_deg"] == pytest.approx(BIAS_DEG[0] - np.degrees(0.1 / 2.1), abs=0.3)
