"""fit_throttle.py: the curve of a synthetic flight comes back; bags that say too little say why."""

import math
import pathlib
import runpy
import subprocess
import sys

import numpy as np
import pytest
import rosbag
import rospy
import yaml

from data_extraction.throttle_fit import FitParams, HoverPoints, fit, fit_bag, hover_points
from risc_lab.frames import GRAVITY_M_S2 as G
from risc_lab.lab import load_vehicle_type
from risc_lab.lab.vehicle_types import own_numbers
from risc_lab.radio_sticks import RadioSticks
from risc_maap_msgs.msg import VehicleStatus
from risc_msgs.msg import Control, Controls, Cortex, States
from roscopter.msg import Status

NODE = pathlib.Path(__file__).resolve().parents[1] / "nodes/fit_throttle.py"
CURVE = own_numbers(load_vehicle_type("iris"), RadioSticks).hover_throttle
T0_S, LIFE_S = 500.0, 900.0


def true_throttle(pct):
    return np.polynomial.polynomial.polyval(pct, CURVE)


def flight(until_pct=35.0, from_pct=100.0, noise=1.0, whole_percents=True, seed=1):
    """(states, throttle, battery) as `hover_points` takes them, of a vehicle that bobs and sways by that throttle."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, LIFE_S * (from_pct - until_pct) / 100.0, 0.005)
    pct = from_pct - 100.0 * t_s / LIFE_S
    up_m_s2 = 0.25 * np.sin(1.5 * t_s)
    climb_m_s, roll_rad = -0.25 / 1.5 * np.cos(1.5 * t_s), 0.25 * np.sin(0.5 * t_s)
    sent = true_throttle(pct) + (1.0 + up_m_s2 / G) / np.cos(roll_rad) - 1.0
    sent = sent + noise * rng.normal(0.0, 0.02, len(t_s))
    climb_m_s = climb_m_s + noise * rng.normal(0.0, 0.02, len(t_s))
    roll_rad = roll_rad + noise * rng.normal(0.0, 0.005, len(t_s))
    states = np.column_stack((t_s, 0.0 * t_s + 1.2, climb_m_s, np.abs(climb_m_s), roll_rad, 0.0 * t_s))
    told = np.column_stack((t_s, np.round(pct) if whole_percents else pct))
    return states, np.column_stack((t_s, sent))[::4], told[::100]


def worst(found):
    """Greatest error of the curve where it was flown, as a fraction of the span of the true one."""
    pct = np.linspace(found.points.pct[0], found.points.pct[-1], 200)
    return np.abs(found.scaled(pct) - true_throttle(pct)).max() / np.ptp(true_throttle(pct))


@pytest.mark.parametrize(("noise", "whole_percents"), [(0.0, False), (0.0, True), (1.0, False), (1.0, True)])
def test_the_curve_of_a_known_flight_comes_back(noise, whole_percents):
    found = fit(hover_points(*flight(noise=noise, whole_percents=whole_percents), FitParams()), 4)
    assert worst(found) < 0.01
    raw = np.polynomial.polynomial.polyval(found.points.pct, found.coefficients)
    assert np.abs(raw - found.scaled(found.points.pct)).max() < 1e-9


def test_tilt_and_acceleration_count():
    """Without them the throttle of the same flight gives a wrong curve."""
    states, throttle, battery = flight(noise=0.0)
    level = states.copy()
    level[:, 4] = 0.0
    assert worst(fit(hover_points(level, throttle, battery, FitParams()), 4)) > 0.02
    still = states.copy()
    still[:, 2] = 0.0
    short = FitParams(window_s=0.5)
    spreads = [np.nanmean(hover_points(s, throttle, battery, short).spread) for s in (states, still)]
    assert spreads[1] > 10.0 * spreads[0]


def test_the_intervals_hold_the_truth_as_often_as_they_say():
    pct, rng, flights = np.arange(40.0, 101.0), np.random.default_rng(3), 60
    inside, inside_half = np.zeros(5), np.zeros(5)
    for _ in range(flights):
        throttle = true_throttle(pct) + rng.normal(0.0, 0.004, len(pct))
        found = fit(HoverPoints(pct, throttle, 0.0 * pct, 0.0 * pct + 9.0), 4)
        off = np.abs(found.coefficients - CURVE)
        inside += off <= found.intervals
        inside_half += off <= 0.5 * found.intervals
    assert (inside >= 0.85 * flights).all(), "95 % are meant"
    assert (inside_half <= 0.85 * flights).all(), "68 % are meant"


def test_what_is_no_hover_counts_not():
    states, throttle, battery = flight(noise=0.0)
    everything = hover_points(states, throttle, battery, FitParams())
    half = len(states) // 2
    low, fast, rises, thrown = (states.copy() for _ in range(4))
    low[half:, 1], fast[half:, 3] = 0.1, 1.5
    rises[half:, 2] += 0.5
    thrown[half:, 2] += 0.3 * np.sign(np.cos(np.pi * states[half:, 0]))  # in the middle of each window
    silent = throttle[throttle[:, 0] < states[half, 0]]
    untold = battery[battery[:, 0] < states[half, 0]]
    carried = throttle.copy()  # carried through the room, disarmed
    carried[carried[:, 0] >= states[half, 0], 1] = -1.0
    for told in (
        (low, throttle, battery),
        (fast, throttle, battery),
        (rises, throttle, battery),
        (thrown, throttle, battery),
        (states, silent, battery),
        (states, carried, battery),
        (states, throttle, untold),
    ):
        assert hover_points(*told, FitParams()).seconds.sum() == pytest.approx(everything.seconds.sum() / 2.0, abs=8.0)
    unseen = np.delete(states, slice(half, None, 20), axis=0)  # single missing frames do not count as a loss
    assert hover_points(unseen, throttle, battery, FitParams()).seconds.sum() == everything.seconds.sum()


# --- bags -------------------------------------------------------------------------------------------------------------


def write(path, data, own="/iris1/controls", charge="/iris1/vehicle_status", without=()):
    """A bag of a flight at 20 Hz; `charge` is a VehicleStatus or, on apm/status, a roscopter Status."""
    states, throttle, battery = data
    with rosbag.Bag(str(path), "w") as bag:

        def put(topic, message, t_s):
            if topic not in without:
                bag.write(topic, message, rospy.Time.from_sec(T0_S + t_s))

        for t_s, z, climb, _, roll, _ in states[::10]:
            put("/cortex_raw", Cortex(Obj=[States("IRIS", True, 0, 0, z, 0, 0, climb, math.degrees(roll), *[0] * 5),
                                           States("fluffy_II", True, *[0] * 12)]), t_s)  # fmt: skip
        for t_s, value in throttle[::2]:
            put(own, Controls(Obj=[Control("IRIS", 0.0, 0.0, 0.0, value)]), t_s)
        for t_s, value in battery:
            if charge.endswith("vehicle_status"):
                put(charge, VehicleStatus(name="IRIS", battery_pct=value), t_s)
            else:
                put(charge, Status(battery_remaining=int(value)), t_s)
    return path


@pytest.fixture(scope="module")
def long_bag(tmp_path_factory):
    return write(tmp_path_factory.mktemp("bag") / "long.bag", flight())


def test_the_command_writes_a_line_for_the_type_file(long_bag, tmp_path):
    """As a user starts it."""
    command = [sys.executable, str(NODE), str(long_bag), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    said = done.stdout
    coefficients = yaml.safe_load((tmp_path / "hover_throttle.yaml").read_text())["hover_throttle"]
    pct = np.arange(36.0, 100.0)
    off = np.polynomial.polynomial.polyval(pct, coefficients) - true_throttle(pct)
    assert np.abs(off).max() < 0.01 * np.ptp(true_throttle(pct))
    assert "IRIS" in said and "hover_throttle: [" in said
    assert (tmp_path / "hover_throttle.png").read_bytes().startswith(b"\x89PNG")
    RadioSticks(tuple(coefficients))  # a type takes them


def test_bags_of_the_original_have_no_namespace(tmp_path):
    data = flight(until_pct=75.0)
    bag = write(tmp_path / "old.bag", data, "/controls", "/apm/status")
    name, found = fit_bag(bag, params=FitParams(order=2))
    assert (name, len(found.coefficients)) == ("IRIS", 3)
    assert fit_bag(bag, "IRIS", FitParams(order=2))[1].rms == found.rms


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"without": ("/cortex_raw",)}, "no /cortex_raw .*/iris1/controls"),
        ({"without": ("/iris1/controls",)}, "no NAMESPACE/controls .*record.launch"),
        ({"without": ("/iris1/vehicle_status",)}, "no NAMESPACE/vehicle_status"),
        ({"own": "/controls"}, "no NAMESPACE/controls"),  # a controller's wish is not what was sent to an IRIS+
        ({"charge": "/risc1/vehicle_status"}, "BATT_MONITOR"),
    ],
)
def test_a_bag_that_lacks_something_says_what(tmp_path, options, message):
    bag = write(tmp_path / "short.bag", flight(until_pct=99.0), **options)
    with pytest.raises(ValueError, match=message):
        fit_bag(bag)


def test_a_flight_that_says_too_little_says_why(tmp_path, monkeypatch, capsys):
    data = flight(until_pct=92.0)
    bag = write(tmp_path / "short.bag", data)
    with pytest.raises(ValueError, match="100 to 92 %.*order 4 .* 20 .*--order"):
        fit_bag(bag)
    assert len(fit_bag(bag, params=FitParams(order=1))[1].coefficients) == 2
    with pytest.raises(ValueError, match="IRIS .* 2 m .*--min-height"):
        fit_bag(bag, params=FitParams(min_height_m=2.0))
    with pytest.raises(ValueError, match="'risc1'.*IRIS .iris1."):
        fit_bag(bag, "risc1")
    untold = write(tmp_path / "untold.bag", (*data[:2], [(t_s, math.nan) for t_s, _ in data[2]]))
    with pytest.raises(ValueError, match="BATT_MONITOR"):
        fit_bag(untold)
    for arguments, text in (([bag, "--order", 12], "'order'"), ([tmp_path / "none.bag"], "none.bag")):
        monkeypatch.setattr(sys, "argv", [str(NODE), *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            runpy.run_path(str(NODE), run_name="__main__")
        error = capsys.readouterr().err
        assert ended.value.code == 1 and text in error and "Traceback" not in error
