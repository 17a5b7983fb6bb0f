"""Short runs of the gate's benchmark: its keys, which scripts rely on, and that it can tell a gate from none."""

import functools
import json
import math

import gate as bench
import numpy as np
import pytest
from flight_tape import record, replay

from risc_estimation.filters import make_filter
from risc_experiments.offline import Flight
from risc_lab.states import S

# in this process: another would find the driver's sources before its messages, once a test here has imported them
SMALL = ["--frames", "6000", "--injections", "8", "--outages", "24", "--seeds", "2", "--workers", "1"]
TRUSTING = ["acceleration=1e-4", "climb_acceleration=1e-4", "disturbance=0", "tilt_command=1e-3"]  # trusts its model
IMMOBILE = ["acceleration_max_m_s2=0.1", "speed_max_m_s=0.1", "memory_s=1e6"]  # assumes bodies at rest
ALL = dict.fromkeys(bench.FAULT_OF, 1.0)


@pytest.fixture(scope="module")
def figures(tmp_path_factory):
    """figures(*options): those of an arm."""

    @functools.cache
    def run(*options, changes=()):
        file = tmp_path_factory.mktemp("gate") / "figures.json"
        changes = [word for change in changes for word in ("--set", change)]
        assert bench.main([*SMALL, *options, *changes, "--json", str(file)]) == 0
        return json.loads(file.read_text(encoding="utf-8"))

    return run


@pytest.mark.release
def test_the_figures_that_scripts_rely_on(figures):
    found = figures()
    assert found["clean_poses"] >= 6000 and found["outages"] == 24 and set(found["injections"].values()) == {8}
    assert found["detected_first_frame"] == ALL
    assert 0.0 <= found["false_reject_rate"] <= 1e-4 and found["false_reject_upper95"] < 5e-4
    assert found["lockouts"] == 0 and 0.0 <= found["readmission_ms_p99"] <= 100.0
    assert set(found["nees_of"]) == {"position", "velocity", "angles", "rates"}
    for band in found["nees"], found["nis"], *found["nees_of"].values():
        assert band["low95"] < band["mean"] < band["high95"]


@pytest.mark.release
def test_of_a_filter_without_covariances(figures):
    found = figures("--estimator", "least_squares")
    assert found["detected_first_frame"] == ALL and found["false_reject_rate"] == 0.0
    assert found["lockouts"] == 0 and found["readmission_ms_p99"] <= 50.0, "a window is filled first"
    assert {band["mean"] for band in (found["nees"], found["nis"], *found["nees_of"].values())} == {None}


@pytest.mark.release
def test_without_the_gate_what_is_false_is_taken(figures):
    control = figures("--gate", "off")
    assert control["detected_first_frame"] == {**dict.fromkeys(ALL, 0.0), "swap": 0.5}, "most swaps show"
    assert control["false_reject_rate"] == 0.0


@pytest.mark.release
def test_a_narrow_gate_refuses_what_is_good(figures):
    """1 % of positions and 1 % of attitudes."""
    assert figures(changes=("gate_probability=1e-2",))["false_reject_rate"] == pytest.approx(0.02, abs=0.005)


@pytest.mark.release
@pytest.mark.parametrize(("estimator", "changes"), [("ekf", ["readmit_s=1e9", *TRUSTING]), ("least_squares", IMMOBILE)])
def test_who_trusts_its_prediction_without_a_way_back_locks_out(figures, estimator, changes):
    assert figures("--estimator", estimator, changes=tuple(changes))["lockouts"] > 0


@pytest.mark.release
def test_covariances_that_are_too_large_are_outside_of_the_band(figures):
    found = figures(changes=("acceleration=0.1", "climb_acceleration=0.1"))
    assert found["nees"]["mean"] < found["nees"]["low95"]
    assert found["nees_of"]["velocity"]["mean"] < found["nees_of"]["velocity"]["low95"]


def test_what_is_wrong_and_what_is_false():
    truth = np.zeros((4, 12))
    truth[:, S.PSI] = math.pi - 0.01
    x = truth.copy()
    x[0, S.X], x[1, S.PHI], x[2, S.PSI] = 0.031, math.radians(5.1), -math.pi + math.radians(10.1) - 0.01
    errors = bench.errors_of(x[:, :3], x[:, S.PHI : S.P], truth)
    limits = 0.03, math.radians(5.0), math.radians(10.0)
    assert (errors > limits).tolist() == [[True, False, False], [False, True, False], [False, False, True], [False] * 3]
    np.testing.assert_allclose(errors[3], 0.0, atol=1e-12)


def test_a_lock_out_is_counted_and_has_no_time():
    tally = bench.Tally(10, 1, bench.Counter(jump=2), bench.Counter(jump=1), [0.005, math.inf], [[12.0] * 5], [6.0])
    found = bench.figures_of([tally, tally], {})
    assert found["lockouts"] == 2 and found["readmission_ms_p99"] is None
    assert found["detected_first_frame"] == {"swap": None, "flip": None, "exchange": None, "jump": 0.5}
    # of Clopper and Pearson, one-sided: so many or fewer have a probability of 5 %
    upper = found["false_reject_upper95"]
    assert sum(math.comb(20, k) * upper**k * (1.0 - upper) ** (20 - k) for k in range(3)) == pytest.approx(0.05)


@pytest.mark.parametrize("wrong", [["--frames", "0"], ["--seeds", "0"], ["--outages", "-1"], ["--gate", "maybe"],
                                   ["--estimator", "none"], ["--set", "gate_probability=much"],
                                   ["--set", "gate_probability=0.5"], ["--set", "gate=1"]])  # fmt: skip
def test_wrong_use_is_refused(wrong):
    with pytest.raises(SystemExit):
        bench.main(wrong)


def test_a_tape_is_the_flight_that_was_flown():
    """Its estimator follows the truth, apart from noise; the same flight gives the same tape."""
    flight = Flight("circle", vehicles=2, seed=3, duration_s=2.0)
    tape = record(flight, ("command", "velocity", "attitude"))
    assert tape.names == ("fluffy_II", "albatross") and len(tape.times_s) == len(tape.told) == pytest.approx(400, abs=2)
    np.testing.assert_array_equal(record(flight, ()).truths, tape.truths)
    kinds = {what for told in tape.told for _, _, what, _ in told}
    assert kinds == {"command", "velocity", "attitude"}
    ends = []
    for seed in (1, 1, 2):
        estimator = tape.estimator(make_filter("ekf"))
        for k, seen, estimate in replay(tape, estimator, tape.cameras(seed)):
            assert seen.time_s == estimate.stamp_s == tape.times_s[k]
        ends.append(estimate.states)
    assert np.linalg.norm(ends[0][:, :3] - tape.truths[-1, :, :3], axis=1).max() < 0.005
    np.testing.assert_array_equal(ends[0], ends[1])
    assert (ends[0] != ends[2]).all()
