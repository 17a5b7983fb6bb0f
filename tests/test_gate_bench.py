"""The benchmark of the gate, in small: its keys, which scripts rely on, and that it can tell a gate from none."""

import json
import math

import gate as bench
import numpy as np
import pytest

from risc_estimation.filters import make_filter
from risc_experiments.flight_tape import record, replay
from risc_experiments.offline import Flight
from risc_lab.states import S

# in this process: another would find the driver's sources before its messages, once a test here has imported them
SMALL = ["--frames", "4000", "--injections", "12", "--outages", "4", "--seeds", "1", "--workers", "1"]


@pytest.fixture(scope="module")
def arms(tmp_path_factory):
    """{gate: figures}, and what was printed is told by the last one."""
    found = {}
    for gate in ("on", "off"):
        file = tmp_path_factory.mktemp("gate") / "figures.json"
        assert bench.main([*SMALL, "--gate", gate, "--json", str(file)]) == 0
        found[gate] = json.loads(file.read_text(encoding="utf-8"))
    return found


@pytest.mark.release
def test_the_figures_that_scripts_rely_on(arms):
    found = arms["on"]
    assert set(found["detected_first_frame"]) == {"swap", "flip", "exchange", "jump"}
    assert found["clean_poses"] >= 4000 and found["outages"] == 4
    assert set(found["injections"].values()) == {12}
    assert 0.0 <= found["false_reject_rate"] < found["false_reject_upper95"] < 0.01
    assert found["lockouts"] == 0 and 0.0 <= found["readmission_ms_p99"] < 1000.0
    for name, freedom in ("nees", 12), ("nis", 6):
        assert found[name]["low95"] < freedom < found[name]["high95"] and found[name]["mean"] > 0.0
    assert set(found["nees_of"]) == {"position", "velocity", "angles", "rates"}


@pytest.mark.release
def test_without_the_gate_what_is_false_is_taken(arms):
    found, control = (arms[gate]["detected_first_frame"] for gate in ("on", "off"))
    assert min(found["flip"], found["exchange"], found["jump"]) > 0.9
    assert max(control["flip"], control["exchange"], control["jump"]) < 0.1
    assert found["swap"] > control["swap"]
    assert arms["off"]["false_reject_rate"] == 0.0


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
    found = bench.figures_of([tally, tally], True)
    assert found["lockouts"] == 2 and found["readmission_ms_p99"] is None
    assert found["detected_first_frame"] == {"swap": None, "flip": None, "exchange": None, "jump": 0.5}
    # of Clopper and Pearson, one-sided: so many or fewer have a probability of 5 %
    upper = found["false_reject_upper95"]
    assert sum(math.comb(20, k) * upper**k * (1.0 - upper) ** (20 - k) for k in range(3)) == pytest.approx(0.05)


@pytest.mark.parametrize("wrong", [["--frames", "0"], ["--seeds", "0"], ["--outages", "-1"], ["--gate", "maybe"]])
def test_wrong_use_is_refused(wrong):
    with pytest.raises(SystemExit):
        bench.main(wrong)


def test_a_tape_is_the_flight_that_was_flown():
    """Its estimator, with exact cameras' noise aside, follows the truth; the same tape comes out of the same flight."""
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
